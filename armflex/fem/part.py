"""A condensed part: how a meshed structure gives, weighs and vibrates at its interfaces; its file, PART.toml."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from armflex.conventions import Array
from armflex.declaration import Declaration, read_toml
from armflex.errors import Flag
from armflex.fem.surface import Surface, surface_path, write_surface
from armflex.result import Result
from armflex.storage.whole_file import together, write_whole

FORMAT = "armflex-part-1"

SYMMETRIC = 1e-6
"""Relative skew of a compliance beyond which it is not one that was condensed."""

MOST = 8
"""Interfaces that carry load."""


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
        surface: What pages draw, None of several loaded interfaces and where the part was read from its file.
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
    surface: Surface | None = None

    TOLD = (
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
        found = np.linalg.inv(self.compliance / np.outer(root, root)) / np.outer(root, root)
        return 0.5 * (found + found.T)

    def sag(self, gravity: Array) -> Array:
        """Return the (6 n,) motion of the interfaces [m, rad] under the part's weight, gravity (3,) [m/s^2]."""
        return self.compliance @ self.weight @ gravity


def write_part(part: Part, path: Path) -> Path:
    """Write a PART.toml, and beside it PART.surface.safetensors for pages, whole or not at all."""

    def rows(matrix: Array) -> str:
        return "[\n" + "".join(f"    [{', '.join(f'{x:.16e}' for x in row)}],\n" for row in matrix) + "]"

    def row(values: Array) -> str:
        return f"[{', '.join(f'{x:.12g}' for x in values)}]"

    def text(value: str) -> str:
        import tomlkit

        return tomlkit.string(value).as_string()

    lines = [
        f"# Condensed from {part.mesh!r} by `armflex fem`: {part.nodes} nodes. Axes of the mesh, SI.",
        f"format = {text(FORMAT)}",
        f"mesh = {text(part.mesh)}",
        f"sha256 = {text(part.sha256)}",
        f"nodes = {part.nodes}",
        f"fixed = {text(part.fixed)}",
        f"fixed_origin = {row(part.fixed_origin)}  # m",
        f"loaded = [{', '.join(map(text, part.loaded))}]",
        f"origins = {rows(part.origins)}  # m",
        f"interface = {text(part.interface)}",
        f"young_std = {part.young_std!r}  # relative, of the whole compliance",
        f"mass = {part.mass!r}  # kg",
        f"com = {row(part.com)}  # m",
        f"inertia = {rows(part.inertia)}  # kg m^2, about the centre of mass",
        f"frequencies_hz = {row(part.frequencies_hz)}",
        "# m/N, rad/Nm and mixed",
        f"compliance = {rows(part.compliance)}",
        "# kg, kg m, kg m^2",
        f"mass_matrix = {rows(part.mass_matrix)}",
        "# load on the interfaces per m/s^2 of gravity",
        f"weight = {rows(part.weight)}",
        f"# load on the interfaces per rad/s^2 of turning about {part.loaded[0]!r}",
        f"spin = {rows(part.spin)}",
    ]
    with together():
        if part.surface is not None:
            write_surface(part.surface, surface_path(path), part.sha256)
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
    size = 6 * len(names)
    frequencies = table.raw("frequencies_hz")
    count = len(frequencies) if isinstance(frequencies, list) else 0
    found = Part(
        table.text("mesh"),
        table.text("sha256", ""),
        table.text("fixed"),
        table.numbers("fixed_origin", (3,)),
        names,
        table.numbers("origins", (len(names), 3)),
        table.choice("interface", ("rigid", "average")),
        _compliance(table, size),
        table.number("mass"),
        table.numbers("com", (3,)),
        table.numbers("inertia", (3, 3)),
        table.numbers("mass_matrix", (size, size)),
        table.numbers("weight", (size, 3)),
        table.numbers("spin", (size, 3)),
        table.numbers("frequencies_hz", (count,)) if count else np.zeros(0),
        table.std("young_std", 0.0),
        int(table.number("nodes", 0.0)),
    )
    table.finish()
    if found.mass < 0.0:
        raise table.fail("mass", f"expected 0 kg or more, got {found.mass:g}")
    return found


def _compliance(table: Declaration, size: int) -> Array:
    """Return a compliance that is symmetric and positive definite."""
    found = table.numbers("compliance", (size, size))
    diagonal = np.diag(found)
    if diagonal.min() <= 0.0:
        raise table.fail(
            "compliance", f"[{diagonal.argmin()}][{diagonal.argmin()}] is {diagonal.min():g}, expected > 0"
        )
    scaled = found / np.sqrt(np.outer(diagonal, diagonal))
    if np.abs(scaled - scaled.T).max() > SYMMETRIC or np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[0] <= 0.0:
        raise table.fail("compliance", "is not symmetric and positive definite")
    return 0.5 * (found + found.T)
