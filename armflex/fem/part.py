"""A condensed part: how a meshed structure gives, weighs and vibrates at its interfaces; its file, PART.toml."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.declaration import read_toml
from armflex.errors import Flag
from armflex.result import Result, plain
from armflex.storage.array_file import Layout, read_arrays, write_arrays
from armflex.storage.schema import Numbers
from armflex.storage.whole_file import together, write_whole

FORMAT = "armflex-part-1"

BESIDE = ".surface.safetensors"
"""Suffix of the surface's file, beside the part's."""


MOST = 8
"""Interfaces that carry load."""

LASTING = ("stiff_elements", "soft_material", "long_mesh", "unit")
"""Codes of flags about how a part gives, which its file keeps for every arm that it is part of."""

SURFACE = Layout(
    "the surface of a part",
    "armflex-surface-1",
    {
        "points": Numbers(("nodes", 3)),
        "triangles": Numbers(("triangles", 3), "i8", least=0),
        "shapes": Numbers(("nodes", 3, 6)),
    },
    {"sha256": str},
    anew="run `armflex fem` again",
)


@dataclass(frozen=True, repr=False)
class Part(Result):
    """A structure, held at one interface, seen from n others. Axes are the mesh's.

    Attributes:
        mesh: Name of the mesh's file.
        sha256: Of that file.
        fixed: The set that is held.
        fixed_origin: (3,) its centroid [m].
        loaded: The sets that carry load.
        origins: (n, 3) their centroids [m].
        interface: "rigid": a set's nodes move as one body; "average": its motion is the mean of theirs, and a load is
            distributed over them.
        compliance: (6 n, 6 n) motion of the loaded interfaces by load [m/N, rad/Nm and mixed], at their centroids.
        mass: [kg]; 0 where no density is known.
        com: (3,) centre of mass [m].
        inertia: (3, 3) about it [kg m^2].
        mass_matrix: (6 n, 6 n) mass at the interfaces, condensed statically [kg, kg m, kg m^2].
        weight: (6 n, 3) load on the loaded interfaces, which moves them as the part's own weight does, per acceleration
            of gravity [kg, kg m].
        spin: (6 n, 3) the same load by angular acceleration about the first loaded interface's centroid [kg m, kg m^2].
        frequencies_hz: (k,) lowest natural frequencies [1/s] with the fixed set held and nothing carried; dimensionless
            modes are not kept.
        young_std: Relative standard uncertainty of the compliance, one factor of all of it; 0 where nobody says.
        nodes: Number of the mesh's nodes.
        flags: What is doubtful.
        surface: Arrays of `SURFACE`, by twist of the loaded interface, which pages draw; None of several loaded
            interfaces, and of a part that was read.
    """

    mesh: str
    sha256: str
    fixed: str
    fixed_origin: Array
    loaded: tuple[str, ...]
    origins: Array
    interface: str
    compliance: Array
    mass: float
    com: Array
    inertia: Array
    mass_matrix: Array
    weight: Array
    spin: Array
    frequencies_hz: Array
    young_std: float = 0.0
    nodes: int = 0
    flags: tuple[Flag, ...] = ()
    surface: Mapping[str, Array] | None = None

    FIELDS = (
        *("mesh", "sha256", "nodes", "fixed", "fixed_origin", "loaded", "interface", "origin", "compliance"),
        *("stiffness", "mass", "com", "inertia", "mass_matrix", "weight", "frequencies_hz", "young_std", "flags"),
    )
    ROWS = "table"

    @property
    def table(self) -> dict[str, list]:
        """Rows of the compliance, by axis."""
        axes = [f"{name}:{axis}" for name in self.loaded for axis in ("dx", "dy", "dz", "rx", "ry", "rz")]
        return {"axis": axes, "compliance": np.diag(self.compliance).tolist()}

    @property
    def origin(self) -> Array:
        """(3,) the loaded interface's centroid [m]; (n, 3) of several."""
        return self.origins[0] if len(self.loaded) == 1 else self.origins

    @property
    def stiffness(self) -> Array:
        """(6 n, 6 n) load by motion of the loaded interfaces, the fixed one held [N/m, Nm/rad and mixed]."""
        root = np.sqrt(np.diag(self.compliance))
        stiffness = np.linalg.inv(self.compliance / np.outer(root, root)) / np.outer(root, root)
        return 0.5 * (stiffness + stiffness.T)

    def seen_from(self, place: pin.SE3) -> Array:
        """Return the (6 n, 6 n) compliance in other axes and at their origin, of which `place` is the interfaces'."""
        action = np.kron(np.eye(len(self.loaded)), place.action)
        compliance = action @ self.compliance @ action.T
        return 0.5 * (compliance + compliance.T)

    def sag(self, gravity: Array) -> Array:
        """Return the (6 n,) motion of the interfaces [m, rad] under the part's weight, gravity (3,) [m/s^2]."""
        return self.compliance @ self.weight @ gravity


@dataclass(frozen=True, eq=False)
class Drawing:
    """A part as pages draw it.

    Attributes:
        path: Of its PART.toml.
        part: The part.
        place: Of the mesh's axes, put at the loaded interface, in the axes of the flexure.
    """

    path: Path
    part: Part
    place: pin.SE3

    def bent(self, twist: Array) -> tuple[Array, np.ndarray] | None:
        """Return (V, 3) nodes [m] in the axes of the flexure's outboard side, bent by its twist, and (F, 3) triangles.

        Nothing where the file of the surface is not there, or is that of another mesh.

        Raises:
            FileError: It is damaged.
        """
        if not (file := self.path.with_suffix(BESIDE)).exists():
            return None
        about, arrays, _ = read_arrays(file, SURFACE)
        if about["sha256"] != self.part.sha256 or arrays["triangles"].max(initial=0) >= len(arrays["points"]):
            return None
        moved = arrays["points"] - self.part.origin + arrays["shapes"] @ self.place.actInv(pin.Motion(twist)).vector
        placed = pin.exp6(pin.Motion(twist)).actInv(self.place)
        return moved @ placed.rotation.T + placed.translation, arrays["triangles"]


WORDS = ("mesh", "sha256", "nodes", "fixed", "loaded", "interface", "young_std", "mass", "frequencies_hz")


def _shapes(count: int) -> dict[str, tuple[int, ...]]:
    """Return the arrays of a PART.toml with so many loaded interfaces: their shapes."""
    size = 6 * count
    return {
        **{"fixed_origin": (3,), "origins": (count, 3), "com": (3,), "inertia": (3, 3)},
        **{"compliance": (size, size), "mass_matrix": (size, size), "weight": (size, 3), "spin": (size, 3)},
    }


def write_part(part: Part, path: Path) -> Path:
    """Write a PART.toml, and beside it PART.surface.safetensors for pages, whole or not at all."""
    lines = [f"# Condensed from {part.mesh!r} by `armflex fem`. Axes of the mesh, SI.", f'format = "{FORMAT}"']
    for name in (*WORDS, *_shapes(len(part.loaded))):
        value = getattr(part, name)
        if np.ndim(value) == 2:
            lines.append(f"{name} = [\n" + "".join(f"    {row},\n" for row in value.tolist()) + "]")
        else:  # as JSON, which TOML reads
            lines.append(f"{name} = {json.dumps(plain(value), ensure_ascii=False)}")
    if lasting := [str(flag) for flag in part.flags if flag.code in LASTING]:
        lines.append(f"flags = {json.dumps(lasting, ensure_ascii=False)}")
    with together():
        if part.surface is not None:
            write_arrays(path.with_suffix(BESIDE), SURFACE, part.surface, {"sha256": part.sha256})
        return write_whole(path, ("\n".join(lines) + "\n").encode())


def read_part(path: Path) -> Part:
    """Read a PART.toml.

    Raises:
        ArmFileError: It cannot be read, misses a key or has an unknown one, or no structure gives so.
    """
    table = read_toml(path)
    table.choice("format", (FORMAT,))
    names = table.texts("loaded")
    if not 1 <= len(names) <= MOST:
        raise table.fail("loaded", f"expected 1 to {MOST} names, got {len(names)}")
    arrays: dict[str, Any] = {name: table.numbers(name, shape) for name, shape in _shapes(len(names)).items()}
    compliance, frequencies = arrays["compliance"], table.raw("frequencies_hz")
    root = np.sqrt(np.diag(compliance).clip(1e-300))
    scaled = compliance / np.outer(root, root)
    # Relative skew of a compliance beyond which it is not one that was condensed
    if np.abs(scaled - scaled.T).max() > 1e-6 or np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[0] <= 0.0:
        raise table.fail("compliance", "is not symmetric and positive definite")
    arrays["compliance"] = 0.5 * (compliance + compliance.T)
    count = len(frequencies) if isinstance(frequencies, list) else 0
    written = (text.partition(": ") for text in (table.texts("flags") if table.has("flags") else ()))
    part = Part(
        mesh=table.text("mesh"),
        sha256=table.text("sha256", ""),
        nodes=int(table.number("nodes", 0.0)),
        fixed=table.text("fixed"),
        loaded=names,
        interface=table.choice("interface", ("rigid", "average")),
        young_std=table.std("young_std", 0.0),
        mass=table.number("mass"),
        frequencies_hz=table.numbers("frequencies_hz", (count,)) if count else np.zeros(0),
        flags=tuple(Flag(code, text) for code, _, text in written),
        **arrays,
    )
    table.finish()
    if part.mass < 0.0:
        raise table.fail("mass", f"expected 0 kg or more, got {part.mass:g}")
    return part
