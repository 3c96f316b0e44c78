"""A tracker's state in a file, see `storage.array_file`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from armflex.errors import ModelFileError, Place
from armflex.storage.array_file import Layout, read_arrays, write_arrays
from armflex.storage.schema import Numbers
from armflex.track.estimate import Estimate, Seen
from armflex.track.reading import Reading
from armflex.track.tracker_file import State
from armflex.track.watch import FEWEST, LONGEST, Anchor, Change, Watch

PLAIN = {
    **dict.fromkeys(("count", "outliers", "waiting"), int),
    "session": str | None,
    "time": float | None,
    "timed": bool | None,
    **dict.fromkeys(("clock", "drifted", "patience"), float),
    **dict.fromkeys(("q", "approach"), list[float] | None),
}
"""What of a state is told as it is."""

WATCH = {"weights": list[float], "total": float, "rising": int, "unsettled": int, "part": float}

READING = {
    "q": list[float],
    "position": tuple[float, float, float],
    "sigma": float | tuple[float, float, float],
    **dict.fromkeys(("payload", "session"), str),
    **dict.fromkeys(("time", "sigma_r"), float | None),
    "rotation": tuple[float, float, float] | None,
    "covariates": dict[str, float],
}

CHANGE = {
    "name": str,
    "probability": float,
    **dict.fromkeys(("reading", "since"), int),
    "labels": tuple[str, ...],
    "others": tuple[tuple[str, float], ...],
}

ESTIMATES = ("now", "first", "later")
"""The present one, and those of the watch's anchors."""


def _arrays(about: Mapping[str, Any]) -> dict[str, Numbers]:
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
    "armflex-tracker-3",
    _arrays,
    {
        "about": {"arm": str, "rates": dict[str, float], "sigma": float},
        "plain": PLAIN,
        "anchors": tuple[tuple[int, float], tuple[int, float]],
        "watch": WATCH,
        "readings": list[READING],
        "changes": list[CHANGE],
    },
    lambda about: {f"numbers {i}": (3, 6) for i in range(len(about["watch"]["weights"]))},
    anew="begin a new tracker",
    error=ModelFileError,
)


def write_state(state: State, about: Mapping[str, Any], path: Path) -> Path:
    """Write a state, and what it is of, whole or not at all; return the path."""
    watch = state.watch
    estimates = zip(ESTIMATES, (state.estimate, watch.first.estimate, watch.later.estimate), strict=True)
    arrays = {"point": state.point}
    for name, estimate in estimates:
        arrays |= {f"{name} values": estimate.values, f"{name} root": estimate.root}
    for i, seen in enumerate(watch.window):
        arrays |= {f"window {i} residual": seen.residual, f"window {i} columns": seen.columns}
    for i, change in enumerate(state.changes):
        arrays |= {f"change {i} size": change.size, f"change {i} std": change.std}
    said = {
        "about": dict(about),
        "plain": {name: getattr(state, name) for name in PLAIN},
        "anchors": [[anchor.count, anchor.drifted] for anchor in (watch.first, watch.later)],
        "watch": {name: getattr(watch, name) for name in WATCH},
        "readings": [_told_reading(reading) for reading in watch.readings],
        "changes": [{name: getattr(change, name) for name in CHANGE} for change in state.changes],
    }
    write_arrays(path, LAYOUT, arrays, said)
    return path


def read_state(path: Path) -> tuple[State, dict[str, Any]]:
    """Return a state, and what it is of.

    Raises:
        ModelFileError: Missing, damaged, or no tracker's state.
    """
    said, arrays, _ = read_arrays(path, LAYOUT)
    now, *before = (Estimate(arrays[f"{name} values"], arrays[f"{name} root"]) for name in ESTIMATES)
    first, later = (Anchor(estimate, *told) for estimate, told in zip(before, said["anchors"], strict=True))
    count = len(said["watch"]["weights"])
    window = [Seen(arrays[f"window {i} residual"], arrays[f"window {i} columns"]) for i in range(count)]
    changes = [
        Change(**told, size=arrays[f"change {i} size"], std=arrays[f"change {i} std"])
        for i, told in enumerate(said["changes"])
    ]
    watch = Watch(first, later, window, **said["watch"], readings=[Reading(**told) for told in said["readings"]])
    state = State(now, arrays["point"], watch, changes=changes, **said["plain"])
    if problem := _problem(state):
        raise ModelFileError(Place(path), f"does not hold {LAYOUT.what}: {problem}; {LAYOUT.anew}")
    return state, said["about"]


def _told_reading(reading: Reading) -> dict[str, Any]:
    """Return what a reading says in plain numbers: it was found good, and what was given may be of any kind."""
    numbers = ("q", "position", "sigma", "rotation", "sigma_r", "time")
    told = {name: getattr(reading, name) for name in READING}
    told |= {name: np.asarray(told[name], dtype=float).tolist() for name in numbers if told[name] is not None}
    return told | {"covariates": {name: float(value) for name, value in reading.covariates.items()}}


def _problem(state: State) -> str | None:
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
            and len(set(change.labels)) == len(change.labels) > 0
            for change in state.changes
        ),
    }
    broken = [name for name, kept in rules.items() if not kept]
    return f"{' and '.join(broken)} cannot have come about" if broken else None
