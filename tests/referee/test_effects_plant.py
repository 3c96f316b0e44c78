"""With the true machine's parameters and the true effect's, the library reads what an unrelated plant reads."""

from dataclasses import dataclass, replace
from itertools import cycle

import numpy as np
import pinocchio as pin
import pytest
from support.campaigns import KINDS, LAGGED, Drawn, TrueEffect, draw
from support.plant import Array, apply
from support.stage import few, readings
from support.undeclared import Effect as Hidden

from armflex import load_arm, predict, read_measurements
from armflex.arm import Setup
from armflex.laws import LinearLaw
from armflex.laws.effects import Effect, Location
from armflex.laws.effects.catalogue import EVERY
from armflex.measured.measurements import Measurements
from armflex.mechanics.history import known_rows
from armflex.readings.instrument import Instrument
from armflex.robot import Corrections

pytestmark = pytest.mark.slow

EXACT = 1e-9
"""m: two ways to the same equilibrium."""

SHARE = {
    # Errors of the joint's own motion: the plant has them before the flexure's twist, the library in it. They do not
    # commute; the difference is the effect times the twist, some milliradians.
    **dict.fromkeys(("encoder_scale", "encoder_offset", "encoder_eccentricity", "gear_harmonic"), 0.01),
    **dict.fromkeys(("backlash", "friction_windup", "slip_step"), 0.01),
    "hysteresis": 0.02,  # the library's play follows the load as it is without the play's own effect
    "tool_shift": 0.02,  # the plant moves the target, the library the tool with what it carries
}
"""Share of the effect by which the two may differ, 0 where nothing is said."""

AXES = ("dx", "dy", "dz", "rx", "ry", "rz")
REFERENCE = 20.0


@dataclass(frozen=True)
class Case:
    """A drawn campaign, and the library's arm with the true machine's parameters and none of the effects."""

    drawn: Drawn
    told: TrueEffect
    setup: Setup
    rows: Measurements

    @property
    def law(self) -> str:
        return self.told.name

    def number(self, name: str) -> float:
        return float(self.told.parameters[name])

    def moving(self, site: str) -> bool:
        return site in self.setup.arm.joint_names


def case(kind: str, seed: int, arm: str, folder) -> Case:
    drawn = draw(kind, seed, arm)
    truth = drawn.write(folder)
    declared = load_arm(truth.arm)
    rows = read_measurements(truth.train, declared)
    station, plant = drawn.station, drawn.plant
    sessions = {
        f"s{n}": np.concatenate([shift[:3, 3], pin.log3(shift[:3, :3])]) for n, shift in enumerate(drawn.shifts)
    }
    instrument = Instrument(pin.SE3(station[:3, :3], station[:3, 3]), sessions, plant.target)
    flexures = tuple(replace(one, law=LinearLaw(plant.compliance[one.joint])) for one in declared.flexures)
    true = replace(declared, flexures=flexures, corrections=Corrections(joint_offset=dict(plant.offset)))
    if truth.effects[0].name == "base_drift":  # counted from the first row there, from zero here
        rows = replace(rows, time=rows.time - rows.time[0])
    return Case(drawn, truth.effects[0], Setup(true, instrument), rows)


def amplitudes(law: str, location: Location, inner: tuple[float, ...], **values: float) -> Effect:
    """Return an effect by the names of its amplitudes."""
    names = [amplitude.name for amplitude in EVERY[law].amplitudes]
    assert set(values) <= set(names)
    terms = tuple(names.index(name) for name in values)
    whole = tuple(values.get(name, 0.0) for name in names)
    return Effect(EVERY[law], replace(location, terms=terms), whole + inner)


def warm(one: Case) -> tuple[float, float]:
    return REFERENCE, float(one.told.parameters.get("lag", 0.0))


def in_library(one: Case) -> tuple[Effect, ...]:
    """Return the library's effects for a plant's."""
    told, law = one.told, one.law
    on_link = not one.moving(told.site) or law in ("thermal_bending", "link_flexure", "link_geometry")
    site = told.site if told.site in ("base", "tool") else f"link:{told.site}"
    link, joint = Location(site, told.axis), Location(told.site, told.axis)
    n = one.number
    if law in ("base_thermal", "thermal_growth", "thermal_bending"):
        return (_thermal(one, link),)
    if law in ("umbilical", "magnetic_pull", "link_mass", "tip_force", "payload_mass", "payload_com", "gravity_tilt"):
        return (_load(one, link),)
    if law in ("tracker_scale", "session_frame", "tool_shift"):
        return (_instrument(one),)
    if law in ("link_flexure", "link_geometry", "base_compliance", "base_drift"):
        name = {"link_flexure": "C_", "base_compliance": "C_", "base_drift": "v_", "link_geometry": ""}[law]
        location = replace(link, covariates=("time",)) if law == "base_drift" else link
        return (amplitudes(law, location, (), **{name + told.axis: float(next(iter(told.parameters.values())))}),)
    assert not on_link
    offset = Location(told.site, told.axis)
    if law == "encoder_scale":
        return amplitudes(law, joint, (), scale=n("scale")), _offset(offset, -n("scale") * n("q0"))
    if law == "dress_pack":
        index = [flexure.joint for flexure in one.setup.arm.flexures].index(told.site)
        soft = one.setup.arm.flexures[index].law.compliance[AXES.index(told.axis), AXES.index(told.axis)]
        return amplitudes(law, joint, (), k=n("k")), _offset(offset, -n("k") * n("q0") * soft)
    return _at_joint(one, joint)


def _offset(location: Location, value: float) -> Effect:
    return amplitudes("encoder_offset", location, (), offset=value)


def _thermal(one: Case, link: Location) -> Effect:
    location, told = replace(link, covariates=("temperature",)), one.told
    if one.law == "thermal_growth":
        return amplitudes("thermal_growth", replace(location, axis=None), warm(one), alpha=one.number("alpha"))
    if one.law == "thermal_bending":
        return amplitudes("thermal_bending", location, (1.0, *warm(one)), beta=one.number("beta"))
    return amplitudes("base_thermal", location, warm(one), **{f"beta_{told.axis}": one.number("beta")})


def _load(one: Case, link: Location) -> Effect:
    told, n = one.told, one.number
    if one.law == "magnetic_pull":
        inner = (n("magnet_x"), n("magnet_y"), n("magnet_z"), 0.0)
        return amplitudes("magnetic_pull", Location(link.site), inner, F1=n("force_at_1m"))
    if one.law == "tip_force":
        return amplitudes("tip_force", Location("tool"), (), **{name: n(name) for name in ("fx", "fy", "fz")})
    if one.law == "link_mass":
        moved = {f"com_{told.axis[1]}": n("com")} if "com" in told.parameters else {"mass": n("mass")}
        return amplitudes("link_mass", Location(link.site), (), **moved)
    if one.law == "payload_mass":
        share = "mass_at_heaviest" in told.parameters
        location = Location("tool", partner="" if share else "each")
        return amplitudes("payload_mass", location, (), mass=n("mass_at_heaviest" if share else "mass"))
    if one.law == "payload_com":
        return amplitudes("payload_com", Location("tool", told.axis), (), **{told.axis: n(told.axis)})
    return amplitudes("gravity_tilt", Location("base", told.axis), (), **{told.axis: n("tilt")})


def _instrument(one: Case) -> Effect:
    told, n = one.told, one.number
    if one.law == "tracker_scale":
        return amplitudes("tracker_scale", Location("base"), (), **{"lambda": n("ppm")})
    if one.law == "session_frame":
        location = Location("base", partner=str(told.parameters["session"]))
        return amplitudes("session_frame", location, (), **{axis: n(axis) for axis in AXES[:3]})
    first = one.rows.session.index(str(told.parameters["from"]))
    since = -1.0 if first == 0 else float(one.rows.time[first])
    return amplitudes("tool_shift", Location("tool", told.axis), (since,), **{told.axis: n(told.axis)})


def _at_joint(one: Case, joint: Location) -> tuple[Effect, ...]:
    """Return the effects whose parameters have the plant's names."""
    law, p = one.law, one.told.parameters
    if law == "hysteresis":
        count = sum(name.startswith("gain") for name in p)
        pairs = [(float(p[f"gain{i}"]), float(p[f"radius{i}"])) for i in range(1, count + 1)]
        return tuple(amplitudes(law, joint, (radius,), gain=gain) for gain, radius in pairs)
    if law == "cross_coupling":
        return (amplitudes(law, replace(joint, partner=str(p["with"])), (), C=one.number("C")),)
    if law == "even_in_load":
        return (amplitudes(law, joint, (), **{"c_square" if p["of"] == "tau^2" else "c_moment": one.number("c")}),)
    if law == "thermal_softening":
        location = replace(joint, axis=None, covariates=("temperature",))
        return (amplitudes(law, location, warm(one), beta=one.number("beta")),)
    if law == "slip_step":
        return (amplitudes(law, joint, (one.number("time"),), size=one.number("size")),)
    inner = tuple(float(p[parameter.name]) for parameter in EVERY[law].inner)
    outer = {amplitude.name: float(p[amplitude.name]) for amplitude in EVERY[law].amplitudes if amplitude.name in p}
    return (amplitudes(law, joint, inner, **outer),)


def with_effects(setup: Setup, effects: tuple[Effect, ...]) -> Setup:
    for effect in effects:
        setup = setup.with_effect(effect)
    return setup


COMPARABLE = [kind for kind in (*KINDS, *LAGGED) if kind not in ("umbilical", "hysteresis")]
SOME = np.arange(3, 460, 41)
LEAST = 1e-4
"""Largest motion of a reading from which an effect is compared [m]: some of those that machines have move less."""


def moved(drawn: Drawn, hidden: tuple[Hidden, ...]) -> tuple[Array, float]:
    """Return some readings, and by how much the effects move one of them at most."""
    found = drawn.readings(hidden)[SOME]
    return found, float(np.abs(found - drawn.readings(())[SOME]).max())


@pytest.mark.parametrize(("kind", "arm"), list(zip(COMPARABLE, cycle(["boom", "six"]))))
def test_the_library_reads_what_the_plant_reads(kind, arm, tmp_path):
    for seed in range(1, 9):
        one = case(kind, seed, arm, tmp_path)
        expected, effect = moved(one.drawn, one.drawn.effects)
        if effect > LEAST:
            break
    agree(one, with_effects(one.setup, in_library(one)), expected, effect)


def radii(one: Case) -> int:
    return sum(name.startswith("radius") for name in one.told.parameters)


@pytest.mark.parametrize("arm", ["boom", "six"])
def test_play_follows_the_load(arm, tmp_path):
    one = next(c for seed in range(20) if radii(c := case("hysteresis", seed, arm, tmp_path)) == 1)
    compare(one, with_effects(one.setup, in_library(one)), one.drawn.effects)


@pytest.mark.parametrize("arm", ["boom", "six"])
def test_several_plays_at_one_place_add_up(arm, tmp_path):
    one = next(c for seed in range(20) if radii(c := case("hysteresis", seed, arm, tmp_path)) > 1)
    compare(one, with_effects(one.setup, in_library(one)), one.drawn.effects)


def compare(one: Case, setup: Setup, hidden: tuple[Hidden, ...]) -> None:
    agree(one, setup, *moved(one.drawn, hidden))


def agree(one: Case, setup: Setup, expected: Array, effect: float) -> None:
    with_memory = known_rows(setup.arm, one.rows)
    rows = few(one.rows, SOME)
    covariates = {name: values[SOME] for name, values in with_memory.items() if "lagged" in name or "play" in name}
    found = readings(setup, replace(rows, covariates={**rows.covariates, **covariates}))
    assert effect > LEAST
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=EXACT + SHARE.get(one.law, 0.0) * effect)


def test_without_effects_the_two_agree(tmp_path):
    one = case("backlash", 4, "boom", tmp_path)
    np.testing.assert_allclose(
        readings(one.setup, few(one.rows, SOME)), one.drawn.readings(())[SOME], rtol=0.0, atol=EXACT
    )


@pytest.mark.parametrize(("arm", "end"), [("boom", 2), ("six", 4), ("boom", 10)])
def test_a_spring_at_the_end_of_a_link(arm, end, tmp_path):
    """The plant's own umbilical hooks anywhere on a link; this one beside its end, where the library has it."""
    one = case("backlash", 2, arm, tmp_path)
    joints = one.drawn.plant.joints
    end, k, rest = min(end, len(joints)), 400.0, 0.8
    anchor, aside = np.array([2.5, -1.5, 1.0]), np.array([0.1, -0.05, 0.2])
    origin = joints[end].origin if end < len(joints) else one.drawn.plant.tip
    site = f"link:{joints[end].name}" if end < len(joints) else "tool"

    def act(state, push, amplitude: float) -> None:
        point = apply(state.frames[:, end - 1], origin[:3, 3] + aside)
        line = anchor - point
        length = np.linalg.norm(line, axis=1, keepdims=True)
        push.loads.append((end - 1, amplitude * line * np.maximum(1.0 - rest / length, 0.0), point))

    hidden = Hidden("umbilical", site, None, (), act, lambda x: {"k": x}, 1.0, k, amplitude=k)
    effect = amplitudes("umbilical", Location(site), (*anchor.tolist(), rest, 1.0, *aside.tolist()), k=k)
    compare(replace(one, told=replace(one.told, name="umbilical")), with_effects(one.setup, (effect,)), (hidden,))


@pytest.mark.parametrize("kind", ["thermal_growth lagged", "creep", "backlash"])
def test_predictions_of_a_whole_campaign(kind, tmp_path):
    one = case(kind, 3, "six", tmp_path)
    setup = with_effects(one.setup, in_library(one))
    found = predict(replace(setup.arm, instrument=setup.instrument), one.rows).position
    allowed = EXACT + SHARE.get(one.law, 0.0) * one.told.raw_rms
    np.testing.assert_allclose(found, one.drawn.readings(), rtol=0.0, atol=allowed)


def test_lags_of_two_effects_at_one_place_are_their_own(tmp_path):
    """A link that grows with one lag and the joint at its end that softens with another."""
    one = case("backlash", 2, "six", tmp_path)
    link, joint = Location("link:J3", None, ("temperature",)), Location("J3", None, ("temperature",))
    growing = amplitudes("thermal_growth", link, (REFERENCE, 9000.0), alpha=3e-5)
    softening = amplitudes("thermal_softening", joint, (REFERENCE, 900.0), beta=0.03)
    base, rows = readings(one.setup, one.rows), one.rows
    apart = [readings(with_effects(one.setup, (effect,)), rows) - base for effect in (growing, softening)]
    together = readings(with_effects(one.setup, (growing, softening)), rows) - base
    assert np.abs(apart[0]).max() > 1e-4 < np.abs(apart[1]).max()
    np.testing.assert_allclose(together, sum(apart), atol=2e-6)
