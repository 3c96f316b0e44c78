"""What a mesh's file has beside solids: the harmless is left out, sets are read, all else is named by line."""

import re
import struct
from pathlib import Path

import numpy as np
import pytest

import armflex
from armflex.fem.condense import condense
from armflex.fem.mesh import Mesh
from armflex.fem.read import read_mesh

CORNERS = [
    (0, 0, 0),
    (0.1, 0, 0),
    (0.1, 0.1, 0),
    (0, 0.1, 0),
    (0, 0, 0.1),
    (0.1, 0, 0.1),
    (0.1, 0.1, 0.1),
    (0, 0.1, 0.1),
]
GRIDS = "".join(f"GRID,{n},,{x},{y},{z}\n" for n, (x, y, z) in enumerate(CORNERS, 1))
NASTRAN = f"""SOL 101
CEND
{{control}}
BEGIN BULK
{GRIDS}CHEXA,101,1,1,2,3,4,5,6
,7,8
PSOLID,1,1
MAT1,1,2.1+11,,0.3,7850.0
{{bulk}}
ENDDATA
"""
NODES = "".join(f"{n}, {x}, {y}, {z}\n" for n, (x, y, z) in enumerate(CORNERS, 1))
ABAQUS = f"""*NODE
{NODES}*ELEMENT, TYPE=C3D8, ELSET=ALL
1, 1, 2, 3, 4, 5, 6, 7, 8
*NSET, NSET=FOOT
1, 2, 3, 4
*MATERIAL, NAME=M
*ELASTIC
2.1e11, 0.3
*DENSITY
7850.
*SOLID SECTION, ELSET=ALL, MATERIAL=M
"""
BULK, KEYWORD = NASTRAN.partition("{bulk}")[0].count("\n") + 1, ABAQUS.count("\n") + 1
"""Lines of {bulk} and of what follows ABAQUS."""


def nastran(folder: Path, bulk: str = "", control: str = "") -> Mesh:
    (folder / "b.bdf").write_text(NASTRAN.format(bulk=bulk, control=control))
    return read_mesh(folder / "b.bdf")


def abaqus(folder: Path, *lines: str, text: str = ABAQUS) -> Mesh:
    (folder / "b.inp").write_text(text + "\n".join([*lines, ""]))
    return read_mesh(folder / "b.inp")


def numbers(mesh: Mesh, name: str) -> list[int]:
    return mesh.ids[mesh.nodes_of(name)].tolist()


@pytest.mark.parametrize(
    "card",
    [
        *("MPC,5,7,1,1.,8,1,-1.", "CONROD,50,7,8,1,.01", "CWELD,50,60,,PARTPAT", "CFAST,50,60", "CGAP,50,60,7,8"),
        *("CBUSH,50,60,7,8", "RBE1,50,8,123456", "RSPLINE,50,.1,5,6", "CMASS2,9,10.,8,1", "NSML1,5,PSOLID,10.,ALL"),
        *("DMIG,K2GG,0,6,1,0", "BGSET,100,1,2", "BCTABL1,0,5", "BCTABLE,1", "SESET,1,5", "MATT1,1,5", "BOLT,1"),
        *("GRDSET,,5", "GRID,9,5,0.,0.,0.", "PARAM,CK1,2.", "PARAM,UNHEARD,1", "INCLUDE 'nowhere.bdf'", "NOSUCH,1"),
        *("SPC1,1,123,1,2,3,4,5,6,7", "BEGIN SUPER=1", "PSOLID,2,1,,,,,PFLUID"),
    ],
)
def test_a_card_that_may_change_the_model_is_refused(card: str, tmp_path: Path) -> None:
    """A line of nine values too many is one that Nastran cuts off."""
    with pytest.raises(armflex.InputError, match=rf"b\.bdf:{BULK}: "):
        nastran(tmp_path, card)


@pytest.mark.parametrize(
    "command", ["MPC = 5", "K2GG = KX", "BGSET = 1", "NSM = 5", "TITLE = a,\nMPC = 5", "PARAM,CM1,2."]
)
def test_a_command_that_may_change_the_model_is_refused(command: str, tmp_path: Path) -> None:
    with pytest.raises(armflex.InputError, match=rf"b\.bdf:{3 + command.count(chr(10))}: "):
        nastran(tmp_path, control=command)


def test_what_is_harmless_in_a_deck_is_left_out(tmp_path: Path) -> None:
    control = (
        "TITLE = MPC, glued\nECHO = NONE\nDISPLACEMENT(PLOT,\nREAL) = ALL\nSPCFORCES = ALL\nPARAM,POST,-1\nSUBCASE 1\n"
    )
    control += "METHOD = 1\nLOAD = 2\nOUTPUT(PLOT)\nSET 9 = ALL\nFIND SCALE,ORIGIN 1\nPLOT SET 9"
    bulk = "PARAM,AUTOSPC,YES\nMDLPRM   HDF5    0\nGRDSET,,,,,,,456\nCORD2R,5,0,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\n"
    bulk += "SPOINT,1001\n"
    bulk += (
        "PLOTEL,960,1,5\nFORCE,2,8,,1.,1.,0.,0.\nPLOAD4,2,101,1.+6\nGRAV,3,,9.8,0.,0.,-1.\nEIGRL,1,,,10\nMAT9,5,1.\n"
    )
    bulk += "PSHELL,77,1,.1\nTEMPD,4,20.\nSUPORT,1,123\nASET1,123,1,2"
    mesh = nastran(tmp_path, bulk, control)
    assert len(mesh.points) == 8 and [len(block.ids) for block in mesh.blocks] == [1] and not mesh.flags


def test_wtmass_weighs_and_what_is_included_is_read(tmp_path: Path) -> None:
    """The case control's PARAM is the one that holds; an included file's line is named as its own."""
    materials = [
        nastran(tmp_path, bulk, control).blocks[0].material
        for bulk, control in (
            ("PARAM,WTMASS,0.5", ""),
            ("", "PARAM,WTMASS,.5"),
            ("PARAM   WTMASS  3.", "PARAM,WTMASS,0.5"),
        )
    ]
    assert [material and material.density for material in materials] == [3925.0] * 3
    (tmp_path / "more.bdf").write_text("$ joints\nSPC1,4,123,1\nMPC,5,7,1,1.,8,1,-1.\n")
    with pytest.raises(armflex.InputError, match=r"more\.bdf:3: MPC "):
        nastran(tmp_path, "INCLUDE 'more.bdf'")


@pytest.mark.parametrize(
    ("words", "nodes"),
    [
        ("5,6,7,8", [5, 6, 7, 8]),
        ("5 THRU 10", [5, 6, 7, 8]),
        ("1 THRU 8 EXCEPT 1 THRU 4", [5, 6, 7, 8]),
        ("1 THRU 4 EXCEPT 2,3,7", [1, 4, 7]),
        ("1 THRU 7 BY 3", [1, 4, 7]),
        ("5,6,\n7,8", [5, 6, 7, 8]),
        ("ALL", [1, 2, 3, 4, 5, 6, 7, 8]),
        ("ALL EXCEPT 3", [1, 2, 4, 5, 6, 7, 8]),
        ("101", "names node 101, which is not there"),
        ("1.0, 2.5", "has '1.0', expected nodes"),
        ("1,2\nSTRESS = 7", "is one of elements"),
        ("1,2\nSUBCASE 2\nSET 7 = 3,4", "stands twice, in line 3 too"),
    ],
)
def test_a_set_of_the_case_control_is_read_as_written(words: str, nodes: list[int] | str, tmp_path: Path) -> None:
    """One of elements or frequencies concerns the mesh only if it is asked for."""
    mesh = nastran(tmp_path, control=f"SET 7 = {words}")
    if isinstance(nodes, list):
        assert numbers(mesh, "7") == nodes
    else:
        with pytest.raises(armflex.InputError, match=rf"b\.bdf:\d+: set '7' {nodes}"):
            mesh.nodes_of("7")


def test_held_nodes_and_fields_are_read_in_every_form(tmp_path: Path) -> None:
    mesh = nastran(
        tmp_path, "SPC,1,1,123,0.0,2,123\nSPC,1,3,123\nSPC1,2,123456,4,THRU,6\nSPCADD,3,1,2\nSPC1,4,123,1001"
    )
    assert numbers(mesh, "SPC1") == [1, 2, 3] and numbers(mesh, "SPC3") == [1, 2, 3, 4, 5, 6]
    with pytest.raises(armflex.InputError, match="set 'SPC4' names node 1001"):
        mesh.nodes_of("SPC4")
    mesh = nastran(tmp_path, "SPC1,1,13,1,2\nSPC,1,1,2,,2,2\nSPC1,2,123,3\nSPC1,2,2,4\nSPCADD,3,1,2")
    assert numbers(mesh, "SPC1") == [1, 2]
    for name in ("SPC2", "SPC3"):  # a plane of symmetry
        with pytest.raises(armflex.InputError, match=rf"b\.bdf:{BULK + 3}: set '{name}' holds node 4 in 2 alone"):
            mesh.nodes_of(name)
    text = NASTRAN.format(bulk="SPC1\t1\t123\t1\t2\t3\t4", control="")
    text = text.replace("GRID,1,,0,0,0\n", "GRID*,1,,0.0,0.0,*\n*,0.0\n").replace(
        "GRID,2,,0.1,0,0\n", "GRID\t2\t\t0.10000000001\t0\t0\n"
    )
    (tmp_path / "b.bdf").write_text(text)
    mesh = read_mesh(tmp_path / "b.bdf")
    np.testing.assert_allclose(mesh.points, CORNERS, atol=1e-10)
    assert numbers(mesh, "SPC1") == [1, 2, 3, 4]
    (tmp_path / "b.bdf").write_text(text.replace(",5,6\n,7,8", ",5,6,+A\n+B,7,8"))
    with pytest.raises(armflex.InputError, match=r"'\+B' does not continue the line before, which goes on at '\+A'"):
        read_mesh(tmp_path / "b.bdf")


@pytest.mark.parametrize(
    "keyword",
    [
        *("*EMBEDDED ELEMENT, HOST ELSET=ALL\nALL", "*FASTENER, INTERACTION NAME=F", "*CONTACT", "*TIE, NAME=T\nA, B"),
        *(
            "*NCOPY, CHANGE NUMBER=100, OLD SET=FOOT",
            "*NGEN\n1, 2",
            "*NMAP, NSET=FOOT",
            "*ELGEN\n1, 2, 100",
            "*MPC\nBEAM, 1, 2",
        ),
        *(
            "*NONSTRUCTURAL MASS, ELSET=ALL\n40.",
            "*MASS, ELSET=ALL\n1.",
            "*PRE-TENSION SECTION, NODE=5",
            "*SUBMODEL\nFOOT",
        ),
        *(
            "*MATRIX ASSEMBLE, STIFFNESS=K",
            "*SHELL TO SOLID COUPLING",
            "*IMPERFECTION, FILE=f",
            "*RESTART, READ",
            "*NOSUCH",
        ),
        *(
            "*SYMMETRIC MODEL GENERATION",
            "*NODE, SYSTEM=C\n9, 1., 0., 0.",
            "*ELEMENT, TYPE=C3D8, OFFSET=100",
            "*PARAMETER\nE=5",
        ),
        *(
            "*SOLID SECTION, COMPOSITE, ELSET=ALL, MATERIAL=M",
            "*NSET, NSET=A, COMBINE=UNION",
            "*ELASTIC, NO TENSION\n1e9, .3",
        ),
        *("*STEP\n*STATIC\n*MODEL CHANGE, REMOVE\nALL\n*END STEP", "*SYSTEM\n0., 0., 0., 1., 0., 0."),
    ],
)
def test_a_keyword_that_may_change_the_model_is_refused(keyword: str, tmp_path: Path) -> None:
    word = next(line for line in reversed(keyword.split("\n")) if line[0] == "*" and line != "*END STEP").split(",")[0]
    line = KEYWORD + keyword.split("\n").index(next(one for one in keyword.split("\n") if one.startswith(word)))
    with pytest.raises(armflex.InputError, match=rf"b\.inp:{line}: \{word}"):
        abaqus(tmp_path, keyword)


def test_what_is_harmless_in_an_input_file_is_left_out(tmp_path: Path) -> None:
    """As preprocessors write it; a surface of a kind that is not read matters where it is asked for."""
    lines = [
        "*AMPLITUDE, NAME=A",
        "0., 0.",
        "*PHYSICAL CONSTANTS, ABSOLUTE ZERO=0",
        "*SURFACE INTERACTION, NAME=I",
        "*FRICTION",
    ]
    lines += [
        "0.2,",
        "*TRANSFORM, NSET=FOOT",
        "0., 1., 0., -1., 0., 0.",
        "*ORIENTATION, NAME=O",
        "1., 0., 0., 0., 1., 0.",
        "*SURFACE, NAME=FREE",
        "ALL,",
        "*TIME POINTS, NAME=T",
    ]
    lines += [
        "*MATERIAL, NAME=P",
        "*ELASTIC",
        "70e9, 0.33",
        "*PLASTIC",
        "2e8, 0.",
        "*CREEP, LAW=STRAIN",
        "1e-20, 4., 0.",
        "*STEP, NLGEOM=NO",
        "*STATIC",
        "*CLOAD",
        "5, 1, 1.",
        "*DSLOAD",
        "S, P, 1.",
        "*RESTART, WRITE, FREQUENCY=0",
    ]
    lines += ["*OUTPUT, FIELD", "*NODE OUTPUT", "U", "*EL FILE", "S", "*NSET, NSET=LATE", "1", "*END STEP"]
    mesh = abaqus(tmp_path, *lines)
    assert len(mesh.points) == 8 and not mesh.flags
    with pytest.raises(armflex.InputError, match=r"b\.inp:31: set 'FREE' is a \*SURFACE of 'ALL', ''"):
        mesh.nodes_of("FREE")


@pytest.mark.parametrize(
    ("held", "by_set", "problem"),
    [
        ({n: "123456" for n in (1, 2, 3, 4)}, "", ""),
        ({n: "" for n in (1, 2, 3, 4)} | {n: "456" for n in (5, 6, 7, 8)}, "123", ""),
        ({n: "123" for n in (1, 2, 3, 4, 5)}, "", ":9: node 5 is held by its own line, with 5 of the set 'PS', and"),
        ({3: "2"}, "", ":7: GRID 3 is held in 2 alone by its PS"),
        ({3: "127"}, "", ":7: GRID 3 is held in 127 alone by its PS"),
    ],
)
def test_a_node_that_its_own_line_holds_is_held(held: dict, by_set: str, problem: str, tmp_path: Path) -> None:
    """It was free, and the part softer than in the deck."""
    text = NASTRAN.format(bulk=f"SPC1,1,123,1,2,3,4\nSPC1,9,123,5,6,7,8\nGRDSET,,,,,,,{by_set}", control="")
    for node, axes in held.items():
        text = re.sub(rf"(GRID,{node},.*)", rf"\1,,{axes}", text)
    (tmp_path / "b.bdf").write_text(text)
    free = nastran(tmp_path, "SPC1,1,123,1,2,3,4\nSPC1,9,123,5,6,7,8")
    (tmp_path / "b.bdf").write_text(text)
    if problem:
        with pytest.raises(armflex.InputError, match=rf"b\.bdf{problem}"):
            condense(read_mesh(tmp_path / "b.bdf"), "SPC1", ["SPC9"])
    else:
        np.testing.assert_array_equal(
            condense(read_mesh(tmp_path / "b.bdf"), "PS", ["SPC9"]).compliance,
            condense(free, "SPC1", ["SPC9"]).compliance,
        )


@pytest.mark.parametrize(
    ("again", "problem"),
    [
        ("MAT1,1,1.0+11,,0.3,7850.0", f"{BULK}: material '1' stands twice, with young 2.1e+11 and 1e+11"),
        ("MAT1,1,2.1+11,,0.3", f"{BULK}: material '1' stands twice, with density 7850 and 0"),
        ("MAT1,2,1.0+11,,0.3\nPSOLID,1,2", f"{BULK + 1}: element 101 is in two sections, .* '1' and '2'"),
        ("PARAM,WTMASS,.5\nPARAM,WTMASS,1.", f"{BULK + 1}: PARAM WTMASS stands twice, with 0.5 and 1"),
    ],
)
def test_what_stands_twice_in_a_deck_is_the_same_or_refused(again: str, problem: str, tmp_path: Path) -> None:
    """Nastran takes identical cards and refuses others; here the later one counted."""
    assert len(nastran(tmp_path, "MAT1,1,2.1+11,,0.3,7850.0\nPSOLID,1,1").blocks) == 1
    with pytest.raises(armflex.InputError, match=rf"b\.bdf:{problem}".replace("+11", r"\+11")):
        nastran(tmp_path, again)


@pytest.mark.parametrize(
    ("again", "problem"),
    [
        ("*ELASTIC\n1e11, 0.3", f"{KEYWORD}: material 'M' stands twice, with young"),
        ("*MATERIAL, NAME=m\n*DENSITY\n1000.", f"{KEYWORD + 1}: material 'M' stands twice, with density 7850 and 1000"),
        (
            "*MATERIAL, NAME=N\n*ELASTIC\n1e11, 0.3\n*SOLID SECTION, ELSET=ALL, MATERIAL=N",
            f"{KEYWORD + 3}: element 1 is in two sections, of the materials 'M' and 'N'",
        ),
    ],
)
def test_what_stands_twice_in_an_input_file_is_the_same_or_refused(again: str, problem: str, tmp_path: Path) -> None:
    same = "*MATERIAL, NAME=M\n*ELASTIC\n2.1e11, 0.3\n*SOLID SECTION, ELSET=ALL, MATERIAL=M"
    ((block,),) = (abaqus(tmp_path, same).blocks,)
    assert block.material is not None and block.material.density == 7850.0
    with pytest.raises(armflex.InputError, match=rf"b\.inp:{problem}"):
        abaqus(tmp_path, again)


@pytest.mark.parametrize(
    ("cards", "problem"),
    [
        ("GRID*,5,,0.0,0.0,*A\nGRID*,6,,0.1,0.0,*B\n*B,0.1\n*A,0.1", ""),
        ("GRID*,5,,0.0,0.0,*A\n*A,0.1\nGRID*,6,,0.1,0.0,*A\n*A,0.1", ""),
        ("GRID*,5,,0.0,0.0,*\n*,0.1\nGRID*,6,,0.1,0.0\n*,0.1", ""),
        ("GRID*,5,,0.0,0.0,*A\nGRID*,6,,0.1,0.0,*B\n*B,0.1", ":9: goes on in a line that begins with 'A'"),
        ("GRID*,5,,0.0,0.0,*\nGRID,6,,0.1,0.0,0.1", ":10: expected what continues the line before"),
        ("GRID*,5,,0.0,0.0,*A\nGRID*,6,,0.1,0.0,*A\n*A,0.1", r":10: '\*A' is where the card of line 9 goes on, too"),
    ],
)
def test_a_card_goes_on_where_the_name_is_that_it_ends_with(cards: str, problem: str, tmp_path: Path) -> None:
    """What went on elsewhere was given to another card, and the node's third coordinate was 0."""
    text = NASTRAN.format(bulk="", control="").replace("GRID,5,,0,0,0.1\nGRID,6,,0.1,0,0.1", cards)
    (tmp_path / "b.bdf").write_text(text)
    if problem:
        with pytest.raises(armflex.InputError, match=rf"b\.bdf{problem}"):
            read_mesh(tmp_path / "b.bdf")
    else:
        np.testing.assert_allclose(read_mesh(tmp_path / "b.bdf").points, CORNERS)


def test_two_constants_of_a_material_are_enough_and_corners_have_no_gaps(tmp_path: Path) -> None:
    text = NASTRAN.format(bulk="", control="")
    for constants in ("2.1+11,,0.3", "2.1+11,8.0769230769+10,", ",8.0769230769+10,0.3"):
        (tmp_path / "b.bdf").write_text(text.replace("2.1+11,,0.3", constants))
        material = read_mesh(tmp_path / "b.bdf").blocks[0].material
        assert material is not None
        np.testing.assert_allclose([material.young, material.poisson], [2.1e11, 0.3], rtol=1e-9)
    (tmp_path / "b.bdf").write_text(text.replace(",7,8\n", ",7,,8\n"))
    with pytest.raises(armflex.InputError, match=r"b\.bdf:13: CHEXA 101 has 8 nodes and gaps between them"):
        read_mesh(tmp_path / "b.bdf")


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("*NODE", "** Units: mm, N, tonne\n*NODE", "unit"),
        ("*NODE", "** LENGTH UNIT = inch\n*NODE", "unit"),
        ("*NODE", "** UNITS (N, mm, s)\n*NODE", "unit"),
        ("0.1", "70.", "long_mesh"),
        ("2.1e11", "3.0e7", "soft_material"),
        ("*NODE", "** Units: m, N, kg\n** units in question, and units of mm/s\n*NODE", None),
        ("2.1e11, 0.3", "3.0e7, 0.48", None),
    ],
)
def test_another_unit_is_doubted(old: str, new: str, code: str | None, tmp_path: Path) -> None:
    assert [flag.code for flag in abaqus(tmp_path, text=ABAQUS.replace(old, new)).flags] == [code] * bool(code)


def test_a_system_moves_the_nodes_after_it(tmp_path: Path) -> None:
    placed = abaqus(tmp_path, text="*SYSTEM\n1., 0., 0., 1., 1., 0.\n0., 0., 0.\n" + ABAQUS).points
    x, y, z = np.array(CORNERS).T
    np.testing.assert_allclose(placed, np.column_stack([1.0 - y, x, z]), atol=1e-15)
    placed = abaqus(tmp_path, text="*SYSTEM\n1., 2., 3.\n*SYSTEM\n" + ABAQUS).points
    np.testing.assert_allclose(placed, CORNERS)


def test_data_of_other_files_are_read_and_named_as_theirs(tmp_path: Path) -> None:
    (tmp_path / "nodes.txt").write_text(NODES)
    text = ABAQUS.replace(f"*NODE\n{NODES}", "*NODE, INPUT=nodes.txt\n")
    (tmp_path / "rest.inc").write_text(text)
    assert abaqus(tmp_path, text="*INCLUDE, INPUT='rest.inc'\n").ids.tolist() == [*range(1, 9)]
    (tmp_path / "nodes.txt").write_text(NODES.replace("3, 0.1,", "3, O.1,"))
    with pytest.raises(armflex.InputError, match=r"nodes\.txt:3: expected 2 finite numbers"):
        abaqus(tmp_path, text="*INCLUDE, INPUT='rest.inc'\n")


def test_an_assembly_has_sets_and_reference_points_of_its_own(tmp_path: Path) -> None:
    """Its set is not the part's of the same name; a node that no element has is lost unless it is such a point."""
    part = ABAQUS[: ABAQUS.index("*MATERIAL")] + "*SOLID SECTION, ELSET=ALL, MATERIAL=M\n*END PART\n"
    material = ABAQUS[ABAQUS.index("*MATERIAL") : ABAQUS.index("*SOLID")]
    text = f"*PART, NAME=P\n{part}*ASSEMBLY, NAME=A\n*INSTANCE, NAME=I, PART=P\n*END INSTANCE\n*NODE\n1, .5, .5, .5\n"
    text += "*NSET, NSET=RP, INTERNAL\n1,\n*NSET, NSET=FOOT, INSTANCE=I\n5, 6\n*END ASSEMBLY\n" + material
    mesh = abaqus(tmp_path, text=text)
    assert numbers(mesh, "FOOT") == [5, 6] and numbers(mesh, "I.FOOT") == [1, 2, 3, 4] and len(mesh.points) == 8
    assert [flag.code for flag in mesh.flags] == ["left_out"]
    with pytest.raises(armflex.InputError, match=r"set 'RP' is node 1 alone, which belongs to no element"):
        mesh.nodes_of("RP")
    assert len(abaqus(tmp_path, "*NODE", "99, .5, .5, .5", "*NSET, NSET=RP", "99").points) == 8
    assert len(abaqus(tmp_path, "*NODE", "99, .5, .5, .5").points) == 9


POINTS = [(x, y, z) for z in (0, 0.1) for y in (0, 0.1) for x in (0, 0.1)]
BRICK = "1 2 4 3 5 6 8 7"
LISTED = "\n".join(f"{n} {x} {y} {z}" for n, (x, y, z) in enumerate(POINTS, 1))
TEXTS = {
    "2.2": f"""$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
2
2 1 "FOOT END"
3 2 "BODY"
$EndPhysicalNames
$Nodes
8
{LISTED}
$EndNodes
$Elements
2
1 3 2 1 1 1 2 4 3
2 5 2 2 1 {BRICK}
$EndElements
""",
    "4.1": f"""$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
2
2 1 "FOOT END"
3 2 "BODY"
$EndPhysicalNames
$Entities
0 0 1 1
1 0 0 0 1 1 1 1 1 0
1 0 0 0 1 1 1 1 2 0
$EndEntities
$Nodes
1 8 1 8
3 1 0 8
{chr(10).join(map(str, range(1, 9)))}
{chr(10).join(row.split(" ", 1)[1] for row in LISTED.split(chr(10)))}
$EndNodes
$Elements
2 2 1 2
2 1 3 1
1 1 2 4 3
3 1 5 1
2 {BRICK}
$EndElements
""",
}


def gmsh(folder: Path, text: str) -> Mesh:
    (folder / "b.msh").write_text(text)
    return read_mesh(folder / "b.msh", young=2.1e11, poisson=0.3)


@pytest.mark.parametrize("version", TEXTS)
def test_a_mesh_of_gmsh_holds_its_counts(version: str, tmp_path: Path) -> None:
    text = TEXTS[version]
    remarks = "$Comments\n$Nodes\n$EndComments\n" + text + '$NodeData\n1\n"u"\n$EndNodeData\n'
    for good in (text, text.replace("\n", "\r\n"), text.replace("\n", "\n\n"), remarks if version == "4.1" else text):
        mesh = gmsh(tmp_path, good)
        assert numbers(mesh, "foot end") == [1, 2, 3, 4] and [block.ids.tolist() for block in mesh.blocks] == [[2]]
        assert mesh.blocks[0].nodes.tolist() == [[0, 1, 3, 2, 4, 5, 7, 6]]
    lines = text.splitlines()
    brick, end, nodes = (lines.index(word) for word in (lines[-2], "$EndElements", "$EndNodes"))
    for line, spoilt in (
        (end + 1, [*lines[:end], "3" + lines[brick][1:].replace("5", "6", 1), lines[end]]),
        (brick if version == "4.1" else brick - 1, [*lines[:brick], *lines[end:]]),  # where the count stands
        (nodes + 1, [*lines[:nodes], "9 0 0 0", *lines[nodes:]]),
        (end + 1, [*lines[:end], "$EndElement"]),
        (end + 1, [*lines[:end], "$End"]),
        (nodes + 1, [*lines[:nodes], *lines[nodes + 1 :]]),
        (4, [*lines[:3], "$Nonsense", "$EndNonsense", *lines[3:]]),
        (4, [*lines[:3], "stray", *lines[3:]]),
        (brick + 1, [*lines[:brick], lines[brick] + " 3", *lines[end:]]),
        (end + 2, [*lines, "$Elements", "0", "$EndElements"]),
    ):
        with pytest.raises(armflex.InputError, match=rf"b\.msh:{line}: "):
            gmsh(tmp_path, "\n".join(spoilt) + "\n")


def test_what_gmsh_writes_by_an_option_names_it(tmp_path: Path) -> None:
    text = TEXTS["4.1"]
    for spoilt, option in (
        (text.replace("3 1 0 8", "3 1 1 8"), "SaveParametric = 0"),
        (text.replace("Entities", "PartitionedEntities"), "NbPartitions = 0"),
        (TEXTS["2.2"].replace("Nodes", "ParametricNodes"), "SaveParametric = 0"),
        (text.replace("4.1 0 8", "4 0 8"), "MshFileVersion = 4.1"),
        (text.replace("3 1 5 1", "3 1 12 1"), "SecondOrderIncomplete = 1"),
    ):
        with pytest.raises(armflex.InputError, match=rf"b\.msh(:\d+)?: .*Mesh\.{option}"):
            gmsh(tmp_path, spoilt)


def test_an_element_of_several_groups_stands_once_for_each(tmp_path: Path) -> None:
    """In version 2; two solids of one group and the same nodes are still counted twice."""
    twice = (
        TEXTS["2.2"]
        .replace("$Elements\n2\n", "$Elements\n3\n")
        .replace("$EndElements", f"3 5 2 7 1 {BRICK}\n$EndElements")
    )
    mesh = gmsh(tmp_path, twice)
    assert len(mesh.blocks[0].ids) == 1 and numbers(mesh, "group_7") == numbers(mesh, "BODY") == [*range(1, 9)]
    assert len(gmsh(tmp_path, twice.replace("3 5 2 7 1", "3 5 2 2 1")).blocks[0].ids) == 2


def binary(version: str, order: str, number: int = 1) -> bytes:
    """What `TEXTS` has, nodes counted by a `number`, as gmsh writes it with Mesh.Binary = 1."""

    def pack(form: str, *values: float) -> bytes:
        return struct.pack(order + form, *values)

    face, brick = ([number * int(n) for n in nodes.split()] for nodes in ("1 2 4 3", BRICK))
    names = TEXTS[version].partition("$EndMeshFormat\n")[2].partition("$EndPhysicalNames")[0].encode()
    head = f"$MeshFormat\n{version} 1 8\n".encode() + pack("i", 1) + b"\n$EndMeshFormat\n" + names
    head += b"$EndPhysicalNames\n"
    ids = [number * n for n in range(1, 9)]
    if version == "2.2":
        nodes = b"8\n" + b"".join(pack("i3d", n, *at) for n, at in zip(ids, POINTS, strict=True))
        elements = b"2\n" + pack("3i", 3, 1, 2) + pack("7i", 1, 1, 1, *face) + pack("3i", 5, 1, 2)
        elements += pack("11i", 2, 2, 1, *brick)
    else:
        entities = b"".join(pack("i6dQiQ", 1, *[0.0] * 3, *[1.0] * 3, 1, tag, 0) for tag in (1, 2))
        head += b"$Entities\n" + pack("4Q", 0, 0, 1, 1) + entities + b"\n$EndEntities\n"
        nodes = pack("4Q", 1, 8, 1, 8 * number) + pack("3iQ", 3, 1, 0, 8) + pack("8Q", *ids)
        nodes += pack("24d", *np.ravel(POINTS))
        elements = pack("4Q", 2, 2, 1, 2) + pack("3iQ", 2, 1, 3, 1) + pack("5Q", 1, *face)
        elements += pack("3iQ", 3, 1, 5, 1) + pack("9Q", 2, *brick)
    return head + b"$Nodes\n" + nodes + b"\n$EndNodes\n$Elements\n" + elements + b"\n$EndElements\n"


@pytest.mark.parametrize("version", TEXTS)
@pytest.mark.parametrize("order", "<>")
def test_a_binary_mesh_of_gmsh_is_judged_as_its_text(version: str, order: str, tmp_path: Path) -> None:
    def read(data: bytes) -> Mesh:
        (tmp_path / "b.msh").write_bytes(data)
        return read_mesh(tmp_path / "b.msh", young=2.1e11, poisson=0.3)

    results = b'$NodeData\n1\n"u"\n1\n0.0\n3\n0\n1\n1\n' + bytes(12) + b"\n$EndNodeData\n"
    for number, after in ((1, b""), (10, results)):
        mesh, text = read(binary(version, order, number) + after), gmsh(tmp_path, TEXTS[version])
        assert mesh.ids.tolist() == [number * n for n in text.ids] and mesh.points.tolist() == text.points.tolist()
        assert [block.nodes.tolist() for block in mesh.blocks] == [block.nodes.tolist() for block in text.blocks]
        assert mesh.sets.keys() == text.sets.keys() and numbers(mesh, "foot end") == [number * n for n in (1, 2, 3, 4)]
    good = binary(version, order)
    start, end = good.index(b"$Elements"), len(b"\n$EndElements\n")
    width = 11 * 4 if version == "2.2" else 9 * 8
    brick = good[-end - width - 12 : -end]
    for spoilt, problem in (
        (good[:-end] + brick + good[-end:], "does not end with .EndElements after what its counts state"),
        (good.replace(b"$Elements\n2\n", b"$Elements\n3\n"), "2 rows where 3 elements")
        if version == "2.2"
        else (good.replace(struct.pack(f"{order}4Q", 2, 2, 1, 2), struct.pack(f"{order}4Q", 2, 3, 1, 2)), "states 3"),
        (good[:-60], r"has fewer than the 1 rows of \d+ bytes that it states"),
        (good[: 1 - end], "does not end with .EndElements"),
        (good + good[start:], "stands twice"),
        (good.replace(b"$Nodes", b"$Nonsense"), "no section of a gmsh mesh is called .Nonsense"),
        (good.replace(b" 1 8\n", b" 1 4\n"), "numbers of 4 bytes"),
    ):
        with pytest.raises(armflex.InputError, match=rf"b\.msh: .*{problem}"):
            read(spoilt)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("$", False),
        ("SPC1,2,123,1,2", False),  # a part of what is held
        ("SPC1,2,1,1,4,5,8", True),  # a plane of symmetry
        ("SPC1,2,123,5", True),
    ],
)
def test_supports_that_are_not_held_are_said(more: str, said: bool, tmp_path: Path) -> None:
    mesh = nastran(tmp_path, f"SPC1,1,123,1,2,3,4\n{more}", "SET 7 = 5,6,7,8")
    flags = [flag.text for flag in condense(mesh, "SPC1", ["7"]).flags if flag.code == "left_out"]
    text = f"SPC2 (line {BULK + 1}) holds what 'SPC1' does not, and is left out"
    assert any(text in flag for flag in flags) is said


def test_a_boundary_in_a_step_is_said_as_one_of_the_model_is(tmp_path: Path) -> None:
    mesh = abaqus(tmp_path, "*STEP", "*STATIC", "*BOUNDARY", "FOOT, 1, 3", "*END STEP")
    assert any(f"*BOUNDARY (line {KEYWORD + 2}) is left out" in flag.text for flag in mesh.flags)
