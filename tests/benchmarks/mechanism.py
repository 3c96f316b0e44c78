"""What the bundled machines with loops take, beside their own chains with the loops cut and passive joints driven,
without springs and with them.

python tests/benchmarks/mechanism.py
"""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import armflex
from armflex.mechanics.response import respond
from armflex.robot.linkage import Linkage

ROBOTS = Path(__file__).parents[2] / "robots"


def milliseconds(ask: Callable[[int], object], rows: int) -> float:
    """Return the CPU time of a question [ms], the least of five rounds through all rows, forth and back."""
    order, best = [*range(rows), *range(rows - 1, -1, -1)], np.inf
    for _ in range(5):
        start = time.process_time()
        for i in order:
            ask(i)
        best = min(best, (time.process_time() - start) / len(order))
    return 1e3 * best


def measured(arm: armflex.Arm, q: np.ndarray) -> list[float]:
    """Return the time of a query, of a prepared one, and of a row of a batch and of a linearised one [ms]."""
    many, prepared = np.concatenate([q, q[::-1]] * 5), arm.prepared()
    arm.deflection(many)
    respond(arm, many, ["none"])
    single = milliseconds(lambda i: arm.deflection(q[i]).displacement, len(q))
    quick = milliseconds(lambda i: prepared(q[i]), len(q))
    batch = milliseconds(lambda i: arm.deflection(many).displacement, 1) / len(many)
    return [single, quick, batch, milliseconds(lambda i: respond(arm, many, ["none"]), 1) / len(many)]


def main() -> None:
    print(
        f"{'ms of CPU time':25s}" + "".join(f"{what:>11s}" for what in ("query", "prepared", "batch row", "linearised"))
    )
    for name in ("palletizer", "hybrid_lifter"):
        arm = armflex.load_arm(ROBOTS / name / "arm.toml")
        path, linkage = armflex.read_trajectory(ROBOTS / name / "trajectory.csv", arm), arm.robot.linkage
        passive = [arm.deflection(row).passive for row in path.q]
        chain = {joint.name for joint in arm.robot.chain}
        locked = {joint.name: 0.0 for joint in linkage.beside}
        bends = tuple(one for one in arm.flexures if one.joint in chain)
        sprung = replace(arm, robot=replace(arm.robot, linkage=Linkage(), locked=locked), flexures=bends)
        cut = replace(sprung, springs=())
        known = [
            dict(zip(arm.joint_names, row.tolist(), strict=True)) | own
            for row, own in zip(path.q, passive, strict=True)
        ]
        q = np.array([[row[joint] for joint in cut.joint_names] for row in known])
        lines = {name: (arm, path.q), f"{name}, cut": (cut, q)}
        lines |= {f"{name}, cut, springs": (sprung, q)} if arm.springs else {}
        for what, asked in lines.items():
            print(f"{what:25s}" + "".join(f"{one:11.4f}" for one in measured(*asked)))


if __name__ == "__main__":
    main()
