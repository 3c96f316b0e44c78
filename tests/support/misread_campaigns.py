"""Campaigns written in another convention than their arm's: what is done to them, and what should be said of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from armflex.arm import Arm, Prior
from armflex.errors import ConventionError
from armflex.estimate.misread import check_conventions
from armflex.laws.joint.carried import scaled
from armflex.measured.measurements import Measurements
from support.plant import Array


@dataclass(frozen=True)
class Fault:
    """A fault: how an arm and its campaign are written with it, and a part of what should be said of it."""

    named: str
    written: Callable[[Arm, Measurements], tuple[Arm, Measurements]]


def faults(arm: Arm) -> Iterator[Fault]:
    """Yield faults at joints two and three of an arm, which bend it under its own weight, and of tables and files."""
    joints = [joint.name for joint in arm.robot.moving if joint.kind != "prismatic"]
    one, other = joints[1], joints[2]
    i, j = (arm.joint_names.index(name) for name in (one, other))
    turning = [arm.joint_names.index(name) for name in joints]

    def swapped(q: Array) -> Array:
        return q[:, [j if k == i else i if k == j else k for k in range(q.shape[1])]]

    def factors(places: list[int], factor: float) -> Array:
        return np.where(np.isin(np.arange(len(arm.joint_names)), places), factor, 1.0)

    def of_joints(change: Callable[[Array], Array]) -> Callable[[Arm, Measurements], tuple[Arm, Measurements]]:
        return lambda arm, rows: (arm, replace(rows, q=change(rows.q)))

    quarter = np.where(np.arange(len(arm.joint_names)) == i, np.pi / 2.0, 0.0)
    yield Fault(f"the columns q_{one} and q_{other} are exchanged", of_joints(swapped))
    yield Fault(f"the sign of q_{one} is turned", of_joints(lambda q: q * factors([i], -1.0)))
    yield Fault(f"the home position of {one} is -90 degrees", of_joints(lambda q: q + quarter))
    yield Fault(f"q_{other} is in radians", of_joints(lambda q: q * factors([j], np.pi / 180.0)))
    yield Fault("the turning joints are in degrees", of_joints(lambda q: q * factors(turning, 180.0 / np.pi)))
    yield Fault("x, y, z are those of the row before", lambda arm, rows: (arm, late(rows)))
    yield Fault("sigma is in mm", lambda arm, rows: (arm, replace(rows, sigma=1e3 * rows.sigma)))
    masses = [payload.mass for payload in arm.payloads.values()]
    if max(masses, default=0.0) > 0.0:
        yield Fault("payload masses are in grams", lambda arm, rows: (heavier(arm, 1e3), rows))
    if max(masses, default=0.0) > 200.0:  # lighter ones hardly bend a stiff arm
        yield Fault("payload masses are in tonnes", lambda arm, rows: (heavier(arm, 1e-3), rows))
    if arm.flexures:  # a rigid arm is written with none
        yield Fault("the compliance is a thousand times too large", lambda arm, rows: (softer(arm, 1e3), rows))
        yield Fault("the compliance is a thousand times too small", lambda arm, rows: (softer(arm, 1e-3), rows))
    yield Fault("[prior] frees nothing", lambda arm, rows: (replace(arm, prior=Prior()), rows))


def late(rows: Measurements) -> Measurements:
    """Return readings each in the row after the one that they were taken in."""
    position, measured = np.array(rows.position), np.flatnonzero(rows.measured)
    position[measured] = np.roll(position[measured], 1, axis=0)
    return replace(rows, position=position)


def heavier(arm: Arm, factor: float) -> Arm:
    """Return an arm whose payloads are written with other masses."""
    return replace(arm, payloads={name: replace(one, mass=factor * one.mass) for name, one in arm.payloads.items()})


def softer(arm: Arm, factor: float) -> Arm:
    """Return an arm whose compliances are written with a factor."""
    each = np.full(6, np.sqrt(factor))
    return replace(arm, flexures=tuple(replace(one, law=scaled(one.law, each)) for one in arm.flexures))


def judged(arm: Arm, rows: Measurements) -> tuple[str, ...]:
    """Return what a campaign is said to have been misread as."""
    try:
        check_conventions(arm, rows, np.flatnonzero(rows.measured))
    except ConventionError as error:
        return error.names
    return ()
