"""A campaign on a boom whose A4 turns 1.6 times as far as its mesh says.

    python loop.py FOLDER
    armflex trace FOLDER/arm.toml FOLDER/campaign.csv -o traced.toml
    armflex calibrate FOLDER/learn.toml FOLDER/campaign.csv -o learned_anew.toml

writes the campaign, and learned.toml as measured in base axes; learn.toml learns A4 anew from the tip's readings.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np

import armflex
from armflex.laws.law import Row

sys.path.insert(0, str(Path(__file__).parents[1]))

from boom.truth import JOINTS, PAYLOADS, Boom

ROBOT = armflex.bundled_robot("tarm_like")
ROWS, NOISE = 180, 1e-4
SOFTER = np.diag([1.0, 1.0, 1.0, 1.6, 1.6, 1.6])


def main(folder: Path) -> None:
    """Write arm.toml, learn.toml and campaign.csv."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        arm = armflex.load_arm(ROBOT / "learned.toml")
    boom, rng = Boom(ROBOT / "robot.urdf"), np.random.default_rng(4)
    places = {name: i for i, name in enumerate(JOINTS)}
    lower, upper = 0.85 * arm.robot.lower, 0.85 * arm.robot.upper
    lower[0], upper[0] = 2.5, 4.0
    q, payloads = rng.uniform(lower, upper, (ROWS, 7)), rng.choice(list(PAYLOADS), ROWS)
    lines = ["pose,session,time,payload," + ",".join(f"q_{name}" for name in JOINTS) + ",x,y,z,sigma"]
    for i, (at, payload) in enumerate(zip(q, payloads, strict=True)):
        twists = dict.fromkeys(JOINTS, np.zeros(6))
        for _ in range(6):
            pose, loads = boom.at(dict(zip(JOINTS, at, strict=True)), twists, PAYLOADS[payload])
            twists = {one.name: one.law.twist(loads[one.name], Row(at, places)) for one in arm.flexures}
            twists["A4"] = SOFTER @ twists["A4"]
        tip = pose[:3, 3] + rng.normal(0.0, NOISE, 3)
        cells = [f"p{i}", "s", str(60 * i), payload, *(f"{x:.9g}" for x in at), *(f"{x:.7f}" for x in tip), f"{NOISE}"]
        lines.append(",".join(cells))
    (folder / "campaign.csv").write_text("\n".join(lines) + "\n")
    text = (ROBOT / "learned.toml").read_text().replace('frame = "unknown"', 'frame = "base"')
    text = text.replace('"robot.urdf"', f'"{ROBOT}/robot.urdf"').replace('"learned_A', f'"{ROBOT}/learned_A')
    (folder / "arm.toml").write_text(text)
    (folder / "learn.toml").write_text(text.replace('learned_A4.safetensors"', 'learned_A4.safetensors"\nlearn = true'))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
