"""What each column of a file is: a joint, a coordinate, a name, a time, or something else that is kept."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from armflex.conventions import NUMBER, UNITS
from armflex.intake.sources import Source
from armflex.measured.points import LENGTHS

TURN = 2.2 * np.pi
"""Tolerance: position [rad] of a joint beyond which it is none: controllers count one turn either way at most."""

UR = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")

JOINTS: tuple[tuple[str, str], ...] = (
    (r"q_(?P<name>\w+)", "rad"),
    (r"(?:actual|target)_q_(?P<ur>[0-5])", "rad"),
    (r"\$?axis_act(?:_meas)?[._ ]?(?P<name>[ae][1-6])", "deg"),
    (r"(?:/?joint_states?[./])?position[._\[](?P<name>\w+?)\]?", "rad"),
    (r"(?P<name>(?:j|a|axis|joint|achse|gelenk)[ _.]?[1-9])(?:[ _.](?:act|actual|pos|ist))?", ""),
)
"""Patterns of a joint's column, and the unit that their controller writes; '' where people write either."""

NAMES = r"(?:point ?name|point|name|punkt(?:name)?|pose|pt|id|target ?name|feature)"
TIMES = r"(?:time(?: ?stamp)?|zeit(?:stempel)?|uhrzeit|date(?: ?time)?|datum)"
COORDINATE = r"(?:(?:pos(?:ition)?|actual|meas(?:ured)?|ist)[ _.])?(?P<axis>[xyz])(?:[ _.](?:act\w*|meas\w*|ist))?"
KEPT = ("payload", "session")
BRACKETS = re.compile(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]\s*")


@dataclass(frozen=True)
class Meaning:
    """What one column is.

    Attributes:
        column: Its name in the file.
        kind: "joint", "coordinate", "name", "time", "kept", "covariate" or "unused".
        name: Of the joint or the axis, or the column of a campaign.
        unit: As in a header's suffix; '' for texts, None where it is open.
        why: Where that is known from.
    """

    column: str
    kind: str
    name: str
    unit: str | None
    why: str


def meanings(source: Source, taken: Mapping[str, str]) -> tuple[Meaning, ...]:
    """Return what every column of a file is.

    Args:
        source: The file.
        taken: What the caller says columns are, by their name: `q_J1_deg`, `x_mm`, `pose`, `time`.
    """
    comment = next(filter(None, (_unit_of_comment(one) for one in source.comments)), None)
    found = []
    for header, cells in zip(source.header, source.columns, strict=True):
        own = taken.get(header)
        found.append(_meaning(own or header, header, cells, comment, own is not None))
    axes = {one.name for one in found if one.kind == "coordinate"}
    if axes != {"x", "y", "z"}:  # an X of something else
        found = [Meaning(one.column, "covariate", one.column, "", "a number") if one.kind == "coordinate" else one
                 for one in found]  # fmt: skip
    # One joint beyond a turn shows the unit of all.
    sizes = [
        np.abs([float(cell) for cell in cells if NUMBER.fullmatch(cell)] or [0.0]).max()
        for one, cells in zip(found, source.columns, strict=True)
        if one.kind == "joint" and one.unit is None
    ]
    if sizes and max(sizes) > TURN:
        why = f"a value of {max(sizes):.4g} is no angle in rad"
        found = [
            Meaning(one.column, one.kind, one.name, "deg", why) if one.kind == "joint" and one.unit is None else one
            for one in found
        ]
    return tuple(found)


def _meaning(text: str, header: str, cells: tuple[str, ...], comment: str | None, asked: bool) -> Meaning:
    text, unit = text.strip(), None
    if match := BRACKETS.fullmatch(text):
        text, unit = match[1], match[2].lower().replace("°", "deg")
    elif "_" in text and text.rpartition("_")[2].lower() in {*LENGTHS, *UNITS["angle"]}:
        base, _, last = text.rpartition("_")
        text, unit = (base, last.lower()) if len(base) > 0 else (text, None)
    word, why = text.strip().lower(), "as asked" if asked else "its name"
    in_header = "as asked" if asked else "its header"
    for pattern, usual in JOINTS:
        if match := re.fullmatch(pattern, word):
            parts = match.groupdict()
            name = f"{UR[int(parts['ur'])]}_joint" if parts.get("ur") else text[match.start("name") : match.end("name")]
            if unit in {"degree", "degrees", "grad"}:
                unit = "deg"
            known = unit if unit in UNITS["angle"] else usual or None
            reason = in_header if unit in UNITS["angle"] else "as this controller writes it" if usual else why
            return Meaning(header, "joint", name.replace(" ", "_").replace(".", "_"), known, reason)
    if match := re.fullmatch(COORDINATE, word):
        known = unit if unit in LENGTHS else comment
        return Meaning(header, "coordinate", match["axis"], known, in_header if unit in LENGTHS else "a comment")
    if re.fullmatch(NAMES, word):
        return Meaning(header, "name", "pose", "", why)
    if re.fullmatch(TIMES, word):
        return Meaning(header, "time", "time", "", why)
    if word in KEPT:
        return Meaning(header, "kept", word, "", why)
    return Meaning(header, "covariate", re.sub(r"\W+", "_", header).strip("_") or "column", "", "nothing else")


def _unit_of_comment(text: str) -> str | None:
    """Return the length unit that a comment states: 'Units: Millimeters'."""
    match = re.search(r"(?:units?|einheit(?:en)?|length)\b[^:=]*[:=]\s*([^\W\d_]+)", text, re.IGNORECASE)
    return match[1].lower() if match and match[1].lower() in LENGTHS else None
