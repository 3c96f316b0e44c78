"""Calibrations as YAML that other programs read: `ur_calibration`'s and `robot_calibration`'s."""

import re
from collections import Counter
from hashlib import sha256
from pathlib import Path

import numpy as np
import pinocchio as pin

from armflex.arm import Arm
from armflex.errors import InputError, UnsupportedError, listing
from armflex.export import Exported
from armflex.export.rigid import joint_frames, left_out, require_six_turning, with_constants
from armflex.measured.measurements import read_measurements
from armflex.robot.urdf import MOVING

UR_LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
POSE = ("x", "y", "z", "roll", "pitch", "yaw")
WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_./-]*")
"""Names that `robot_calibration` reads back: its own reader ends a name at the first blank and knows no quotes."""


def export(arm: Arm, flavour: str, over: Path | None = None) -> Exported:
    """Return an arm's calibration as YAML.

    Args:
        arm: The arm.
        flavour: "ur_calibration": the kinematics that ur_description makes a robot of; "robot_calibration": offsets of
            joints and of the frames they stand in, against the URDF that the arm was declared by.
        over: Rows over which what the file leaves out is stated; the joints' limits when None.

    Raises:
        InputError: There is no such flavour.
        UnsupportedError: The flavour has no place for this arm's joints or names.
        TableError, MissingCovariateError: The rows cannot be used.
    """
    flavours = {"ur_calibration": _ur, "robot_calibration": _robot}
    if flavour not in flavours:
        raise InputError(f"flavour {flavour!r}: expected one of {listing(flavours)}")
    whole = with_constants(arm)
    rows = None if over is None else read_measurements(over, arm, inputs_only=True)
    text = flavours[flavour](whole)
    return Exported(text, *left_out(whole, rows))


def _ur(arm: Arm) -> str:
    """Return the poses of six joints, each in the one before and turning about its z; what is before the first joint's
    parent link and beyond the last joint stays the URDF's, and is written in comments."""
    require_six_turning(arm, "ur_calibration")
    if arm.robot.linkage:
        named = listing((*arm.robot.linkage.closures, *arm.robot.linkage.passive))
        raise UnsupportedError(f"ur_calibration takes six driven joints in a row; this arm has {named}")
    first, *between, last = joint_frames(arm, zeros=True)
    ahead = pin.SE3.Identity()
    for joint in arm.robot.chain:
        if joint.kind in MOVING:
            break
        ahead = ahead * pin.SE3(joint.rotation, joint.origin) * arm.corrections.frame(joint)
    poses = [_numbers(pose) for pose in (ahead.inverse() * first, *between)]
    lines = [
        "# Joint zeros are in the poses. Each joint turns about the z axis of its frame.",
        f"# base to the parent of shoulder: {_flow(_numbers(ahead))}",
        f"# wrist_3 to tip: {_flow(_numbers(last))}",
        "# The driver compares the hash with the controller's, whose own calibration this is not.",
        "kinematics:",
    ]
    for link, numbers in zip(UR_LINKS, poses, strict=True):
        lines += [f"  {link}:", *(f"    {name}: {value}" for name, value in zip(POSE, numbers, strict=True))]
    digest = int.from_bytes(sha256("\n".join(lines).encode()).digest()[:8], "big")
    return "\n".join([*lines, f"  hash: calib_{digest}", ""])


def _robot(arm: Arm) -> str:
    """Return `joint: offset` of every moving joint, and `joint_x` to `joint_c` of every frame that was corrected."""
    corrections, offsets = arm.corrections, []
    for joint in arm.robot.places:
        if joint in arm.robot.moving:
            offsets.append((joint.name, corrections.joint_offset.get(joint.name, 0.0)))
        if np.any(corrections.geometry.get(joint.name, 0.0)):
            pose = corrections.frame(joint)
            values = (*pose.translation, *pin.log3(pose.rotation))
            offsets += [(f"{joint.name}_{axis}", value) for axis, value in zip("xyzabc", values, strict=True)]
    names = Counter(name for name, _ in offsets)
    if odd := [name for name in names if not WORD.fullmatch(name)]:
        raise UnsupportedError(
            f"robot_calibration cannot read the names {listing(map(repr, odd))}: letters, digits, _ . / -"
        )
    if twice := [name for name, count in names.items() if count > 1]:
        raise UnsupportedError(f"robot_calibration would take {listing(twice)} for a joint and for an axis of a frame")
    return "".join(f"{name}: {float(value) + 0.0!r}\n" for name, value in offsets)


def _numbers(pose: pin.SE3) -> list[str]:
    """Return numbers that every version of YAML takes for such: with a point, also before an exponent."""
    values = (*pose.translation, *pin.rpy.matrixToRpy(pose.rotation))
    return [re.sub(r"^(-?\d+)e", r"\1.0e", repr(float(value) + 0.0)) for value in values]


def _flow(numbers: list[str]) -> str:
    return "{" + ", ".join(f"{name}: {value}" for name, value in zip(POSE, numbers, strict=True)) + "}"
