"""The engine against Pinocchio on arms drawn at random, and what its tables and its build refuse."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from support.arms import bundled, crooked, networks, positions
from support.linearised import linearised_rows
from support.machines import MACHINES, poses
from support.small_arms import random_compliance, three_joints
from support.sprung_arm import BALANCER, STRUT, TIE, sprung

from armflex import Arm, Payload, Wrench
from armflex.conventions import Array
from armflex.errors import InputError
from armflex.laws import LinearLaw
from armflex.laws.joint.hardening import HardeningLaw
from armflex.laws.law import WithoutParameters
from armflex.laws.row import MASS
from armflex.laws.terms import Curve, Factor, Of, Term, Terms, part, power, straight, table
from armflex.mechanics.engine import binding, build
from armflex.mechanics.engine.tables import Laws, Tables, Tree
from armflex.mechanics.response import respond


@dataclass(frozen=True)
class EveryTerm(WithoutParameters):
    """A law with every kind of feature and of factor, each a small part of a compliance."""

    compliance: Array
    joint: str
    seed: int

    def terms(self) -> Terms:
        rng, q = np.random.default_rng(self.seed), f"q_{self.joint}"
        way = rng.normal(size=6) / np.repeat([3e3, 1e3], 3)
        form = np.outer(way, way)
        features = (
            (part(way, Curve.SIZE),), (part(way, Curve.CLIPPED),), (part(way, Curve.TANH, 0.1),),
            (power(form, 0.5, 1.0),), (power(form, -0.25, 2.0), part(way, Curve.PART)), (part(way, Curve.RAMP, -0.2),),
        )  # fmt: skip
        factors = (
            Factor(Of.POWER, q, (0.1, 2.0, 2.0)), Factor(Of.SINE, q, (3.0,)), Factor(Of.COSINE, q, (2.0,)),
            Factor(Of.STEP, q, (-0.3,)), Factor(Of.BUMP, q, (0.2, 0.5)), Factor(Of.TENT, q, (-1.0, 1.0, 0.5, 1.0)),
            Factor(Of.CREEP, q, (2.0,)), Factor(Of.OVERLAP, q, (1.0, 0.4)), Factor(Of.CHEBYSHEV, q, (0.1, 1.7, 3.0)),
            table(q, -1.0, 0.5, rng.normal(size=5).tolist()), table(q, 0.0, 0.7, rng.normal(size=9).tolist(), True),
            table(q, -0.5, 1.0, [1.0, -1.0]),
        )  # fmt: skip
        small = 0.02 * self.compliance
        bent = [Term(1e-5 * rng.normal(size=6), small, features=own) for own in features]
        turned = [Term(1e-5 * rng.normal(size=6), small, factors=(one,)) for one in factors]
        both = Term(np.zeros(6), small, features=features[2], factors=(factors[0], Factor(Of.SINE, MASS, (0.3,))))
        return [straight(self.compliance), *bent, *turned, both]


def random_chain(folder: Path, seed: int) -> Arm:
    softness = 10.0 ** np.random.default_rng(seed).uniform(-1.0, 0.7)
    law = [LinearLaw(random_compliance(seed + i, softness)) for i in range(6)]
    where = {"tip": ("flange", law[0]), "foot": (None, law[1]), "roll": ("roll", law[2])}
    return crooked(
        folder, where | {"end": ("slide", law[3], True), "seam": ("seam", law[4]), "again": ("roll", law[5])}
    )


def with_terms(folder: Path, seed: int) -> Arm:
    laws = [EveryTerm(random_compliance(seed + i), name, seed + i) for i, name in enumerate(("roll", "yaw", "pitch"))]
    return three_joints(folder, laws)


def hardening(folder: Path, seed: int) -> Arm:
    return three_joints(folder, [HardeningLaw(random_compliance(seed + i), 0.5 + 0.5 * i) for i in range(3)])


ARMS: dict[str, Callable[[Path, int], Arm]] = {
    "chain": random_chain,
    "terms": with_terms,
    "hardening": hardening,
    "networks": lambda folder, seed: networks(folder, (3, 6)[seed % 2]),
    "springs": lambda folder, seed: sprung(folder, (BALANCER, TIE, STRUT)[: seed % 4], full=True),
    **{name: lambda folder, seed, name=name: MACHINES[name].load(folder) for name in MACHINES},
}


def drawn(kind: str, folder: Path, seed: int) -> tuple[Arm, Array, Payload, tuple[Wrench, ...]]:
    """Return an arm with joint positions, a payload, and a dead and a following load on its links."""
    rng, arm = np.random.default_rng(seed), ARMS[kind](folder, seed)
    q = poses(kind, 3) if kind in MACHINES else rng.uniform(-0.3, 0.3, (3, len(arm.joint_names)))
    body = Payload(rng.uniform(0.0, 30.0), rng.uniform(-0.1, 0.1, 3))
    loads = [
        Wrench(str(rng.choice(arm.link_names)), *(100.0 * rng.normal(size=(2, 3))), axes) for axes in ("base", "frame")
    ]
    return arm, q, body, tuple(loads)


@pytest.mark.slow
@settings(max_examples=60, suppress_health_check=list(HealthCheck))
@given(kind=st.sampled_from(sorted(ARMS)), seed=st.integers(0, 10**6))
@example(kind="uneven", seed=6153)  # of which one step happens to be short
def test_it_says_what_pinocchio_says(tmp_path_factory, kind: str, seed: int) -> None:
    """Where an arm rests and how it responds; relative to the largest of each, by the rounding of levers of metres."""
    arm, q, body, loads = drawn(kind, tmp_path_factory.mktemp("arm"), seed)
    found, line = arm.deflection(q, body, wrenches=loads), respond(arm, q, [body] * 3, wrenches=loads)
    loop = arm.prepared(body, wrenches=loads)
    for i, row in enumerate(q):
        one = arm.deflection(row, body, wrenches=loads, method="newton")
        # The residual of Newton's last step, of levers of some metres, over the tangent's least singular value.
        near = 4e-13 * max(1.0, one.load_factor / (one.load_factor - 1.0) if np.isfinite(one.load_factor) else 1.0)
        for values in (found.displacement[i], loop(row)):
            np.testing.assert_allclose(values, one.displacement, rtol=0, atol=near)
        np.testing.assert_allclose(found.twists[i], one.twists, rtol=0, atol=near)
        size = max(1.0, np.abs(one.wrenches).max(initial=0.0))
        np.testing.assert_allclose(found.wrenches[i], one.wrenches, rtol=0, atol=1e-9 * size)
    expected = linearised_rows(arm, q, body, loads).response(None)
    for name, values in expected.items():
        far = 1e-9 * np.abs(values).max(initial=0.0)
        np.testing.assert_allclose(getattr(line, name), values, rtol=0, atol=far, err_msg=name)


@settings(max_examples=25, suppress_health_check=list(HealthCheck))
@given(
    kind=st.sampled_from(["chain", "terms", "hardening", "networks"]),
    seed=st.integers(0, 10**6),
    given_rates=st.sampled_from([(1.0, 1.0), (1.0, None), (None, 1.0)]),
)
def test_a_moving_arm_is_where_pinocchio_has_it(tmp_path_factory, kind: str, seed: int, given_rates: tuple) -> None:
    """With every body's inertia, slides and turning joints, and loads beside."""
    arm, q, body, loads = drawn(kind, tmp_path_factory.mktemp("arm"), seed)
    rng, inertia = np.random.default_rng(seed), (0.5, 0.4, 0.6, 0.02, -0.03, 0.01)
    body = replace(body, inertia=np.array(inertia) if body.mass else None)
    v, a = (None if size is None else size * rng.normal(size=q.shape[1]) for size in given_rates)
    found, newton = (arm.deflection(q[0], body, v=v, a=a, wrenches=loads, method=m) for m in ("exact", "newton"))
    assert found.method == "exact" and newton.method == "newton"
    size = max(1.0, np.abs(newton.wrenches).max())
    np.testing.assert_allclose(found.displacement, newton.displacement, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.twists, newton.twists, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.wrenches, newton.wrenches, rtol=0, atol=1e-9 * size)
    standing = arm.deflection(q[0], body, wrenches=loads)  # nothing is left of the motion
    still = arm.deflection(q[0], body, wrenches=loads, method="newton")
    np.testing.assert_allclose(standing.displacement, still.displacement, rtol=0, atol=1e-12)


def test_a_load_that_is_made_anew_is_no_other_than_one_that_is_kept() -> None:
    """The second at the same link in the same axes, the third at another or in others."""
    arm, numbers = bundled("tarm_like"), np.random.default_rng(3).normal(size=(6, 2, 3)) * [[30.0], [5.0]]
    places = [("tool", "base"), ("tool", "base"), ("tool", "frame"), (arm.link_names[2], "frame"), ("tool", "base")]
    for (link, axes), (force, moment) in zip(places, numbers, strict=False):
        found = arm.deflection(np.zeros(7), wrenches=[Wrench(link, force, moment, axes)])
        newton = arm.deflection(np.zeros(7), wrenches=[Wrench(link, force, moment, axes)], method="newton")
        np.testing.assert_allclose(found.twists, newton.twists, rtol=0, atol=1e-13)


@pytest.mark.parametrize("seed", [1, 2])
def test_factors_that_it_asks_itself_are_those_of_the_laws(tmp_path: Path, seed: int) -> None:
    """In a control loop of an arm that is proven to stay; here whether it is or not."""
    arm, body = with_terms(tmp_path, seed), Payload(5.0, [0.1, 0.0, 0.1])
    loaded = arm.loaded(body)
    columns = {f"q_{name}": place for name, place in arm.joint_index.items()} | {MASS: 3}
    factors = arm.stack.factors(columns)
    assert factors is not None and len(factors.factor) == 1 + 3 * 12 + 1 and factors.names == ()
    ask = binding.OneRow(loaded.tree, arm.stack.numbers, np.array(arm.bounds), factors, np.array([5.0]))
    ask.set_loads(binding.NO_LINKS, binding.NO_WRENCHES)
    for q in positions(arm, 8):
        one = arm.deflection(q, body, method="newton")
        answer = ask(q)
        assert answer is not None
        displacement, twists, loads = answer
        np.testing.assert_allclose(twists, one.twists, rtol=0, atol=1e-13)
        np.testing.assert_allclose(loads, one.wrenches, rtol=0, atol=1e-9 * np.abs(one.wrenches).max())
        np.testing.assert_allclose(displacement, one.displacement, rtol=0, atol=1e-13)


def test_a_curve_through_knots_is_that_of_scipy() -> None:
    from scipy.interpolate import CubicHermiteSpline

    rng, x = np.random.default_rng(0), np.linspace(-3.0, 7.0, 201)
    values = rng.normal(size=7)
    knots = 0.5 + 0.8 * np.arange(7)
    ends = [np.polynomial.Polynomial.fit(knots[some], values[some], 2).deriv()(knots[k]) for some, k in (
        (slice(0, 3), 0), (slice(4, 7), 6))]  # fmt: skip
    slopes = np.concatenate([ends[:1], (values[2:] - values[:-2]) / 1.6, ends[1:]])
    expected = CubicHermiteSpline(knots, values, slopes)(np.clip(x, knots[0], knots[-1]))
    np.testing.assert_allclose(table("q_J", 0.5, 0.8, values.tolist()).of(x), expected, rtol=0, atol=1e-13)
    wide, three = 0.5 + 0.8 * np.arange(-8, 15), np.tile(values, 5)
    around = np.array([three[i % 7] for i in range(-8, 15)])
    slopes = np.array([three[(i + 1) % 7] - three[(i - 1) % 7] for i in range(-8, 15)]) / 1.6
    closed = table("q_J", 0.5, 0.8, values.tolist(), closes=True)
    np.testing.assert_allclose(closed.of(x), CubicHermiteSpline(wide, around, slopes)(x), rtol=0, atol=1e-12)
    np.testing.assert_allclose(closed.later(0.3)[0][1].of(x), closed.of(x + 0.3), rtol=0, atol=1e-12)
    single = [float(closed.of(np.array(one))) for one in x]
    np.testing.assert_array_equal(single, closed.of(x))


# Tables that are damaged.


def some_tree() -> Tree:
    return bundled("palletizer").loaded(None).tree


BROKEN = {
    "parents": lambda a: a.__setitem__(2, 5),
    "kinds": lambda a: a.__setitem__((1, 1), 90),
    "joins": lambda a: a.__setitem__((0, 1), len(a) + 900),
    "flexures": lambda a: a.__setitem__(0, 900),
    "carried": lambda a: a.__setitem__((0, 0), 3.0),
    "elements": lambda a: a.__setitem__((-1, 15), -1.0),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_damaged_table_is_refused_before_c_reads_it(name: str) -> None:
    tree = some_tree()
    assert tree.struct.count == len(tree.parents)
    array = getattr(tree, name).copy()
    BROKEN[name](array)
    with pytest.raises(InputError):
        _ = replace(tree, **{name: array}).struct
    with pytest.raises(InputError):
        _ = replace(tree, **{name: array[:-1]}).struct
    with pytest.raises(InputError, match=name):
        _ = replace(tree, **{name: array.astype(np.float32)}).struct


def test_laws_of_another_arm_are_refused() -> None:
    arm = bundled("heavy_six")
    tables, laws = Tables(arm.loaded(None).tree), arm.stack.numbers
    tables.set_laws(laws, 1)
    with pytest.raises(InputError, match="spans"):
        tables.set_laws(laws._replace(spans=laws.spans[::-1].copy() + 1, bent=laws.bent.copy()), 1)
    with pytest.raises(InputError, match="compliance"):
        tables.set_laws(laws._replace(compliance=np.repeat(laws.compliance, 2, axis=0)), 3)
    assert isinstance(laws, Laws)


def test_what_is_no_number_is_not_fine() -> None:
    arm = bundled("heavy_six")
    engine, q = binding.Engine(arm.loaded(None).tree), positions(arm, 6)
    q[1], q[4] = np.nan, np.inf
    engine.set_laws(arm.stack.numbers, len(q))
    n, fine = len(arm.sites), np.empty(6, dtype=bool)
    engine.rest_chain(q, True, np.empty((6, 6)), None, np.empty((6, n, 6)), fine)
    assert fine.tolist() == [True, False, True, True, False, True]


# The build.


@pytest.mark.parametrize("exact", [False, True])
def test_everything_is_filled_whatever_was_there(exact: bool) -> None:
    """Also the loads on flexures without coupling, which the fixed point keeps to itself."""
    arm = bundled("tarm_like")
    n = len(arm.sites)
    engine, q = binding.Engine(arm.loaded(None).tree), positions(arm, 5)
    engine.set_laws(arm.stack.numbers, 5)
    filled = [[np.full(shape, value) for shape in ((5, 6), (5, n, 6), (5, n, 6))] for value in (0.0, np.nan)]
    for displacement, loads, twists in filled:
        engine.rest_chain(q, exact, displacement, loads, twists, np.empty(5, dtype=bool))
    for first, second in zip(*filled, strict=True):
        np.testing.assert_array_equal(first, second)


def test_an_edited_source_is_noticed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / f"engine-0123-{build.LEVELS[0]}{build.SUFFIX}").touch()
    monkeypatch.setattr(build, "FOLDER", tmp_path)
    for source in build.SOURCES:
        (tmp_path / source).write_text("int other;")
    with pytest.raises(binding.EngineError, match=r"edited since.* run `python -m armflex\.mechanics\.engine\.build`"):
        binding._loaded(build.LEVELS[0])


def test_a_machine_without_a_compiler_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(build, "own_compiler", list)
    monkeypatch.setattr(build, "find_spec", lambda name: None)
    with pytest.raises(SystemExit, match="pip install ziglang"):
        build.compile_engine(tmp_path)
    monkeypatch.setattr(build, "own_compiler", lambda: ["no-such-compiler"])
    with pytest.raises(SystemExit, match="install gcc or clang"):
        build.compile_engine(tmp_path)
