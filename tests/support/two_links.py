"""An arm of two links that is good until a test spoils it: its URDF, its arm.toml."""

import time
from pathlib import Path

import pytest

from armflex.errors import UrdfError
from armflex.robot import load_robot
from support.small_arms import write

GOOD = """<?xml version="1.0"?>
<robot name="two_link">
  <link name="base"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/>
    <child link="upper"/>
    <origin xyz="0 0 0.5" rpy="0 0.1 0"/>
    <axis xyz="0 1 0"/>
    <limit lower="-1.5" upper="1.6" effort="900" velocity="0.7"/>
  </joint>
  <link name="upper">
    <inertial>
      <origin xyz="0.5 0 0.01"/>
      <mass value="20"/>
      <inertia ixx="0.2" ixy="0.001" ixz="0.002" iyy="1.7" iyz="0.003" izz="1.75"/>
    </inertial>
    <visual name="tube">
      <geometry><box size="1.0 0.1 0.1"/></geometry>
    </visual>
  </link>
  <joint name="elbow" type="revolute">
    <parent link="upper"/>
    <child link="fore"/>
    <origin xyz="1.0 0 0"/>
    <axis xyz="0 0 1"/>
    <limit lower="-2" upper="2.1" effort="400" velocity="0.8"/>
  </joint>
  <link name="fore">
    <inertial>
      <origin xyz="0.4 0 0"/>
      <mass value="12"/>
      <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.7" iyz="0" izz="0.71"/>
    </inertial>
  </link>
  <joint name="flange" type="fixed">
    <parent link="fore"/>
    <child link="tool"/>
    <origin xyz="0.8 0 0"/>
  </joint>
  <link name="tool"/>
</robot>
"""
PAYLOADS = """[payload.p5]
mass = 5.0
com = [0.1, 0.0, 0.0]
inertia = [0.3, 0.3, 0.3, 0.0, 0.0, 0.0]

[payload.p20]
mass = 20.0
com = [0.1, 0.0, 0.05]
"""
ARM = f"""[robot]
urdf = "robot.urdf"
tip = "tool"
base = "base"
gravity = [0.0, 0.0, -9.81]
payload_rating = 10.0

{PAYLOADS}
[flexure.S]
joint = "shoulder"
model = "linear"
relative_std = 0.1
compliance = [1e-9, 1e-9, 6e-10, 4e-8, 4.5e-8, 2e-7]

[flexure.E]
joint = "elbow"
model = "position_dependent"
depends_on = "elbow"
relative_std = 0.2
compliance = [1e-9, 1e-9, 6e-10, 4e-8, 4e-8, 3e-7]
compliance_q1 = [0.0, 0.0, 0.0, 0.0, 0.0, 1e-8]

[measurement]
frame = "unknown"
gravity_in = "base"

[prior]
joint_offset = 1e-3
compliance = 0.2
"""
Q = [0.2, -0.3]
MASS = '<mass value="20"/>'
INERTIA = '<inertia ixx="0.2" ixy="0.001" ixz="0.002" iyy="1.7" iyz="0.003" izz="1.75"/>'
ELBOW_LIMIT = '<limit lower="-2" upper="2.1" effort="400" velocity="0.8"/>'
ELBOW_AXIS = '<axis xyz="0 0 1"/>'
ELBOW_ORIGIN = '<origin xyz="1.0 0 0"/>'
ELBOW = '<joint name="elbow" type="revolute">'
UPPER_INERTIAL = '<inertial>\n      <origin xyz="0.5 0 0'
FORE = '<link name="fore">'


def edited(text: str, *edits: tuple[str, str]) -> str:
    """Return a text with texts in it replaced, each of which must occur once."""
    for old, new in edits:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


def changed(*edits: tuple[str, str]) -> str:
    """Return the good URDF, edited."""
    return edited(GOOD, *edits)


def declared(folder: Path, *edits: tuple[str, str]) -> Path:
    """Write the good arm.toml, edited, beside its URDF."""
    write(folder, GOOD)
    return write(folder, edited(ARM, *edits), "arm.toml")


def codes(loaded: object) -> list[str]:
    """Return the codes of the flags of whatever has some."""
    return [flag.code for flag in loaded.flags]


def assert_refused(path, words: tuple[str, ...], line: int | None = None, **options: object) -> None:
    """Assert a `UrdfError` that names the file, the line where there is one, and all the words."""
    started = time.process_time()
    with pytest.raises(UrdfError) as caught:
        load_robot(path, **options)
    assert time.process_time() - started < 5.0
    message = str(caught.value)
    assert message.startswith(f"{path}:{line}: " if line else f"{path}"), message
    assert not line or caught.value.place.line == line
    for word in words:
        assert word in message
    assert len(message) < 2000
