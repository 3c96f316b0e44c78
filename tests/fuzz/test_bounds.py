"""Causes that spoilt inputs found, each by its smallest file."""

import copy
import datetime
from pathlib import Path

import numpy as np
import pytest
from harness import as_toml, judge, judge_command, limited, written
from seeds import ARM, PATH, PATH_HEADER, URDF, arm, declared, quietly, traced

from armflex import load_arm, read_trajectory
from armflex.conventions import NUMBER, parse_quantity
from armflex.errors import ArmFileError, TableError, UnitError
from armflex.robot import load_robot

PLAIN = ARM.replace("LEARN", "").partition("[[effect]]")[0]


def refused(text: str, problem: str) -> None:
    declared()
    path = written("arm.toml", text)
    with pytest.raises(ArmFileError, match=rf"arm\.toml.*{problem}"), limited():
        load_arm(path)
    assert judge_command("deflect", path) == 2


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("a = " + "[" * 3000 + "]" * 3000, "nested deeper than 32"),
        ("a = " + "{a = " * 3000 + "1" + "}" * 3000, "nested deeper than 32"),
        ("a." * 5000 + "a = 1", "nested deeper than 32"),
        ("[" + "a." * 5000 + "a]", "nested deeper than 32"),
        ("a = " + "9" * 5000, "more than 64 bits"),
        ("a = 0x" + "f" * 5000, "more than 64 bits"),
        ("a = [[1, 9223372036854775808]]", ":1: .*more than 64 bits"),
    ],
)
def test_toml_beyond_its_bounds(text: str, problem: str) -> None:
    refused(text, problem)


@pytest.mark.parametrize(
    ("key", "value", "problem"),
    [
        ("com = [0.1, 0.0, 0.05]", "com = [true, 0.0, 0.05]", "com: expected 3 numbers"),
        ("com = [0.1, 0.0, 0.05]", "com = [1e31, 0.0, 0.05]", r"com: beyond 1e\+30"),
        ("com = [0.1, 0.0, 0.05]", f"com = {['x' * 1000] * 1000}", r"com: expected 3 numbers.{0,300}\.\.\.$"),
        ('urdf = "robot.urdf"', 'urdf = "robot\\u0000.urdf"', r"holds the character \\x00"),
        ('urdf = "robot.urdf"', 'urdf = "ghost.urdf"', r"urdf: .*ghost\.urdf: cannot be read"),
        ("joint_offset = 1e-3", "joint_offset = 1e-200", "joint_offset: 1e-200 is less than"),
    ],
)
def test_values_of_a_declaration(key: str, value: str, problem: str) -> None:
    assert PLAIN.count(key) == 1
    declared()
    path = written("arm.toml", PLAIN.replace(key, value))
    with pytest.raises(Exception, match=rf"(?s)arm\.toml.*{problem}"):
        quietly(path)
    assert judge_command("deflect", path) == 2


def test_a_structure_of_too_many_nodes() -> None:
    nodes = "".join(f"n{i} = [0.0, 0.0, {i}.0]\n" for i in range(300))
    refused(PLAIN.replace("[flexure.S.nodes]\n", f"[flexure.S.nodes]\n{nodes}"), "302, more than the 200 allowed")


@pytest.mark.parametrize(
    "more",
    [
        '[[flexure.S.subjoint]]\nat = "1"\ncompliance = [0, 0, 0, 0, 0, 0]\n' * 2,
        '[[flexure.S.subjoint]]\nat = "1"\nholds = ["dx"]\ncompliance = [0, 0, 0, 0, 0, 0]\n' * 2,
    ],
)
def test_a_structure_that_is_held_twice(more: str) -> None:
    refused(PLAIN.replace("[[flexure.S.beam]]", f"{more}[[flexure.S.beam]]"), "model: the structure's equations are")


def test_too_many_flexures() -> None:
    more = "".join(f'[flexure.n{i}]\njoint = "yaw"\ncompliance = [0,0,0,0,0,1e-9]\n' for i in range(600))
    refused(PLAIN + more, "604 flexures, more than the 500 allowed")


def test_a_moment_of_a_payload_that_is_zero_but_for_rounding() -> None:
    declared()
    thin = PLAIN.replace("inertia = [0.3, 0.3, 0.3, 0.0, 0.0, 0.0]", "inertia = [0.3, 0.3, -1e-12, 0.0, 0.0, 0.0]")
    found = quietly(written("arm.toml", thin))
    still = found.deflection(np.zeros(3), "p5", v=np.ones(3))
    assert np.isfinite(still.displacement).all()


CALIBRATION = {
    "negative variance": (lambda c: c["covariance"][2].__setitem__(2, -1e-12), "covariance: has a negative variance"),
    "zero variance": (lambda c: _alone(c, 2, 0.0), "covariance: the variance of '.*' is zero"),
    "too large a covariance": (lambda c: c["covariance"][3].__setitem__(1, 1.0), "not positive semidefinite"),
    "true for a number": (lambda c: c["covariance"][3].__setitem__(1, True), "covariance: expected 4 numbers"),
    "huge integer": (lambda c: c["covariance"][3].__setitem__(1, 10**400), "more than 64 bits"),
    "upper triangle": (lambda c: c["covariance"].reverse(), "covariance: expected .* rows of 1, 2"),
    "no rows": (lambda c: c.__setitem__("covariance", 1.0), "covariance: expected .* rows of 1, 2"),
    "misspelt parameter": (lambda c: c["parameters"].__setitem__(0, "instrumnt x"), "did you mean 'instrument'"),
    "no parameter": (lambda c: c["parameters"].__setitem__(0, "geometry"), "'geometry' is no parameter"),
    "directions": (lambda c: c.__setitem__("undetermined", [[1.0]]), "undetermined: expected rows of"),
    "no directions": (lambda c: c.__setitem__("undetermined", 1), "undetermined: expected rows of"),
    "turn in degrees": (lambda c: c["instrument"].__setitem__(5, 90.0), "instrument: a rotation vector of 90"),
    "session shift": (lambda c: c["sessions"]["s0"].__setitem__(4, 1e31), "s0: beyond"),
    "far target": (lambda c: c["target"].__setitem__(0, 1e31), "target: beyond"),
    "scale": (lambda c: c.__setitem__("scale", -1.0), "scale: a relative error"),
    "hash": (lambda c: c.__setitem__("measurements_sha256", 1), "measurements_sha256: expected a text"),
    "rows": (lambda c: c.__setitem__("rows", "many"), "rows: expected a number"),
    "rms": (lambda c: c.__setitem__("rms_m", -1.0), "rms_m: expected 0 or more"),
    "factor": (lambda c: c["compliance"]["Y"].__setitem__(0, 1e3), "Y: logarithms of factors, none beyond 200"),
}


def _alone(calibration: dict, row: int, variance: float) -> None:
    """Give a parameter a variance and no covariances."""
    rows = calibration["covariance"]
    rows[row] = [0.0] * row + [variance]
    for other in rows[row + 1 :]:
        other[row] = 0.0


@pytest.mark.parametrize("case", CALIBRATION)
def test_a_calibration(case: str) -> None:
    change, problem = CALIBRATION[case]
    tree = copy.deepcopy(traced())
    change(tree["calibration"])
    refused(as_toml(tree), problem)


def parquet(columns: dict) -> Path:
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    plain = {name: [float(row[i]) if i not in (4, 5) else row[i] for row in PATH] for i, name in enumerate(PATH_HEADER)}
    path = written("path.parquet", b"")
    parquet.write_table(pa.table(plain | columns), path)
    return path


def test_parquet_that_is_no_table_of_plain_values() -> None:
    pa = pytest.importorskip("pyarrow")
    broken = pa.array([b"\xff", b"a", b"b"]).cast(pa.string(), safe=False)
    cases = {
        "UTF-8": broken,
        "out of range": pa.array([10**14] * 3, pa.timestamp("s")),
        "expected numbers or text": pa.array([b"abcd"] * 3, pa.binary(4)),
        "holds list": pa.array([[1.0]] * 3),
        "holds dictionary": pa.array([b"a"] * 3).dictionary_encode(),
    }
    for problem, column in cases.items():
        with pytest.raises(TableError, match=rf"path\.parquet.*{problem}"):
            read_trajectory(parquet({"via": column}), arm())
    dates = parquet({"via": [datetime.date(2024, 1, 2)] * 3})
    assert read_trajectory(dates, arm()).via == ("2024-01-02",) * 3


def test_a_long_text_in_many_rows_of_parquet_is_held_once() -> None:
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    path, count = written("bomb.parquet", b""), 5000
    long = pa.DictionaryArray.from_arrays(pa.array(np.zeros(count, dtype=np.int32)), pa.array(["x" * 1_000_000]))
    columns = {name: np.linspace(0.0, 0.1, count) for name in PATH_HEADER if name not in ("payload", "via")}
    parquet.write_table(pa.table({"time": np.arange(float(count)), **columns, "via": long}), path)
    assert path.stat().st_size < 2_000_000
    assert judge(lambda: read_trajectory(path, arm()), path)


def test_a_long_row_of_digits_that_is_no_number_takes_no_time() -> None:
    with limited(seconds=1.0):
        assert not NUMBER.fullmatch("9" * 100_000 + "x")
        assert NUMBER.fullmatch("9" * 100_000)
        with pytest.raises(UnitError):
            parse_quantity("9" * 100_000 + "!", "length")


def test_rows_of_a_path_that_are_no_time_apart() -> None:
    rows = [",".join(row) for row in PATH]
    path = written("path.csv", "\n".join([",".join(PATH_HEADER), rows[0], rows[1].replace("1.0", "1e-320", 1)]))
    with pytest.raises(TableError, match=r"path\.csv:3: time does not increase, by 1e-09 s at least"):
        read_trajectory(path, arm())


def test_numbers_of_a_table_beyond_everything() -> None:
    row = ",".join(PATH[0]).replace("0.1", "-1e31", 1)
    path = written("path.csv", f"{','.join(PATH_HEADER)}\n{row}\n")
    with pytest.raises(TableError, match=r"path\.csv:2: column 'q_yaw' is '-1e31', beyond 1e\+30"):
        read_trajectory(path, arm())


def test_a_mass_next_to_nothing() -> None:
    text = URDF.replace('mass value="60.0"', 'mass value="1e-320"')
    path = written("light.urdf", text)
    assert "1e-320" in text and judge(lambda: load_robot(path, "tool"), path)
