"""Finished fits of a bootstrap in a folder, so that an interrupted one goes on from where it was."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.digest import digest
from armflex.kept import open_kept, read_piece, write_piece
from armflex.measured.measurements import Measurements
from armflex.version import __version__

Fitted = tuple[tuple[str, ...], Array]
"""Names of the parameters, and their (P,) values."""


@dataclass(frozen=True)
class KeptFits:
    """A folder of fits that belong to one bootstrap; each file is there whole or not at all."""

    folder: Path

    def has(self, number: int) -> bool:
        """Return whether a fit is there."""
        return self._path(number).exists()

    def read(self, number: int) -> Fitted:
        """Return a fit; raise `FileError` where its file is damaged."""
        return read_piece(self._path(number), lambda arrays: (tuple(arrays["names"].tolist()), arrays["values"]))

    def write(self, number: int, fit: Fitted) -> None:
        """Write a fit."""
        write_piece(self._path(number), {"names": np.array(fit[0]), "values": fit[1]})

    def _path(self, number: int) -> Path:
        return self.folder / f"fit-{number:07d}.npz"


def open_kept_fits(folder: str | Path, arm: Arm, measurements: Measurements, seed: int) -> KeptFits:
    """Return the fits kept in a folder, which is made where there is none.

    Raises:
        FileError: The folder holds those of another bootstrap, or something else, or cannot be written.
    """
    manifest = {"format": "armflex-bootstrap-1", "arm": digest(arm), "measurements": digest(measurements)}
    open_kept(Path(folder), {**manifest, "seed": seed, "armflex": __version__, "numpy": np.__version__})
    return KeptFits(Path(folder))
