"""Points of the arm that a campaign found, as a touching ball: a file has them, or says by how many mm it has not."""

import importlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from support.arms import bundled, corrected, positions

from armflex import Arm
from armflex.cli.export_command import FORMATS
from armflex.readings import Touch
from armflex.readings.instrument import Instrument
from armflex.readings.touch import Sockets, TouchingSensor
from armflex.robot import load_robot

TARGET, BALL, GIVEN = np.array([2e-3, -3e-3, 6e-3]), np.array([0.01, 0.0, 0.004]), {"yaml": "robot_calibration"}
GEOMETRY = [name for name, form in FORMATS.items() if "traj" not in form.options]
"""Formats that say where the tip is; those of a path have the positions of the joints."""


@pytest.fixture
def arm() -> Arm:
    """A calibrated arm, whose target is 7 mm from the tip, and a ball on another link."""
    arm = corrected(bundled("heavy_six"))
    link = arm.robot.chain[-3].child
    touch = TouchingSensor("probe", Touch, link, 1e-5, np.zeros(6), np.zeros(6), {"": np.append(np.zeros(3), BALL)})
    touch = replace(touch, sockets=Sockets(own_point=True))
    return replace(arm, instrument=Instrument(target=TARGET), sensors={"probe": touch})


@pytest.mark.parametrize("name", GEOMETRY)
def test_a_format_has_the_measured_points_or_says_how_far_they_are(name: str, arm: Arm, tmp_path: Path) -> None:
    module = importlib.import_module(f"armflex.export.{FORMATS[name].module}")
    found = module.export(arm, *([GIVEN[name]] if name in GIVEN else []))
    said = "\n".join(found.notes)
    assert "leaves out nothing" not in said and "target 7 mm" in said and "probe_point 10.8 mm" in said
    if name != "urdf":
        assert "not in this file" in said
        return
    path = tmp_path / "found.urdf"
    path.write_text(found.text)
    stiff = replace(arm, flexures=(), effects=())
    for point, place, link in (("target", TARGET, arm.robot.tip), ("probe_point", BALL, arm.sensors["probe"].link)):
        model = pin.buildModelFromXML(found.text)
        data = model.createData()
        for q in positions(arm, 4):
            at = pin.neutral(model)
            for joint, value in zip(arm.joint_names, q.tolist(), strict=True):
                at[model.joints[model.getJointId(joint)].idx_q] = value
            pin.framesForwardKinematics(model, data, at)
            base, there, body = (data.oMf[model.getFrameId(one, pin.BODY)] for one in (arm.robot.base, point, link))
            if link == arm.robot.tip:
                wanted = stiff.deflection(q, enforce_limits=False).pose.act(place)
                assert np.abs((base.inverse() * there).translation - wanted).max() < 1e-12
            assert np.abs((body.inverse() * there).translation - place).max() < 1e-12
    assert load_robot(path, "target").tip == "target"
