"""The rows of a plan as a measurements.csv to be filled in."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from armflex.measured.table import write_table

if TYPE_CHECKING:
    from armflex.plan.result import Plan


def write_plan(found: Plan, path: str | Path) -> Path:
    """Write pose, session, payload, q_*, what effects depend on, x y z to be filled in, and sigma.

    Stops whose pose begins with `to ` stay empty. What a row is worth is not a column: in the campaign that the file
    becomes, `trace` would look at it as a cause.
    """
    rows, reach = found.rows, found.reach
    columns: dict[str, list] = {name: list(getattr(rows, name)) for name in ("pose", "session", "payload")}
    columns |= {f"q_{joint}": rows.q[:, i].tolist() for i, joint in enumerate(rows.joint_names)}
    for joint in reach.approached:
        columns[f"approach_{joint}"] = rows.approach[:, rows.joint_names.index(joint)].astype(int).tolist()
    known = {**rows.covariates, "hold": rows.hold, "time": rows.time}
    columns |= {name: known[name].tolist() for name in reach.levels}
    columns |= {axis: [""] * len(rows) for axis in "xyz"}
    sigma = (reach.sigma[0],) if (reach.sigma == reach.sigma[0]).all() else reach.sigma
    names = ("sigma",) if len(sigma) == 1 else ("sigma_x", "sigma_y", "sigma_z")
    columns |= {name: [float(value)] * len(rows) for name, value in zip(names, sigma, strict=True)}
    return write_table(path, columns)
