"""`train`: the published table's numbers, known compliances recovered, uncertainty that covers what it claims."""

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.bench import bench, write
from support.small_arms import ROBOTS

from armflex import InputError, read_joint_data, train
from armflex.bench.fit_linear import fit_compliance
from armflex.errors import TableError, UnitError, UnknownNameError
from armflex.laws import LinearLaw, Row
from armflex.show.view.law_curves import draw_training

TABLE = ROBOTS / "tarm_like" / "a4_table_1.csv"
NOWHERE = Row(np.zeros(0), {})


@pytest.mark.parametrize(
    ("structure", "in_sample", "held_out"),
    [("full", [0.142, 0.099, 0.341], [0.172, 0.121, 0.415]), ("diagonal", [1.113, 0.595, 0.703], None)],
)
@pytest.mark.parametrize("read_as", [None, {"mm": "um"}])
def test_published_table(structure: str, in_sample: list, held_out: list | None, read_as: dict | None) -> None:
    result = train(read_joint_data(TABLE, read_as), "linear", structure)
    np.testing.assert_array_equal(np.round(result.train_rms, 3), in_sample)
    if held_out:
        np.testing.assert_array_equal(np.round(result.held_out_rms, 3), held_out)
    assert (result.rows, result.held_out) == (20, "leave-one-out")
    assert result.units == (("mm",) * 3 if read_as is None else ("um",) * 3)


def test_published_table_read_as_another_unit_is_a_thousandth() -> None:
    plain, read = (train(read_joint_data(TABLE, read_as)) for read_as in (None, {"mm": "um"}))
    np.testing.assert_allclose(read.trained.law.compliance, 1e-3 * plain.trained.law.compliance, rtol=1e-12)
    assert "soft" in {flag.code for flag in plain.flags} and "soft" not in {flag.code for flag in read.flags}


def test_held_out_error_by_hand() -> None:
    data = read_joint_data(TABLE)
    residual = np.empty((20, 3))
    for i in range(20):
        kept = np.arange(20) != i
        for k in range(3):
            row = np.linalg.lstsq(data.loads[kept], data.deflections[kept, k], rcond=None)[0]
            residual[i, k] = data.deflections[i, k] - data.loads[i] @ row
    expected = np.sqrt((residual**2).mean(axis=0)) * 1e3
    np.testing.assert_allclose(train(data).held_out_rms, expected, rtol=1e-9)


def test_many_rows_are_held_out_by_tenths() -> None:
    data, _ = bench(3, 600, 3, 0.02)
    result = train(data)
    assert result.held_out == "10-fold" and (result.held_out_rms > result.train_rms).all()
    np.testing.assert_allclose(result.held_out_rms, result.train_rms, rtol=0.03)


@pytest.mark.parametrize("size", [3, 6])
@pytest.mark.parametrize("structure", ["full", "symmetric", "diagonal"])
@pytest.mark.parametrize("seed", [1, 2])
def test_known_compliance_is_recovered(size: int, structure: str, seed: int) -> None:
    data, truth = bench(size, 40, seed, 0.0, structure)
    law = train(data, "linear", structure).trained.law
    scale = np.sqrt(np.outer(np.abs(np.diag(truth)), np.abs(np.diag(truth))))
    np.testing.assert_allclose(law.compliance[:size, :size] / scale, truth / scale, rtol=0, atol=1e-10)
    assert not law.compliance[size:].any() and not law.compliance[:, size:].any()


@pytest.mark.parametrize("size", [3, 6])
@pytest.mark.parametrize("structure", ["full", "symmetric", "diagonal"])
def test_noisy_compliance_lies_within_its_own_errors(size: int, structure: str) -> None:
    scores = []
    for seed in range(30 if size == 6 else 150):
        data, truth = bench(size, 60, seed, 0.05, structure)
        fitted = fit_compliance(data.loads, data.deflections, structure)
        std = np.sqrt(np.array([np.diag(block) for block in fitted.row_covariance]))
        free = std > 0.0
        assert free.sum() == (size if structure == "diagonal" else size * size)
        scores.append(((fitted.compliance - truth)[free] / std[free]).ravel())
    scores = np.concatenate(scores)
    assert np.mean(np.abs(scores) > 4.0) < 1e-3
    independent = len(scores) * (0.5 if structure == "symmetric" else 1.0)
    assert abs(np.sqrt(np.mean(scores**2)) - 1.0) < 4.0 / np.sqrt(2.0 * independent)  # neither boastful nor timid


def test_symmetric_structure_gives_a_symmetric_matrix() -> None:
    data, truth = bench(6, 30, 9, 0.05, "full")
    law = train(data, "linear", "symmetric").trained.law
    np.testing.assert_array_equal(law.compliance, law.compliance.T)
    assert np.abs(truth - truth.T).max() > 0.01 * np.abs(truth).max()
    asymmetric = train(data, "linear", "full")
    assert "asymmetric" in {flag.code for flag in asymmetric.flags}
    assert "asymmetric" not in {flag.code for flag in train(data, "linear", "symmetric").flags}


@pytest.mark.parametrize("size", [3, 6])
def test_covariance_is_that_of_least_squares(size: int) -> None:
    """Row by row: s^2 (L^T L)^-1 with s^2 the residual sum of squares over N - k."""
    data, _ = bench(size, 25, 4, 0.1)
    law = train(data).trained.law
    inverse = np.linalg.inv(data.loads.T @ data.loads)
    for k in range(size):
        row, rss = np.linalg.lstsq(data.loads, data.deflections[:, k], rcond=None)[:2]
        variance = rss[0] / (25 - size)
        np.testing.assert_allclose(law.compliance[k, :size], row, rtol=1e-9)
        np.testing.assert_allclose(law.fit.row_covariance[k], variance * inverse, rtol=1e-7)
        np.testing.assert_allclose(law.fit.residual_std[k], np.sqrt(variance), rtol=1e-9)
    wrench = np.zeros(6)
    wrench[:size] = data.loads[3] * 1.7
    predicted = np.diag(law.covariance(wrench, NOWHERE))
    expected = law.fit.residual_std**2 * (1.0 + wrench[:size] @ inverse @ wrench[:size])
    np.testing.assert_allclose(predicted[:size], expected, rtol=1e-7)
    assert not predicted[size:].any()


@pytest.mark.slow
@pytest.mark.parametrize("structure", ["full", "symmetric", "diagonal"])
def test_prediction_variance_covers_new_readings(structure: str) -> None:
    """About 95 of 100 fresh readings lie within 1.96 of the stated deviation, with few rows to learn from."""
    inside = []
    for seed in range(150):
        data, _ = bench(3, 40, seed, 0.1, structure)
        train_data = replace(data, loads=data.loads[:12], deflections=data.deflections[:12])
        law = train(train_data, "linear", structure).trained.law
        for load, reading in zip(data.loads[12:], data.deflections[12:], strict=True):
            wrench = np.concatenate([load, np.zeros(3)])
            std = np.sqrt(np.diag(law.covariance(wrench, NOWHERE))[:3])
            inside.append(np.abs(reading - law.twist(wrench, NOWHERE)[:3]) < 1.96 * std)
    # With 9 degrees of freedom the normal's 1.96 covers 0.918 of Student's t; 11 of them cover 0.924.
    assert 0.90 < np.mean(inside) < 0.95


@pytest.mark.parametrize("structure", ["full", "symmetric", "diagonal"])
def test_a_column_that_is_followed_exactly(structure: str) -> None:
    """A direction with no deflection at all has no scatter either, which must not upset the others."""
    loads = np.vstack([np.eye(3), 2.0 * np.eye(3), -4.0 * np.eye(3)]) * 1e3
    truth = np.diag([2.0**-30, 2.0**-31, 0.0])
    data, _ = bench(3, 9, 0)
    result = train(replace(data, loads=loads, deflections=loads @ truth), "linear", structure)
    np.testing.assert_allclose(result.trained.law.compliance[:3, :3], truth, atol=1e-20)
    assert np.isfinite(result.trained.law.fit.row_covariance).all()


def test_rows_are_not_all_in_one_unit(tmp_path: Path) -> None:
    """Six components in kN, Nmm, mm and mrad: SI inside, errors in each column's own unit."""
    data, _ = bench(6, 30, 6, 0.02)
    plain = train(data)
    factors = np.array([1e3] * 3 + [1e-3] * 3 + [1e-3, 1e-3, 1e-6, 1e-3, np.pi / 180, 1.0])
    header = "fx_kN,fy_kN,fz_kN,mx_Nmm,my_Nmm,mz_Nmm,dx_mm,dy_mm,dz_um,rx_mrad,ry_deg,rz_rad,specimen"
    rows = np.hstack([np.hstack([data.loads, data.deflections]) / factors, np.arange(30)[:, None]])
    path = write(tmp_path, header, rows)
    read = read_joint_data(path)
    result = train(read)
    np.testing.assert_allclose(result.trained.law.compliance, plain.trained.law.compliance, rtol=1e-9)
    np.testing.assert_allclose(result.train_rms, plain.train_rms / factors[6:], rtol=1e-9)
    assert result.units == ("mm", "mm", "um", "mrad", "deg", "rad") and list(read.covariates) == ["specimen"]
    assert result.trained.metadata["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert result.trained.metadata["units"] == list(result.units)


def rewritten(folder: Path, *edits: tuple[str, str]) -> Path:
    text = TABLE.read_text()
    for old, new in edits:
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / "joint.csv"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("edits", "read_as", "error", "complaint"),
    [
        (
            [("dx_mm", "dx")],
            None,
            UnitError,
            "joint.csv:1: column 'dx' has no unit; write one in the header, such as dx_m",
        ),
        ([("fx_kN", "fx")], None, UnitError, "column 'fx' has no unit"),
        ([("fx_kN", "fx_mm")], None, TableError, "'mm' is no unit of force"),
        ([("dx_mm", "dx_mmm")], None, TableError, "'mmm' is no unit of length, did you mean 'mm'"),
        ([("dx_mm", "ddx_mm")], None, TableError, "joint.csv:1: unknown column 'ddx_mm', did you mean 'dx'"),
        ([("fx_kN", "fxx_kN")], None, TableError, "unknown column 'fxx_kN', did you mean 'fx'"),
        ([("dz_mm", "DDZ_mm")], None, TableError, "unknown column 'DDZ_mm', did you mean 'dz'"),
        ([("data_no", "mxx_Nm")], None, TableError, "unknown column 'mxx_Nm', did you mean 'mx'"),
        ([("data_no", "rx_mrad")], None, TableError, "has no moments mx, my, mz beside the rotations rx"),
        ([("data_no", "mz_kNm")], None, TableError, "has no rotations rx, ry, rz beside the moments mz"),
        ([("-1.09,", "1e300,")], None, TableError, "joint.csv:2: column 'dx_mm' is '1e300', which no bench reaches"),
        ([("1.1852,", "1e308,")], None, TableError, "joint.csv:2: column 'fx_kN' is '1e308', which no bench reaches"),
        ([], {"cm": "mm"}, UnitError, "joint.csv:1: no column is in 'cm', did you mean 'mm'"),
        ([("-1.09,", "1.0.9,")], None, TableError, "joint.csv:2: column 'dx_mm' is '1.0.9'"),
        ([], {"mm": "umm"}, UnitError, "'umm' is no unit of length, did you mean 'um'"),
        ([], {"mm": "N"}, UnitError, "'N' is no unit of length"),
    ],
)
def test_bad_tables(tmp_path: Path, edits: list, read_as: dict | None, error: type, complaint: str) -> None:
    with pytest.raises(error, match=complaint):
        read_joint_data(rewritten(tmp_path, *edits), read_as)


def test_too_few_rows(tmp_path: Path) -> None:
    lines = TABLE.read_text().splitlines()
    for count in (1, 3):
        (tmp_path / "few.csv").write_text("\n".join(lines[: count + 1]))
        with pytest.raises(TableError, match=f"has {count} rows, 3 components need more"):
            read_joint_data(tmp_path / "few.csv")
    (tmp_path / "few.csv").write_text("\n".join(lines[:5]))
    with pytest.raises(InputError, match="the held-out error needs more rows: without data row 1, 3 rows"):
        train(read_joint_data(tmp_path / "few.csv"))
    (tmp_path / "few.csv").write_text("\n".join(lines[:6]))
    assert train(read_joint_data(tmp_path / "few.csv")).rows == 5


@pytest.mark.parametrize("flaw", ["zero column", "two alike", "in a plane"])
def test_loads_that_do_not_span(flaw: str) -> None:
    data, _ = bench(3, 12, 2)
    loads = data.loads.copy()
    loads[:, 2] = {"zero column": 0.0 * loads[:, 0], "two alike": 3.0 * loads[:, 0], "in a plane": loads[:, :2].sum(1)}[
        flaw
    ]
    with pytest.raises(InputError, match="loads do not span their 3 components"):
        train(replace(data, loads=loads))


def test_one_row_that_alone_loads_a_component() -> None:
    data, _ = bench(3, 12, 2)
    loads = data.loads.copy()
    loads[:, 2] = 0.0
    loads[7, 2] = 1e3
    with pytest.raises(InputError, match="without data row 8, loads do not span"):
        train(replace(data, loads=loads))


def test_unknown_model_and_structure() -> None:
    data, _ = bench(3, 12, 2)
    with pytest.raises(
        UnknownNameError, match="no joint deformation model to train named 'liner', did you mean 'linear'"
    ):
        train(data, "liner")
    with pytest.raises(InputError, match="structure 'diagonl' is not known, did you mean 'diagonal'"):
        train(data, "linear", "diagonl")


def test_trained_law_remembers_the_loads_it_saw() -> None:
    data = read_joint_data(TABLE)
    law = train(data).trained.law
    assert isinstance(law, LinearLaw)
    np.testing.assert_array_equal(law.fit.loads, [data.loads.min(axis=0), data.loads.max(axis=0)])


@pytest.mark.slow
@pytest.mark.parametrize("model", ["linear", "polynomial"])
def test_what_was_learned_is_drawn(model: str, tmp_path: Path) -> None:
    """The picture is there whole, and differs where the law does; of another ending it is refused."""
    data = read_joint_data(TABLE)
    result = train(data, model)
    drawn = draw_training(result, data, tmp_path / "law.png").read_bytes()
    other = draw_training(train(data, "linear", "diagonal"), data, tmp_path / "other.png").read_bytes()
    assert drawn[:4] == b"\x89PNG" == other[:4] and drawn != other
    with pytest.raises(InputError, match=r"law\.jpg: expected a name that ends in \.png"):
        draw_training(result, data, tmp_path / "law.jpg")


def test_programs_get_the_unit_of_every_column(tmp_path: Path) -> None:
    loads = np.random.default_rng(0).normal(size=(30, 6))
    head = "fx_kN,fy_kN,fz_kN,mx_kNm,my_kNm,mz_kNm,dx_mm,dy_mm,dz_mm,rx_mrad,ry_mrad,rz_mrad"
    np.savetxt(tmp_path / "turns.csv", np.hstack([loads, loads]), delimiter=",", header=head, comments="")
    both, shifts = (train(read_joint_data(path), "linear").to_dict() for path in (tmp_path / "turns.csv", TABLE))
    assert both["units"] == ["mm"] * 3 + ["mrad"] * 3 and both["unit"] is None and len(both["train_rms"]) == 6
    assert shifts["units"] == ["mm"] * 3 and shifts["unit"] == "mm"
