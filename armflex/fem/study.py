"""Many loads on one structure, and what they move: the source paper's automated study, on any mesh.

Where CalculiX is installed it solves every load with large displacements, and with whatever the model has beside solids
(springs, contacts, plasticity); a linear mesh is condensed where it is not.
"""

import os
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path
from shutil import which

import numpy as np
import pinocchio as pin

from armflex.conventions import TWIST_NAMES, WRENCH_NAMES, Array
from armflex.errors import ConvergenceError, Flag, UnsupportedError
from armflex.fem.condense import Tick, condense
from armflex.fem.matrices import rigid_motion
from armflex.fem.mesh import UNITS, Mesh, interfaces_of
from armflex.storage.whole_file import scratch, write_whole

PROGRAM = "ccx"
"""CalculiX, from https://www.calculix.de (GPL), as a program of its own."""

FIXED, LOADED, REFERENCE = "ARMFLEX_FIXED", "ARMFLEX_LOADED", "ARMFLEX_REFERENCE"


@dataclass(frozen=True)
class Study:
    """Loads at the centroid of an interface and its motion there, axes of the mesh.

    Attributes:
        loads: (N, 6) [N, Nm].
        twists: (N, 6) [m, rad].
        solver: "calculix" or "linear".
        flags: What is doubtful.
    """

    loads: Array
    twists: Array
    solver: str
    flags: tuple[Flag, ...] = ()

    @property
    def columns(self) -> dict[str, list[float]]:
        """Columns of a joint_data.csv; forces and shifts alone where no load has a moment."""
        size = 6 if self.loads[:, 3:].any() else 3
        units = [*(["_N"] * 3 + ["_Nm"] * 3)[:size], *(["_mm"] * 3 + ["_mrad"] * 3)[:size]]
        names = [*WRENCH_NAMES[:size], *TWIST_NAMES[:size]]
        values = np.hstack([self.loads[:, :size], 1e3 * self.twists[:, :size]]).T.tolist()
        return {name + unit: column for name, unit, column in zip(names, units, values, strict=True)}


def random_loads(count: int, forces: tuple[float, float], moments: tuple[float, float], seed: int) -> Array:
    """Return (N, 6) loads [N, Nm]: of any direction, of a size between two bounds."""
    rng, loads = np.random.default_rng(seed), []
    for bounds in (forces, moments):
        directions, sizes = rng.normal(size=(count, 3)), rng.uniform(*bounds, size=(count, 1))
        loads.append(sizes * directions / np.linalg.norm(directions, axis=1, keepdims=True))
    return np.hstack(loads)


def study(
    mesh: Mesh,
    fixed: str,
    loaded: str,
    loads: Array,
    unit: str = "m",
    interface: str = "rigid",
    tick: Tick | None = None,
) -> Study:
    """Return what loads on a set do, each from the undeformed state.

    Args:
        mesh: The structure; see `Mesh.beyond` for what only CalculiX computes.
        fixed: The set that is held.
        loaded: The set that carries the loads.
        loads: (N, 6) at its centroid [N, Nm].
        unit: Of the mesh's file, a key of `mesh.UNITS`.
        interface: "rigid" or "average", see `Part`.
        tick: Is given what is done, how far, of how much.

    Raises:
        UnsupportedError: The model needs CalculiX, which is not installed.
        ConvergenceError: CalculiX did not solve a load; which.
    """
    if not which(PROGRAM):
        if mesh.beyond:
            keyword, line = mesh.beyond[0]
            text = f"{mesh.place(line)}: *{keyword} is computed by CalculiX alone, and {PROGRAM} is not installed"
            raise UnsupportedError(f"{text} (Debian: apt install calculix-ccx)")
        part = condense(mesh, fixed, [loaded], interface, tick=tick)
        text = f"CalculiX ({PROGRAM}) is not installed: the deflections are linear in the loads"
        return Study(loads, loads @ part.compliance.T, "linear", (Flag("linear", text), *part.flags))
    held, carrying = interfaces_of(mesh, fixed, (loaded,), whole=not mesh.beyond).values()
    # Instances may have nodes of one number.
    ids = mesh.ids if mesh.beyond else np.arange(1, len(mesh.points) + 1)
    length, first = UNITS[unit][0] if mesh.beyond else 1.0, int(ids.max()) + 1_000_001
    centre = mesh.points[carrying].mean(axis=0)
    body = rigid_motion(mesh.points[carrying] - centre)
    spread = body @ np.linalg.inv(body.T @ body)
    lines = [*_model(mesh, ids), f"*NSET, NSET={FIXED}", *map(str, ids[held])]
    lines += [f"*NSET, NSET={LOADED}", *map(str, ids[carrying]), "*BOUNDARY", f"{FIXED}, 1, 3"]
    read = ids[carrying]
    if interface == "rigid":
        read, place = np.array([first, first + 1]), ", ".join(f"{x / length:.12e}" for x in centre)
        lines += ["*NODE", f"{first}, {place}", f"{first + 1}, {place}", f"*NSET, NSET={REFERENCE}"]
        lines += [f"{first}, {first + 1}", f"*RIGID BODY, NSET={LOADED}, REF NODE={first}, ROT NODE={first + 1}"]
        spread = np.diag([*[1.0] * 3, *[1.0 / length] * 3])  # forces at one node, moments in the file's unit at another
    twists = np.zeros((len(loads), 6))
    with scratch(model_inp="\n".join(lines) + "\n") as folder:
        for row, load in enumerate(loads):
            if tick:
                tick("CalculiX, load", row + 1, len(loads))
            step = ["*INCLUDE, INPUT=model.inp", "*STEP, NLGEOM, INC=1000", "*STATIC", "1., 1.", "*CLOAD"]
            for node, forces in zip(read, (spread @ load).reshape(-1, 3), strict=True):
                step += [f"{node}, {axis}, {force:.12e}" for axis, force in enumerate(forces, 1)]
            step += [f"*NODE PRINT, NSET={REFERENCE if interface == 'rigid' else LOADED}, TOTALS=NO", "U", "*END STEP"]
            write_whole(folder / "job.inp", ("\n".join(step) + "\n").encode())
            environment = {"OMP_NUM_THREADS": "1", **os.environ}
            ran = subprocess.run([PROGRAM, "job"], cwd=folder, capture_output=True, env=environment)
            moved = _printed(folder / "job.dat")
            if any(node not in moved for node in read):
                said = ran.stdout.decode(errors="replace").splitlines()
                problem = next((line.strip() for line in said if "*ERROR" in line), "no message")
                raise ConvergenceError(f"{mesh.path}: CalculiX did not solve load {row + 1}: {problem}", ())
            displacements = np.concatenate([moved[node] for node in read])
            shift, turn = (displacements if interface == "rigid" else displacements @ spread).reshape(2, 3)
            turn = turn if interface == "rigid" else length * turn
            twists[row] = pin.log6(pin.SE3(pin.exp3(turn), length * shift)).vector
    return Study(loads, twists, "calculix", mesh.flags)


def _printed(path: Path) -> dict[int, Array]:
    """Return the displacements by node that CalculiX printed at the end of the step, at time 1."""
    displacements: dict[int, Array] = {}
    ended = False
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        cells = line.split()
        if line.lstrip().startswith("displacements"):
            ended = abs(float(cells[-1]) - 1.0) < 1e-6
        elif ended and len(cells) == 4:
            displacements[int(cells[0])] = np.array([float(cell) for cell in cells[1:]])
    return displacements


def _model(mesh: Mesh, ids: np.ndarray) -> list[str]:
    """Return the model without its steps: its solids in SI, or where it has more the .inp as it stands."""
    if mesh.beyond:
        lines = mesh.path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
        words = [line.strip().upper() for line in lines]
        apart = ("*PART", "*INSTANCE", "*INCLUDE", "*SYSTEM", "*TRANSFORM")
        if any(word.startswith(apart) or re.match(r"\*.*\bINPUT\s*=", word) for word in words):
            keyword, line = mesh.beyond[0]
            text = f"*{keyword} with parts, systems, transforms or included files: flatten the model first"
            raise UnsupportedError(f"{mesh.path}:{line}: {text}")
        return lines[: next((i for i, word in enumerate(words) if word.startswith("*STEP")), len(lines))]
    places = enumerate(mesh.points.tolist(), 1)
    lines = ["*NODE", *(f"{number}, {x:.12e}, {y:.12e}, {z:.12e}" for number, (x, y, z) in places)]
    for place, block in enumerate(mesh.blocks):
        lines.append(f"*ELEMENT, TYPE={block.kind}, ELSET=E{place}")
        for row in np.column_stack([10_000_000 * place + 1 + np.arange(len(block.ids)), ids[block.nodes]]).tolist():
            lines.append(",\n".join(str(row[start : start + 12])[1:-1] for start in range(0, len(row), 12)))
        material = block.material
        assert material is not None
        lines += [f"*MATERIAL, NAME=M{place}", "*ELASTIC", f"{material.young:.12e}, {material.poisson:.12e}"]
        lines += ["*DENSITY", f"{material.density:.12e}"] if material.density else []
        lines.append(f"*SOLID SECTION, ELSET=E{place}, MATERIAL=M{place}")
    return lines
