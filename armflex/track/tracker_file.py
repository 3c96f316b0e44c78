"""Everything that a tracker has learnt from its readings, and the file that holds it; see `storage.array_file`."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.errors import ModelFileError, Place, UnknownNameError
from armflex.robot import Robot
from armflex.rows.branch import Branch
from armflex.rows.wrench import Wrench
from armflex.storage.array_file import Layout, read_arrays, write_arrays
from armflex.storage.digest import digest
from armflex.storage.schema import Numbers
from armflex.track.estimate import Estimate, LinearisedReading
from armflex.track.reading import Reading
from armflex.track.state_space import model_of
from armflex.track.watch import FEWEST, LONGEST, Anchor, Change, Watch


@dataclass
class TrackerState:
    """What changes from reading to reading.

    Attributes:
        estimate: Of all parameters, as steps from `point`; see `Model.at`.
        point: (P,) values at which the arm is linearised.
        watch: The last readings.
        count: How many readings were taken in.
        outliers: How many of them counted less than in full.
        session: The session that the last one was of.
        time: When that was [s].
        timed: Whether readings have times, None before the first.
        clock: Time that drift depends on, in seconds or readings.
        drifted: Clock up to which drift is in the estimate.
        waiting: Readings since then.
        patience: How long drift may wait.
        q: Joint positions of the last one, None before the first.
        approach: Direction that each joint last moved in: -1 or 1, 0 where it has not.
        changes: What was announced.
    """

    estimate: Estimate
    point: Array
    watch: Watch
    count: int = 0
    outliers: int = 0
    session: str | None = None
    time: float | None = None
    timed: bool | None = None
    clock: float = 0.0
    drifted: float = 0.0
    waiting: int = 0
    patience: float = 0.0
    q: list[float] | None = None
    approach: list[float] | None = None
    changes: list[Change] = field(default_factory=list)

    @property
    def now(self) -> Anchor:
        """The estimate as it is, to go back to."""
        return Anchor(self.estimate, self.count, self.drifted)


def _as_they_are(kind: type, *others: str) -> dict[str, Any]:
    """Return the types of a dataclass's fields by name, but for some others."""
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in fields(kind) if field.name not in others}


PLAIN = _as_they_are(TrackerState, "estimate", "point", "watch", "changes")
WATCH = _as_they_are(Watch, "first", "later", "window", "readings")

WRENCH = {
    **dict.fromkeys(("frame", "axes"), str),
    **dict.fromkeys(("force", "moment"), tuple[float, float, float]),
    "positions": dict[str, float] | None,
}
"""A load from outside; of what hangs beside the chain its joints' positions, too."""


READING = {
    "q": list[float],
    "position": tuple[float, float, float] | None,
    "sigma": float | tuple[float, float, float],
    **dict.fromkeys(("payload", "session"), str),
    **dict.fromkeys(("time", "sigma_r"), float | None),
    "rotation": tuple[float, float, float] | None,
    "covariates": dict[str, float],
    "sensors": dict[str, list[float]],
    "wrenches": list[WRENCH],
}

CHANGE = _as_they_are(Change, "parameters", "size", "std") | {"name": str, "labels": tuple[str, ...]}

ESTIMATES = ("now", "first", "later")
"""The present one, and those of the watch's anchors."""


def _declared(about: Mapping[str, Any]) -> dict[str, Numbers]:
    declared = {"point": Numbers(("parameters",))}
    for name in ESTIMATES:
        declared |= {f"{name} values": Numbers(("parameters",)), f"{name} root": Numbers(("parameters",) * 2)}
    for i in range(len(about["watch"]["weights"])):
        declared[f"window {i} residual"] = Numbers((f"numbers {i}",))
        declared[f"window {i} columns"] = Numbers((f"numbers {i}", "parameters"))
    for i, change in enumerate(about["changes"]):
        declared[f"change {i} size"] = Numbers((len(change["labels"]),))
        declared[f"change {i} std"] = Numbers((len(change["labels"]),), least=0.0)
    return declared


LAYOUT = Layout(
    "a tracker's state",
    "armflex-tracker-4",
    _declared,
    {
        "about": {"arm": str, "rates": dict[str, float], "sigma": float},
        "plain": PLAIN,
        "anchors": tuple[tuple[int, float], tuple[int, float]],
        "watch": WATCH,
        "readings": list[READING],
        "changes": list[CHANGE],
    },
    lambda about: {f"numbers {i}": range(1, 1000) for i in range(len(about["watch"]["weights"]))},  # of a reading
    anew="begin a new tracker",
    error=ModelFileError,
)


def write_state(state: TrackerState, about: Mapping[str, Any], path: Path) -> Path:
    """Write a state, and what it is of, whole or not at all; return the path."""
    watch, arrays = state.watch, {"point": state.point}
    for name, estimate in zip(ESTIMATES, (state.estimate, watch.first.estimate, watch.later.estimate), strict=True):
        arrays |= {f"{name} values": estimate.values, f"{name} root": estimate.root}
    for i, seen in enumerate(watch.window):
        arrays |= {f"window {i} residual": seen.residual, f"window {i} columns": seen.jacobian}
    for i, change in enumerate(state.changes):
        arrays |= {f"change {i} size": change.size, f"change {i} std": change.std}
    numbers = ("q", "position", "sigma", "rotation", "sigma_r", "time")  # found good; what was given may be of any kind
    readings = []
    for reading in watch.readings:
        saved = {name: getattr(reading, name) for name in READING if name not in ("sensors", "wrenches")}
        saved |= {name: np.asarray(saved[name], dtype=float).tolist() for name in numbers if saved[name] is not None}
        saved["covariates"] = {name: float(value) for name, value in reading.covariates.items()}
        saved["sensors"] = {
            name: np.atleast_1d(np.asarray(read, dtype=float)).tolist() for name, read in reading.sensors.items()
        }
        saved["wrenches"] = []
        for wrench in reading.wrenches:
            at = (
                {joint: float(value) for joint, value in wrench.positions.items()}
                if isinstance(wrench, Branch)
                else None
            )
            load = {
                "frame": wrench.frame,
                "axes": wrench.axes,
                "force": wrench.force.tolist(),
                "moment": wrench.moment.tolist(),
            }
            saved["wrenches"].append(load | {"positions": at})
        readings.append(saved)
    said = {
        "about": dict(about),
        "plain": {name: getattr(state, name) for name in PLAIN},
        "anchors": [[anchor.count, anchor.drifted] for anchor in (watch.first, watch.later)],
        "watch": {name: getattr(watch, name) for name in WATCH},
        "readings": readings,
        "changes": [{name: getattr(change, name) for name in CHANGE} for change in state.changes],
    }
    write_arrays(path, LAYOUT, arrays, said)
    return path


def read_state(path: Path, arm: Arm) -> tuple[TrackerState, dict[str, Any]]:
    """Return a state of an arm as tracking began with it, and what else it is of.

    Raises:
        ModelFileError: Missing, damaged, no tracker's state, or that of another arm.
        UnknownNameError: The arm has no such parameter.
    """
    said, arrays, _ = read_arrays(path, LAYOUT)
    about, parameter_of = said["about"], {}
    if about["arm"] != digest(arm):
        raise ModelFileError(Place(path), "is of another arm: expected the one that the tracker began with")
    if said["changes"]:
        parameter_of = {parameter.label: parameter for parameter in model_of(arm).parameters}
    changes = []
    for i, saved in enumerate(said["changes"]):
        for label in saved["labels"]:
            if label not in parameter_of:
                raise UnknownNameError("parameter", label, parameter_of)
        parameters = tuple(parameter_of[label] for label in saved["labels"])
        size, std = arrays[f"change {i} size"], arrays[f"change {i} std"]
        numbers = {name: value for name, value in saved.items() if name not in ("name", "labels")}
        changes.append(Change(parameters, **numbers, size=size, std=std))
    now, *before = (Estimate(arrays[f"{name} values"], arrays[f"{name} root"]) for name in ESTIMATES)
    first, later = (Anchor(estimate, *saved) for estimate, saved in zip(before, said["anchors"], strict=True))
    count = len(said["watch"]["weights"])
    readings = [
        Reading(**saved | {"wrenches": tuple(_read(wrench, arm.robot) for wrench in saved["wrenches"])})
        for saved in said["readings"]
    ]
    window = [LinearisedReading(arrays[f"window {i} residual"], arrays[f"window {i} columns"]) for i in range(count)]
    watch = Watch(first, later, window, **said["watch"], readings=readings)
    state = TrackerState(now, arrays["point"], watch, changes=changes, **said["plain"])
    if problem := _problem(state):
        raise ModelFileError(Place(path), f"does not hold {LAYOUT.what}: {problem}; {LAYOUT.anew}")
    return state, about


def _read(saved: Mapping[str, Any], robot: Robot) -> Wrench:
    """Return a load that was written."""
    given = (saved["frame"], np.array(saved["force"]), np.array(saved["moment"]), saved["axes"])
    if saved["positions"] is None:
        return Wrench(*given)
    return Branch(*given, robot=robot, positions={name: np.array(at) for name, at in saved["positions"].items()})


def _problem(state: TrackerState) -> str | None:
    """Return what in a state contradicts the rest of it."""
    watch, size = state.watch, len(state.watch.window)
    first, later, begun = watch.first, watch.later, state.count > 0
    times = [reading.time for reading in watch.readings]
    given = [time for time in (*times, state.time) if time is not None]
    judged = watch.unsettled > 0 or len(times) > 0
    rules = {
        "its counts of readings": state.count == first.count + size
        and 0 <= first.count <= later.count <= state.count
        and 0 <= state.outliers <= state.count
        and state.waiting >= 0,
        "its times": 0.0 <= first.drifted <= later.drifted <= state.drifted <= state.clock
        and state.patience >= 0.0
        and given == sorted(given)
        and len(given) == (len(times) + 1 if state.timed else 0),
        "its beginning": begun == (state.timed is not None) == (state.session is not None),
        "its clock": bool(state.timed) or state.clock == state.count,
        "its window": size <= LONGEST
        and all(0.0 <= weight <= 1.0 for weight in watch.weights)
        and 0.0 < watch.part <= 1.0
        and watch.total >= 0.0
        and 0 <= watch.rising <= size
        and 0 <= watch.unsettled <= FEWEST,
        "the readings of its window": len(times) == (size if judged else 0)
        and all(
            len(seen.residual) == reading.size for seen, reading in zip(watch.window, watch.readings, strict=False)
        ),
        "its directions": (state.q is None) == (state.approach is None)
        and len(state.q or ()) == len(state.approach or ())
        and set(state.approach or ()) <= {-1.0, 0.0, 1.0},
        "its changes": all(
            0.0 <= change.probability <= 1.0
            and 1 <= change.since <= change.reading <= state.count
            and all(0.0 <= share <= 1.0 for _, share in change.others)
            and len({parameter.group for parameter in change.parameters}) == 1
            and len(set(change.parameters)) == len(change.parameters)
            for change in state.changes
        ),
    }
    broken = [name for name, kept in rules.items() if not kept]
    return f"{' and '.join(broken)} cannot have come about" if broken else None
