"""Many loads on one structure, and what they move: the source paper's automated study, on any mesh.

Where CalculiX is installed it solves every load with large displacements, and with whatever the model has beside solids
(springs, contacts, plasticity); a linear mesh is condensed where it is not.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from shutil import which

import numpy as np
import pinocchio as pin

from armflex.conventions import TWIST_NAMES, WRENCH_NAMES, Array
from armflex.errors import ConvergenceError, Flag, InputError, UnsupportedError
from armflex.fem.condense import condense
from armflex.fem.matrices import rigid_motion
from armflex.fem.mesh import UNITS, Mesh, check_size
from armflex.storage.whole_file import scratch, write_whole

PROGRAM = "ccx"
"""CalculiX, from https://www.calculix.de (GPL), as a program of its own."""

LOOK = 0.2
"""Seconds between two looks at how far it is."""

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


def random_loads(count: int, forces: tuple[float, float], moments: tuple[float, float] | None, seed: int) -> Array:
    """Return (N, 6) loads [N, Nm]: of any direction, of a size between two bounds; no moments where they have none.

    Raises:
        InputError: A bound is negative, or the lower one above the upper one.
    """
    found, rng = np.zeros((count, 6)), np.random.default_rng(seed)
    for place, bounds in ((slice(0, 3), forces), (slice(3, 6), moments)):
        if bounds is None:
            continue
        if not 0.0 <= bounds[0] <= bounds[1] or bounds[1] == 0.0:
            raise InputError(f"loads from {bounds[0]:g} to {bounds[1]:g}: expected 0 <= lower <= upper, not both 0")
        directions = rng.normal(size=(count, 3))
        sizes = rng.uniform(*bounds, size=(count, 1))
        found[:, place] = sizes * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return found


def study(
    mesh: Mesh,
    fixed: str,
    loaded: str,
    loads: Array,
    unit: str = "m",
    interface: str = "rigid",
    tick: Callable[[str, int, int | None], None] | None = None,
) -> Study:
    """Return what loads on a set do.

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
    if which(PROGRAM):
        check_size(mesh)
        if not mesh.beyond:  # instances may have nodes of one number
            mesh = replace(mesh, ids=np.arange(1, len(mesh.points) + 1))
        return Study(loads, _calculix(mesh, fixed, loaded, loads, unit, interface, tick), "calculix", mesh.flags)
    if mesh.beyond:
        keyword, line = mesh.beyond[0]
        text = f"{mesh.path}:{line}: *{keyword} is computed by CalculiX alone, and {PROGRAM} is not installed"
        raise UnsupportedError(f"{text} (Debian: apt install calculix-ccx)")
    part = condense(mesh, fixed, [loaded], interface, tick=tick)
    text = f"CalculiX ({PROGRAM}) is not installed: the deflections are linear in the loads"
    return Study(loads, loads @ part.compliance.T, "linear", (Flag("linear", text), *part.flags))


def _calculix(
    mesh: Mesh,
    fixed: str,
    loaded: str,
    loads: Array,
    unit: str,
    interface: str,
    tick: Callable[[str, int, int | None], None] | None,
) -> Array:
    """Return the (N, 6) twists [m, rad] that CalculiX finds, a step for each load."""
    length = UNITS[unit][0]
    held, carrying = mesh.nodes_of(fixed), mesh.nodes_of(loaded)
    arms = mesh.points[carrying] - mesh.points[carrying].mean(axis=0)
    body = rigid_motion(arms)
    spread = body @ np.linalg.inv(body.T @ body)
    first = int(mesh.ids.max()) + 1_000_001
    rigid = interface == "rigid"
    lines = [_model(mesh, unit)]
    for name, rows in ((FIXED, held), (LOADED, carrying)):
        lines += [f"*NSET, NSET={name}", *map(str, mesh.ids[rows])]
    if rigid:
        place = ", ".join(f"{x / length:.12e}" for x in mesh.points[carrying].mean(axis=0))
        lines += ["*NODE", f"{first}, {place}", f"{first + 1}, {place}", f"*NSET, NSET={REFERENCE}"]
        lines += [f"{first}, {first + 1}", f"*RIGID BODY, NSET={LOADED}, REF NODE={first}, ROT NODE={first + 1}"]
    lines += ["*BOUNDARY", f"{FIXED}, 1, 3"]
    printed = REFERENCE if rigid else LOADED
    for load in loads:
        if rigid:
            given = [(first + i // 3, i % 3 + 1, load[i] if i < 3 else load[i] / length) for i in range(6)]
        else:
            nodal = (spread @ load).reshape(-1, 3)
            given = [(n, i + 1, f) for n, own in zip(mesh.ids[carrying], nodal, strict=True) for i, f in enumerate(own)]
        lines += ["*STEP, NLGEOM, INC=1000", "*STATIC", "1., 1.", "*CLOAD, OP=NEW"]
        lines += [f"{node}, {axis}, {value:.12e}" for node, axis, value in given]
        lines += [f"*NODE PRINT, NSET={printed}, TOTALS=NO", "U", "*END STEP"]
    with scratch(job_inp="\n".join(lines) + "\n") as folder:
        said = _run(folder, len(loads), tick)
        found = _printed(folder / "job.dat")
    if len(found) < len(loads):
        problem = next((line.strip() for line in said.splitlines() if "*ERROR" in line), "no message")
        raise ConvergenceError(f"{mesh.path}: CalculiX did not solve load {len(found) + 1}: {problem}", ())
    twists = []
    for moved in found:
        if rigid:
            shift, turn = length * moved[first], moved[first + 1]
        else:
            mean = np.array([moved[node] for node in mesh.ids[carrying]]).ravel() @ spread
            shift, turn = length * mean[:3], length * mean[3:]
        twists.append(pin.log6(pin.SE3(pin.exp3(turn), shift)).vector)
    return np.array(twists)


def _run(folder: Path, steps: int, tick: Callable[[str, int, int | None], None] | None) -> str:
    """Run CalculiX on job.inp; return what it says."""
    environment, pipe = {"OMP_NUM_THREADS": "1", **os.environ}, subprocess.PIPE
    command, status = [PROGRAM, "job"], folder / "job.sta"
    running = subprocess.Popen(command, cwd=folder, stdout=pipe, stderr=subprocess.STDOUT, env=environment)
    try:
        while True:
            try:
                return running.communicate(timeout=LOOK)[0].decode(errors="replace")
            except subprocess.TimeoutExpired:  # what it said until now is kept
                if tick and status.exists() and (rows := status.read_text(errors="replace").split("\n")[2:-1]):
                    tick("CalculiX, load", int(rows[-1].split()[0]), steps)
    finally:
        running.kill()
        running.wait()


def _printed(path: Path) -> list[dict[int, Array]]:
    """Return the displacements that CalculiX printed at the end of every step, by node."""
    found: dict[int, dict[int, Array]] = {}
    now: dict[int, Array] = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        cells = line.split()
        if line.lstrip().startswith("displacements"):
            time_now, now = float(cells[-1]), {}
            if abs(time_now - round(time_now)) < 1e-6:
                found[round(time_now)] = now
        elif len(cells) == 4:
            now[int(cells[0])] = np.array([float(cell) for cell in cells[1:]])
    return [found[step] for step in sorted(found)]


def _model(mesh: Mesh, unit: str) -> str:
    """Return the model without its steps: its solids, or where it has more the .inp as it stands."""
    if mesh.beyond:
        lines = mesh.path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
        words = [line.strip().upper() for line in lines]
        if any(word.startswith(("*PART", "*INSTANCE", "*INCLUDE")) for word in words):
            keyword, line = mesh.beyond[0]
            raise UnsupportedError(
                f"{mesh.path}:{line}: *{keyword} in parts or included files: flatten the model first"
            )
        end = next((i for i, word in enumerate(words) if word.startswith("*STEP")), len(lines))
        return "\n".join(lines[:end])
    length, stress, density = UNITS[unit]
    lines = ["*NODE"]
    for number, place in zip(mesh.ids, mesh.points / length, strict=True):
        lines.append(", ".join([str(number), *(f"{x:.12e}" for x in place)]))
    for place, block in enumerate(mesh.blocks):
        lines.append(f"*ELEMENT, TYPE={block.kind}, ELSET=E{place}")
        for element, own in enumerate(mesh.ids[block.nodes], 10_000_000 * place + 1):
            row = [str(element), *map(str, own)]
            pieces = [", ".join(row[start : start + 12]) for start in range(0, len(row), 12)]
            lines.append(",\n".join(pieces))
        assert block.material is not None
        lines += [
            f"*MATERIAL, NAME=M{place}",
            "*ELASTIC",
            f"{block.material.young / stress:.12e}, {block.material.poisson:.12e}",
        ]
        lines += ["*DENSITY", f"{block.material.density / density:.12e}"] if block.material.density else []
        lines.append(f"*SOLID SECTION, ELSET=E{place}, MATERIAL=M{place}")
    return "\n".join(lines)


def write_study(found: Study, path: Path) -> Path:
    """Write a joint_data.csv: forces in N, moments in Nm, shifts in mm, rotations in mrad.

    Forces and shifts alone where no load has a moment.
    """
    size = 6 if found.loads[:, 3:].any() else 3
    units = [*["N"] * 3, *["Nm"] * 3][:size], [*["mm"] * 3, *["mrad"] * 3][:size]
    both = zip((*WRENCH_NAMES[:size], *TWIST_NAMES[:size]), (*units[0], *units[1]), strict=True)
    names = [f"{name}_{unit}" for name, unit in both]
    cells = np.hstack([found.loads[:, :size], 1e3 * found.twists[:, :size]])
    rows = [",".join(f"{value:.15g}" for value in row) for row in cells]
    return write_whole(path, ("\n".join([",".join(names), *rows]) + "\n").encode())
