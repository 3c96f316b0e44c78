"""The rows as they are driven: with little motion, and past a pose first where the side counts that it comes from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from armflex.conventions import Array
from armflex.plan.offer import OVERSHOOT, Reach
from armflex.plan.order import driving_order, motion
from armflex.rows import Rows
from armflex.rows.rows import STILL

RUN_UP = "to "
"""How the pose of a stop begins that is only there to come from the right side."""


def driven(rows: Rows, reach: Reach, start: Array) -> tuple[Rows, list[int], tuple[float, float]]:
    """Return all stops in order, which of (n,) rows are read in turn, and the way in that order and as they were given.

    Between two stops each joint is taken to go straight. Where an effect depends on the side that a joint comes from
    and the way there comes from the other, a stop at which nothing is read goes before: the pose, with that joint past
    it. The way is that of all joints together in ranges, such stops left out.
    """
    groups, span = _groups(rows, reach), np.maximum(reach.upper - reach.lower, STILL)
    order = driving_order(rows.q[groups], [_group(rows, reach, i) for i in groups], start, span)
    read = [int(groups[i]) for i in order]
    way = motion(rows.q[read], start, span), motion(rows.q, start, span)
    return _with_run_ups(rows.some(read), reach), read, way


def _group(rows: Rows, reach: Reach, i: int) -> tuple:
    """Return what takes long to change: covariates first, then the payload."""
    known = {**rows.covariates, "hold": rows.hold, "time": rows.time}
    return (*(float(known[name][i]) for name in reach.levels), rows.payload[i])


def _groups(rows: Rows, reach: Reach) -> np.ndarray:
    """Return the rows' numbers, those of one group together; the payload stays where a covariate changes."""
    groups = [_group(rows, reach, i) for i in range(len(rows))]
    conditions = sorted({group[:-1] for group in groups})
    payloads = [name for name in reach.payloads if name in rows.payload]
    wanted = [
        (*condition, payload)
        for number, condition in enumerate(conditions)
        for payload in (payloads if number % 2 == 0 else payloads[::-1])
    ]
    return np.array([i for group in wanted for i in range(len(rows)) if groups[i] == group])


def _with_run_ups(rows: Rows, reach: Reach) -> Rows:
    """Return named rows with the stops between them at which nothing is read."""
    chosen = np.isin(reach.arm.joint_names, reach.approached)
    past = OVERSHOOT * (reach.upper - reach.lower)
    stops: list[tuple[int, Array, Array]] = []  # row, position, approach; the row's own where it is read
    names: list[str] = []
    before = None
    for i, (q, side) in enumerate(zip(rows.q, rows.approach, strict=True)):
        came = np.zeros(len(q)) if before is None else _sign(q - before)
        wrong = chosen & (came != side)
        if wrong.any():
            away = q - np.where(wrong, side * past, 0.0)
            stops.append((i, away, _sided(away, before, wrong, side)))
            names.append(f"{RUN_UP}p{i + 1}")
        stops.append((i, q, side))
        names.append(f"p{i + 1}")
        before = q
    found = rows.some([i for i, _, _ in stops])
    read = np.array([not name.startswith(RUN_UP) for name in names])
    q, approach = (np.array([stop[place] for stop in stops]) for place in (1, 2))
    return replace(found, pose=tuple(names), q=q, approach=approach, measured=read)


def _sided(away: Array, before: Array | None, wrong: np.ndarray, side: Array) -> Array:
    """Return from which side the joints come to a stop before a row, as for the row where that is not wrong."""
    came = -side if before is None else _sign(away - before)
    return np.where(wrong & (came != 0.0), came, np.where(wrong, -side, side))


def _sign(change: Array) -> Array:
    return np.where(np.abs(change) > STILL, np.sign(change), 0.0)
