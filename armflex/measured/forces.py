"""Known forces in a table of rows: the columns `force_fx` .. `force_mz`, `force_frame`, `force_axes`, read once."""

from __future__ import annotations

import numpy as np

from armflex.arm import Arm
from armflex.conventions import WRENCH_NAMES
from armflex.errors import Place, TableError, UnknownNameError, did_you_mean
from armflex.measured.table import Table
from armflex.rows.wrench import Wrench

FORCES = tuple(f"force_{name}" for name in WRENCH_NAMES)
FORCE_KINDS = {name: "force" if name in FORCES[:3] else "moment" for name in FORCES}
"""Kind of quantity of each column that holds numbers, for `read_table`."""

FORCE_TEXTS = ("force_frame", "force_axes")
FORCE_AXES = {"base": "base", "link": "frame"}
"""As files name the axes, and as `Wrench` does."""


def read_forces(table: Table, arm: Arm) -> tuple[Wrench, ...]:
    """Return the known loads from outside of a table's rows, for all N rows each, zero where a row has none.

    `force_fx` .. `force_mz` are in N and Nm, or as their headers say; a column that is not there is zero, and so is a
    row whose cells are all empty. `force_frame` names the link at whose origin it acts, the tip where it is empty, and
    `force_axes` whose axes they are: those of the `base` where it is empty, or of that `link`, with which it turns.

    Args:
        table: Read with `FORCE_KINDS` among its kinds.
        arm: The arm that is pulled at.

    Returns:
        A wrench for every link and axes that occur; none where no row has a force.

    Raises:
        TableError: A cell is no number, a row has some of its numbers only, there is no such link, or no such axes;
            frame or axes are given without a force.
    """
    names = [name for name in FORCES if name in table.columns]
    texts = [name for name in FORCE_TEXTS if name in table.columns]
    if not names:
        if texts:
            raise TableError(Place(table.path, 1), f"has {texts[0]!r} but none of {FORCES[0]} .. {FORCES[-1]}")
        return ()
    given = np.array([[bool(cell) for cell in table.texts(name)] for name in names]).T.reshape(len(table), -1)
    there = np.all(given, axis=1)
    partly = np.any(given, axis=1) & ~there
    if partly.any():
        line = table.lines[int(partly.argmax())]
        raise TableError(Place(table.path, line), f"only some of {', '.join(names)} are given")
    loads = np.zeros((len(table), 6))
    for name in names:
        loads[:, FORCES.index(name)] = table.numbers_where(name, there)
    frames, axes = (
        [cell or default for cell in table.texts(name)] if name in texts else [default] * len(table)
        for name, default in zip(FORCE_TEXTS, (arm.robot.tip, "base"), strict=True)
    )
    for line, frame, axis in zip(table.lines, frames, axes, strict=True):
        if frame not in arm.link_names:
            problem = f"force_frame: {UnknownNameError('link', frame, arm.link_names)}"
        elif axis not in FORCE_AXES:
            problem = f"force_axes is {axis!r}, expected base or link{did_you_mean(axis, FORCE_AXES)}"
        else:
            continue
        raise TableError(Place(table.path, line), problem)
    found, pairs = [], list(zip(frames, axes, strict=True))
    for pair in dict.fromkeys(pair for pair, load in zip(pairs, loads, strict=True) if load.any()):
        own = np.where([[other == pair] for other in pairs], loads, 0.0)
        found.append(Wrench(pair[0], own[:, :3], own[:, 3:], FORCE_AXES[pair[1]]))
    return tuple(found)
