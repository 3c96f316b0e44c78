"""CalculiX 2.20's stiffness and mass matrices of small curved meshes, as it stored them, against ours."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("skfem")

from armflex.errors import MeshError
from armflex.fem.assembly import assembled
from armflex.fem.condense import condense
from armflex.fem.matrices import read_matrices
from armflex.fem.read import read_mesh

STORED = Path(__file__).parent / "calculix"
KINDS = ("c3d4", "c3d8", "c3d10", "c3d20")


def difference(kind: str, folder: Path, found: dict[str, np.ndarray]) -> list[float]:
    mesh = read_mesh(folder / f"{kind}.inp")
    stiffness, mass = (matrix.toarray() for matrix in assembled(mesh))
    row = {number: place for place, number in enumerate(mesh.ids)}
    places = np.array([3 * row[node] + axis - 1 for node, axis in found[f"{kind}_dof"]])
    upper = np.triu_indices(len(places))
    pairs = ((stiffness, "sti"), (np.kron(mass, np.eye(3)), "mas"))
    apart = [matrix[np.ix_(places, places)][upper] - found[f"{kind}_{name}"] for matrix, name in pairs]
    return [np.abs(d).max() / np.abs(found[f"{kind}_{n}"]).max() for d, (_, n) in zip(apart, pairs, strict=True)]


@pytest.mark.parametrize("kind", KINDS)
def test_stiffness_and_mass_are_those_that_calculix_stored(kind: str) -> None:
    with np.load(STORED / "matrices.npz") as found:
        assert max(difference(kind, STORED, dict(found))) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_stored_matrices_are_calculix(kind: str, tmp_path: Path) -> None:
    if shutil.which("ccx") is None:
        pytest.skip("CalculiX (ccx) is not installed")
    shutil.copy(STORED / f"{kind}.inp", tmp_path)
    subprocess.run(["ccx", kind], cwd=tmp_path, capture_output=True, check=True, timeout=600)
    dofs = np.array([line.split(".") for line in (tmp_path / f"{kind}.dof").read_text().split()], int)
    found = {f"{kind}_dof": dofs}
    for name in ("sti", "mas"):
        row, column, value = np.loadtxt(tmp_path / f"{kind}.{name}").T
        whole = np.zeros((len(dofs),) * 2)
        whole[row.astype(int) - 1, column.astype(int) - 1] = value
        found[f"{kind}_{name}"] = _upper(whole)
    assert max(difference(kind, tmp_path, found)) < 1e-12


@pytest.mark.slow
def test_matrices_that_calculix_stored_are_a_part(tmp_path: Path) -> None:
    """JOB.sti, JOB.mas and JOB.dof give what the mesh does; a freedom that is none is named by line."""
    if shutil.which("ccx") is None:
        pytest.skip("CalculiX (ccx) is not installed")
    shutil.copy(STORED / "c3d10.inp", tmp_path)
    subprocess.run(["ccx", "c3d10"], cwd=tmp_path, capture_output=True, check=True, timeout=600)
    found = condense(read_matrices(tmp_path / "c3d10.sti"), "ROOT", ["TIP"])
    expected = condense(read_mesh(tmp_path / "c3d10.inp"), "ROOT", ["TIP"])
    for name in ("compliance", "mass_matrix", "weight", "inertia", "frequencies_hz"):
        values = getattr(expected, name)
        np.testing.assert_allclose(getattr(found, name), values, rtol=1e-9, atol=1e-9 * np.abs(values).max())
    freedoms = (tmp_path / "c3d10.dof").read_text().splitlines()
    (tmp_path / "c3d10.dof").write_text("\n".join([*freedoms[:4], "7001.2", *freedoms[5:]]) + "\n")
    with pytest.raises(MeshError, match=r"c3d10\.dof:5: '7001\.2' is no freedom of c3d10\.inp"):
        read_matrices(tmp_path / "c3d10.sti")


def _upper(whole: np.ndarray) -> np.ndarray:
    both = whole + whole.T - np.diag(np.diag(whole))
    return both[np.triu_indices(len(whole))]


@pytest.mark.slow
def test_a_rigid_interface_is_calculix_rigid_body(tmp_path: Path) -> None:
    """Six unit loads on a *RIGID BODY at the loaded set's centroid give the columns of the compliance."""
    if shutil.which("ccx") is None:
        pytest.skip("CalculiX (ccx) is not installed")
    from support.meshes import bar, write_bar

    points, nodes = bar("C3D10", (4, 2, 2), (0.8, 0.1, 0.2))
    mesh = write_bar(tmp_path / "bar.inp", "C3D10", points, nodes)
    part = condense(read_mesh(mesh), "ROOT", ["TIP"])
    x, y, z = part.origin.tolist()
    model = [
        mesh.read_text(),
        f"*NODE\n9001, {x!r}, {y!r}, {z!r}\n9002, {x!r}, {y!r}, {z!r}\n*NSET, NSET=REF\n9001, 9002",
        "*RIGID BODY, NSET=TIP, REF NODE=9001, ROT NODE=9002\n*BOUNDARY\nROOT, 1, 3",
    ]
    for axis in range(6):
        model.append(f"*STEP\n*STATIC\n*CLOAD, OP=NEW\n{9001 + axis // 3}, {axis % 3 + 1}, 1e3")
        model.append("*NODE PRINT, NSET=REF\nU\n*END STEP")
    (tmp_path / "job.inp").write_text("\n".join(model) + "\n")
    subprocess.run(["ccx", "job"], cwd=tmp_path, capture_output=True, check=True, timeout=600)
    rows = [line.split() for line in (tmp_path / "job.dat").read_text().splitlines()]
    moved = np.array([[float(c) for c in row[1:4]] for row in rows if len(row) == 4 and row[0] in ("9001", "9002")])
    np.testing.assert_allclose(
        moved.reshape(6, 6).T / 1e3, part.compliance, rtol=2e-5, atol=1e-6 * part.compliance.max()
    )
