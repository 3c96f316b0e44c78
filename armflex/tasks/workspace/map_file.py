"""A map as a file: .safetensors with everything in it, or .csv with a line for each voxel."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path

import numpy as np

from armflex.arguments import checked_kinds
from armflex.errors import FileError, Flag, InputError, Place
from armflex.measured.table import write_table
from armflex.storage.array_file import Layout, read_arrays, write_arrays
from armflex.storage.schema import Numbers
from armflex.tasks.workspace.cells import SIDE
from armflex.tasks.workspace.workspace_map import WorkspaceMap

SUFFIXES = (".safetensors", ".csv")
INF, NAN = float("inf"), float("nan")

ARRAYS = {
    "index": Numbers(("voxels", 3), "i8", least=-SIDE, most=SIDE - 1),
    "configurations": Numbers(("voxels",), "i8", least=0),
    "answered": Numbers(("voxels",), "i8", least=0),
    "refused": Numbers(("voxels", "reasons"), "i8", least=0),
    "worst_payload": Numbers(("voxels",), "i8", least=0),
    "mean": Numbers(("voxels",), least=0.0, beside=(NAN,)),
    "worst": Numbers(("voxels",), least=0.0, beside=(NAN,)),
    "sigma": Numbers(("voxels",), least=0.0, beside=(NAN,), optional=True),
    "worst_of_draws": Numbers(("voxels",), least=0.0, beside=(INF,), optional=True),
    "frequency": Numbers(("voxels",), least=0.0, beside=(NAN,), optional=True),
    "worst_q": Numbers(("voxels", "joints")),
}
OPTIONAL = tuple(name for name, numbers in ARRAYS.items() if numbers.optional)
LISTS = ("reasons", "payloads", "joints")

LAYOUT = Layout(
    "a workspace map",
    "armflex-map-4",
    ARRAYS,
    {
        "voxel": float,
        **dict.fromkeys(LISTS, tuple[str, ...]),
        **dict.fromkeys(("base", "tip"), str),
        **dict.fromkeys(("rows", "seed", "draws"), int),
        "flags": tuple[Flag, ...],
    },
    lambda about: {"voxels": range(1, about["rows"] + 1), **{name: (len(about[name]),) for name in LISTS}},
    anew="make the map anew",
    most_bytes=1 << 30,
)


@checked_kinds
def write_map(found: WorkspaceMap, path: str | Path, tolerance: float | None = None) -> Path:
    """Write a map, whole or not at all; return the path.

    Args:
        found: The map.
        path: Ends in .safetensors or .csv. `read_map` reads the first; a .csv is for other programs: SI, cells without
            a value are blank, also where a drawn arm has no answer.
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
    arrays = {name: getattr(found, name) for name in ARRAYS if getattr(found, name) is not None}
    about = {field.name: getattr(found, field.name) for field in fields(found) if field.name not in ARRAYS}
    write_arrays(path, LAYOUT, arrays, about | {"flags": [asdict(flag) for flag in found.flags]})
    return path


@checked_kinds
def read_map(path: str | Path) -> WorkspaceMap:
    """Read a map that `write_map` wrote as .safetensors.

    Raises:
        FileError: The file cannot be read, is damaged, was made by another version, or is no map.
    """
    path = Path(path)
    if path.suffix == ".npz":
        raise FileError(Place(path), f"was made by an earlier version, expected .safetensors; {LAYOUT.anew}")
    about, arrays, _ = read_arrays(path, LAYOUT)
    found = WorkspaceMap(**{**dict.fromkeys(OPTIONAL), **arrays}, **about)
    try:
        _check(found)
    except ValueError as error:
        raise FileError(Place(path), f"does not hold {LAYOUT.what}: {error}; {LAYOUT.anew}") from None
    return found


def _check(found: WorkspaceMap) -> None:
    """Raise `ValueError` where what a map says does not go together."""
    some, asked = found.answered > 0, found.rows * len(found.payloads)
    if not (found.voxel > 0.0 and found.seed >= 0 and found.draws >= 0):
        raise ValueError(f"voxel {found.voxel:g}, seed {found.seed}, draws {found.draws}: expected no negative numbers")
    for name in LISTS:
        if len(set(getattr(found, name))) < len(getattr(found, name)):
            raise ValueError(f"one of the {name} is there twice")
    steps = np.diff(found.index, axis=0)
    first = np.take_along_axis(steps, (steps != 0).argmax(axis=1)[:, None], axis=1)
    if not ((first > 0).all() and (found.worst_payload < len(found.payloads)).all()):
        raise ValueError("its voxels are not in order, or a payload is not among those asked for")
    if found.configurations.sum() != found.rows or found.answered.sum() + found.refused.sum() != asked:
        raise ValueError(f"{asked} questions are not as many as were answered and refused")
    if (np.isfinite(found.worst) != some).any() or (np.isfinite(found.mean) != some).any():
        raise ValueError("a displacement is there without an answer, or an answer without one")
    if (found.mean[some] > found.worst[some] * (1.0 + 1e-9)).any():
        raise ValueError("a mean is above the largest")
    if found.sigma is not None and np.isfinite(found.sigma[~some]).any():
        raise ValueError("an uncertainty is there without an answer")
    if (found.worst_of_draws is None) != (found.draws == 0):
        raise ValueError(f"{found.draws} draws, expected 'worst_of_draws' where there are any, and only there")


def _columns(found: WorkspaceMap, tolerance: float | None) -> dict[str, list]:
    columns = {name: np.asarray(values).tolist() for name, values in found.table.items()}
    if tolerance is not None:
        asked = {"margin": found.margin(tolerance).tolist(), "verdict": found.verdicts(tolerance).tolist()}
        place = list(columns).index("payload")
        columns = {**dict([*columns.items()][:place]), **asked, **dict([*columns.items()][place:])}
    sizes = ("mean", "worst", *OPTIONAL, "margin")
    return columns | {name: [x if np.isfinite(x) else "" for x in columns[name]] for name in sizes if name in columns}
