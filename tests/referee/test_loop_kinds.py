"""MuJoCo as referee of a machine with everything: two loops in chain, closed in every way, pins that give, a cylinder
and a spring on passive joints, and what gives across their axes. What its loops hold is written here in world axes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation
from support.machines import UNEVEN, Hinge, Machine, X, Y, Z

import armflex

PAYLOAD = 120.0
MACHINE = Machine(
    hinges={
        **UNEVEN.hinges,
        "crank": Hinge("column", "crank", (0.21, 0.0, 0.31), Y),
        "eye": Hinge("fore", "eye", (-0.42, 0.0, 0.01), Y, passive=True),
        "wrist": Hinge("fore", "hand", (1.2, 0.0, 0.0), Y, passive=True),
        "bell": Hinge("arm", "bell", (0.0, 0.05, 1.1), Y, passive=True),
        "stay": Hinge("column", "stay", (0.02, 0.05, 0.42), Y, passive=True),
    },
    bodies={
        **UNEVEN.bodies,
        "eye": (2.0, (0.0, 0.0, 0.05)),
        "hand": (35.0, (0.1, 0.02, -0.1)),
        "bell": (6.0, (0.05, 0.0, 0.1)),
        "stay": (9.0, (0.0, 0.0, 0.5)),
    },
    gives={**UNEVEN.gives, "elbow": (X, 8e5), "wrist": (Z, 4e5), "foot": (X, 3e6)},
    loops={
        "tail": ("rod", (0.01, -0.03, 1.13), "eye", (0.0, 0.0, 0.0), None),
        "level": ("stay", (0.0, 0.0, 1.12), "bell", (-0.21, 0.0, 0.1), Y),
    },
    cylinders={"tie": ("bell", (0.05, 0.0, 0.21), "hand", (-0.03, 0.04, 0.2), 9e6, 0.9, 1.5)},
    springs=UNEVEN.springs,
    tool=("hand", (0.3, 0.1, -0.1)),
)
"""A palletizing arm, not quite parallel, whose wrist is kept level by a second loop and a cylinder."""


@dataclass(frozen=True)
class Closed:
    """How the first loop is closed: its kind, what its pin gives, and whether the rod's eye turns by itself."""

    kind: str
    gives: tuple[float, ...] = (0.0,) * 6
    eye: bool = False


CLOSED = {
    "revolute": Closed("revolute"),
    "revolute, gives": Closed("revolute", (2e-8, 3e-8, 1e-8, 1e-7, 0.0, 2e-7)),
    "spherical": Closed("spherical"),
    "spherical, gives": Closed("spherical", (2e-8, 3e-8, 1e-8, 0.0, 0.0, 0.0)),
    "cylindrical": Closed("cylindrical"),
    "cylindrical, gives": Closed("cylindrical", (2e-8, 0.0, 1e-8, 1e-7, 0.0, 2e-7)),
    "fixed": Closed("fixed", eye=True),
    "fixed, gives": Closed("fixed", (2e-8, 3e-8, 1e-8, 1e-7, 2e-7, 2e-7), eye=True),
}


def built(closed: Closed, folder: Path) -> tuple[Machine, armflex.Arm]:
    """Return the machine closed in a way, and as armflex reads it."""
    machine, at = MACHINE, ("eye", (0.0, 0.0, 0.0))
    if not closed.eye:
        hinges, bodies = ({k: v for k, v in one.items() if k != "eye"} for one in (machine.hinges, machine.bodies))
        at = ("fore", MACHINE.hinges["eye"].place)
        machine = replace(machine, hinges=hinges, bodies=bodies)
    machine = replace(machine, loops={**machine.loops, "tail": (*machine.loops["tail"][:2], *at, None)})
    machine.load(folder)
    axis = "" if closed.kind in ("spherical", "fixed") else "axis = [0.0, 1.0, 0.0]\n"
    compliance = f"compliance = {list(closed.gives)}\n" if any(closed.gives) else ""
    file = folder / "arm.toml"
    text = file.read_text().replace('kind = "spherical"', f'kind = "{closed.kind}"\n{axis}{compliance}', 1)
    file.write_text(f"{text}\n[payload.p]\nmass = {PAYLOAD}\ncom = [0.0, 0.0, 0.0]\n")
    return machine, armflex.load_arm(file)


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
                angles, turning = (
                    np.cross(y, other),
                    np.cross(y, np.cross((back @ (moved[1][1] - moved[0][1])).T, other)).T,
                )
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
