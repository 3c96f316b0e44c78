"""The steps of a trace one by one: what is possible at all, what is one effect, and what competes with chance."""

from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support import six_axes

from armflex import Arm, Measurements, predict, trace
from armflex.conventions import Array
from armflex.estimate.block import amplitude_prior
from armflex.estimate.fit import moved
from armflex.estimate.held_out import folds_of
from armflex.estimate.view import LARGEST_MOTION
from armflex.laws import Row
from armflex.laws.effects import CATALOGUE, Effect, EffectLaw, Location
from armflex.laws.effects.candidate import Candidate, grid
from armflex.laws.effects.catalogue import EVERY
from armflex.laws.effects.context import Context
from armflex.laws.effects.location import resolve
from armflex.laws.effects.payload_mass import EACH
from armflex.laws.effects.possible import MOST_GIVE, SOFTER, sensible, size_prior, unusual
from armflex.laws.effects.shapes import free_of_aliases
from armflex.laws.joint.linear import SOFTEST
from armflex.parameters import ParameterKind, of_motions
from armflex.trace.selection import SCALES
from armflex.trace.state import State

HOOK = (0.5, 0.2, 2.5, 0.3, 1.0)
"""m: where a hose is anchored, its length, and how far along the link it is hooked on."""


def candidate_of(state: State, name: str, site: str, axis: str | None, terms: tuple[int, ...] = (0,)) -> Candidate:
    law = CATALOGUE[name]
    location = next(s for s in law.places(state.context.records) if (s.site, s.axis, s.terms) == (site, axis, terms))
    return Candidate(law, location, next(grid(law, location, state.context)))


def is_sensible(state: State, candidate: Candidate, *amplitudes: float) -> bool:
    return sensible(candidate.effect(np.array(amplitudes)), state.fit.view, state.context, state.declared.arm)


def against_it(state: State, candidate: Candidate, amplitude: float) -> float:
    return unusual(candidate.effect(np.array([amplitude])), state.fit.view, state.context)


# What the rows do not tell.


# What is possible.


@pytest.mark.parametrize("lag", [0.0, 3000.0])
def test_a_joint_does_not_double_its_give_with_ten_degrees(before, lag):
    soft = candidate_of(before, "thermal_softening", "J2", "ry")
    soft = replace(soft, inner=(soft.inner[0], lag))
    assert is_sensible(before, soft, 0.01) and is_sensible(before, soft, -0.09)
    assert not is_sensible(before, soft, 0.11) and not is_sensible(before, soft, -46.7)


def masses(state: State) -> tuple[float, float]:
    """Return the declared masses of the link before J4 and of all that moves."""
    robot = state.declared.arm.robot
    moved = {joint.child for joint in robot.chain}
    every = {name: link.inertial.mass for name, link in robot.urdf.links.items() if link.inertial and name in moved}
    joint = next(joint for joint in robot.chain if joint.name == "J4")
    return every[joint.parent], sum(every.values())


def test_a_link_keeps_a_mass_and_weighs_no_more_than_the_arm(before):
    own, whole = masses(before)
    mass = candidate_of(before, "link_mass", "link:J4", None)
    assert 1.0 < own < whole < 40_000.0
    for possible in (-0.99 * own, -1.0, 1e-3, 5.0, 0.99 * whole):
        assert is_sensible(before, mass, possible), possible
    for impossible in (-1.01 * own, -40_000.0, 1.01 * whole, 40_000.0):
        assert not is_sensible(before, mass, impossible), impossible


@pytest.mark.parametrize("share", [0.6, 0.99, 1.01])
def test_a_payload_found_lighter_weighs_what_is_left_of_it_just_once(before, share):
    lightest = min(one.mass for one in before.declared.arm.payloads.values() if one.mass > 0.0)
    places = CATALOGUE["payload_mass"].places(before.context.records)
    lighter = Candidate(CATALOGUE["payload_mass"], next(one for one in places if one.partner == EACH), ())
    assert is_sensible(before, lighter, -share * lightest) == (share < 1.0)


def pulled(campaign, aside: tuple[float, float, float]) -> tuple[Arm, Measurements]:
    """Return an arm and what a campaign reads of it where a hose pulls beside the end of a link."""
    _, arm, rows = campaign
    hose = Effect(CATALOGUE["umbilical"], Location("link:J5"), (900.0, *HOOK, *aside))
    read = predict(replace(arm, effects=(hose,)), rows).position
    noise = np.random.default_rng(0).normal(0.0, 2e-4, read.shape)
    return arm, replace(rows, position=read + noise)


@pytest.mark.slow
def test_where_a_link_is_pulled_beside_its_end_is_a_detail_of_one_cause(campaign):
    aside = (0.1, -0.15, 0.2)
    (one,) = trace(*pulled(campaign, aside)).found
    assert one.effect.law.name == "umbilical" and one.effect.location.site == "link:J5"
    names = ("aside_x", "aside_y", "aside_z")
    std = np.array([one.std[name] for name in names])
    assert (np.abs([one.effect.named[name] for name in names] - np.array(aside)) < 3.0 * std).all()
    assert np.median(std) < 0.1


def test_a_centre_of_mass_stays_within_a_metre(before):
    centre = candidate_of(before, "link_mass", "link:J4", None, (1, 2, 3))
    assert is_sensible(before, centre, 0.1, -0.9, 0.2)
    for place in range(3):
        assert not is_sensible(before, centre, *(1.1 * np.eye(3)[place]))
        assert not is_sensible(before, centre, *(-1.1 * np.eye(3)[place]))


@pytest.mark.parametrize(("axis", "softest"), [("dx", SOFTEST[0]), ("dz", SOFTEST[0]), ("ry", SOFTEST[1])])
def test_hysteresis_is_no_softer_than_a_joint_can_be(before, axis, softest):
    """Under loads so small that no gain makes a large twist of them; one below zero would make energy."""
    line = before.fit.view.line
    line = replace(line, _kept={"wrenches": 1e-4 * line.wrenches})
    fit = replace(before.fit, view=replace(before.fit.view, line=line))
    loads = {site: 1e-4 * wrenches for site, wrenches in before.context.wrenches.items()}
    state = replace(before, fit=fit, context=replace(before.context, wrenches=loads))
    play = Candidate(CATALOGUE["hysteresis"], Location("J6", axis), (1e-6,))
    assert is_sensible(state, play, 0.99 * SOFTER * softest)
    assert not is_sensible(state, play, 1.01 * SOFTER * softest) and not is_sensible(state, play, -1e-12)


def test_an_effect_that_would_be_a_turn_under_the_largest_load_counts_against_it(before):
    """Friction holds a drive wound up by hundredths of what winds it; hysteresis follows its load as a compliance."""
    largest = np.linalg.norm(before.context.wrenches["J1"][:, 3:], axis=1).max()
    windup = candidate_of(before, "friction_windup", "J1", "rz", (1,))
    play = Candidate(CATALOGUE["hysteresis"], Location("J1", "rz"), (1e-6,))
    for one in (windup, play):
        assert against_it(before, one, 0.01 / largest) < 1.0
        turn = 0.5 / largest / MOST_GIVE / one.law.plausible.turn
        assert against_it(before, one, 0.5 / largest) >= (0.99 * turn * largest) ** 2 > 100.0


def test_how_large_an_effect_may_be_goes_by_the_size_of_the_arm(before):
    view, play = before.fit.view, candidate_of(before, "backlash", "J3", "ry").effect(np.array([1e-3]))
    reach = np.linalg.norm(view.line.tip[:, :3, 3], axis=1).max()
    (prior,) = amplitude_prior(play, (), view, before.context)
    moved = view.rms(view.effect_jacobian(play, before.context)[:, :, 0])
    assert prior * moved == pytest.approx(LARGEST_MOTION * reach)


def test_a_force_that_is_always_down_is_a_mass(before):
    places = CATALOGUE["tip_force"].places(before.context.records)
    assert [one.axis for one in places] == ["dx", "dy", None]


def test_what_is_positive_by_nature_is_not_negative(before):
    deadband = candidate_of(before, "deadband", "J2", "ry")
    assert is_sensible(before, deadband, 1e-5) and not is_sensible(before, deadband, -1e-5)


@pytest.mark.parametrize(
    ("name", "site", "axis", "terms", "possible", "impossible"),
    [
        ("tracker_scale", "base", None, (0,), 200.0, 2000.0),  # ppm
        ("encoder_eccentricity", "J3", "ry", (0, 1), 3e-3, 3e-2),
        ("gear_harmonic", "J3", "ry", (0, 1), 3e-3, 1.5e-2),
        ("backlash", "J3", "ry", (0,), 5e-3, 3e-2),
        ("tip_force", "tool", "dx", (0,), 300.0, 3e4),
    ],
)
def test_sizes_that_no_machine_has_are_not_believed(before, name, site, axis, terms, possible, impossible):
    candidate, ones = candidate_of(before, name, site, axis, terms), np.ones(len(terms))
    assert is_sensible(before, candidate, *(possible * ones)) and not is_sensible(
        before, candidate, *(impossible * ones)
    )


@pytest.mark.parametrize(("site", "axis"), [("J2", "rz"), ("J3", "dy"), ("base", "rz")])
def test_an_axis_that_poses_load_a_little_may_be_soft_which_counts_against_it(before, site, axis):
    """As if the largest load on its joint were along it: the base bears hardly a moment about the vertical."""
    largest = np.linalg.norm(before.context.wrenches[site].reshape(-1, 2, 3), axis=2).max(axis=0)[int(axis[0] == "r")]
    law = CATALOGUE["base_compliance" if site == "base" else "compliance"]
    soft = candidate_of(before, law.name, site, axis, (3,) if site == "base" else (0,))
    most = MOST_GIVE * (law.plausible.turn if axis[0] == "r" else law.plausible.shift) / largest
    against = [against_it(before, soft, share * most) for share in (0.99, 3.0, 30.0)]
    assert against == pytest.approx([0.99**2, 3.0**2, 30.0**2])


def test_a_hose_that_pulls_more_than_hoses_do_counts_against_a_dress_pack(before):
    pack = candidate_of(before, "dress_pack", "J2", "ry")
    usual, large = (against_it(before, pack, k) for k in (150.0, 2000.0))
    assert usual < 1.0 and large == pytest.approx(10.0**2)


def test_scales_are_as_likely_as_machines_have_the_sizes(before):
    pack = candidate_of(before, "dress_pack", "J2", "ry")

    def prior(k: float) -> np.ndarray:
        return size_prior((pack.effect(np.array([k])),), SCALES, before.fit.view, before.context)

    np.testing.assert_allclose(prior(1e-6), 1.0 / len(SCALES), rtol=1e-6)
    some = prior(200.0)  # a millimetre is what hoses may do
    np.testing.assert_allclose(some / some[2], 2.0 / (1.0 + SCALES**2))
    assert some.sum() == pytest.approx(1.0) and prior(2000.0).sum() < 0.6 and prior(2e6).max() < 1e-6


def test_of_two_laws_of_one_column_one_that_is_larger_than_machines_have_it_is_less_likely(before):
    """Where both have usual sizes they are as likely as the likelier alone."""
    pack, scale = (candidate_of(before, name, "J2", "ry") for name in ("dress_pack", "encoder_scale"))

    def priors(k: float) -> tuple[np.ndarray, ...]:
        effects = pack.effect(np.array([k])), scale.effect(np.array([1e-6]))
        some = (effects, effects[::-1], effects[1:])
        return tuple(size_prior(one, np.ones(1) * [1.0, 3.0], before.fit.view, before.context) for one in some)

    hose, beside_it, alone = priors(20.0)
    np.testing.assert_allclose(hose, alone, rtol=1e-6)
    np.testing.assert_allclose(beside_it, alone, rtol=1e-6)
    hose, beside_it, alone = priors(4000.0)
    np.testing.assert_allclose(beside_it, alone, rtol=1e-6)
    np.testing.assert_allclose(hose / alone, 2.0 / (1.0 + np.array([20.0, 60.0]) ** 2), rtol=1e-3)


def test_friction_grows_with_the_load(before):
    friction = candidate_of(before, "friction_windup", "J2", "ry", (0, 1))
    assert is_sensible(before, friction, 1e-4, 1e-9) and is_sensible(before, friction, -1e-4, -1e-9)
    assert not is_sensible(before, friction, 1e-4, -1e-9)


def test_a_force_is_compared_with_that_of_a_person_where_an_arm_has_no_weight(before, monkeypatch):
    monkeypatch.setattr(Arm, "weight", property(lambda arm: 0.0))
    force = candidate_of(before, "tip_force", "tool", "dx")
    with np.errstate(all="raise"):
        against = [against_it(before, force, f) for f in (0.0, 5.0, 500.0)]
    assert against[0] == 0.0 < against[1] < 1.0 < against[2]


@pytest.mark.parametrize("name", ["base_compliance", "link_flexure"])
def test_a_compliance_about_several_axes_is_symmetric_and_positive(before, name):
    law = CATALOGUE[name]
    location = next(
        one
        for one in law.places(before.context.records)
        if {law.amplitudes[i].name for i in one.terms} == {"C_rx", "C_ry", "C_rx_ry"}
    )
    candidate = Candidate(law, location, ())
    wrench = np.random.default_rng(0).normal(size=(4, 6))
    basis = law.twists(resolve(location, before.declared.arm.robot, ()), wrench, Row(np.zeros((4, 0)), {}), ())
    matrix = np.array([[8.2e-9, 5.8e-9], [5.8e-9, 5.4e-9]])  # of a machine on tracks, a thousandth
    given = np.einsum("nka,k->na", basis[:, list(location.terms)], [matrix[0, 0], matrix[1, 1], matrix[0, 1]])
    np.testing.assert_allclose(given[:, 3:5], wrench[:, 3:5] @ matrix, rtol=1e-12)
    assert not given[:, [0, 1, 2, 5]].any()
    assert is_sensible(before, candidate, 8.2e-9, 5.4e-9, 5.8e-9)
    assert not is_sensible(before, candidate, 8.2e-9, 5.4e-9, 6.8e-9)  # it would make energy
    assert not is_sensible(before, candidate, 8.2e-9, 5.4e-9, -6.8e-9)


def test_nothing_is_pulled_towards_a_point_far_from_the_arm(before):
    (low, high), magnet = before.context.box, candidate_of(before, "magnetic_pull", "tool", None)
    for up, believed in ((0.1, True), (1.0, False)):
        point = (0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), high[2] + up * before.context.size)
        assert is_sensible(before, replace(magnet, inner=(*point, 0.0)), 10.0) is believed


def test_no_hose_is_anchored_far_from_the_arm(before):
    """A spring to a point 50 m off is a force of constant direction, which is another law."""
    (low, high), hose = before.context.box, candidate_of(before, "umbilical", "tool", None)
    for up, believed in ((1.0, True), (50.0, False)):
        anchor = (0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), high[2] + up * before.context.size)
        assert is_sensible(before, replace(hose, inner=(*anchor, *hose.inner[3:])), 0.1) is believed


def test_every_law_says_how_large_it_is_on_machines_and_why():
    reasons = [law.plausible.why for law in EVERY.values()]
    assert all(law.plausible.shift > 0.0 and law.plausible.turn > 0.0 for law in EVERY.values())
    default = EffectLaw.__dataclass_fields__["plausible"].default.why
    assert all(reasons) and default not in reasons


def test_a_wave_is_told_from_those_that_give_the_same_at_the_poses_at_hand():
    rng = np.random.default_rng(0)
    even = np.linspace(0.0, 2.0, 33)  # 16 periods at most
    for slow in (10.0, 30.0):
        fast = 2.0 * np.pi / even[1] - slow
        np.testing.assert_allclose(np.cos(fast * even), np.cos(slow * even), atol=1e-9)
        assert free_of_aliases(even, slow) and not free_of_aliases(even, fast)
    anyhow = rng.uniform(-1.5, 1.5, 200)
    assert free_of_aliases(anyhow, 2.0 * np.pi * 24.0 / np.ptp(anyhow))
    levels = rng.choice([0.05, 0.19, 0.28, 0.6, 0.94], 440) + rng.normal(0.0, 1e-4, 440)
    assert not any(free_of_aliases(levels, number) for number in (2.0, 16.0, 35.0, 48.0))
    gear, at_stops = CATALOGUE["gear_harmonic"], Location("J2", "ry", ("q_J2",), (0, 1))
    # Few positions of a joint show no harmonic, however many rows there are.
    assert not gear.possible(Effect(gear, at_stops, (1e-3, 0.0, 16.0)), of_positions("J2", levels), None)
    assert gear.possible(Effect(gear, at_stops, (1e-3, 0.0, 16.0)), of_positions("J2", anyhow), None)
    assert len(list(grid(gear, at_stops, of_positions("J2", levels)))) == 0


def of_positions(joint: str, values: Array) -> Context:
    """Return the context of rows of which only a joint's positions are known."""
    row = Row(values[:, None], {joint: 0}, {})
    return Context(None, row, (), (), (), {}, np.zeros((2, 3)))


# How a fit moves.


def test_a_factor_moves_in_a_straight_line_and_never_below_nothing(before):
    blocks = before.blocks
    logs = np.array([block.name == "compliance" for block in blocks for _ in block.labels])
    assert 0 < logs.sum() < len(logs)
    steps = np.random.default_rng(0).normal(0.0, 3.0, len(logs))
    values = np.random.default_rng(1).normal(0.0, 0.3, len(logs))
    after = moved(blocks, values, steps)
    np.testing.assert_allclose(after[~logs], (values + steps)[~logs])
    factor = np.exp(after - values)[logs]
    np.testing.assert_allclose(factor, np.where(steps > 0.0, 1.0 + steps, 1.0 / (1.0 - steps))[logs])
    small = moved(blocks, values, 1e-6 * steps) - values
    np.testing.assert_allclose(small, 1e-6 * steps, rtol=1e-4)


# Sessions.


def test_a_session_whose_name_begins_with_another_has_its_own_frame():
    setup = SimpleNamespace(instrument=SimpleNamespace(campaigns=()))
    fit = SimpleNamespace(parameters=of_motions(ParameterKind.SESSION, ("a", "a b")), setup=setup)
    folds, frames = folds_of(fit, ["a b", "a", "a b"])
    assert folds.tolist() == [0, 1, 0]
    assert [frame.tolist() for frame in frames] == [list(range(6, 12)), list(range(6))]


def test_a_drive_whose_angle_is_no_tilt_has_no_stop(before):
    """Of six axes the second alone: the first stands upright, and what is outboard of the second is tilted by it."""
    places = CATALOGUE["support_lift"].places(before.context.records)
    assert {location.site for location in places} == {"J2"}


@pytest.mark.slow
def test_a_play_whose_radius_is_nothing_takes_nothing_from_a_compliance():
    joint = "shoulder_lift_joint"
    soft = Candidate(CATALOGUE["compliance"], Location(joint, "ry", terms=(0,)), ()).effect(np.array([4e-5]))
    wrist, own = "wrist_2_joint", ("q_wrist_2_joint",)
    eccentric = Candidate(CATALOGUE["encoder_eccentricity"], Location(wrist, "rz", own, (0, 1)), ())
    arm, rows = six_axes.campaign(100, 1, [soft, eccentric.effect(np.array([2.3e-3, 1.9e-3]))])
    traced = trace(arm, rows)
    chances = Counter[str]()
    for effect, chance in traced.suspects:
        chances[effect.law.name] += chance
    assert chances["compliance"] > 0.3 and chances["hysteresis"] < 0.1
