"""A file, or a part of a recording, of which every column is understood: what it has of each row, in SI."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import Rotation

from armflex.conventions import Array
from armflex.errors import Place, TableError
from armflex.intake.meanings import ANGLE_UNITS, ANGLES, VECTOR, Meaning, changed
from armflex.intake.sources import Cells, SourceTable, numbers
from armflex.measured.orientation_names import ROUNDED
from armflex.measured.points import LENGTHS

DIGITS = 12
"""Decimals of a metre or a radian: further ones are of a conversion."""


@dataclass(frozen=True, eq=False)
class Record(SourceTable):
    """A source and what it is in a join.

    Attributes:
        meant: What each column is.
        role: "log" where it has the joints, "export" where it has places of a target; '' of others.
        rank: Place among exports.
    """

    meant: tuple[Meaning, ...] = ()
    role: str = ""
    rank: int = 0

    def of(self, *kinds: str) -> Iterator[tuple[Meaning, Cells]]:
        """Yield what columns of these kinds are, and their cells."""
        return (pair for pair in zip(self.meant, self.columns, strict=True) if pair[0].kind in kinds)

    def has(self, kind: str) -> bool:
        """Return whether a column is of a kind."""
        return any(meaning.kind == kind for meaning in self.meant)

    def cells(self, kind: str) -> Cells | None:
        """Return the first column of a kind, not that of a day; None where there is none."""
        return next((cells for meaning, cells in self.of(kind) if meaning.name != "date"), None)

    def where(self, which: Callable[[Meaning], bool], **changes: Any) -> Self:
        """Return it with other meanings of the columns that `which` chooses."""
        return replace(self, meant=tuple(changed(self.meant, which, **changes)))

    def si(self, kind: str) -> dict[str, Array]:
        """Return (N,) numbers of joints or coordinates in SI, by name; nan where a cell is empty."""
        factors = LENGTHS | ANGLE_UNITS
        sizes = {meaning.name: (numbers(cells), factors[meaning.unit or ""]) for meaning, cells in self.of(kind)}
        return {
            name: values if factor == 1.0 else np.round(values * factor, DIGITS)
            for name, (values, factor) in sizes.items()
        }

    @property
    def places(self) -> Array:
        """(N, 3) places [m], nan where none was read."""
        coordinates = self.si("coordinate")
        return np.column_stack([coordinates[axis] for axis in "xyz"])

    @property
    def moved(self) -> tuple[Array, str]:
        """(N, d) joint positions [rad] of a log, else (N, d) coordinates [m], and that unit."""
        kind, unit = ("joint", "rad") if self.has("joint") else ("coordinate", "m")
        return np.column_stack([*self.si(kind).values()]), unit

    def turned(self) -> Array | None:
        """Return (N, 4) quaternions x y z w of a target, nan where none was read; None where it has none.

        Raises:
            TableError: A quaternion is not of length 1.
        """
        parts = {one.name: numbers(cells) * ANGLE_UNITS.get(one.unit or "", 1.0) for one, cells in self.of("turn")}
        if parts.keys() >= {"qw", "qx", "qy", "qz"}:
            four = np.column_stack([parts[f"q{axis}"] for axis in "xyzw"])
            size = np.sqrt((four**2).sum(axis=1))
            four[size < 0.1] = np.nan  # noughts where nothing was set
            for i in np.flatnonzero(np.abs(size - 1.0) > ROUNDED)[:1]:
                if np.isfinite(four[i]).all():
                    place = Place(self.path, self.lines[i])
                    raise TableError(place, f"its quaternion is {size[i]:.4g} long, expected 1")
            return np.asarray(four / size[:, None], dtype=float)
        names = next((names for names in (VECTOR, ANGLES) if parts.keys() >= set(names)), None)
        if names is None:
            return None
        three = np.column_stack([parts[name] for name in names])
        read, four = np.isfinite(three).all(axis=1), np.full((len(three), 4), np.nan)
        if read.any():
            turn = Rotation.from_rotvec(three[read]) if names == VECTOR else Rotation.from_euler("xyz", three[read])
            four[read] = turn.as_quat()
        return four

    def on_one_side(self) -> Self:
        """Return it with its orientation as quaternions on one side, so that means of them exist."""
        four = self.turned()
        if four is None or not (read := np.isfinite(four).all(axis=1)).any():
            return self
        apart = (four[read][1:] * four[read][:-1]).sum(axis=1) < 0.0
        four[read] *= np.cumprod(np.concatenate([[1.0], np.where(apart, -1.0, 1.0)]))[:, None]
        kept = [i for i, meaning in enumerate(self.meant) if meaning.kind != "turn"]
        names = ("qx", "qy", "qz", "qw")
        return replace(
            self,
            header=(*(self.header[i] for i in kept), *names),
            columns=(*(self.columns[i] for i in kept), *four.T),
            meant=(
                *(self.meant[i] for i in kept),
                *(Meaning(name, "turn", name, "", "its orientation") for name in names),
            ),
        )


def ranked(records: Iterable[Record]) -> list[Record]:
    """Return the log and the exports in their order."""
    return sorted((record for record in records if record.role), key=lambda record: (record.role != "log", record.rank))
