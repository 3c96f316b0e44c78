"""Wire lengths of a small six-axis arm known by its DH numbers alone, as laboratories hand them on; numpy only."""

import csv
from pathlib import Path

import numpy as np

DH = (  # theta [deg], d [mm], a [mm], alpha [deg], lowest and highest position [deg]
    (0.0, 290.0, 0.0, -90.0, -165.0, 165.0),
    (-90.0, 0.0, 270.0, 0.0, -110.0, 110.0),
    (0.0, 0.0, 70.0, -90.0, -110.0, 70.0),
    (0.0, 302.0, 0.0, 90.0, -160.0, 160.0),
    (0.0, 0.0, 0.0, -90.0, -120.0, 120.0),
    (180.0, 72.0, 0.0, 0.0, -180.0, 180.0),
)
"""Of an arm of 0.6 m reach, in the standard form."""

OFF = (0.3, 0.7, 0.7, 0.15)
"""One standard deviation of what the true machine's theta [deg], d, a [mm] and alpha [deg] are off."""

ANCHOR, ZERO, EYE, NOISE = (620.0, -450.0, 80.0), 37.0, (12.0, -8.0, 25.0), 0.1
"""Where the wire truly begins, what it reads too much, where it is hooked on in the flange frame, its noise [mm]."""

ARM = """[robot]
dh = "standard"

[robot.joint]
{joints}

[prior]
joint_offset = 0.01
geometry = 2e-3

[instrument.L]
kind = "distance"
link = "flange"
point_std = 0.05
anchor = [0.5, -0.5, 0.0]
anchor_std = 0.3
length_offset_std = 0.1
sigma = 1e-4
"""


def declared(folder: Path) -> Path:
    """Write what is known of the arm and of the wire: its DH numbers, and about where the wire begins."""
    joints = "\n".join(
        f"J{i + 1} = {{ theta_deg = {theta}, d_mm = {d}, a_mm = {a}, alpha_deg = {alpha} }}"
        for i, (theta, d, a, alpha, _, _) in enumerate(DH)
    )
    file = folder / "arm.toml"
    file.write_text(ARM.format(joints=joints))
    return file


def tips(q: np.ndarray, dh: np.ndarray) -> np.ndarray:
    """Return the (N, 4, 4) pose of the last frame [mm], for (N, 6) positions and (6, 4) numbers [deg, mm]."""
    pose = np.tile(np.eye(4), (len(q), 1, 1))
    for column, (theta, d, a, alpha) in zip(q.T, dh, strict=True):
        c, s = np.cos(np.radians(column + theta)), np.sin(np.radians(column + theta))
        u, v = np.cos(np.radians(alpha)), np.sin(np.radians(alpha))
        step = np.zeros((len(q), 4, 4))
        step[:, 0] = np.stack([c, -s * u, s * v, a * c], axis=1)
        step[:, 1] = np.stack([s, c * u, -c * v, a * s], axis=1)
        step[:, 2], step[:, 3, 3] = (0.0, v, u, d), 1.0
        pose = pose @ step
    return pose


def true_dh(seed: int) -> np.ndarray:
    """Return the (6, 4) theta, d, a, alpha of the machine [deg, mm]."""
    return np.array(DH)[:, :4] + np.random.default_rng([seed, 1]).normal(0.0, OFF, (len(DH), 4))


def lengths(q: np.ndarray, dh: np.ndarray) -> np.ndarray:
    """Return the (N,) lengths that the wire reads without noise [mm]."""
    pose = tips(q, dh)
    there = pose[:, :3, 3] + pose[:, :3, :3] @ np.array(EYE)
    return np.linalg.norm(there - np.array(ANCHOR), axis=1) + ZERO


def positions(count: int, seed: int) -> np.ndarray:
    """Return (N, 6) positions over the limits, in front of the wire's box and off the floor [deg]."""
    rng, lower, upper = np.random.default_rng([seed, 2]), *np.array(DH).T[4:]
    q = rng.uniform(lower, upper, (20 * count, len(DH)))
    place = tips(q, np.array(DH)[:, :4])[:, :3, 3]
    able = (place[:, 2] > 50.0) & (place @ np.array(ANCHOR) > 0.0)
    return q[able][:count]


def write(file: Path, q: np.ndarray, seed: int) -> Path:
    """Write positions in degrees and what the wire reads there in mm."""
    read = lengths(q, true_dh(seed)) + np.random.default_rng([seed, 3]).normal(0.0, NOISE, len(q))
    with open(file, "w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow([*(f"q_J{i + 1}_deg" for i in range(len(DH))), "L_mm"])
        writer.writerows([*np.round(row, 3), round(length, 3)] for row, length in zip(q.tolist(), read, strict=True))
    return file
