"""Machines with loops are calibrated from readings of their tips as chains are."""

from dataclasses import replace

import numpy as np
import pytest
from support.machines import MACHINES, poses
from support.small_arms import ROBOTS

import armflex
from armflex.arm import Measurement, Prior, Setup
from armflex.errors import ConventionError, UnsupportedError
from armflex.estimate.blocks import declared_blocks
from armflex.estimate.view import look
from armflex.laws import LinearLaw
from armflex.measured.measurements import Measurements
from armflex.readings import Position, Readings
from armflex.readings.instrument import Instrument
from armflex.rows import Rows

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
    path = found.write(tmp_path / "found.toml")
    again = armflex.load_arm(path)
    q = poses(name, 2)[1]
    np.testing.assert_allclose(
        again.deflection(q, "p").displacement, found.arm.deflection(q, "p").displacement, atol=1e-9
    )


@pytest.mark.slow
def test_a_drive_that_is_counted_backwards_is_named_where_other_conventions_close_no_loop():
    folder = ROBOTS / "palletizer"
    prior = Prior(joint_offset=1e-3, compliance=0.2)
    arm = replace(armflex.load_arm(folder / "arm.toml"), prior=prior, measurement=Measurement("base"), certainty=None)
    driven = armflex.read_trajectory(folder / "trajectory.csv", arm).q
    q = driven[np.linspace(0, len(driven) - 1, 24).astype(int)]
    read = arm.deflection(q).pose[:, :3, 3] + SIGMA * np.random.default_rng(1).normal(size=(len(q), 3))
    turned = np.where(np.array(arm.joint_names) == "upper", -q, q)
    rows = Rows.of(arm.joint_names, turned, ("none",) * len(q), {}, session="s", derived=("time",))
    measurements = Measurements.of(rows, Readings(len(q), (Position(read, np.full(read.shape, SIGMA)),)))
    with pytest.raises(ConventionError) as refused:
        armflex.calibrate(arm, measurements)
    assert refused.value.names[0] == "the sign of q_upper is turned"


def test_geometry_of_a_loop_that_nothing_lets_give_across_its_plane_is_refused(tmp_path):
    arm = declared("parallelogram", tmp_path, PRIOR + "geometry = 5e-4\n")
    with pytest.raises(UnsupportedError, match=r"loop 'tail' is held across its plane.*kind = \"spherical\""):
        armflex.calibrate(arm, campaign(arm, arm, poses("parallelogram", 8), tmp_path))


EVERYTHING = Prior(joint_offset=1e-3, compliance=0.2, spring=0.1, spring_length=0.01)
"""But for frames and masses: what the response says of frames and loads is held in `test_mechanism`."""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["palletizer", "hybrid_lifter"])
def test_readings_answer_to_every_parameter_as_by_finite_differences(name):
    arm = armflex.load_arm(ROBOTS / name / "arm.toml")
    arm = replace(arm, prior=EVERYTHING, measurement=Measurement("base"), certainty=None)
    trajectory = armflex.read_trajectory(ROBOTS / name / "trajectory.csv", arm)
    some = trajectory.q[:: len(trajectory.q) // 3][1:3]
    carried = max(arm.payloads, key=lambda one: arm.payloads[one].mass)
    rows = Rows.of(arm.joint_names, some, (carried,) * 2, {}, session="s", derived=("time",))
    measurements = Measurements.of(rows, Readings(2, (Position(np.zeros((2, 3)), np.ones((2, 3))),)))
    setup = Setup(arm, Instrument())
    here = look(setup, measurements)
    blocks = declared_blocks(setup, measurements)
    kinds = {"joint_offset", "compliance", *(["spring"] if arm.springs else [])}
    assert {str(block.kind) for block in blocks} == kinds
    for block in blocks:
        jacobian = block.jacobian(here)
        for i, size in enumerate((1e-3 * block.prior).tolist()):
            step = size * np.eye(len(block.prior))[i]
            ends = [look(block.stepped(setup, side * step), measurements).residual for side in (1.0, -1.0)]
            quotient = (ends[1] - ends[0]) / (2.0 * size)
            limit = 1e-5 * np.abs(jacobian).max() + 1e-11 / size
            np.testing.assert_allclose(jacobian[:, :, i], quotient, rtol=1e-5, atol=limit, err_msg=block.labels[i])
