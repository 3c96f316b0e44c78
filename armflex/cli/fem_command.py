"""armflex fem: a mesh into a part that an arm can name, or into a table of loads and deflections."""

from pathlib import Path

import click
import numpy as np

from armflex.cli import options
from armflex.cli.terminal import doing, number, print_table, say
from armflex.conventions import TWIST_NAMES, WRENCH_NAMES, parse_quantity
from armflex.errors import InputError, listing
from armflex.fem.condense import condense
from armflex.fem.matrices import SUFFIXES, read_matrices
from armflex.fem.mesh import UNITS
from armflex.fem.part import Part, write_part
from armflex.fem.read import read_mesh
from armflex.fem.study import random_loads, study
from armflex.measured.table import write_table
from armflex.storage.whole_file import together

SOLVERS = {"calculix": "CalculiX, with large displacements", "linear": "a linear condensation"}
"""Solver of a table -> how people read it."""


@click.command(cls=options.Command)
@click.argument("mesh_path", metavar="MESH", type=options.InputPath)
@click.option("--fixed", required=True, metavar="SET", help="The set of nodes, or surface, that is held.")
@click.option("--loaded", required=True, metavar="SET[,SET]", help="The sets that carry load; each is an interface.")
@click.option("--unit", type=options.Choice(tuple(UNITS)), default="m", show_default=True,
              help="Of the mesh; mm: mm, N, t, MPa.")  # fmt: skip
@click.option("--young", type=float, help="Young's modulus of all elements [Pa].")
@click.option("--poisson", type=float, help="Poisson's ratio of all elements.")
@click.option("--density", type=float, help="Density of all elements [kg/m^3].")
@click.option("--young-std", type=click.FloatRange(0.0, 1.0), default=0.0, help="Relative std of Young's modulus.")
@click.option("--size", type=options.Quantity("length"), metavar="20mm", help="Edge of the elements of a STEP file.")
@click.option("--interface", type=options.Choice(("rigid", "average")), default="rigid", show_default=True,
              help="A loaded set moves as one body, or its motion is the mean of its nodes' and its load "
                   "distributed.")  # fmt: skip
@click.option("--table", type=click.IntRange(1, 100_000), metavar="N", help="Write a table of N random loads instead.")
@click.option("--load", metavar="1kN:5kN", help="With --table: least and largest force, of any direction.")
@click.option("--moment", metavar="1kNm:5kNm", help="With --table: least and largest moment; without it there is none.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="With --table: of the loads.")
@click.option("-o", "--output", required=True, type=options.OutputPath(), help="Part (.toml) or table (.csv) to write.")
def command(
    mesh_path: Path,
    fixed: str,
    loaded: str,
    unit: str,
    young_std: float,
    interface: str,
    table: int | None,
    load: str | None,
    moment: str | None,
    seed: int,
    output: Path,
    **solid: float | None,
) -> None:
    """Condense a mesh to stiffness, mass and weight where it joins its neighbours.

    MESH is an Abaqus or CalculiX .inp, a Nastran .bdf, a gmsh .msh, a STEP file, which gmsh meshes, or finished
    matrices (.sti, .mtx). With --table it writes deflections under random loads, for `train`; where CalculiX (ccx) is
    installed, with large displacements.
    """
    ending = ".csv" if table else ".toml"
    if output.suffix != ending:
        raise InputError(f"{output}: a {'table' if table else 'part'} is a {ending} file; name it so")
    if bool(table) != bool(load) or (moment and not table):
        raise InputError("--table N and --load 1kN:5kN belong together, and --moment with both")
    names = tuple(name.strip() for name in loaded.split(",") if name.strip())
    if table and len(names) != 1:
        raise InputError(f"a table is of one loaded set, got {listing(names)}")
    doing(f"reading {mesh_path.name}")

    def tick(what: str, done: int, total: int | None) -> None:
        doing(what + (f", {done} of {total}" if total else ""))

    if mesh_path.suffix.lower() in SUFFIXES:
        if table or any(value is not None for value in solid.values()):
            raise InputError(f"{mesh_path} has finished matrices: neither material, --size nor --table is for them")
        mesh = read_matrices(mesh_path, unit)
    else:
        mesh = read_mesh(mesh_path, unit, **solid, springs=bool(table))
        if table:
            loads = random_loads(table, _bounds(load, "force"), _bounds(moment, "moment"), seed)
            sweep = study(mesh, fixed.strip(), names[0], loads, unit, interface, tick)
            with together():
                write_table(output, sweep.columns)
                said = {"solver": sweep.solver, "rows": table, "seed": seed, "loads": loads, "twists": sweep.twists}
                options.conclude(lambda: said, sweep.flags)
            say(f"{table} loads, solved by {SOLVERS[sweep.solver]}. Written to {output}, for armflex train {output}.")
            return
    part = condense(mesh, fixed.strip(), names, interface, young_std, tick)
    with together():
        write_part(part, output)
        options.conclude(lambda: {**part.to_dict(), "flags": []}, part.flags)
    print_part(part)
    say(f'Written to {output}. In an arm.toml: file = "{output.name}" in a [flexure.NAME] or a [link.NAME].')


def _bounds(text: str | None, kind: str) -> tuple[float, float]:
    """Return the two quantities of a text such as 1kN:5kN, of none zeros."""
    if text is None:
        return 0.0, 0.0
    low, colon, high = text.partition(":")
    least, most = (parse_quantity(bound, kind) if colon else -1.0 for bound in (low, high))
    if not 0.0 <= least <= most or most == 0.0:
        raise InputError(f"{text!r}: expected the least and the largest {kind}, such as 1kN:5kN, not both 0")
    return least, most


def print_part(part: Part) -> None:
    """Print how a part gives, weighs and vibrates."""
    for place, name in enumerate(part.loaded):
        block = part.compliance[6 * place : 6 * place + 6, 6 * place : 6 * place + 6]
        scale = np.sqrt(np.abs(np.outer(np.diag(block), np.diag(block))))
        # A coupling that is smaller, as a part of the compliances that it couples, is of the solution's rounding
        block = np.where(np.abs(block) > 1e-10 * scale, block, 0.0)
        print_table(
            f"Compliance at {name!r}, {part.fixed!r} held (m/N, rad/Nm and mixed)",
            ["", *(f"per {axis}" for axis in WRENCH_NAMES)],
            [[axis, *(f"{x:.4g}" for x in row)] for axis, row in zip(TWIST_NAMES, block, strict=True)],
        )
    if part.mass:
        said = ", ".join(number(x, 4) for x in part.frequencies_hz)
        say(f"{part.nodes} nodes, {number(part.mass, 5)} kg. Natural frequencies, {part.fixed!r} held: {said} Hz.")
