"""The engine and Newton's method side by side at 3, 30 and 300 mm of sag, against a Pinocchio baseline.

python tests/benchmarks/equilibrium.py
"""

import dataclasses
import sys
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from baseline import machine, medians_us, rigid_baseline

from armflex import Arm, bundled_robot, load_arm
from armflex.laws import LinearLaw, PositionDependentLaw
from armflex.mechanics.equilibrium import METHODS

PAYLOAD = "p600"


def softened(arm: Arm, factor: float) -> Arm:
    """Return the arm with every compliance multiplied by a factor."""
    flexures = []
    for flexure in arm.flexures:
        law = flexure.law
        if isinstance(law, LinearLaw):
            law = dataclasses.replace(law, compliance=factor * law.compliance)
        elif isinstance(law, PositionDependentLaw):
            law = dataclasses.replace(law, coefficients=factor * law.coefficients)
        flexures.append(dataclasses.replace(flexure, law=law))
    return dataclasses.replace(arm, flexures=tuple(flexures))


def with_sag(arm: Arm, sag: float) -> Arm:
    """Return the arm softened until its tip moves by `sag` [m], straight out with the payload."""
    factor = 1.0
    for _ in range(20):
        found = softened(arm, factor).deflection(np.zeros(len(arm.joint_names)), PAYLOAD, allow_large=True)
        factor *= sag / np.linalg.norm(found.displacement[:3])
    return softened(arm, factor)


def main() -> None:
    warnings.simplefilter("ignore")
    arm = load_arm(bundled_robot("tarm_like") / "arm.toml")
    q = np.zeros(len(arm.joint_names))
    print(machine())
    print(f"{'sag mm':>7} {'method':>12} {'tip error mm':>13} {'iterations':>10} {'x baseline':>10}")
    for sag in (0.003, 0.03, 0.3):
        soft = with_sag(arm, sag)
        found = {m: soft.deflection(q, PAYLOAD, method=m, allow_large=True) for m in METHODS}
        calls = {m: lambda m=m, soft=soft: soft.deflection(q, PAYLOAD, method=m, allow_large=True) for m in METHODS}
        times = medians_us({"baseline": rigid_baseline(soft), **calls})
        for method in reversed(METHODS):
            error = np.linalg.norm(found[method].displacement[:3] - found["newton"].displacement[:3])
            steps = max(len(found[method].residuals) - 1, 0)
            ratio = times[method] / times["baseline"]
            print(f"{sag * 1e3:7g} {method:>12} {error * 1e3:13.1e} {steps:10d} {ratio:10.1f}")


if __name__ == "__main__":
    main()
