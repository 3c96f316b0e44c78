"""The surface of a condensed mesh and how its nodes move with the loaded interface: what pages draw of a part."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.fem.mesh import FACES, Mesh, corners_of
from armflex.storage.array_file import Layout, read_arrays
from armflex.storage.schema import Numbers

LAYOUT = Layout(
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


@dataclass(frozen=True, eq=False)
class Drawing:
    """Where a part's surface is, in its file and in the arm.

    Attributes:
        path: Its file.
        sha256: Of the mesh that the part was condensed from.
        origin: (3,) centroid of the loaded interface in axes of the mesh [m].
        place: Of the mesh's axes, put at that centroid, in the axes of the flexure.
    """

    path: Path
    sha256: str
    origin: Array
    place: pin.SE3

    def bent(self, twist: Array) -> tuple[Array, np.ndarray] | None:
        """Return (V, 3) nodes [m] in the axes of the flexure's outboard side, bent by its twist, and (F, 3) triangles.

        Nothing where the file is not there, or is that of another mesh.

        Raises:
            FileError: It is damaged.
        """
        if not self.path.exists():
            return None
        about, arrays, _ = read_arrays(self.path, LAYOUT)
        if about["sha256"] != self.sha256 or arrays["triangles"].max(initial=0) >= len(arrays["points"]):
            return None
        moved = arrays["points"] - self.origin + arrays["shapes"] @ self.place.actInv(pin.Motion(twist)).vector
        back = pin.exp6(pin.Motion(twist)).inverse()
        placed = moved @ self.place.rotation.T + self.place.translation
        return placed @ back.rotation.T + back.translation, arrays["triangles"]


def surface_path(part: Path) -> Path:
    """Return where the surface of a PART.toml is."""
    return part.with_suffix(".surface.safetensors")


def surface_of(mesh: Mesh, shapes: Array) -> dict[str, np.ndarray]:
    """Return the arrays of `LAYOUT` of a mesh, whose N nodes move by (3 N, 6) shapes per twist of its loaded interface.

    Triangles are rows of the points, seen from outside against the clock.
    """
    found = []
    for corners, faces in FACES.items():
        own = [b.nodes[:, face] for b in mesh.blocks if corners_of(b.kind) == corners for face in faces]
        if own:
            every = np.vstack(own)
            _, first, times = np.unique(np.sort(every, axis=1), axis=0, return_index=True, return_counts=True)
            outer = every[first[times == 1]]  # a face of two elements is inside
            found += [outer[:, [0, i, i + 1]] for i in range(1, every.shape[1] - 1)]
    kept, numbers = np.unique(np.vstack(found), return_inverse=True)
    moves = shapes.reshape(-1, 3, 6)[kept]
    return {"points": mesh.points[kept], "triangles": numbers.reshape(-1, 3).astype("i8"), "shapes": moves}
