"""`armflex fem`: beams are Timoshenko's, every reader gives the same part, and broken meshes are named by line."""

import contextlib
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import io, linalg, sparse
from support.command_line import fine, run_here, strict_json
from support.meshes import bar, write_bar
from support.small_arms import ROBOTS

import armflex
from armflex.fem.bdf import read_bdf
from armflex.fem.inp import read_inp
from armflex.fem.matrices import of_mesh
from armflex.fem.part import read_part
from armflex.show.report import write_report
from armflex.show.report.checked import CheckedPath

pytest.importorskip("skfem")

YOUNG, POISSON, DENSITY = 2.1e11, 0.3, 7850.0
SHEAR = YOUNG / 2.6


def condensed(folder: Path, mesh: Path, *more: object) -> dict:
    found = run_here(
        folder, "fem", mesh, "--fixed", "root", "--loaded", "tip", "-o", "p.toml", "--json", "p.json", *more
    )
    fine(found)
    return strict_json(folder / "p.json")


def test_couplings_that_are_rounding_are_printed_as_0(tmp_path: Path) -> None:
    mesh = write_bar(tmp_path / "bar.inp", "C3D20", *bar("C3D20", (4, 2, 2), (1.0, 0.1, 0.1), 0))
    found = fine(run_here(tmp_path, "fem", mesh, "--fixed", "root", "--loaded", "tip", "-o", "p.toml"))
    row = next(line.split() for line in found.stdout.splitlines() if line.split()[:1] == ["dy"])
    assert [cell == "0" for cell in row[1:]] == [True, False, True, True, True, False]


@pytest.mark.slow
@pytest.mark.parametrize("hollow", [0, 1])
@pytest.mark.parametrize("kind", ["C3D10", "C3D20"])
def test_a_beam_is_timoshenkos(kind: str, hollow: int, tmp_path: Path) -> None:
    length, wide, high = 3.0, 0.2, 0.3
    counts = (20, 2, 3) if not hollow else (20, 6, 9)
    mesh = write_bar(tmp_path / "bar.inp", kind, *bar(kind, counts, (length, wide, high), hollow))
    part = condensed(tmp_path, mesh)
    inner = [side * (1.0 - 2.0 * hollow / count) if hollow else 0.0 for side, count in ((wide, 6), (high, 9))]
    area = wide * high - inner[0] * inner[1]
    second_y = (wide * high**3 - inner[0] * inner[1] ** 3) / 12.0
    second_z = (high * wide**3 - inner[1] * inner[0] ** 3) / 12.0
    compliance = np.array(part["compliance"])
    shears = (5 / 6, 5 / 6) if not hollow else (0.4, 0.55)  # of a solid and roughly of a box section
    for axis, second, kappa in ((1, second_z, shears[0]), (2, second_y, shears[1])):
        expected = length**3 / (3.0 * YOUNG * second) + length / (kappa * SHEAR * area)
        assert compliance[axis, axis] == pytest.approx(expected, rel=0.02)
    assert compliance[0, 0] == pytest.approx(length / (YOUNG * area), rel=0.02)
    assert compliance[4, 4] == pytest.approx(length / (YOUNG * second_y), rel=0.02)
    assert compliance[5, 5] == pytest.approx(length / (YOUNG * second_z), rel=0.02)
    assert compliance[1, 5] == pytest.approx(length**2 / (2.0 * YOUNG * second_z), rel=0.02)
    assert part["origin"] == pytest.approx([length, wide / 2, high / 2])
    assert part["mass"] == pytest.approx(DENSITY * area * length)
    first = 1.8751**2 / (2.0 * np.pi) * np.sqrt(YOUNG * second_z / (DENSITY * area * length**4))
    assert part["frequencies_hz"][0] == pytest.approx(first, rel=0.02)
    # Its own weight: 3/8 of the end load's sag, q L^4 / 8 E I.
    found = read_part(tmp_path / "p.toml")
    expected = DENSITY * area * 9.81 * length**4 / (8.0 * YOUNG * second_y)
    assert found.sag(np.array([0.0, 0.0, -9.81]))[2] == pytest.approx(-expected, rel=0.03)


def small(tmp_path: Path, **how: object) -> Path:
    return write_bar(tmp_path / "bar.inp", "C3D10", *bar("C3D10", (3, 1, 1), (0.6, 0.1, 0.2)), **how)


def nastran(mesh: Path) -> str:
    """Return a bar's .inp as Nastran's bulk data, some of it in large fields and some free."""
    found = read_inp(mesh)
    lines = [f"SET {n} = {', '.join(str(found.ids[r]) for r in rows)}" for n, rows in found.sets.items()]
    lines += ["BEGIN BULK", "MAT1,1,2.1+11,,0.3,7850.", "PSOLID,1,1"]
    for number, place in zip(found.ids, found.points, strict=True):
        x, y, z = (f"{value:16.9E}" for value in place)
        lines += [f"GRID*   {number:16d}{'':16}{x}{y}*", f"*       {z}"]
    (block,) = found.blocks
    for number, own in zip(block.ids, found.ids[block.nodes], strict=True):
        lines += [f"CTETRA,{number},1,{','.join(map(str, own[:6]))},+", f"+,{','.join(map(str, own[6:]))}"]
    return "\n".join([*lines, "ENDDATA"]) + "\n"


def test_every_reader_gives_the_same_part(tmp_path: Path) -> None:
    mesh = small(tmp_path)
    expected = condensed(tmp_path, mesh)
    compliance = np.array(expected["compliance"])
    # In mm, N and tonnes.
    in_mm = small(tmp_path, scale=1e3)
    in_mm.write_text(in_mm.read_text().replace("2.1e11", "210000.").replace("7850.", "7.85e-9"))
    np.testing.assert_allclose(
        condensed(tmp_path, in_mm, "--unit", "mm")["compliance"], compliance, rtol=1e-9, atol=1e-18
    )
    # As a part and an instance, moved and turned about z by a right angle.
    text = small(tmp_path).read_text()
    head, _, tail = text.partition("*MATERIAL")
    tail, _, section = tail.partition("*SOLID")
    text = f"*PART, NAME=P\n{head}*SOLID{section}*END PART\n*ASSEMBLY, NAME=A\n*INSTANCE, NAME=I, PART=P\n1., 2., 3.\n"
    text += f"1., 2., 3., 1., 2., 4., 90.\n*END INSTANCE\n*END ASSEMBLY\n*MATERIAL{tail}"
    (tmp_path / "parts.inp").write_text(text)
    turned = condensed(tmp_path, tmp_path / "parts.inp")
    turn = np.kron(np.eye(2), [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(turned["compliance"], turn @ compliance @ turn.T, rtol=1e-6, atol=1e-18)
    np.testing.assert_allclose(turned["origin"], [0.95, 2.6, 3.1])
    # Of two instances each has its own sets; both are a part of two pieces.
    one = "*INSTANCE, NAME=J, PART=P\n3., 2., 3.\n*END INSTANCE\n*END ASSEMBLY"
    (tmp_path / "two.inp").write_text(text.replace("*END ASSEMBLY", one))
    both = read_inp(tmp_path / "two.inp")
    assert len(both.sets["I.TIP"]) == len(both.sets["J.TIP"]) == len(both.sets["TIP"]) / 2
    assert not np.intersect1d(both.sets["I.TIP"], both.sets["J.TIP"]).size
    # Nastran.
    (tmp_path / "bar.bdf").write_text(nastran(small(tmp_path)))
    np.testing.assert_allclose(
        condensed(tmp_path, tmp_path / "bar.bdf")["compliance"], compliance, rtol=1e-6, atol=1e-18
    )
    # The faces of a surface.
    surface = small(tmp_path).read_text() + "*SURFACE, NAME=FACES\nALL, S1\nALL, S2\nALL, S3\nALL, S4\n"
    (tmp_path / "faces.inp").write_text(surface)
    found = read_inp(tmp_path / "faces.inp")
    assert set(found.sets["FACES"]) == set(range(len(found.points)))


def gmsh41(points: np.ndarray, cells: list[np.ndarray], names: list[str]) -> str:
    """Return a text of gmsh's version 4.1: two surfaces and a volume, each a physical group, numbers with gaps."""
    box = "0 0 0 1 1 1"
    lines = ["$MeshFormat", "4.1 0 8", "$EndMeshFormat", "$PhysicalNames", "3"]
    lines += [f'{2 + (n == 3)} {n} "{name}"' for n, name in enumerate(names, 1)]
    lines += ["$EndPhysicalNames", "$Entities", "0 0 2 1", *(f"{n} {box} 1 {n} 0" for n in (1, 2)), f"1 {box} 1 3 0"]
    count, total = len(points), sum(map(len, cells))
    lines += ["$EndEntities", "$Nodes", f"1 {count} 1 {count}", f"3 1 0 {count}", *(str(n + 1) for n in range(count))]
    lines += [" ".join(map(str, place)) for place in points.tolist()]
    lines += ["$EndNodes", "$Elements", f"3 {total} 1 {10 * total}"]
    number = 0
    for n, own in enumerate(cells, 1):
        lines.append(f"{2 + (n == 3)} {n % 3 + (n == 3)} {2 + 2 * (n == 3)} {len(own)}")
        for row in own + 1:
            lines.append(" ".join(map(str, [10 * (number := number + 1), *row])))
    return "\n".join([*lines, "$EndElements"]) + "\n"


def test_gmsh_meshes_are_read(tmp_path: Path) -> None:
    meshio = pytest.importorskip("meshio")
    points, nodes = bar("C3D4", (4, 2, 2), (0.6, 0.1, 0.2))
    triangles = {0.0: [], 0.6: []}
    for own in nodes:
        for face in ((0, 1, 2), (0, 1, 3), (1, 2, 3), (0, 2, 3)):
            x = points[own[list(face)], 0]
            for place, found in triangles.items():
                found += [own[list(face)]] if np.abs(x - place).max() < 1e-9 else []
    cells = [("triangle", np.array(triangles[0.0])), ("triangle", np.array(triangles[0.6])), ("tetra", nodes)]
    data = {"gmsh:physical": [np.full(len(c), n) for n, (_, c) in enumerate(cells, 1)]}
    data["gmsh:geometrical"] = data["gmsh:physical"]
    names = {"ROOT": np.array([1, 2]), "TIP": np.array([2, 2]), "BODY": np.array([3, 3])}
    meshio.write(tmp_path / "bar.msh", meshio.Mesh(points, cells, cell_data=data, field_data=names), "gmsh22")
    found = condensed(tmp_path, tmp_path / "bar.msh", "--young", YOUNG, "--poisson", POISSON, "--density", DENSITY)
    same = write_bar(tmp_path / "bar.inp", "C3D4", points, nodes)
    np.testing.assert_allclose(found["compliance"], condensed(tmp_path, same)["compliance"], rtol=1e-9, atol=1e-18)
    # In text, of either version, what is wrong is named by the file's numbers and lines.
    given = ("--fixed", "root", "--loaded", "tip", "--young", YOUNG, "--poisson", POISSON, "-o", "q.toml")
    for version in (2, 4):
        if version == 2:
            mesh = meshio.Mesh(points, cells, cell_data=data, field_data=names)
            meshio.write(tmp_path / "bar.msh", mesh, "gmsh22", binary=False)
        else:
            (tmp_path / "bar.msh").write_text(gmsh41(points, [own for _, own in cells], list(names)))
        lines = (tmp_path / "bar.msh").read_text().splitlines()
        last = lines.index("$EndElements")
        number, *others, first, second = lines[last - 1].split()
        lines[last - 1] = " ".join([number, *others, second, first])
        (tmp_path / "bar.msh").write_text("\n".join(lines) + "\n")
        found = run_here(tmp_path, "fem", "bar.msh", *given)
        assert f"bar.msh:{last}: element {number} (C3D4) has no positive volume" in fine(found, 2).stderr
        (tmp_path / "bar.msh").write_text("\n".join(lines[: last - 9]) + "\n")
        found = run_here(tmp_path, "fem", "bar.msh", *given)
        opened = lines.index("$Elements") + 1
        assert f"bar.msh:{opened}: $Elements does not end: is the file whole?" in fine(found, 2).stderr


def test_faces_that_gmsh_writes_are_sets(tmp_path: Path) -> None:
    """Its plane elements have no section; a keyword may go on after a comma; a set of elements is that of its nodes."""
    points, nodes = bar("C3D4", (4, 1, 1), (0.6, 0.1, 0.2))
    mesh = write_bar(tmp_path / "bar.inp", "C3D4", points, nodes)
    expected = condensed(tmp_path, mesh)
    at = {name: np.flatnonzero(np.abs(points[:, 0] - x) < 1e-9) + 1 for name, x in (("root", 0.0), ("tip", 0.6))}
    text = mesh.read_text().partition("*NSET")[0] + "*MATERIAL" + mesh.read_text().partition("*MATERIAL")[2]
    text = text.replace("ELSET=ALL, MATERIAL", "ELSET=ALL,\n MATERIAL")
    for number, (name, own) in enumerate(at.items(), 900):
        text += f"*ELEMENT, type=CPS4,\n ELSET={name}\n{number}, {', '.join(map(str, own))}\n"
    mesh.write_text(text)
    assert condensed(tmp_path, mesh)["compliance"] == expected["compliance"]
    mesh.write_text(text + "*SOLID SECTION, ELSET=tip, MATERIAL=STEEL\n")
    found = run_here(tmp_path, "fem", mesh, "--fixed", "root", "--loaded", "tip", "-o", "p.toml")
    assert found.returncode == 2 and "element 901 is a CPS4 with a section" in found.stderr


def test_finished_matrices_give_the_same_part(tmp_path: Path) -> None:
    """Of all nodes, in mm and tonnes too, and as another program's Craig-Bampton part of two interfaces and modes."""
    points, nodes = bar("C3D10", (4, 1, 1), (0.6, 0.1, 0.2))
    expected = condensed(tmp_path, write_bar(tmp_path / "bar.inp", "C3D10", points, nodes))
    whole = of_mesh(read_inp(tmp_path / "bar.inp"))
    names = {row: name for name in ("ROOT", "TIP") for row in whole.mesh.sets[name]}

    def write(name: str, stiffness: np.ndarray, mass: np.ndarray, rows: list[str]) -> Path:
        io.mmwrite(tmp_path / f"{name}.mtx", sparse.coo_array(stiffness), symmetry="symmetric")
        io.mmwrite(tmp_path / f"{name}.mass.mtx", sparse.coo_array(mass), symmetry="symmetric")
        (tmp_path / f"{name}.nodes.csv").write_text("\n".join(["node,x,y,z,set", *rows]) + "\n")
        return tmp_path / f"{name}.mtx"

    def same(found: dict, *keys: str) -> None:
        for key in keys:
            scale = np.abs(expected[key]).max()
            np.testing.assert_allclose(found[key], expected[key], rtol=1e-6, atol=1e-8 * scale)

    stiffness, mass = whole.stiffness.toarray(), whole.mass.toarray()
    rows = [f"{i + 1},{1e3 * x},{1e3 * y},{1e3 * z},{names.get(i, '')}" for i, (x, y, z) in enumerate(points)]
    found = condensed(tmp_path, write("all", 1e-3 * stiffness, 1e-3 * mass, rows), "--unit", "mm")
    same(found, "compliance", "mass", "com", "inertia", "mass_matrix", "weight", "frequencies_hz")
    ends = [points[whole.mesh.sets[name]].mean(axis=0) for name in ("ROOT", "TIP")]
    free = whole.at(np.array([i for i in range(len(points)) if i not in names]))
    rigid = np.zeros((len(stiffness), 12))
    for place, name in enumerate(("ROOT", "TIP")):
        own = whole.at(whole.mesh.sets[name])
        rigid[own, 6 * place : 6 * place + 6] = whole.rigid(ends[place])[own]
    inner = stiffness[np.ix_(free, free)]
    rigid[free] = -np.linalg.solve(inner, (stiffness @ rigid)[free])
    modes = np.zeros((len(stiffness), 20))
    modes[free] = linalg.eigh(inner, mass[np.ix_(free, free)], subset_by_index=[0, 19])[1]
    basis = np.hstack([rigid, modes])
    rows = [f"{i},{x},{y},{z},{name}" for i, ((x, y, z), name) in enumerate(zip(ends, ("ROOT", "TIP"), strict=True), 1)]
    found = condensed(tmp_path, write("cb", basis.T @ stiffness @ basis, basis.T @ mass @ basis, rows))
    same(found, "compliance", "mass", "com", "inertia", "mass_matrix", "weight")
    np.testing.assert_allclose(found["frequencies_hz"], expected["frequencies_hz"], rtol=5e-3)


ABAQUS = """** as *MATRIX OUTPUT, STIFFNESS, FORMAT=MATRIX INPUT writes it: a triangle, or the square
1,1, 1,1,  2.000000000000000e+06
1,2, 1,2,  1.000000000000000e+36
4,1, 1,1, -2.000000000000000e+06
1,1, 4,1, -2.000000000000000e+06
4,1, 4,1,  2.000000000000000e+06
4,2, 4,2,  2.000000000000000e+06
4,3, 4,3,  2.000000000000000e+06
2,1, 2,1,  2.000000000000000e+06
5,1, 2,1, -2.000000000000000e+06
5,1, 5,1,  2.000000000000000e+06
5,2, 5,2,  2.000000000000000e+06
5,3, 5,3,  2.000000000000000e+06
6,1, 6,1,  2.000000000000000e+06
6,2, 6,2,  2.000000000000000e+06
6,3, 6,3,  2.000000000000000e+06
"""
"""Three points, each held by 2 MN/m along x, y and z; node 3 has no stiffness, and 1 is held along y."""


@pytest.mark.parametrize("beside", ["model", "table"])
def test_matrices_that_abaqus_wrote_are_read(tmp_path: Path, beside: str) -> None:
    """By hand from the documentation of *MATRIX INPUT: node, component, node, component, value; held ones have 1e36."""
    points = {1: (0, 0, 0), 2: (0.3, 0, 0), 3: (0, 0.3, 0), 4: (0, 0, 0.5), 5: (0.3, 0, 0.5), 6: (0, 0.3, 0.5)}
    rows = [f"{n}, {x}., {y}, {z}".replace(".3.", ".3") for n, (x, y, z) in points.items()]
    if beside == "model":
        name = "job_STIF2.mtx"
        text = ["*NODE", *rows, "*ELEMENT, TYPE=C3D6, ELSET=E", "1, 1, 2, 3, 4, 5, 6", "*NSET, NSET=ROOT", "1, 2, 3"]
        (tmp_path / "job.inp").write_text("\n".join([*text, "*NSET, NSET=TIP", "4, 5, 6"]))
        (tmp_path / "job_MASS2.mtx").write_text("4,1, 4,1, 2.\n4,2, 4,2, 2.\n4,3, 4,3, 2.\n")
    else:
        name = "part.mtx"
        named = [f"{row.replace(' ', '')},{'ROOT' if n < 4 else 'TIP'}" for n, row in enumerate(rows, 1)]
        (tmp_path / "part.nodes.csv").write_text("\n".join(["node,x,y,z,set", *named]))
        (tmp_path / "part.mass.mtx").write_text("4,1, 4,1, 2.\n4,2, 4,2, 2.\n4,3, 4,3, 2.\n")
    (tmp_path / name).write_text(ABAQUS)
    found = condensed(tmp_path, tmp_path / name)
    assert found["origin"] == pytest.approx([0.1, 0.1, 0.5]) and found["mass"] == pytest.approx(2.0)
    stiffness = np.zeros((6, 6))
    for x, y in ((-0.1, -0.1), (0.2, -0.1), (-0.1, 0.2)):
        motion = np.array([[1, 0, 0, 0, 0, -y], [0, 1, 0, 0, 0, x], [0, 0, 1, y, -x, 0]])
        stiffness += 2e6 * motion.T @ motion
    np.testing.assert_allclose(found["compliance"], np.linalg.inv(stiffness), atol=1e-15)
    given = ["fem", tmp_path / name, "--fixed", "ROOT", "--loaded", "TIP", "-o", "q.toml"]
    for spoilt, problem in (
        (ABAQUS + "9,1, 9,1, 1.\n", "'9.1' is no freedom of"),
        ("1 1 2e6\n2 2 2e6\n", "(FORMAT=MATRIX INPUT)"),
        (ABAQUS + "4,1, x\n", f"{name}:17: expected rows"),
    ):
        (tmp_path / name).write_text(spoilt)
        assert problem in fine(run_here(tmp_path, *given), 2).stderr


def test_an_average_interface_is_softer_than_a_rigid_one(tmp_path: Path) -> None:
    mesh = small(tmp_path)
    rigid, average = (
        np.diag(condensed(tmp_path, mesh, "--interface", how)["compliance"]) for how in ("rigid", "average")
    )
    assert (average > rigid).all() and (average < 1.5 * rigid).all()


def test_a_part_is_a_flexure(tmp_path: Path) -> None:
    """It gives as the same compliance by numbers does at a node, and is as uncertain as one factor."""
    part = condensed(tmp_path, small(tmp_path), "--young-std", 0.1)
    told = (ROBOTS / "heavy_six" / "arm.toml").read_text().split("[flexure")[0].replace("robot.urdf", "R.urdf")
    (tmp_path / "R.urdf").write_bytes((ROBOTS / "heavy_six" / "robot.urdf").read_bytes())
    joint = armflex.load_arm(ROBOTS / "heavy_six" / "arm.toml").joint_names[1]
    named = f'[flexure.F]\njoint = "{joint}"\nnode = [0.1, 0.2, 0.3]\n'
    rows = [", ".join(str([factor * x for x in row]) for row in part["compliance"]) for factor in (1.0, 1.001, 0.999)]
    shifts = []
    for how in ('file = "p.toml"\n', *(f"compliance = [{one}]\n" for one in rows)):
        (tmp_path / "arm.toml").write_text(told + named + how)
        arm = armflex.load_arm(tmp_path / "arm.toml")
        found = arm.deflection(arm.position())
        shifts.append((found.displacement, np.zeros((6, 6)) if found.covariance is None else found.covariance))
    np.testing.assert_allclose(shifts[0][0], shifts[1][0], rtol=1e-9, atol=1e-15)
    change = (shifts[2][0] - shifts[3][0]) / 0.002
    np.testing.assert_allclose(shifts[0][1], 0.01 * np.outer(change, change), rtol=1e-4, atol=1e-18)


@pytest.mark.parametrize(("kind", "stiff"), [("C3D8", True), ("C3D20", False)])
def test_an_arm_says_that_the_elements_of_its_part_are_too_stiff(tmp_path: Path, kind: str, stiff: bool) -> None:
    """Years after the mesh was condensed, in results and on pages."""
    condensed(tmp_path, write_bar(tmp_path / "bar.inp", kind, *bar(kind, (4, 1, 1), (1.0, 0.1, 0.1))))
    (tmp_path / "R.urdf").write_bytes((ROBOTS / "heavy_six" / "robot.urdf").read_bytes())
    told = (ROBOTS / "heavy_six" / "arm.toml").read_text().split("[flexure")[0].replace("robot.urdf", "R.urdf")
    (tmp_path / "arm.toml").write_text(f'{told}[flexure.F]\njoint = "J2"\nfile = "p.toml"\n')
    arm = armflex.load_arm(tmp_path / "arm.toml")
    path = armflex.Trajectory(arm.joint_names, np.zeros(1), arm.position()[None], ("none",), ("here",))
    page = write_report(CheckedPath(arm, path, armflex.check(arm, path, 0.1), 0.1, {}, {}), tmp_path / "r.html")
    for flags in (arm.flags, arm.deflection(arm.position()).flags, armflex.check(arm, path, 0.1).flags):
        said = [flag.text for flag in flags if flag.code == "stiff_elements"]
        assert said == ["p.toml of [flexure.F]: C3D8 are too stiff in bending; C3D10 or C3D20 are not"] * stiff
    assert ("too stiff in bending" in page.read_text()) == stiff


def test_parts_are_beams_of_a_composed_joint(tmp_path: Path) -> None:
    """Two bars in a row, the second turned, on a sub-joint of a third mesh: compliances add up at the tip."""
    points, nodes = bar("C3D10", (2, 1, 1), (0.4, 0.1, 0.2))
    write_bar(tmp_path / "bar.inp", "C3D10", points - [0.0, 0.05, 0.1], nodes)
    part = condensed(tmp_path, tmp_path / "bar.inp")
    (tmp_path / "R.urdf").write_bytes((ROBOTS / "heavy_six" / "robot.urdf").read_bytes())
    told = (ROBOTS / "heavy_six" / "arm.toml").read_text().split("[flexure")[0].replace("robot.urdf", "R.urdf")
    joint = armflex.load_arm(ROBOTS / "heavy_six" / "arm.toml").joint_names[1]
    text = f'''[flexure.F]
joint = "{joint}"
model = "structural"
tip = "c"
nodes = {{ a = [0.0, 0.0, 0.0], b = [0.4, 0.0, 0.0], c = [0.4, 0.4, 0.0] }}
subjoint = [{{ at = "a", file = "p.toml" }}]
beam = [
    {{ between = ["a", "b"], file = "p.toml" }},
    {{ between = ["b", "c"], file = "p.toml", rpy = [0.0, 0.0, {np.pi / 2.0}] }},
]
'''
    (tmp_path / "arm.toml").write_text(told + text)
    constant = armflex.load_arm(tmp_path / "arm.toml").flexures[0].law.constant
    assert constant is not None
    own, turn = np.array(part["compliance"]), np.kron(np.eye(2), pin.utils.rotate("z", np.pi / 2.0))
    expected = np.zeros((6, 6))
    for place, one in (([0, 0, 0], own), ([0.4, 0, 0], own), ([0.4, 0.4, 0], turn @ own @ turn.T)):
        action = pin.SE3(np.eye(3), np.array(place, float)).action
        expected += action @ one @ action.T
    np.testing.assert_allclose(constant, expected, rtol=1e-8, atol=1e-12 * expected.max())
    (tmp_path / "arm.toml").write_text(told + text.replace(", rpy = [0.0, 0.0, 1.5707963267948966]", ""))
    with pytest.raises(armflex.InputError, match="turn it by rpy"):
        armflex.load_arm(tmp_path / "arm.toml")


def edited(change: Callable[[str], str]) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        mesh = small(folder)
        mesh.write_text(change(mesh.read_text()))
        return mesh

    return make


def two_apart(folder: Path) -> Path:
    points, nodes = bar("C3D10", (1, 1, 1), (0.2, 0.1, 0.2))
    return write_bar(
        folder / "bar.inp",
        "C3D10",
        np.vstack([points, points + np.array([0.4, 0.0, 0.0])]),
        np.vstack([nodes, nodes + len(points)]),
    )


def swapped(text: str) -> str:
    lines = text.splitlines()
    at = lines.index("*ELEMENT, TYPE=C3D10, ELSET=ALL") + 1
    cells = lines[at].split(", ")
    cells[1], cells[2] = cells[2], cells[1]
    return "\n".join([*lines[:at], ", ".join(cells), *lines[at + 1 :]]) + "\n"


def folded(folder: Path) -> Path:
    """Middles of edges stay: at its points of integration such a brick still has a positive volume."""
    points, nodes = bar("C3D20", (2, 1, 1), (0.4, 0.1, 0.2))
    nodes[0, :8] = np.roll(nodes[0, :8], 4)
    return write_bar(folder / "bar.inp", "C3D20", points, nodes)


BROKEN: dict[str, tuple[Callable[[Path], Path], tuple[object, ...], str]] = {
    "a node of no element": (
        edited(lambda t: t.replace("*NODE\n", "*NODE\n999, 1., 0., 0.\n")),
        (),
        "bar.inp:2: node 999 belongs to no element",
    ),
    "an element twice": (
        edited(
            lambda t: t + "*ELEMENT, TYPE=C3D10, ELSET=ALL\n900," + t.split("ELSET=ALL\n1,")[1].split("\n")[0] + "\n"
        ),
        (),
        "and 900 have the same nodes",
    ),
    "a set of nodes that are not there": (
        edited(lambda t: t + "*NSET, NSET=Q\n777\n"),
        ("--loaded", "q"),
        "bar.inp:111: *NSET names '777', which is not there",
    ),
    "an inverted element": (edited(swapped), (), "element 1 (C3D10) has no positive volume"),
    "a brick whose corners alone are exchanged": (folded, (), "element 1 (C3D20) has no positive volume"),
    "a part on its own": (two_apart, (), "is not connected to 'root'"),
    "a missing set": (small, ("--loaded", "tipp"), "no set of bar.inp named 'tipp', did you mean 'TIP'"),
    "a missing material": (
        edited(lambda t: t.replace("MATERIAL=STEEL", "MATERIAL=STEAL")),
        (),
        "a section of the material 'STEAL', which is not there (known: STEEL)",
    ),
    "no section": (edited(lambda t: t.split("*SOLID")[0]), (), "have no material: give --young and --poisson"),
    "millimetres": (lambda folder: small(folder, scale=1e3), (), "is another unit meant (--unit mm)?"),
    "MPa in metres": (
        edited(lambda t: t.replace("2.1e11", "210000.")),
        (),
        "is the mesh in mm, N and tonnes (--unit mm)?",
    ),
    "shared nodes": (
        edited(lambda t: t + "*NSET, NSET=OTHER\nTIP\n"),
        ("--loaded", "tip,other"),
        "interfaces 'tip' and 'other' share",
    ),
    "an interface that is held": (small, ("--loaded", "root"), "all different"),
    "a line of nodes": (
        edited(lambda t: t + "*NSET, NSET=TWO\n" + "\n".join(t.split("NSET=TIP\n")[1].split("\n")[:2]) + "\n"),
        ("--loaded", "two"),
        "nodes on one line",
    ),
    "shells": (
        edited(lambda t: t + "*ELEMENT, TYPE=S4, ELSET=X\n900, 1, 2, 3, 4\n"),
        (),
        "elements of the type S4 are not computed",
    ),
    "a tie": (edited(lambda t: t + "*TIE, NAME=T\nA, B\n"), (), "*TIE is not computed here"),
    "a number": (
        edited(lambda t: t.replace("2.1e11, 0.3", "2.1e11, O.3")),
        (),
        "expected 2 finite numbers, got '2.1e11,O.3'",
    ),
    "a decimal comma": (
        edited(lambda t: t.replace("2.1e11, 0.3", "210000000000,0, 0,3")),
        (),
        "Young's modulus, Poisson's ratio",
    ),
    "a part that does not end": (
        edited(lambda t: f"*PART, NAME=P\n{t}"),
        (),
        "bar.inp:1: *PART has no *END PART: is the file whole?",
    ),
    "a node that is not there": (
        edited(lambda t: t.replace("\n2, ", "\n1001, ", 1)),
        (),
        "element 1 names node 2, which is not there",
    ),
    "Poisson's ratio": (small, ("--poisson", 0.5), "Poisson's ratio 0.5"),
    "another suffix": (lambda folder: small(folder).rename(folder / "bar.ipn"), (), "is no mesh, did you mean '.inp'"),
    "no file": (lambda folder: folder / "none.inp", (), "cannot be read"),
}


@pytest.mark.parametrize("broken", BROKEN)
def test_a_broken_mesh_is_named(broken: str, tmp_path: Path) -> None:
    make, more, expected = BROKEN[broken]
    found = run_here(tmp_path, "fem", make(tmp_path), "--fixed", "root", "--loaded", "tip", "-o", "p.toml", *more)
    assert found.returncode == 2 and expected in found.stderr, found.stderr
    assert not (tmp_path / "p.toml").exists()


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_spoilt_meshes_are_refused_or_read(data: st.DataObject, tmp_path: Path) -> None:
    """No spoilt line ends in anything but a mesh or a typed error."""
    mesh = small(tmp_path)
    nastrans = data.draw(st.booleans())
    lines = (nastran(mesh) if nastrans else mesh.read_text()).splitlines()
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(lines) - 1))
        words = st.sampled_from(
            [*"*,0-9.", "1e999", "nan", "*NODE", "GENERATE", "ALL", "THRU", "ROOT", "", "é", "-1", "\0"]
        )
        place = data.draw(st.integers(0, len(lines[at])))
        lines[at] = lines[at][:place] + data.draw(words) + lines[at][place + data.draw(st.integers(0, 5)) :]
    path = tmp_path / ("spoilt.bdf" if nastrans else "spoilt.inp")
    path.write_text("\n".join(lines))
    with contextlib.suppress(armflex.InputError):
        (read_bdf if nastrans else read_inp)(path)


def test_a_table_of_loads_without_calculix_is_linear_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = small(tmp_path)
    monkeypatch.setattr("armflex.fem.study.PROGRAM", "no such program")
    given = ["fem", mesh, "--fixed", "root", "--loaded", "tip", "-o", "t.csv", "--table", 30, "--load", "1kN:5kN"]
    found = fine(run_here(tmp_path, *given, "--moment", "10Nm:20Nm"))
    assert "CalculiX (no such program) is not installed: the deflections are linear" in found.stderr
    rows = armflex.read_joint_data(tmp_path / "t.csv")
    compliance = np.array(condensed(tmp_path, mesh)["compliance"])
    np.testing.assert_allclose(rows.deflections, rows.loads @ compliance.T, rtol=1e-6, atol=1e-13)
    sizes = np.linalg.norm(rows.loads.reshape(-1, 2, 3), axis=2)
    assert (sizes > [999.0, 9.99]).all() and (sizes < [5001.0, 20.01]).all()
    # The paper's linear model on linear rows is structural condensation.
    fitted = armflex.train(rows, model="linear")
    np.testing.assert_allclose(fitted.trained.law.constant, compliance, rtol=1e-8, atol=1e-12 * compliance.max())
    text = mesh.read_text() + "*ELEMENT, TYPE=SPRINGA, ELSET=S\n900, 1, 2\n*SPRING, ELSET=S\n1e6\n"
    mesh.write_text(text)
    assert "is computed by CalculiX alone" in fine(run_here(tmp_path, *given), 2).stderr
    assert "--table N and --load" in fine(run_here(tmp_path, *given[:-2]), 2).stderr


@pytest.mark.slow
def test_calculix_is_given_the_material_that_was_asked_for(tmp_path: Path) -> None:
    """An .inp of gmsh's has faces without a section and no material at all; CalculiX gets neither."""
    if shutil.which("ccx") is None:
        pytest.skip("CalculiX (ccx) is not installed")
    text = (
        small(tmp_path).read_text().split("*MATERIAL")[0] + "*ELEMENT, TYPE=CPS6, ELSET=FACE\n900, 1, 2, 3, 5, 6, 7\n"
    )
    (tmp_path / "bar.inp").write_text(text)
    soft = ("--young", 7e10, "--poisson", 0.3)
    ends = ("--fixed", "ROOT", "--loaded", "TIP")
    fine(run_here(tmp_path, "fem", "bar.inp", *ends, *soft, "-o", "t.csv", "--table", 2, "--load", "10N:10N"))
    compliance = condensed(tmp_path, tmp_path / "bar.inp", *soft)["compliance"]
    rows = np.genfromtxt(tmp_path / "t.csv", delimiter=",", skip_header=1)
    expected = rows[:, :3] @ np.array(compliance)[:3, :3].T
    np.testing.assert_allclose(1e-3 * rows[:, 3:6], expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize("interface", ["rigid", "average"])
def test_a_table_of_loads_by_calculix(tmp_path: Path, interface: str) -> None:
    """Small loads give the condensation's compliance; in mm, and of a mesh that is no .inp, too."""
    if shutil.which("ccx") is None:
        pytest.skip("CalculiX (ccx) is not installed")
    mesh = small(tmp_path, scale=1e3)
    mesh.write_text(mesh.read_text().replace("2.1e11", "210000.").replace("7850.", "7.85e-9"))
    compliance = np.array(condensed(tmp_path, mesh, "--unit", "mm", "--interface", interface)["compliance"])
    (tmp_path / "bar.bdf").write_text(nastran(small(tmp_path)))
    for file, unit in ((mesh, "mm"), (tmp_path / "bar.bdf", "m")):
        if unit == "mm":
            small(tmp_path, scale=1e3)
            mesh.write_text(mesh.read_text().replace("2.1e11", "210000.").replace("7850.", "7.85e-9"))
        given = ["fem", file, "--fixed", "root", "--loaded", "tip", "-o", "t.csv", "--unit", unit, "--table", 4]
        given += ["--load", "100N:500N", "--moment", "10Nm:50Nm", "--interface", interface]
        assert "solved by CalculiX" in fine(run_here(tmp_path, *given)).stdout
        rows = np.loadtxt(tmp_path / "t.csv", delimiter=",", skiprows=1)
        expected = rows[:, :6] @ compliance.T * 1e3
        np.testing.assert_allclose(rows[:, 6:], expected, rtol=2e-3, atol=1e-3 * np.abs(expected).max())


def test_a_table_is_of_a_sound_mesh(tmp_path: Path) -> None:
    """Whoever solves it: CalculiX would only say that it failed."""
    mesh = small(tmp_path)
    mesh.write_text(mesh.read_text() + "*NSET, NSET=OTHER\nROOT, TIP\n")
    given = ("-o", "t.csv", "--table", 2, "--load", "1kN:5kN", "--fixed", "root", "--loaded")
    assert "share" in fine(run_here(tmp_path, "fem", mesh, *given, "other"), 2).stderr
    assert "all different, got root, ROOT" in fine(run_here(tmp_path, "fem", mesh, *given, "ROOT"), 2).stderr
    mesh = small(tmp_path, scale=1e3)
    found = run_here(tmp_path, "fem", mesh, *given, "tip", "--unit", "mm", "--young", 210000.0, "--density", 7.85e-9)
    said = fine(found, 2).stderr
    assert "error: --young: Young's modulus 210000 Pa, expected" in said and mesh.name not in said
    assert "--young is in Pa whatever the mesh's unit" in said
    found = run_here(tmp_path, "fem", mesh, *given, "tip", "--unit", "mm", "--poisson", 0.7)
    assert "error: --poisson: Poisson's ratio 0.7: expected" in fine(found, 2).stderr
