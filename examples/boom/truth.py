"""Every joint by finite elements under the loads of 200 poses and payloads, and a solver of the whole arm.

    python truth.py FOLDER [JOINT ...]

writes FOLDER/JOINT_truth.csv. The solver shares no code with armflex: bodies and joints from the URDF by plain numpy,
loads by summing weights outboard of each joint, twists as exponentials. The loads that are solved are those of the
rigid arm; `tip` moves the twists to the loads of the deflected one.
"""

from __future__ import annotations

import sys
import warnings
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
from scipy.linalg import expm

sys.path.insert(0, str(Path(__file__).parents[1]))

JOINTS = ("M1", "A1", "A2", "A3", "A4", "A5", "A6")
POSES, EXTENSIONS, PAYLOADS = 200, (2.0, 3.0, 4.0), {"empty": 0.0, "p300": 300.0, "p600": 600.0}
GRAVITY = np.array([0.0, 0.0, -9.81])


def cross(a: np.ndarray) -> np.ndarray:
    """Return the (3, 3) matrix of a cross product."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def exponential(twist: np.ndarray) -> np.ndarray:
    """Return the (4, 4) motion of a twist."""
    found = np.zeros((4, 4))
    found[:3, :3], found[:3, 3] = cross(twist[3:]), twist[:3]
    return expm(found)


def placed(turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Return a (4, 4) pose."""
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = turn, shift
    return found


class Boom:
    """The chain of a URDF of prismatic, revolute and fixed joints, whose frames are all parallel at zero."""

    def __init__(self, urdf: Path) -> None:
        root = ElementTree.parse(urdf).getroot()
        self.joints = []
        numbers = lambda text: np.array([float(x) for x in text.split()])  # noqa: E731
        bodies = {}
        for link in root.findall("link"):
            own = link.find("inertial")
            if own is not None:
                bodies[link.get("name")] = (
                    float(own.find("mass").get("value")),
                    numbers(own.find("origin").get("xyz")),
                )
        for joint in root.findall("joint"):
            origin = joint.find("origin")
            assert not numbers(origin.get("rpy", "0 0 0")).any()
            axis = joint.find("axis")
            kind, child = joint.get("type"), joint.find("child").get("link")
            along = numbers(axis.get("xyz")) if axis is not None else np.zeros(3)
            shift = numbers(origin.get("xyz")) if origin is not None else np.zeros(3)
            self.joints.append((joint.get("name"), kind, along, shift, bodies.get(child, (0.0, np.zeros(3)))))

    def at(
        self, q: dict[str, float], twists: dict[str, np.ndarray], mass: float
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return the (4, 4) pose of the tool, and the (6,) load on every moving joint in its own axes."""
        pose, frames, weights = np.eye(4), {}, []
        for name, kind, axis, origin, (own, com) in self.joints:
            pose = pose @ placed(np.eye(3), origin)
            if name in q:
                motion = np.concatenate(
                    [axis * q[name], np.zeros(3)] if kind == "prismatic" else [np.zeros(3), axis * q[name]]
                )
                pose = pose @ exponential(motion) @ exponential(twists[name])
                frames[name] = (pose, len(weights))
            weights.append((own, pose[:3, :3] @ com + pose[:3, 3]))
        weights.append((mass, pose[:3, :3] @ [0.2, 0.0, 0.0] + pose[:3, 3]))
        loads = {}
        for name, (frame, first) in frames.items():
            force = sum(m for m, _ in weights[first:]) * GRAVITY
            moment = sum(np.cross(place - frame[:3, 3], m * GRAVITY) for m, place in weights[first:])
            turn = frame[:3, :3].T
            loads[name] = np.concatenate([turn @ force, turn @ moment])
        return pose, loads


def rows(robot: Path, seed: int = 20) -> tuple[np.ndarray, list[str]]:
    """Return the (N, 7) poses and the payloads."""
    import armflex

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        arm = armflex.load_arm(robot / "arm.toml")
    rng = np.random.default_rng(seed)
    q = rng.uniform(0.9 * arm.robot.lower, 0.9 * arm.robot.upper, (POSES, 7))
    q[:, 0] = rng.choice(EXTENSIONS, POSES)
    return q, rng.choice(list(PAYLOADS), POSES).tolist()


def main(folder: Path, names: list[str]) -> None:
    """Write the twists of every joint under the loads of the rigid boom."""
    from boom.tables import ROBOT, solved

    q, payloads = rows(ROBOT)
    boom = Boom(ROBOT / "robot.urdf")
    none = dict.fromkeys(JOINTS, np.zeros(6))
    loads = [
        boom.at(dict(zip(JOINTS, one, strict=True)), none, PAYLOADS[p])[1] for one, p in zip(q, payloads, strict=True)
    ]
    for name in names:
        own, twists = np.array([load[name] for load in loads]), np.zeros((POSES, 6))
        for extension in EXTENSIONS if name == "M1" else (3.0,):
            some = np.flatnonzero(q[:, 0] == extension) if name == "M1" else np.arange(POSES)
            twists[some] = solved(name, own[some], extension).twists
        np.savetxt(folder / f"{name}_truth.csv", np.hstack([own, twists]), "%.12g", ",")
        print(name, "truth", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:] or list(JOINTS))
