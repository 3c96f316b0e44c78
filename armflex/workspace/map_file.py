"""A map as a file: .npz with everything in it, or .csv with a line for each voxel."""

from __future__ import annotations

import json
import zipfile
from dataclasses import asdict, fields
from io import BytesIO
from pathlib import Path

import numpy as np

from armflex.errors import FileError, Flag, InputError, Place
from armflex.measured.table import write_table
from armflex.whole_file import write_whole
from armflex.workspace.workspace_map import WorkspaceMap

FORMAT = "armflex-map-3"
SUFFIXES = (".npz", ".csv")
COUNTS = ("index", "configurations", "answered", "refused", "worst_payload")
OPTIONAL = ("sigma", "worst_of_draws")
ARRAYS = (*COUNTS, "mean", "worst", *OPTIONAL, "worst_q")


def write_map(found: WorkspaceMap, path: str | Path, tolerance: float | None = None) -> Path:
    """Write a map, whole or not at all; return the path.

    Args:
        found: The map.
        path: Ends in .npz or .csv. `read_map` reads an .npz; a .csv is for other programs: SI, cells without a value
            are blank, also where a drawn arm has no answer.
        tolerance: Adds the columns `margin` and `verdict` to a .csv [m].

    Raises:
        InputError: The path ends otherwise, or the tolerance is no positive length.
        FileError: It cannot be written.
    """
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: expected a name that ends in {' or '.join(SUFFIXES)}")
    if path.suffix == ".csv":
        return write_table(path, _columns(found, tolerance))
    file = BytesIO()
    arrays = {name: getattr(found, name) for name in ARRAYS if getattr(found, name) is not None}
    rest = {field.name: getattr(found, field.name) for field in fields(found) if field.name not in ARRAYS}
    rest["flags"] = [asdict(flag) for flag in found.flags]
    np.savez_compressed(file, about=json.dumps({"format": FORMAT, **rest}), **arrays)
    return write_whole(path, file.getvalue())


def read_map(path: str | Path) -> WorkspaceMap:
    """Read a map that `write_map` wrote as .npz.

    Raises:
        FileError: The file cannot be read, is damaged, or is no map.
    """
    place = Place(Path(path))
    try:
        with np.load(path, allow_pickle=False) as file:
            about = json.loads(str(file["about"]))
            arrays = {name: file[name] for name in ARRAYS if name in file.files}
    except (OSError, ValueError, KeyError, EOFError, AttributeError, zipfile.BadZipFile) as error:
        raise FileError(place, f"is no map that can be read: {error}") from None
    if not isinstance(about, dict) or about.pop("format", None) != FORMAT:
        raise FileError(place, f"is no map of format {FORMAT}")
    try:
        flags = tuple(Flag(**flag) for flag in about.pop("flags"))
        lists = {name: tuple(about.pop(name)) for name in ("reasons", "payloads", "joints")}
        found = WorkspaceMap(**{**dict.fromkeys(OPTIONAL), **arrays}, **lists, **about, flags=flags)
        _check(found)
    except (TypeError, KeyError, ValueError) as error:
        raise FileError(place, f"is a damaged map: {error}") from None
    return found


def _check(found: WorkspaceMap) -> None:
    """Raise `ValueError` where arrays do not fit each other."""
    shapes = {"index": (3,), "refused": (len(found.reasons),), "worst_q": (len(found.joints),)}
    for name in ARRAYS:
        values, expected = getattr(found, name), (len(found), *shapes.get(name, ()))
        if values is not None and (values.shape != expected or (values.dtype.kind == "i") != (name in COUNTS)):
            raise ValueError(f"{name!r} is {values.dtype} {values.shape}, expected {expected}")
    if (found.worst_of_draws is None) != (found.draws == 0):
        raise ValueError(f"{found.draws} draws, expected 'worst_of_draws' where there are any, and only there")


def _columns(found: WorkspaceMap, tolerance: float | None) -> dict[str, list]:
    columns: dict[str, list] = {axis: found.centres[:, i].tolist() for i, axis in enumerate("xyz")}
    columns |= {name: getattr(found, name).tolist() for name in ("configurations", "answered")}
    columns |= {f"refused_{name}": found.refused[:, i].tolist() for i, name in enumerate(found.reasons)}
    sizes = {name: getattr(found, name) for name in ("mean", "worst", *OPTIONAL)}
    if tolerance is not None:
        sizes["margin"] = found.margin(tolerance)
    for name, values in sizes.items():
        columns[name] = [""] * len(found) if values is None else [x if np.isfinite(x) else "" for x in values.tolist()]
    if tolerance is not None:
        columns["verdict"] = found.verdicts(tolerance).tolist()
    columns["payload"] = [found.payloads[i] for i in found.worst_payload]
    return columns | {f"q_{joint}": found.worst_q[:, i].tolist() for i, joint in enumerate(found.joints)}
