"""The boom whose joints were learned from finite elements, against finite elements at the tip.

200 poses and payloads that no law was trained on. `examples/boom` meshes the joints, solves their loads, trains the
laws and makes the tips; this compares, with linear fits to the same tables in place of the networks as well.
"""

import csv
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

import armflex
from armflex.laws import Row
from armflex.laws.joint.linear import LinearLaw

TABLES = Path(__file__).parent / "boom" / "tables"


def linear_fits(arm: armflex.Arm) -> armflex.Arm:
    """Return the arm with full linear laws, fitted to the rows that its networks were trained on."""
    flexures = []
    for flexure in arm.flexures:
        if flexure.name != "M1":  # which is linear
            rows = armflex.read_joint_data(TABLES / f"{flexure.name}.csv")
            fitted = np.linalg.lstsq(rows.loads, rows.deflections, rcond=None)[0]
            flexure = replace(flexure, law=LinearLaw(0.5 * (fitted + fitted.T)))
        flexures.append(flexure)
    return replace(arm, flexures=tuple(flexures))


def main() -> dict[str, float]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        arm = armflex.load_arm(armflex.bundled_robot("tarm_like") / "learned.toml")
    with (TABLES / "tips.csv").open() as file:
        rows = list(csv.DictReader(file))
    q = np.array([[float(row[f"q_{name}"]) for name in arm.joint_names] for row in rows])
    tips = np.array([[float(row[axis]) for axis in "xyz"] for row in rows])
    found = {}
    for name, one in (("learned", arm), ("linear", linear_fits(arm))):
        began = time.process_time()
        deflections = [one.deflection(at, row["payload"]) for at, row in zip(q, rows, strict=True)]
        took = (time.process_time() - began) / len(rows)
        errors = np.array([tip - d.pose.translation for tip, d in zip(tips, deflections, strict=True)])
        sags = [np.linalg.norm(d.displacement[:3]) for d in deflections]
        found[name] = float(np.sqrt((errors**2).sum(axis=1).mean()))
        worst = np.linalg.norm(errors, axis=1).max()
        print(f"{name}: RMS {found[name] * 1e3:.2f} mm, worst {worst * 1e3:.2f} mm, ", end="")
        print(f"of a sag of {np.mean(sags) * 1e3:.0f} mm (up to {max(sags) * 1e3:.0f}); {took * 1e6:.0f} us a query")
        if name == "learned":
            stds = np.array([np.sqrt(np.diag(d.covariance)[:3]) for d in deflections])
            found["covered"] = float((np.abs(errors) < 1.96 * stds).mean())
            print(f"  {found['covered']:.1%} of x, y, z inside the 95 % band; share of each joint in its variance:")
            variance = np.zeros(len(arm.flexures))
            for at, d in zip(q, deflections, strict=True):
                gains = (d.flexure_jacobian @ np.linalg.inv(d.tangent)).reshape(6, -1, 6)[:3]  # loads follow the motion
                row = Row(at, {name: i for i, name in enumerate(arm.joint_names)})
                for i, flexure in enumerate(arm.flexures):
                    own = flexure.law.covariance(d.wrenches[i], row)
                    variance[i] += np.trace(gains[:, i] @ own @ gains[:, i].T)
            found["explained"] = float(variance.sum() / (stds**2).sum())
            for flexure, share in zip(arm.flexures, variance / variance.sum(), strict=True):
                found[flexure.name] = float(share)
                print(f"    {flexure.name}: {share:.1%}")
    return found


if __name__ == "__main__":
    main()
