"""The catalogue of effects as a page: what each law says of itself, what calibration leaves, and what resembles it.

On the bundled boom and the rows of its campaign, with readings simulated without any effect, every law is given 1 mm of
the tip's motion (RMS) at the place where calibration hides least of it. What calibration cannot absorb is drawn and
offered to all other laws: the share that one of them explains is how far it would be taken for this one.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib
import numpy as np

import armflex
from armflex.laws.effects.candidate import Candidate
from armflex.laws.effects.catalogue import CATALOGUE, NAMED
from armflex.laws.effects.context import Records
from armflex.laws.effects.effect import Afterwards, Amplitude, EffectLaw, Inner
from armflex.laws.effects.location import BASE, LINK, TOOL, Location, drive_axis
from armflex.rows.rows import TIME
from armflex.trace.bank import Bank
from armflex.trace.hypotheses import hypotheses
from armflex.trace.screen import Screen
from armflex.trace.state import begin

matplotlib.use("agg")
import matplotlib.pyplot as plt

NOISE = 2e-4
"""Standard deviation of a simulated reading [m]."""

ALIKE = 0.5
"""Share of what calibration leaves from which another law is listed."""

BLUE = "#2a5d9c"


@dataclass(frozen=True)
class Shown:
    """A law at work on the bundled boom.

    Attributes:
        candidate: Law, place and inner parameters.
        left: Share of its motion of the tip that calibration leaves.
        residual: (M,) that, along the direction in which it is largest [mm].
        column, values: What it is drawn against.
        alike: Other laws at their best places, and the shares that they explain of it.
    """

    candidate: Candidate
    left: float
    residual: np.ndarray
    column: str
    values: np.ndarray
    alike: tuple[tuple[str, float], ...]


def shown() -> tuple[dict[str, Shown], Records]:
    """Return every law of the catalogue at work, and what the campaign records."""
    folder = armflex.bundled_robot("tarm_like")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        arm = armflex.load_arm(folder / "measured.toml")
        rows = armflex.read_measurements(folder / "campaign.csv", arm)
        noise = np.random.default_rng(0).normal(0.0, NOISE, (len(rows), 3))
        clean = replace(
            rows, position=np.where(rows.measured[:, None], armflex.predict(arm, rows).position + noise, 0.0)
        )
        state = begin(armflex.calibrate(arm, clean, as_stated=True, anyway=True))
    fit, context = state.fit, state.context
    known = [one for one in hypotheses(context) if one.one.law.name in CATALOGUE]
    made = Bank(tuple(one.one for one in known), fit, context, quiet=state.quiet)
    screen = Screen(known, made, state.bare)
    whole, inside = np.zeros((2, len(made.candidates)))
    for groups, squares, _ in made.squares():
        whole[groups] = squares.sum(axis=(1, 2))  # all amplitudes alike
    for groups, _, rest, _ in screen.blocks[0].batches:
        scale = np.array([screen.groups[i].scale for i in groups.tolist()])
        amplitude = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0.0)
        inside[groups] = np.einsum("gk,gkl,gl->g", amplitude, rest, amplitude)
    share = np.sqrt(np.clip(inside, 0.0, None) / np.where(whole > 0.0, whole, 1.0))
    names = np.array([candidate.law.name for candidate in made.candidates])
    found = {}
    for name in NAMED:
        some = np.flatnonzero((names == name) & (whole > 0.0))
        if len(some):
            found[name] = _at_work(int(some[share[some].argmax()]), made, screen, fit, context, names)
    return found, context.records


def _at_work(index: int, made, screen, fit, context, names: np.ndarray) -> Shown:
    projection = screen.projection
    candidate = made.candidates[index]
    motion = made.group(index).sum(axis=1)
    scale = fit.view.sigma / np.sqrt(fit.weights)
    left = motion - projection.regressors @ projection.absorbed(motion)
    raw, rest = (each.reshape(scale.shape)[:, :3] * scale[:, :3] for each in (motion, left))
    size = 1.0 / np.sqrt((raw**2).sum(axis=1).mean())
    scores, gains = screen.scores_of(left[:, None])[:, 0], np.zeros(len(made.candidates))
    for groups, places, inside, _ in screen.blocks[0].batches:
        score = scores[places][:, None, :]
        gains[groups] = (score @ np.linalg.pinv(inside, 1e-9, hermitian=True) @ score.transpose(0, 2, 1))[:, 0, 0]
    shares = gains / float(left @ left)
    best = {}
    for other in np.argsort(-shares):
        law, location = names[other], made.candidates[other].location
        if law != candidate.law.name and law not in best and shares[other] >= ALIKE:
            best[law] = (f"`{law}` at {place(location)}", float(min(shares[other], 1.0)))
    residual = size * rest @ np.linalg.svd(rest, full_matrices=False)[2][0]
    column, values = _against(candidate, residual, fit, context)
    return Shown(
        candidate,
        float(np.sqrt((rest**2).sum() / (raw**2).sum())),
        residual,
        column,
        values,
        tuple(best.values())[:5],
    )


def _against(candidate: Candidate, residual: np.ndarray, fit, context) -> tuple[str, np.ndarray]:
    """Return the column that the residual goes with: one that the law names, else whichever orders it best."""
    rows, location = fit.view.rows, candidate.location
    named = [name for name in location.covariates if name != "time"] or list(location.covariates)
    known = {name: np.asarray(context.column(name))[rows] for name in (named or _columns(context))}
    if not named and location.site in context.wrenches:
        load = context.wrenches[location.site][rows]
        for axis, unit, values in zip(
            ("fx", "fy", "fz", "mx", "my", "mz"), 3 * ("kN",) + 3 * ("kNm",), load.T, strict=True
        ):
            known[f"{axis} at {location.place} [{unit}]"] = values * 1e-3
    return max(known.items(), key=lambda item: _ordered(item[1], residual))


def _columns(context) -> list[str]:
    return [f"q_{joint}" for joint in context.robot.joint_names] + ["time"]


def _ordered(column: np.ndarray, residual: np.ndarray) -> float:
    """Return the share of a residual's variance that the means over twelfths of a column explain."""
    if np.ptp(column) == 0.0:
        return 0.0
    place = np.unique(np.argsort(np.argsort(column)) * 12 // len(column), return_inverse=True)[1]
    mean = np.bincount(place, residual) / np.bincount(place)
    return 1.0 - float(((residual - mean[place]) ** 2).mean() / residual.var())


def place(location: Location) -> str:
    """Return a location as people say it."""
    axis = " to ".join(part for part in (location.axis, location.partner) if part)
    return f"{location.place}{f' ({axis})' if axis else ''}"


def draw(one: Shown, file: Path) -> None:
    """Draw what calibration leaves of a law."""
    figure, axes = plt.subplots(figsize=(4.6, 2.1), layout="constrained")
    values, shift = one.values, 0.0
    if len(np.unique(values)) <= 3:  # directions: spread a little, so that points can be told apart
        shift = np.random.default_rng(0).uniform(-0.12, 0.12, len(values))
    axes.plot(values + shift, one.residual, ".", color=BLUE, ms=3, alpha=0.7)
    axes.axhline(0.0, color="0.6", lw=0.6)
    axes.set_xlabel(unit_of(one.column), fontsize=8)
    axes.set_ylabel("left over [mm]", fontsize=8)
    axes.tick_params(labelsize=7)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(file, dpi=130, facecolor="white")
    plt.close(figure)


def unit_of(column: str) -> str:
    """Return a column's label with its unit."""
    if column.startswith("q_"):
        return f"{column} [{'m' if column == 'q_M1' else 'rad'}]"
    return {"time": "time [s]", "hold": "hold [s]", "temperature": "temperature [°C]"}.get(column, column)


def parameter(one: Amplitude | Inner) -> str:
    """Return a parameter's name and unit; of a turning axis where the unit depends on that."""
    unit = one.unit.format(m="rad", w="Nm", across="N or Nm", over="rad or N")
    straight = one.unit.format(m="m", w="N", across="N or Nm", over="rad or N")
    unit = "dimensionless" if unit == "1" else unit if unit == straight else f"{unit}; along a straight axis {straight}"
    bounds = ", not below 0" if getattr(one, "positive", False) and isinstance(one, Amplitude) else ""
    default = f", {one.default:g} where left out" if isinstance(one, Inner) and one.default is not None else ""
    return f"`{one.name}` [{unit}]{bounds}{default}"


def needs(law: EffectLaw, one: Shown | None) -> str:
    """Return the columns that a law needs."""
    columns = (
        []
        if one is None
        else [c.replace(one.candidate.location.place, "<joint>") for c in one.candidate.location.covariates]
    )
    said = ", ".join(f"`{column}`" for column in columns) or "nothing beyond the joint positions"
    if law.memory and not columns:
        said += "; rows in the order driven"
    if law.memory and columns:
        said += ", and `time` for a lag"
    return said


def where(law: EffectLaw, records: Records) -> str:
    """Return the kinds of places that a law has on the bundled boom, with its axes."""
    kinds: dict[str, set[str]] = {}
    drives = {joint.name: drive_axis(joint) for joint in records.robot.moving}
    for location in law.places(records):
        site = location.site
        kind = "a link" if site.startswith(LINK) else {BASE: "the base", TOOL: "the tool"}.get(site, "a joint")
        axis = location.axis or ""
        kinds.setdefault(kind, set()).add("drive" if axis and axis == drives.get(location.place) else axis)
    said = []
    for kind, axes in kinds.items():
        axes = axes - {""}
        text = "" if not axes else " on its drive's axis" if axes == {"drive"} else " on any axis"
        named = sorted(axes - {"drive"})
        text = f" ({', '.join(named)})" if axes and "drive" not in axes and len(named) < 6 else text
        said.append(kind + text)
    return ", ".join(said)


def page(found: dict[str, Shown], records: Records, folder: Path) -> str:
    """Return the page; pictures go into a folder beside it."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = []
    for name in NAMED:
        law, one = CATALOGUE.get(name), found.get(name)
        if law is None:  # a shape with a name of its own
            continue
        lines += [
            f"(effect-{name.replace('_', '-')})=",
            f"## `{name}`",
            "",
            f"**{law.words.title[:1].upper()}{law.words.title[1:]}**: {law.words.meaning}."
            + (f" Here {law.words.signs}." if law.words.signs else ""),
            "",
        ]
        lines += ["| | |", "|---|---|", f"| law | {law.words.formula.replace('|', chr(92) + '|')} |"]
        lines += [f"| acts as | {law.act.value} |", f"| where | {where(law, records)} |"]
        parameters = [*law.amplitudes, *law.inner]
        lines += [f"| parameters | {'<br>'.join(map(parameter, parameters))} |"]
        lines += [f"| needs | {needs(law, one)} |"]
        if law.afterwards is Afterwards.ANEW or any(TIME in one.covariates for one in law.places(records)):
            lines += [f"| on another day | {law.afterwards.value} |"]
        if law.instead:
            tilts = f"; where gravity turns with the joint, {law.level}" if law.level else ""
            lines += [f"| other ways to distinguish it | {law.instead}{tilts} |"]
        if one:
            draw(one, folder / f"{name}.png")
            alike = (
                ", ".join(f"{who} {min(100 * share, 99.9):.3g} %" for who, share in one.alike) or "none of the others"
            )
            lines += [
                f"| confused with | {alike} |",
                f"| of 1 mm at {place(one.candidate.location)} calibration leaves | {one.left:.2g} mm |",
                "",
            ]
            lines += [f"![What calibration leaves of it, over {one.column}](_made/{folder.name}/{name}.png)", ""]
        lines.append("")
    return "\n".join(lines)
