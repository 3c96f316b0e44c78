"""Tables and options that no joint deformation model can be learned from, asked of every model alike."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.bench import SIX, bench, write
from support.command_line import Run, fine, strict_json
from support.small_arms import ROBOTS
from support.structures import ASSEMBLY, BEAM

from armflex import InputError, load_law, read_joint_data, train
from armflex.bench import fit_bayesian as bayesian
from armflex.bench.fit_bayesian import fit_bayesian
from armflex.bench.fit_linear import fit_compliance
from armflex.bench.fitted import NOWHERE
from armflex.bench.learners import Options, learner
from armflex.bench.training import bench_flags, law_flags
from armflex.errors import (
    ArmflexWarning,
    ArrayTypeError,
    ConvergenceError,
    IdentifiabilityError,
    LawError,
    NotFiniteError,
    ShapeError,
    TableError,
    UnknownNameError,
)
from armflex.laws.declared import read_assembly

TABLE = ROBOTS / "tarm_like" / "a4_table_1.csv"
SMALL = {"neurons": 2, "starts": 1}
MODELS = {
    "linear": ("linear", Options()),
    "polynomial": ("polynomial", Options(features=("radial",))),
    "terms found": ("polynomial", Options(features=("found",))),
    "neural": ("neural", Options(**SMALL)),
    "plain neural": ("neural", Options(**SMALL, prior="none")),
    "laplace": ("bayesian", Options(**SMALL)),
    "nuts": ("bayesian", Options(**SMALL, sampler="nuts")),
    "metropolis": ("bayesian", Options(**SMALL, sampler="metropolis")),
    "auto": ("auto", Options(**SMALL)),
}
every_model = pytest.mark.parametrize("model", MODELS)


def codes(flags: tuple) -> set[str]:
    return {flag.code for flag in flags}


@every_model
@pytest.mark.parametrize("flaw", ["no load", "one component never loaded", "one row many times"])
def test_loads_that_determine_nothing(model: str, flaw: str) -> None:
    data, _ = bench(3, 20, 2, 0.01)
    loads = {
        "no load": 0.0 * data.loads,
        "one component never loaded": data.loads * [1.0, 0.0, 1.0],
        "one row many times": np.repeat(data.loads[:1], 20, axis=0),
    }[flaw]
    name, options = MODELS[model]
    with pytest.raises(IdentifiabilityError, match=r"left free: .*fy") as caught:
        train(replace(data, loads=loads), name, options=options)
    assert caught.value.rank < 4 and caught.value.condition > 1e6


@every_model
def test_tables_that_are_no_joints(model: str) -> None:
    data, _ = bench(3, 20, 2, 0.01)
    name, options = MODELS[model]
    with pytest.raises(LawError, match="every deflection is 0"):
        train(replace(data, deflections=0.0 * data.deflections), name, options=options)
    with pytest.raises(LawError, match=r"negative work on the deflections in 20 of 20 rows: .* not its reaction"):
        train(replace(data, deflections=-data.deflections), name, options=options)


@pytest.mark.parametrize(
    ("change", "error", "complaint"),
    [
        ({"deflections": np.full((20, 3), np.nan)}, NotFiniteError, "deflections: element 0 is not finite"),
        ({"loads": np.full((20, 3), np.inf)}, NotFiniteError, "loads: element 0 is not finite"),
        ({"loads": np.full((20, 3), 1e13)}, NotFiniteError, "loads: a number is beyond 1e\\+12"),
        ({"loads": np.ones((19, 3))}, ShapeError, r"deflections: expected shape \(19, 3\)"),
        ({"loads": np.ones((20, 4))}, ShapeError, r"expected \(rows, 3\) or \(rows, 6\)"),
        ({"loads": np.ones((20, 3), complex)}, ArrayTypeError, "expected real numbers"),
        ({"units": ("m",)}, ShapeError, "expected one for each of 3"),
    ],
)
def test_joint_data_that_is_none(change: dict, error: type, complaint: str) -> None:
    data, _ = bench(3, 20, 2)
    with pytest.raises(error, match=complaint):
        replace(data, **change)


def test_lists_and_other_floats_are_taken() -> None:
    data, _ = bench(3, 20, 2)
    listed = replace(data, loads=data.loads.tolist(), deflections=data.deflections.astype(np.float32))
    assert listed.loads.dtype == listed.deflections.dtype == np.float64
    np.testing.assert_array_equal(listed.loads, data.loads)


def test_what_is_asked_for_in_python() -> None:
    data, _ = bench(3, 20, 2)
    with pytest.raises(InputError, match=r"joint\.csv: cannot be read: No such file"):
        train("joint.csv")
    with pytest.raises(UnknownNameError, match="named 'None'"):
        train(data, None)
    with pytest.raises(InputError, match="structure None is not known"):
        train(data, "linear", None)
    for wrong in ({"neurons": 0}, {"neurons": 2.5}, {"starts": -1}, {"seed": -1}, {"seed": "0"}):
        with pytest.raises(InputError, match="expected a whole number from"):
            Options(**wrong)
    assert Options(neurons=np.int64(3)).neurons == 3 and Options(features="linear+radial").features[1] == "radial"
    with pytest.raises(InputError, match="give it alone"):
        train(data, "polynomial", options=Options(features=("found", "radial")))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "value"), [(m, v) for m in ("linear", "polynomial", "neural") for v in (0.0, 3.7e-4)] + [("auto", 0.0)]
)
def test_a_column_that_never_changes_is_said_and_upsets_no_comparison(model: str, value: float) -> None:
    data, _ = bench(3, 24, 2, 0.01)
    deflections = data.deflections.copy()
    deflections[:, 1] = value
    with np.errstate(divide="raise", invalid="raise"):
        result = train(replace(data, deflections=deflections), model, options=Options(**SMALL))
    assert "constant_column" in codes(result.flags)
    assert np.isfinite(result.held_out_rms).all() and not any("nan" in flag.text for flag in result.flags)


def test_doubts_about_a_bench() -> None:
    data, _ = bench(3, 20, 2, 0.01)
    assert bench_flags(data) == ()
    twice = replace(data, loads=data.loads[[*range(20), 4, 4]], deflections=data.deflections[[*range(20), 4, 4]])
    (flag,) = bench_flags(twice)
    assert flag.code == "duplicate_rows" and flag.text.startswith("2 rows repeat") and "data row 21" in flag.text
    (flag,) = bench_flags(replace(data, deflections=data.deflections * [1.0, 1.0, -1.0]))
    assert flag.code == "against_its_load" and flag.text.startswith("dz goes against fz")


@pytest.mark.parametrize("model", ["linear", "polynomial", "neural", "bayesian"])
def test_every_model_doubts_a_unit_that_makes_no_machine(model: str) -> None:
    for read_as, soft in ((None, True), ({"mm": "um"}, False)):
        data = read_joint_data(TABLE, read_as)
        found = codes(law_flags(data, learner(model, Options(**SMALL))(data.loads, data.deflections, 0)))
        assert ("soft" in found) == soft
        assert "does_not_turn" in found
    six, _ = bench(6, 30, 1, 0.01)
    assert "does_not_turn" not in codes(train(six).flags)


def test_loads_are_read_as_another_unit_too() -> None:
    plain, read = (read_joint_data(TABLE, read_as) for read_as in (None, {"kN": "N"}))
    np.testing.assert_allclose(read.loads, 1e-3 * plain.loads, rtol=1e-15)
    np.testing.assert_array_equal(read.deflections, plain.deflections)


@pytest.mark.slow
def test_asymmetry_is_judged_by_the_noise() -> None:
    """A flag in 2 of 40 benches of symmetric joints at most, and in all where an entry is 10 deviations off."""
    said = wrong = 0
    for seed in range(40):
        data, _ = bench(3, 30, seed, 0.05, "symmetric")
        said += "asymmetric" in codes(train(data).flags)
        fitted = fit_compliance(data.loads, data.deflections)
        off = np.zeros((3, 3))
        off[0, 2] = 10.0 * np.sqrt(fitted.row_covariance[0, 2, 2] + fitted.row_covariance[2, 0, 0])
        skewed = replace(data, deflections=data.deflections + data.loads @ off.T)
        (flag,) = [flag for flag in train(skewed).flags if flag.code == "asymmetric"]
        wrong += "dx per fz" not in flag.text
    assert said <= 2 and wrong == 0


def test_subjoints_that_the_loads_do_not_determine(tmp_path: Path) -> None:
    forces = ASSEMBLY.split("[[beam]]")[0].replace("[nodes]", "components = 3\n[nodes]", 1)
    forces = forces.rsplit("[[subjoint]]", 1)[0] + BEAM.format("1") + BEAM.format("2")
    whole = ASSEMBLY + BEAM.format("1") + BEAM.format("2")
    for name, text in (("assembly.toml", whole), ("forces.toml", forces)):
        (tmp_path / name).write_text(text)
    assembly, only_forces = (read_assembly(tmp_path / name) for name in ("assembly.toml", "forces.toml"))
    data, _ = bench(6, 30, 1, 0.01)
    with pytest.raises(IdentifiabilityError, match="left free: 1 C_dx"):
        train(replace(data, loads=0.0 * data.loads), "structural", options=Options(assembly=assembly))
    with pytest.raises(InputError, match="have 6 components, the assembly 3"):
        train(data, "structural", options=Options(assembly=only_forces))
    loads = data.loads * [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    deflections = assembly.twist(loads, NOWHERE) + 1e-7 * np.random.default_rng(0).normal(size=loads.shape)
    one_way = replace(data, loads=loads, deflections=deflections)
    flags = train(one_way, "structural", options=Options(assembly=assembly)).flags
    assert any(flag.code == "not_identified" and "2 C_rz" in flag.text for flag in flags)


@pytest.mark.slow
def test_a_chain_that_is_taken_unconverged_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("arviz_stats")
    monkeypatch.setattr(bayesian, "DRAWS", {"metropolis": 60})
    data, _ = bench(3, 24, 2, 0.01)
    result = train(data, "bayesian", options=Options(**SMALL, sampler="metropolis", allow_unconverged=True))
    assert "not_converged" in codes(result.flags) and result.held_out == "5-fold"
    assert result.trained.metadata["diagnostics"]["ess_min"] == result.diagnostics.ess_min < 400


def test_a_chain_that_has_converged_on_all_rows_but_not_without_some(monkeypatch: pytest.MonkeyPatch) -> None:
    data, _ = bench(3, 24, 2, 0.01)

    def learn(loads: np.ndarray, deflections: np.ndarray, *rest: object, **options: object) -> object:
        if len(loads) < 24:
            raise ConvergenceError("the chains have not converged", ())
        return fit_bayesian(loads, deflections, 2)

    monkeypatch.setattr("armflex.bench.fit_bayesian.fit_bayesian", learn)
    with pytest.raises(ConvergenceError, match=r"held-out error, without data row .* and 4 others: the chains"):
        train(data, "bayesian", options=Options(sampler="nuts"))


def test_a_stuck_chain_is_null_for_programs(armflex: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("arviz_stats")

    data, _ = bench(3, 24, 2, 0.01)
    result = train(data)
    stuck = replace(result, diagnostics=replace(result.diagnostics, rhat_max=np.inf, ess_min=0.0))
    told = stuck.to_dict()["diagnostics"]
    assert told["rhat_max"] is None and told["ess_min"] == 0.0


@pytest.mark.parametrize(
    ("asked", "complaint"),
    [
        (["--model", "neural", "--sampler", "nuts"], "--sampler does not concern --model neural"),
        (["--model", "polynomial", "--neurons", "4"], "--neurons does not concern --model polynomial"),
        (["--model", "auto", "--structure", "diagonal"], "--structure does not concern --model auto"),
        (["--seed", "-1"], "-1 is not in the range"),
        (["--read-as", "cm=mm"], "no column is in 'cm', did you mean 'mm'"),
    ],
)
def test_options_that_would_do_nothing(armflex: Run, tmp_path: Path, asked: list[str], complaint: str) -> None:
    ran = armflex("train", TABLE, *asked, "-o", "law.safetensors", "--json", "law.json")
    assert complaint in fine(ran, 2).stderr.replace("\n", " ")
    assert not list(tmp_path.glob("law.*"))


@pytest.mark.slow
def test_bench_in_kN_and_mm_from_table_to_arm(armflex: Run, tmp_path: Path) -> None:
    """What a newcomer does, with the last line of the first command as the only help."""
    data, _ = bench(6, 40, 3, 0.01)
    header = SIX.replace("_Nm", "_kNm").replace("_N,", "_kN,").replace("_m,", "_mm,").replace("_rad", "_mrad")
    path = write(tmp_path, header, np.hstack([data.loads * 1e-3, data.deflections * 1e3]))
    shown = fine(armflex("train", path, "--model", "polynomial", "-o", "a4.safetensors"))
    lines = shown.stdout.split("In an arm.toml:\n")[1]
    assert lines.splitlines()[:2] == ['model = "polynomial"', 'file = "a4.safetensors"']
    arm = (ROBOTS / "tarm_like" / "arm.toml").read_text().replace('"robot.urdf"', f'"{ROBOTS}/tarm_like/robot.urdf"')
    (tmp_path / "arm.toml").write_text(f'{arm.split("[flexure.A4]")[0]}[flexure.A4]\njoint = "A4"\n{lines}\n')
    fine(armflex("deflect", "arm.toml", "--json", "d.json"))
    assert np.isfinite(strict_json(tmp_path / "d.json")["displacement"]).all()
    assert load_law(tmp_path / "a4.safetensors").metadata["units"] == ["mm"] * 3 + ["mrad"] * 3


def test_headers_of_a_bench_may_have_capitals_and_brackets(tmp_path: Path) -> None:
    lines = TABLE.read_text().splitlines()
    (tmp_path / "capital.csv").write_text("\n".join(["Fx [kN],Fy [kN],Fz [kN],Dx [mm],Dy [mm],Dz [mm],No", *lines[1:]]))
    found, plain = read_joint_data(tmp_path / "capital.csv"), read_joint_data(TABLE)
    assert np.array_equal(found.loads, plain.loads) and np.array_equal(found.deflections, plain.deflections)


@pytest.mark.parametrize("mark", [",", ";"])
def test_titles_before_the_header_of_a_bench_are_not_read(tmp_path: Path, mark: str) -> None:
    lines = TABLE.read_text().splitlines()
    titles = ["Bench of the elbow, 14.03.2026, by: White", "", "# second run"]
    text = "\n".join([*titles, *(line.replace(",", mark) for line in lines)])
    (tmp_path / "titled.csv").write_text(text)
    with pytest.warns(ArmflexWarning, match=r"titled\.csv:1: not read, a title before the header: 'Bench of the elbow"):
        titled = read_joint_data(tmp_path / "titled.csv")
    plain = read_joint_data(TABLE)
    assert np.array_equal(titled.loads, plain.loads) and np.array_equal(titled.deflections, plain.deflections)
    (tmp_path / "longer.csv").write_text("\n".join([*titles, *lines, "1,2"]))
    at = len(titles) + len(lines) + 1
    with (
        pytest.warns(ArmflexWarning),
        pytest.raises(TableError, match=rf"longer\.csv:{at}: has 2 cells, the header has"),
    ):
        read_joint_data(tmp_path / "longer.csv")


@pytest.mark.parametrize(
    ("head", "zeros", "declared"),
    [
        (
            "Joint;Moment [kNm];Rotation [mrad]",
            "slew;",
            "joint_stiffness = {stiffness:.5g} (about the joint's own axis)",
        ),
        ("JOINT,TORQUE_KNM,Angle_Mrad", "slew,", "joint_stiffness = {stiffness:.5g} (about the joint's own axis)"),
        ("Joint,My [kNm],Ry_mrad", "slew,", "compliance = [0, 0, 0, 0, {softness:.5g}, 0]"),
        ("joint,moment_kNm,rotation_mrad", "slew,", "joint_stiffness = {stiffness:.5g} (about the joint's own axis)"),
        ("joint,my_kNm,ry_mrad", "slew,", "compliance = [0, 0, 0, 0, {softness:.5g}, 0]"),
        (
            "joint,fx_N,fy_N,fz_N,mx_Nm,mz_Nm,dx_mm,dy_mm,dz_mm,rx_mrad,rz_mrad,my_kNm,ry_mrad",
            "slew,0,0,0,0,0,0,0,0,0,0,",
            "compliance = [0, 0, 0, 0, {softness:.5g}, 0]",
        ),
    ],
)
def test_a_table_of_one_axis_is_answered_with_its_compliance(
    tmp_path: Path, head: str, zeros: str, declared: str
) -> None:
    moments = np.linspace(-20.0, 20.0, 11)  # [kNm]
    noise = 0.004 * np.random.default_rng(2).normal(size=11)
    turns = 0.02 * moments + noise  # [mrad]
    mark = ";" if ";" in head else ","
    rows = [f"{zeros}{float(moment)!r}{mark}{float(turn)!r}" for moment, turn in zip(moments, turns, strict=True)]
    (tmp_path / "bench.csv").write_text("\n".join([head, *rows]) + "\n")
    with pytest.raises(TableError, match=r"loads one axis alone, '.*' against '.*'; train needs all") as met:
        read_joint_data(tmp_path / "bench.csv")
    # Ordinary least squares about the means.
    softness = moments @ (turns - turns.mean()) / (moments @ moments)
    left = turns - turns.mean() - softness * moments
    std = np.sqrt(left @ left / 9.0 / (moments @ moments))
    said = declared.format(softness=softness * 1e-6, stiffness=1e6 / softness)
    assert f"{softness * 1e-6:.5g} ± {std * 1e-6:.2g} rad/Nm: [flexure.slew]" in str(met.value)
    assert f'joint = "slew", {said}, relative_std = {std / softness:.2g}' in str(met.value)
