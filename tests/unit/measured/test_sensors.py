"""Campaigns of wires, levels, accelerometers and further targets, from the files to what is predicted; bad input."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.instruments import ACCELERATION, CAMERA, ENCODER, LEVEL, TARGET, WIRE, Machine, heavy, in_base, measured

from armflex import Reading, Tracker, calibrate, load_arm, plan, predict, read_measurements
from armflex.conventions import TWIST_NAMES
from armflex.errors import ArmFileError, ConventionError, InputError, TableError, UnknownNameError
from armflex.estimate import Calibration
from armflex.plan.drive import write_plan
from armflex.plan.instruments import declaration

EVERY = (WIRE, LEVEL, ACCELERATION, ENCODER, CAMERA)


def campaign(folder: Path, *instruments: str, seed: int = 1, count: int = 60, **given) -> tuple[Machine, Path, Path]:
    arm = heavy(folder, *instruments)
    arm.write_text(in_base(arm.read_text()))
    machine = Machine.draw(arm, seed)
    return machine, arm, measured(machine, arm, machine.rows(count), folder / "rows.csv", **given)


def fitted(arm: Path, rows: Path, **given) -> Calibration:
    loaded = load_arm(arm)
    return calibrate(loaded, read_measurements(rows, loaded), **given)


def rewritten(file: Path, change) -> Path:
    """Return a campaign whose columns were changed, as lists of text by header."""
    lines = [line.split(",") for line in file.read_text().splitlines()]
    columns = {name: [line[i] for line in lines[1:]] for i, name in enumerate(lines[0])}
    columns = change(columns) or columns
    rows = zip(*columns.values(), strict=True)
    other = file.with_name("other.csv")
    other.write_text("\n".join([",".join(columns), *(",".join(row) for row in rows)]) + "\n")
    return other


def test_every_kind_is_fitted_to_written_and_predicted(tmp_path: Path) -> None:
    """No x y z at all: nuisances and compliances are found within their uncertainty, and other rows are predicted."""
    machine, arm, rows = campaign(tmp_path, *EVERY)
    found = fitted(arm, rows)
    assert found.scatter == pytest.approx(1.0, abs=0.15) and not found.flags and found.declared_rms > 3.0 * found.rms
    # Everything that was drawn, in standard deviations.
    off = []
    for parameter in found.parameters:
        name = (parameter.which.name or "").split(" ")
        if parameter.which.group.kind == "sensor":
            axis = {"x": 0, "y": 1, "z": 2, "rx": 0, "ry": 1, "rz": 2}.get(name[-1], 0)
            truth = machine.off[str(parameter.which.group.of)][name[0]][axis]
        elif parameter.which.group.kind == "compliance":
            joint = [one.name for one in machine.plant.joints].index(str(parameter.which.group.of))
            truth = machine.factors[joint, TWIST_NAMES.index(name[0])]
        else:
            truth = machine.plant.offset[str(parameter.which.group.of)]
        off.append((parameter.value - truth) / parameter.std)
    assert np.sqrt(np.mean(np.square(off))) < 1.3 and np.abs(off).max() < 4.5
    told = [p.name for p in found.parameters if p.std < 0.2 * p.prior]
    assert {"sensor wire1 length_offset", "sensor level3 bias y"} & set(told) and "compliance J2 ry" in told
    # Written, read, and asked about rows that it has not seen: as the instruments then read.
    saved = load_arm(found.write(tmp_path / "fitted.toml"))
    for name, sensor in found.arm.sensors.items():
        np.testing.assert_allclose(saved.sensors[name].found[""], sensor.found[""], rtol=1e-12)
    assert saved.certainty is not None and found.arm.certainty is not None
    np.testing.assert_allclose(saved.certainty.covariance, found.arm.certainty.covariance, rtol=1e-6, atol=1e-15)
    other = measured(machine, arm, machine.rows(40), tmp_path / "more.csv")
    asked = read_measurements(other, saved)
    foretold = predict(saved, asked)
    for kind, std in foretold.sensors:
        read = asked.readings.of(type(kind), kind.name)
        assert read is not None and std is not None
        whitened = (read.values - kind.values) / np.hypot(read.sigma, std)
        assert 0.7 < np.sqrt((whitened**2).mean()) < 1.35, kind.title


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:partly_certain:armflex.ArmflexWarning")
def test_what_a_declared_compliance_is_uncertain_by_is_in_what_sensors_will_read(tmp_path: Path) -> None:
    """As `relative_std` has it: arms drawn so read that far apart, by a level on a link and by a target on the tip."""
    target = TARGET.replace("point = [0.0, 0.3, 0.05]", "").replace("point_std = 1e-3\n", "")
    _, arm, rows = campaign(tmp_path, LEVEL, target, count=6)
    text = arm.read_text()
    own = text.partition("[flexure.J2]")[2].partition("\n[")[0]
    read = []
    arm.write_text(text.replace(own, own + "\nrelative_std = 0.1\n"))
    loaded = load_arm(arm)
    foretold = predict(loaded, read_measurements(rows, loaded))
    law = loaded.flexures[1].law
    for factors in np.random.default_rng(3).normal(0.0, 0.1, (60, 6)):
        root = np.diag(1.0 + 0.5 * factors)
        softer = replace(loaded.flexures[1], law=replace(law, compliance=root @ law.compliance @ root))
        other = replace(loaded, flexures=(loaded.flexures[0], softer, *loaded.flexures[2:]))
        read.append([kind.values for kind, _ in predict(other, read_measurements(rows, loaded)).sensors])
    for number, (kind, std) in enumerate(foretold.sensors):
        spread = np.std([one[number] for one in read], axis=0)
        assert std is not None and spread.max() > 1e-6, kind.title
        np.testing.assert_allclose(std, spread, rtol=0.35, atol=0.05 * spread.max())
    smr = next(std for kind, std in foretold.sensors if kind.name == "smr2")
    np.testing.assert_allclose(smr, foretold.sigma, rtol=1e-3)  # the same point by another name


def test_sensors_beside_a_tracker_make_it_more_certain(tmp_path: Path) -> None:
    _, arm, rows = campaign(tmp_path, LEVEL, tracker=1e-4)
    both = fitted(arm, rows)
    without = rewritten(rows, lambda columns: [columns.pop(f"level3_{axis}_deg") for axis in "xy"] and None)
    alone = fitted(arm, without)
    assert any(flag.code == "instrument_unread" for flag in read_measurements(without, load_arm(arm)).flags)
    stds = [{p.name: p.std for p in one.parameters if p.which.group.moves} for one in (both, alone)]
    assert min(stds[0][name] / std for name, std in stds[1].items()) < 0.5
    assert max(stds[0][name] / std for name, std in stds[1].items()) < 1.1


def test_lost_readings_are_in_no_headline(tmp_path: Path) -> None:
    """A wire that read 9999 and 0 mm: the fit survives, and figures and flags are about the others."""
    _, arm, rows = campaign(tmp_path, WIRE, LEVEL)

    def change(columns: dict[str, list[str]]) -> None:
        columns["wire1_mm"][5], columns["wire1_mm"][15] = "9999", "0"

    whole, found = fitted(arm, rows), fitted(arm, rewritten(rows, change))
    assert found.left_out == 2 and len(found.outliers) == 2
    assert found.rms == pytest.approx(found.noise_rms, rel=0.3)
    assert found.declared_rms == pytest.approx(whole.declared_rms, rel=0.3)
    assert found.held_out and whole.held_out and found.held_out[1] < 1.5 * whole.held_out[1]
    assert [flag.code for flag in found.flags] == [flag.code for flag in whole.flags]


def test_rows_with_some_instruments_only_and_their_own_sigma(tmp_path: Path) -> None:
    """Each row counts for what it read; a wire that was lost spoils neither the level in its row nor the fit."""
    _, arm, rows = campaign(tmp_path, WIRE, LEVEL)

    def change(columns: dict[str, list[str]]) -> None:
        columns["wire1_mm"][:20] = [""] * 20
        columns["level3_x_deg"][20:30], columns["level3_y_deg"][20:30] = [""] * 10, [""] * 10
        columns["wire1_mm"][40] = str(float(columns["wire1_mm"][40]) + 30.0)
        columns["sigma_wire1_mm"] = ["0.1"] * 60

    found = fitted(arm, rewritten(rows, change))
    wire = found.fit.view.readings.kinds[0]
    assert np.isfinite(wire.sigma).sum() == 40 and found.fit.view.count == 40 + 2 * 50
    np.testing.assert_allclose(wire.sigma[np.isfinite(wire.sigma)], 1e-4)
    assert [(one.row, one.instrument) for one in found.outliers] == [(40, "wire1")]
    np.testing.assert_array_equal(found.fit.weights[40] < 0.1, [True, False, False])
    assert found.outliers[0].error_m == pytest.approx(0.03, rel=0.05)


def test_two_targets_give_the_orientation(tmp_path: Path) -> None:
    """A second target on the tool tells what rx ry rz of the first would."""
    from scipy.spatial.transform import Rotation

    other = TARGET.replace("smr2", "smr3").replace("[0.0, 0.3, 0.05]", "[0.3, 0.0, 0.1]")
    machine, arm, rows = campaign(tmp_path, TARGET, other, tracker=2e-5)
    two, sigma = fitted(arm, rows), 2e-5 / 0.3
    machine.rng = np.random.default_rng(1)
    state = machine.plant.relax(Machine.draw(arm, 1).rows(60))
    turned = Rotation.from_matrix(state.frames[:, -1, :3, :3])
    noise = Rotation.from_rotvec(machine.rng.normal(0.0, sigma, (60, 3)))
    vectors = (noise * turned).as_rotvec()

    def change(columns: dict[str, list[str]]) -> dict[str, list[str]]:
        kept = {name: cells for name, cells in columns.items() if not name.startswith("smr")}
        kept |= {f"r{axis}": [repr(float(v)) for v in vectors[:, i]] for i, axis in enumerate("xyz")}
        return kept | {"sigma_r": [repr(sigma)] * 60}

    plain = arm.with_name("plain.toml")
    plain.write_text(arm.read_text().partition("\n[instrument.")[0])
    six = fitted(plain, rewritten(rows, change))
    values = [{p.name: p for p in one.parameters if p.which.group.moves} for one in (two, six)]
    for name, one in values[1].items():
        same = values[0][name]
        assert abs(same.value - one.value) < 4.0 * np.hypot(same.std, one.std), name
        assert 0.5 < same.std / one.std < 2.0, name


@pytest.mark.slow
def test_a_new_session_is_a_new_place(tmp_path: Path) -> None:
    """A wire that was set up again is found again; one that was moved without a word is suspected by name and row."""
    _, arm, rows = campaign(tmp_path, WIRE, LEVEL, session=["one"] * 30 + ["two"] * 30)

    def shifted(columns: dict[str, list[str]]) -> None:
        columns["wire1_mm"][30:] = [str(float(cell) + 8.0) for cell in columns["wire1_mm"][30:]]

    told = fitted(arm, rewritten(rows, shifted))
    offsets = [told.arm.sensors["wire1"].of("length_offset", [name])[0, 0] for name in ("one", "two")]
    assert offsets[1] - offsets[0] == pytest.approx(8e-3, abs=5e-4)
    assert not any(flag.code == "instrument_moved" for flag in told.flags)

    def silent(columns: dict[str, list[str]]) -> None:
        shifted(columns)
        del columns["session"]

    untold = fitted(arm, rewritten(rows, silent))
    flag = next(flag for flag in untold.flags if flag.code == "instrument_moved")
    assert "wire1 (distance)" in flag.text and "other.csv:3" in flag.text
    quiet = fitted(arm, rewritten(rows, lambda columns: columns.pop("session") and None))
    assert not any(flag.code == "instrument_moved" for flag in quiet.flags)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("instruments", "change", "said"),
    [
        (WIRE.replace("1.6, -1.2, 0.3", "-1.6, 1.2, 0.3"), None, "fit .* times better from an anchor at"),
        (WIRE, "wire1_mm wire1", "in mm, not m"),
        (LEVEL, "level3_x_deg level3_y_deg", "x and y swapped"),
        (LEVEL, "level3_x_deg level3_x level3_y_deg level3_y", "better in degrees"),
        (ACCELERATION.replace("specific_force", "gravity"), None, 'write reads = "specific_force"'),
    ],
)
def test_conventions_of_sensors_are_named(tmp_path: Path, instruments: str, change: str | None, said: str) -> None:
    kind = next(one for one in (WIRE, LEVEL, ACCELERATION) if one.split("]")[0] == instruments.split("]")[0])
    _, arm, rows = campaign(tmp_path, kind)
    arm.write_text(arm.read_text().replace(kind, instruments))
    if change and len(change.split()) == 2 and "level" in change:
        one, two = change.split()
        rows = rewritten(
            rows, lambda columns: {{one: two, two: one}.get(name, name): cells for name, cells in columns.items()}
        )
    elif change:
        words = change.split()
        names = dict(zip(words[::2], words[1::2], strict=True))
        rows = rewritten(rows, lambda columns: {names.get(name, name): cells for name, cells in columns.items()})
    with pytest.raises(ConventionError, match=said):
        fitted(arm, rows)


def _swap(one: str, other: str):
    return lambda columns: {{one: other, other: one}.get(name, name): cells for name, cells in columns.items()}


def _times(name: str, factor: float, shift: float = 0.0):
    def change(columns: dict[str, list[str]]) -> None:
        columns[name] = [repr(factor * float(cell) + shift) for cell in columns[name]]

    return change


def _late(columns: dict[str, list[str]]) -> None:
    columns["wire1_mm"] = columns["wire1_mm"][-1:] + columns["wire1_mm"][:-1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("instruments", "count"), [((WIRE,), 60), ((LEVEL,), 60), ((ACCELERATION,), 60), ((WIRE, LEVEL), 40)]
)
def test_a_campaign_as_it_was_written_is_not_suspected(
    tmp_path: Path, instruments: tuple[str, ...], count: int
) -> None:
    _, arm, rows = campaign(tmp_path, *instruments, count=count)
    assert not fitted(arm, rows).flags


@pytest.mark.slow
@pytest.mark.parametrize(
    ("instruments", "change", "said"),
    [
        ((WIRE,), _swap("q_J2", "q_J3"), "columns q_J2 and q_J3 are exchanged"),
        ((WIRE,), _times("q_J2", -1.0), "sign of q_J2 is turned"),
        ((WIRE,), _times("q_J3", 1.0, -0.5 * np.pi), r"home position of J3 is \+90 degrees"),
        ((WIRE,), _late, "readings are those of the row (before|after)"),
        ((WIRE, LEVEL), _times("q_J5", -1.0), "sign of q_J5 is turned"),
        ((LEVEL,), _times("q_J3", -1.0), "sign of q_J3 is turned"),
    ],
)
def test_conventions_of_joints_are_named_without_positions(tmp_path: Path, instruments, change, said: str) -> None:
    """Nobody but a wire or a level looks: what the columns mean is asked all the same."""
    _, arm, rows = campaign(tmp_path, *instruments, count=40)
    with pytest.raises(ConventionError, match=said):
        fitted(arm, rewritten(rows, change))


def _thousandth(columns: dict[str, list[str]]) -> None:
    _times("wire1_mm", 1e-3)(columns)


def _in_radians(columns: dict[str, list[str]]) -> None:
    for name in ("level3_x_deg", "level3_y_deg"):
        columns[name] = [repr(float(np.radians(float(cell)))) for cell in columns[name]]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("instrument", "wrong", "change", "said"),
    [
        (WIRE, ("anchor_std = ", "anchor_std = 0.3 #"), _thousandth, "better in m, not mm"),
        (LEVEL, ("", ""), _in_radians, "better in rad, not degrees"),
        (LEVEL, ('link = "link3"', 'link = "link2"'), None, "is on 'link3'"),
        (ACCELERATION, ("", ""), "exchanged", "better with x and y swapped"),
    ],
)
def test_units_axes_and_links_of_every_kind_are_tried(tmp_path: Path, instrument, wrong, change, said: str) -> None:
    _, arm, rows = campaign(tmp_path, instrument)
    assert not wrong[0] or wrong[0] in arm.read_text()
    arm.write_text(arm.read_text().replace(*wrong) if wrong[0] else arm.read_text())
    if change == "exchanged":
        axes = [name for name in rows.read_text().splitlines()[0].split(",") if name.startswith("acc")]
        change = _swap(axes[0], axes[1])
    with pytest.raises(ConventionError, match=said):
        fitted(arm, rewritten(rows, change) if change else rows)


@pytest.mark.slow
def test_a_standard_deviation_that_is_wrong_is_that_of_one_instrument(tmp_path: Path) -> None:
    """It neither makes the other count less nor passes for a sensor that was moved."""
    _, arm, rows = campaign(tmp_path, WIRE, LEVEL)
    right, text = fitted(arm, rows), arm.read_text()
    place = text.index("sigma = ", text.index("[instrument.level3]"))
    stated = text[place:].splitlines()[0]
    for factor in (0.02, 100.0):
        other = f"sigma = {factor * float(stated.split('=')[1])}"
        arm.write_text(text[:place] + text[place:].replace(stated, other, 1))
        wrong = fitted(arm, rows)
        flags = {flag.code: flag.text for flag in wrong.flags}
        assert "level3 (inclination): its sigma is" in flags["sigma_implausible"]
        assert "instrument_moved" not in flags
        if factor < 1.0:
            assert wrong.fit.factors[0] == 1.0 and wrong.fit.factors[1] > 25.0
            assert wrong.fit.posterior.std == pytest.approx(right.fit.posterior.std, rel=0.3)


def _in_mm(columns: dict[str, list[str]]) -> dict[str, list[str]]:
    for name in ("ta_x", "ta_y", "ta_z"):
        _times(name, 1e3)(columns)
    return {(f"{name}_m" if name.startswith("ta_") else name): cells for name, cells in columns.items()}


def _one_for_the_other(columns: dict[str, list[str]]) -> dict[str, list[str]]:
    other = {"ta": "tb", "tb": "ta"}
    return {other.get(name[:2], name[:2]) + name[2:]: cells for name, cells in columns.items()}


TWO_TARGETS = tuple(
    TARGET.replace("smr2", name).replace("0.3, 0.05", y) for name, y in (("ta", "0.3, 0.05"), ("tb", "-0.25, 0.1"))
)
TWO_LEVELS = tuple(
    LEVEL.replace("level3", name).replace("link3", on) for name, on in (("ta", "link3"), ("tb", "link5"))
)


@pytest.mark.parametrize(
    ("instruments", "change", "said"),
    [
        (TWO_LEVELS, _one_for_the_other, "columns of ta and those of tb are exchanged"),
        (TWO_TARGETS, _one_for_the_other, "columns of ta and those of tb are exchanged"),
        (TWO_TARGETS, _in_mm, "better in mm, not m"),
    ],
    ids=["levels", "targets", "mm"],
)
def test_one_of_two_instruments_in_other_units_and_two_exchanged_are_named(tmp_path, instruments, change, said) -> None:
    _, arm, rows = campaign(tmp_path, *instruments, count=30)
    assert not fitted(arm, rows).flags
    with pytest.raises(ConventionError, match=said):
        fitted(arm, rewritten(rows, change))


def test_values_absurdly_far_from_their_priors_are_flagged(tmp_path: Path) -> None:
    """Offsets of a milliradian under a prior of a microradian: priors are wrong, or something else is."""
    _, arm, rows = campaign(tmp_path, tracker=2e-5)
    right = fitted(arm, rows)
    assert not any(flag.code == "beyond_priors" for flag in right.flags)
    arm.write_text(arm.read_text().replace("joint_offset = 1e-3", "joint_offset = 1e-6"))
    wrong = fitted(arm, rows, anyway=True, as_stated=True)
    (flag,) = (flag for flag in wrong.flags if flag.code == "beyond_priors")
    far = sum(abs(one.pull) > 10.0 for one in wrong.parameters)
    assert far > 3 and flag.text.startswith(f"{far} values are absurdly far from what was declared (joint_offset J")
    assert re.search(r"joint_offset J\d by \d{2,4} prior standard deviations", flag.text)


def test_lost_beams_of_one_instrument_are_no_convention(tmp_path: Path) -> None:
    """A tenth of a wire's lengths is wrong by decimetres: each is an outlier of the wire, and nothing is suspected."""
    _, arm, rows = campaign(tmp_path, WIRE, LEVEL)
    lost = list(range(3, 60, 10))

    def glitched(columns: dict[str, list[str]]) -> None:
        cells = columns["wire1_mm"]
        columns["wire1_mm"] = [repr(float(cell) + 200.0 + i) if i in lost else cell for i, cell in enumerate(cells)]

    found = fitted(arm, rewritten(rows, glitched))
    assert sorted(one.row for one in found.outliers) == lost and {one.instrument for one in found.outliers} == {"wire1"}
    assert not found.flags and found.left_out == len(lost)
    right = fitted(arm, rows)
    off = [abs(one.value - same.value) / same.std for one, same in zip(found.parameters, right.parameters, strict=True)]
    assert max(off) < 5.0  # Huber's weights leave a bias of lost beams on one side


def test_what_no_row_reads_is_said(tmp_path: Path) -> None:
    _, arm, rows = campaign(tmp_path, WIRE, LEVEL, count=20)
    loaded = load_arm(arm)
    for change, said in (
        (lambda columns: columns.update(wire1_mm=[""] * 20), "its columns are empty in every row"),
        (lambda columns: columns.update(rope_mm=columns.pop("wire1_mm")), "did you mean 'rope_mm'?"),
    ):
        flags = read_measurements(rewritten(rows, change), loaded).flags
        assert any(flag.code == "instrument_unread" and said in flag.text for flag in flags)


@pytest.mark.slow
@pytest.mark.parametrize("anchor", ["[-1.6, -1.2, 0.3]", "[2.0, 2.0, 2.5]"])
def test_an_anchor_that_may_be_anywhere_is_found_from_the_lengths(tmp_path: Path, anchor: str) -> None:
    """Circles about points of one plane meet on both sides of it, and one of twenty lengths is of a lost wire."""
    machine, arm, rows = campaign(tmp_path, WIRE, count=40)
    truth = np.array([1.6, -1.2, 0.3]) + machine.off["wire1"]["anchor"]

    def spoilt(columns: dict[str, list[str]]) -> None:
        name = next(one for one in columns if one.startswith("wire1"))
        columns[name][::20] = [str(1.2 * float(one)) for one in columns[name][::20]]

    text = arm.read_text().replace("anchor = [1.6, -1.2, 0.3]", f"anchor = {anchor}")
    arm.write_text(
        text.replace("anchor_std = 0.01", "anchor_std = 2.0").replace("offset_std = 0.005", "offset_std = 0.1")
    )
    found = fitted(arm, rewritten(rows, spoilt)).arm.sensors["wire1"]
    assert np.linalg.norm(found.of("anchor", ("",))[0] - truth) < 5e-3
    assert found.of("length_offset", ("",))[0] == pytest.approx(machine.off["wire1"]["length_offset"], abs=3e-3)


def test_columns_and_instruments_go_together(tmp_path: Path) -> None:
    _, arm, rows = campaign(tmp_path, WIRE, LEVEL, count=20)
    loaded = load_arm(arm)
    for change, said in (
        (lambda columns: columns.update(wire2_mm=columns["wire1_mm"]), r"no \[instrument.wire2\], did you mean"),
        (lambda columns: columns.update(sigma_wires=columns["wire1_mm"]), r"sigma_wires"),
        (lambda columns: columns.pop("level3_y_deg") and None, "has no column 'level3_y'"),
        (lambda columns: columns.update(wire1_mm=["NaN", *columns["wire1_mm"][1:]]), "'NaN', .*: leave the cell empty"),
        (lambda columns: columns.update(level3_x_mm=columns.pop("level3_x_deg")), "'mm' is no unit of inclination"),
        (lambda columns: {name: own for name, own in columns.items() if name[0] not in "wl"}, "no column 'x', 'y'"),
    ):  # fmt: skip
        with pytest.raises(TableError, match=said):
            read_measurements(rewritten(rows, change), loaded)
    tilts = read_measurements(
        rewritten(rows, lambda columns: columns.update(tilt_x=["1"] * 20, tilt_y=["2"] * 20)), loaded
    )
    assert any(flag.code == "instrument_undeclared" and "[instrument.tilt]" in flag.text for flag in tilts.flags)
    columns = ("laser_mm", "incl_x_deg", "incl_y_deg", "temp_deg", "load_kg")
    others = read_measurements(rewritten(rows, lambda given: given.update(dict.fromkeys(columns, ["1"] * 20))), loaded)
    assert [flag.text for flag in others.flags if flag.code == "instrument_undeclared"] == [
        "column laser_mm is read as a covariate; [instrument.laser] would have it read the arm",
        "columns incl_x_deg, incl_y_deg are read as covariates; [instrument.incl] would have it read the arm",
    ]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (WIRE.replace('"distance"', '"distanze"'), "'distanze' is not known, did you mean 'distance'"),
        (WIRE.replace('"tool"', '"tol"'), r"\[instrument.wire1\] link: the arm has no link 'tol', did you mean 'tool'"),
        (WIRE.replace("[1.6, -1.2, 0.3]", "[1600, -1200, 300]"), "anchor: is 2.02e.03 m from the base.*millimetres"),
        (WIRE.replace("anchor = [1.6, -1.2, 0.3]\n", ""), r"needs 'anchor'.* write \[0, 0, 0\] and anchor_std = 2"),
        (WIRE + "bias_std = 1e-3\n", "bias_std: unknown key"),
        (WIRE.replace("sigma = 5e-5", "sigma = 50.0"), "sigma: expected one standard deviation"),
        (LEVEL.replace("mounting_std = 5e-3", "mounting_std = 45.0"), "mounting_std: expected a standard deviation"),
        (ENCODER.replace('"J2"', '"J9"'), "'J9' is not known"),
        (CAMERA.replace('seen_from = "link2"', 'seen_from = "tool"'), "'tool' is the link itself"),
    ],
)
def test_what_is_declared_wrongly_is_named(tmp_path: Path, wrong: str, said: str) -> None:
    with pytest.raises(ArmFileError, match=said) as raised:
        load_arm(heavy(tmp_path, wrong))
    assert raised.value.place.line > 0


def test_a_slide_is_read_by_an_encoder_of_lengths(tmp_path: Path) -> None:
    from support.small_arms import ROBOTS

    text = (ROBOTS / "tarm_like" / "arm.toml").read_text().replace('"robot.urdf"', f'"{ROBOTS}/tarm_like/robot.urdf"')
    file = tmp_path / "arm.toml"
    file.write_text(text + ENCODER.replace('"J2"', '"M1"'))
    arm = load_arm(file)
    q = arm.position(M1=0.7)
    header = ",".join([*(f"q_{name}" for name in arm.joint_names), "enc2_mm"])
    (tmp_path / "rows.csv").write_text(f"{header}\n{','.join(map(repr, q.tolist()))},700.0\n")
    rows = read_measurements(tmp_path / "rows.csv", arm, inputs_only=True)
    kind, _ = predict(arm, rows).sensors[0]
    assert kind.unit == "m" and rows.readings.kinds[-1].values[0, 0] == pytest.approx(0.7)
    joint = next(joint for joint in arm.robot.moving if joint.name == "M1")
    gives = arm.deflection(q).twists[arm.flexure_names.index("M1")][:3] @ joint.axis
    assert kind.values[0, 0] == pytest.approx(0.7 + gives, abs=1e-6)
    assert replace(kind).title == "enc2 (slide encoder)"


@pytest.mark.slow
def test_a_plan_chooses_where_instruments_go(tmp_path: Path) -> None:
    """The best link for a level is said with the others, what each buys, and columns to be filled in."""
    arm = load_arm(heavy(tmp_path))
    found = plan(arm, 6, instruments=["wire", "level"])
    wire, level = found.mounts
    assert wire.reached < wire.without and level.reached < level.without
    assert level.without == pytest.approx(wire.reached) and min(value for _, value in level.others) >= level.reached
    header = write_plan(found, tmp_path / "plan.csv").read_text().splitlines()[0].split(",")
    assert header[-3:] == [wire.sensor.name, f"{level.sensor.name}_x", f"{level.sensor.name}_y"] and "x" not in header
    # What it says to declare is what it planned with.
    again = load_arm(heavy(tmp_path, *(f"\n{declaration(one.sensor)}\n" for one in found.mounts)))
    for mount in found.mounts:
        np.testing.assert_allclose(again.sensors[mount.sensor.name].std, mount.sensor.std)
        np.testing.assert_allclose(again.sensors[mount.sensor.name].declared, mount.sensor.declared)
    with pytest.raises(InputError, match="no instrument 'levle', did you mean 'level'"):
        plan(arm, 6, instruments=["levle"])


def test_a_plan_weighs_every_instrument_by_its_own_scatter(tmp_path: Path) -> None:
    """A level that states a hundredth of what it scatters by makes neither the tracker count less nor itself more."""
    _, file, rows = campaign(tmp_path, LEVEL, tracker=1e-4)
    arm, wrong = load_arm(file), tmp_path / "wrong.toml"
    wrong.write_text(file.read_text().replace("sigma = 2e-5", "sigma = 2e-7"))
    other = load_arm(wrong)
    right, doubted = (
        plan(one, 4, after=read_measurements(rows, one), instruments=["tracker", "level3"]) for one in (arm, other)
    )
    assert not any(flag.code == "unexplained_residual" for flag in right.flags)
    (text,) = (flag.text for flag in doubted.flags if flag.code == "unexplained_residual")
    assert "readings of level3 scatter" in text
    np.testing.assert_allclose(doubted.std_before, right.std_before, rtol=0.2)
    ((position, _), (level, _)) = doubted.offered.view.readings.placed
    assert np.min(level.sigma) == pytest.approx(2e-5, rel=0.3) and np.min(position.sigma) == pytest.approx(1e-4)


@pytest.mark.parametrize(
    "own", [(ACCELERATION,), (ENCODER,), (CAMERA,), (TARGET,)], ids=["acc", "encoder", "camera", "target"]
)
def test_a_tracker_takes_every_kind(tmp_path: Path, own: tuple[str, ...]) -> None:
    """What each reads narrows what is known, and leads no further than its uncertainty from the truth."""
    machine, arm, rows = campaign(tmp_path, *own, count=40)
    loaded = load_arm(arm)
    read, tracker = read_measurements(rows, loaded), Tracker(loaded)
    before = dict(zip(tracker.labels, tracker.std, strict=True))
    for row in range(len(read)):
        tracker.update(Reading.of(read, row))
    after = dict(zip(tracker.labels, zip(tracker.values, tracker.std, strict=True), strict=True))
    joint = "joint_offset J2"
    assert min(std / before[name] for name, (_, std) in after.items() if before[name]) < 0.3
    assert abs(after[joint][0] - machine.plant.offset["J2"]) < 4.0 * after[joint][1]


@pytest.mark.slow
def test_a_tracker_follows_what_wires_and_levels_read(tmp_path: Path) -> None:
    """Reading by reading it comes to know what a calibration of all of them knows."""
    _, arm, rows = campaign(tmp_path, WIRE.replace("anchor_std = 0.01", "anchor_std = 1e-4"), LEVEL)
    loaded = load_arm(arm)
    read = read_measurements(rows, loaded)
    whole, tracker = calibrate(loaded, read), Tracker(loaded)
    for row in range(len(read)):
        if row == 5:  # while all readings are kept for another look
            tracker = Tracker.restore(tracker.save(tmp_path / "state"), loaded)
        tracker.update(Reading.of(read, row))
    known = dict(zip(tracker.labels, zip(tracker.values, tracker.std, strict=True), strict=True))
    told = [p for p in whole.parameters if p.std < 0.3 * p.prior]
    assert len(told) > 5
    for one in told:
        value, std = known[one.name]
        assert std < 0.6 * one.prior and abs(value - one.value) < 4.0 * np.hypot(std, one.std), one.name
    with pytest.raises(UnknownNameError, match="wire9"):
        tracker.update(Reading(read.q[0], sensors={"wire9": 1.0}))
    with pytest.raises(InputError, match="there is no reading"):
        tracker.update(Reading(read.q[0]))
