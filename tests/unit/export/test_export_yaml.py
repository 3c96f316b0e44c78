"""`export --to yaml`: as ur_description and robot_calibration read them, the tip is the calibrated arm's."""

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from support.arms import bundled, corrected, crooked, positions
from support.command_line import fine, run_here
from support.exported import offsets_of, placed, rotation, ur_poses
from support.small_arms import ROBOTS, joint, link, three_joints

from armflex import Arm
from armflex.errors import UnsupportedError
from armflex.export.yaml_files import export
from armflex.robot import Corrections


def rigid(arm: Arm, q: np.ndarray) -> np.ndarray:
    return replace(arm, flexures=(), effects=()).deflection(q, enforce_limits=False).pose


def by_links(poses: list[np.ndarray], q: np.ndarray) -> np.ndarray:
    """Return wrist_3 in the parent of shoulder: six joints about z."""
    T = np.eye(4)
    for pose, angle in zip(poses, q, strict=True):
        T = T @ pose @ rotation("z", angle)
    return T


@pytest.mark.parametrize("seed", range(3))
def test_ur_description_has_the_tip_where_the_calibrated_arm_has_it(seed: int) -> None:
    arm, rng = corrected(bundled("heavy_six")), np.random.default_rng(seed)
    geometry = {name: rng.normal(0.0, 2e-3, 6) for name in arm.joint_names}
    arm = replace(arm, corrections=Corrections(arm.corrections.joint_offset, geometry))
    before, poses, after = ur_poses(export(arm, "ur_calibration").text)
    q = positions(arm, 6)
    found = [before @ by_links(poses, row) @ after for row in q]
    np.testing.assert_allclose(found, rigid(arm, q), rtol=0.0, atol=1e-9)


def test_ur_calibration_is_the_yaml_that_ur_description_reads() -> None:
    yaml = pytest.importorskip("yaml")
    arm = corrected(bundled("heavy_six"))
    text = export(arm, "ur_calibration").text
    read = yaml.safe_load(text)["kinematics"]
    assert read.pop("hash").startswith("calib_")
    assert {tuple(row) for row in read.values()} == {("x", "y", "z", "roll", "pitch", "yaw")}
    assert all(isinstance(value, float) for row in read.values() for value in row.values())
    np.testing.assert_allclose([placed(row) for row in read.values()], ur_poses(text)[1], rtol=0.0, atol=0.0)


def test_a_fixed_joint_before_the_first_is_not_in_shoulder(tmp_path: Path) -> None:
    """As `base_link` and `base_link_inertia`, half a turn apart."""
    parts = [link("base"), joint("half_turn", "base", "l0", (0, 0, 0.1), (0, 0, np.pi), kind="fixed"), link("l0", 1.0)]
    for i in range(6):
        place, axis = (0.1, 0.02 * i, 0.2), ((0, 0, 1), (0, 1, 0))[i % 2]
        parts += [joint(f"j{i}", f"l{i}", f"l{i + 1}", place, axis=axis), link(f"l{i + 1}", 1.0)]
    arm = corrected_six(tmp_path, parts)
    before, poses, after = ur_poses(export(arm, "ur_calibration").text)
    np.testing.assert_allclose(
        before, placed({"x": 0, "y": 0, "z": 0.1, "roll": 0, "pitch": 0, "yaw": np.pi}), atol=1e-15
    )
    np.testing.assert_allclose(poses[0][:3, 3], [0.1, 0.0, 0.2], atol=1e-15)
    q = positions(arm, 4)
    found = [before @ by_links(poses, row) @ after for row in q]
    np.testing.assert_allclose(found, rigid(arm, q), rtol=0.0, atol=1e-12)


def corrected_six(folder: Path, parts: list[str]) -> Arm:
    from support.small_arms import arm_of

    arm = arm_of(folder, parts, "l6", {})
    return replace(arm, corrections=Corrections({"j2": 1e-3}, {}))


def updated_urdf(arm: Arm, offsets: dict[str, float]) -> ElementTree.Element:
    """Return the arm's URDF as robot_calibration updates it: origins times frame offsets, zeros into `rising`."""
    root = ElementTree.parse(arm.robot.urdf.path).getroot()
    for element in root.findall("joint"):
        name, origin = element.get("name"), element.find("origin")
        given = [offsets.get(f"{name}_{axis}", 0.0) for axis in "xyzabc"]
        old = {key: [float(x) for x in (origin.get(key) or "0 0 0").split()] for key in ("xyz", "rpy")}
        pose = placed(dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), (*old["xyz"], *old["rpy"]), strict=True)))
        moved = pin.SE3(pose) * pin.SE3(pin.exp3(np.array(given[3:])), np.array(given[:3]))
        origin.set("xyz", " ".join(map(repr, moved.translation.tolist())))
        origin.set("rpy", " ".join(map(repr, pin.rpy.matrixToRpy(moved.rotation).tolist())))
        if name in offsets:
            ElementTree.SubElement(element, "calibration", rising=repr(offsets[name]))
    return root


@pytest.mark.parametrize("name", ["heavy_six", "tarm_like", "crooked"])
def test_robot_calibration_makes_of_the_urdf_what_was_calibrated(name: str, tmp_path: Path) -> None:
    arm = corrected(crooked(tmp_path, {}) if name == "crooked" else bundled(name))
    offsets = offsets_of(export(arm, "robot_calibration").text)
    root = updated_urdf(arm, offsets)
    found = {element.get("name"): element.find("calibration") for element in root.iter("joint")}
    rising = {one: float(element.get("rising")) for one, element in found.items() if element is not None}
    assert rising == arm.corrections.joint_offset
    model = pin.buildModelFromXML(ElementTree.tostring(root, "unicode"))
    data, q = model.createData(), positions(arm, 6)
    for row, wanted in zip(q, rigid(arm, q), strict=True):
        at = pin.neutral(model)
        reported = {**dict(zip(arm.joint_names, row, strict=True)), **arm.robot.locked}
        for joint_name, value in reported.items():
            at[model.joints[model.getJointId(joint_name)].idx_q] = value + rising.get(joint_name, 0.0)
        pin.framesForwardKinematics(model, data, at)
        tip = data.oMf[model.getFrameId(arm.robot.base)].inverse() * data.oMf[model.getFrameId(arm.robot.tip)]
        np.testing.assert_allclose(tip.homogeneous, wanted, rtol=0.0, atol=1e-9)


def test_robot_calibration_is_yaml_too() -> None:
    yaml = pytest.importorskip("yaml")
    text = export(corrected(bundled("heavy_six")), "robot_calibration").text
    assert yaml.safe_load(text) == pytest.approx(offsets_of(text))


@pytest.mark.parametrize("odd", ["a b", "x: 1", "#1", '"q"', "{a}", "é"])
def test_names_that_robot_calibration_cannot_read_are_refused(odd: str, tmp_path: Path) -> None:
    arm = renamed(tmp_path, odd)
    with pytest.raises(UnsupportedError, match="cannot read the names"):
        export(arm, "robot_calibration")


def test_a_joint_named_as_the_axis_of_a_frame_is_refused(tmp_path: Path) -> None:
    arm = replace(renamed(tmp_path, "yaw_x"), corrections=Corrections({}, {"yaw": np.full(6, 1e-3)}))
    with pytest.raises(UnsupportedError, match="yaw_x"):
        export(arm, "robot_calibration")


def renamed(folder: Path, name: str) -> Arm:
    """Return the crooked arm whose second joint has another name."""
    from xml.sax.saxutils import quoteattr

    from support.small_arms import CROOKED, arm_of

    parts = [part.replace('name="pitch"', f"name={quoteattr(name)}") for part in CROOKED]
    return arm_of(folder, parts, "tool", {})


def test_more_or_other_joints_than_a_ur_has_are_refused_with_their_names(tmp_path: Path) -> None:
    with pytest.raises(UnsupportedError, match=r"takes six turning joints; this arm has 3: yaw, pitch, roll"):
        export(three_joints(tmp_path, [np.eye(6) * 1e-9] * 3), "ur_calibration")
    with pytest.raises(UnsupportedError, match=r"this arm has 7, M1 sliding: M1, A1"):
        export(bundled("tarm_like"), "ur_calibration")


@pytest.mark.slow
def test_command(tmp_path: Path) -> None:
    arm = ROBOTS / "heavy_six" / "arm.toml"
    done = run_here(tmp_path, "export", arm, "--to", "yaml", "-o", "c.yaml")
    assert done.returncode == 2 and "--to yaml needs --flavour ur_calibration or robot_calibration" in done.stderr
    done = run_here(tmp_path, "export", arm, "--to", "yaml", "--flavour", "ur_kalibration", "-o", "c.yaml")
    assert done.returncode == 2 and "did you mean 'ur_calibration'" in done.stderr
    assert not list(tmp_path.iterdir())
    done = fine(run_here(tmp_path, "export", arm, "--to", "yaml", "--flavour", "ur_calibration", "-o", "c.yaml"))
    assert "payload 'p200'" in done.stdout and len(ur_poses((tmp_path / "c.yaml").read_text())[1]) == 6
