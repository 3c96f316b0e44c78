"""Effects and places in plain words."""

from __future__ import annotations

from dataclasses import dataclass

from armflex.laws.effects.law import Effect
from armflex.laws.effects.spot import BASE, LINK, TOOL, Spot
from armflex.laws.effects.unnamed import SHAPES
from armflex.parameters import numbered


@dataclass(frozen=True)
class Words:
    """What a law is called, what it means, and its formula."""

    title: str
    meaning: str
    formula: str


LAWS = {
    "encoder_offset": Words("encoder offset", "the joint stands beside where it is said to stand", "constant"),
    "encoder_scale": Words("encoder scale", "the joint moves further than is said, or less", "scale · (q − q₀)"),
    "encoder_eccentricity": Words("encoder eccentricity", "the error turns with the joint", "A sin q + B cos q"),
    "gear_harmonic": Words("gear harmonic", "the error goes k times round with the joint", "A sin kq + B cos kq"),
    "backlash": Words("backlash", "play that is taken up by the side from which the joint came", "(gap / 2) · s"),
    "friction_windup": Words(
        "friction wind-up", "the drive is twisted by the friction that it overcame last", "s · (a + b |τ|)"
    ),
    "hysteresis": Words("hysteresis", "the joint gives with the loads it carried before", "gain · play(τ; radius)"),
    "stiffening": Words("load-dependent stiffness", "the joint gives not in proportion", "c₂ τ|τ| + c₃ τ³"),
    "deadband": Words("play taken up by the load", "the joint falls to the loaded side", "g · clip(τ / τ₀, ±1)"),
    "even_in_load": Words("deflection even in the load", "the same way whichever way it is loaded", "c |w|, c τ²"),
    "compliance": Words("compliance", "the joint gives more (or less) than declared", "C · w"),
    "cross_coupling": Words("cross coupling", "a load along one axis deflects another", "C_ab · w_b"),
    "position_dependent_compliance": Words(
        "position-dependent compliance", "the joint gives more in some positions", "(C₁ q + C₂ q²) · w"
    ),
    "thermal_softening": Words("thermal softening", "the joint gives more as it warms", "β (T − T₀) · C w"),
    "creep": Words("creep", "the joint goes on giving while the load stands", "c τ log(1 + h / t₀)"),
    "slip_step": Words("slip", "the joint moved once and stayed there", "size from a moment on"),
    "dress_pack": Words("dress pack pull", "cables turn the joint as it moves", "C · k (q − q₀)"),
    "thermal_growth": Words("thermal growth", "the link grows as it warms", "α L (T − T₀)"),
    "thermal_bending": Words("thermal bending", "the link bends as it warms", "β (T − T₀)"),
    "link_flexure": Words("link flexure", "the link itself bends", "C · w"),
    "link_mass": Words("link mass correction", "the link weighs otherwise than declared", "m, centre of mass"),
    "link_geometry": Words("link geometry correction", "the link is otherwise than drawn", "constant twist"),
    "payload_mass": Words("payload mass correction", "the payload weighs otherwise than declared", "Δm"),
    "payload_com": Words("payload centre-of-mass correction", "the payload hangs elsewhere than declared", "Δcom"),
    "tool_shift": Words("tool shift", "the target is elsewhere than declared, or moved", "constant shift"),
    "tip_force": Words("tip force", "something pulls at the tip", "constant force"),
    "umbilical": Words("umbilical pull", "a spring pulls the link towards a fixed point", "k · (distance − rest)"),
    "magnetic_pull": Words("magnetic pull", "a force towards a point that falls with distance", "F / (d² + reach²)"),
    "base_compliance": Words("base compliance", "the foundation tilts under the load", "C · w"),
    "base_thermal": Words("thermal base motion", "the foundation follows the weather", "β (T − T₀)"),
    "base_drift": Words("base drift", "the foundation or the instrument wanders with time", "v · t"),
    "gravity_tilt": Words("gravity tilt", "down is not where the frame says", "rotation of gravity"),
    "tracker_scale": Words("instrument scale", "distances are read too long or too short", "λ · range"),
    "session_frame": Words("session frame", "the frame of one session differs", "a frame per session"),
    "unnamed_guide": Words(
        "play in the guides",
        "a tube rocks in its guides, the more the less they overlap",
        "(g · clip(τ / τ₀) + c τ) / overlap",
    ),
    "unnamed_level": Words("unnamed level", "it is there while a column has one entry", "a step"),
    "unnamed_line": Words("unnamed trend", "it grows steadily with a column", "slope · x + curvature · x²"),
    "unnamed_wave": Words("unnamed wave", "it goes up and down with a column", "A sin kx + B cos kx"),
    "unnamed_bump": Words("unnamed bump", "it happens near one value", "height · exp(−(x − centre)² / 2 width²)"),
    "unnamed_shape": Words("unnamed shape", "it follows a column freely", "f(x), straight between knots"),
    "unnamed_compliance": Words("unnamed compliance", "it gives with the load, as a column goes", "f(x) · w"),
    "unnamed_wave_product": Words(
        "unnamed wave product", "a wave in one column grows with another", "(A + C y) sin kx + (B + D y) cos kx"
    ),
    "unnamed_product": Words("unnamed product", "two columns act together", "f(x) · (1, y)"),
}

SITES = {BASE: "the base", TOOL: "the tool", LINK + TOOL: "the last link"}


def words(effect: str) -> Words:
    """Return the words for a law; one without words goes by its name."""
    return LAWS.get(effect, Words(effect.replace("_", " "), "", ""))


def site_words(site: str) -> str:
    """Return a site in words: 'A5', 'the link ending at A5', 'the base'."""
    if site in SITES:
        return SITES[site]
    return f"the link ending at {site.removeprefix(LINK)}" if site.startswith(LINK) else site


def place_words(spot: Spot) -> str:
    """Return where an effect acts: 'A5 (rz)'."""
    return f"{site_words(spot.site)} ({spot.axis})" if spot.axis else site_words(spot.site)


def called(effect: Effect, number: int = 1) -> str:
    """Return an effect in words: 'backlash at A5 (rz)'; one without a name says which column it goes with.

    `number` is which of its name it is in the arm, see `numbers_of`: the second ends in #2.
    """
    title = words(effect.law.name).title
    if effect.law.name in SHAPES and title.startswith("unnamed "):
        shape, columns = title.removeprefix("unnamed "), " and ".join(effect.spot.covariates)
        title = f"something without a name (a {shape} in {columns})"
    partner = f" with {effect.spot.partner}" if effect.spot.partner else ""
    return f"{title} at {place_words(effect.spot)}{partner}{numbered(number)}"


def units_of(effect: Effect) -> dict[str, str]:
    """Return the unit of every value by name; one per unit of a column says which column."""
    spot = effect.spot
    column = spot.covariates[-1] if spot.covariates else "its column"
    units = [unit.replace("per recorded", f"per unit of {column}") for unit in effect.units]
    return dict(zip(effect.named, units, strict=True))


def labelled(effect: Effect, number: int = 1) -> str:
    """Return an effect in as few words as tell it from its rivals: law, place, number, terms, columns."""
    law, spot = effect.law, effect.spot
    terms = [law.amplitudes[i].name for i in spot.terms]
    which = f" [{' '.join(terms)}]" if 0 < len(terms) < len(law.amplitudes) else ""
    against = f" ~ {', '.join(spot.covariates)}" if law.name in SHAPES else ""
    return f"{effect.name}{numbered(number)}{which}{against}"


def joined(parts: list[str]) -> str:
    """Return parts as a sentence lists them: 'a, b and c'."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
