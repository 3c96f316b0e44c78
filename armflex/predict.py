"""The tip's pose for every row of a table of joint positions and payloads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from armflex.arm import Arm
from armflex.conventions import TWIST_NAMES, Array
from armflex.deflection import Deflection
from armflex.errors import ArmflexError, Flag, Place, TableError
from armflex.table import read_table, write_table
from armflex.trajectory import check_payloads, joint_kinds, misspelt

IDENTIFYING = ("pose", "session", "time", "payload")
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Rows:
    """Inputs of a prediction: (N, nq) joint positions, payload names, and the columns that identify the rows."""

    q: Array
    payload: tuple[str, ...]
    identity: Mapping[str, tuple[str, ...]]
    places: tuple[Place, ...]


@dataclass(frozen=True)
class Prediction:
    """Where the tip will be, base frame.

    Attributes:
        rows: What was asked.
        position: (N, 3) tip origin [m].
        rotation: (N, 3) rotation vector of the tip's orientation [rad].
        sigma: (N, 3) standard uncertainty of the position [m], None where no law carries one.
        displacement: (N, 6) flexed minus rigid, base axes [m, rad].
        flags: Doubts, each with the first row it concerns.
    """

    rows: Rows
    position: Array
    rotation: Array
    sigma: Array | None
    displacement: Array
    flags: tuple[Flag, ...]


def read_rows(path: str | Path, arm: Arm) -> Rows:
    """Read the joint positions and payloads of a campaign or any table like it; measured columns are not used.

    Raises:
        TableError: A joint's column is missing or not numeric, or a payload is unknown.
    """
    table = read_table(path, joint_kinds(arm, "q"))
    names = [f"q_{joint}" for joint in arm.joint_names]
    table.require(names)
    if not len(table):
        raise TableError(Place(table.path), "has a header but no rows")
    if "payload" not in table.columns and any(misspelt(name, ["payload"]) for name in table.columns):
        table.require(["payload"])
    payload = table.texts("payload") if "payload" in table.columns else ("none",) * len(table)
    check_payloads(table, payload, arm)
    identity = {name: table.texts(name) for name in IDENTIFYING if name in table.columns}
    places = tuple(Place(table.path, line) for line in table.lines)
    return Rows(table.matrix(names), tuple(name or "none" for name in payload), identity, places)


def predict(arm: Arm, rows: Rows, progress: Progress | None = None) -> Prediction:
    """Return the tip's pose and displacement for every row.

    Raises:
        ArmflexError: A row cannot be computed; its file and line are named.
    """
    found: list[Deflection] = []
    for i, q in enumerate(rows.q):
        try:
            found.append(arm.deflection(q, rows.payload[i]))
        except ArmflexError as error:
            error.args = (f"{rows.places[i]}: {error.args[0]}", *error.args[1:])
            raise
        if progress:
            progress(i + 1, len(rows.q))
    sigma = None
    if any(one.covariance is not None for one in found):
        sigma = np.array([np.sqrt(np.diag(_known(one))[:3]) for one in found])
    return Prediction(
        rows,
        np.array([one.pose.translation for one in found]),
        np.array([pin.log3(one.pose.rotation) for one in found]),
        sigma,
        np.array([one.displacement for one in found]),
        _flags(arm, found),
    )


def _known(one: Deflection) -> Array:
    return np.zeros((6, 6)) if one.covariance is None else one.covariance


def _flags(arm: Arm, found: list[Deflection]) -> tuple[Flag, ...]:
    flags: dict[str, Flag] = {}
    if arm.measurement.frame == "unknown":
        text = f"the instrument's place is not known, so positions are in the base frame {arm.robot.base!r}"
        flags["base_frame"] = Flag("base_frame", text)
    for number, one in enumerate(found):
        for flag in one.flags:
            flags.setdefault(flag.code, Flag(flag.code, f"row {number}: {flag.text}"))
    return tuple(flags.values())


def write_predictions(prediction: Prediction, path: str | Path) -> Path:
    """Write x y z, sigma_*, the orientation pose_r*, and the displacement dx to rz; whole or not at all."""
    columns: dict[str, list] = {name: list(cells) for name, cells in prediction.rows.identity.items()}
    columns |= {axis: prediction.position[:, i].tolist() for i, axis in enumerate("xyz")}
    columns |= {f"pose_r{axis}": prediction.rotation[:, i].tolist() for i, axis in enumerate("xyz")}
    blank = [""] * len(prediction.position)
    sigma = prediction.sigma
    columns |= {f"sigma_{axis}": blank if sigma is None else sigma[:, i].tolist() for i, axis in enumerate("xyz")}
    columns |= {name: prediction.displacement[:, i].tolist() for i, name in enumerate(TWIST_NAMES)}
    return write_table(path, columns)
