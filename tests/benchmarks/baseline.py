"""Interleaved timing against Pinocchio's own calls on the rigid arm, in one process."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Mapping
from importlib.metadata import version

import numpy as np
import pinocchio as pin

from armflex import Arm
from armflex.robot import build_model


def rigid_baseline(arm: Arm) -> Callable[[], object]:
    """Return `pin.rnea + pin.computeJointJacobians` on the rigid arm at zero, as one call."""
    model = build_model(arm.robot).model
    data, q, v = model.createData(), np.zeros(model.nq), np.zeros(model.nv)
    return lambda: (pin.rnea(model, data, q, v, v), pin.computeJointJacobians(model, data, q))


def medians_us(calls: Mapping[str, Callable[[], object]], rounds: int = 30, repeats: int = 40) -> dict[str, float]:
    """Return the median time of each call [us]; the calls take turns so that a busy machine hits all alike."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            start = time.perf_counter()
            for _ in range(repeats):
                call()
            times[name].append((time.perf_counter() - start) / repeats * 1e6)
    return {name: float(np.median(values)) for name, values in times.items()}


def machine() -> str:
    """Return the machine and the versions that a figure belongs to."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("armflex", "pin", "numpy"))
    return f"{os.cpu_count()} cores {platform.machine()}, Python {platform.python_version()}, {packages}"
