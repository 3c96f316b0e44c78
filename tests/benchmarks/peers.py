"""Where the same loaded boom comes to rest, by armflex and by what a user would pick instead, in one run.

    OPENBLAS_NUM_THREADS=1 python tests/benchmarks/peers.py

Eight joints in a bent posture, 8 springs (the drives) or 48 (six behind every joint), 30 and 280 mm of sag. Every
program starts from straight springs and ends with the tip's position. `off` is the distance of that from where Newton
with Pinocchio's derivatives puts it. armflex's flexures are `exp6`, not slides and hinges in series, so with six
springs at a joint its convention is another and `off` is the gap between the two; `in series` is armflex in the peers'.
`deflection` is the public call with its result object and its checks, `prepared` the object for control loops; only
these are asked with q, the peers' posture is built into their models. Times are the processor's.
"""

import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

import peer_solvers as peers
from baseline import machine, medians_us, rigid_baseline
from beam import frame_assembled, frame_solved
from boom import Boom, make_boom

from armflex import Arm
from armflex.conventions import Array

OWN, PREPARED = "armflex, deflection", "armflex, prepared"
SAGS = (0.03, 0.28)
SOLVERS: dict[str, Callable[[Boom], Callable[[], Array]]] = {
    "Pinocchio by hand, fixed point": peers.pinocchio_fixed_point,
    "Pinocchio by hand, Newton": peers.pinocchio_newton,
    "MuJoCo, fixed point by hand": peers.mujoco_fixed_point,
    "MuJoCo, stepped, 0.5 s": partial(peers.mujoco_stepped, damping=1.0, step=0.5),
    "MuJoCo, stepped, 1 s (best)": partial(peers.mujoco_stepped, damping=1.0, step=1.0),
    "Exudyn, static": peers.exudyn_static,
    "Exudyn, modified Newton": partial(peers.exudyn_static, modified=True),
    "beam FE, assembled and solved": frame_assembled,
    "beam FE, solved only": frame_solved,
}
CANNOT = {
    "Pinocchio by hand": "nothing but what the loop's author writes: here springs of one axis each",
    "MuJoCo": "a joint's spring has one axis (constant, or a polynomial in its own motion); a coupled 6 x 6 needs fixed"
    " tendons along its eigenvectors, trained laws need the user's own forces; rest is reached by stepping, damping and"
    " step to be found, or by the user's own loop",
    "Exudyn": "a joint's control gain has one axis; coupled and other laws need a user function",
    "beam FE": "first order only: loads do not turn with the arm; no laws; assembled anew for every posture (its own"
    " strength, links that bend along their length, is not used here)",
    "none of them": "loads held against what a law was trained on, whether the equilibrium is stable, the covariance of"
    " the tip, effects found in measurements",
}


def own_calls(boom: Boom) -> dict[str, Callable[[], Array]]:
    """Return armflex's ways to the tip's position."""

    def asked(arm: Arm, method: str) -> Callable[[], Array]:
        return lambda: arm.deflection(boom.q, method=method).pose.translation

    def prepared(method: str) -> Callable[[], Array]:
        loop, rigid = boom.arm.prepared(method=method), boom.arm.rigid_pose(boom.q).translation
        return lambda: rigid + loop(boom.q)[:3]

    calls = {OWN: asked(boom.arm, "exact"), PREPARED: prepared("exact")}
    if boom.freedoms > len(boom.stations):
        calls["armflex, in series"] = asked(boom.series, "exact")
    return calls


def peer_calls(boom: Boom) -> dict[str, Callable[[], Array] | None]:
    """Return the peers' calls, None for one that is not installed."""
    calls: dict[str, Callable[[], Array] | None] = {}
    for name, build in SOLVERS.items():
        try:
            calls[name] = build(boom)
        except ModuleNotFoundError:
            calls[name] = None
    return calls


def compare(boom: Boom) -> None:
    """Print a line for every program: how far off, and how long, beside the baseline and beside armflex."""
    exact = peers.pinocchio_newton(boom)()
    calls = own_calls(boom) | peer_calls(boom)
    here = {name: call for name, call in calls.items() if call is not None}
    timed = {"baseline": rigid_baseline(boom.arm), **here}
    times = medians_us(timed, rounds=40, repeats=None, clock=time.process_time)
    rigid = boom.arm.rigid_pose(boom.q).translation
    sag = np.linalg.norm(exact - rigid) * 1e3
    print(f"\n{boom.freedoms} springs, {sag:.1f} mm of sag; baseline {times['baseline']:.2f} us")
    print(f"{'':>32} {'off mm':>9} {'us':>8} {'x baseline':>10} {'x deflection':>12} {'x prepared':>10}")
    for name in calls:
        if name not in here:
            print(f"{name:>32} not installed: pip install 'armflex[bench]'")
            continue
        off = np.linalg.norm(here[name]() - exact) * 1e3
        of = [times[name] / times[other] for other in ("baseline", OWN, PREPARED)]
        print(f"{name:>32} {off:9.1e} {times[name]:8.1f} {of[0]:10.1f} {of[1]:12.2f} {of[2]:10.2f}")


def versions() -> str:
    """Return the peers' versions."""
    found = []
    for name in ("mujoco", "exudyn", "scipy"):
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            found.append(f"{name} not installed")
    return ", ".join(found)


def main() -> None:
    warnings.simplefilter("ignore")
    print(f"{machine()}, {versions()}")
    for drives_only in (True, False):
        for sag in SAGS:
            with tempfile.TemporaryDirectory() as folder:
                compare(make_boom(Path(folder), drives_only, sag))
    print("\nWhat they cannot express:")
    for name, text in CANNOT.items():
        print(f"{name}: {text}.")


if __name__ == "__main__":
    main()
