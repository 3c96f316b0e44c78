"""Measured, the boom is not where the model says: find out what the model lacks, add it, and predict unseen poses."""

import numpy as np

import armflex


def error(arm: armflex.Arm, rows: armflex.Measurements) -> float:
    read = rows.measured
    away = armflex.predict(arm, rows).position[read] - rows.position[read]
    return float(np.sqrt((away**2).sum(axis=1).mean()))


def main() -> tuple[float, float]:
    folder = armflex.bundled_robot("tarm_like")
    arm = armflex.load_arm(folder / "measured.toml")
    campaign = armflex.read_measurements(folder / "campaign.csv", arm)
    held_out = armflex.read_measurements(folder / "held_out.csv", arm)  # poses that the fit does not see

    found = armflex.trace(arm, campaign)
    for one in found.found:
        values = {name: f"{value:.3g} ± {one.std.get(name, 0.0):.1g}" for name, value in one.effect.named.items()}
        print(f"{one.effect.title}: {values}")
    before, after = error(found.calibration.arm, held_out), error(found.arm, held_out)
    print(f"on held-out poses: calibrated {before * 1e3:.2f} mm, with what was found {after * 1e3:.2f} mm")
    return before, after


if __name__ == "__main__":
    main()
