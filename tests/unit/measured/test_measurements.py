"""Reading a campaign: what is converted, kept and masked, and what is refused with row and column."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from support.measurement_rows import JOINTS, campaign, codes, written

from armflex import Arm, InputError, read_measurements, read_trajectory
from armflex.arm import Setup
from armflex.errors import TableError
from armflex.estimate.view import look
from armflex.laws.effects.catalogue import CATALOGUE
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.location import Location
from armflex.measured.data_flags import duplicates
from armflex.measured.table import is_nearly
from armflex.readings.instrument import Instrument
from armflex.rows.rows import leaked, pose_groups


def renamed(rows: list[dict[str, object]], **names: str) -> list[dict[str, object]]:
    return [{names.get(key, key): value for key, value in row.items()} for row in rows]


def test_units_order_masks_and_covariates_are_kept(heavy: Arm, tmp_path: Path) -> None:
    rows = campaign()
    for i, row in enumerate(rows):
        row |= {"q_J1": np.degrees(row["q_J1"]), "x": 1e3 * row["x"], "temperature": 20.0 + i, "operator": f"o{i % 2}"}
    rows[3] |= {"x": "", "y": "", "z": "", "sigma": ""}
    names = {"x": "x_mm", "q_J1": "q_J1_deg"}
    found = read_measurements(written(tmp_path, renamed(rows, **names)), heavy)
    plain = campaign()
    np.testing.assert_allclose(found.q[:, 0], [row["q_J1"] for row in plain], rtol=1e-14)
    assert found.measured.tolist() == [i != 3 for i in range(12)]
    expected = [[row[axis] for axis in "xyz"] for i, row in enumerate(plain) if i != 3]
    np.testing.assert_allclose(found.position[found.measured], expected, rtol=1e-14)
    np.testing.assert_array_equal(found.covariates["temperature"], 20.0 + np.arange(12))
    assert found.covariates["operator"] == ("o0", "o1") * 6
    assert found.places[3].line == 5 and not found.flags


BROKEN = {
    "no header": (lambda text: text.partition("\n")[2], r"rows.csv:1: has no header row.*expected.*x, y, z.*found: p0"),
    "missing": (lambda text: text.replace("q_J3", "angle3"), r"no column 'q_J3'.*expected: q_J1.*found: pose.*angle3"),
    "two missing": (lambda text: text.replace("y,z,", "b,c,"), r"no column 'y', 'z'"),
    "renamed": (lambda text: text.replace(",x,", ",X,"), r"no column 'x', did you mean 'X'"),
    "case": (lambda text: text.replace("session", "Session"), r"unknown column 'Session', did you mean 'session'"),
    "misspelt": (
        lambda text: text.replace("payload", "pay_load"),
        r"unknown column 'pay_load', did you mean 'payload'",
    ),
    "exchanged letters": (lambda text: text.replace("pose,", "psoe,"), r"unknown column 'psoe', did you mean 'pose'"),
    "another arm": (
        lambda text: text.replace("q_J", "q_A"),
        r"seems to be of another arm: it has q_A1, .*q_A6, and the joints of 'heavy_six' are called J1, .*J6",
    ),
    "small letters in degrees": (
        lambda text: re.sub(r"q_J([1-6])", r"q_j\1 [deg]", text),
        r"no column 'q_J1', .*'q_J6', did you mean 'q_j1 \[deg\]'",
    ),
    "small letters in radians": (
        lambda text: re.sub(r"q_J([1-6])", r"q_j\1_rad", text),
        r"no column 'q_J1', .*'q_J6', did you mean 'q_j1_rad'",
    ),
    "another arm in degrees": (
        lambda text: re.sub(r"q_J([1-6])", r"q_A\1_deg", text),
        r"seems to be of another arm: it has q_A1_deg, .*q_A6_deg",
    ),
    "unit": (lambda text: text.replace(",x,", ",x_inch,"), r"column 'x_inch': 'inch' is no unit of length"),
    "a row cut": (lambda text: text.rstrip().rpartition(",")[0], r"rows.csv:13: has 13 cells, the header has 14"),
    "a cell empty": (lambda text: text.replace("p4,s0,40.0", "p4,s0,"), r"rows.csv:6: column 'time' is empty"),
    "nan": (lambda text: text.replace("p4,s0,40.0", "p4,s0,NaN"), r"rows.csv:6: column 'time' is 'NaN'"),
    "payload": (lambda text: text.replace("40.0,none", "40.0,brick"), r"rows.csv:6: no payload named 'brick'"),
    "empty": (lambda text: "", r"is empty, expected a header row"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_refused_with_place_expected_and_found(heavy: Arm, tmp_path: Path, name: str) -> None:
    change, match = BROKEN[name]
    path = written(tmp_path, campaign())
    path.write_text(change(path.read_text()))
    with pytest.raises(TableError, match=match):
        read_measurements(path, heavy)


def test_a_column_in_capitals_is_no_covariate(heavy: Arm, tmp_path: Path) -> None:
    with pytest.raises(TableError, match="unknown column 'RX', did you mean 'rx'"):
        read_measurements(written(tmp_path, [row | {"RX": 0.0} for row in campaign()]), heavy)


def test_a_byte_order_mark_is_read_over(heavy: Arm, tmp_path: Path) -> None:
    path = written(tmp_path, campaign())
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert read_measurements(path, heavy).pose[0] == "p0"


@pytest.mark.parametrize("cell", ["nan", "-inf", "NaN"])
def test_nan_in_a_covariate_is_an_error_with_row_and_column(heavy: Arm, tmp_path: Path, cell: str) -> None:
    rows = [row | {"humidity": cell if i == 7 else 50.0 + i} for i, row in enumerate(campaign())]
    with pytest.raises(TableError, match=rf"rows.csv:9: column 'humidity' is '{cell}'"):
        read_measurements(written(tmp_path, rows), heavy)


def test_a_gap_in_a_covariate_is_flagged(heavy: Arm, tmp_path: Path) -> None:
    rows = [row | {"humidity": "" if i == 7 else 50.0 + i} for i, row in enumerate(campaign())]
    found = read_measurements(written(tmp_path, rows), heavy)
    assert codes(found) == ["covariate_gaps"] and "lines 9" in found.flags[0].text
    assert "not searched" in found.flags[0].text and not [name for name in found.known if "humidity" in name]


def test_a_column_that_is_nearly_a_temperature_is_asked_about(heavy: Arm, tmp_path: Path) -> None:
    names = {"temprature": True, "tmeperature": True, "temperatures": True, "temperature_2": False, "cold": False}
    for name, asked in names.items():
        found = read_measurements(written(tmp_path, [row | {name: i} for i, row in enumerate(campaign())]), heavy)
        assert codes(found) == (["covariate_name"] if asked else []) and name in found.covariates
        assert not asked or f"rows.csv:1: column '{name}' is read as a covariate: did" in found.flags[0].text
    both = [row | {"temprature": i, "temperature": 2 * i} for i, row in enumerate(campaign())]
    assert not codes(read_measurements(written(tmp_path, both), heavy))


def depending_on(arm: Arm, column: str) -> Arm:
    """Return the arm with an effect that depends on a column."""
    law = CATALOGUE["base_thermal"]
    effect = Effect(law, Location("base", "dx", (column,)), (0.0,) * (len(law.amplitudes) + len(law.inner)))
    return dataclasses.replace(arm, effects=(effect,))


def test_a_column_that_effects_depend_on_is_not_asked_about(heavy: Arm, tmp_path: Path) -> None:
    path = written(tmp_path, [row | {"temperatur": i} for i, row in enumerate(campaign())])
    assert codes(read_measurements(path, heavy)) == ["covariate_name"]
    assert not codes(read_measurements(path, depending_on(heavy, "temperatur")))


@pytest.mark.parametrize(
    ("asked", "slips", "others"),
    [
        (
            "pressure_b",
            ("presure_b", "pressures_b", "pressureb", "Pressure_B"),
            ("pressure_a", "pressure", "presure_a"),
        ),
        ("tool_temperature", ("tool_temperatur", "tol_temperature"), ("room_temperature", "tool_temperature_2")),
        ("temperature", ("temperatures", "temperatur", "temp_erature"), ("temperature2", "air_temperature")),
        ("gap_11", ("gap11",), ("gap_1_1", "gap_12", "cap_11")),
    ],
)
def test_one_word_of_a_name_may_be_misspelt(asked: str, slips: tuple[str, ...], others: tuple[str, ...]) -> None:
    assert [name for name in (*slips, *others) if is_nearly(name, asked)] == [*slips]


def test_another_column_beside_that_which_effects_depend_on_is_read(heavy: Arm, tmp_path: Path) -> None:
    for name, asked in {"pressure_a": "pressure_b", "room_temperature": "tool_temperature"}.items():
        path = written(tmp_path, [row | {name: i} for i, row in enumerate(campaign())])
        assert name in read_measurements(path, depending_on(heavy, asked)).covariates
        assert name in read_trajectory(path, depending_on(heavy, asked)).covariates


def test_a_misspelt_column_that_effects_depend_on_is_refused(heavy: Arm, tmp_path: Path) -> None:
    arm = depending_on(heavy, "humidity")
    for name in ("humidty", "hunidity", "Humidity"):
        path = written(tmp_path, [row | {name: i} for i, row in enumerate(campaign())])
        with pytest.raises(TableError, match=f"rows.csv:1: column '{name}', did you mean 'humidity'.*effects depend"):
            read_measurements(path, arm)
        with pytest.raises(TableError, match=f"rows.csv:1: column '{name}', did you mean 'humidity'.*effects depend"):
            read_trajectory(path, arm)
    for name in ("humidity_out", "humidity2", "hour"):  # what is missing may be given otherwise
        read_measurements(written(tmp_path, [row | {name: i} for i, row in enumerate(campaign())]), arm)


def test_entries_of_a_text_column_are_known_as_columns(heavy: Arm, tmp_path: Path) -> None:
    rows = [row | {"operator": f"o{i % 3}", "remark": f"remark {i}"} for i, row in enumerate(campaign(14))]
    found = read_measurements(written(tmp_path, rows), heavy)
    np.testing.assert_array_equal(found.known["operator=o1"], np.arange(14) % 3 == 1)
    assert [name for name in found.known if "=" in name] == ["operator=o0", "operator=o1", "operator=o2"]
    assert codes(found) == ["covariate_text"] and "'remark': 14 different texts" in found.flags[0].text


def test_a_row_without_an_orientation_counts_by_its_position(heavy: Arm, tmp_path: Path) -> None:
    turned = {"rx": 0.1, "ry": 0.2, "rz": 0.3, "sigma_r": 1e-3}
    blank = dict.fromkeys(turned, "")
    rows = [row | (blank if i in (2, 7) else turned) for i, row in enumerate(campaign())]
    found = read_measurements(written(tmp_path, rows), heavy)
    assert np.flatnonzero(np.isinf(found.sigma_r)).tolist() == [2, 7] and found.measured.all()
    assert (found.sigma_r[[0, 11]] == 1e-3).all() and not found.rotation[[2, 7]].any()
    view = look(Setup(heavy, Instrument()), found, np.arange(12))
    assert not view.whitened[[2, 7], 3:].any() and np.abs(view.whitened[[0, 11], 3:]).min() > 0.0
    nothing = read_measurements(written(tmp_path, [row | blank for row in campaign()]), heavy)
    assert nothing.rotation is None and nothing.sigma_r is None


ORIENTATIONS = {
    "no sigma_r": ({"rx": 0.1, "ry": 0.2, "rz": 0.3}, r"rows.csv:1: .*no column 'sigma_r'"),
    "zero": ({"rx": 0.1, "ry": 0.2, "rz": 0.3, "sigma_r": 0}, r"rows.csv:2: sigma_r must be positive"),
    "blank": ({"rx": 0.1, "ry": 0.2, "rz": 0.3, "sigma_r": ""}, r"rows.csv:2: column 'sigma_r' is empty"),
    "alone": (
        {"rx": 0.1, "ry": 0.2, "rz": 0.3, "sigma_r": 1e-3, "x": "", "y": "", "z": ""},
        r"rows.csv:2: has rx ry rz but no x y z",
    ),
}


@pytest.mark.parametrize("name", ORIENTATIONS)
def test_orientations_that_cannot_be_used_are_refused(heavy: Arm, tmp_path: Path, name: str) -> None:
    added, match = ORIENTATIONS[name]
    with pytest.raises(TableError, match=match):
        read_measurements(written(tmp_path, [row | added for row in campaign()]), heavy)


def test_a_load_that_has_stood_for_less_than_nothing_is_refused(heavy: Arm, tmp_path: Path) -> None:
    rows = [row | {"hold": -5.0 if i == 3 else 0.0} for i, row in enumerate(campaign())]
    with pytest.raises(TableError, match=r"rows\.csv:5: hold is -5 s: the load has stood for 0 s at least"):
        read_measurements(written(tmp_path, rows), heavy)


def test_rotations_without_their_standard_deviation_make_no_campaign(heavy: Arm, tmp_path: Path) -> None:
    found = read_measurements(written(tmp_path, campaign()), heavy)
    with pytest.raises(InputError, match="sigma_r"):
        dataclasses.replace(found, rotation=np.zeros((12, 3)))


def test_what_only_the_order_of_rows_tells_is_named(heavy: Arm, tmp_path: Path) -> None:
    rows = [{key: value for key, value in row.items() if key != "time"} | {"approach_J2": 1} for row in campaign()]
    found = read_measurements(written(tmp_path, rows), heavy)
    assert found.derived == ("time", *(f"approach_{name}" for name in JOINTS if name != "J2"))
    assert "time" not in found.known and (found.known["approach_J2"] == 1.0).all()


@pytest.mark.parametrize(("chosen", "factor"), [((2, 5, 6, 9), 1e3), ((4,), 1e3), ((1, 3, 8), 1e-3), (range(7), 1e3)])
def test_rows_in_another_unit_are_named(heavy: Arm, tmp_path: Path, chosen: tuple[int, ...], factor: float) -> None:
    rows = campaign(14)
    for i in chosen:
        rows[i] |= {axis: factor * rows[i][axis] for axis in "xyz"}
    with pytest.raises(TableError, match="mm among m") as caught:
        read_measurements(written(tmp_path, rows), heavy)
    assert caught.value.place.line == min(chosen) + 2
    assert f"lines {', '.join(str(i + 2) for i in chosen)}" in str(caught.value)


def test_one_column_in_another_unit_in_some_rows_is_named(heavy: Arm, tmp_path: Path) -> None:
    rows = campaign(14)
    for i in (3, 4):
        rows[i]["y"] *= 1e3
    with pytest.raises(TableError, match=r"rows.csv:5.*lines 5, 6"):
        read_measurements(written(tmp_path, rows), heavy)


def test_a_lost_beam_or_a_pose_at_the_origin_is_no_other_unit(heavy: Arm, tmp_path: Path) -> None:
    rows = campaign(30)
    rows[3]["x"] += 1.0
    rows[5]["y"] += 40.0
    rng = np.random.default_rng(2)
    for i in range(10, 16):  # a reference pose that the frame was set up at, read with noise
        rows[i] |= dict(zip("xyz", rng.normal(1e-3, 2e-4, 3).tolist(), strict=True))
    assert not codes(read_measurements(written(tmp_path, rows), heavy))


@pytest.mark.parametrize("number", [0.0, -9999.0, -3.697314e28])
def test_what_an_instrument_writes_again_and_again_where_it_reads_nothing_is_no_place(
    heavy: Arm, tmp_path: Path, number: float
) -> None:
    rows = campaign(30)
    for i in (4, 9, 17):
        rows[i] |= dict.fromkeys("xyz", number)
    with pytest.raises(TableError, match=r"rows.csv:6: x, y, z are .* leave the cells empty \(3 of 30 .*6, 11, 19\)"):
        read_measurements(written(tmp_path, rows), heavy)
    rows = campaign(30)
    rows[4] |= dict.fromkeys("xyz", 0.0)  # where a frame was set up
    assert not codes(read_measurements(written(tmp_path, rows), heavy))
    for row in rows:  # a target that is put into one socket
        row |= dict.fromkeys("xyz", 0.0)
    assert read_measurements(written(tmp_path, rows), heavy).measured.all()


def test_two_statements_of_sigma_are_refused(heavy: Arm, tmp_path: Path) -> None:
    rows = [row | dict.fromkeys(("sigma_x", "sigma_y", "sigma_z"), 1e-4) for row in campaign()]
    with pytest.raises(TableError, match="has sigma beside sigma_x, sigma_y, sigma_z: leave one out"):
        read_measurements(written(tmp_path, rows), heavy)


def test_degrees_among_radians_are_named(heavy: Arm, tmp_path: Path) -> None:
    rows = campaign()
    rows[6]["q_J2"] = np.degrees(rows[6]["q_J2"])
    with pytest.raises(TableError, match=r"rows.csv:8: q_J2 .*q_J2_deg"):
        read_measurements(written(tmp_path, rows), heavy)


def test_duplicates_are_counted_and_kept(heavy: Arm, tmp_path: Path) -> None:
    rows = campaign()
    repeat = rows[2] | {"time": 500.0, "x": rows[2]["x"] + 1e-4}
    blind = rows[6] | {"x": "", "y": "", "z": ""}
    found = read_measurements(written(tmp_path, [*rows, rows[4], rows[4], repeat, blind, blind]), heavy)
    assert codes(found) == ["time_unordered", "duplicate_rows"] and found.measured[:-2].all()
    assert "2 rows" in found.flags[1].text and "rows.csv:14" in found.flags[1].text
    assert duplicates(found).tolist() == [12, 13] and len(found) == 17


def test_without_a_time_column_duplicates_are_still_seen(heavy: Arm, tmp_path: Path) -> None:
    rows = [{key: value for key, value in row.items() if key != "time"} for row in campaign()]
    assert codes(read_measurements(written(tmp_path, [*rows, rows[0]]), heavy)) == ["duplicate_rows"]


def test_time_that_goes_back_is_flagged_and_kept(heavy: Arm, tmp_path: Path) -> None:
    rows = campaign()
    rows[5]["time"], rows[9]["time"] = 5.0, 6.0
    found = read_measurements(written(tmp_path, rows), heavy)
    assert codes(found) == ["time_unordered"] and "2 rows, first at" in found.flags[0].text
    assert "rows.csv:7" in found.flags[0].text and found.time[5] == 5.0 and found.pose[5] == "p5"


def test_groups_hold_a_pose_together_under_any_name_and_load(heavy: Arm, tmp_path: Path) -> None:
    rows = campaign()
    again = [rows[2] | {"time": 200.0}, rows[3] | {"pose": "other", "time": 210.0}, rows[5] | {"time": 220.0}]
    again[1]["q_J4"] += 5e-4
    again[2]["q_J1"] += 0.1
    labels = pose_groups(read_measurements(written(tmp_path, [*rows, *again]), heavy))
    assert labels.tolist() == [*range(12), 2, 3, 5]


def test_a_chain_of_names_and_places_is_one_group(heavy: Arm, tmp_path: Path) -> None:
    rows = campaign(4)
    joints = {key: value for key, value in rows[0].items() if key.startswith("q_")}
    rows[3] |= joints
    rows[2]["pose"] = "p3"
    assert pose_groups(read_measurements(written(tmp_path, rows), heavy)).tolist() == [0, 1, 0, 0]


def test_rows_that_leak_into_a_test_split_are_found(heavy: Arm, tmp_path: Path) -> None:
    rows = campaign()
    train = read_measurements(written(tmp_path, rows[:8]), heavy)
    late = [*rows[8:], rows[1] | {"pose": "new", "payload": "none", "x": 2.0}]
    test = read_measurements(written(tmp_path, late, "test.csv"), heavy)
    assert leaked(train, test).tolist() == [4]
    with pytest.raises(InputError, match="J1, J2"):
        leaked(dataclasses.replace(train, joint_names=("a",)), test)


def test_parquet_gives_what_csv_gives(heavy: Arm, tmp_path: Path) -> None:
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    rows = [row | {"operator": f"o{i % 2}"} for i, row in enumerate(campaign())]
    rows[3] |= {"x": None, "y": None, "z": None, "sigma": None}
    table = pa.table({name: [row[name] for row in rows] for name in rows[0]})
    operator = table.schema.get_field_index("operator")
    pq.write_table(
        table.set_column(operator, "operator", table["operator"].dictionary_encode()), tmp_path / "r.parquet"
    )
    csv_read = read_measurements(written(tmp_path, rows), heavy)
    found = read_measurements(tmp_path / "r.parquet", heavy)
    for name in ("time", "q", "measured", "position", "sigma", "approach"):
        np.testing.assert_array_equal(getattr(found, name), getattr(csv_read, name))
    assert (found.pose, found.payload, found.covariates) == (csv_read.pose, csv_read.payload, csv_read.covariates)
    assert [place.line for place in found.places] == [place.line for place in csv_read.places]


def test_parquet_passes_the_same_checks(heavy: Arm, tmp_path: Path) -> None:
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    columns = {name: [row[name] for row in campaign()] for name in campaign()[0]}
    wrong = {
        "rows.parquet:6: column 'y' is 'nan'": columns | {"y": [*columns["y"][:4], float("nan"), *columns["y"][5:]]},
        "no column 'q_J3'.*expected.*found": {name: cells for name, cells in columns.items() if name != "q_J3"},
        "column 'tags' holds list": columns | {"tags": [[1]] * 12},
    }
    for match, content in wrong.items():
        pq.write_table(pa.table(content), tmp_path / "rows.parquet")
        with pytest.raises(TableError, match=match):
            read_measurements(tmp_path / "rows.parquet", heavy)


def test_damaged_huge_or_missing_parquet_is_refused(heavy: Arm, tmp_path: Path) -> None:
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    (tmp_path / "damaged.parquet").write_bytes(b"PAR1 and nothing else")
    pq.write_table(pa.table({"a": pa.nulls(30_000_000, pa.int8())}), tmp_path / "huge.parquet")
    for name, match in (("damaged", "cannot be read"), ("huge", "30000000 cells"), ("missing", "cannot be read")):
        with pytest.raises(TableError, match=match):
            read_measurements(tmp_path / f"{name}.parquet", heavy)


def test_without_pyarrow_the_error_says_what_to_install(heavy: Arm, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(TableError, match=r"pip install 'armflex\[parquet\]'"):
        read_measurements(tmp_path / "rows.parquet", heavy)
