"""One update of `armflex.Tracker` for 11, 29 and 101 parameters of a boom that sags 30 mm, and the slowest of many.

OPENBLAS_NUM_THREADS=1 python tests/benchmarks/tracker.py
"""

import itertools
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from baseline import machine, medians_us, rigid_baseline
from boom import Boom, make_boom

from armflex import Arm, Reading, Tracker
from armflex.conventions import TWIST_NAMES, Array
from armflex.laws.learned import Learning, learned_law, seen_in
from armflex.parameters import Certainty
from armflex.readings.instrument import Instrument

GOAL, CALLS, POSES, SIGMA = 500, 5000, 64, 2e-4
DRIFT = {"compliance": 1e-3, "law": 1e-3}


def tracked(boom: Boom, blocks: Sequence[str], compliances: Sequence[str], learned: Sequence[str]) -> Arm:
    """Return the boom as a calibration of some blocks would leave it, some flexures' laws learned with couplings."""
    wrenches, q = boom.arm.deflection(boom.q).wrenches, boom.q[None]
    row = boom.arm.loaded(None).row(q, {})
    flexures, free = [], {}
    for flexure, wrench in zip(boom.arm.flexures, wrenches, strict=True):
        if flexure.name in learned:
            law = learned_law(flexure.law, Learning("linear"), seen_in(flexure.law, wrench[None], row))
            free |= {f"law {flexure.name} {one.name}": 0.1 for one in law.parameters}
            flexure = replace(flexure, law=law)
        flexures.append(flexure)
    fixed = {f"instrument {axis}": 1e-4 for axis in TWIST_NAMES} | {f"tool {axis}": 1e-3 for axis in TWIST_NAMES[:3]}
    fixed |= {f"joint_offset {joint}": 1e-3 for joint in boom.arm.joint_names}
    fixed |= {f"compliance {name} {axis}": 0.1 for name in compliances for axis in TWIST_NAMES}
    std = {label: value for label, value in fixed.items() if label.split(" ")[0] in blocks} | free
    arm = replace(boom.arm, flexures=tuple(flexures), instrument=Instrument())
    return replace(arm, certainty=Certainty(arm.named(tuple(std)), np.diag(np.square(list(std.values())))))


def arms(boom: Boom) -> list[Arm]:
    every = boom.arm.joint_names
    some = ("tool", "joint_offset", "compliance")
    return [
        tracked(boom, ("tool", "joint_offset"), (), ()),
        tracked(boom, some, every[2:5], ()),
        tracked(boom, ("instrument", *some), (), every[2:6]),
    ]


def readings(arm: Arm, about: Array, shift: float = 0.0) -> list[Reading]:
    """Return noisy readings of poses about a posture; with a shift, of an arm whose third drive stands elsewhere."""
    rng, found = np.random.default_rng(1), []
    for _ in range(POSES):
        q = about + rng.uniform(-0.5, 0.5, len(about))
        moved = q + shift * np.eye(len(q))[2]
        tip = tip_of(arm, moved)
        found.append(Reading(q, tip + rng.normal(0.0, SIGMA, 3), SIGMA))
    return found


def tip_of(arm: Arm, q: Array) -> Array:
    """Return the (3,) place of the bent arm's tip."""
    return arm.rigid_pose(q).translation + arm.deflection(q).displacement[:3]


def ratios(boom: Boom) -> None:
    calls: dict[str, Callable[[], object]] = {"baseline": rigid_baseline(boom.arm), "prepared": prepared(boom)}
    for arm in arms(boom):
        count = len(arm.certainty.labels)
        for name, rates in (("", {}), (" drifting", drift(arm))):
            tracker, rows = Tracker(arm, rates), itertools.cycle(readings(arm, boom.q))
            calls[f"{count} parameters{name}"] = updates(tracker, rows)
    times = medians_us(calls, rounds=30, repeats=None, clock=time.process_time)
    print(f"{'':>28} {'x baseline':>10} {'goal':>5}   ({times['baseline']:.1f} us)")
    for name, value in list(times.items())[1:]:
        print(f"{name:>28} {value / times['baseline']:10.1f} {GOAL if 'parameters' in name else '':>5}")


def prepared(boom: Boom) -> Callable[[], object]:
    loop = boom.arm.prepared()
    return lambda: loop(boom.q)


def drift(arm: Arm) -> dict[str, float]:
    kinds = {label.split(" ")[0] for label in arm.certainty.labels}
    return {name: rate for name, rate in DRIFT.items() if name in kinds} or {"tool": 1e-6}


def updates(tracker: Tracker, rows: Iterator[Reading]) -> Callable[[], object]:
    return lambda: tracker.update(next(rows))


def slowest(boom: Boom, arm: Arm) -> None:
    """Print the quantiles of many updates, and the slowest while a joint stands elsewhere than before."""
    tracker, baseline = Tracker(arm, drift(arm)), rigid_baseline(arm)
    unit = medians_us({"baseline": baseline})["baseline"]
    quiet = [timed(tracker, row) / unit for row in itertools.islice(itertools.cycle(readings(arm, boom.q)), CALLS)]
    jump = [timed(tracker, row) / unit for row in readings(arm, boom.q, 1e-3)[:20]]
    p50, p99, p999 = np.quantile(quiet, [0.5, 0.99, 0.999])
    names = ", ".join(f"{change.name} after {change.reading - CALLS}" for change in tracker.changes)
    print(
        f"{len(tracker.labels):4} parameters, {CALLS} updates with drift, CPU time x baseline: half within {p50:.0f},"
        f" 99 % {p99:.0f}, 99.9 % {p999:.0f}, all {max(quiet):.0f}; then a jump ({names}): all within {max(jump):.0f}"
    )


def timed(tracker: Tracker, row: Reading) -> float:
    """Return the CPU time of an update [us]: what other programs take is not its own."""
    start = time.thread_time_ns()
    tracker.update(row)
    return (time.thread_time_ns() - start) / 1e3


def main() -> None:
    print(machine())
    with tempfile.TemporaryDirectory() as folder:
        boom = make_boom(Path(folder), drives_only=False, sag=0.03)
    ratios(boom)
    print()
    for arm in arms(boom):
        slowest(boom, arm)


if __name__ == "__main__":
    main()
