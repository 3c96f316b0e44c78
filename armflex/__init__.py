"""armflex: manipulators that sag. Joint compliance, end-effector deflection, path checks and compensation.

A name is imported when it is first asked for: to load an arm and ask for its deflection needs nothing that fits one.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from armflex.version import __version__ as __version__

if TYPE_CHECKING:
    from armflex.arm import Arm as Arm
    from armflex.arm import Flexure as Flexure
    from armflex.bench.training import train as train
    from armflex.bundled import bundled_robot as bundled_robot
    from armflex.errors import ArmflexError as ArmflexError
    from armflex.errors import ArmflexWarning as ArmflexWarning
    from armflex.errors import InputError as InputError
    from armflex.estimate import Bootstrap as Bootstrap
    from armflex.estimate import Calibration as Calibration
    from armflex.estimate import bootstrap as bootstrap
    from armflex.estimate import calibrate as calibrate
    from armflex.estimate.draw import draw_arms as draw_arms
    from armflex.estimate.draw import ensemble as ensemble
    from armflex.estimate.tip_uncertainty import total_covariance as total_covariance
    from armflex.files.arm_file import load_arm as load_arm
    from armflex.files.arm_file import make_arm as make_arm
    from armflex.laws.law_file import load_law as load_law
    from armflex.laws.law_file import save_law as save_law
    from armflex.measured.joint_data import read_joint_data as read_joint_data
    from armflex.measured.measurements import Measurements as Measurements
    from armflex.measured.measurements import read_measurements as read_measurements
    from armflex.measured.points import PointExport as PointExport
    from armflex.measured.points import read_points as read_points
    from armflex.measured.repeats import Repeats as Repeats
    from armflex.measured.repeats import repeats as repeats
    from armflex.mechanics.deflection import Deflection as Deflection
    from armflex.mechanics.deflection import DeflectionBatch as DeflectionBatch
    from armflex.mechanics.loaded import Payload as Payload
    from armflex.plan.drive import write_plan as write_plan
    from armflex.plan.picture import draw_plan as draw_plan
    from armflex.plan.planning import plan as plan
    from armflex.robot import load_robot as load_robot
    from armflex.rows.poses import leaked as leaked
    from armflex.rows.poses import pose_groups as pose_groups
    from armflex.rows.wrench import Wrench as Wrench
    from armflex.show.view import draw_laws as draw_laws
    from armflex.show.view import view as view
    from armflex.show.view.map_page import map_page as map_page
    from armflex.tasks.check import CheckReport as CheckReport
    from armflex.tasks.check import check as check
    from armflex.tasks.compensate import Compensation as Compensation
    from armflex.tasks.compensate import compensate as compensate
    from armflex.tasks.iso9283 import PosePerformance as PosePerformance
    from armflex.tasks.iso9283 import iso9283 as iso9283
    from armflex.tasks.predict import Prediction as Prediction
    from armflex.tasks.predict import predict as predict
    from armflex.tasks.workspace import WorkspaceMap as WorkspaceMap
    from armflex.tasks.workspace import draw_map as draw_map
    from armflex.tasks.workspace import map_workspace as map_workspace
    from armflex.tasks.workspace import read_map as read_map
    from armflex.tasks.workspace import write_map as write_map
    from armflex.trace import trace as trace
    from armflex.track import Reading as Reading
    from armflex.track import Tracker as Tracker
    from armflex.trajectory import Trajectory as Trajectory
    from armflex.trajectory import read_trajectory as read_trajectory
    from armflex.trajectory import write_trajectory as write_trajectory

HOMES = {
    "armflex.arm": "Arm Flexure",
    "armflex.bench.training": "train",
    "armflex.bundled": "bundled_robot",
    "armflex.errors": "ArmflexError ArmflexWarning InputError",
    "armflex.estimate": "Bootstrap Calibration bootstrap calibrate",
    "armflex.estimate.draw": "draw_arms ensemble",
    "armflex.estimate.tip_uncertainty": "total_covariance",
    "armflex.files.arm_file": "load_arm make_arm",
    "armflex.laws.law_file": "load_law save_law",
    "armflex.measured.joint_data": "read_joint_data",
    "armflex.measured.measurements": "Measurements read_measurements",
    "armflex.measured.points": "PointExport read_points",
    "armflex.measured.repeats": "Repeats repeats",
    "armflex.mechanics.deflection": "Deflection DeflectionBatch",
    "armflex.mechanics.loaded": "Payload",
    "armflex.plan.drive": "write_plan",
    "armflex.plan.picture": "draw_plan",
    "armflex.plan.planning": "plan",
    "armflex.robot": "load_robot",
    "armflex.rows.poses": "leaked pose_groups",
    "armflex.rows.wrench": "Wrench",
    "armflex.show.view": "draw_laws view",
    "armflex.show.view.map_page": "map_page",
    "armflex.tasks.check": "CheckReport check",
    "armflex.tasks.compensate": "Compensation compensate",
    "armflex.tasks.iso9283": "PosePerformance iso9283",
    "armflex.tasks.predict": "Prediction predict",
    "armflex.tasks.workspace": "WorkspaceMap draw_map map_workspace read_map write_map",
    "armflex.trace": "trace",
    "armflex.track": "Reading Tracker",
    "armflex.trajectory": "Trajectory read_trajectory write_trajectory",
}
"""The names of every module that are the package's own."""

EXPORTS = {name: module for module, names in HOMES.items() for name in names.split()}

__all__ = ["__version__", *EXPORTS]


class _Package(ModuleType):
    """The package as a module: `trace` and `plan` stay functions when the packages of their names are imported."""

    def __setattr__(self, name: str, value: object) -> None:
        if not (name in EXPORTS and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


def __getattr__(name: str) -> object:
    """Return a name of `EXPORTS`, which is then there."""
    if name not in EXPORTS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(EXPORTS[name]), name)
    return value


def __dir__() -> list[str]:
    """Return the names that are the package's own, imported or not, and nothing else."""
    return sorted(__all__)


sys.modules[__name__].__class__ = _Package
