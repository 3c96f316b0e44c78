"""The rows as they are driven, and in a file: little motion, and past a pose first where the side counts.

Conditions and payloads are changed as rarely as can be. Within what is left the nearest row comes next, then pieces of
the way are turned round as long as that shortens it (2-opt; Croes 1958).
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from armflex.arguments import checked_kinds
from armflex.conventions import UNITS, Array
from armflex.measured.table import write_table
from armflex.plan.offer import OVERSHOOT, Reach
from armflex.rows import Rows
from armflex.rows.rows import STILL

if TYPE_CHECKING:
    from armflex.plan.asking import RequestedRows
    from armflex.plan.planned_rows import Plan

RUN_UP = "to "
"""How the pose of a stop begins that is only there to come from the right side."""


def driven(rows: Rows, reach: Reach, start: Array) -> tuple[Rows, list[int], tuple[float, float]]:
    """Return all stops in order, which of (n,) rows are read in turn, and the way in that order and as they were given.

    Between two stops each joint is taken to go straight. Where an effect depends on the side that a joint comes from
    and the way there comes from the other, a stop at which nothing is read goes before: the pose, with that joint past
    it. The way is that of all joints together in ranges, such stops left out.
    """
    levels = [_levels(rows)[name] for name in reach.levels]
    conditions = [tuple(float(values[i]) for values in levels) for i in range(len(rows))]
    rank = {condition: number for number, condition in enumerate(sorted(set(conditions)))}

    def turn(i: int) -> tuple[int, int]:
        """Conditions take longest to change; the payload stays where one does."""
        number, payload = rank[conditions[i]], reach.payloads.index(rows.payload[i])
        return number, payload if number % 2 == 0 else -payload

    numbers = sorted(range(len(rows)), key=turn)
    span = np.maximum(reach.upper - reach.lower, STILL)
    order = driving_order(rows.q[numbers], [turn(i) for i in numbers], start, span)
    read = [numbers[i] for i in order]
    way = motion(rows.q[read], start, span), motion(rows.q, start, span)
    return _with_run_ups(rows.some(read), reach), read, way


def _levels(rows: Rows) -> dict:
    return {**rows.covariates, "hold": rows.hold, "time": rows.time}


def driving_order(q: Array, groups: Sequence[Hashable], start: Array, span: Array) -> list[int]:
    """Return the numbers of (N, nq) rows in the order to drive them.

    Args:
        q: Joint positions [rad or m].
        groups: What every row shares with those that are driven without a change between; in order of appearance.
        start: (nq,) where the arm stands before [rad or m].
        span: (nq,) way of every joint that counts as one [rad or m].
    """
    order: list[int] = []
    here = start / span
    for group in dict.fromkeys(groups):
        members = [i for i, member in enumerate(groups) if member == group]
        order += [members[i] for i in _short_way(q[members] / span, here)]
        here = q[order[-1]] / span
    return order


def motion(q: Array, start: Array, span: Array) -> float:
    """Return the way that all joints together make over (N, nq) rows, in units of `span`."""
    return float(np.abs(np.diff(np.vstack([start, q]) / span, axis=0)).sum())


def _short_way(places: Array, here: Array) -> list[int]:
    """Return the order of (N, nq) places from the nearest to the nearest, pieces turned round until none is worth it.

    It ends wherever it likes.
    """
    every = np.vstack([here, places])
    far = np.abs(every[:, None] - every[None]).sum(axis=2)
    stops, left = [0], list(range(1, len(every)))
    while left:
        stops.append(min(left, key=lambda i: far[stops[-1], i]))
        left.remove(stops[-1])
    better = True
    while better:
        better = False
        for first in range(1, len(stops) - 1):
            for last in range(first + 1, len(stops)):
                before, begin, end = stops[first - 1], stops[first], stops[last]
                change = far[before, end] - far[before, begin]
                if last + 1 < len(stops):
                    change += far[begin, stops[last + 1]] - far[end, stops[last + 1]]
                if change < -1e-9:
                    stops[first : last + 1] = stops[first : last + 1][::-1]
                    better = True
    return [i - 1 for i in stops[1:]]


def _with_run_ups(rows: Rows, reach: Reach) -> Rows:
    """Return named rows with the stops between them at which nothing is read."""
    chosen = np.isin(reach.arm.joint_names, reach.approached)
    past = OVERSHOOT * (reach.upper - reach.lower)
    stops: list[tuple[int, str, Array, Array]] = []  # row, name, position, approach
    before = None
    for i, (q, side) in enumerate(zip(rows.q, rows.approach, strict=True)):
        came = np.zeros(len(q)) if before is None else _sign(q - before)
        wrong = chosen & (came != side)
        if wrong.any():
            away = q - np.where(wrong, side * past, 0.0)
            turned = -side if before is None else _sign(away - before)
            approach = np.where(wrong & (turned != 0.0), turned, np.where(wrong, -side, side))
            stops.append((i, f"{RUN_UP}p{i + 1}", away, approach))
        stops.append((i, f"p{i + 1}", q, side))
        before = q
    numbers, names, q, approach = zip(*stops, strict=True)
    read = np.array([not name.startswith(RUN_UP) for name in names])
    return replace(rows.some(numbers), pose=names, q=np.array(q), approach=np.array(approach), measured=read)


def _sign(change: Array) -> Array:
    return np.where(np.abs(change) > STILL, np.sign(change), 0.0)


@checked_kinds
def write_plan(found: Plan | RequestedRows, path: str | Path) -> Path:
    """Write the rows as a measurements.csv whose positions are still empty; whole or not at all.

    It holds pose, session, payload, q_*, what effects depend on, x y z to be filled in, and sigma, in the units of the
    campaign that it is planned after, else in SI; positions end where no drive resolves them. Stops whose pose begins
    with `to ` stay empty. What a row is worth is not a column: in the campaign that the file becomes, `trace`
    would look at it as a cause.
    """
    rows, reach = found.rows, found.reach
    columns: dict[str, list] = {name: list(getattr(rows, name)) for name in ("pose", "session", "payload")}
    for i, joint in enumerate(reach.arm.robot.moving):
        name, values = f"q_{joint.name}", rows.q[:, i]
        unit, factor = _unit(found, name, "length" if joint.kind == "prismatic" else "angle")
        # Resolution of a joint position in a file [m, rad], at least.
        digits = int(np.floor(1e-9 - np.log10(1e-6 / factor)))
        # Rounded towards the middle at its limits.
        inside = np.round(0.1**digits, digits) * np.ceil(np.array([joint.lower, -joint.upper]) / factor * 10.0**digits)
        rounded = np.clip(np.round(values / factor, digits), inside[0], -inside[1])
        columns[name + unit] = np.round(rounded, digits).tolist()
    for joint in reach.approached:
        columns[f"approach_{joint}"] = rows.approach[:, rows.joint_names.index(joint)].astype(int).tolist()
    given = _levels(rows)
    columns |= {name: [""] * len(rows) if name in reach.blank else given[name].tolist() for name in reach.levels}
    for name, sensor in reach.arm.sensors.items():
        if name in reach.touching:
            pairs = zip(rows.covariates[name], rows.measured.tolist(), strict=True)
            columns[name] = [socket if read else "" for socket, read in pairs]
            continue
        columns |= {column: [""] * len(rows) for column in sensor.kind.columns(name) if name in reach.read}
    if "" not in reach.read:
        return write_table(path, columns)
    columns |= {axis + _unit(found, axis, "length")[0]: [""] * len(rows) for axis in "xyz"}
    same = (reach.sigma == reach.sigma[0]).all()
    sigma = (
        {"sigma": reach.sigma[0]} if same else dict(zip(("sigma_x", "sigma_y", "sigma_z"), reach.sigma, strict=True))
    )
    for name, value in sigma.items():
        unit, factor = _unit(found, name if name in found.units else "sigma", "length")
        columns[name + unit] = [float(f"{value / factor:.3g}")] * len(rows)
    return write_table(path, columns)


def _unit(planned: Plan | RequestedRows, column: str, kind: str) -> tuple[str, float]:
    """Return the suffix and the factor of a column's unit in the campaign before, '' and 1 for SI."""
    unit = planned.units.get(column, "")
    return (f"_{unit}", UNITS[kind][unit]) if unit else ("", 1.0)
