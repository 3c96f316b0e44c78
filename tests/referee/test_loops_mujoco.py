"""MuJoCo as referee of loops and cylinders: its own equation where armflex has the machine, and its own solution."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.optimize import root
from support.machines import MACHINES, poses

from armflex.mechanics.mechanism import Mechanism


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
