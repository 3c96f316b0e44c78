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
        UrdfError: The name leads out of the folders it may be in, or the file is too large or no text (.obj, .dae).
    """
    for root, relative in _candidates(urdf.resolve(), filename):
        path = (root / relative).resolve()
        if not path.is_relative_to(root):
            raise UrdfError(Place(urdf), f"mesh {filename!r} leads out of {root}")
        try:
            if path.is_file() and path.suffix.lower() in FORMATS:
                return _read(path), FORMATS[path.suffix.lower()]
        except (OSError, ValueError) as error:
            raise UrdfError(Place(urdf), f"mesh {filename[:200]!r} cannot be read: {error}") from None
    return None


def _read(path: Path) -> bytes:
    if path.stat().st_size > MAX_BYTES:
        raise ValueError(f"larger than {MAX_BYTES} bytes")
    data = path.read_bytes()
    if path.suffix.lower() != ".stl":
        data.decode()  # the others are text
    return data


def _candidates(urdf: Path, filename: str) -> list[tuple[Path, str]]:
    scheme, separator, rest = filename.partition("://")
    if not separator:
        return [(urdf.parent, filename)]
    if scheme == "file":
        return [(urdf.parent, str(Path(rest)))]
    package = rest.partition("/")[0]
    holders = [folder for folder in urdf.parents if (folder / package).is_dir()]
    return [(holder, rest) for holder in holders[:3]]
