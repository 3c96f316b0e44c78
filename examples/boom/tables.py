"""Loads and deflections of the boom's joints, by finite elements: what its laws are trained on, and compared with.

    python tables.py FOLDER [NAME ...]

writes NAME.csv (trained on) and NAME_new.csv (new loads) for each structure. The tables that it wrote are in
robots/tarm_like/learned. Solids are condensed exactly onto the ends of the springs, and the springs, with their large
displacements, are solved by Newton's method: milliseconds for a load instead of a second. `by_calculix` does the same
with CalculiX, geometrically nonlinear in everything.
"""

from __future__ import annotations

import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

import armflex
from armflex.fem.assembly import assembled
from armflex.fem.inp import read_inp
from armflex.fem.mesh import Mesh
from armflex.fem.study import Study, study
from armflex.measured.table import write_table

sys.path.insert(0, str(Path(__file__).parents[1]))
from boom import structures

ROBOT = armflex.bundled_robot("tarm_like")
ROWS, NEW = 160, 60
EXTENSIONS, FINE = np.arange(0.0, 6.01, 0.5), 0.25
"""Of M1, at which its compliance is found [m], and length of its elements there; its tables are at 3 m."""

RING = 7e4, 2.5e4, 1.8e4, 6e3, 7.5e3, 1.2e4
"""Largest loads on a ring of A4 [N, Nm]: those that compose.py finds there are a little smaller."""

NAMES = ("M1", "A1", "A2", "A3", "A4", "A5", "A6", "A4_ring")


def boxes() -> dict[str, np.ndarray]:
    """Return for each joint the (2, 6) least and largest loads that it meets [N, Nm], with some room.

    They are those of the arm with assumed laws on its path, at 200 poses within its limits with M1 between 2.5 and
    4 m, and straight out, empty and with 600 kg.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        arm = armflex.load_arm(ROBOT / "arm.toml")
        path = armflex.read_trajectory(ROBOT / "trajectory.csv", arm)
        poses = random_poses(arm, 200, 1)
        q = np.vstack([path.q[::4], poses, np.zeros((1, len(arm.joint_names)))])
        loads = np.concatenate([arm.deflection(q, payload).wrenches for payload in ("empty", "p600")])
    found = {}
    for i, name in enumerate(arm.flexure_names):
        low, high = loads[:, i].min(axis=0), loads[:, i].max(axis=0)
        middle, half = 0.5 * (low + high), 0.55 * (high - low)
        for part in (slice(0, 3), slice(3, 6)):
            half[part] = np.maximum(half[part], 0.1 * np.abs(loads[:, i, part]).max())
        found[name] = np.array([middle - half, middle + half])
    return found


def random_poses(arm: armflex.Arm, count: int, seed: int) -> np.ndarray:
    """Return (N, nq) poses within 0.9 of the limits, M1 between 2.5 and 4 m."""
    lower, upper = 0.9 * arm.robot.lower, 0.9 * arm.robot.upper
    lower[0], upper[0] = 2.5, 4.0
    return np.random.default_rng(seed).uniform(lower, upper, (count, len(arm.joint_names)))


def written(name: str, file: Path, extension: float = 3.0, step: float = 0.5) -> tuple[Mesh, np.ndarray]:
    """Write a structure's .inp; return its mesh, and the (6, 6) action of the pose of what it carries."""
    if name == "M1":
        structures.mast(file, extension, step)
    elif name.startswith("A4"):
        structures.fork(file, name.partition("_")[2] or "whole")
    else:
        structures.hinge(name, file)
    mesh = read_inp(file, springs=True)
    place = np.zeros(3)  # of all others than A4's the flexure's origin is that of what it carries
    if name.startswith("A4"):
        place = mesh.points[mesh.nodes_of("CARRIES")].mean(axis=0)
    return mesh, pin.SE3(np.eye(3), place).action


def by_calculix(name: str, loads: np.ndarray, extension: float = 3.0) -> np.ndarray:
    """Return the (N, 6) twists [m, rad] of (N, 6) loads [N, Nm] at a joint's origin, in its axes, by CalculiX."""
    with tempfile.TemporaryDirectory() as folder:
        mesh, action = written(name, Path(folder) / f"{name}.inp", extension)
        return study(mesh, "HELD", "CARRIES", loads @ action).twists @ action.T


class Condensed:
    """A structure whose solids are condensed onto the ends of its springs.

    What is not joined by solids to what is held moves with the body that carries the load, through finite rotations
    (corotationally): its solids deform linearly in axes that turn with that body.
    """

    def __init__(self, name: str, extension: float = 3.0, step: float = 0.5) -> None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / f"{name}.inp"
            mesh, self.action = written(name, file, extension, step)
            springs = read_springs(file)
        row = {number: place for place, number in enumerate(mesh.ids.tolist())}
        pairs = [(np.array([(row[a], row[b]) for a, b in own]), law) for own, law in springs]
        held, carried = mesh.nodes_of("HELD"), mesh.nodes_of("CARRIES")
        ends = np.unique(np.concatenate([own.ravel() for own, _ in pairs]))
        outer = np.setdiff1d(ends, np.concatenate([held, carried]))
        inner = np.setdiff1d(np.arange(len(mesh.points)), np.concatenate([held, carried, outer]))
        whole, _ = assembled(mesh)
        dofs = lambda nodes: (3 * nodes[:, None] + np.arange(3)).ravel()  # noqa: E731
        across = whole[dofs(inner)][:, dofs(outer)]
        solver = splu(whole[dofs(inner)][:, dofs(inner)].tocsc())
        self.stiffness = whole[dofs(outer)][:, dofs(outer)].toarray() - across.T @ solver.solve(across.toarray())
        _, part = connected_components(whole)
        still = np.isin(part[3 * ends], part[3 * held])
        self.moves = ~still
        self.centre = mesh.points[carried].mean(axis=0)
        self.ends = mesh.points[ends] - self.centre
        self.own = np.full(len(ends), -1)
        self.own[np.searchsorted(ends, outer)] = np.arange(len(outer))
        self.springs = [(np.searchsorted(ends, own), *law) for own, law in pairs]
        self.lengths = [np.linalg.norm(self.ends[own[:, 1]] - self.ends[own[:, 0]], axis=1) for own, *_ in self.springs]

    def twists(self, loads: np.ndarray) -> np.ndarray:
        """Return the (N, 6) twists [m, rad] of (N, 6) loads [N, Nm]."""
        return np.array([self._solved(load) for load in loads @ self.action]) @ self.action.T

    def _solved(self, load: np.ndarray) -> np.ndarray:
        size, count = len(self.stiffness), len(self.ends)
        local, turn, shift = np.zeros(size), np.eye(3), np.zeros(3)
        free = self.own >= 0
        places = np.zeros((count, 3), int)
        places[free] = 3 * self.own[free, None] + np.arange(3)
        # A quarter of the load at a time: where rollers lose their preload at once there is nothing to turn to.
        for iteration in range(240):
            part = min(1.0, 0.25 * (1 + iteration // 4))
            moved = self.ends.copy()
            moved[free] += local.reshape(-1, 3)[self.own[free]]
            moved[self.moves] = moved[self.moves] @ turn.T
            motion = np.zeros((count, 3, size + 6))  # of every end, per step of the unknowns
            for axis in range(3):
                for to in range(3):
                    motion[np.flatnonzero(free), to, places[free, axis]] = np.where(
                        self.moves[free], turn[to, axis], float(to == axis)
                    )
            motion[self.moves, :, size : size + 3] = np.eye(3)
            x, y, z = moved[self.moves].T
            zero = np.zeros_like(x)
            motion[self.moves, :, size + 3 :] = np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]]).transpose(
                2, 0, 1
            )
            moved[self.moves] += shift
            force = np.concatenate([self.stiffness @ local, -part * load])
            tangent = np.zeros((size + 6,) * 2)
            tangent[:size, :size] = self.stiffness
            for (own, law, travel), start in zip(self.springs, self.lengths, strict=True):
                along = moved[own[:, 1]] - moved[own[:, 0]]
                length = np.linalg.norm(along, axis=1)
                unit, stretch = along / length[:, None], length - start
                pull = np.interp(stretch, travel, law)
                place = np.clip(np.searchsorted(travel, stretch), 1, len(travel) - 1)
                slope = (law[place] - law[place - 1]) / (travel[place] - travel[place - 1])
                move = motion[own[:, 1]] - motion[own[:, 0]]
                by = np.einsum("sa,san->sn", unit, move)
                force += by.T @ pull
                tangent += (by * (slope - pull / length)[:, None]).T @ by
                flat = move.reshape(-1, move.shape[2])
                tangent += (flat * np.repeat(pull / length, 3)[:, None]).T @ flat
            step = -np.linalg.solve(tangent, force)
            done = part == 1.0 and np.abs(step).max() < 1e-10
            step *= 1.0 if iteration < 40 else 0.4  # the springs' laws are polygons, on whose corners Newton may turn
            local, shift = local + step[:size], shift + step[size : size + 3]
            turn = pin.exp3(step[size + 3 :]) @ turn
            if done:
                return pin.log6(pin.SE3(turn, shift)).vector
        raise RuntimeError(f"a load was not solved: {load}")


def read_springs(file: Path) -> list[tuple[list[tuple[int, int]], tuple[np.ndarray, np.ndarray]]]:
    """Return the pairs of nodes of every set of SPRINGA of an .inp, and its (n,) forces [N] and elongations [m]."""
    found, now, pairs, rows = [], "", [], []
    for line in [*file.read_text(encoding="utf-8").splitlines(), "*END"]:
        if line.startswith("*"):
            if now == "*SPRING":
                found.append((pairs, tuple(np.array(rows).T)))
                pairs, rows = [], []
            now = line.partition(",")[0] if "SPRING" in line else ""
        elif now == "*ELEMENT":
            pairs.append(tuple(int(cell) for cell in line.split(",")[1:]))
        elif now == "*SPRING":
            rows.append([float(cell) for cell in line.split(",")])
    return found


def solved(name: str, loads: np.ndarray, extension: float = 3.0, step: float = 0.5) -> Study:
    """Return what (N, 6) loads [N, Nm] at a joint's origin, in its axes, do there."""
    return Study(loads, Condensed(name, extension, step).twists(loads), "condensed, with springs")


def main(folder: Path, names: list[str]) -> None:
    """Write the tables."""
    box = boxes()
    for name in names:
        rng = np.random.default_rng([3, NAMES.index(name)])
        if name in box:
            loads = rng.uniform(*box[name], size=(ROWS + NEW, 6))
        else:
            loads = rng.uniform(-1.0, 1.0, (ROWS + NEW, 6)) * RING
        found = solved(name, loads)
        for part, rows in ((name, slice(0, ROWS)), (f"{name}_new", slice(ROWS, None))):
            write_table(folder / f"{part}.csv", Study(found.loads[rows], found.twists[rows], found.solver).columns)
        print(name, flush=True)
    if "M1" in names:  # a compliance at each extension, of least squares over loads of the box
        rows = []
        for extension in EXTENSIONS:
            loads = np.random.default_rng(5).uniform(*box["M1"], size=(24, 6))
            compliance = np.linalg.lstsq(loads, solved("M1", loads, float(extension), FINE).twists, rcond=None)[0].T
            rows += [[extension, *row] for row in 0.5 * (compliance + compliance.T)]
        np.savetxt(folder / "M1_extension.csv", rows, "%.9g", ",", header="extension_m,fx,fy,fz,mx,my,mz", comments="")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:] or list(NAMES))
