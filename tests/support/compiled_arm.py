"""An arm exported as C, compiled as strictly as it is promised, and asked through ctypes."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from armflex import Arm
from armflex.export.c_code import export

COMPILER = shutil.which("gcc") or shutil.which("cc")
STRICT = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O2")
POINTER = ctypes.POINTER(ctypes.c_double)


@dataclass(frozen=True)
class CompiledArm:
    """The functions and names of an exported arm.

    Attributes:
        library: What was compiled.
        joints, payloads, covariates: Names in it.
    """

    library: ctypes.CDLL
    joints: list[str]
    payloads: list[str]
    covariates: list[str]

    def know(self, known: Mapping[str, float]) -> None:
        """Set the covariates that it asks for; what is not known is NaN."""
        values = (ctypes.c_double * len(self.covariates)).in_dll(self.library, "arm_covariates")
        values[:] = [known.get(name, np.nan) for name in self.covariates]

    def tips(self, q: np.ndarray, payload: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (N,) codes and (N, 3, 4) poses of the tip at (N, nq) positions; NaN where C wrote nothing."""
        codes, poses = self._ask(self.library.arm_tip, q, payload, 12)
        return codes, poses.reshape(-1, 3, 4)

    def followed(
        self, q: np.ndarray, payload: np.ndarray, state: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return what `tips` does, each row from where the one before it was; the first from a state, or cold."""
        size = ctypes.c_int.in_dll(self.library, "arm_nstate").value
        carried = np.zeros(max(size, 1)) if state is None else state
        at = carried.ctypes.data_as(POINTER)
        codes, poses = self._ask(lambda row, one, out: self.library.arm_follow(row, one, at, out), q, payload, 12)
        return codes, poses.reshape(-1, 3, 4)

    def compensated(self, q: np.ndarray, payload: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (N,) codes and (N, nq) joint positions."""
        return self._ask(self.library.arm_compensate, q, payload, q.shape[1])

    @staticmethod
    def _ask(function, q: np.ndarray, payload: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
        found, q = np.full((len(q), size), np.nan), np.ascontiguousarray(q, dtype=float)
        pairs = zip(q, payload.tolist(), found, strict=True)
        codes = [function(row.ctypes.data_as(POINTER), one, out.ctypes.data_as(POINTER)) for row, one, out in pairs]
        return np.array(codes), found


def compiled(arm: Arm, folder: Path) -> CompiledArm:
    """Return an arm as C of the name `arm`, compiled in a folder."""
    own = Path(tempfile.mkdtemp(dir=folder))  # a library of a path that was loaded before is not loaded again
    source, made = own / "arm.c", own / "arm.so"
    source.write_text(export(arm).text)
    command = [COMPILER, *STRICT, "-fPIC", "-shared", "-o", made, source, "-lm"]
    result = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=600)
    assert result.returncode == 0, result.stderr
    library = ctypes.CDLL(str(made))
    return CompiledArm(library, *(_names(library, kind) for kind in ("joints", "payloads", "covariate_names")))


def _names(library: ctypes.CDLL, kind: str) -> list[str]:
    pointers, names = (ctypes.c_char_p * 1000).in_dll(library, f"arm_{kind}"), []
    while pointers[len(names)] is not None:
        names.append(pointers[len(names)].decode())
    return names
