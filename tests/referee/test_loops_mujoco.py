"""MuJoCo as referee of loops and cylinders: its own equation where armflex has the machine, and its own solution."""

import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.linalg import eigh, null_space
from scipy.optimize import root
from support.arms import bundled
from support.machines import MACHINES, poses
from support.small_arms import ROBOTS

import armflex
from armflex import read_trajectory
from armflex.errors import ArmFileError, UrdfError
from armflex.mechanics.mechanism import Mechanism
from armflex.tasks.settle import settle


class Mujoco:
    """A machine in MuJoCo, its drives at given positions."""

    def __init__(self, name: str, q: np.ndarray) -> None:
        self.machine = MACHINES[name]
        at = dict(zip(self.machine.driven, q.tolist(), strict=True))
        self.model = mujoco.MjModel.from_xml_string(self.machine.mjcf(at))
        self.data = mujoco.MjData(self.model)
        self.names = [self.model.joint(i).name for i in range(self.model.njnt)]
        self.start = np.array([at.get(name, 0.0) for name in self.names])
        driven = [one in at for one in self.names]
        self.free = np.flatnonzero(~np.array(driven))

    def look(self, free: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the torques that nothing balances yet, the loops' Jacobian and their gaps."""
        self.data.qpos[:] = self.start
        self.data.qpos[self.free] = free
        self.data.qvel[:] = 0.0
        mujoco.mj_forward(self.model, self.data)
        jacobian = np.zeros((3 * len(self.machine.loops), self.model.nv))
        gaps = np.zeros(len(jacobian))
        for k, loop in enumerate(self.machine.loops):
            sides = []
            for i in range(2):
                moved = np.zeros((3, self.model.nv))
                mujoco.mj_jacSite(self.model, self.data, moved, None, self.model.site(f"{loop}/{i}").id)
                sides.append((self.data.site(f"{loop}/{i}").xpos.copy(), moved))
            gaps[3 * k : 3 * k + 3] = sides[1][0] - sides[0][0]
            jacobian[3 * k : 3 * k + 3] = sides[1][1] - sides[0][1]
        self.left, self.ways = self.data.qfrc_passive - self.data.qfrc_bias, jacobian
        return self.left[self.free], jacobian[:, self.free], gaps

    def drives(self, forces: np.ndarray) -> dict[str, float]:
        """Return the loads on driven hinges under forces in the loops [Nm], where it was looked at last."""
        loads = self.left - self.ways.T @ forces
        return {one: float(loads[i]) for i, one in enumerate(self.names) if i not in self.free}


@pytest.mark.parametrize("row", range(4))
@pytest.mark.parametrize("name", MACHINES)
def test_a_machine_rests_where_mujoco_has_it(name, row, tmp_path):
    machine, q = MACHINES[name], poses(name)[row]
    arm = machine.load(tmp_path)
    assert arm.joint_names == machine.driven
    found = arm.deflection(q)
    flexures = {one: i for i, one in enumerate(arm.flexure_names)}
    referee = Mujoco(name, q)

    def own(joint: str) -> float:
        if joint in found.passive:
            return found.passive[joint]
        key = joint.removesuffix("/gives")
        return float(found.twists[flexures[key], 3:] @ machine.gives[key][0])

    here = np.array([own(referee.names[i]) for i in referee.free])
    left, jacobian, gaps = referee.look(here)
    forces = np.linalg.lstsq(jacobian.T, left, rcond=1e-9)[0]
    size = max(np.abs(left).max(), np.abs(found.drive_loads).max())
    # Its own equation, where armflex has the machine: torques that balance, loops that are closed.
    assert np.abs(left - jacobian.T @ forces).max() < 1e-7 * size
    assert np.abs(gaps).max(initial=0.0) < 1e-9
    assert np.linalg.norm(referee.data.site("tool").xpos - found.pose.translation) < 1e-9
    loads = dict(zip(machine.driven, found.drive_loads, strict=True))
    for one, load in referee.drives(forces).items():
        assert abs(load - loads[one]) < 1e-7 * size
    for one, (length, tension) in found.cylinder_states.items():
        stiffness, at = machine.cylinders[one][4], q[machine.driven.index(one)]
        assert length == pytest.approx(np.linalg.norm(np.diff(sites(referee, one), axis=0)), abs=1e-9)
        assert tension == pytest.approx(stiffness * (length - at), rel=1e-6)
    # And where it has the machine itself, from its drives alone; a plane loop does not gap across its plane.
    count, across = len(here), np.linalg.svd(jacobian)[0][:, : np.linalg.matrix_rank(jacobian, tol=1e-6)]

    def equation(at: np.ndarray) -> np.ndarray:
        left, jacobian, gaps = referee.look(at[:count])
        return np.concatenate([left * 1e-4 - jacobian.T @ across @ at[count:], across.T @ gaps])

    mechanics = arm.loaded(None).mechanics
    assert isinstance(mechanics, Mechanism)
    rigid = mechanics.closed(q)
    start = [dict(zip(found.passive, rigid, strict=True)).get(referee.names[i], 0.0) for i in referee.free]
    solved = root(equation, np.concatenate([start, np.zeros(across.shape[1])]), tol=1e-15)
    assert np.abs(solved.fun).max() < 1e-9
    assert np.abs(solved.x[:count] - here).max() < 1e-9


@pytest.mark.parametrize("name", MACHINES)
def test_a_machine_that_moves_bears_what_mujoco_says(name, tmp_path):
    """Passive joints move as they do where the closed rigid machine is asked at five times."""
    machine, q, rng = MACHINES[name], poses(name)[1], np.random.default_rng(3)
    arm, (v, a) = machine.load(tmp_path), rng.uniform(-1.0, 1.0, (2, len(machine.driven)))
    v, a = (0.05 * v, 0.3 * a) if machine.cylinders else (0.8 * v, 4.0 * a)
    found, still = arm.deflection(q, v=v, a=a), arm.deflection(q)
    flexures, referee = {one: i for i, one in enumerate(arm.flexure_names)}, Mujoco(name, q)
    mechanics = arm.loaded(None).mechanics
    assert isinstance(mechanics, Mechanism)
    times = 1e-2 * np.arange(-2, 3)
    path = np.array([mechanics.closed(q + v * t + 0.5 * a * t**2) for t in times])
    speeds = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) @ path / (12.0 * 1e-2)
    growth = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) @ path / (12.0 * 1e-4)
    rates = dict(zip(machine.driven, zip(v, a, strict=True), strict=True))
    rates |= dict(zip(found.passive, zip(speeds, growth, strict=True), strict=True))
    here = []
    for i in referee.free:
        key = referee.names[i].removesuffix("/gives")
        passive = referee.names[i] in found.passive
        here.append(found.passive[key] if passive else found.twists[flexures[key], 3:] @ machine.gives[key][0])
    _, jacobian, gaps = referee.look(np.array(here))
    data, held = referee.data, np.zeros(referee.model.nv)
    data.qvel[:], data.qacc[:] = np.array([rates.get(one, (0.0, 0.0)) for one in referee.names]).T
    mujoco.mj_fwdVelocity(referee.model, data)
    mujoco.mj_rne(referee.model, data, 1, held)
    referee.left = data.qfrc_passive - held
    left = referee.left[referee.free]
    forces = np.linalg.lstsq(jacobian.T, left, rcond=1e-9)[0]
    size = max(np.abs(left).max(), np.abs(found.drive_loads).max())
    assert np.abs(found.drive_loads - still.drive_loads).max() > 1e-2 * size
    assert np.abs(left - jacobian.T @ forces).max() < 1e-7 * size
    assert np.abs(gaps).max(initial=0.0) < 1e-9
    loads = dict(zip(machine.driven, found.drive_loads, strict=True))
    for one, load in referee.drives(forces).items():
        assert abs(load - loads[one]) < 1e-7 * size
    for one, load, own in zip(machine.driven, found.drive_loads, found.joint_loads, strict=True):
        along = np.eye(6)[0] if one in machine.cylinders else np.array([0.0, 0.0, 0.0, *machine.hinges[one].axis])
        assert abs(along @ own - load) < 1e-9 * size
    np.testing.assert_allclose(arm.deflection(q[None], v=v[None], a=a[None]).displacement[0], found.displacement)


def sites(referee: Mujoco, name: str) -> np.ndarray:
    return np.array([referee.data.site(f"{name}/{i}").xpos for i in range(2)])


def test_loads_in_loops_and_of_drives_are_those_of_mujoco(tmp_path):
    q = poses("five_bar")[0]
    found, referee = MACHINES["five_bar"].load(tmp_path).deflection(q), Mujoco("five_bar", q)
    at = {**found.passive, **{f"{one}/gives": float(found.twists[i, 3:] @ MACHINES["five_bar"].gives[one][0])
                              for i, one in enumerate(found.names.flexures)}}  # fmt: skip
    left, jacobian, _ = referee.look(np.array([at[referee.names[i]] for i in referee.free]))
    forces = np.linalg.lstsq(jacobian.T, left, rcond=1e-9)[0].reshape(-1, 3)
    poses_of = found.link_poses()
    for force, (loop, load) in zip(forces, found.loop_loads.items(), strict=True):
        turn = poses_of[MACHINES["five_bar"].loops[loop][0]][:3, :3]
        np.testing.assert_allclose(turn @ load[:3], force, rtol=1e-7, atol=1e-4)


def frequencies(referee: Mujoco, here: np.ndarray) -> np.ndarray:
    """Return natural frequencies [Hz] of the machine about positions at which it rests, drives holding.

    With A the loops' Jacobian, f their forces and N the motions that they allow, N'(K - d(A'f)) N u = w^2 N'M N u: the
    change of A at the same f is found by differences, as that of all other forces is.
    """
    left, jacobian, _ = referee.look(here)
    across = np.linalg.svd(jacobian)[0][:, : np.linalg.matrix_rank(jacobian, tol=1e-6)]
    forces = across @ np.linalg.lstsq(jacobian.T @ across, left, rcond=1e-12)[0]
    stiffness = np.empty((len(here), len(here)))
    for i in range(len(here)):
        sides = []
        for side in (1e-6, -1e-6):
            moved = here.copy()
            moved[i] += side
            left, other, _ = referee.look(moved)
            sides.append(left - other.T @ forces)
        stiffness[:, i] = -(sides[0] - sides[1]) / 2e-6
    referee.look(here)
    mass = np.zeros((referee.model.nv,) * 2)
    mujoco.mj_fullM(referee.model, referee.data, mass)  # pyright: ignore[reportAttributeAccessIssue]
    mass = (mass - np.diag(referee.model.dof_armature))[np.ix_(referee.free, referee.free)]
    free = null_space(across.T @ jacobian, rcond=1e-9)
    stiffness = 0.5 * (stiffness + stiffness.T)
    return np.sqrt(eigh(free.T @ stiffness @ free, free.T @ mass @ free, eigvals_only=True)) / (2.0 * np.pi)


@pytest.mark.parametrize("row", range(2))
@pytest.mark.parametrize("name", MACHINES)
def test_a_machine_swings_as_mujoco_has_it(name: str, row: int, tmp_path) -> None:
    machine, q = MACHINES[name], poses(name)[row]
    arm = machine.load(tmp_path)
    found, modes = arm.deflection(q), arm.modes(q)
    referee, flexures = Mujoco(name, q), arm.flexure_names

    def own(joint: str) -> float:
        if joint in found.passive:
            return found.passive[joint]
        key = joint.removesuffix("/gives")
        return float(found.twists[flexures.index(key), 3:] @ machine.gives[key][0])

    expected = frequencies(referee, np.array([own(referee.names[i]) for i in referee.free]))
    count = min(len(expected), len(modes.frequencies))
    np.testing.assert_allclose(modes.frequencies[:count], expected[:count], rtol=1e-6)
    assert count >= 2
    # Of a mode the energy of the flexures is that of the motion, but for what the loads take of it.
    assert np.abs(modes.sensitivities.sum(axis=1) - 0.5).max() < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["palletizer", "hybrid_lifter"])
def test_bundled_machines_settle(name: str) -> None:
    arm = bundled(name)
    report = settle(arm, read_trajectory(ROBOTS / name / "trajectory.csv", arm), within=1e-3)
    assert len(report.via_points) == 3
    for one in report.via_points[1:]:  # the first is where it stands
        assert np.isfinite(one.settle_s) and 1e-6 < one.peak_m < 1e-2


TREE = """[robot]
urdf = "machine.xml"
tip = "tool"
base = "world"
"""


@pytest.mark.parametrize("name", ["parallelogram", "uneven", "five_bar"])
@pytest.mark.filterwarnings("ignore:gravity:armflex.ArmflexWarning")
def test_loops_and_springs_of_mjcf_are_those_of_an_arm_file(name: str, tmp_path) -> None:
    """`connect`, tendons with a spring and joints without an actuator, beside the same machine declared."""
    machine = MACHINES[name]
    machine = replace(machine, loops={one: (*loop[:4], None) for one, loop in machine.loops.items()})
    expected = machine.load(tmp_path)
    motors = "".join(f'<motor joint="{one}"/>' for one in machine.driven)
    text = replace(machine, gives={}).mjcf({}).replace("</mujoco>", f"<actuator>{motors}</actuator></mujoco>")
    (tmp_path / "machine.xml").write_text(text)
    flexures = machine.declared().split("[flexure.", 1)[1]
    (tmp_path / "mjcf.toml").write_text(f"{TREE}\n[flexure.{flexures}")
    arm = armflex.load_arm(tmp_path / "mjcf.toml")
    assert arm.joint_names == expected.joint_names and len(arm.springs) == len(machine.springs)
    for q in poses(name)[:2]:
        found, other = arm.deflection(q), expected.deflection(q)
        np.testing.assert_allclose(found.pose, other.pose, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.displacement, other.displacement, rtol=0, atol=1e-9)
        assert found.passive == pytest.approx(other.passive, abs=1e-9)
        np.testing.assert_allclose(found.drive_loads, other.drive_loads, rtol=1e-7, atol=1e-4)


def driven_tendons(text: str) -> str:
    """Return the crane with its cylinders as tendons that actuators drive: one that holds a length, one of force."""
    machine = MACHINES["crane"]
    spans = "".join(
        f'<spatial name="{name}" {limits}><site site="{name}/0"/><site site="{name}/1"/></spatial>'
        for name, limits in (("lift", ""), ("fold", 'limited="true" range="0.9 2"'))
    )
    kept = f'<position name="valve" tendon="lift" kp="{machine.cylinders["lift"][4] / 4}" gear="2" '
    kept += 'ctrllimited="true" ctrlrange="1.8 4.4" forcelimited="true" forcerange="-1e5 1e5"/>'
    motors = f'{kept}<motor tendon="fold"/><motor joint="slew"/>'
    text = re.sub("<tendon>.*</tendon>", f"<tendon>{spans}</tendon>", text)
    return text.replace("</mujoco>", f"<actuator>{motors}</actuator></mujoco>")


@pytest.mark.filterwarnings("ignore:gravity:armflex.ArmflexWarning")
def test_driven_tendons_of_mjcf_are_cylinders(tmp_path) -> None:
    machine = MACHINES["crane"]
    rigid = {**machine.cylinders, "fold": (*machine.cylinders["fold"][:4], 1e15, *machine.cylinders["fold"][5:])}
    expected = replace(machine, cylinders=rigid).load(tmp_path)
    text = driven_tendons(replace(machine, gives={}).mjcf(dict.fromkeys(machine.cylinders, 1.5)))
    (tmp_path / "machine.xml").write_text(text)
    flexures = machine.declared().split("[flexure.", 1)[1]
    (tmp_path / "mjcf.toml").write_text(f"{TREE}\n[flexure.{flexures}")
    arm = armflex.load_arm(tmp_path / "mjcf.toml")
    assert arm.joint_names == expected.joint_names and set(arm.robot.linkage.passive) == {"boom", "jib"}
    lift, fold = arm.robot.linkage.cylinders
    assert (lift.lower, lift.upper, lift.effort) == (0.9, 2.2, 2e5) and (fold.lower, fold.upper) == (0.9, 2.0)
    for q in poses("crane"):
        found, other = arm.deflection(q), expected.deflection(q)
        np.testing.assert_allclose(found.displacement, other.displacement, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.drive_loads, other.drive_loads, rtol=1e-6, atol=1e-6)
    (tmp_path / "machine.xml").write_text(text.replace('limited="true" range="0.9 2"', ""))
    with pytest.raises(ArmFileError, match=r"\[cylinder.fold\] needs 'lower'"):
        armflex.load_arm(tmp_path / "mjcf.toml")


@pytest.mark.filterwarnings("ignore:gravity:armflex.ArmflexWarning")
def test_a_weld_of_mjcf_is_a_fixed_loop(tmp_path) -> None:
    """The rod of the parallelogram is welded to a pin's eye; a weld that wants it turned is refused."""
    machine = replace(MACHINES["parallelogram"], loops={}, gives={})
    text = machine.mjcf({}).replace("</worldbody>", "</worldbody>", 1)
    eye = '<body name="eye" pos="-0.4 0 0"><joint name="pin" axis="0 1 0"/>'
    eye += '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/></body>'
    place = text.index('<inertial mass="60.0"')
    motors = "".join(f'<motor joint="{one}"/>' for one in machine.driven)
    weld = '<weld name="tail" body1="eye" body2="rod" anchor="0 0 1.1"/>'
    text = text[:place] + eye + text[place:]
    text = text.replace("</mujoco>", f"<equality>{weld}</equality><actuator>{motors}</actuator></mujoco>")
    (tmp_path / "machine.xml").write_text(text)
    (tmp_path / "mjcf.toml").write_text(f'{TREE}\n[flexure.lower]\njoint = "lower"\njoint_stiffness = 3e5\n')
    arm = armflex.load_arm(tmp_path / "mjcf.toml")
    (loop,) = arm.robot.linkage.loops
    assert (loop.name, loop.kind, set(arm.robot.linkage.passive)) == ("tail", "fixed", {"elbow", "foot", "pin"})
    found = arm.deflection([0.1, 0.3, -0.2]).passive
    assert found["elbow"] == pytest.approx(-0.5, abs=2e-2)  # the rod keeps the forearm by the crank
    (tmp_path / "machine.xml").write_text(text.replace('anchor="0 0 1.1"', 'relpose="0 0 0 0.9 0 0.4 0"'))
    with pytest.raises(UrdfError, match="an equality ties body 'eye' to 'rod', which closes a loop"):
        armflex.load_arm(tmp_path / "mjcf.toml")
