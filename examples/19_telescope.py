"""A telescope in twelve lines: a simulated pointing run, as TPOINT reads it, calibrates it to an arcsecond."""

import sys
import tempfile
from pathlib import Path

import numpy as np

import armflex
from armflex.intake import intake

MOUNT = """\
prior = { joint_offset = 5e-3, geometry = 2e-3, compliance = 2.0 }
[robot]
dh = "modified"
gravity = [0, 0, -9.81]
tool = { xyz = [1, 0, 0], rpy = [0, 0, 0] }
[robot.joint]
az = { alpha_deg = 180, mass = 10 }
el = { alpha_deg = -90, mass = 10, com = [0.5, 0, 0] }
[flexure]
tube = { joint = "el", compliance = [0, 0, 0, 1e-6, 1e-6, 1e-6] }
[instrument]
star = { kind = "direction", link = "flange", axis = [1, 0, 0], azimuth = "north_to_east", sigma = 5e-6 }
"""
ARCSEC = np.pi / 648000.0
NOISE = 1.0  # arcsec in each direction


def pointing_run(stars: int, seed: int = 1) -> str:
    """Return a run in TPOINT's form 4: azimuth and elevation of stars, and of the axes that point at them [deg].

    The axes are off by the classical terms, each in arcsec: zeros, a collimation, axes that are not square, a base that
    leans to the north and to the west, and a tube that sags by the cosine of its elevation.
    """
    rng = np.random.default_rng(seed)
    az, el = rng.uniform(0.0, 2.0 * np.pi, stars), np.radians(rng.uniform(15.0, 82.0, stars))
    level = -322.0 * np.cos(el) + 45.0 - 30.0 * np.sin(el)  # of the axes less the star, along the horizon
    level -= (66.0 * np.cos(az) + 44.0 * np.sin(az)) * np.sin(el)
    rise = 358.0 - 44.0 * np.cos(az) + 66.0 * np.sin(az) + 15.0 * np.cos(el)
    level, rise = (off + rng.normal(0.0, NOISE, stars) for off in (level, rise))
    axes = az + ARCSEC * level / np.cos(el), el + ARCSEC * rise
    rows = np.degrees(np.column_stack([az, el, *axes]))
    lines = [
        "A simulated mount",
        ": ALTAZ",
        "-30 14 40.2",
        *(" ".join(f"{angle:.7f}" for angle in row) for row in rows),
        "END",
    ]
    return "\n".join(lines) + "\n"


def main(folder: str = ".") -> tuple[float, float]:
    mount, run = Path(folder) / "mount.toml", Path(folder) / "run.dat"
    mount.write_text(MOUNT)
    run.write_text(pointing_run(stars=90))
    arm = armflex.load_arm(mount)
    found = armflex.calibrate(arm, intake([run], None).table)

    assert found.held_out is not None
    before, after = (error / ARCSEC for error in found.held_out)
    print(
        f"stars held out: {before:.0f} arcsec off as declared, {after:.2f} calibrated; noise {np.sqrt(2.0) * NOISE:.2f}"
    )
    return before, after


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        main(*(sys.argv[1:2] or [scratch]))
