"""An arm inside a control loop: the answers and the errors of `deflection`; and the proof that an arm stays."""

import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.arms import bundled, corrected, networks, positions
from support.every_law import KINDS, KNOWN, effects, laws_of
from support.small_arms import random_compliance, three_joints

from armflex import Arm, Payload, Wrench
from armflex.errors import (
    ArrayTypeError,
    ConvergenceError,
    InputError,
    JointLimitError,
    MissingCovariateError,
    NotFiniteError,
    ShapeError,
    SmallDisplacementError,
    UnknownNameError,
    UnstableEquilibriumError,
)
from armflex.laws import LinearLaw, Row
from armflex.laws.effects.catalogue import EVERY
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.in_arm import BoundTwist
from armflex.laws.effects.location import Here, Location
from armflex.laws.joint.hardening import HardeningLaw
from armflex.mechanics import query
from armflex.mechanics.certificate import SHARE, StabilityBound
from armflex.mechanics.mechanism import Mechanism

METHODS = ("exact", "newton")


@pytest.fixture
def no_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing may be left to Pinocchio."""

    def refuse(*_: object) -> None:
        raise AssertionError("the reference was asked")

    monkeypatch.setattr(query, "deflect", refuse)


def assert_alike(arm: Arm, q: np.ndarray, payload=None, method: str = "exact", **known: float) -> None:
    loop = arm.prepared(payload, method=method)
    for row in q:
        found, one = loop(row, **known), arm.deflection(row, payload, method=method, covariates=known)
        np.testing.assert_allclose(found, one.displacement, rtol=0, atol=1e-13)
        np.testing.assert_allclose(loop.twists, one.twists, rtol=0, atol=1e-13)
        most = np.abs(one.wrenches).max(initial=1.0)
        np.testing.assert_allclose(loop.wrenches, one.wrenches, rtol=0, atol=1e-12 * most)
        np.testing.assert_array_equal(loop.q, row)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("name", "payload"), [("tarm_like", "p600"), ("heavy_six", None)])
def test_the_bundled_arms(name, payload, method):
    assert_alike(bundled(name), positions(bundled(name), 5), payload, method)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["tarm_like", "heavy_six"])
def test_an_arm_that_stands_elsewhere_than_its_controller_says(name, method):
    arm = corrected(bundled(name))
    assert_alike(arm, positions(arm, 5), None, method)


@pytest.mark.parametrize("name", ["tarm_like", "heavy_six"])
def test_the_bundled_arms_are_answered_by_compiled_code(name, no_reference):
    for arm in (bundled(name), corrected(bundled(name))):
        for row in positions(arm, 5):
            arm.prepared()(row)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_law_is_answered_by_compiled_code(tmp_path, kind, no_reference):
    """Effects that pull at a link are, too."""
    known = {name: float(np.ravel(values)[0]) for name, values in KNOWN.items()}
    arm = replace(three_joints(tmp_path, laws_of(kind)), effects=effects())
    for row in positions(arm, 3):
        arm.prepared()(row, **known)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_law_and_effects(tmp_path, kind):
    known = {name: float(np.ravel(values)[0]) for name, values in KNOWN.items()}
    arm = three_joints(tmp_path, laws_of(kind))
    for acting in ((), effects()[:-1], effects()):
        assert_alike(replace(arm, effects=acting), positions(arm, 3), **(known if acting else {}))


def test_an_answer_is_the_callers_own():
    loop, (one, other) = bundled("tarm_like").prepared("p300"), positions(bundled("tarm_like"), 2)
    first = loop(one)
    kept = first.copy()
    loop(other)
    np.testing.assert_array_equal(first, kept)


def test_threads_may_share_one():
    """Calls at the same time do not use each other's workspace, which was wrong by most of a metre."""
    arm = bundled("tarm_like")
    loop, q = arm.prepared("p300"), positions(arm, 40)
    alone, before = [loop(row) for row in q], sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(8) as pool:
            shared = list(pool.map(loop, np.tile(q, (50, 1))))
    finally:
        sys.setswitchinterval(before)
    np.testing.assert_array_equal(shared, alone * 50)


def test_lists_whole_numbers_and_strides_will_do():
    arm = bundled("tarm_like")
    loop, q = arm.prepared("p300"), positions(arm, 1)[0]
    np.testing.assert_allclose(loop(q.tolist()), loop(q), rtol=0, atol=1e-15)
    np.testing.assert_allclose(loop(np.repeat(q, 2)[::2]), loop(q), rtol=0, atol=1e-15)
    np.testing.assert_allclose(loop(np.zeros(7, dtype=int)), loop(np.zeros(7)), rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("q", "error"),
    [
        (np.full(7, np.nan), NotFiniteError),
        (np.zeros(6), ShapeError),
        (np.zeros((1, 7)), ShapeError),
        (0.0, ShapeError),
        (np.zeros(7, dtype=complex), ArrayTypeError),
        (["a"] * 7, ArrayTypeError),
        ([0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0], JointLimitError),
        (np.array([0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0]), JointLimitError),
    ],
    ids=str,
)
def test_what_is_wrong_with_q_is_said_and_the_last_answer_stays(q, error):
    loop = bundled("tarm_like").prepared("p300")
    kept = loop(np.zeros(7)).copy(), loop.wrenches
    with pytest.raises(error):
        loop(q)
    np.testing.assert_array_equal(loop.wrenches, kept[1])
    np.testing.assert_array_equal(loop(np.zeros(7)), kept[0])


def test_unknown_names_and_methods_are_refused_at_once():
    with pytest.raises(UnknownNameError, match="p300"):
        bundled("tarm_like").prepared("p30")
    with pytest.raises(InputError, match="did you mean 'newton'"):
        bundled("tarm_like").prepared(method="newtn")


def test_limits_may_be_let_go():
    arm = bundled("tarm_like")
    q = np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0])
    found = arm.prepared("p300", enforce_limits=False)(q)
    np.testing.assert_allclose(found, arm.deflection(q, "p300", enforce_limits=False).displacement, atol=1e-13)


def test_covariates_are_asked_for(tmp_path):
    arm = replace(three_joints(tmp_path, laws_of("linear")), effects=effects()[:-1])
    with pytest.raises(MissingCovariateError, match="temperature"):
        arm.prepared()(np.zeros(3))
    known = {name: float(np.ravel(values)[0]) for name, values in KNOWN.items()}
    with pytest.raises(NotFiniteError, match="humidity"):
        arm.prepared()(np.zeros(3), **(known | {"humidity": np.nan}))


def test_an_arm_that_turns_too_far_or_buckles(tmp_path):
    soft = three_joints(tmp_path, [random_compliance(i, 300.0) for i in range(3)])
    for method in METHODS:
        with pytest.raises((SmallDisplacementError, ConvergenceError, UnstableEquilibriumError)):
            soft.prepared(method=method)(np.zeros(3))


def test_no_answer_depends_on_those_before_it():
    loop, fresh = bundled("tarm_like").prepared("p600"), bundled("tarm_like").prepared("p600")
    one, *others = positions(bundled("tarm_like"), 5)
    for q in others:
        loop(q)
    np.testing.assert_array_equal(loop(one), fresh(one))


@pytest.mark.parametrize("change", [np.asfortranarray, lambda q: q[::-1][::-1], lambda q: q.astype(np.float32)])
def test_positions_however_they_are_kept(change):
    arm = bundled("tarm_like")
    q = change(positions(arm, 1)[0])
    q.flags.writeable = False
    found = arm.deflection(q.astype(float), "p300").displacement
    np.testing.assert_allclose(arm.prepared("p300")(q), found, rtol=0, atol=1e-13)


# The proof.


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    softness=st.floats(0.1, 30.0),
    mass=st.floats(0.0, 200.0),
    seed=st.integers(0, 10**6),
    kind=st.sampled_from(["linear", "position dependent", "network"]),
)
def test_the_bound_holds(tmp_path_factory, softness, mass, seed, kind):
    """Whatever the pose, the tangent's largest eigenvalue less one, and its norm with the bound's own weights."""
    folder, rng = tmp_path_factory.mktemp("arm"), np.random.default_rng(seed)
    laws = [LinearLaw(random_compliance(seed + i, softness)) for i in range(3)]
    if kind == "position dependent":
        laws[1:] = laws_of("position dependent")[1:]
    arm = networks(folder) if kind == "network" else three_joints(folder, laws)
    loaded = arm.loaded(Payload(mass, [0.2, 0.1, -0.1]))
    bound = loaded.stability_bound
    largest = (np.einsum("ipq,iq->ip", bound.compliance_bound, bound.change) / bound.reference).max()
    found = arm.deflection(rng.uniform(-1.5, 1.5, 3), loaded.payload, allow_large=True)
    if np.linalg.norm(found.twists) > 0.1 or not bound.proven:
        return
    change = np.abs(found.tangent - np.eye(18)).reshape(3, 2, 3, 3, 2, 3)
    norms = np.array(
        [
            [[[np.linalg.norm(change[i, p, :, j, r, :], 2) for r in (0, 1)] for j in range(3)] for p in (0, 1)]
            for i in range(3)
        ]
    )
    exact = (np.einsum("ipjq,jq->ip", norms, bound.reference) / bound.reference).max()
    assert np.abs(np.linalg.eigvals(found.tangent - np.eye(18))).max() <= largest * (1 + 1e-9)
    assert exact <= 3.0 * largest  # absolute values of entries may lengthen a 3 x 3 block by up to 3


@settings(max_examples=30)
@given(
    seed=st.integers(0, 10**6),
    size=st.floats(0.0, 3.5).map(lambda power: 10.0**power),
    axes=st.sampled_from([("base", "base"), ("frame", "frame"), ("base", "frame")]),
)
def test_the_bound_holds_under_loads_from_outside(tmp_path_factory, seed, size, axes):
    """It is no less than the tangent's distance from that of a rigid arm."""
    arm = three_joints(tmp_path_factory.mktemp("arm"), [random_compliance(i, 5.0) for i in range(3)])
    rng = np.random.default_rng(seed)
    links = zip(rng.choice(arm.link_names, 2), axes, strict=True)
    wrenches = [Wrench(link, *(size * rng.normal(size=(2, 3))), whose) for link, whose in links]
    weight = arm.loaded(None).stability_bound
    bound = weight.under(wrenches)
    assert (bound.change >= weight.change).all()
    found = arm.deflection(rng.uniform(-1.5, 1.5, 3), wrenches=wrenches, allow_large=True)
    if np.linalg.norm(found.twists) <= 0.1:
        largest = (np.einsum("ipq,iq->ip", bound.compliance_bound, bound.change) / bound.reference).max()
        assert np.abs(np.linalg.eigvals(found.tangent - np.eye(18))).max() <= largest * (1 + 1e-9)


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6), quick=st.floats(-1.0, 1.0).map(lambda power: 10.0**power))
def test_the_bound_holds_while_the_arm_moves(tmp_path_factory, seed, quick):
    """What is proven has a tangent no farther from that of a rigid arm than the share of it that is used."""
    arm = three_joints(tmp_path_factory.mktemp("arm"), [random_compliance(i, 1.0) for i in range(3)])
    rng = np.random.default_rng(seed)
    q, (v, a) = rng.uniform(-1.5, 1.5, 3), quick * rng.normal(size=(2, 3)) * [[1.0], [quick]]
    bound, motion = arm.loaded(None).stability_bound, np.array([v, a])
    force = [Wrench("tool", rng.normal(size=3))]
    assert not bound.under(force).proven_while(motion) or bound.proven_while(motion)
    found = arm.deflection(q, v=v, a=a, method="newton", allow_large=True)
    if bound.proven_while(motion) and np.linalg.norm(found.twists) <= 0.1:
        assert np.abs(np.linalg.eigvals(found.tangent - np.eye(18))).max() <= SHARE


@pytest.mark.parametrize("axes", ["base", "frame"])
def test_a_force_needs_no_tangent_where_the_bound_proves_that_the_arm_stays(axes, monkeypatch):
    arm, force = bundled("tarm_like"), [Wrench("tool", [30.0, -20.0, 10.0], [5.0, 0.0, 0.0], axes)]
    with monkeypatch.context() as patched:
        patched.setattr(Mechanism, "tangent", None)
        found = arm.deflection(np.zeros(7), "p300", wrenches=force)
    assert found.method == "exact"
    newton = arm.deflection(np.zeros(7), "p300", wrenches=force, method="newton")
    np.testing.assert_allclose(found.twists, newton.twists, rtol=0, atol=1e-13)


def test_a_network_is_asked_for_its_tangent_at_the_loads_that_it_carries(tmp_path, monkeypatch):
    """Where its bound proves nothing; at rest, not at the twists."""
    asked, stays = [], StabilityBound.stays
    monkeypatch.setattr(StabilityBound, "stays", lambda *a: asked.append(a[1]) or stays(*a))
    found = networks(tmp_path).deflection(np.array([0.1, 0.2, 0.3]), Payload(2000.0, [0.5, 0.0, 0.0]), allow_large=True)
    assert asked
    np.testing.assert_allclose(asked[0].ravel(), found.wrenches.ravel(), rtol=1e-6)


def test_laws_that_harden_are_not_asked_one_by_one(tmp_path, monkeypatch):
    """Eight of them took `deflection` ten times as long."""
    arm, q = three_joints(tmp_path, laws_of("hardening")), np.array([0.3, -0.4, 0.5])
    newton = arm.deflection(q, method="newton")
    monkeypatch.setattr(HardeningLaw, "twist", None)
    found = arm.deflection(q)
    np.testing.assert_allclose(found.displacement, newton.displacement, rtol=0, atol=1e-13)
    assert found.method == "exact" and "hardening" in KINDS


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("method", METHODS)
def test_what_runs_away_is_refused_and_not_warned_of(tmp_path, method):
    law = LinearLaw(np.diag([1e-8] * 3 + [1e170] * 3))
    arm = three_joints(tmp_path, [law, law, law])
    with pytest.raises((ConvergenceError, SmallDisplacementError, UnstableEquilibriumError)):
        arm.deflection(np.array([0.1, 0.5, 0.2]), method=method)


def test_what_is_not_proven_is_left_to_newton(tmp_path):
    """Hanging, a soft arm stays though the bound cannot tell; it is found all the same."""
    arm = three_joints(tmp_path, [random_compliance(i, 150.0) for i in range(3)])
    assert not arm.loaded(None).stability_bound.proven
    found = arm.deflection(np.array([0.1, 1.5, 0.0]), allow_large=True)
    newton = arm.deflection(np.array([0.1, 1.5, 0.0]), allow_large=True, method="newton")
    np.testing.assert_allclose(found.twists, newton.twists, rtol=0, atol=1e-11)


# What is proportional to the load says so.


PROPORTIONAL = (
    *("compliance", "cross_coupling", "position_dependent_compliance", "thermal_softening", "creep"),
    *("base_compliance", "link_flexure", "cylinder_leak", "unnamed_telescope"),
)


@pytest.mark.slow
@pytest.mark.parametrize("name", PROPORTIONAL)
def test_effects_that_are_linear_are(tmp_path, name):
    arm, law, rng = three_joints(tmp_path, laws_of("position dependent")), EVERY[name], np.random.default_rng(1)
    partner = "out" if name.endswith("telescope") else "ry"
    location = Location("yaw", "rx", ("temperature",), tuple(range(len(law.amplitudes))), partner)
    values = (
        *rng.uniform(1e-8, 1e-7, len(law.amplitudes)),
        *(20.0 if one.name == "reference" else 0.5 for one in law.inner),
    )
    row = Row(
        np.array([0.3, -0.2, 0.4]),
        arm.joint_index,
        {"temperature": np.array(27.0), "hold": np.array(60.0), "temperature_lagged_0.5s": np.array(25.0)},
    )
    bound = BoundTwist(Effect(law, location, values), Here(location, arm.robot, arm.flexures[1].law))
    twist, compliance = bound.affine(row)
    assert bound.proportional and not twist.any() and compliance.any()
    for wrench in 1e3 * rng.normal(size=(4, 6)):
        np.testing.assert_allclose(bound.twist(wrench, row), compliance @ wrench, rtol=1e-12, atol=1e-20)
