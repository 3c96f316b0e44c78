"""Corners of a board in pictures: found by OpenCV, or from a table that another program wrote.

A row of a campaign names its picture, or has the corners themselves. A table of corners has a line for each corner
that was found: `picture, corner, u, v`. The camera's pixel (0, 0) is the middle of the first one, as OpenCV has it.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from armflex.conventions import Array
from armflex.errors import Flag, Place, TableError, UnsupportedError, did_you_mean, listing
from armflex.measured.table import Table, read_table
from armflex.readings import Camera, Pixels, Sensor
from armflex.readings.board import Board
from armflex.storage.read_file import read_file

if TYPE_CHECKING:
    from armflex.measured.measurements import Measurements

CORNER = ("picture", "corner", "u", "v")
"""Columns of a table of corners."""

MOST_BYTES = 500_000_000
"""Of a picture."""


def read_pictures(table: Table, sensor: Sensor) -> Array:
    """Return the (N, 2 C) corners u, v [px] that a camera saw in the rows of a campaign, not a number where it did not.

    Args:
        table: The campaign: the column NAME names pictures, or NAME_u0 NAME_v0 NAME_u1 .. hold the corners.
        sensor: The camera.

    Raises:
        TableError: A picture or a corner is not there, or is none of the board's.
        UnsupportedError: There are pictures, and OpenCV is not installed.
    """
    camera, name = sensor.about, sensor.name
    assert isinstance(camera, Camera)
    empty = sensor.unread(len(table))
    if name not in table.columns:
        given = sorted({at for i, header in enumerate(empty.headers) if header in table.columns for at in (i, i ^ 1)})
        table.require(empty.headers[i] for i in given)
        values = np.full(empty.values.shape, np.nan)
        for i in given:
            there = np.array([bool(cell) for cell in table.texts(empty.headers[i])])
            values[there, i] = table.numbers_where(empty.headers[i], there)[there]
    else:
        folder = table.path.parent if isinstance(table.path, Path) else Path()
        corners = read_corners(folder / camera.corners, camera.board) if camera.corners else None
        values = np.full(empty.values.shape, np.nan)
        for row, text in enumerate(table.texts(name)):
            if not text:
                continue
            if corners is None:
                values[row] = _found(table, row, folder / text, camera.board)
            elif text in corners:  # in others no corner was found
                values[row] = corners[text]
        if corners is not None and any(table.texts(name)) and not np.isfinite(values).any():
            row, text = next((i, text) for i, text in enumerate(table.texts(name)) if text)
            where = f"{folder / camera.corners} has no corners of any picture"
            hint = did_you_mean(text, corners) or f" (it has {listing([*corners][:3])} ..)"
            raise table.fail(f"{name} is {text!r}: {where}{hint}", row)
    pairs = values.reshape(len(values), -1, 2)
    half = np.isfinite(pairs).any(axis=2) & ~np.isfinite(pairs).all(axis=2)
    if half.any():
        row, corner = (int(index) for index in np.argwhere(half)[0])
        raise table.fail(f"corner {corner} of {name} has only one of u and v", row)
    return values


def without_board(measurements: Measurements, table: Table, name: str) -> Iterator[Flag]:
    """Yield the flag about pictures in which no board was found."""
    kind = measurements.readings.of(Pixels, name)
    assert kind is not None
    unread = ~np.any(np.isfinite(kind.sigma), axis=1)
    empty = [text for text, lost in zip(table.texts(name), unread.tolist(), strict=True) if text and lost]
    if empty:
        named = listing(empty[:5]) + (f" and {len(empty) - 5} more" if len(empty) > 5 else "")
        yield Flag("picture_without_board", f"[instrument.{name}] has no corners of the board in {named}", about=name)


def read_corners(path: Path, board: Board) -> dict[str, Array]:
    """Return (2 C,) corners u, v [px] by picture, nan where none was found; raise of one that stands twice."""
    table = read_table(path, {"u": "pixel", "v": "pixel"})
    table.require(CORNER)
    pictures: dict[str, Array] = {}
    count = len(board.points)
    numbers = zip(table.numbers("corner"), table.numbers("u"), table.numbers("v"), strict=True)
    for line, picture, (corner, u, v) in zip(table.lines, table.texts("picture"), numbers, strict=True):
        if not picture:
            raise TableError(Place(path, line), "names no picture")
        if corner != int(corner) or not 0 <= corner < count:
            text = f"corner is {corner:g}; the board has corners 0 to {count - 1}"
            raise TableError(Place(path, line), text)
        pixels = pictures.setdefault(picture, np.full(2 * count, np.nan))
        if np.isfinite(pixels[2 * int(corner)]):
            raise TableError(Place(path, line), f"corner {corner:g} of picture {picture!r} stands twice")
        pixels[2 * int(corner) : 2 * int(corner) + 2] = u, v
    return pictures


def _found(table: Table, row: int, path: Path, board: Board) -> Array:
    """Return (2 C,) corners of the board in the picture of a row, not a number where they were not found [px]."""
    if not path.is_file():
        text = f"there is no picture {path}; corners from a table need `corners` in the arm file"
        raise table.fail(text, row)
    stat = path.stat()
    corners = find_corners(path, board, (stat.st_mtime_ns, stat.st_size))
    if corners is None:
        raise table.fail(f"{path} is no picture that OpenCV reads", row)
    return corners


@lru_cache(maxsize=4096)
def find_corners(path: Path, board: Board, version: object = None) -> Array | None:
    """Return (2 C,) corners of a board in a picture [px], not a number where they were not found; None of no picture.

    Args:
        path: The picture.
        board: What is looked for.
        version: Of the file: it is read once as long as that is the same.

    Raises:
        UnsupportedError: OpenCV is not installed.
    """
    try:
        import cv2  # a wheel of 60 MB that only pictures need
    except ImportError:
        text = "corners are found in pictures with OpenCV: pip install 'armflex[camera]'"
        raise UnsupportedError(f"{text}; or write them to a table, see `corners`") from None
    picture = cv2.imdecode(np.frombuffer(read_file(path, MOST_BYTES), np.uint8), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        return None
    pixels = np.full((len(board.points), 2), np.nan)
    if board.kind in ("charuco", "apriltag"):
        numbers, corners = _of_markers(cv2, picture, board)
        pixels[numbers] = corners
        return pixels.ravel()
    size = (board.columns, board.rows)
    if board.kind == "chessboard":
        there, corners = cv2.findChessboardCornersSB(picture, size, flags=cv2.CALIB_CB_ACCURACY)
    elif board.kind == "points":
        raise UnsupportedError(f"{path}: points that are declared one by one are not found in pictures: give `corners`")
    else:
        grid = cv2.CALIB_CB_SYMMETRIC_GRID if board.kind == "circles" else cv2.CALIB_CB_ASYMMETRIC_GRID
        there, corners = cv2.findCirclesGrid(picture, size, flags=grid | cv2.CALIB_CB_CLUSTERING)
        there, corners = (there, corners) if there else cv2.findCirclesGrid(picture, size, flags=grid)
    if there:
        pixels[:] = np.asarray(corners).reshape(-1, 2)
        if board.alike:  # upside down: the first point is where the picture begins
            across = pixels[-1] - pixels[0]
            pixels = pixels if across[np.abs(across).argmax()] > 0.0 else pixels[::-1]
    return pixels.ravel()


def _of_markers(cv2: Any, picture: Any, board: Board) -> tuple[np.ndarray, Array]:
    """Return the numbers and (n, 2) places [px] of corners that markers beside them name."""
    number = getattr(cv2.aruco, f"DICT_{board.dictionary}", None)
    if number is None:
        dictionaries = [name.removeprefix("DICT_") for name in dir(cv2.aruco) if name.startswith("DICT_")]
        hint = did_you_mean(board.dictionary, dictionaries)
        raise UnsupportedError(
            f"OpenCV has no dictionary of markers {board.dictionary!r}{hint} ({listing(dictionaries)})"
        )
    markers = cv2.aruco.getPredefinedDictionary(number)
    if board.kind == "charuco":
        target = cv2.aruco.CharucoBoard((board.columns, board.rows), *board.lengths, markers)
        corners, numbers, _, _ = cv2.aruco.CharucoDetector(target).detectBoard(picture)
        if numbers is None:
            return np.zeros(0, int), np.zeros((0, 2))
        return numbers.ravel(), np.asarray(corners, float).reshape(-1, 2)
    how = cv2.aruco.DetectorParameters()
    # Half the side of the window [px] in which a corner of a tag is refined.
    how.cornerRefinementMethod, how.cornerRefinementWinSize = cv2.aruco.CORNER_REFINE_SUBPIX, 5
    corners, numbers, _ = cv2.aruco.ArucoDetector(markers, how).detectMarkers(picture)
    if numbers is None:
        return np.zeros(0, int), np.zeros((0, 2))
    on_board = np.flatnonzero(numbers.ravel() < board.columns * board.rows)
    places = np.array([corners[i].reshape(4, 2) for i in on_board], float).reshape(-1, 2)
    return (4 * numbers.ravel()[on_board][:, None] + np.arange(4)).ravel(), places
