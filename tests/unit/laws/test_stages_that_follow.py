"""Stages of a boom that a gear moves with another one: whose position a law depends on."""

from pathlib import Path

import numpy as np
import pytest

from armflex import load_arm
from armflex.errors import ArmFileError

URDF = """<robot name="boom"><link name="base"/>
<link name="one"><inertial><origin xyz="1 0 0"/><mass value="100"/>
  <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="two"><inertial><origin xyz="0.5 0 0"/><mass value="50"/>
  <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="ext1" type="prismatic"><parent link="base"/><child link="one"/><axis xyz="1 0 0"/>
  <limit lower="0" upper="2" effort="1e5" velocity="1"/></joint>
<joint name="ext2" type="prismatic"><parent link="one"/><child link="two"/><origin xyz="2 0 0"/><axis xyz="1 0 0"/>
  <mimic joint="ext1" multiplier="FACTOR"/><limit lower="0" upper="2" effort="1e5" velocity="1"/></joint></robot>
"""
ARM = """[robot]
urdf = "boom.urdf"
tip = "two"
gravity = [0.0, 0.0, -9.81]
[flexure.stage2]
joint = "ext2"
model = "telescope"
EI = 1e6
length0 = 0.5
along = [1, 0, 0]
"""
pytestmark = pytest.mark.filterwarnings("ignore::armflex.ArmflexWarning")


def sag(folder: Path, factor: float, more: str = "") -> float:
    """Return how far the tip comes down at ext1 = 1.6 m."""
    (folder / "boom.urdf").write_text(URDF.replace("FACTOR", f"{factor:g}"))
    (folder / "arm.toml").write_text(ARM + more)
    return float(-load_arm(folder / "arm.toml").deflection([1.6]).displacement[2])


@pytest.mark.parametrize("factor", [0.5, 1.0])
def test_a_stage_is_as_long_as_it_is_out_itself(factor: float, tmp_path: Path) -> None:
    length = 0.5 + factor * 1.6
    force, moment = 50.0 * 9.81, 50.0 * 9.81 * 0.5
    beam = (force * length**3 / 3.0 + moment * length**2 / 2.0) / 1e6
    assert sag(tmp_path, factor) == pytest.approx(beam, rel=1e-3)


def test_a_stage_is_not_as_long_as_the_one_that_moves_it(tmp_path: Path) -> None:
    assert sag(tmp_path, 1.0, 'depends_on = "ext1"\n') == pytest.approx(sag(tmp_path, 1.0), rel=1e-12)
    with pytest.raises(ArmFileError, match=r"as its own joint 'ext2' is out, 0.5 ext1, .*leave depends_on out"):
        sag(tmp_path, 0.5, 'depends_on = "ext1"\n')


def test_a_polynomial_is_of_the_joint_that_is_named(tmp_path: Path) -> None:
    """In the position of that joint, whatever moves it."""
    law = 'model = "position_dependent"\ncompliance = [0, 0, 1e-6, 0, 0, 0]\ncompliance_q1 = [0, 0, 1e-6, 0, 0, 0]\n'
    (tmp_path / "boom.urdf").write_text(URDF.replace("FACTOR", "0.5"))
    sags = []
    for named in ("ext1", "ext2"):
        (tmp_path / "arm.toml").write_text(ARM[: ARM.index("model")] + law + f'depends_on = "{named}"\n')
        sags.append(-load_arm(tmp_path / "arm.toml").deflection([1.6]).displacement[2])
    assert sags == pytest.approx(50.0 * 9.81 * 1e-6 * np.array([1.0 + 1.6, 1.0 + 0.8]), rel=1e-6)


def test_a_stage_that_is_moved_beyond_its_own_limits_is_said_of_rows_as_of_one(tmp_path: Path) -> None:
    sag(tmp_path, 2.0)
    arm = load_arm(tmp_path / "arm.toml")
    said = "joint 'ext2' has no drive and stands at 3.2, outside its limits [0, 2]"
    assert [flag.text for flag in arm.deflection([1.6]).flags if flag.code == "passive_limits"] == [said]
    rows = arm.deflection([[0.5], [1.6], [1.2]]).flags
    assert [flag.text for flag in rows if flag.code == "passive_limits"] == [f"row 1: {said}"]
    assert not [flag for flag in arm.deflection([[0.5], [0.9]]).flags if flag.code == "passive_limits"]
