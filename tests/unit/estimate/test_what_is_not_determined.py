"""Why readings do not determine a parameter: nothing moves with it, another does the same, or it absorbs a misfit."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.small_arms import joint, link, robot

from armflex import calibrate, load_arm, read_measurements
from armflex.estimate import Calibration

pytestmark = pytest.mark.slow

BENDING = 1.0 / (2.1e11 * 2e-5)  # 1/(N m^2)


def arm_file(file: Path, telescope: str, frame: str, prior: str = "") -> Path:
    hinge = "compliance = [0.0, 0.0, 0.0, 2e-8, 1.5e-7, 0.0]"
    file.write_text(f"""[robot]
urdf = "robot.urdf"
base = "base"
tip = "tool"
gravity = [0.0, 0.0, -9.81]
[payload.p100]
mass = 100.0
com = [0.2, 0.0, 0.0]
[flexure.L]
joint = "L"
model = "linear"
{hinge}
[flexure.T]
joint = "T"
{telescope}
[measurement]
frame = "{frame}"
[prior]
{prior}
""")
    return file


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    """A tube that bends the more the further it is out, declared with the compliance that it has half out."""
    folder = tmp_path_factory.mktemp("telescope")
    tube = joint("T", "outer", "inner", (2.2, 0.0, 0.0), axis=(1, 0, 0), kind="prismatic")
    parts = link("base"), link("outer", 400.0, (1.0, 0.0, 0.0)), link("inner", 250.0), link("tool", 80.0)
    joints = joint("L", "base", "outer"), tube.replace('lower="-3"', 'lower="0"')
    (folder / "robot.urdf").write_text(robot(*parts, *joints, joint("W", "inner", "tool", (0.5, 0.0, 0.0))))
    cantilever = np.zeros((4, 6, 6))  # of 1 m and what is out, by powers of that
    for each, (shift, turn, both) in zip(
        cantilever, ((1 / 3, 1, 1 / 2), (1, 1, 1), (1, 0, 1 / 2), (1 / 3, 0, 0)), strict=True
    ):
        each[2, 2], each[4, 4], each[2, 4], each[4, 2] = shift, turn, -both, -both
    cantilever *= BENDING
    names = ("compliance", "compliance_q1", "compliance_q2", "compliance_q3")
    powers = [f"{name} = {one.tolist()}" for name, one in zip(names, cantilever, strict=True)]
    grows = "\n".join(['model = "position_dependent"', *powers])
    constant = f'model = "linear"\ncompliance = {np.tensordot(1.5 ** np.arange(4), cantilever, 1).tolist()}'
    truth = load_arm(arm_file(folder / "truth.toml", grows, "base"))
    arm = load_arm(
        arm_file(folder / "arm.toml", constant, "unknown", "compliance = 0.2\njoint_offset = 1e-3\ntool = 5e-3")
    )
    rng = np.random.default_rng(0)
    q, payload = rng.uniform([-0.9, 0.0, -1.2], [0.2, 3.0, 1.2], (60, 3)), ["p100", "none"] * 30
    points = np.asarray(truth.deflection(q, payload).pose)[:, :3, 3] + rng.normal(0.0, 1e-4, (60, 3))
    with (folder / "campaign.csv").open("w", newline="") as file:
        rows = [[f"p{i}", payload[i], *q[i], *points[i], 1e-4] for i in range(60)]
        csv.writer(file).writerows([["pose", "payload", "q_L", "q_T", "q_W", "x", "y", "z", "sigma"], *rows])
    return calibrate(arm, read_measurements(folder / "campaign.csv", arm))


@pytest.mark.filterwarnings("ignore:not_the_drive:armflex.ArmflexWarning")
def test_a_value_that_a_misfit_moved_is_not_called_unseen(found: Calibration) -> None:
    """The readings want none of the constant compliance: the smaller it is, the less they depend on it."""
    absorbing = {one.name: one for one in found.undetermined if one.absorbing}
    assert found.scatter > 10.0 and "compliance T dz" in absorbing
    one = absorbing["compliance T dz"]
    assert one.pull < -3.0 and not one.surprising and "absorbs what the arm lacks" in one.reason()


def test_what_no_row_loads_and_what_another_does_as_well_is_said(found: Calibration) -> None:
    """All joints move in one plane: no moment about the boom's length ever loads the hinge."""
    reasons = {one.name: one.reason({"instrument dy": "the tracker"}) for one in found.undetermined}
    assert reasons["compliance L rx"] == "no row loads it"
    assert reasons["tool dy"] == "can be exchanged for the tracker"


def test_compliances_that_are_held_although_uncertain_are_said() -> None:
    folder = Path(__file__).parents[3] / "robots" / "tarm_like"
    arm = load_arm(folder / "arm.toml")
    rows = read_measurements(folder / "campaign.csv", arm)
    held = calibrate(replace(arm, prior=replace(arm.prior, compliance=0.0)), rows)
    (flag,) = (flag for flag in held.flags if flag.code == "held")
    most = max(flexure.law.relative_std for flexure in arm.flexures)
    assert f"compliance = {most:g} under [prior] frees it" in flag.text
    assert "held" not in {flag.code for flag in calibrate(arm, rows).flags}
