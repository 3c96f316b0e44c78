"""Interleaved timing against Pinocchio's own calls on the rigid arm, in one process."""

import os
import platform
import time
from collections.abc import Callable, Mapping
from importlib.metadata import version

import numpy as np
import pinocchio as pin

from armflex import Arm
from armflex.mechanics.pinocchio_model import build_model

TURN = 1e-3
"""How long a call's turn lasts [s]: long enough to fill the caches anew, short enough to be seldom interrupted."""


def rigid_baseline(arm: Arm) -> Callable[[], object]:
    """Return `pin.rnea + pin.computeJointJacobians` on the rigid arm at zero, as one call."""
    model = build_model(arm.robot).model
    data, q, v = model.createData(), np.zeros(model.nq), np.zeros(model.nv)
    return lambda: (pin.rnea(model, data, q, v, v), pin.computeJointJacobians(model, data, q))


def medians_us(
    calls: Mapping[str, Callable[[], object]],
    rounds: int = 30,
    repeats: int | None = 40,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, float]:
    """Return the median time of each call [us]; the calls take turns so that a busy machine hits all alike.

    Where some calls take a thousand times as long as others, `repeats` None gives each a turn of about `TURN`, and
    `time.process_time` as the clock keeps other programs from counting more in a long turn than in a short one.
    """
    quickest = {name: min(seconds(call, 1, clock) for _ in range(5)) for name, call in calls.items()}
    counts = {name: repeats or max(2, round(TURN / quickest[name])) for name in calls}
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            times[name].append(seconds(call, counts[name], clock) * 1e6)
    return {name: float(np.median(values)) for name, values in times.items()}


def seconds(call: Callable[[], object], repeats: int, clock: Callable[[], float]) -> float:
    """Return the mean time of a call [s]."""
    start = clock()
    for _ in range(repeats):
        call()
    return (clock() - start) / repeats


def machine() -> str:
    """Return the machine and the versions that a figure belongs to."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("armflex", "pin", "numpy"))
    return f"{os.cpu_count()} cores {platform.machine()}, Python {platform.python_version()}, {packages}"
