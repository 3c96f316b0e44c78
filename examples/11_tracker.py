"""A joint softens by 20 % while the arm is in use: a path compensated with the arm as calibrated, and as tracked.

The machine is simulated by armflex itself: the boom as declared, its A4 softer from reading to reading. An instrument
that is bolted to the base reads its tip.
"""

from dataclasses import replace

import numpy as np

import armflex
from armflex.arm import Measurement, Prior
from armflex.laws.joint.carried import scaled

READINGS, SIGMA, SOFTER = 300, 2e-4, 0.2
BOLTED = {"measurement": Measurement(frame="base"), "prior": Prior(joint_offset=1e-3, compliance=0.2, tool=5e-3)}


def softened(arm: armflex.Arm, part: float) -> armflex.Arm:
    """Return the arm with the compliance of A4 so much larger."""
    factor = np.full(6, np.sqrt(1.0 + part))
    flexures = [replace(one, law=scaled(one.law, factor)) if one.name == "A4" else one for one in arm.flexures]
    return replace(arm, flexures=tuple(flexures))


def missed(arm: armflex.Arm, machine: armflex.Arm, path: armflex.Trajectory) -> float:
    """Return how far [m] the machine's tip is from the worst via-point on a path that `arm` compensates."""
    fixed = armflex.compensate(arm, path).trajectory
    return max(
        float(np.linalg.norm(machine.deflection(q, payload).pose.translation - arm.rigid_pose(wanted).translation))
        for q, wanted, payload, via in zip(fixed.q, path.q, path.payload, path.via, strict=True)
        if via
    )


def follow(
    tracker: armflex.Tracker, machine: armflex.Arm, rows: armflex.Measurements, softer: np.ndarray, seed: int
) -> None:
    """Let the tracker read a machine whose A4 is as much softer at each of (N,) readings."""
    rng = np.random.default_rng(seed)
    for i, part in enumerate(softer):
        q, payload = rows.q[i % len(rows)], rows.payload[i % len(rows)]
        tip = softened(machine, part).deflection(q, payload).pose.translation
        tracker.update(armflex.Reading(q, tip + rng.normal(0.0, SIGMA, 3), SIGMA, payload))
        if tracker.stale:
            tracker.relinearise()


def main() -> tuple[float, float, float]:
    folder = armflex.bundled_robot("tarm_like")
    machine = replace(armflex.load_arm(folder / "measured.toml"), **BOLTED)
    rows = armflex.read_measurements(folder / "campaign.csv", machine)  # for the poses
    path = armflex.read_trajectory(folder / "trajectory.csv", machine)

    tracker = armflex.Tracker(machine, rates={"compliance": 0.004})  # any joint may: 7 % in 300 readings
    follow(tracker, machine, rows, np.zeros(READINGS), seed=1)
    calibrated = tracker.arm
    follow(tracker, machine, rows, np.linspace(0.0, SOFTER, READINGS), seed=2)

    worn = softened(machine, SOFTER)
    before = missed(calibrated, machine, path)
    without, tracked = missed(calibrated, worn, path), missed(tracker.arm, worn, path)
    print(f"worst via-point of the compensated path: {before * 1e3:.2f} mm off when calibrated;")
    print(
        f"A4 20 % softer: {without * 1e3:.2f} mm with the arm as it was calibrated, {tracked * 1e3:.2f} mm as tracked"
    )
    for label in ("compliance A4 ry", "compliance A4 rz"):
        i = tracker.labels.index(label)
        print(f"{label}: {np.expm1(tracker.values[i]):+.1%}, one sigma {tracker.std[i]:.1%}")
    return before, without, tracked


if __name__ == "__main__":
    main()
