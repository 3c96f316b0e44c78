"""Where the tip is by finite elements: twists of every joint composed by a solver that shares no code with armflex.

    python tip.py FOLDER

reads the loads and twists that truth.py wrote to FOLDER, and writes tips.csv, with which example 16 compares.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np

import armflex
from armflex.laws.law import Row

sys.path.insert(0, str(Path(__file__).parents[1]))

from boom.truth import JOINTS, PAYLOADS, Boom, rows

ROBOT = armflex.bundled_robot("tarm_like")


def truth(folder: Path) -> tuple[np.ndarray, list[str], np.ndarray]:
    """Return poses (N, 7), payloads, and the (N, 4, 4) tips by finite elements.

    Twists are moved from the loads that were solved to those of the deflected pose by the slope of a linear fit; with
    these the loads agree, and what is left out is the curvature over that small change.
    """
    q, payloads = rows(ROBOT)
    boom = Boom(ROBOT / "robot.urdf")
    known = {name: np.loadtxt(folder / f"{name}_truth.csv", delimiter=",") for name in JOINTS}
    slopes = {}
    for name in JOINTS[1:]:
        loads, twists = known[name][:, :6], known[name][:, 6:]
        slopes[name] = np.linalg.lstsq(np.c_[loads, np.ones(len(loads))], twists, rcond=1e-9)[0][:6].T
    tips = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        arm = armflex.load_arm(ROBOT / "learned.toml")
    for i, (one, payload) in enumerate(zip(q, payloads, strict=True)):
        at = dict(zip(JOINTS, one, strict=True))
        mast = arm.flexures[0].law.compliance(Row(one, {"M1": 0}))
        twists = {name: known[name][i, 6:] for name in JOINTS}
        for _ in range(4):
            pose, loads = boom.at(at, twists, PAYLOADS[payload])
            for name in JOINTS:
                slope = mast if name == "M1" else slopes[name]
                twists[name] = known[name][i, 6:] + slope @ (loads[name] - known[name][i, :6])
        tips.append(pose)
    return q, payloads, np.array(tips)


def main(folder: Path) -> None:
    """Write tips.csv: poses, payloads and the tip's place [m]."""
    q, payloads, tips = truth(folder)
    lines = ["payload," + ",".join(f"q_{name}" for name in JOINTS) + ",x,y,z"]
    for payload, one, tip in zip(payloads, q, tips, strict=True):
        lines.append(",".join([payload, *(f"{x:.9g}" for x in one), *(f"{x:.9f}" for x in tip[:3, 3])]))
    (folder / "tips.csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
