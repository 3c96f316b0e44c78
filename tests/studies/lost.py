"""Calibrate campaigns with two rows exchanged and one reading far off, and count which give a result.

python tests/studies/lost.py --draws 100
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.lost_campaign import write_arm, write_campaign

from armflex import calibrate, load_arm, read_measurements
from armflex.errors import ArmflexError


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--draws", type=int, default=100)
    draws, seconds, errors, named, failed = asked.parse_args().draws, list[float](), list[float](), 0, 0
    for seed in range(draws):
        with tempfile.TemporaryDirectory() as folder:
            arm = load_arm(write_arm(Path(folder)))
            path, wrong = write_campaign(Path(folder), seed)
            campaign, begun = read_measurements(path, arm), time.process_time()
            try:
                found = calibrate(arm, campaign)
            except ArmflexError as error:
                failed += 1
                print(seed, type(error).__name__, str(error)[:70])
            else:
                named += {one.row for one in found.outliers} == wrong and found.left_out == 3
                errors.append((found.held_out or (np.nan, np.nan))[1])
            seconds.append(time.process_time() - begun)
    print(f"{draws - failed} of {draws} give a result, {named} leave out the three rows that are wrong and no other")
    print(f"poses held out {1e3 * np.median(errors):.3f} mm, the worst {1e3 * max(errors):.3f} mm")
    print(f"{np.median(seconds):.1f} s of CPU, the longest {max(seconds):.1f} s")


if __name__ == "__main__":
    main()
