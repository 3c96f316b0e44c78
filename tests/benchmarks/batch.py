"""100 000 configurations of a boom of eight joints, against a Python loop over Pinocchio's own calls on the rigid arm.

OPENBLAS_NUM_THREADS=1 python tests/benchmarks/batch.py
"""

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from baseline import machine, rigid_baseline
from boom import make_boom
from query import arms

from armflex import Arm, Wrench, ensemble
from armflex.laws import LinearLaw
from armflex.mechanics.response import respond

ROWS, ROUNDS, DRAWS = 100_000, 5, 100


def seconds(call: Callable[[], object]) -> float:
    """Return how long a call takes [s]: of the processor, so that other programs count less."""
    start = time.process_time()
    call()
    return time.process_time() - start


def main() -> None:
    print(machine())
    with tempfile.TemporaryDirectory() as folder:
        boom = make_boom(Path(folder), drives_only=False, sag=0.03)
    base, known = rigid_baseline(boom.arm), arms(boom)
    lower, upper = (np.clip(limit, -1.5, 1.5) for limit in (boom.arm.robot.lower, boom.arm.robot.upper))
    q = np.random.default_rng(0).uniform(lower, upper, (ROWS, len(lower)))
    force = {"wrenches": [Wrench("tool", [300.0, -200.0, 100.0], [0.0, 0.0, 0.0])]}
    print(f"{'laws':>12} {'':>8} {'x the speed of the loop':>24}")
    for name, given in (("linear", {}), ("networks", {}), ("a curved law", {}), ("linear", force)):
        arm, rates = known[name], []
        arm.deflection(q[:5000], **given)
        for _ in range(ROUNDS):
            loop = seconds(lambda: [base() for _ in range(ROWS // 10)]) * 10
            rates.append(loop / seconds(lambda a=arm, g=given: a.deflection(q, **g)))
        print(f"{name:>12} {'a force' if given else '':>8} {np.median(rates):24.2f}")
    linearised(known, q[:4000], base)
    shared(known, q)
    followed(known["linear"], q[:2000])
    drawn(boom.arm, q[:2000])


def linearised(known: dict, q: np.ndarray, base: Callable[[], object]) -> None:
    """Print what a fit pays for a row: the equilibrium and how the tip responds to laws, joints and every site."""
    loop = seconds(lambda: [base() for _ in range(20_000)]) / 20_000

    def everything(arm: Arm) -> None:
        found = respond(arm, q, ["none"] * len(q))
        _ = found.tip, found.joints, found.twists, found.wrenches

    for name in ("linear", "networks", "a curved law"):
        respond(known[name], q[:10], ["none"] * 10)
        solved = np.median([seconds(lambda n=name: respond(known[n], q, ["none"] * len(q))) for _ in range(ROUNDS)])
        whole = np.median([seconds(lambda n=name: everything(known[n])) for _ in range(ROUNDS)])
        each = (1e6 * part / len(q) for part in (solved, whole))
        print(
            f"{name}: {'; '.join(f'{us:.1f} us, {us * 1e-6 / loop:.1f} x the loop' for us in each)}, a row linearised"
        )


def shared(known: dict, q: np.ndarray) -> None:
    """Print what two cores gain, by the clock, and what both together spend on it: on an idle machine half of that."""
    for name in ("linear", "networks"):
        clock, spent = {}, {}
        for jobs in (1, 2) * ROUNDS:
            start, begun = time.perf_counter(), time.process_time()
            known[name].deflection(q, jobs=jobs)
            clock.setdefault(jobs, []).append(time.perf_counter() - start)
            spent.setdefault(jobs, []).append(time.process_time() - begun)
        gain, cost = np.median(clock[1]) / np.median(clock[2]), np.median(spent[2]) / np.median(spent[1])
        print(f"{name}, exact, jobs=2: {gain:.2f} times as fast as one, for {cost:.2f} times the processor's time")


def followed(arm: Arm, q: np.ndarray) -> None:
    """Print what shares and covariances of a batch take beside those of its rows."""
    for one in arm.flexures:
        assert isinstance(one.law, LinearLaw)
    flagged = tuple(replace(one, law=replace(one.law, relative_std=0.1)) for one in arm.flexures)
    arm = replace(arm, flexures=flagged)
    for name in ("contributions", "covariance"):
        found = arm.deflection(q)
        many = seconds(lambda found=found, name=name: getattr(found, name)) / len(q)
        each = seconds(lambda found=found, name=name: [getattr(found.row(i), name) for i in range(200)]) / 200
        print(f"{name}: {1e6 * many:.0f} us a row in arrays, {each / many:.1f} times as fast as row by row")


def drawn(arm: object, q: np.ndarray) -> None:
    """Print what draws cost beside as many batches, each of one query."""
    one = np.median([seconds(lambda: arm.deflection(q)) for _ in range(ROUNDS)])
    single = seconds(lambda: [arm.deflection(row).displacement for row in q[:200]]) * len(q) / 200
    many = np.median([seconds(lambda: ensemble(arm, q, draws=DRAWS)) for _ in range(3)])
    print(f"{DRAWS} draws: {many / one:.0f} batches of one query, {many / single:.1f} times single queries")


if __name__ == "__main__":
    main()
