"""Mesh files named by a URDF, opened only on request and only from beside it."""

from __future__ import annotations

from pathlib import Path

from armflex.errors import Place, UrdfError

FORMATS = {".stl": "stl", ".obj": "obj", ".dae": "dae"}
MAX_BYTES = 100_000_000


def read_mesh(urdf: Path, filename: str) -> tuple[bytes, str] | None:
    """Return a mesh's bytes and format, or None where the file is not there or of no drawable format.

    `package://NAME/rest` is looked for beside the URDF and in the folders above it that hold NAME.

    Raises:
        UrdfError: The name leads out of the folders it may be in, or the file is too large.
    """
    for root, relative in _candidates(urdf.resolve(), filename):
        path = (root / relative).resolve()
        if not path.is_relative_to(root):
            raise UrdfError(Place(urdf), f"mesh {filename!r} leads out of {root}")
        if path.is_file() and path.suffix.lower() in FORMATS:
            if path.stat().st_size > MAX_BYTES:
                raise UrdfError(Place(urdf), f"mesh {filename!r} is larger than {MAX_BYTES} bytes")
            return path.read_bytes(), FORMATS[path.suffix.lower()]
    return None


def _candidates(urdf: Path, filename: str) -> list[tuple[Path, str]]:
    scheme, separator, rest = filename.partition("://")
    if not separator:
        return [(urdf.parent, filename)]
    if scheme == "file":
        return [(urdf.parent, str(Path(rest)))]
    package = rest.partition("/")[0]
    holders = [folder for folder in urdf.parents if (folder / package).is_dir()]
    return [(holder, rest) for holder in holders[:3]]
