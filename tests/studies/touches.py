"""Touches, scored as the authors of MUKCa score them (Franzese et al., arXiv 2503.12584).

    python tests/studies/touches.py DIR [--fit PLACE]

DIR has an arm.toml with an instrument of `kind = "touch"`, and a touches.csv whose column `place` says where the block
of sockets stood. The arm is calibrated with the touches at one place. At every other place each socket's touches should
be one point: the score is the mean distance of the touching point from the mean of its socket. Distances between
sockets, which the fit has not seen there, are compared with the one that is declared.
"""

import argparse
import warnings
from pathlib import Path

import numpy as np

import armflex
from armflex.arm import Arm
from armflex.estimate.calibrate import calibrate
from armflex.measured.measurements import Measurements, read_measurements
from armflex.readings import Touch
from armflex.tasks.predict import predict


def scored(arm: Arm, rows: Measurements, fitted: str) -> tuple[float, dict[str, float]]:
    """Return the mean distance of touches from their socket's mean at places not fitted [m], and sockets' distances.

    Args:
        arm: The arm.
        rows: All touches, with a column `place`.
        fitted: The place that is left out.
    """
    touch = next(kind for kind in rows.readings.kinds if isinstance(kind, Touch))
    points, places = predict(arm, rows).position, np.array(rows.covariates["place"])
    sockets, off, lengths = np.array(touch.sockets), [], {}
    for place in sorted(set(places) - {fitted}):
        middles = []
        for socket in sorted(set(sockets[places == place])):
            own = points[sockets == socket]
            middles.append(own.mean(axis=0))
            off.append(np.linalg.norm(own - middles[-1], axis=1))
        if len(middles) == 2:
            lengths[str(place)] = float(np.linalg.norm(middles[0] - middles[1]))
    return float(np.concatenate(off).mean()), lengths


def main() -> None:
    """Print the scores of the arm as declared and as calibrated at one place."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--fit", default="front_center", help="the place that is fitted")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    arm = armflex.load_arm(asked.folder / "arm.toml")
    rows = read_measurements(asked.folder / "touches.csv", arm)
    own = np.flatnonzero([place == asked.fit for place in rows.covariates["place"]])
    found = calibrate(arm, rows, rows=own)
    for name, one in (("declared", arm), ("calibrated", found.arm)):
        score, lengths = scored(one, rows, asked.fit)
        far = ", ".join(f"{1e3 * length:.2f}" for length in lengths.values())
        print(f"{name}: {1e3 * score:.3f} mm mean distance from sockets; between sockets {far} mm")


if __name__ == "__main__":
    main()
