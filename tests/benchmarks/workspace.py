"""Configurations of a workspace map for each second: in one process and in two, and what the counting costs.

OPENBLAS_NUM_THREADS=1 python tests/benchmarks/workspace.py [ROWS]
"""

import resource
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from baseline import machine, medians_us, rigid_baseline

from armflex import bundled_robot, load_arm, map_workspace
from armflex.configurations import Configurations

ROUNDS = 3


def seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def main(rows: int = 1 << 15) -> None:
    warnings.simplefilter("ignore")
    arm = load_arm(bundled_robot("tarm_like") / "arm.toml")
    (q,) = Configurations(arm.robot.lower, arm.robot.upper, rows, 0, 1 << 20).chunks()
    calls = {
        "deflection(Q) alone": lambda: arm.deflection(q, "p600"),
        "map": lambda: map_workspace(arm, "p600", rows=rows),
        "map without uncertainty": lambda: map_workspace(arm, "p600", rows=rows, uncertainty=False),
        "map, two processes": lambda: map_workspace(arm, "p600", rows=rows, jobs=2),
    }
    arm.deflection(q[:8], "p600")
    times = {name: min(seconds(call) for _ in range(ROUNDS)) for name, call in calls.items()}
    loop = medians_us({"baseline": rigid_baseline(arm)})["baseline"]
    print(machine())
    print(f"{rows} configurations; a Python loop over pin.rnea + computeJointJacobians takes {loop:.2f} us each")
    for name, spent in times.items():
        print(f"{name:26s}{rows / spent:10.0f} a second{spent / rows * 1e6 / loop:8.2f} times the loop")
    print(f"largest resident set {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
