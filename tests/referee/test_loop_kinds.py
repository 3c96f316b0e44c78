"""MuJoCo as referee of a machine with everything; what its loops hold is written here in world axes."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation
from support.loop_kinds import CLOSED, PAYLOAD, built
from support.machines import Y


def holds(kind: str) -> np.ndarray:
    """Return the (m, 6) shifts and turns, in axes of the first link, that a loop of a kind about y holds."""
    held = {"spherical": "xyz", "revolute": "xyzac", "cylindrical": "xzac", "fixed": "xyzabc"}[kind]
    return np.eye(6)[["xyzabc".index(one) for one in held]]


@pytest.mark.parametrize("way", CLOSED)
def test_a_machine_with_everything_rests_where_mujoco_has_it(way: str, tmp_path: Path) -> None:
    closed, rng = CLOSED[way], np.random.default_rng(5)
    machine, arm = built(closed, tmp_path)
    kinds = {"tail": (closed.kind, np.array(closed.gives)), "level": ("revolute", np.zeros(6))}
    compiled = {payload: arm.prepared(payload) for payload in (None, "p")}
    numbers = {name: i for i, name in enumerate(arm.flexure_names)}
    for row in range(20):
        q = np.array([*rng.uniform(-0.5, 0.5, 3), 1.2 + rng.uniform(-0.05, 0.05)])
        at, carried = dict(zip(machine.driven, q.tolist(), strict=True)), PAYLOAD * (row % 2)
        payload = "p" if carried else None
        found = arm.deflection(q, payload)
        np.testing.assert_allclose(compiled[payload](q), found.displacement, rtol=0, atol=1e-12)
        model = mujoco.MjModel.from_xml_string(machine.mjcf(at, carried))
        data, names = mujoco.MjData(model), [model.joint(i).name for i in range(model.njnt)]
        for i, name in enumerate(names):
            known = {**at, **found.passive}
            hinge = name.removesuffix("/gives")
            data.qpos[i] = known[name] if name in known else found.twists[numbers[hinge], 3:] @ machine.gives[hinge][0]
        mujoco.mj_forward(model, data)
        left, ways, gaps, soft = data.qfrc_passive - data.qfrc_bias, [], [], []
        for loop in arm.robot.linkage.loops:
            places, turns, moved = [], [], []
            for i in range(2):
                shift, turn = np.zeros((2, 3, model.nv))
                mujoco.mj_jacSite(model, data, shift, turn, model.site(f"{loop.name}/{i}").id)
                places.append(data.site(f"{loop.name}/{i}").xpos.copy())
                turns.append(data.site(f"{loop.name}/{i}").xmat.reshape(3, 3).copy())
                moved.append((shift, turn))
            kind, gives = kinds[loop.name]
            back, apart = turns[0].T, places[1] - places[0]
            carried_along = np.cross(moved[0][1].T, apart).T
            angles = Rotation.from_matrix(back @ turns[1] @ loop.turn_to).as_rotvec()
            # The gaps are so small that a turn's derivative is the turn, but for half of its product with it.
            turning = back @ (moved[1][1] - moved[0][1])
            turning = turning - 0.5 * np.cross(angles, turning.T).T
            if kind in ("revolute", "cylindrical"):
                y = np.array(Y)
                other = (back @ turns[1] @ loop.turn_to) @ y
                angles = np.cross(y, other)
                turning = np.cross(y, np.cross((back @ (moved[1][1] - moved[0][1])).T, other)).T
            rows = holds(kind)
            ways.append(rows @ np.concatenate([back @ (moved[1][0] - moved[0][0] - carried_along), turning]))
            gaps.append(rows @ np.concatenate([back @ apart, angles]))
            soft.append(rows @ np.diag(gives) @ rows.T)
        held, gap, give = np.concatenate(ways), np.concatenate(gaps), np.asarray(block_diag(*soft))
        free = [i for i, name in enumerate(names) if name not in at]
        size = max(np.abs(left).max(), np.abs(found.drive_loads).max())
        # Forces that balance everything and open the pins by what these give.
        equation = np.concatenate([held[:, free].T / size, give * 1e9 / size])
        forces = np.linalg.lstsq(equation, np.concatenate([left[free] / size, gap * 1e9 / size]), rcond=1e-13)[0]
        assert np.abs(left[free] - held[:, free].T @ forces).max() < 1e-7 * size
        assert np.abs(gap - give @ forces).max() < 1e-9
        assert np.linalg.norm(data.site("tool").xpos - found.pose.translation) < 1e-9
        drives, loads = left - held.T @ forces, dict(zip(machine.driven, found.drive_loads, strict=True))
        for i, name in enumerate(names):
            assert name not in at or abs(drives[i] - loads[name]) < 1e-7 * size
