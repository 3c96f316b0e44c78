"""Arms with loops or springs, compiled: the answers, branches and errors are those of Pinocchio."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from support.fixtures import ROBOTS
from support.linearised import linearised_rows
from support.machines import CRANE, MACHINES, PARALLELOGRAM, UNEVEN, Hinge, Machine, poses, skewed
from support.sprung_arm import BALANCER, STRUT, TIE, sprung

import armflex
from armflex import Arm, Wrench
from armflex.errors import ClosureError
from armflex.laws.law import WithoutParameters
from armflex.laws.terms import Term, straight
from armflex.mechanics.mechanism import Mechanism
from armflex.mechanics.response import respond
from armflex.robot import Corrections

FULL = "[[2e-8,1e-9,0,0,2e-9,0],[1e-9,3e-8,0,1e-9,0,0],[0,0,1e-8,0,0,3e-9],[0,1e-9,0,5e-7,0,0],[2e-9,0,0,0,4e-7,1e-8],"
FULL += "[0,0,3e-9,0,1e-8,6e-7]]"
SPHERICAL = 'kind = "spherical"\ncompliance = [2e-8, 1e-8, 3e-8, 0, 0, 0]'
MIMIC = '<mimic joint="lower" multiplier="-2" offset="0.1"/>'
GAS = '[spring.strut]\nlink = "column"\nat = [0, 0, 0]\nto = "arm"\nat_to = [0.3, 0.1, 0.4]\n'
GAS += "pressure = 4e5\narea = 2e-3\nlength0 = 0.6\nexponent = 1.3\n"
LOADS = (
    Wrench("tool", np.array([300.0, -200.0, 90.0]), np.array([20.0, 5.0, -8.0]), axes="frame"),
    Wrench("fore", np.array([-50.0, 70.0, 400.0])),
)


def declared(machine: Machine, folder: Path, **changes: str) -> Arm:
    """Return a machine whose arm.toml has some lines, by what they begin with, in place of its own."""
    machine.load(folder)
    file, found = folder / "arm.toml", []
    for line in file.read_text().splitlines():
        key = line.split(" ")[0]
        found += [changes.get(key, line)] if key != "axis" or "kind" not in changes else []
    file.write_text("\n".join([*found, changes.get("more", "")]))
    return armflex.load_arm(file)


def followed(folder: Path) -> Arm:
    """A joint that a belt ties to a drive, and another that has a loop."""
    declared(PARALLELOGRAM, folder, kind=SPHERICAL)
    urdf, file = folder / "robot.urdf", folder / "arm.toml"
    head, tail = urdf.read_text().split('<joint name="elbow"')
    urdf.write_text(f'{head}<joint name="elbow"{tail.replace("</joint>", MIMIC + "</joint>", 1)}')
    file.write_text(file.read_text().replace("[joint.elbow]", "[joint.crank]"))
    return armflex.load_arm(file)


def misplaced(arm: Arm) -> Arm:
    """The same with what a calibration corrects: zeros, frames and pins."""
    frames = {name: np.full(6, 1e-3 * (i + 1)) for i, name in enumerate(arm.robot.frames[:3])}
    return replace(arm, corrections=Corrections(joint_offset={arm.joint_names[-1]: 2e-3}, geometry=frames))


EYED = replace(
    PARALLELOGRAM,
    hinges={**PARALLELOGRAM.hinges, "pin": Hinge("fore", "eye", (-0.4, 0.0, 0.0), (0.0, 1.0, 0.0), passive=True)},
    bodies={**PARALLELOGRAM.bodies, "eye": (2.0, (0.0, 0.0, 0.1))},
    loops={"tail": ("rod", (0.0, 0.0, 1.1), "eye", (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))},
)
"""The parallelogram whose last pin is a joint, to which its rod is welded."""
CASES: dict[str, tuple[Callable[[Path], Arm], str | None]] = {
    **{name: ((lambda folder, name=name: MACHINES[name].load(folder)), name) for name in MACHINES},
    "full": (lambda f: declared(UNEVEN, f, compliance=f"compliance = {FULL}", kind=SPHERICAL), "uneven"),
    "moved": (lambda f: misplaced(declared(UNEVEN, f, compliance=f"compliance = {FULL}", kind=SPHERICAL)), "uneven"),
    "moved crane": (lambda f: misplaced(CRANE.load(f)), "crane"),
    "cylindrical": (
        lambda f: declared(UNEVEN, f, kind=f'kind = "cylindrical"\naxis = [0, 1, 0]\ncompliance = {FULL}'), "uneven"),
    "fixed": (lambda f: declared(EYED, f, kind=f'kind = "fixed"\ncompliance = {FULL}'), "parallelogram"),
    "gas": (lambda f: declared(PARALLELOGRAM, f, more=GAS), "parallelogram"),
    "followed": (followed, None),
    "chain": (lambda f: sprung(f, (BALANCER, TIE, STRUT), full=True), None),
    "skewed": (lambda f: skewed(declared(UNEVEN, f, compliance=f"compliance = {FULL}", kind=SPHERICAL)), "uneven"),
    "skewed crane": (lambda f: misplaced(skewed(CRANE.load(f))), "crane"),
    "skewed chain": (lambda f: skewed(sprung(f, (BALANCER, TIE, STRUT), full=True)), None),
    "moved chain": (lambda f: misplaced(sprung(f, (BALANCER, TIE), full=True)), None),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_compiled_answers_are_those_of_pinocchio(name: str, tmp_path: Path, monkeypatch) -> None:
    make, machine = CASES[name]
    arm = make(tmp_path)
    q = poses(machine, 6) if machine else np.random.default_rng(1).uniform(-0.2, 0.2, (6, len(arm.joint_names)))
    loads = tuple(one for one in LOADS if one.frame in arm.link_names)
    alone = [arm.deflection(row, wrenches=loads, method="newton") for row in q]
    fresh = replace(arm)  # nothing of what was asked before
    asked, rest = [], Mechanism.rest
    monkeypatch.setattr(Mechanism, "rest", lambda *given: asked.append(given) or rest(*given))
    many, prepared = fresh.deflection(q, wrenches=loads), fresh.prepared(wrenches=loads)
    assert not asked
    size = max(np.abs(one.wrenches).max() for one in alone)
    np.testing.assert_allclose(many.displacement, [one.displacement for one in alone], rtol=0, atol=1e-12)
    np.testing.assert_allclose(many.twists, [one.twists for one in alone], rtol=0, atol=1e-12)
    np.testing.assert_allclose(many.wrenches, [one.wrenches for one in alone], rtol=0, atol=1e-9 * size)
    for row, expected in zip(q, alone, strict=True):
        found = fresh.deflection(row, wrenches=loads)
        np.testing.assert_allclose(found.displacement, expected.displacement, rtol=0, atol=1e-12)
        np.testing.assert_allclose(prepared(row), expected.displacement, rtol=0, atol=1e-12)
        np.testing.assert_allclose(prepared.wrenches, expected.wrenches, rtol=0, atol=1e-9 * size)
        np.testing.assert_allclose(found.pose, expected.pose, rtol=0, atol=1e-12)
        assert found.passive == pytest.approx(expected.passive, abs=1e-12)
        for one in ("loop_loads", "cylinder_states"):
            for told, other in zip(getattr(found, one).values(), getattr(expected, one).values(), strict=True):
                np.testing.assert_allclose(told, other, rtol=0, atol=1e-9 * max(size, np.abs(other).max()))
        np.testing.assert_allclose(found.drive_loads, expected.drive_loads, rtol=0, atol=1e-9 * size)
        assert [flag.code for flag in found.flags] == [flag.code for flag in expected.flags]
        assert found.load_factor == pytest.approx(expected.load_factor, rel=1e-6)


@pytest.mark.slow
def test_cold_rows_of_an_exact_parallelogram_settle(tmp_path: Path, monkeypatch) -> None:
    """Nothing answers to three of its pin's five gaps: what rounding makes of these decides nothing."""
    arm = PARALLELOGRAM.load(tmp_path)
    asked, rest = [], Mechanism.rest
    monkeypatch.setattr(Mechanism, "rest", lambda *given: asked.append(given[1].q) or rest(*given))
    for q in poses("parallelogram", 40):
        replace(arm).deflection(q[None])
    assert not asked


def test_a_mechanism_that_its_loads_stiffen_is_proven_in_compiled_code(tmp_path: Path, monkeypatch) -> None:
    """What they change is too much for its norm to be a proof, and stiffens it."""
    arm, pull = CRANE.load(tmp_path), Wrench("jib", np.array([1e5, 0.0, 0.0]), np.zeros(3))
    few = arm.deflection(poses("crane", 8), wrenches=(pull,), allow_large=True, method="newton")
    asked, rest = [], Mechanism.rest
    monkeypatch.setattr(Mechanism, "rest", lambda *given: asked.append(given) or rest(*given))
    found = replace(arm).deflection(few.q, wrenches=(pull,), allow_large=True)
    assert len(asked) < len(few.q)
    np.testing.assert_allclose(found.displacement, few.displacement, rtol=0, atol=1e-12)


def test_pinocchio_solves_every_row_once(tmp_path: Path, monkeypatch) -> None:
    arm = declared(PARALLELOGRAM, tmp_path, kind=SPHERICAL)
    q = poses("parallelogram", 4)
    alone = [arm.deflection(row, wrenches=LOADS[:1], method="newton") for row in q]
    asked, rest = [], Mechanism.rest
    monkeypatch.setattr(Mechanism, "rest", lambda *given: asked.append(given) or rest(*given))
    found = replace(arm).deflection(q, wrenches=LOADS[:1], method="newton")
    for i, one in enumerate(alone):
        row = found.row(i)
        np.testing.assert_allclose(found.contributions[i], one.contributions, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.drive_loads[i], one.drive_loads, rtol=1e-9, atol=1e-6)
        np.testing.assert_allclose(row.total_jacobian, one.total_jacobian, rtol=1e-9, atol=1e-9)
        assert [flag.code for flag in row.flags] == [flag.code for flag in one.flags]
        assert row.load_factor == pytest.approx(one.load_factor, rel=1e-9)
    assert len(asked) == len(q)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_compiled_responses_are_those_of_pinocchio(name: str, tmp_path: Path, monkeypatch) -> None:
    make, machine = CASES[name]
    arm = make(tmp_path)
    q = poses(machine, 3) if machine else np.random.default_rng(1).uniform(-0.2, 0.2, (3, len(arm.joint_names)))
    loads, end = tuple(one for one in LOADS if one.frame in arm.link_names), arm.link_names[len(arm.link_names) // 2]
    few, many = linearised_rows(arm, q, "none", loads), respond(replace(arm), q, ["none"], wrenches=loads)
    for link in (None, end):
        for one, expected in few.response(link).items():
            for line, some in ((many, np.arange(3)), (many.some(np.array([2, 0])), np.array([2, 0]))):
                far = 1e-9 * np.abs(expected).max()
                np.testing.assert_allclose(getattr(line.of(link), one), expected[some], rtol=0, atol=far, err_msg=one)
    assert many.equilibrium(1).placed.motion == pytest.approx(few.founds[1].placed.motion, abs=1e-12)


def test_uncertainties_and_rigid_tips_of_many_rows_are_those_of_each(tmp_path: Path, monkeypatch) -> None:
    compliance = f"compliance = {FULL}\nrelative_std = 0.2"
    arm = misplaced(declared(UNEVEN, tmp_path, compliance=compliance, kind=SPHERICAL))
    q = poses("uneven", 4)
    alone = [replace(arm).deflection(row, wrenches=LOADS, method="newton") for row in q]
    covariances = np.array([one.covariance for one in alone])
    asked, closed = [], Mechanism.rest
    monkeypatch.setattr(Mechanism, "rest", lambda *given: asked.append(given) or closed(*given))
    many = replace(arm).deflection(q, wrenches=LOADS)
    assert covariances.any() and many.covariance is not None
    np.testing.assert_allclose(many.covariance, covariances, rtol=0, atol=1e-9 * np.abs(covariances).max())
    np.testing.assert_allclose(many.rigid_pose, [one.rigid_pose.homogeneous for one in alone], rtol=0, atol=1e-12)
    assert not asked


@pytest.mark.slow
@pytest.mark.parametrize("name", ["uneven", "moved", "chain"])
def test_every_row_has_its_own_load(name: str, tmp_path: Path, monkeypatch) -> None:
    arm = CASES[name][0](tmp_path)
    rng = np.random.default_rng(2)
    q, pushes = rng.uniform(-0.2, 0.2, (5, len(arm.joint_names))), rng.normal(0.0, 300.0, (5, 3))
    load = Wrench("tool", pushes, np.zeros((5, 3)))
    many, response = arm.deflection(q, wrenches=(load,)), respond(arm, q, ["none"] * 5, wrenches=(load,))
    for i in range(5):
        alone = arm.deflection(q[i], wrenches=(Wrench("tool", pushes[i], np.zeros(3)),))
        np.testing.assert_allclose(many.displacement[i], alone.displacement, rtol=0, atol=1e-12)
        np.testing.assert_allclose(response.flexure_twists[i], alone.twists.ravel(), rtol=0, atol=1e-12)


def test_rows_that_compiled_code_does_not_answer_are_asked_in_their_turn(tmp_path: Path, monkeypatch) -> None:
    arm = CRANE.load(tmp_path)
    q = np.tile(poses("crane")[0], (3, 1))
    q[1, 1:] = (1.55, 1.9)  # longer than boom and jib are ever apart
    with pytest.raises(ClosureError, match=r"row 1: loop 'fold' cannot close here"):
        arm.deflection(q)
    with pytest.raises(ClosureError, match=r"loop 'fold' cannot close here"):
        arm.prepared()(q[1])


def test_the_branch_is_that_of_the_row_before(tmp_path: Path, monkeypatch) -> None:
    """A four-bar whose rod is on its other side: every row goes on from there, far ones by smaller steps."""
    machine = replace(PARALLELOGRAM, loops={"tail": ("rod", (0.0, 0.0, 0.9), "fore", (-0.5, 0.0, 0.0), (0, 1, 0))})
    machine.load(tmp_path)
    file = tmp_path / "arm.toml"
    text = file.read_text().replace("[joint.elbow]\npassive = true", "[joint.elbow]\npassive = true\nq0 = 2.5")
    # In another order than the robot has its joints.
    text = text.replace("[joint.foot]\npassive = true", "")
    file.write_text("[joint.foot]\npassive = true\nq0 = 1.0\n\n" + text)
    q = np.array([[0.0, 0.0, 0.0], [0.0, 0.3, -0.2], [0.0, -0.2, 0.3], [0.0, 0.1, 0.1]])
    arm = armflex.load_arm(file)
    expected = arm.deflection(q, method="newton")
    assert arm.deflection(q[0]).passive["elbow"] > 1.5
    found = armflex.load_arm(file).deflection(q)
    np.testing.assert_allclose(found.displacement, expected.displacement, rtol=0, atol=1e-12)


def rounded(arm: Arm, q: np.ndarray) -> np.ndarray:
    """Return (N, 1) by how much two solutions may differ [m, rad], as a gap is a sum of products that are rounded.

    Those are some thirty of the arm's length on the way around the loop; the condition of the loop's gaps by passive
    joints is by how much more these turn.
    """
    mechanics = arm.loaded(None).mechanics
    assert isinstance(mechanics, Mechanism)
    ways = [mechanics.true.gaps(row, mechanics.rigid_configuration(row))[1] for row in q]
    sizes = np.linalg.svd(np.array(ways)[:, :, mechanics.flex.free_v], compute_uv=False)
    return 32.0 * np.finfo(float).eps * arm.robot.reach * sizes[:, :1] / sizes[:, -1:]


@pytest.mark.slow
@pytest.mark.parametrize("off", [0.0, 5e-6, 5e-5])
def test_a_parallelogram_that_is_not_quite_one_near_its_singular_pose(off: float, tmp_path) -> None:
    pin = ("rod", (off, 0.5 * off, 1.1), "fore", (-0.4, 0.0, off), (0.0, 1.0, 0.0))
    machine = replace(PARALLELOGRAM, loops={"tail": pin}, springs=UNEVEN.springs)
    arm = machine.load(tmp_path)
    q = np.array([[0.0, 0.0, 0.5 * np.pi - angle] for angle in (1.2, 0.6, 0.3, 0.1, 0.03, 0.003)])
    expected = arm.deflection(q, method="newton")
    found, bound = replace(arm).deflection(q), rounded(arm, q)
    assert bound[0] < 1e-12 and bound[-1] > 100.0 * bound[0]
    assert (np.abs(found.displacement - expected.displacement) <= bound).all()


@dataclass(frozen=True)
class Skewed(WithoutParameters):
    """An axis that turns under a force across it as well, which does not shift under a moment."""

    def terms(self) -> list[Term]:
        compliance = np.zeros((6, 6))
        compliance[4, 4], compliance[4, 2] = 1e-6, 4e-7
        return [straight(compliance)]


@pytest.mark.parametrize("name", ["uneven", "chain"])
def test_a_law_that_is_not_symmetric_is_solved_as_it_is(name: str, tmp_path: Path) -> None:
    arm = CASES[name][0](tmp_path)
    arm = replace(arm, flexures=tuple(replace(one, law=Skewed()) for one in arm.flexures))
    q = np.full(len(arm.joint_names), 0.1)
    exact, newton = (arm.deflection(q, wrenches=LOADS[1:], method=method) for method in ("exact", "newton"))
    assert np.abs(newton.twists).max() > 1e-5
    np.testing.assert_allclose(exact.twists, newton.twists, rtol=0, atol=1e-12)
    np.testing.assert_allclose(arm.deflection(q[None], wrenches=LOADS[1:]).twists[0], newton.twists, rtol=0, atol=1e-12)


@pytest.mark.parametrize("split", ["abab", "aabb", "abbaab", "aaab", "baaa"])
def test_payloads_that_change_between_rows_are_those_of_each_row(split: str) -> None:
    """The oil's stiffness differs by row, and what is asked of all rows follows what was asked of one payload's."""
    arm, payloads = (
        armflex.load_arm(ROBOTS / "hybrid_lifter" / "arm.toml"),
        [{"a": "none", "b": "t125"}[letter] for letter in split],
    )
    rng = np.random.default_rng(3)
    q = np.array([0.1, 0.1, 1.7, 0.95, 0.95]) + rng.uniform(-0.05, 0.05, (len(split), 5))
    many, alone = arm.deflection(q, payloads), [replace(arm).deflection(*row) for row in zip(q, payloads, strict=True)]
    assert np.ptp([np.linalg.norm(one.displacement) for one in alone]) > 1e-3
    np.testing.assert_allclose(many.displacement, [one.displacement for one in alone], rtol=0, atol=1e-12)
    np.testing.assert_allclose(many.pose, [one.pose.homogeneous for one in alone], rtol=0, atol=1e-12)
    covariances = np.array([one.covariance for one in alone])
    np.testing.assert_allclose(many.covariance, covariances, rtol=0, atol=1e-9 * np.abs(covariances).max())
    loads = np.array([one.drive_loads for one in alone])
    np.testing.assert_allclose(many.drive_loads, loads, rtol=0, atol=1e-9 * np.abs(loads).max())
