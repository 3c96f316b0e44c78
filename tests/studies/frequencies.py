"""What ten frequencies add to thirty positions: masses of links on machines that MuJoCo simulates.

python tests/studies/frequencies.py [MACHINES]
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.sprung_campaign import declared, machine

from armflex import calibrate


def main(count: int) -> None:
    """Print standard deviations, errors and coverage of the logarithms of masses, without and with frequencies."""
    arm = declared()
    found: dict[str, list[tuple[float, float]]] = {"positions": [], "and frequencies": []}
    for seed in range(100, 100 + count):
        *campaigns, truth = machine(arm, seed)
        for (title, own), campaign in zip(found.items(), campaigns, strict=True):
            fitted = calibrate(arm, campaign, anyway=True).parameters
            own += [(one.value - truth[one.name], one.std) for one in fitted if one.name in truth]
            print(seed, title, flush=True)
    for title, own in found.items():
        errors, stds = np.array(own).T
        inside = np.abs(errors) < 1.96 * stds
        print(f"{title}: std {np.sqrt((stds**2).mean()):.4f}, RMS error {np.sqrt((errors**2).mean()):.4f}, ", end="")
        print(f"median error {np.median(np.abs(errors)):.4f}, {inside.mean():.1%} within 1.96 std")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
