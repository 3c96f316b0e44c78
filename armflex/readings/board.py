"""A printed board: the points on it that a camera finds, by their number, as OpenCV numbers them.

Points are in the board's frame [m], z zero: x runs along a row of the print, y from one row to the next.
"""

from dataclasses import dataclass

import numpy as np

from armflex.conventions import SMALLEST_STD, Array
from armflex.declaration import Declaration

FEWEST, MOST = 4, 2000
"""Points of a board: fewer do not determine where it is, more are no board."""

LENGTHS = {
    "charuco": ("square", "marker"),
    "chessboard": ("square",),
    "apriltag": ("tag", "gap"),
    "circles": ("spacing",),
    "asymmetric_circles": ("spacing",),
    "points": (),
}
"""Kind of board -> lengths that it is declared by."""

DICTIONARY = {"charuco": "4X4_50", "apriltag": "APRILTAG_36h11"}
"""The dictionary of a kind's markers where none is declared, as OpenCV calls it without its DICT_."""


@dataclass(frozen=True, eq=False)
class Board:
    """A board as declared.

    Attributes:
        kind: A key of `LENGTHS`.
        points: (C, 3) its points [m].
        columns, rows: Of a ChArUco board its squares; of a chessboard its inner corners; of others tags or circles. 0
            of points that are given one by one.
        lengths: As `LENGTHS` names them [m].
        dictionary: Of its markers, '' of none.
    """

    kind: str
    points: Array
    columns: int = 0
    rows: int = 0
    lengths: tuple[float, ...] = ()
    dictionary: str = ""

    @property
    def alike(self) -> bool:
        """Whether the print looks the same upside down."""
        return self.kind == "circles" or (self.kind == "chessboard" and (self.columns + self.rows) % 2 == 0)


def read_board(table: Declaration) -> Board:
    """Return the board that `board = { .. }` declares.

    Raises:
        ArmFileError: A kind that is not known, or no board of it.
    """
    kind = table.choice("kind", tuple(LENGTHS))
    if kind == "points":
        points = np.array([point for point in table.ragged("points", *_shape_of(table))]).reshape(-1, 3)
        table.finish()
        return Board(kind, points)
    columns, rows = (_count(table, key) for key in ("columns", "rows"))
    lengths = tuple(table.number(key) for key in LENGTHS[kind])
    for key, length in zip(LENGTHS[kind], lengths, strict=True):
        if not SMALLEST_STD < length < 10.0:
            raise table.fail(key, f"expected a length of the print [m], got {length:g}")
    if kind == "charuco" and lengths[1] >= lengths[0]:
        raise table.fail("marker", f"is {lengths[1]:g} m: a marker lies within its square of {lengths[0]:g} m")
    dictionary = table.text("dictionary", DICTIONARY[kind]).removeprefix("DICT_") if kind in DICTIONARY else ""
    table.finish()
    pitch = lengths[0] + (lengths[1] if kind == "apriltag" else 0.0)
    across, down = (columns - 1, rows - 1) if kind == "charuco" else (columns, rows)
    i, j = (grid.ravel().astype(float) for grid in np.meshgrid(np.arange(across), np.arange(down)))
    if kind == "charuco":
        i, j = i + 1.0, j + 1.0
    if kind == "asymmetric_circles":
        i = 2.0 * i + j % 2
    places = pitch * np.column_stack([i, j, np.zeros(len(i))])
    if kind == "apriltag":  # of each tag its four corners, clockwise from the upper left
        corners = lengths[0] * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
        places = (places[:, None] + corners).reshape(-1, 3)
    if not FEWEST <= len(places) <= MOST:
        raise table.fail("columns", f"the board has {len(places)} points, expected {FEWEST} to {MOST}")
    return Board(kind, places, columns, rows, lengths, dictionary)


def _shape_of(table: Declaration) -> tuple[list[int], str]:
    """Return how many numbers each of the points has that are given one by one, and what they are."""
    points = table.raw("points")
    count = len(points) if isinstance(points, list) and FEWEST <= len(points) <= MOST else FEWEST
    return [3] * count, f"{FEWEST} points or more, [[x, y, z], ..] [m]"


def _count(table: Declaration, key: str) -> int:
    value = table.number(key)
    if value != int(value) or not 1 <= value <= MOST:
        raise table.fail(key, f"expected how many {key} the board has, got {value:g}")
    return int(value)
