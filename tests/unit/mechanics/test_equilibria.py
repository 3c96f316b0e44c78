"""Many rows solved together, against each of them solved alone; and laws asked about many loads at once."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.every_law import COUNT, KINDS, KNOWN, PAYLOAD, Q, effects, laws_of
from support.small_arms import central_difference, one_joint, random_compliance, standing, three_joints
from support.stage import ROWS, Stage, some_effects
from support.structures import nonlinear

from armflex import Arm, Payload
from armflex.errors import ConvergenceError, SmallDisplacementError, UnstableEquilibriumError
from armflex.laws import PositionDependentLaw, Row
from armflex.laws.effects.catalogue import EVERY
from armflex.laws.effects.in_arm import BoundTwist
from armflex.laws.law import WithoutParameters
from armflex.mechanics.deflection import Deflection
from armflex.mechanics.equilibrium import find_equilibrium
from armflex.mechanics.history import known_rows
from armflex.mechanics.pinocchio_model import LoadCase
from armflex.mechanics.response import respond

NEAR = 1e-11
"""m and rad; of loads relative to the largest."""

FAILURES = (ConvergenceError, SmallDisplacementError, UnstableEquilibriumError)
CARRIED = (Payload(0.0, (0, 0, 0)), Payload(40.0, (0.1, 0.0, 0.05)), Payload(120.0, (0.2, -0.1, 0.0)))


@dataclass(frozen=True)
class Equilibria:
    """An arm solved in N rows: (N, 6 n) twists [m, rad] and wrenches [N, Nm] of its flexures."""

    twists: np.ndarray
    wrenches: np.ndarray


@dataclass(frozen=True)
class Rows:
    """An arm in many rows, as `respond` and `find_equilibrium` are asked about it."""

    arm: Arm
    carried: list[Payload]
    cases: list[LoadCase]
    row: Row

    def together(self) -> Equilibria:
        found = respond(self.arm, self.row.q, self.carried, self.row.covariates)
        return Equilibria(found.flexure_twists, found.flexure_wrenches.reshape(found.flexure_twists.shape))

    def alone(self, i: int, **options: bool) -> Deflection:
        return Deflection(find_equilibrium(self.arm.loaded(self.carried[i]), self.cases[i], **options))

    def stiffening(self, i: int) -> float:
        """Return how far the tangent of a row is from that of a rigid arm."""
        tangent = self.alone(i).tangent
        return float(np.linalg.norm(tangent - np.eye(len(tangent))))


def rows_of(arm: Arm, q: np.ndarray, carried: np.ndarray | None = None, **known: object) -> Rows:
    """Return rows of an arm, each with one of the payloads by its number."""
    carried = np.zeros(len(q), int) if carried is None else carried
    row = Row(q, arm.joint_index, known)
    cases = [LoadCase(position, covariates=row.some(i).covariates) for i, position in enumerate(q)]
    return Rows(arm, [CARRIED[i] for i in carried], cases, row)


def assert_alike(rows: Rows, found: Equilibria) -> None:
    """Every row is what it is alone."""
    expected = [rows.alone(i) for i in range(len(rows.cases))]
    wrenches = np.array([one.wrenches.ravel() for one in expected])
    np.testing.assert_allclose(found.twists, [one.twists.ravel() for one in expected], rtol=0, atol=NEAR)
    np.testing.assert_allclose(found.wrenches, wrenches, rtol=0, atol=NEAR * np.abs(wrenches).max(initial=1.0))


# Arms of every kind of law, in many rows.


@pytest.fixture(scope="module", params=KINDS)
def rows(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Rows:
    arm = three_joints(tmp_path_factory.mktemp("arm"), laws_of(request.param))
    if request.param.startswith("effects"):
        arm = replace(arm, effects=effects())
    return rows_of(arm, Q, PAYLOAD, **KNOWN)


@pytest.fixture(scope="module")
def together(rows: Rows) -> Equilibria:
    return rows.together()


@pytest.mark.slow
def test_many_rows_are_each_row_alone(rows, together):
    assert together.twists.shape == together.wrenches.shape == (COUNT, 6 * len(rows.arm.stack.laws))
    assert np.abs(together.twists).max() > 1e-5
    assert_alike(rows, together)


def test_twists_are_what_the_laws_say_of_the_loads(rows, together):
    for i in range(COUNT):
        parts = together.wrenches[i].reshape(-1, 6)
        expected = [law.twist(load, rows.row.some(i)) for law, load in zip(rows.arm.stack.laws, parts, strict=True)]
        np.testing.assert_allclose(together.twists[i], np.concatenate(expected), rtol=0, atol=2e-12)


@settings(max_examples=25)
@given(order=st.permutations(range(8)), count=st.integers(1, 8))
def test_rows_know_nothing_of_each_other(tmp_path_factory, order, count):
    arm = three_joints(tmp_path_factory.mktemp("arm"), laws_of("position dependent"))
    chosen = np.array(order[:count])
    whole = rows_of(arm, Q[:8], PAYLOAD[:8]).together()
    some = rows_of(arm, Q[chosen], PAYLOAD[chosen]).together()
    np.testing.assert_allclose(some.twists, whole.twists[chosen], rtol=0, atol=1e-14)


# What needs damping, buckles, or has no answer.


def outcome(ask) -> object:
    try:
        return ask()
    except FAILURES as error:
        return type(error)


def outcomes(rows: Rows) -> tuple[set[type], object]:
    """Return the kinds of failure of the rows alone, and what comes of them together."""
    alone = [outcome(lambda i=i: rows.alone(i)) for i in range(len(rows.cases))]
    return {one for one in alone if isinstance(one, type)}, outcome(rows.together)


def test_a_soft_row_that_stays_is_found_all_the_same(tmp_path):
    rows = rows_of(standing(tmp_path, 0.1, -1.0), np.array([[0.0], [0.05], [-0.1]]))
    assert min(rows.stiffening(i) for i in range(3)) > 1.0
    assert_alike(rows, rows.together())


def test_soft_rows_among_stiff_ones(tmp_path):
    """Hanging, but the softer the farther it is turned: where it is soft it stays, but its tangent does not show it."""
    stiff, softer = np.diag([1e-8] * 3 + [1e-6] * 3), np.diag([0.0] * 3 + [1.0] * 3)
    law = PositionDependentLaw("j", np.array([stiff, np.zeros((6, 6)), softer]))
    hung = standing(tmp_path, 0.0, -1.0, 0.0, law)
    level = replace(hung, robot=replace(hung.robot, gravity=9.81 * np.array([-np.sin(0.25), 0.0, -np.cos(0.25)])))
    rows = rows_of(level, np.array([[0.0], [0.25], [0.05], [0.27], [0.1]]))
    stiffening = [rows.stiffening(i) for i in range(5)]
    assert min(stiffening) < 0.1 and max(stiffening) > 1.0
    assert_alike(rows, rows.together())


def test_soft_rows_of_a_structure_alone(tmp_path):
    """Every row turns too far at once."""
    arm = one_joint(tmp_path, nonlinear(), (1, 0.1, 0), mass=1e6)
    rows = rows_of(arm, np.array([[0.2], [0.3]]))
    failures, found = outcomes(rows)
    assert failures == {SmallDisplacementError} and found is SmallDisplacementError


def test_a_buckled_row_is_refused(tmp_path):
    rows = rows_of(standing(tmp_path, 0.1, 1.0), np.array([[0.0], [0.0]]))
    assert outcomes(rows) == ({UnstableEquilibriumError}, UnstableEquilibriumError)
    with pytest.raises(UnstableEquilibriumError, match="buckles"):
        rows.together()


def test_one_row_that_turns_too_far_is_refused(tmp_path):
    rows = rows_of(standing(tmp_path, 8e-3, 0.1, 1.0), np.array([[1.3], [0.0]]))
    assert not isinstance(outcome(lambda: rows.alone(0)), type)
    assert outcomes(rows) == ({SmallDisplacementError}, SmallDisplacementError)


def test_the_flexure_that_turns_too_far_is_named(tmp_path):
    rows = rows_of(standing(tmp_path, 8e-3, 0.1, 1.0), np.array([[1.3], [0.0]]))
    rest = rows.alone(1, allow_large=True).twists
    assert 0.1 < rest[0, 4] < 0.2
    with pytest.raises(SmallDisplacementError, match=r"'j' turns by 0\.1"):
        rows.together()


@dataclass(frozen=True)
class Relay(WithoutParameters):
    """Turns one way or the other, and nothing between, as the moment about y passes a bound."""

    bound: float

    def twist(self, wrench: np.ndarray, row: Row) -> np.ndarray:
        return 1e-3 * np.sign(wrench[..., 4:5] - self.bound) * np.eye(6)[4]

    def tangent(self, wrench: np.ndarray, row: Row) -> np.ndarray:
        return np.zeros((*wrench.shape, 6))


def test_a_row_without_rest_is_refused(tmp_path):
    """Hanging below the joint, the weight comes back as it turns: either side calls for the other."""
    rows = rows_of(standing(tmp_path, 0.0, -0.5, 1.0, Relay(2.0 * 9.81 * 1.0001)), np.array([[0.3], [0.0]]))
    assert not isinstance(outcome(lambda: rows.alone(0)), type)
    assert outcomes(rows) == ({ConvergenceError}, ConvergenceError)


@settings(max_examples=60)
@given(
    softness=st.floats(-4.0, 0.0).map(lambda power: 10.0**power),
    height=st.floats(-1.0, 1.0),
    across=st.floats(-1.0, 1.0),
    turns=st.lists(st.floats(-1.5, 1.5), min_size=1, max_size=4),
)
def test_however_soft_it_fares_as_each_row_alone(tmp_path_factory, softness, height, across, turns):
    arm = standing(tmp_path_factory.mktemp("arm"), softness, height, across)
    rows = rows_of(arm, np.array(turns)[:, None])
    failures, found = outcomes(rows)
    if failures:
        assert found in failures
    else:
        assert_alike(rows, found)


# Nothing gives, or nothing is asked.


def test_an_arm_without_flexures(tmp_path):
    rows = rows_of(replace(standing(tmp_path, 1e-4, 1.0), flexures=()), np.zeros((4, 1)))
    found = rows.together()
    assert found.twists.shape == found.wrenches.shape == (4, 0)
    assert_alike(rows, found)


def test_no_rows(tmp_path):
    found = rows_of(standing(tmp_path, 1e-4, 1.0), np.zeros((0, 1))).together()
    assert found.twists.shape == (0, 6)


# What laws know of rows.


def known(count: int) -> Row:
    columns = {"temperature": 20.0 + np.arange(count), "humidity": 40.0, "zero": np.array(7.0)}
    return Row(np.arange(2.0 * count).reshape(count, 2), {"a": 0, "b": 1}, columns)


@given(count=st.integers(1, 6), data=st.data())
def test_some_rows_are_the_right_ones(count, data):
    row = known(count)
    chosen = np.array(data.draw(st.lists(st.integers(0, count - 1), min_size=1, max_size=5)))
    some = row.some(chosen)
    np.testing.assert_array_equal(some.q, row.q[chosen])
    np.testing.assert_array_equal(some.position("b"), 2.0 * chosen + 1.0)
    np.testing.assert_array_equal(some.covariate("temperature"), 20.0 + chosen)
    assert some.covariate("humidity") == 40.0 and some.covariate("zero") == 7.0
    one = row.some(int(chosen[0]))
    assert one.position("a") == 2.0 * chosen[0] and one.covariate("temperature") == 20.0 + chosen[0]
    assert one.covariate("humidity") == 40.0 and one.q.shape == (2,)


def test_one_row_for_all_is_still_that_row():
    shared = Row(np.array([1.0, 2.0]), {"a": 0, "b": 1}, {"humidity": 40.0})
    for row in (shared.some(3), shared.some(np.array([0, 5])), shared.repeated(4)):
        np.testing.assert_array_equal(row.q, [1.0, 2.0])
        assert row.covariate("humidity") == 40.0


def test_a_row_is_spread_over_many():
    one = Row(np.array([[1.0, 2.0]]), {"a": 0, "b": 1}, {"temperature": np.array([20.0]), "humidity": 40.0})
    spread = one.repeated(3)
    np.testing.assert_array_equal(spread.position("b"), [2.0, 2.0, 2.0])
    np.testing.assert_array_equal(spread.covariate("temperature"), [20.0, 20.0, 20.0])
    assert spread.covariate("humidity") == 40.0
    again = known(3).repeated(3)
    np.testing.assert_array_equal(again.q, known(3).q)
    np.testing.assert_array_equal(again.covariate("temperature"), [20.0, 21.0, 22.0])


def test_a_widened_row_takes_several_loads_each():
    row, law = known(3), PositionDependentLaw("b", np.array([random_compliance(1), random_compliance(2)]))
    loads = np.random.default_rng(1).normal(size=(3, 5, 6))
    wide = row.widened()
    assert wide.position("a").shape == wide.covariate("temperature").shape == (3, 1)
    assert wide.covariate("humidity").shape == (1,)
    found = law.twist(loads, wide)
    for i in range(3):
        expected = [law.twist(load, row.some(i)) for load in loads[i]]
        np.testing.assert_allclose(found[i], expected, rtol=1e-13)
        np.testing.assert_allclose(law.twist(loads[i], row.some(i).widened()), expected, rtol=1e-13)


def test_a_structure_is_asked_about_many_loads(rows):
    loads = 3e3 * np.random.default_rng(2).normal(size=(COUNT, 6 * len(rows.arm.stack.laws)))
    twists, tangents = rows.arm.stack.twists(loads, rows.row), rows.arm.stack.tangent(loads, rows.row)
    for i in range(0, COUNT, 2):
        row = rows.row.some(i)
        np.testing.assert_allclose(twists[i], rows.arm.stack.twists(loads[i], row), rtol=1e-12, atol=1e-18)
        expected = rows.arm.stack.tangent(loads[i], row)
        np.testing.assert_allclose(tangents[i], expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


# The tangents of effects.

LOADED = [name for name, law in EVERY.items() if law.loaded]


@pytest.mark.parametrize("name", LOADED)
def test_tangents_of_many_loads(name, stage: Stage):
    rng, largest = np.random.default_rng(4), 0.0
    effects = some_effects(EVERY[name], stage, 3)
    for effect in effects:
        bound = BoundTwist(effect, stage.context.here(effect.location, stage.setup.arm))
        row = replace(stage.context.row, covariates=known_rows(stage.with_effect(effect).arm, stage.rows))
        usual = np.maximum(np.sqrt((stage.context.wrenches[effect.location.site] ** 2).mean(axis=0)), 1.0)
        wrenches = usual * rng.choice((-1.0, 1.0), (ROWS, 6)) * 10.0 ** rng.uniform(-1.5, 0.3, (ROWS, 6))
        whole = bound.tangent(wrenches, row)
        assert whole.shape == (ROWS, 6, 6)
        largest = max(largest, np.abs(whole).max())
        for i in range(ROWS):
            one, load, most = row.some(i), wrenches[i], np.abs(whole[i]).max()
            np.testing.assert_allclose(bound.tangent(load, one), whole[i], rtol=1e-9, atol=1e-9 * most)
            numeric = central_difference(lambda part, b=bound, r=one, w=load: b.twist(w * part, r), np.ones(6), 1e-5)
            size = max(np.abs(numeric).max(), 1e-6 * np.abs(bound.twist(load, one)).max())
            np.testing.assert_allclose(whole[i] * load, numeric, rtol=0, atol=1e-5 * size + 1e-13)
    # Without a star in sight what lifts off a support does so at an angle, which no load moves.
    assert largest > 0.0 or all(effect.location.covariates for effect in effects)
