"""100 000 configurations of a boom of eight joints, against a Python loop over Pinocchio's own calls on the rigid arm.

OPENBLAS_NUM_THREADS=1 python tests/benchmarks/batch.py
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from baseline import machine, rigid_baseline
from boom import make_boom
from query import arms

from armflex import ensemble
from armflex.batch import bending
from armflex.batch import solver as batch_solver

ROWS, ROUNDS, DRAWS = 100_000, 5, 100


@contextmanager
def by(way: str):
    """Let batches be answered by compiled code, where numba is installed, or by numpy."""
    if way == "numba":
        yield
        return
    with mock.patch.object(batch_solver, "compiled", lambda: bending):
        yield


def seconds(call: Callable[[], object]) -> float:
    """Return how long a call takes [s]: of the processor, so that other programs count less."""
    start = time.process_time()
    call()
    return time.process_time() - start


def main() -> None:
    print(machine())
    ways = ["numpy"] + ["numba"] * (batch_solver.compiled() is not bending)
    with tempfile.TemporaryDirectory() as folder:
        boom = make_boom(Path(folder), drives_only=False, sag=0.03)
    base, known = rigid_baseline(boom.arm), arms(boom)
    lower, upper = (np.clip(limit, -1.5, 1.5) for limit in (boom.arm.robot.lower, boom.arm.robot.upper))
    q = np.random.default_rng(0).uniform(lower, upper, (ROWS, len(lower)))
    print(f"{'laws':>10} {'method':>12} {'':>6} {'x the speed of the loop':>24}")
    for name in ("linear", "networks"):
        for method in ("first_order", "exact"):
            for way in ways:
                with by(way):
                    known[name].deflection(q[:5000], method=method)
                    rates = []
                    for _ in range(ROUNDS):
                        loop = seconds(lambda: [base() for _ in range(ROWS // 10)]) * 10
                        rates.append(loop / seconds(lambda n=name, m=method: known[n].deflection(q, method=m)))
                print(f"{name:>10} {method:>12} {way:>6} {np.median(rates):24.2f}")
    shared(known, q)
    drawn(boom.arm, q[:2000])


def shared(known: dict, q: np.ndarray) -> None:
    """Print the gain of two processes, by the clock."""
    arm, times = known["networks"], {}
    for jobs in (1, 2):
        arm.deflection(q, jobs=jobs)
        start = time.perf_counter()
        arm.deflection(q, jobs=jobs)
        times[jobs] = time.perf_counter() - start
    print(f"\nnetworks, exact, two processes: {times[1] / times[2]:.2f} times as fast as one")


def drawn(arm: object, q: np.ndarray) -> None:
    """Print what draws cost beside as many batches, each of one query."""
    for method in ("first_order", "exact"):
        one = np.median([seconds(lambda m=method: arm.deflection(q, method=m)) for _ in range(ROUNDS)])
        single = (
            seconds(lambda m=method: [arm.deflection(row, method=m).displacement for row in q[:200]]) * len(q) / 200
        )
        many = np.median([seconds(lambda m=method: ensemble(arm, q, draws=DRAWS, method=m)) for _ in range(3)])
        print(
            f"{DRAWS} draws, {method}: {many / one:.0f} batches of one query, {many / single:.1f} times single queries"
        )


if __name__ == "__main__":
    main()
