"""A tracker's state in a file: safetensors for the arrays, strict JSON for the rest, and a digest of both."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from armflex.errors import ModelFileError, Place
from armflex.tracking.estimate import Estimate, Seen
from armflex.tracking.reading import Reading
from armflex.tracking.state import State
from armflex.tracking.watch import Anchor, Change, Watch
from armflex.whole_file import write_whole

KEY, FORMAT = "armflex", "armflex-tracker-2"
PLAIN = ("count", "outliers", "session", "time", "timed", "clock", "drifted", "waiting", "patience", "q", "approach")
"""What of a state is told as it is."""

Tensors = dict[str, np.ndarray]


def write_state(state: State, about: Mapping[str, Any], path: Path) -> Path:
    """Write a state, and what it is of, whole or not at all; return the path."""
    watch = state.watch
    tensors = {"point": state.point, **_told_estimate("now", state.estimate)}
    tensors |= _told_estimate("first", watch.first.estimate) | _told_estimate("later", watch.later.estimate)
    for i, seen in enumerate(watch.window):
        tensors |= {f"window {i} residual": seen.residual, f"window {i} columns": seen.columns}
    for i, change in enumerate(state.changes):
        tensors |= {f"change {i} size": change.size, f"change {i} std": change.std}
    said = {
        "format": FORMAT,
        "about": dict(about),
        "plain": {name: getattr(state, name) for name in PLAIN},
        "anchors": [[anchor.count, anchor.drifted] for anchor in (watch.first, watch.later)],
        "watch": [watch.weights, watch.total, watch.rising, watch.unsettled, watch.part],
        "readings": [_told_reading(reading) for reading in watch.readings],
        "changes": [_told_change(change) for change in state.changes],
    }
    tensors = {name: np.ascontiguousarray(values) for name, values in tensors.items()}
    text = json.dumps(said | {"digest": _digest(tensors, said)}, allow_nan=False, sort_keys=True)
    return write_whole(path, save(tensors, metadata={KEY: text}))  # several keys would come in any order


def read_state(path: Path) -> tuple[State, dict[str, Any]]:
    """Return a state, and what it is of.

    Raises:
        ModelFileError: Missing, damaged, or no tracker's state.
    """
    said, tensors = _read(path)
    try:
        return _state(said, tensors), said["about"]
    except (KeyError, TypeError, ValueError) as error:
        raise ModelFileError(Place(path), f"does not hold a tracker's state: {error}") from None


def _state(said: Mapping[str, Any], tensors: Tensors) -> State:
    anchors = [
        Anchor(_estimate(name, tensors), *numbers)
        for name, numbers in zip(("first", "later"), said["anchors"], strict=True)
    ]
    weights, *numbers = said["watch"]
    window = [Seen(tensors[f"window {i} residual"], tensors[f"window {i} columns"]) for i in range(len(weights))]
    changes = [_change(i, told, tensors) for i, told in enumerate(said["changes"])]
    readings = [Reading(**told) for told in said["readings"]]
    watch = Watch(anchors[0], anchors[1], window, weights, *numbers, readings)
    return State(_estimate("now", tensors), tensors["point"], watch, changes=changes, **said["plain"])


def _told_estimate(name: str, estimate: Estimate) -> Tensors:
    return {f"{name} values": estimate.values, f"{name} root": estimate.root}


def _estimate(name: str, tensors: Tensors) -> Estimate:
    return Estimate(tensors[f"{name} values"], tensors[f"{name} root"])


def _told_reading(reading: Reading) -> dict[str, Any]:
    """Return what a reading says in plain numbers: it was found good, and what was given may be of any kind."""
    numbers = ("q", "position", "sigma", "rotation", "sigma_r", "time")
    told = {name: value for name, value in vars(reading).items() if value is not None}
    told |= {name: np.asarray(told[name], dtype=float).tolist() for name in numbers if name in told}
    return told | {"covariates": {name: float(value) for name, value in reading.covariates.items()}}


def _told_change(change: Change) -> dict[str, Any]:
    return {name: value for name, value in vars(change).items() if name not in ("size", "std")}


def _change(i: int, told: Mapping[str, Any], tensors: Tensors) -> Change:
    others = tuple((name, share) for name, share in told["others"])
    known = {**told, "labels": tuple(told["labels"]), "others": others}
    return Change(**known, size=tensors[f"change {i} size"], std=tensors[f"change {i} std"])


def _read(path: Path) -> tuple[dict[str, Any], Tensors]:
    try:
        with safe_open(path, framework="numpy") as file:
            said = json.loads((file.metadata() or {}).get(KEY, "null"))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dict
    except (SafetensorError, OSError, ValueError, TypeError) as error:
        raise ModelFileError(Place(path), f"is not a readable safetensors file: {error}") from None
    if not isinstance(said, dict) or said.get("format") != FORMAT:
        raise ModelFileError(Place(path), f"is no tracker's state: expected format {FORMAT!r}")
    kept = {name: value for name, value in said.items() if name != "digest"}
    if said.get("digest") != _digest(tensors, kept):
        raise ModelFileError(Place(path), "its SHA-256 is not that of its content: the file is damaged")
    return kept, tensors


def _digest(tensors: Tensors, said: Mapping[str, Any]) -> str:
    """Return the SHA-256 of every array and of what is said about them."""
    whole = hashlib.sha256(json.dumps(said, sort_keys=True).encode())
    for name in sorted(tensors):
        whole.update(f"{name} {tensors[name].dtype.str} {tensors[name].shape} ".encode() + tensors[name].tobytes())
    return whole.hexdigest()
