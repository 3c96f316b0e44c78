"""The steps of a trace one by one: what is possible at all, what is one effect, and what competes with chance."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.campaigns import draw
from support.stage import few

from armflex import Arm, Measurements, calibrate, load_arm, predict, read_measurements, trace
from armflex.conventions import TWIST_NAMES, Array
from armflex.errors import MissingCovariateError
from armflex.estimate.block import LARGEST_MOTION, amplitude_prior
from armflex.estimate.fit import moved
from armflex.estimate.view import look
from armflex.laws import Row
from armflex.laws.effects import CATALOGUE, Effect, EffectLaw, Location
from armflex.laws.effects.catalogue import EVERY
from armflex.laws.effects.context import Context
from armflex.laws.effects.in_arm import derived_directions
from armflex.laws.effects.location import resolve
from armflex.laws.effects.payload_mass import EACH
from armflex.laws.effects.shapes import told_from_aliases
from armflex.laws.joint.linear import SOFTEST
from armflex.parameters import ParameterKind, of_motions
from armflex.trace.accept import null_maximum, session_folds
from armflex.trace.candidates import Candidate, Sifted, bank, candidates_of, grid, sift
from armflex.trace.findings import write_traced
from armflex.trace.grow import loosened
from armflex.trace.polish import MOST_GIVE, SOFT, Polished, polish, sensible, unusual
from armflex.trace.projection import project
from armflex.trace.search import TIE, preferred
from armflex.trace.state import State, add, begin, context_at, sorted_out, stands, without

HOOK = (0.5, 0.2, 2.5, 0.3, 1.0)
"""m: where a hose is anchored, its length, and how far along the link it is hooked on."""


def candidate_of(state: State, name: str, site: str, axis: str | None, terms: tuple[int, ...] = (0,)) -> Candidate:
    law = CATALOGUE[name]
    location = next(s for s in law.places(state.context.records) if (s.site, s.axis, s.terms) == (site, axis, terms))
    return Candidate(law, location, next(grid(law, location, state.context)))


def is_sensible(state: State, candidate: Candidate, *amplitudes: float) -> bool:
    return sensible(candidate, np.array(amplitudes), state.fit, state.context)


# What the rows do not tell.


@pytest.mark.slow
def test_rows_that_tell_no_direction_leave_with_the_effect_that_asks_for_it(campaign, before):
    rows, j = campaign[2], campaign[1].joint_names.index("J4")
    approach = rows.approach.copy()
    approach[:20, j] = 0.0
    rows = replace(rows, approach=approach, derived=tuple(f"approach_{name}" for name in rows.joint_names))
    calibration = replace(before.calibration, measurements=rows)
    state = replace(before, calibration=calibration, measurements=rows, context=context_at(before.fit, rows))
    law = CATALOGUE["backlash"]
    backlash = next(
        Candidate(law, location, ()) for location in law.places(state.context.records) if location.site == "J4"
    )
    column = bank([backlash], state.fit, state.context).regressors.reshape(len(state.rows), -1)
    np.testing.assert_array_equal(column.any(axis=1), state.rows >= 20)  # what may be either is taken as halfway
    added = add(state, polish(backlash, state.fit, state.context, project(state.fit)))
    left = sorted_out(added)
    assert added.uses(state.rows) and left.uses(state.rows[state.rows >= 20]) and left.untold.sum() == 20
    arm = added.fit.setup.arm
    (flag,) = derived_directions(arm, rows, state.rows)  # the effect says that it was found in such rows
    assert f"{(state.rows < 20).sum()} rows do not determine it" in flag.text
    recorded = replace(arm, effects=tuple(replace(effect, derived=()) for effect in arm.effects))
    with pytest.raises(MissingCovariateError, match="approach_J4"):
        derived_directions(recorded, rows, state.rows)
    assert [flag.code for flag in derived_directions(arm, rows, left.rows)] == ["approach_derived"]
    assert sorted_out(without(left, 0)).uses(state.rows)


def test_an_effect_knows_where_it_was_found(campaign, before):
    def added(name: str, **more: object) -> Effect:
        law = CATALOGUE[name]
        location = next(s for s in law.places(before.context.records) if s.site == "J4")
        candidate = Candidate(law, location, next(grid(law, location, before.context)))
        return add(before, Polished(candidate, 1.0, 1.0, np.full(len(location.terms), 1e-5), ())).fitted[0]

    ((name, low, high),), driven = added("gear_harmonic").seen, campaign[2].q[before.rows, 3]
    assert (name, low, high) == ("q_J4", driven.min(), driven.max())
    assert added("backlash").seen == () and added("slip_step").seen == ()


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
    amplitudes = np.array([-share * lightest])
    setup = before.fit.setup.with_effect(lighter.effect(amplitudes))
    fitted = replace(before.fit, view=look(setup, before.measurements, before.rows))
    assert sensible(lighter, amplitudes, fitted, before.context, present=True) == (share < 1.0)
    assert is_sensible(before, lighter, *amplitudes) == (share < 1.0)


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


def test_a_detail_that_nothing_speaks_for_stays_as_it_usually_is(campaign):
    bare = begin(calibrate(*pulled(campaign, (0.0, 0.0, 0.0)), as_stated=True))
    plain = Candidate(CATALOGUE["umbilical"], Location("link:J5"), (*HOOK, 0.0, 0.0, 0.0))
    assert loosened(add(bare, polish(plain, bare.fit, bare.context, project(bare.fit)))) is None


def test_a_centre_of_mass_stays_within_a_metre(before):
    centre = candidate_of(before, "link_mass", "link:J4", None, (1, 2, 3))
    assert is_sensible(before, centre, 0.1, -0.9, 0.2)
    for place in range(3):
        assert not is_sensible(before, centre, *(1.1 * np.eye(3)[place]))
        assert not is_sensible(before, centre, *(-1.1 * np.eye(3)[place]))


@pytest.mark.parametrize(("axis", "softest"), [("dx", SOFTEST[0]), ("dz", SOFTEST[0]), ("ry", SOFTEST[1])])
def test_hysteresis_is_no_softer_than_a_joint_can_be(before, axis, softest):
    """Under loads so small that no gain makes a large twist of them."""
    line = replace(before.fit.view.line)
    line.__dict__["wrenches"] = 1e-4 * before.fit.view.line.wrenches
    fit = replace(before.fit, view=replace(before.fit.view, line=line))
    loads = {site: 1e-4 * wrenches for site, wrenches in before.context.wrenches.items()}
    state = replace(before, fit=fit, context=replace(before.context, wrenches=loads))
    play = Candidate(CATALOGUE["hysteresis"], Location("J6", axis), (1e-6,))
    for side in (1.0, -1.0):
        assert is_sensible(state, play, side * 0.99 * SOFT * softest)
        assert not is_sensible(state, play, side * 1.01 * SOFT * softest)


def test_a_joint_gives_no_more_against_its_load_than_along_it(before):
    """Friction holds a drive wound up by hundredths of what winds it, not by a turn under the largest load nearby."""
    windup = candidate_of(before, "friction_windup", "J1", "rz", (1,))
    loads = np.linalg.norm(before.context.wrenches["J1"][:, 3:], axis=1)
    for side in (1.0, -1.0):
        assert is_sensible(before, windup, side * 0.01 / loads.max())
        assert not is_sensible(before, windup, side * 0.5 / loads.max())


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


def test_an_axis_that_hardly_any_pose_loads_is_not_taken_for_soft(before):
    """The base bears moments about the vertical that are rounding beside the others, and gives by them as by those."""
    about_z = candidate_of(before, "base_compliance", "base", "rz", (3,))
    loads = before.context.wrenches["base"]
    largest = np.linalg.norm(loads[:, 3:], axis=1).max()
    assert np.abs(loads[:, 5]).max() < 1e-3 * largest
    assert is_sensible(before, about_z, 0.01 / largest) and not is_sensible(before, about_z, 1.0 / largest)


@pytest.mark.parametrize(("site", "axis", "shows"), [("J2", "rz", True), ("J3", "dy", False)])
def test_an_axis_that_poses_load_a_little_may_be_soft_which_counts_against_it(before, site, axis, shows):
    """Four hundredths of the largest moment turn one; the force along the other is there only because the arm bends."""
    loads, place = before.context.wrenches[site], TWIST_NAMES.index(axis)
    largest = np.linalg.norm(loads[:, 3:] if shows else loads[:, :3], axis=1).max()
    assert (np.abs(loads[:, place]).max() > 1e-3 * largest) == shows
    soft, plausible = candidate_of(before, "compliance", site, axis), CATALOGUE["compliance"].plausible
    most = MOST_GIVE * (plausible.turn if shows else plausible.shift) / largest
    assert is_sensible(before, soft, 0.99 * most) and is_sensible(before, soft, 3.0 * most) == shows
    against = [unusual(soft, np.array([share * most]), before.fit.view, before.context) for share in (0.99, 3.0, 30.0)]
    assert against == pytest.approx([0.0, 4.0 * np.log(3.0), 4.0 * np.log(30.0)])


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
    basis = law.basis(resolve(location, before.declared.arm.robot, ()), wrench, Row(np.zeros((4, 0)), {}), ())
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
        assert told_from_aliases(even, slow) and not told_from_aliases(even, fast)
    anyhow = rng.uniform(-1.5, 1.5, 200)
    assert told_from_aliases(anyhow, 2.0 * np.pi * 24.0 / np.ptp(anyhow))
    levels = rng.choice([0.05, 0.19, 0.28, 0.6, 0.94], 440) + rng.normal(0.0, 1e-4, 440)
    assert not any(told_from_aliases(levels, number) for number in (2.0, 16.0, 35.0, 48.0))
    gear, at_stops = CATALOGUE["gear_harmonic"], Location("J2", "ry", ("q_J2",), (0, 1))
    # Few positions of a joint show no harmonic, however many rows there are.
    assert not gear.possible(Effect(gear, at_stops, (1e-3, 0.0, 16.0)), of_positions("J2", levels), None)
    assert gear.possible(Effect(gear, at_stops, (1e-3, 0.0, 16.0)), of_positions("J2", anyhow), None)
    assert len(list(grid(gear, at_stops, of_positions("J2", levels)))) == 0


def of_positions(joint: str, values: Array) -> Context:
    """Return the context of rows of which only a joint's positions are known."""
    row = Row(values[:, None], {joint: 0}, {})
    return Context(None, row, (), (), (), {}, np.zeros((2, 3)))


# What still stands after the refit.


def polished(candidate: Candidate, amplitudes: Array) -> Polished:
    return Polished(candidate, 1.0, 1.0, amplitudes, ())


def free_amplitudes(state: State, candidate: Candidate) -> Array:
    """Return the amplitudes that explain most, possible or not."""
    regressors = bank([candidate], state.fit, state.context).regressors
    return project(state.fit).gain(regressors)[1]


def wanted(state: State, sign: float) -> Candidate:
    """Return the deadband about one axis that the data want most of those they want above, or below, zero."""
    law, projection = CATALOGUE["deadband"], project(state.fit)
    tried = [c for c in candidates_of([law], state.context) if c.location.axis and c.location.axis.startswith("r")]
    gains = [projection.gain(bank([one], state.fit, state.context).regressors) for one in tried]
    return tried[max((gain, i) for i, (gain, amplitudes) in enumerate(gains) if sign * amplitudes[0] > 0.0)[1]]


def test_a_refit_that_turns_a_sign_does_not_stand(before):
    candidate = wanted(before, -1.0)
    amplitudes = free_amplitudes(before, candidate)
    after = add(before, polished(candidate, amplitudes))
    assert amplitudes[0] < 0.0 and after.values_of(after.effects[0])[0] < 0.0
    assert stands(before) and not stands(after)


def test_one_bad_effect_of_two_is_enough(before):
    good = candidate_of(before, "backlash", "J4", "rx")
    after = add(before, polish(good, before.fit, before.context, project(before.fit)))
    assert stands(after)
    candidate = wanted(after, -1.0)
    both = add(after, polished(candidate, free_amplitudes(after, candidate)))
    assert len(both.effects) == 2 and not stands(both)


def test_a_good_effect_stands_until_its_sign_is_turned(before):
    candidate = wanted(before, 1.0)
    after = add(before, polished(candidate, free_amplitudes(before, candidate)))
    values = after.fit.values.copy()
    values[after.fit.places(after.effects[0])] *= -1.0
    assert stands(after) and not stands(replace(after, fit=replace(after.fit, values=values)))


# What is one effect.


def added(state: State, candidate: Candidate) -> State:
    return add(state, polished(candidate, free_amplitudes(state, candidate)))


def test_further_terms_of_a_law_join_it(before):
    first = added(before, candidate_of(before, "stiffening", "J2", "ry", (0,)))
    second = added(first, candidate_of(first, "stiffening", "J2", "ry", (1,)))
    whole = added(before, candidate_of(before, "stiffening", "J2", "ry", (0, 1)))
    assert [block.effect.location.terms for block in first.effects] == [(0,)]
    assert len(second.effects) == 1 and second.effects[0].effect.location.terms == (0, 1)
    assert second.effects[0].labels == ("c2", "c3")
    effects = [state.fit.setup.arm.effects for state in (second, whole)]
    assert len(effects[0]) == 1
    stds = whole.stds_of(whole.effects[0])
    assert (np.abs(second.values_of(second.effects[0]) - whole.values_of(whole.effects[0])) < 0.2 * stds).all()
    np.testing.assert_array_less(np.abs(second.effects[0].start - second.values_of(second.effects[0])), 0.5 * stds)
    assert second.fit.cost(1e9) == pytest.approx(whole.fit.cost(1e9), abs=0.5)


def test_terms_that_both_have_are_added(before):
    first = added(before, candidate_of(before, "stiffening", "J2", "ry", (0,)))
    again = added(first, candidate_of(first, "stiffening", "J2", "ry", (0, 1)))
    assert len(again.effects) == 1 and again.effects[0].effect.location.terms == (0, 1)


def test_a_joined_effect_keeps_its_place(before):
    state = added(before, candidate_of(before, "stiffening", "J2", "ry", (0,)))
    state = added(state, candidate_of(state, "backlash", "J4", "rx"))
    state = added(state, candidate_of(state, "stiffening", "J2", "ry", (1,)))
    found = [(block.effect.law.name, block.effect.location.terms) for block in state.effects]
    assert found == [("stiffening", (0, 1)), ("backlash", (0,))]
    assert [block.ordinal for block in state.effects] == [0, 1]
    gap = state.fit.setup.arm.effects[1].named["gap"]
    assert gap == pytest.approx(float(state.values_of(state.effects[1])[0]))


@pytest.mark.parametrize(("site", "axis"), [("J3", "ry"), ("J2", "rz")])
def test_the_same_law_elsewhere_is_another_effect(before, site, axis):
    state = added(before, candidate_of(before, "stiffening", "J2", "ry", (0,)))
    state = added(state, candidate_of(state, "stiffening", site, axis, (1,)))
    assert [(b.effect.location.site, b.effect.location.axis) for b in state.effects] == [("J2", "ry"), (site, axis)]


def test_laws_with_inner_parameters_stay_two(before):
    """Two waves in one gear: their numbers of teeth are not to be added up."""
    first = candidate_of(before, "gear_harmonic", "J3", "ry", (0, 1))
    other = list(grid(first.law, first.location, before.context))[-1]
    assert other != first.inner
    state = added(before, first)
    state = added(state, replace(first, inner=other))
    assert [block.effect.inner for block in state.effects] == [first.inner, other]
    assert len(state.fit.setup.arm.effects) == 2


# What competes with chance.

NAMES = ("backlash", "stiffening", "encoder_scale", "gear_harmonic", "thermal_growth")


@pytest.fixture(scope="module")
def sifted(before) -> Sifted:
    laws = [CATALOGUE[name] for name in NAMES]
    return sift(bank(candidates_of(laws, before.context), before.fit, before.context), project(before.fit))


def only(state: State, known: Sifted, names: frozenset[str]) -> Sifted:
    """Return what a search of these laws alone would have looked at."""
    kept = [candidate for candidate in known.bank.candidates if candidate.law.name in names]
    return sift(bank(kept, state.fit, state.context), known.projection)


@pytest.mark.parametrize("names", [NAMES[:1], NAMES[1:3], NAMES[3:], NAMES])
def test_the_null_of_some_laws_is_that_of_a_search_of_them_alone(before, sifted, names):
    names = frozenset(names)
    found = null_maximum(sifted, before.groups, names, flips=40)
    alone = null_maximum(only(before, sifted, names), before.groups, flips=40)
    np.testing.assert_allclose(found, alone, rtol=1e-9)


@pytest.mark.slow
@given(names=st.sets(st.sampled_from(NAMES), min_size=1), more=st.sets(st.sampled_from(NAMES)))
def test_the_more_compete_the_higher_chance_gets(sifted, before, names, more):
    few = null_maximum(sifted, before.groups, frozenset(names), flips=20)
    many = null_maximum(sifted, before.groups, frozenset(names | more), flips=20)
    every = null_maximum(sifted, before.groups, flips=20)
    assert (few <= many).all() and (many <= every).all()


def test_the_null_of_all_laws_is_the_largest_of_each(before, sifted):
    each = [null_maximum(sifted, before.groups, frozenset([name]), flips=40) for name in NAMES]
    np.testing.assert_array_equal(np.max(each, axis=0), null_maximum(sifted, before.groups, flips=40))
    assert len(set(np.argmax(each, axis=0).tolist())) > 1


def test_where_no_law_competes_chance_has_nothing(before, sifted):
    assert (null_maximum(sifted, before.groups, frozenset(["slip_step"]), flips=5) == -np.inf).all()


# What is plainer.


def evident(state: State, law: str, site: str, axis: str | None, evidence: float, *amplitudes: float) -> Polished:
    terms = (TWIST_NAMES.index(axis),) if law == "link_geometry" else (0,)
    return Polished(candidate_of(state, law, site, axis, terms), 0.0, evidence, np.array(amplitudes), ())


def test_of_what_the_data_do_not_tell_apart_the_plainest_is_taken(before):
    drawn = evident(before, "encoder_scale", "J3", "ry", 99.0, 1e-3)
    laid = evident(before, "dress_pack", "J3", "ry", 100.0, 500.0)
    assert preferred([laid, drawn]) is drawn
    assert preferred([replace(laid, evidence=99.0 + TIE + 0.1), drawn]).candidate.law.name == "dress_pack"


def test_a_constant_is_plainer_than_a_load(before):
    load = evident(before, "even_in_load", "J2", "rz", 101.0, 1e-7)
    constant = evident(before, "link_geometry", "link:J3", "rz", 100.0, 1e-3)
    assert preferred([load, constant]) is constant


def test_one_law_is_not_taken_where_much_more_of_it_is_needed(before):
    more = evident(before, "link_geometry", "link:J6", "rz", 101.0, -5.5e-3)
    less = evident(before, "link_geometry", "link:J5", "dy", 100.0, -0.47e-3)
    alike = evident(before, "link_geometry", "link:J6", "dy", 100.5, -1.3e-3)
    assert preferred([more, less]) is less
    assert preferred([more, alike, less]) is alike and preferred([alike, less]) is alike


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


# Sessions and columns of text.


def test_a_session_whose_name_begins_with_another_has_its_own_frame():
    fit = SimpleNamespace(parameters=of_motions(ParameterKind.SESSION, ("a", "a b")))
    folds, frames = session_folds(fit, ["a b", "a", "a b"])
    assert folds.tolist() == [0, 1, 0]
    assert [frame.tolist() for frame in frames] == [list(range(6, 12)), list(range(6))]


@pytest.mark.slow
def test_an_entry_of_a_text_column_is_a_suspect(tmp_path):
    """One of three operators, at random poses, stands J4 a little aside."""
    truth = draw("none", 100, "six").write(tmp_path)
    arm = load_arm(truth.arm)
    rows = read_measurements(truth.train, arm)
    rows = few(rows, np.flatnonzero(rows.measured)[::2])
    rng, poses = np.random.default_rng(0), rows.pose_number
    operator = np.array(["ann", "bob", "cy"])[rng.integers(0, 3, poses.max() + 1)][poses]
    aside = rows.q - arm.position(J4=1.5e-3) * (operator == "bob")[:, None]
    found = trace(arm, replace(rows, q=aside, covariates={**rows.covariates, "operator": tuple(operator.tolist())}))
    (only,) = found.found
    location, step = only.effect.location, only.effect.named["step"]
    assert (only.effect.law.name, location.site, location.axis) == ("unnamed_level", "J4", "rx")
    assert location.covariates == ("operator=bob",) and abs(step - 1.5e-3) < 4.0 * only.std["step"]
    again = load_arm(write_traced(truth.arm, found, tmp_path / "traced.toml"))
    asked = replace(rows, q=aside, covariates={**rows.covariates, "operator": ("bob",) * len(rows)})
    np.testing.assert_allclose(predict(again, asked).position, predict(found.arm, asked).position, atol=1e-9)
