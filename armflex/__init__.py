"""armflex: manipulators that sag. Joint compliance, end-effector deflection, path checks and compensation.

A name is imported when it is first asked for: to load an arm and ask for its deflection needs nothing that fits one.
"""

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
    from armflex.estimate import calibrate as calibrate
    from armflex.estimate.draw import ensemble as ensemble
    from armflex.estimate.tip_uncertainty import total_covariance as total_covariance
    from armflex.files.arm_file import load_arm as load_arm
    from armflex.files.arm_file import make_arm as make_arm
    from armflex.laws.law_file import load_law as load_law
    from armflex.laws.law_file import save_law as save_law
    from armflex.measured.campaign_clock import as_in as as_in
    from armflex.measured.joint_data import read_joint_data as read_joint_data
    from armflex.measured.measurements import Measurements as Measurements
    from armflex.measured.measurements import read_measurements as read_measurements
    from armflex.mechanics.loaded import Payload as Payload
    from armflex.plan.drive import write_plan as write_plan
    from armflex.plan.planning import plan as plan
    from armflex.rows.wrench import Wrench as Wrench
    from armflex.show.view import draw_laws as draw_laws
    from armflex.show.view import view as view
    from armflex.tasks.check import check as check
    from armflex.tasks.compensate import compensate as compensate
    from armflex.tasks.iso9283 import iso9283 as iso9283
    from armflex.tasks.predict import predict as predict
    from armflex.tasks.rehearse import rehearse as rehearse
    from armflex.tasks.workspace import map_workspace as map_workspace
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
    "armflex.estimate": "calibrate",
    "armflex.estimate.draw": "ensemble",
    "armflex.estimate.tip_uncertainty": "total_covariance",
    "armflex.files.arm_file": "load_arm make_arm",
    "armflex.laws.law_file": "load_law save_law",
    "armflex.measured.campaign_clock": "as_in",
    "armflex.measured.joint_data": "read_joint_data",
    "armflex.measured.measurements": "Measurements read_measurements",
    "armflex.mechanics.loaded": "Payload",
    "armflex.plan.drive": "write_plan",
    "armflex.plan.planning": "plan",
    "armflex.rows.wrench": "Wrench",
    "armflex.show.view": "draw_laws view",
    "armflex.tasks.check": "check",
    "armflex.tasks.compensate": "compensate",
    "armflex.tasks.iso9283": "iso9283",
    "armflex.tasks.predict": "predict",
    "armflex.tasks.rehearse": "rehearse",
    "armflex.tasks.workspace": "map_workspace",
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
