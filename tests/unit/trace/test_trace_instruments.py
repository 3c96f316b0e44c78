"""Traces of campaigns that wires, levels and encoders read, beside a tracker or without; small draws of the studies."""

import re
from pathlib import Path

import numpy as np
import pytest
from studies.instruments import PAIRS, one_of_a_pair, wires
from support.command_line import fine, run_here, strict_json
from support.instruments import LEVEL, TARGET, WIRE, Machine, heavy, measured

from armflex import calibrate, load_arm, predict, read_measurements

pytestmark = pytest.mark.slow

GAP = 6e-4


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign of one wire and one level on a machine with play in J2, and what `trace` makes of it."""
    return with_play(tmp_path_factory.mktemp("traced"), (WIRE, LEVEL), "--report", "r.html")


def with_play(folder: Path, instruments: tuple[str, ...], *more: str) -> Path:
    arm = heavy(folder, *instruments)
    machine = Machine.draw(arm, 3)
    rows = machine.rows(60)
    rows.approach = machine.rng.choice([-1.0, 1.0], rows.q.shape)
    rows.time = 300.0 * np.arange(60)

    def play(state, push) -> None:
        push.motion[:, 1] += 0.5 * GAP * state.rows.approach[:, 1, None] * machine.plant.joints[1].drive

    sides = {f"approach_J{i + 1}": side.astype(int) for i, side in enumerate(rows.approach.T)}
    measured(machine, arm, rows, folder / "rows.csv", None, (play,), time=rows.time, **sides)
    fine(run_here(folder, "trace", "arm.toml", "rows.csv", "-o", "traced.toml", "--json", "t.json", *more))
    return folder


def test_an_effect_is_found_by_a_wire_and_a_level(folder: Path) -> None:
    (found,) = strict_json(folder / "t.json")["effects"]
    assert (found["effect"], found["site"]) == ("backlash", "J2")
    gap = found["parameters"]["gap"]
    assert abs(gap["value"] - GAP) < 4.0 * gap["std"] < 0.1 * GAP
    arm = load_arm(folder / "traced.toml")
    rows = read_measurements(folder / "rows.csv", arm)
    for kind, _ in predict(arm, rows).sensors:
        read = rows.readings.of(type(kind), kind.name)
        assert read is not None
        assert np.sqrt((((read.values - kind.values) / read.sigma) ** 2).mean()) < 1.2, kind.title


def test_the_report_has_a_panel_for_every_instrument_in_its_own_unit(folder: Path) -> None:
    page = (folder / "r.html").read_text()
    panels = re.findall(r"(\w+) \((\w+)\): RMS ([\d.]+) before, ([\d.]+) after, noise ([\d.]+) (\w+)", page)
    assert [(name, kind, unit) for name, kind, *_, unit in panels] == [
        ("wire1", "distance", "mm"),
        ("level3", "inclination", "mrad"),
    ]
    for _, _, before, after, noise, _ in panels:
        assert float(before) > 3.0 * float(after) and 0.5 < float(after) / float(noise) < 1.3
    assert "RMS of a reading" in page and "Residual arrows" not in page


def test_a_page_of_levels_alone_says_milliradians(folder: Path, tmp_path: Path) -> None:
    """Wires left out: no figure of an error is in millimetres."""
    text = (folder / "arm.toml").read_text()
    (tmp_path / "arm.toml").write_text(text.replace(WIRE, ""))
    header, *rows = ([*line.split(",")] for line in (folder / "rows.csv").read_text().splitlines())
    keep = [i for i, name in enumerate(header) if not name.startswith("wire1")]
    for row in (7, 31):  # two glitches, which are listed
        rows[row][header.index("level3_x_deg")] = "3.0"
    lines = [",".join(line[i] for i in keep) for line in [header, *rows]]
    (tmp_path / "rows.csv").write_text("\n".join(lines) + "\n")
    files = ("-o", "traced.toml", "--report", "r.html", "--json", "t.json")
    done = fine(run_here(tmp_path, "trace", "arm.toml", "rows.csv", *files))
    assert "all rows mrad" in done.stdout and "mm" not in done.stdout.partition("Next:")[0]
    assert "at the target" not in done.stdout and "RMS of the norm of the error of level3 (inclination)" in done.stdout
    told = strict_json(tmp_path / "t.json")
    assert told["unit"] == "rad" and told["rms"]["after"] == pytest.approx(1e-3 * told["rms_mm"]["after"])
    assert told["held_out_rms"].keys() == told["held_out_rms_mm"].keys() and told["noise_rms"] < 1e-4
    assert {one["row"] for one in told["outliers"]} == {7, 31}
    assert all(one["unit"] == "rad" and one["error"] > 0.01 for one in told["outliers"])
    files = ("-o", "c.toml", "--json", "c.json", "--report", "c.html")
    fine(run_here(tmp_path, "calibrate", "arm.toml", "rows.csv", *files))
    assert re.search(
        r"Norm of the error of level3 \(inclination\): [\d.]+ mrad as decl", (tmp_path / "c.html").read_text()
    )
    fitted = strict_json(tmp_path / "c.json")
    assert fitted["unit"] == "rad" and fitted["rms_mm"] is None
    assert fitted["rms"]["calibrated"] == pytest.approx(told["rms"]["calibrated"], rel=0.5)
    page = (tmp_path / "r.html").read_text()
    lead = re.findall(r"Error on held-out poses: ([^<]*)\(", page)[0]
    assert "mrad" in lead and "mm" not in lead and "poses held out [mrad]" in page
    body = page.partition("<body")[2].partition("<h2>What to measure next")[0]
    assert not re.search(r"(\d|\[)\s?mm\b", body) and "Error of a reading" in body and "3-D" not in body
    assert "best to worst place [mrad]" in page and len(re.findall(r"<td>[\d.]+ mrad</td><td>lost beam", page)) == 2


def test_an_error_is_the_same_in_every_figure_where_several_instruments_read_lengths(tmp_path: Path) -> None:
    """A wire reads one number and each target three: in folds, held out and fitted, a reading counts once."""
    other = TARGET.replace("smr2", "smr3").replace("[0.0, 0.3, 0.05]", "[0.3, 0.0, 0.1]")
    said = strict_json(with_play(tmp_path, (WIRE, TARGET, other)) / "t.json")
    (found,) = said["effects"]
    for stage, own in (("calibrated", "before"), ("after", "after")):
        again, linear = said["held_out_rms_mm"][stage], found["held_out_rms_mm"][own]
        assert again == pytest.approx(linear, rel=0.15)
    assert said["held_out_rms_mm"]["after"] == pytest.approx(said["rms_mm"]["after"], rel=0.25)
    arm = load_arm(tmp_path / "arm.toml")
    fitted = calibrate(arm, tmp_path / "rows.csv")
    sizes = [calibrated for _, _, calibrated, _ in fitted.by_kind]
    assert fitted.rms == pytest.approx(np.sqrt(np.mean(np.square(sizes))))


def test_what_no_tip_reading_tells_is_told_by_what_plan_mounts(tmp_path: Path) -> None:
    """A machine of the study: both effects are a class, a wire or a level is named, and with it the truth is alone."""
    one = one_of_a_pair(tmp_path, list(PAIRS)[1], 1)
    assert one.first == "class" and one.advised and one.told and one.without < 1.0, one.text


def test_a_wire_and_a_level_are_as_good_as_a_tracker(tmp_path: Path) -> None:
    found = wires(tmp_path, 2)
    assert found["coverage"] > 0.85 and found["ratio"] < 1.5
    assert found["not_told_by_a_wire"] > 5
