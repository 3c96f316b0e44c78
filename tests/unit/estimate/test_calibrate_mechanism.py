"""Machines with loops are calibrated from readings of their tips as chains are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.machines import MACHINES, poses

import armflex
from armflex.errors import UnsupportedError
from armflex.estimate.calibrate import write_calibrated
from armflex.laws import LinearLaw

SIGMA = 1e-4
PRIOR = """
[payload.p]
mass = 300.0
com = [0.0, 0.0, 0.0]
[measurement]
frame = "base"
[prior]
joint_offset = 1e-3
compliance = 0.2
"""


def campaign(arm: armflex.Arm, true: armflex.Arm, q: np.ndarray, folder) -> armflex.Measurements:
    """Return what a tracker reads of a machine, alternately loaded."""
    carried = ["none", "p"] * (len(q) // 2)
    read = true.deflection(q, carried).pose[:, :3, 3] + SIGMA * np.random.default_rng(1).normal(size=(len(q), 3))
    head = ["pose", "session", "time", "payload", *(f"q_{name}" for name in arm.joint_names), "x", "y", "z", "sigma"]
    numbers = [map(repr, [*at, *tip, SIGMA]) for at, tip in zip(q.tolist(), read.tolist(), strict=True)]
    rows = [[f"p{i}", "s", str(i), carried[i], *own] for i, own in enumerate(numbers)]
    (folder / "rows.csv").write_text("\n".join(",".join(row) for row in [head, *rows]))
    return armflex.read_measurements(folder / "rows.csv", arm)


def declared(name: str, folder, prior: str = PRIOR) -> armflex.Arm:
    MACHINES[name].load(folder)
    (folder / "arm.toml").write_text((folder / "arm.toml").read_text() + prior)
    return armflex.load_arm(folder / "arm.toml")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["crane", "five_bar"])
def test_zeros_of_drives_and_cylinders_and_stiffnesses_are_found(name, tmp_path):
    arm, rng = declared(name, tmp_path), np.random.default_rng(5)
    offsets = {joint: 1e-3 * rng.normal() for joint in arm.joint_names}
    softer = {one.name: float(np.exp(0.15 * rng.normal())) for one in arm.flexures}
    laws = []
    for one in arm.flexures:
        assert isinstance(one.law, LinearLaw)
        laws.append(replace(one, law=one.law.scaled(np.full(6, softer[one.name] ** 0.5))))
    true = replace(arm, flexures=tuple(laws), corrections=replace(arm.corrections, joint_offset=offsets))
    found = armflex.calibrate(arm, campaign(arm, true, poses(name, 40), tmp_path))
    certainty = found.arm.certainty
    assert certainty is not None
    stds = np.sqrt(np.diag(certainty.covariance)).tolist()
    std = {label: value for label, value in zip(certainty.labels, stds, strict=True)}
    off = []
    for joint, value in offsets.items():
        own = next(label for label in std if "offset" in label and joint in label)
        off.append((found.arm.corrections.joint_offset[joint] - value) / std[own])
    assert np.abs(off).max() < 3.5
    assert found.rms < 1.06 * np.sqrt(3.0) * SIGMA
    # What was found is written, and read as it was.
    path = write_calibrated(tmp_path / "arm.toml", found, tmp_path / "found.toml")
    again = armflex.load_arm(path)
    q = poses(name, 2)[1]
    np.testing.assert_allclose(
        again.deflection(q, "p").displacement, found.arm.deflection(q, "p").displacement, atol=1e-9
    )


def test_geometry_of_a_loop_that_nothing_lets_give_across_its_plane_is_refused(tmp_path):
    arm = declared("parallelogram", tmp_path, PRIOR + "geometry = 5e-4\n")
    with pytest.raises(UnsupportedError, match=r"loop 'tail' is held across its plane.*kind = \"spherical\""):
        armflex.calibrate(arm, campaign(arm, arm, poses("parallelogram", 8), tmp_path))
