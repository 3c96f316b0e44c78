"""Pictures of a board, as a folder of files or a table of corners, as a source; and the camera that took them."""

import os
import re
import tomllib
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from armflex.conventions import parse_quantity
from armflex.declaration import Declaration
from armflex.declaration import Source as Text
from armflex.errors import ArmflexError, InputError, Place, TableError, listing
from armflex.intake.sources import SourceTable
from armflex.measured.pictures import CORNER, MOST_BYTES, find_corners
from armflex.readings.board import DICTIONARY, LENGTHS, Board, read_board
from armflex.storage.read_file import read_file

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm")
STAMP = re.compile(r"(\d{4})[-_]?(\d\d)[-_]?(\d\d)[-_ T]?(\d\d)[-_h]?(\d\d)[-_m]?(\d\d)(?:[._-]?(\d{1,9}))?(?!\d)")
EPOCH = re.compile(r"(?<!\d)(1\d{9})[._]?(\d{0,9})(?!\d)")
"""Seconds since 1970 and decimals of them, with a point or without one."""


def is_pictures(path: Path) -> bool:
    """Return whether a folder holds pictures."""
    return path.is_dir() and any(file.suffix.lower() in SUFFIXES for file in path.iterdir())


def read_folder(path: Path) -> SourceTable:
    """Return the pictures of a folder in the order of the numbers in their names, and their times."""
    files = [file for file in path.iterdir() if file.suffix.lower() in SUFFIXES]
    files.sort(key=lambda file: [(part.zfill(20), part) for part in re.split(r"(\d+)", file.name)])
    stamps = [_stamp(file.stem) for file in files]
    times = [file.stat().st_mtime if None in stamps else stamp for file, stamp in zip(files, stamps, strict=True)]
    names = tuple(file.name for file in files)
    columns = (names, tuple(file.stem for file in files), np.array(times, dtype=float))
    return SourceTable(path, ("picture", "name", "time"), tuple(range(1, len(files) + 1)), columns)


def of_corners(source: SourceTable) -> SourceTable:
    """Return a table of corners as the pictures that it has any of, and any other table as it is."""
    if not set(CORNER) <= set(source.header):
        return source
    names = tuple(dict.fromkeys(map(str, source.columns[source.header.index("picture")])))
    stems = tuple(Path(name).stem for name in names)
    return SourceTable(source.path, ("picture", "name"), tuple(range(1, len(names) + 1)), (names, stems))


def board_of(text: str) -> str:
    """Return `board = { .. }` for an arm file of a board in one option: charuco,8x6,30mm,22mm or with ,4X4_50.

    Raises:
        InputError: It is none.
    """
    kind, *rest = (part.strip() for part in text.split(","))
    units = [unit for unit in LENGTHS if unit != "points"]
    if kind not in units:
        raise InputError(f"--board {text}: {kind!r} is no board (known: {listing(units)})")
    form = ",".join([kind, "COLUMNSxROWS", *LENGTHS[kind], *(["DICTIONARY"] if kind in DICTIONARY else [])])
    size = re.fullmatch(r"(\d+)x(\d+)", rest[0]) if rest else None
    count = len(LENGTHS[kind])
    if size is None or not 0 <= len(rest) - 1 - count <= (kind in DICTIONARY):
        example = ",".join([kind, "8x6", *("30mm", "22mm")[:count]])
        raise InputError(f"--board {text}: expected {form.lower()}, as in {example}")
    lengths = {key: parse_quantity(value, "length") for key, value in zip(LENGTHS[kind], rest[1:], strict=False)}
    parts = [f'kind = "{kind}"', f"columns = {size[1]}", f"rows = {size[2]}"]
    parts += [f"{key} = {value:.9g}" for key, value in lengths.items()]
    parts += [f'dictionary = "{rest[-1]}"'] if len(rest) > 1 + count else []
    return f"board = {{ {', '.join(parts)} }}"


def camera(source: SourceTable, board: str, on_arm: bool, name: str, beside: Path) -> tuple[str, list[str], list[str]]:
    """Return the [instrument.NAME] of pictures, "TIP" for the link that it is on; what was found; and what is wrong.

    The board is as `board_of` has it, and may be on the arm instead of the camera.
    """
    link = "board_link" if on_arm else "camera_link"
    lines = [f"[instrument.{name}]", 'kind = "pixels"', f'{link} = "TIP"         # the link that it is on', board]
    if not source.path.is_dir():
        corners = Path(os.path.relpath(source.path, beside)).as_posix()
        return "\n".join([*lines, f'corners = "{corners}"', *LENS]), [], []
    try:
        printed: Board = read_board(Declaration(tomllib.loads(board)["board"], ("--board",), Text(source.path, "")))
        detected = [find_corners(source.path / str(picture), printed) for picture in source.columns[0]]
    except ArmflexError as error:
        return "", [], [str(error)]
    read = [0 if corners_of is None else int(np.isfinite(corners_of[::2]).sum()) for corners_of in detected]
    seen = np.count_nonzero(read)
    usual = np.median([count for count in read if count] or [0])
    note = f"{seen} of {len(read)} pictures show the board, {usual:g} corners"
    if not seen:
        text = "no picture shows this board: are columns and rows (squares of a charuco board, else inner corners) as"
        return "", [], [f"{source.path}: {text} printed, and is the dictionary of its markers?"]
    lines += [f"image = [{', '.join(map(str, _size(source.path / str(source.columns[0][int(np.argmax(read))]))))}]"]
    return "\n".join([*lines, *LENS]), [f"{note} as a rule"], []


LENS = ("distortion_std = 0.2            # k1 k2 p1 p2 k3 are found", "sigma = 0.3                     # px")


def _size(path: Path) -> tuple[int, int]:
    """Return width and height of a picture that OpenCV reads [px]."""
    import cv2  # a wheel of 60 MB that only pictures need

    picture = cv2.imdecode(np.frombuffer(read_file(path, MOST_BYTES), np.uint8), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        raise TableError(Place(path), "is no picture that OpenCV reads")
    return picture.shape[1], picture.shape[0]


def _stamp(name: str) -> float | None:
    """Return the time that the name of a picture says [s], None where it says none."""
    if match := STAMP.search(name):
        *parts, decimals = match.groups()
        try:
            return datetime(*map(int, parts), tzinfo=UTC).timestamp() + float(f"0.{decimals or 0}")
        except ValueError:
            return None
    if match := EPOCH.search(name):
        return int(match[1]) + float(f"0.{match[2] or 0}")
    return None
