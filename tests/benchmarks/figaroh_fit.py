"""FIGAROH on a campaign: its own robot, configuration, parameters and least squares, as its examples use them."""

import contextlib
import csv
import io
import logging
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from armflex import Payload
from armflex.conventions import Array

MEASURED = [True, True, True, False, False, False]


@dataclass(frozen=True)
class Model:
    """What FIGAROH may fit beside base and tip frame: "joint_offset" or "full_params", and the joints' elasticity."""

    level: str
    elastic: bool


@dataclass(frozen=True)
class FigarohFit:
    """Positions (N, 3) [m] for joint positions (N, nq); how many parameters, which were dropped, how long it took."""

    predict: Callable[[Array], Array]
    parameters: tuple[str, ...]
    seconds: float


def with_payload(urdf: Path, tip: str, payload: Payload, path: Path) -> None:
    """Write the URDF with the payload as a link: FIGAROH knows no other way to load an arm."""
    tree = ElementTree.parse(urdf)
    root = tree.getroot()
    if payload.mass > 0.0:
        body = ElementTree.SubElement(ElementTree.SubElement(root, "link", name="payload"), "inertial")
        ElementTree.SubElement(body, "origin", xyz=" ".join(repr(float(x)) for x in payload.com))
        ElementTree.SubElement(body, "mass", value=repr(float(payload.mass)))
        moments = {"ixx": "1", "iyy": "1", "izz": "1", "ixy": "0", "ixz": "0", "iyz": "0"}
        ElementTree.SubElement(body, "inertia", **moments)
        fixed = ElementTree.SubElement(root, "joint", name="payload_fix", type="fixed")
        ElementTree.SubElement(fixed, "parent", link=tip)
        ElementTree.SubElement(fixed, "child", link="payload")
    tree.write(path)


def fit(urdf: Path, tip: str, joints: tuple[str, ...], q: Array, seen: Array, model: Model, folder: Path) -> FigarohFit:
    """Return FIGAROH's fit of positions seen (N, 3) at joint positions (N, nq); files are written to `folder`.

    Raises:
        ModuleNotFoundError: It is not installed.
        figaroh.utils.error_handling.CalibrationError: It could not fit.
    """
    os.environ.setdefault("MPLBACKEND", "Agg")
    from figaroh.calibration.calibration_tools import calc_updated_fkm
    from figaroh.tools.load_robot import load_robot

    write_rows(folder / "rows.csv", joints, q, seen)
    write_configuration(folder / "figaroh.yaml", tip, joints, model, len(q))
    robot = load_robot(str(urdf), package_dirs=str(urdf.parent))
    logging.disable(logging.WARNING)
    start = time.process_time()
    with contextlib.redirect_stdout(io.StringIO()):
        found = tracker()(robot, str(folder / "figaroh.yaml"))
        found.initialize()
        found.solve(enable_logging=False)
    seconds = time.process_time() - start

    def predict(positions: Array) -> Array:
        known = dict(found.calib_config, NbSample=len(positions))
        return calc_updated_fkm(found.model, found.data, found.LM_result.x, positions, known).reshape(3, -1).T

    return FigarohFit(predict, tuple(found.calib_config["param_name"]), seconds)


def tracker() -> type:
    """Return FIGAROH's calibration for a tracker that stands anywhere and sees a target somewhere on the tool."""
    from figaroh.calibration import BaseCalibration
    from figaroh.calibration.calibration_tools import calc_updated_fkm

    class Tracker(BaseCalibration):
        def __init__(self, robot: object, config_file: str) -> None:
            super().__init__(robot, config_file)
            self.calib_config["known_baseframe"] = self.calib_config["known_tipframe"] = False

        def cost_function(self, var: Array) -> Array:
            # In millimetres and in the world's axes; the documented log map gives the same norm, slower.
            positions = calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)
            return 1e3 * (positions - self.PEE_measured)

    return Tracker


def write_rows(path: Path, joints: tuple[str, ...], q: Array, seen: Array) -> None:
    """Write what FIGAROH reads: x1 y1 z1 and a column per joint."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["x1", "y1", "z1", *joints])
        writer.writerows([repr(float(value)) for value in row] for row in np.hstack([seen, q]))


def write_configuration(path: Path, tip: str, joints: tuple[str, ...], model: Model, count: int) -> None:
    """Write the unified configuration."""
    import yaml

    calibration = {
        "type": "kinematic_calibration",
        "enabled": True,
        "kinematics": {"base_frame": "universe", "tool_frame": tip},
        "joints": {"active_joints": list(joints)},
        "parameters": {"calibration_level": model.level, "include_non_geometric": model.elastic},
        "measurements": {
            "markers": [{"ref_joint": joints[-1], "measurable_dof": MEASURED}],
            "poses": {"base_pose": [0.0] * 6, "tool_pose": [0.0] * 6},
        },
        "data": {"source_file": str(path.parent / "rows.csv"), "number_of_samples": count},
    }
    robot = {"name": "arm", "properties": {"joints": {"active_joints": list(joints)}}}
    path.write_text(yaml.safe_dump({"schema_version": "2.0", "robot": robot, "tasks": {"calibration": calibration}}))
