"""Finished fits of a bootstrap in a folder, so that an interrupted one goes on from where it was."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.errors import FileError, Place
from armflex.measured.measurements import Measurements
from armflex.version import __version__
from armflex.whole_file import write_whole

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
        path = self._path(number)
        try:
            with np.load(path, allow_pickle=False) as file:
                return tuple(file["names"].tolist()), file["values"]
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise FileError(Place(path), f"is damaged ({error}): delete it, and it is computed again") from None

    def write(self, number: int, fit: Fitted) -> None:
        """Write a fit."""
        file = BytesIO()
        np.savez(file, names=np.array(fit[0]), values=fit[1])
        write_whole(self._path(number), file.getvalue())

    def _path(self, number: int) -> Path:
        return self.folder / f"fit-{number:07d}.npz"


def open_kept_fits(folder: str | Path, arm: Arm, measurements: Measurements, seed: int) -> KeptFits:
    """Return the fits kept in a folder, which is made where there is none.

    Raises:
        FileError: The folder holds those of another bootstrap, or something else, or cannot be written.
    """
    from armflex.workspace.digest import digest  # which imports this package
    from armflex.workspace.store import open_store

    manifest = {"format": "armflex-bootstrap-1", "arm": digest(arm), "measurements": digest(measurements)}
    open_store(Path(folder), {**manifest, "seed": seed, "armflex": __version__, "numpy": np.__version__})
    return KeptFits(Path(folder))
