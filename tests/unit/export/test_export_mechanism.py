"""Exports of arms with loops: the tree with its passive joints where the rigid loops close; C refuses them by name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from support.arms import bundled
from support.exported import Sheet
from support.machines import MACHINES, poses

from armflex import Arm
from armflex.errors import UnsupportedError
from armflex.export import c_code, sheet, urdf_file, yaml_files
from armflex.robot import Corrections

FOUND = {
    "five_bar": Corrections(
        {"left": 2e-3}, {"pitch": np.full(6, 1e-3), "right": np.full(6, -8e-4), "left_side": np.full(6, 5e-4)}
    ),
    "crane": Corrections({"slew": 1e-3, "lift": 4e-3}, {"boom": np.array([2e-3, 1e-3, -1e-3, 0, 1e-3, 0])}),
}
"""What calibration may have found: zeros, a cylinder's among them, and frames on the chain and beside it."""


@pytest.fixture(params=FOUND)
def arm(request: pytest.FixtureRequest, tmp_path: Path) -> Arm:
    return replace(MACHINES[request.param].load(tmp_path), corrections=FOUND[request.param])


@pytest.fixture
def rows(arm: Arm, tmp_path: Path) -> Path:
    """Return a file of rows in which the loops close."""
    text = "\n".join(",".join(map(repr, q.tolist())) for q in rows_of(arm))
    path = tmp_path / "rows.csv"
    path.write_text(",".join(f"q_{name}" for name in arm.joint_names) + f"\n{text}\n")
    return path


def rows_of(arm: Arm) -> np.ndarray:
    return poses("crane" if "lift" in arm.joint_names else "five_bar")


def rigid(arm: Arm) -> list[tuple[dict[str, float], np.ndarray]]:
    """Return where all joints stand in some rows, and the pose of the tip of the calibrated arm that does not give."""
    stiff, found = replace(arm, flexures=()), []
    for q in rows_of(arm):
        one = stiff.deflection(q)
        found.append(({**dict(zip(arm.joint_names, q.tolist(), strict=True)), **one.passive}, one.pose.homogeneous))
    return found


def test_the_urdf_has_the_tip_where_its_joints_stand_as_in_the_closed_loops(arm: Arm, rows: Path) -> None:
    exported = urdf_file.export(arm, rows)
    model = pin.buildModelFromXML(exported.text)
    data = model.createData()
    for known, wanted in rigid(arm):
        at = pin.neutral(model)
        for joint in list(model.joints)[1:]:
            at[joint.idx_q] = known[model.names[joint.id]]
        pin.framesForwardKinematics(model, data, at)
        np.testing.assert_allclose(data.oMf[model.getFrameId("tool", pin.BODY)].homogeneous, wanted, atol=1e-9)
    told = " ".join(exported.notes)
    for name in (*arm.robot.linkage.closures, *(one.name for one in arm.robot.swept if one.name in known)):
        assert name in told or name in arm.joint_names
    assert ("lift by 4 mm" in told) == ("lift" in arm.joint_names)
    assert exported.numbers["left_out"][0]["most"] > 1e-4 and exported.numbers["loops_open_m"] > 1e-3


def test_the_sheet_has_a_row_for_every_joint_of_the_chain_and_the_zeros_of_all_drives(
    arm: Arm, rows: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sheet, "configurations", rows_of)
    found = Sheet(sheet.export(arm, rows).text)
    offsets, chain = arm.corrections.joint_offset, [joint.name for joint in arm.robot.swept]
    for known, wanted in rigid(arm):
        # Passive joints have no reading and no zero.
        for form in ("dh_standard", "dh_modified"):
            np.testing.assert_allclose(found.tip(np.array([known[name] for name in chain]), form), wanted, atol=1e-9)
    for name, value in offsets.items():
        assert found.value["joint_offset", name, "offset"] == pytest.approx(value, abs=1e-2)  # and what frames turn
    assert "joint_offset" not in {section for section, of, _ in found.value if of not in arm.joint_names}


def test_robot_calibration_has_zeros_of_drives_and_frames_of_all_joints(arm: Arm, rows: Path) -> None:
    text = yaml_files.export(arm, "robot_calibration", rows).text
    lines = dict(line.split(": ") for line in text.splitlines())
    offsets, cylinders = arm.corrections.joint_offset, [one.name for one in arm.robot.linkage.cylinders]
    drives = {name: offsets.get(name, 0.0) for name in arm.joint_names if name not in cylinders}
    assert {name: float(lines[name]) for name in arm.joint_names if name in lines} == drives
    assert not {*arm.robot.linkage.free} & {*lines}
    for name in arm.corrections.geometry:
        assert float(lines[f"{name}_x"]) != 0.0


@pytest.mark.parametrize("name", ["palletizer", "hybrid_lifter"])
def test_c_refuses_loops_by_name(name: str) -> None:
    arm = bundled(name)
    with pytest.raises(UnsupportedError, match=arm.robot.linkage.closures[0]):
        c_code.export(arm)
    with pytest.raises(UnsupportedError, match="ur_calibration"):
        yaml_files.export(arm, "ur_calibration")
