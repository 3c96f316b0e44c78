"""A joint law of your own: layers of torch that turn loads into deflections, trained and put into the boom.

On the command line: `armflex train JOINT.csv --model torch --module 08_own_network.py:Bearing -o law.safetensors`.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

import armflex
from armflex.bench.learners import Options
from armflex.measured.joint_data import JointData


class Bearing(torch.nn.Sequential):
    """A small network of odd functions: pushed the other way, the bearing gives the other way."""

    def __init__(self) -> None:
        layers = torch.nn.Linear(3, 24, bias=False), torch.nn.Tanh(), torch.nn.Linear(24, 3, bias=False)
        super().__init__(*layers)


def bench(rows: int) -> JointData:
    """Return loads and deflections of a bearing that stiffens: d = C F (1 - 0.3 |F|^2), with 1 % noise."""
    rng = np.random.default_rng(0)
    loads = rng.uniform(-1.0, 1.0, (rows, 3))  # 10 kN
    exact = loads * [0.5, 0.5, 0.3] * (1.0 - 0.3 * np.square(loads).mean(axis=1, keepdims=True))  # mm
    measured = exact + 0.01 * exact.std() * rng.normal(size=exact.shape)
    return JointData(1e4 * loads, 1e-3 * measured, ("mm",) * 3, np.full(3, 1e-3), "", Path("made"))


def main() -> float:
    arm = armflex.load_arm(armflex.bundled_robot("tarm_like") / "arm.toml")
    trained = armflex.train(bench(100), "torch", options=Options(module=Bearing, starts=1))
    print(f"error on rows not seen: {trained.held_out_rms.round(4)} mm ({trained.held_out})")
    bearing = armflex.Flexure("A4 bearing", "A4", trained.trained.law)
    there = arm.position(A2=0.2, A4=-0.3)
    plain = arm.deflection(there, payload="p300")
    found = replace(arm, flexures=(*arm.flexures, bearing)).deflection(there, payload="p300")
    more = float(np.linalg.norm(found.displacement[:3] - plain.displacement[:3]))
    print(f"the bearing carries {found.wrenches[-1][:3].round()} N, gives {found.twists[-1][:3] * 1e3} mm,")
    print(f"and moves the tip by another {more * 1e3:.3f} mm ({found.method}, {len(found.residuals)} residuals)")
    return more


if __name__ == "__main__":
    main()
