"""How others call the numbers of an orientation: one table for campaigns and for the files of other programs."""

import re
from collections.abc import Iterable

MATRIX = "r11 r12 r13 r21 r22 r23 r31 r32 r33"
TURNS_BY = ("roll pitch yaw", "heading pitch roll", "a b c", "w p r", "rx ry rz", "omega phi kappa", MATRIX)
"""Angles as rolls, of a ship, of KUKA and Fanuc, as axes, of a camera; and a matrix."""

PART_OF_TURN = re.compile(r"(?P<stem>.*?)[ _.\-/]*(?P<axis>[wxyz0-4])")
BEHIND = re.compile(r"\s*[\[(].*|_(?:deg|rad|mrad)$")

TURNED = re.compile(r"(?:r|rot(?:ation)?|rvec|rotvec|euler|ori(?:ent(?:ation)?)?|rpy|theta|attitude|angle)")
"""What stands before x y z where they are an orientation."""

QUATERNIONS = {"wxyz": "wxyz", "0xyz": "wxyz", "0123": "wxyz"}
"""Ends of names, sorted, of what may be a quaternion of length 1 -> its parts in that order."""

ROUNDED = 0.02
"""Tolerance: how far the length of a quaternion is from 1 where it is written with two digits, or a mean."""


def by_stem(columns: Iterable[str]) -> dict[str, dict[str, str]]:
    """Return by stem which columns are called alike but for their end, an axis or a number, and which end each has."""
    stems: dict[str, dict[str, str]] = {}
    for column in columns:
        if match := PART_OF_TURN.fullmatch(bare(column)):
            stems.setdefault(match["stem"], {})[match["axis"]] = column
    return stems


def ends(group: Iterable[str]) -> str:
    """Return the ends of a stem in their order: `wxyz`, `0123`."""
    return "".join(sorted(group, key="w01234xyz".index))


def bare(column: str) -> str:
    """Return a column's name, small and without its unit."""
    return BEHIND.sub("", column.strip().lower())
