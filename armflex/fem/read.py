"""One reader for every kind of mesh file."""

from functools import partial
from pathlib import Path

from armflex.errors import InputError, MeshError, Place, did_you_mean, listing
from armflex.fem.bdf import read_bdf
from armflex.fem.inp import read_inp
from armflex.fem.matrices import SUFFIXES
from armflex.fem.mesh import MOST_BYTES, Mesh, with_material
from armflex.fem.msh import mesh_step, read_msh
from armflex.storage.read_file import check_file

READERS = {".inp": read_inp, **dict.fromkeys((".bdf", ".nas", ".dat"), read_bdf), ".msh": read_msh}
STEP = (".step", ".stp")


def read_mesh(
    path: Path,
    unit: str = "m",
    young: float | None = None,
    poisson: float | None = None,
    density: float | None = None,
    size: float | None = None,
    springs: bool = False,
) -> Mesh:
    """Return the mesh of an .inp, .bdf, .msh or STEP file, all of whose elements have a material.

    Args:
        path: The file.
        unit: A key of `mesh.UNITS`, of what has no unit of its own; a STEP file has.
        young, poisson, density: Material of all elements [Pa, 1, kg/m^3], where the file has none or another is meant.
        size: Of the elements that a STEP file is meshed into [m].
        springs: Whether an .inp may have what only CalculiX computes; see `Mesh.beyond`.

    Raises:
        MeshError: It is none of them, cannot be read, or elements have no material.
    """
    suffix = path.suffix.lower()
    if suffix not in (*READERS, *STEP):
        suffixes, named = (*READERS, *STEP, *SUFFIXES), suffix or "a file without a suffix"
        raise MeshError(Place(path), f"{named} is no mesh{did_you_mean(suffix, suffixes)} (known: {listing(suffixes)})")
    try:
        check_file(path, MOST_BYTES)
    except OSError as error:
        raise MeshError(Place(path), f"cannot be read: {error.strerror}") from None
    if (size is None) == (suffix in STEP):
        text = (
            "is meshed already: --size is for a STEP file" if size else "has no elements: give their size (--size 20mm)"
        )
        raise InputError(f"{path} {text}")
    if size is not None:
        mesh = mesh_step(path, size)
    else:
        read = partial(read_inp, springs=springs) if suffix == ".inp" else READERS[suffix]
        mesh = read(path, unit)
    if mesh.beyond and not young is poisson is density is None:
        raise InputError(f"{path}: CalculiX reads this model as it stands: write its material there")
    return with_material(mesh, young, poisson, density)
