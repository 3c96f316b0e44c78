"""A composed joint fitted to what its tip did: compliances recovered, their uncertainty honest, files that load."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.command_line import Run, fine
from support.structures import ASSEMBLY, BEAM

from armflex import InputError, read_joint_data, train
from armflex.bench.fit_structural import fit_structural
from armflex.bench.learners import Options
from armflex.errors import ModelFileError
from armflex.laws import LinearLaw, Row
from armflex.laws.declared import read_assembly
from armflex.laws.joint.position_dependent import PositionDependentLaw
from armflex.laws.joint.structural import StructuralLaw
from armflex.laws.law_file import TrainedLaw, load_law, save_law
from armflex.measured.joint_data import JointData

NOWHERE = Row(np.zeros(0), {})
ASSEMBLY += BEAM.format("1") + BEAM.format("2")
FACTORS = ((2.0, 0.5, 1.5), (0.7, 3.0, 1.2), (1.8,))
NOISE = np.array([2e-7, 2e-7, 2e-7, 1e-6, 1e-6, 1e-6])


@pytest.fixture(scope="module")
def assembly(tmp_path_factory: pytest.TempPathFactory) -> StructuralLaw:
    path = tmp_path_factory.mktemp("joint") / "assembly.toml"
    path.write_text(ASSEMBLY)
    return read_assembly(path)


def truth(assembly: StructuralLaw) -> StructuralLaw:
    """Return the assembly with other sub-joints."""
    subjoints = []
    for sub, factors in zip(assembly.subjoints, FACTORS, strict=True):
        diagonal = np.diag(sub.law.compliance).copy()
        diagonal[list(sub.holds)] *= factors
        subjoints.append(replace(sub, law=LinearLaw(np.diag(diagonal))))
    return replace(assembly, subjoints=tuple(subjoints))


def bench(assembly: StructuralLaw, seed: int, rows: int = 60) -> JointData:
    rng = np.random.default_rng(seed)
    loads = rng.normal(size=(rows, 6)) * np.repeat([2e3, 5e2], 3)
    deflections = truth(assembly).twist(loads, NOWHERE) + NOISE * rng.normal(size=(rows, 6))
    return JointData(loads, deflections, ("m",) * 3 + ("rad",) * 3, np.ones(6), "0" * 64, Path("made.csv"))


@pytest.mark.slow
def test_compliances_are_recovered_within_their_uncertainty(assembly: StructuralLaw) -> None:
    wanted = np.concatenate([np.diag(sub.law.compliance)[list(sub.holds)] for sub in truth(assembly).subjoints])
    pulls = []
    for seed in range(12):
        data = bench(assembly, seed)
        found = fit_structural(data.loads, data.deflections, assembly).parameters.values()
        value, std = (np.array([one[key] for one in found]) for key in ("value", "relative_std"))
        pulls.append(np.log(value / wanted) / std)
    spread = np.sqrt((np.array(pulls) ** 2).mean())
    assert 0.75 < spread < 1.3


@pytest.mark.slow
def test_what_is_predicted_is_near_the_truth_and_its_band_covers(assembly: StructuralLaw) -> None:
    data = bench(assembly, 3)
    result = train(data, "structural", options=Options(assembly=assembly))
    np.testing.assert_allclose(result.held_out_rms, NOISE, rtol=0.25)
    assert result.held_out == "10-fold"
    assert 0.9 < result.coverage_95 < 0.99
    fresh = np.random.default_rng(9).normal(size=(20, 6)) * np.repeat([2e3, 5e2], 3)
    exact = truth(assembly).twist(fresh, NOWHERE)
    np.testing.assert_allclose(result.trained.law.twist(fresh, NOWHERE), exact, atol=0.3 * NOISE.max())


@pytest.fixture(scope="module")
def trained(assembly: StructuralLaw) -> TrainedLaw:
    return train(bench(assembly, 1), "structural", options=Options(assembly=assembly)).trained


@pytest.mark.slow
def test_a_fitted_structure_is_the_same_from_a_file_in_a_fresh_process(trained: TrainedLaw, tmp_path: Path) -> None:
    path = save_law(trained, tmp_path / "joint.safetensors")
    again = load_law(path).law
    wrench = np.array([900.0, -300.0, 500.0, 20.0, 60.0, -80.0])
    np.testing.assert_allclose(again.twist(wrench, NOWHERE), trained.law.twist(wrench, NOWHERE), rtol=1e-12)
    np.testing.assert_allclose(again.covariance(wrench, NOWHERE), trained.law.covariance(wrench, NOWHERE))
    assert again.trained and again.flags(1e3 * wrench, NOWHERE) and not again.flags(0.1 * wrench, NOWHERE)
    code = f"import sys, armflex.laws.law_file as f; f.load_law({str(path)!r}); assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=600)


@pytest.mark.slow
def test_a_damaged_file_is_refused(trained: TrainedLaw, tmp_path: Path) -> None:
    path = save_law(trained, tmp_path / "j")
    data = bytearray(path.read_bytes())
    data[-20] ^= 1
    path.write_bytes(bytes(data))
    with pytest.raises(ModelFileError):
        load_law(path)


def test_too_few_readings_and_nonlinear_parts_are_refused(assembly: StructuralLaw) -> None:
    data = bench(assembly, 1)
    with pytest.raises(InputError, match="do not determine 7 compliances"):
        fit_structural(data.loads[:1], data.deflections[:1], assembly)
    with pytest.raises(InputError, match="needs its assembly"):
        train(data, "structural")
    stranger = replace(assembly.subjoints[0], law=PositionDependentLaw("A4", np.zeros((1, 6, 6))))
    with pytest.raises(InputError, match="at '1' is not linear"):
        fit_structural(data.loads, data.deflections, replace(assembly, subjoints=(stranger, *assembly.subjoints[1:])))


@pytest.mark.slow
def test_a_table_and_an_assembly_on_the_command_line(armflex: Run, assembly: StructuralLaw, tmp_path: Path) -> None:
    data = bench(assembly, 2)
    header = "fx_N,fy_N,fz_N,mx_Nm,my_Nm,mz_Nm,dx_m,dy_m,dz_m,rx_rad,ry_rad,rz_rad"
    rows = [",".join(map(repr, row)) for row in np.hstack([data.loads, data.deflections]).tolist()]
    (tmp_path / "joint.csv").write_text("\n".join([header, *rows]) + "\n")
    (tmp_path / "assembly.toml").write_text(ASSEMBLY)
    asked = ["train", tmp_path / "joint.csv", "--model", "structural", "--assembly", tmp_path / "assembly.toml"]
    fine(armflex(*asked, "-o", tmp_path / "joint.safetensors"))
    np.testing.assert_allclose(read_joint_data(tmp_path / "joint.csv").deflections, data.deflections)
    assert isinstance(load_law(tmp_path / "joint.safetensors").law, StructuralLaw)
