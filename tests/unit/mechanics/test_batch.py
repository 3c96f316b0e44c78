"""Many configurations at once, by compiled code, against each of them alone, which Pinocchio answers."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.arms import bundled, corrected, crooked, networks, positions
from support.every_law import KINDS, KNOWN, effects, laws_of
from support.small_arms import random_compliance, three_joints

from armflex import Arm, Payload, Wrench, ensemble
from armflex.errors import (
    ExtrapolationError,
    JointLimitError,
    MissingCovariateError,
    NotFiniteError,
    ShapeError,
    SmallDisplacementError,
    UnknownNameError,
)
from armflex.estimate.draw import draw_arms
from armflex.laws import LinearLaw
from armflex.mechanics import deflection as batch_module
from armflex.mechanics.deflection import DeflectionBatch

NEAR = 1e-12
"""m and rad; of loads relative to the largest."""


def assert_rows(arm: Arm, q: np.ndarray, found: DeflectionBatch, payloads=None, known=None, **options: object) -> None:
    """Every row of a batch is what is found there alone."""
    known = known or {}
    for i, row in enumerate(q):
        given = {name: values if np.ndim(values) == 0 else values[i] for name, values in known.items()}
        payload = payloads if payloads is None or isinstance(payloads, str) else payloads[i]
        one = arm.deflection(row, payload, covariates=given, **options)
        np.testing.assert_allclose(found.displacement[i], one.displacement, rtol=0, atol=NEAR)
        np.testing.assert_allclose(found.twists[i], one.twists, rtol=0, atol=NEAR)
        most = np.abs(one.wrenches).max(initial=1.0)
        np.testing.assert_allclose(found.wrenches[i], one.wrenches, rtol=0, atol=NEAR * most)
        np.testing.assert_allclose(found.pose[i], one.pose.homogeneous, rtol=0, atol=NEAR)
        np.testing.assert_allclose(found.rigid_pose[i], one.rigid_pose.homogeneous, rtol=0, atol=NEAR)


@pytest.fixture
def no_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    """No row may be left to Pinocchio."""

    def refuse(*_: object) -> None:
        raise AssertionError("a row was asked by itself")

    monkeypatch.setattr(batch_module, "deflect", refuse)


@pytest.mark.parametrize(("name", "payload"), [("tarm_like", "p600"), ("heavy_six", "p200"), ("heavy_six", None)])
def test_the_bundled_arms(name, payload):
    arm = bundled(name)
    q = positions(arm, 7)
    assert_rows(arm, q, arm.deflection(q, payload), payload)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_law_and_effects(tmp_path, no_reference, kind):
    arm, known = three_joints(tmp_path, laws_of(kind)), {}
    if kind.startswith("effects"):
        arm, known = replace(arm, effects=effects()[:-1]), KNOWN
    q = positions(arm, 9)
    found = arm.deflection(q, covariates=known)
    assert_rows(arm, q, found, known=known)
    if known:
        pulled = replace(arm, effects=effects())
        assert_rows(pulled, q, pulled.deflection(q, covariates=known), known=known)


def test_payloads_by_row_come_back_in_their_rows():
    arm, q = bundled("tarm_like"), positions(bundled("tarm_like"), 12)
    payloads = ["p600", None, "none", "p300", "p600", "empty"] * 2
    assert_rows(arm, q, arm.deflection(q, payloads), payloads)


@pytest.mark.parametrize("options", [{"v": 0.1}, {"a": 0.2}, {"wrenches": [Wrench("tool", [50.0, 0, 9], [0, 1, 0])]}])
def test_motion_and_loads_from_outside(options):
    arm, q = bundled("tarm_like"), positions(bundled("tarm_like"), 3)
    given = {key: np.full_like(q, value) if key in "va" else value for key, value in options.items()}
    found = arm.deflection(q, "p300", **given)
    for i in range(3):
        one = arm.deflection(q[i], "p300", **{key: value[i] if key in "va" else value for key, value in given.items()})
        np.testing.assert_allclose(found.displacement[i], one.displacement, rtol=0, atol=NEAR)
        np.testing.assert_allclose(found.row(i).joint_loads, one.joint_loads, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("axes", ["base", "frame"])
def test_loads_from_outside_on_any_link(tmp_path, no_reference, axes):
    """On the base, on a side branch, between two flexures of one joint's link, at the tip, and two at once."""
    law = [LinearLaw(random_compliance(i), relative_std=0.1) for i in range(4)]
    where = {
        "foot": (None, law[0]),
        "end": ("slide", law[1], True),
        "roll": ("roll", law[2]),
        "tip": ("flange", law[3]),
    }
    arm, rng = crooked(tmp_path, where), np.random.default_rng(5)
    q = positions(arm, 5)
    for links in (["base"], ["counterweight"], ["mast"], ["boom"], ["fore", "tool"]):
        wrenches = [Wrench(name, *rng.normal(0.0, 300.0, (2, 3)), axes) for name in links]
        found = arm.deflection(q, wrenches=wrenches)
        assert_rows(arm, q, found, wrenches=wrenches)
        assert_consequences(arm, q, found)
        loop = arm.prepared(wrenches=wrenches)
        for row, expected in zip(q, found.displacement, strict=True):
            np.testing.assert_allclose(loop(row), expected, rtol=0, atol=1e-13)
            np.testing.assert_allclose(loop.wrenches, arm.deflection(row, wrenches=wrenches).wrenches)


def test_the_reference_is_asked_row_by_row():
    arm, q = bundled("heavy_six"), positions(bundled("heavy_six"), 3)
    assert_rows(arm, q, arm.deflection(q, "p100", method="newton"), "p100", method="newton")


def test_what_follows_from_an_equilibrium_is_that_of_the_row():
    arm, q = bundled("tarm_like"), positions(bundled("tarm_like"), 3)
    found = arm.deflection(q, "p600")
    for i in range(3):
        one = arm.deflection(q[i], "p600")
        np.testing.assert_allclose(found.contributions[i], one.contributions, rtol=0, atol=NEAR)
        np.testing.assert_allclose(found.covariance[i], one.covariance, rtol=1e-9, atol=0)
        np.testing.assert_allclose(found.total_jacobian[i], one.total_jacobian, rtol=1e-9, atol=1e-9)
    assert arm.deflection(q[:0]).total_jacobian.shape == (0, 6, len(arm.joint_names))


def assert_consequences(arm: Arm, q: np.ndarray, found: DeflectionBatch, near: float = 1e-9) -> None:
    """Shares and covariances of a batch are those of its rows, which Pinocchio's derivatives give."""
    for i in range(len(q)):
        one = found.row(i)
        np.testing.assert_allclose(found.contributions[i], one.contributions, rtol=0, atol=NEAR)
        if one.covariance is None:
            assert found.covariance is None
            continue
        scale = np.sqrt(np.outer(np.diag(one.covariance), np.diag(one.covariance)))
        np.testing.assert_allclose(found.covariance[i], one.covariance, rtol=0, atol=near * scale.max())


def test_shares_and_covariances_of_a_crooked_arm(tmp_path):
    law = [LinearLaw(random_compliance(i, 2.0), relative_std=0.1) for i in range(6)]
    where = {"tip": ("flange", law[0]), "foot": (None, law[1]), "roll": ("roll", law[2])}
    where |= {"end": ("slide", law[3], True), "seam": ("seam", law[4]), "again": ("roll", law[5])}
    arm, bodies = crooked(tmp_path, where), [Payload(15.0, [0.2, 0.1, 0.0]), None]
    q = positions(arm, 8)
    assert_consequences(arm, q, arm.deflection(q, bodies * 4))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_shares_and_covariances_of_every_kind_of_law(tmp_path, kind):
    arm, known = three_joints(tmp_path, laws_of(kind)), {}
    if kind.startswith("effects"):
        arm, known = replace(arm, effects=effects()[:-1]), KNOWN
    q = positions(arm, 9)
    # The tangents of some effects are differences over steps down to 1e-7 of the load, so they round at 1e-9.
    assert_consequences(arm, q, arm.deflection(q, covariates=known), 1e-7 if known else 1e-9)


def test_shares_and_covariances_where_flexures_turn_far(tmp_path):
    """Rows too soft for the series are asked by themselves."""
    laws = [LinearLaw(random_compliance(i, 150.0), relative_std=0.1) for i in range(3)]
    arm = three_joints(tmp_path, laws)
    q = positions(arm, 12)
    found = arm.deflection(q, allow_large=True)
    assert (np.square(found.twists).sum(axis=(1, 2)) > 0.01).any()
    assert_consequences(arm, q, found)


def test_pieces_in_processes_are_those_in_one(monkeypatch):
    monkeypatch.setattr(batch_module, "PIECE", 5)
    arm, q = bundled("tarm_like"), positions(bundled("tarm_like"), 12)
    payloads = ["p600", "p300", None] * 4
    alone, shared = arm.deflection(q, payloads), arm.deflection(q, payloads, jobs=2)
    np.testing.assert_array_equal(shared.displacement, alone.displacement)
    np.testing.assert_array_equal(shared.wrenches, alone.wrenches)


def test_pieces_in_threads_are_those_in_one(monkeypatch):
    monkeypatch.setattr(batch_module, "PIECE", 5)
    arm, q = bundled("heavy_six"), positions(bundled("heavy_six"), 12)
    alone, shared = arm.deflection(q, "p100"), arm.deflection(q, "p100", jobs=2)
    np.testing.assert_array_equal(shared.displacement, alone.displacement)
    np.testing.assert_array_equal(shared.twists, alone.twists)


def test_a_row_too_soft_for_the_proof_is_asked_alone(tmp_path):
    """Some rows need Newton, others do not; each is what it is alone."""
    arm = three_joints(tmp_path, [random_compliance(i, 150.0) for i in range(3)])
    q = positions(arm, 12)
    assert not arm.loaded(None).stability_bound.proven
    assert_rows(arm, q, arm.deflection(q, allow_large=True), allow_large=True)


def test_rows_beyond_their_limits_when_that_is_allowed():
    arm = bundled("tarm_like")
    q = positions(arm, 4)
    q[2, 0] = arm.robot.upper[0] + 0.5
    found = arm.deflection(q, "p300", enforce_limits=False)
    assert_rows(arm, q, found, "p300", enforce_limits=False)
    assert [flag.text[:6] for flag in found.flags if flag.code == "outside_limits"] == ["row 2:"]
    with pytest.raises(JointLimitError, match=r"row 2: joint 'M1'"):
        arm.deflection(q, "p300")


def test_bad_rows_are_named():
    arm = bundled("tarm_like")
    q = positions(arm, 4)
    q[3, 1] = np.nan
    with pytest.raises(NotFiniteError, match="row 3: q of joint 'A1'"):
        arm.deflection(q)
    with pytest.raises(ShapeError, match="7"):
        arm.deflection(np.zeros((4, 6)))
    with pytest.raises(ShapeError, match="expected one name or 2, got 3"):
        arm.deflection(np.zeros((2, 7)), ["p300"] * 3)
    with pytest.raises(UnknownNameError):
        arm.deflection(np.zeros((2, 7)), ["p300", "p301"])
    with pytest.raises(NotFiniteError, match="row 1: v of joint 'M1'"):
        arm.deflection(np.zeros((2, 7)), v=np.array([[0.0] * 7, [np.inf] + [0.0] * 6]))


def test_a_row_that_turns_too_far_is_named(tmp_path):
    arm = three_joints(tmp_path, [random_compliance(i, 300.0) for i in range(3)])
    with pytest.raises(SmallDisplacementError, match=r"row \d+: flexure"):
        arm.deflection(positions(arm, 5))


def test_covariates_that_are_missing(tmp_path):
    arm = replace(three_joints(tmp_path, laws_of("effects")), effects=effects()[:-1])
    with pytest.raises(MissingCovariateError, match="temperature"):
        arm.deflection(positions(arm, 3), covariates={"humidity": 40.0})


def test_flags_name_the_first_row():
    arm = bundled("tarm_like")
    q = np.zeros((3, 7))
    heavy = Payload(900.0, [0.2, 0.0, 0.0])
    flags = arm.deflection(q, [None, heavy, heavy]).flags
    assert [flag.text[:6] for flag in flags if flag.code == "beyond_rating"] == ["row 1:"]
    expected = {flag.code for i in range(3) for flag in arm.deflection(q[i], [None, heavy, heavy][i]).flags}
    assert {flag.code for flag in flags} == expected


def test_strict_names_a_row_beyond_training(tmp_path):
    arm = networks(tmp_path, 6)
    q = positions(arm, 4)
    alone = [bool(arm.deflection(row).unseen) for row in q]
    assert any(alone)
    found = arm.deflection(q)
    assert found.first_unseen[0] == alone.index(True)
    assert {flag.code for flag in found.flags} == {"extrapolating"}  # one of each flexure
    assert len({flag.about for flag in found.flags}) == len(found.flags)
    with pytest.raises(ExtrapolationError, match=f"row {alone.index(True)}: flexure"):
        arm.deflection(q, strict=True)


@settings(max_examples=25)
@given(
    seed=st.integers(0, 10**6),
    softness=st.floats(0.1, 20.0),
    kind=st.sampled_from(["linear", "networks", "position dependent"]),
    count=st.integers(1, 70),
)
def test_rows_that_fill_the_lanes_and_rows_that_do_not(tmp_path_factory, seed, softness, kind, count):
    """Laws that are the same in all rows and laws that are not."""
    laws = [LinearLaw(random_compliance(seed + i, softness)) for i in range(3)]
    if kind == "position dependent":
        laws[1:] = laws_of("position dependent")[1:]
    folder = tmp_path_factory.mktemp("arm")
    arm = networks(folder, (3, 6)[seed % 2]) if kind == "networks" else three_joints(folder, laws)
    q = positions(arm, count, seed)
    found = arm.deflection(q, allow_large=True)
    some = np.unique([0, count // 2, count - 1])
    for i in some:
        one = arm.deflection(q[i], allow_large=True)
        np.testing.assert_allclose(found.displacement[i], one.displacement, rtol=0, atol=NEAR)
        np.testing.assert_allclose(found.twists[i], one.twists, rtol=0, atol=NEAR)
        most = np.abs(one.wrenches).max()
        np.testing.assert_allclose(found.wrenches[i], one.wrenches, rtol=0, atol=NEAR * most)


def test_an_arm_that_stands_elsewhere_than_its_controller_says():
    arm, q = corrected(bundled("tarm_like")), positions(bundled("tarm_like"), 5)
    assert_rows(arm, q, arm.deflection(q, "p600"), "p600")
    drawn = replace(arm, flexures=tuple(replace(one, law=replace(one.law, relative_std=0.0)) for one in arm.flexures))
    one = drawn.deflection(q, "p600").displacement
    np.testing.assert_allclose(ensemble(drawn, q, "p600", draws=2), [one, one], rtol=0, atol=NEAR)


# Draws.


def test_each_draw_is_the_arm_with_those_laws():
    arm, q = bundled("tarm_like"), positions(bundled("tarm_like"), 3)
    found, rng = ensemble(arm, q, "p300", draws=4, seed=5), np.random.default_rng(5)
    assert found.shape == (4, 3, 6)
    for displacements in found:
        flexures = [replace(flexure, law=flexure.law.draw(rng)) for flexure in arm.flexures]
        one = replace(arm, flexures=tuple(flexures)).deflection(q, "p300")
        np.testing.assert_allclose(displacements, one.displacement, rtol=0, atol=NEAR)


@pytest.mark.slow
def test_draws_spread_as_the_covariance_says():
    arm, q = bundled("tarm_like"), positions(bundled("tarm_like"), 1)[0]
    found = ensemble(arm, q, "p600", draws=1000)
    assert found.shape == (1000, 6)
    # Draws of a variance: its relative error is the root of 2/1000, at 4 of them, and what is not linear in 20 %.
    expected = np.sqrt(np.diag(arm.deflection(q, "p600").covariance))
    np.testing.assert_allclose(found.std(axis=0), expected, rtol=0.5 * 4.0 * np.sqrt(2 / 1000) + 0.03)


def test_the_same_seed_draws_the_same_laws_anywhere():
    arm, q = bundled("heavy_six"), positions(bundled("heavy_six"), 5)
    whole = ensemble(arm, q, draws=3, seed=2)
    np.testing.assert_allclose(ensemble(arm, q[3], draws=3, seed=2), whole[:, 3], rtol=0, atol=NEAR)
    assert np.abs(ensemble(arm, q[3], draws=3, seed=4) - whole[:, 3]).max() > 1e-6


def test_an_arm_that_is_pulled_at_is_drawn_whole(tmp_path):
    arm = replace(three_joints(tmp_path, laws_of("linear")), effects=effects()[-1:])
    softer = tuple(replace(one, law=replace(one.law, relative_std=0.1)) for one in arm.flexures)
    arm, q = replace(arm, flexures=softer), positions(arm, 3)
    expected = [one.deflection(q).displacement for one in draw_arms(arm, 3, seed=1)]
    np.testing.assert_array_equal(ensemble(arm, q, draws=3, seed=1), expected)
    assert np.ptp(expected, axis=0).max() > 1e-9
