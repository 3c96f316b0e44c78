"""What the engine takes of each kind of arm, as ratios to a Python loop over Pinocchio's own calls on the rigid boom.

A row of a batch on one thread, a row with all its sensitivities, a prepared call, and `arm.deflection(q)`.

OPENBLAS_NUM_THREADS=1 python tests/benchmarks/engine.py
"""

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from baseline import machine, medians_us, rigid_baseline
from boom import make_boom
from query import arms

from armflex import Arm, bundled_robot, load_arm, read_trajectory
from armflex.conventions import Array
from armflex.mechanics.response import respond

ROWS = 4096
GOALS = {
    "boom": (0.20, 6.0, 1.0, 12.0),
    "networks": (0.50, 6.6, 2.0, None),
    "six-axis": (0.14, 3.2, 0.8, None),
    "palletizer": (4.2, 2.0, None, None),
    "lifter": (2.2, 2.0, None, None),
}
"""Of a row, of its sensitivities, of a prepared call and of `arm.deflection`, where the loop takes 5 us; sensitivities
of loops are those beside the rest."""


def within(arm: Arm) -> Array:
    """Return (N, nq) positions between the limits [rad or m], at most 1.5 from the middle."""
    lower, upper = (np.clip(limit, -1.5, 1.5) for limit in (arm.robot.lower, arm.robot.upper))
    return np.random.default_rng(0).uniform(lower, upper, (ROWS, len(lower)))


def along(name: str, arm: Arm) -> Array:
    """Return (N, nq) positions of the path of a bundled machine, forth and back."""
    path = read_trajectory(bundled_robot(name) / "trajectory.csv", arm).q
    rounds = np.concatenate([path, path[::-1]])
    return np.tile(rounds, (-(-ROWS // len(rounds)), 1))[:ROWS]


def everything(arm: Arm, q: Array) -> None:
    """Ask for every row at rest and for all that its tip answers to."""
    respond(arm, q, ["none"], ask=("joints", "twists", "link_loads", "wrenches"))


def asked(arm: Arm, q: Array) -> dict[str, Callable[[], object]]:
    """Return the four questions; the first two are of all rows."""
    loop, some = arm.prepared(), q[:512]
    steps = iter(range(10**9))
    return {
        "row": lambda: arm.deflection(q),
        "sensitivities": lambda: everything(arm, some),
        "prepared": lambda: loop(some[next(steps) % len(some)]),
        "deflection": lambda: arm.deflection(some[next(steps) % len(some)]),
    }


def main() -> None:
    print(machine())
    with tempfile.TemporaryDirectory() as folder:
        boom = make_boom(Path(folder), drives_only=False, sag=0.03)
        kinds = arms(boom)
    machines = {"boom": kinds["linear"], "networks": kinds["networks"]}
    machines["six-axis"] = load_arm(bundled_robot("heavy_six") / "arm.toml")
    rows = {name: within(arm) for name, arm in machines.items()}
    for name, folder in (("palletizer", "palletizer"), ("lifter", "hybrid_lifter")):
        machines[name] = load_arm(bundled_robot(folder) / "arm.toml")
        rows[name] = along(folder, machines[name])
    calls: dict[tuple[str, ...], Callable[[], object]] = {("loop",): rigid_baseline(boom.arm)}
    for name, arm in machines.items():
        calls |= {(name, what): call for what, call in asked(arm, rows[name]).items()}
    times = medians_us(calls, rounds=9, repeats=None, clock=time.process_time)
    each = {"row": ROWS, "sensitivities": 512, "prepared": 1, "deflection": 1}
    print(f"the loop takes {times['loop',]:.2f} us; x the loop, and the goal:")
    print(f"{'':>12}" + "".join(f"{what:>22}" for what in each))
    for name in machines:
        line = ""
        for (what, count), goal in zip(each.items(), GOALS[name], strict=True):
            ratio = times[name, what] / count / times["loop",]
            line += f"{ratio:14.2f}" + (f" ({goal:.4g})" if goal else "").ljust(8)
        print(f"{name:>12}{line}")


if __name__ == "__main__":
    main()
