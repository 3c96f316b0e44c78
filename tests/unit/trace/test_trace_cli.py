"""`armflex trace`: one campaign from the shell, with its points exported apart, and one that lacks nothing."""

import csv
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from support.campaigns import Truth, draw
from support.command_line import Run, fine, strict_json
from support.effect_arms import quietly

from armflex import predict, read_measurements, trace
from armflex.cli.trace_command import as_json, print_trace
from armflex.estimate.posterior import without_declared_uncertainty
from armflex.estimate.tip_uncertainty import tip_covariance
from armflex.laws.effects.catalogue import CATALOGUE, EVERY
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.location import Location
from armflex.measured.points import read_points
from armflex.show.report.summary import further, headline
from armflex.show.report.words import called
from armflex.trace.findings import Unexplained

pytestmark = pytest.mark.slow

CONTRACT = {
    "format", "nothing", "rows",
    "noise_rms_mm", "rms_mm", "held_out_rms_mm", "effects", "unexplained", "not_identifiable",
    "next_measurement",
}  # fmt: skip


@pytest.fixture(scope="module")
def truth(tmp_path_factory: pytest.TempPathFactory) -> Truth:
    return draw("backlash", 1, "six").write(tmp_path_factory.mktemp("field"), every=3)


def exported(truth: Truth, folder: Path) -> tuple[Path, Path]:
    """Write the campaign's rows without positions, and the positions as an instrument's program exports them."""
    rows = list(csv.DictReader(truth.train.open()))
    kept = [name for name in rows[0] if name not in "xyz"]
    points = ["// Units: mm"]
    for i, row in enumerate(rows):
        row["point"] = f"stop{i}"
        if row["x"]:
            points.append(f"Main stop{i} " + " ".join(f"{1e3 * float(row[axis]):.9f}" for axis in "xyz"))
    with (folder / "m.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, [*kept, "point"], extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    (folder / "points.txt").write_text("\n".join(points) + "\n")
    return folder / "m.csv", folder / "points.txt"


@pytest.fixture(scope="module")
def ran(truth: Truth, tmp_path_factory: pytest.TempPathFactory):
    """Run the command in this process; return its folder, what it said, and the trace that it made."""
    from click.testing import CliRunner

    import armflex.cli.trace_command as module

    folder, made = tmp_path_factory.mktemp("ran"), []
    rows, points = exported(truth, folder)
    given = [truth.arm, rows, "--points", points, "--points-frame", "World", "-o", folder / "traced.toml"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "trace", lambda *args, **more: made.append(trace(*args, **more)) or made[0])
        result = CliRunner().invoke(module.command, [str(x) for x in (*given, "--json", folder / "t.json")])
    assert result.exit_code == 0 and not result.exception, result.output
    return folder, result, made[0]


def test_the_json_is_the_contracts(ran, truth: Truth) -> None:
    found = strict_json(ran[0] / "t.json")
    assert list(found)[: len(CONTRACT)] == [name for name in found if name in CONTRACT] and set(found) >= CONTRACT
    assert found["format"] == "armflex-trace-1" and found["rows"] == len(read_rows(truth))
    assert found["noise_rms_mm"] == pytest.approx(2e-4 * np.sqrt(3.0) * 1e3)
    errors, held_out = found["rms_mm"], found["held_out_rms_mm"]
    assert set(errors) == {"declared", "calibrated", "after"} and set(held_out) == {"calibrated", "after", "families"}
    assert errors["declared"] > errors["calibrated"] > errors["after"] > 0.0
    assert held_out["calibrated"] > held_out["after"] > errors["after"]
    assert found["unexplained"] is None and all(isinstance(text, str) for text in found["next_measurement"])
    assert all(set(one) == {"effect", "site", "reason"} for one in found["not_identifiable"])


def read_rows(truth: Truth) -> list[dict]:
    return [row for row in csv.DictReader(truth.train.open()) if row["x"]]


def test_the_effect_is_named_as_files_name_it(ran, truth: Truth) -> None:
    (one,) = strict_json(ran[0] / "t.json")["effects"]
    true = truth.effects[0]
    assert (one["effect"], one["site"], one["axis"]) == ("backlash", true.site, true.axis)
    assert one["covariates"] == [f"approach_{true.site}"] and set(one["parameters"]) == {"gap"}
    gap = one["parameters"]["gap"]
    assert gap["unit"] == "rad" and abs(gap["value"] - true.parameters["gap"]) < 4.0 * gap["std"] < gap["value"]
    assert one["held_out_rms_mm"]["after"] < one["held_out_rms_mm"]["before"]
    assert one["probability"] > 0.9 and one["credible"][0]["effect"] == "backlash"
    assert [other["effect"] for other in one["equivalent"]] == [other["effect"] for other in one["credible"][1:]]


def test_the_terminal_says_on_what_an_effect_depends(ran, truth: Truth) -> None:
    (one,) = strict_json(ran[0] / "t.json")["effects"]
    lines = ran[1].stdout.splitlines()
    (line,) = [line for line in lines if f"{truth.effects[0].site}  " in line and "->" in line]
    assert one["covariates"][0] in line


def test_what_is_no_likelier_than_all_else_that_it_may_be_has_no_name(ran, capsys) -> None:
    found = ran[2]
    (one,) = found.found
    other = dataclasses.replace(one.effect, location=dataclasses.replace(one.effect.location, site="J2"))
    rarely = dataclasses.replace(one, probability=0.45, credible=((other, 0.48),))
    doubted = dataclasses.replace(found, found=(rarely,))
    said, own = " ".join(further(doubted)), called(one.effect)
    assert f"Not settled: {called(other)} (48%) and {own} (45%). The arm has {own}." in said
    assert headline(doubted) == "Something is missing whose cause these data do not settle."
    print_trace(doubted)
    told = capsys.readouterr().out
    assert "Effects identified" not in told and "In the arm, but not settled" in told and " mrad" in told
    assert [each["named"] for report in (doubted, found) for each in as_json(report)["effects"]] == [False, True]
    assert headline(found).startswith("Identified: ") and "Not settled" not in " ".join(further(found))
    tie, lead = (
        dataclasses.replace(one, probability=share, credible=((other, 0.999 - share),)) for share in (0.502, 0.6)
    )
    assert lead.is_named and not tie.is_named  # of two that are exchangeable another draw gives either
    assert headline(dataclasses.replace(found, found=(tie,))) == headline(doubted)


def test_a_mass_is_of_the_link_that_the_joint_before_moves(ran) -> None:
    found = ran[2]
    before, joint = found.state.fit.setup.arm.robot.moving[2:4]
    mass = Effect(CATALOGUE["link_mass"], Location(f"link:{joint.name}"), (5.0, 0.0, 0.0, 0.0))
    said = further(dataclasses.replace(found, found=(dataclasses.replace(found.found[0], effect=mass),)))
    assert any(f"is of the link {joint.parent}, which {before.name} moves. Its declared mass:" in text for text in said)


def test_what_no_row_determines_by_itself_has_no_name(ran) -> None:
    found = ran[2]
    (one,) = found.found
    assert one.determined and one.is_named
    open_ = dataclasses.replace(found, found=(dataclasses.replace(one, determined=False),))
    assert "of which these rows determine no value by itself." in " ".join(further(open_))
    assert "Identified" not in headline(open_) and as_json(open_)["effects"][0]["named"] is False


def test_a_unit_of_a_column_is_one_of_that_column(ran, capsys) -> None:
    found = ran[2]
    place = Location("J2", "ry", ("hours",), (0, 1))
    effect, std = Effect(EVERY["unnamed_line"], place, (1e-4, 1e-6, 3.0)), {"slope": 1e-5, "curvature": 1e-7}
    line = dataclasses.replace(found.found[0], effect=effect, std=std)
    other = dataclasses.replace(found, found=(line,))
    units = [value["unit"] for value in as_json(other)["effects"][0]["parameters"].values()]
    assert units[:2] == ["rad per unit of hours", "rad per unit of hours^2"]
    print_trace(other)
    assert "mrad per unit of hours and curvature 1.00 ± 0.10 µrad per unit of hours²" in " ".join(
        capsys.readouterr().out.split()
    )


def test_suspects_are_all_that_compete(ran) -> None:
    told = strict_json(ran[0] / "t.json")
    (one,) = told["effects"]
    assert told["suspects"][0] == {key: one[key] for key in told["suspects"][0]}
    chances = [each["probability"] for each in told["suspects"]]
    assert chances == sorted(chances, reverse=True) and min(chances) >= 0.01
    assert told["nuisances"] == [] and told["resampled"]["mismatch"] >= 1.0


def test_held_out_errors_are_of_what_was_chosen_without_the_poses(ran) -> None:
    found, said = ran[2], strict_json(ran[0] / "t.json")
    assert said["held_out_rms_mm"]["after"] == pytest.approx(1e3 * max(found.compared.after, found.held_out_after))
    assert "without the held-out poses" in said["held_out_is_of"] and said["undecided"] is None
    assert next(family["family"] for family in said["families"]) == "play by approach"


def test_the_summary_fits_a_screen_and_the_steps_go_to_stderr(ran) -> None:
    result = ran[1]
    lines = result.stdout.splitlines()
    assert len(lines) <= 24 and not any("[" in line and "mm]" in line for line in lines)
    for said in ("calibrated", "backlash", "±", "rad", "->", "Probability: ", "traced.toml"):
        assert said in result.stdout
    assert "calibrating" in result.stderr and "calibrating" not in result.stdout


def test_the_written_arm_predicts_rows_that_were_not_used(ran, truth: Truth) -> None:
    arm = quietly(ran[0] / "traced.toml")
    test = read_measurements(truth.test, arm)
    there = predict(arm, test)
    error = np.linalg.norm((there.position - truth.clean)[test.measured], axis=1)
    assert np.sqrt((error**2).mean()) < 0.5e-3 * np.sqrt(3.0) * 0.5


def test_the_written_arm_says_which_of_its_effects_are_named(ran) -> None:
    report = strict_json(ran[0] / "t.json")
    named = [line for line in (ran[0] / "traced.toml").read_text().splitlines() if "# named, " in line]
    assert [line.split('"')[1] for line in named] == [one["effect"] for one in report["effects"] if one["named"]]


def test_what_was_fitted_is_uncertain_in_deflect_and_check_too(ran, armflex: Run) -> None:
    arm = quietly(ran[0] / "traced.toml")
    certain, q, known = without_declared_uncertainty(arm), arm.position(J2=0.3), {}
    site = arm.effects[0].location.site
    known[f"approach_{site}"] = 1.0
    given = ["--covariates", f"approach_{site}=1"]
    said = fine(armflex("deflect", ran[0] / "traced.toml", "--q", "J2=0.3", *given, "--json", ran[0] / "d.json"))
    laws = certain.deflection(q, covariates=known).covariance
    expected, _ = tip_covariance(certain, q[None], ("none",), known, None if laws is None else laws[None])
    told = np.array(strict_json(ran[0] / "d.json")["covariance"])
    np.testing.assert_allclose(told, expected[0], rtol=1e-7, atol=1e-18)
    assert (np.diag(told) > (0.0 if laws is None else np.diag(laws))).all()
    assert "The rest is where base, zero of the first joint and target stand" in " ".join(said.stdout.split())
    (line,) = (line for line in said.stdout.splitlines() if line.split()[:1] == ["z"])
    assert f"{np.sqrt(told[2, 2]) * 1e3:.2g}" in line.split()
    rows = "\n".join(f"{t},0,{0.3 + 1e-9 * t},0,0,0,0,v{t}" for t in (0, 1))
    (ran[0] / "t.csv").write_text(f"time,{','.join(f'q_J{i}' for i in range(1, 7))},via\n{rows}\n")
    told_sigma = ["--tolerance", "1m", *given, "--json", ran[0] / "c.json"]
    fine(armflex("check", ran[0] / "traced.toml", ran[0] / "t.csv", *told_sigma))
    shift = certain.deflection(q, covariates=known).displacement[:3]
    along = shift / np.linalg.norm(shift)
    point = strict_json(ran[0] / "c.json")["via_points"][0]
    assert point["sigma_m"] == pytest.approx(np.sqrt(along @ told[:3, :3] @ along), rel=1e-5)


def test_advice_is_cut_and_counted(ran, capsys: pytest.CaptureFixture) -> None:
    advice = tuple(f"advice {i}" for i in range(11))
    print_trace(dataclasses.replace(ran[2], next_measurement=advice))
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line.startswith("Next: ")] == [f"Next: {text}" for text in advice[:3]]
    assert "8 further measurements are proposed in the files of --report and --json." in lines
    assert as_json(dataclasses.replace(ran[2], next_measurement=advice))["next_measurement"] == list(advice)
    for count in (3, 4):  # one more is no longer than the line that would count it
        print_trace(dataclasses.replace(ran[2], next_measurement=advice[:count]))
        out = capsys.readouterr().out
        assert out.count("Next: ") == count and "further measurements" not in out


def test_points_are_those_of_the_campaign(ran, truth: Truth) -> None:
    folder = ran[0]
    assert "measurements_sha256" in (folder / "traced.toml").read_text()
    plain = quietly(truth.arm)
    joined = read_measurements(folder / "m.csv", plain, points=read_points(folder / "points.txt", frame="World"))
    np.testing.assert_allclose(joined.position, read_measurements(truth.train, plain).position, atol=1e-11)


def test_what_is_unexplained_and_nothing_missing_are_said(ran, capsys: pytest.CaptureFixture) -> None:
    found = ran[2]
    left = Unexplained("link:J3", "ry", 1.5e-4, "rad", 3.2e-4)
    told = as_json(dataclasses.replace(found, found=(), unexplained=left))
    assert told["unexplained"] == {
        "site": "J3", "axis": "ry", "std": 1.5e-4, "unit": "rad", "rms_mm": pytest.approx(0.32), "covariates": []
    }  # fmt: skip
    print_trace(dataclasses.replace(found, found=(), unexplained=left))
    said = " ".join(capsys.readouterr().out.split())
    assert "a change of 0.15 mrad from pose to pose at the link ending at J3 (ry)" in said
    assert "No further effect" not in said
    print_trace(dataclasses.replace(found, found=(), unexplained=None))
    said = " ".join(capsys.readouterr().out.split())
    assert "No further effect is observable in this campaign." in said and "The smallest effect that" in said
    json.dumps(told, allow_nan=False)


BAD = {
    "a URDF": (["robot.urdf", "m.csv", "-o", "o.toml"], "trace needs an arm.toml"),
    "no output": (["arm.toml", "m.csv"], "missing option '-o'"),
    "units of nothing": (["arm.toml", "m.csv", "-o", "o.toml", "--points-unit", "mm"], "need --points"),
    "no such points": (["arm.toml", "m.csv", "-o", "o.toml", "--points", "none.txt"], "none.txt: cannot be read"),
    "an input": (["arm.toml", "m.csv", "-o", "arm.toml"], "is an input of this command"),
    "a page over an input": (["arm.toml", "m.csv", "-o", "o.toml", "--report", "m.csv"], "is an input of this command"),
    "the arm for a page": (["arm.toml", "m.csv", "-o", "o.toml", "--report", "o.toml"], "are the same file o.toml"),
    "no folder": (["arm.toml", "m.csv", "-o", "o.toml", "--report", "none/r.html"], "folder none"),
}


@pytest.mark.parametrize(("arguments", "complaint"), BAD.values(), ids=BAD)
def test_bad_input_is_refused_before_anything_is_computed(
    armflex: Run, truth: Truth, tmp_path: Path, arguments: list, complaint: str
) -> None:
    (tmp_path / "arm.toml").write_text(truth.arm.read_text())
    (tmp_path / "m.csv").write_bytes(truth.train.read_bytes())
    before = sorted(path.name for path in tmp_path.iterdir())
    result = fine(armflex("trace", *arguments), 2)
    assert complaint in result.stderr and "searching" not in result.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_a_calibrated_arm_is_not_fitted_again(ran, armflex: Run, truth: Truth) -> None:
    for command in ("trace", "calibrate"):
        result = fine(armflex(command, ran[0] / "traced.toml", truth.train, "-o", "o.toml"), 2)
        assert "is calibrated already" in result.stderr
