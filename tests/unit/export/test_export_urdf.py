"""`export --to urdf`: other programs that read the file have the tip where the calibrated arm without load has it."""

import io
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.arms import bundled, corrected, crooked, positions
from support.campaign_files import write_columns
from support.command_line import fine, run_here, strict_json
from support.small_arms import CROOKED, ROBOTS, arm_of, joint, link, one_joint, three_joints

from armflex import Arm, load_arm
from armflex.export.sheet import export as export_sheet
from armflex.export.urdf_file import export
from armflex.laws.effects.catalogue import CATALOGUE
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.location import Location
from armflex.robot import Corrections, load_robot


def unloaded(arm: Arm) -> Arm:
    """Return the arm of which a URDF can tell: as calibrated, and stiff."""
    return replace(arm, flexures=(), effects=())


def by_pinocchio(text: str, arm: Arm, q: np.ndarray) -> np.ndarray:
    """Return (N, 4, 4) poses of the tip in the base as Pinocchio's own reader of URDFs has them."""
    model = pin.buildModelFromXML(text)
    data, found = model.createData(), []
    for row in q:
        at = pin.neutral(model)
        for name, value in {**dict(zip(arm.joint_names, row, strict=True)), **arm.robot.locked}.items():
            joint = model.joints[model.getJointId(name)]
            at[joint.idx_q : joint.idx_q + joint.nq] = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
        pin.framesForwardKinematics(model, data, at)
        base, tip = (data.oMf[model.getFrameId(name, pin.BODY)] for name in (arm.robot.base, arm.robot.tip))
        found.append((base.inverse() * tip).homogeneous)
    return np.array(found)


def by_mujoco(text: str, arm: Arm, q: np.ndarray) -> np.ndarray:
    """Return the same as MuJoCo has them, with the line of the page for links without inertia."""
    (line,) = re.findall("```xml\n(<mujoco>.*)\n```", (ROBOTS.parent / "docs" / "export.md").read_text())
    root = ElementTree.fromstring(text.encode())
    root.append(ElementTree.fromstring(line))
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, "unicode"))
    data, found = mujoco.MjData(model), []
    for row in q:
        for name, value in zip(arm.joint_names, row, strict=True):
            data.qpos[model.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        body = data.body(arm.robot.tip)
        found.append(np.block([[body.xmat.reshape(3, 3), body.xpos[:, None]], [np.zeros(3), np.ones(1)]]))
    return np.array(found)


def by_yourdfpy(text: str, arm: Arm, q: np.ndarray) -> np.ndarray:
    yourdfpy = pytest.importorskip("yourdfpy")
    robot, found = yourdfpy.URDF.load(io.BytesIO(text.encode()), load_meshes=False), []
    for row in q:
        robot.update_cfg({**dict(zip(arm.joint_names, row, strict=True)), **arm.robot.locked})
        found.append(robot.get_transform(arm.robot.tip, arm.robot.base))
    return np.array(found)


@pytest.mark.parametrize("read", [by_pinocchio, by_mujoco, by_yourdfpy])
@pytest.mark.parametrize("name", ["heavy_six", "tarm_like", "crooked"])
def test_other_readers_have_the_tip_where_the_calibrated_arm_has_it(name: str, read: Callable, tmp_path: Path) -> None:
    arm = corrected(crooked(tmp_path, {}) if name == "crooked" else bundled(name))
    q, text = positions(arm, 12), export(arm).text
    wanted = unloaded(arm).deflection(q, enforce_limits=False).pose
    nominal = np.array([arm.rigid_pose(row, enforce_limits=False).homogeneous for row in q])
    assert np.abs(wanted - nominal)[:, :3, 3].max() > 1e-3
    np.testing.assert_allclose(read(text, arm, q), wanted, rtol=0.0, atol=1e-9)


def test_what_was_not_corrected_is_as_it_was_written(tmp_path: Path) -> None:
    arm = bundled("heavy_six")
    moved = replace(arm, corrections=Corrections({"J4": 2e-3}, {}))
    old, new = (ElementTree.fromstring(text.encode()) for text in (arm.robot.urdf.path.read_text(), export(moved).text))
    for before, after in zip(old.iter(), new.iter(), strict=True):
        changed = before.attrib != after.attrib
        assert before.tag == after.tag and changed == (before is old.find("joint[@name='J4']/origin"))
    assert "<!-- [assumed] Forearm roll. -->" in export(moved).text


@pytest.mark.filterwarnings("ignore:rigid:armflex.ArmflexWarning")
def test_the_file_is_an_arm_of_its_own_without_corrections(tmp_path: Path) -> None:
    arm = corrected(bundled("heavy_six"))
    path = tmp_path / "r.urdf"
    path.write_text(export(arm).text)
    again = load_arm(path)
    assert again.joint_names == arm.joint_names and (again.robot.lower == arm.robot.lower).all()
    for q in positions(arm, 5):
        np.testing.assert_allclose(
            again.rigid_pose(q).homogeneous, unloaded(arm).deflection(q).pose.homogeneous, rtol=0.0, atol=1e-12
        )


def effect(name: str, location: Location, *values: float) -> Effect:
    return Effect(CATALOGUE[name], location, values)


def test_effects_that_depend_on_nothing_are_in_the_file_and_others_are_told(tmp_path: Path) -> None:
    plain = three_joints(tmp_path, [np.diag([0.0, 0.0, 0.0, 1e-6, 1e-6, 1e-6])] * 3)
    constant = (
        effect("encoder_offset", Location("pitch", "ry"), 2e-3),
        effect("link_geometry", Location("link:roll", None, terms=(0, 1, 2)), 1e-3, -2e-3, 5e-4, 0.0, 0.0, 0.0),
        effect("link_geometry", Location("link:roll", "rz", terms=(5,)), 0.0, 0.0, 0.0, 0.0, 0.0, 3e-3),
    )
    scale = effect("encoder_scale", Location("yaw", "rz", ("q_yaw",)), 1e-3)
    arm = replace(plain, effects=(*constant, scale))
    q = positions(arm, 6)
    stiff = replace(arm, flexures=(), effects=constant)
    np.testing.assert_allclose(by_pinocchio(export(arm).text, arm, q), stiff.deflection(q).pose, rtol=0.0, atol=1e-9)
    told = " ".join(export(arm).notes)
    assert "encoder scale at yaw" in told and "encoder offset" not in told and "link geometry" not in told


def test_what_is_left_out_is_what_the_weight_does(tmp_path: Path) -> None:
    """One drive of softness c under a weight m at distance l: its angle is that of t = c m g l cos t."""
    softness, mass = 1e-4, 2.0
    arm = one_joint(tmp_path, np.diag([0.0, 0.0, 0.0, 0.0, softness, 0.0]), (0.5, 0.0, 0.0), mass)
    angle = 0.0
    for _ in range(50):
        angle = softness * mass * 9.81 * 0.5 * np.cos(angle)
    rows = tmp_path / "rows.csv"
    write_columns(rows, {"q_j": [0.0, 0.0]})
    found = export(arm, rows)
    (one,) = found.numbers["left_out"]
    assert one["most"] == pytest.approx(2.0 * np.sin(0.5 * angle), rel=1e-9) and one["rms"] == pytest.approx(
        one["most"]
    )
    assert one["rows"] == 2 and f"{one['most'] * 1e3:.3g} mm" in found.notes[1]
    upright = {**export(arm).numbers["left_out"][0]}
    assert upright["rows"] == 128 and 0.5 * one["most"] < upright["most"] <= 1.01 * one["most"]


def test_effects_that_need_columns_are_named_where_only_limits_are_known(tmp_path: Path) -> None:
    plain = three_joints(tmp_path, [np.diag([0.0, 0.0, 0.0, 1e-6, 1e-6, 1e-6])] * 3)
    arm = replace(plain, effects=(effect("backlash", Location("pitch", "ry", ("approach_pitch",)), 4e-3),))
    told = export(arm).notes
    assert "--over" in told[-1] and "backlash at pitch" in told[-1]
    rows = tmp_path / "rows.csv"
    write_columns(rows, {"q_yaw": [0.0] * 2, "q_pitch": [0.1] * 2, "q_roll": [0.0] * 2, "approach_pitch": [1, -1]})
    (one,) = export(arm, rows).numbers["left_out"]
    assert 1e-3 < one["effects"] < 2e-3 * 2.2


def test_bodies_that_were_found_heavier_are_heavier(tmp_path: Path) -> None:
    arm = three_joints(tmp_path, [np.eye(6) * 1e-8] * 3)
    moved = replace(arm, corrections=Corrections({}, {}, {"upper": np.array([5.0, 0.1, 0.0, -0.05])}))
    models = [pin.buildModelFromXML(export(one).text) for one in (arm, moved)]
    assert pin.computeTotalMass(models[1]) - pin.computeTotalMass(models[0]) == pytest.approx(5.0)
    joint = models[1].getJointId("pitch")
    np.testing.assert_allclose(models[1].inertias[joint].lever, [0.6, 0.05, -0.03])


def test_names_of_any_kind_stay_what_they_are(tmp_path: Path) -> None:
    names = {"yaw": "<a & 'b'>", "pitch": '"]]>', "roll": "--> é中"}
    parts = list(CROOKED)
    for name, odd in names.items():
        parts = [part.replace(f'name="{name}"', f"name={quoteattr(odd)}") for part in parts]
    arm = arm_of(tmp_path, parts, "tool", {})
    moved = replace(arm, corrections=Corrections({odd: 1e-3 for odd in names.values()}, {}))
    path = tmp_path / "again.urdf"
    path.write_text(export(moved).text)
    again = load_robot(path, "tool")
    assert again.joint_names == tuple(names.values())
    q = np.array([0.1, 0.2, 0.3])
    np.testing.assert_allclose(
        Arm(again).rigid_pose(q).homogeneous, unloaded(moved).deflection(q).pose.homogeneous, rtol=0.0, atol=1e-12
    )


def test_meshes_beside_the_old_file_are_told(tmp_path: Path) -> None:
    mesh = '<visual><geometry><mesh filename="{}"/></geometry></visual></link>'
    parts = [part.replace("</link>", mesh.format("parts/a.stl")) if "column" in part else part for part in CROOKED]
    parts = [part.replace("</link>", mesh.format("package://p/b.stl")) if '"fore"' in part else part for part in parts]
    told = export(arm_of(tmp_path, parts, "tool", {})).notes
    assert "1 meshes are named from the folder of robot.urdf, such as 'parts/a.stl'" in told[-1]
    assert not any("meshes" in line for line in export(bundled("heavy_six")).notes)


ANGLE = st.floats(-3.2, 3.2)


@given(st.tuples(ANGLE, ANGLE, ANGLE), st.sampled_from([None, 0.5 * np.pi, -0.5 * np.pi]), st.integers(0, 2))
@settings(max_examples=40)
def test_any_origin_may_be_corrected(
    tmp_path_factory: pytest.TempPathFactory, angles: tuple[float, ...], pitch: float | None, small: int
) -> None:
    """Also one whose pitch is a right angle, where roll and yaw are not told apart, or nearly so."""
    rpy = (angles[0], angles[1] if pitch is None else pitch + angles[1] * (0.0, 1e-12, 1e-7)[small], angles[2])
    parts = [link("base"), joint("j", "base", "body", (0.3, -0.2, 0.5), rpy), link("body", 1.0)]
    parts += [joint("f", "body", "tool", (1, 0.5, 0), kind="fixed"), link("tool")]
    arm = arm_of(tmp_path_factory.mktemp("any"), parts, "tool", {})
    for twist in (np.zeros(6), np.array([1e-3, -2e-3, 1e-3, 1e-6, -2e-6, 1e-6])):
        moved = replace(arm, corrections=Corrections({"j": 1e-9}, {"j": twist}))
        q = np.array([[-1.0], [0.4]])
        np.testing.assert_allclose(
            by_pinocchio(export(moved).text, moved, q), unloaded(moved).deflection(q).pose, rtol=0.0, atol=1e-12
        )


@pytest.mark.slow
def test_command(tmp_path: Path) -> None:
    done = fine(
        run_here(
            tmp_path, "export", ROBOTS / "heavy_six" / "arm.toml", "--to", "urdf", "-o", "r.urdf", "--json", "r.json"
        )
    )
    assert "payload 'p200'" in done.stdout and "Written to r.urdf" in done.stdout
    said = strict_json(tmp_path / "r.json")
    assert [one["payload"] for one in said["left_out"]] == ["none", "empty", "p100", "p200"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["r.json", "r.urdf"]


def test_mujoco_reads_what_has_inertia_as_it_is(heavy: Arm) -> None:
    text = export(heavy).text
    assert mujoco.MjModel.from_xml_string(text).nq == len(heavy.joint_names)
    with pytest.raises(ValueError, match="mass and inertia of moving bodies"):
        mujoco.MjModel.from_xml_string(re.sub("<inertial>.*?</inertial>", "", text, flags=re.S))


def test_the_temperature_at_which_lengths_hold_is_said(heavy: Arm, tmp_path: Path) -> None:
    def warm(place: str, reference: float, column: str = "temperature") -> Effect:
        return Effect(CATALOGUE["thermal_growth"], Location(f"link:{place}", None, (column,)), (1e-5, reference, 0.0))

    def said(*effects: Effect) -> str:
        made = export(replace(heavy, effects=effects))
        assert [line for line in made.notes if "°C" in line] == re.findall("<!-- (Lengths.*) -->", made.text)
        return "; ".join(f"{column} {at:g}" for column, at in made.numbers["holds_at"].items())

    assert said(warm("J3", 21.5), warm("J4", 21.5), warm("J5", 20.0, "air")) == "temperature 21.5; air 20"
    assert said(warm("J3", 21.5), warm("J4", 20.0)) == (
        "temperature (thermal_growth link:J3) 21.5; temperature (thermal_growth link:J4) 20"
    )
    assert said() == ""
    sheet = export_sheet(replace(heavy, effects=(warm("J3", 21.5),)))
    assert "holds_at,temperature,temperature,21.5,,degC" in sheet.text and "21.50000 degC" in sheet.page
    (tmp_path / "warm.urdf").write_text(export(replace(heavy, effects=(warm("J3", 21.5),))).text)
    again = replace(heavy, robot=load_robot(tmp_path / "warm.urdf", heavy.robot.tip), effects=(warm("J3", 25.0),))
    assert re.findall("Lengths.* at (.*) -->", export(again).text) == ["temperature = 25 °C."]
