"""Tables of text, spoilt: campaigns, trajectories, joint data, exported points, Parquet."""

import functools
import io
from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from harness import cases, hostile, judge, mutated_bytes, mutated_cells, mutated_table, written
from hypothesis import given
from hypothesis import strategies as st
from seeds import PATH, PATH_HEADER, arm, campaign, declared, quietly
from support.small_arms import ROBOTS

from armflex import Arm, check, compensate, predict, read_joint_data, read_measurements, read_trajectory, train
from armflex.laws import Row
from armflex.measured.joint_data import JointData
from armflex.measured.measurements import Measurements
from armflex.measured.points import PointExport, read_points
from armflex.trajectory import Trajectory

POINTS = """// Units: mm
// Frame: A::WORLD
// Collection, Group, Point, X, Y, Z, Time
A, tip, p1, 100.5, 200.25, -300.125, 2024-01-02 10:00:00
A, tip, p2, 101.5, 201.25, -301.125, 2024-01-02 10:00:10
A, tip, p3, 102.5, 202.25, -302.125, 2024-01-02 10:00:20
"""


@functools.cache
def whole() -> Arm:
    """Return the arm with its effects."""
    return quietly(declared())


def _spoilt(make: Any) -> st.SearchStrategy[bytes]:
    """Return a table spoilt whose seed takes computing: not made where tests are only collected."""
    return st.deferred(lambda: mutated_table(*make()))


def few() -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    header, rows = campaign()
    return header, rows[:10]


def predicted(rows: Measurements) -> Mapping[str, Any]:
    found = predict(whole(), rows)
    numbers = {"position": found.position, "sigma": found.sigma, "read": rows.position, "sigma of it": rows.sigma}
    return numbers | {name: values for name, values in rows.known.items()}


@cases(250)
@given(_spoilt(few))
def test_a_campaign(text: bytes) -> None:
    path = written("campaign.csv", text)
    judge(lambda: read_measurements(path, whole()), path, predicted)


def pulled() -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    header, rows = few()
    forces = [("0.2", "-300", "", "base"), ("", "", "tool", ""), ("0", "12.5", whole().link_names[2], "link")]
    more = ("force_fx_kN", "force_mz", "force_frame", "force_axes")
    return (*header, *more), tuple((*row, *forces[i % 3]) for i, row in enumerate(rows))


@cases(100)
@given(_spoilt(pulled))
def test_a_campaign_with_forces(text: bytes) -> None:
    path = written("pulled.csv", text)
    judge(lambda: read_measurements(path, whole()), path, predicted)


@cases(50)
@given(_spoilt(few))
def test_rows_to_predict(text: bytes) -> None:
    path = written("rows.csv", text)
    judge(lambda: read_measurements(path, whole(), inputs_only=True), path, predicted)


def followed(path: Trajectory) -> Mapping[str, Any]:
    """Return what the arm does along a path, what of it is held against a tolerance, and what compensates its rows."""
    found = [
        arm().deflection(q, payload, **path.motion(i))
        for i, (q, payload) in enumerate(zip(path.q, path.payload, strict=True))
    ]
    held = check(arm(), path, 5e-3)
    moved = [np.linalg.norm(one.displacement[:3]) for one in found]
    np.testing.assert_allclose([row.displacement_m for row in held.rows], moved, rtol=1e-6, atol=1e-9)
    points = (*held.rows, *held.segments, *held.via_points, held.path_worst)
    return {
        "held": [(one.displacement_m, one.rotation_rad, one.sigma_m, one.margin_m) for one in points],
        "displacement": [one.displacement for one in found],
        "covariance": [one.covariance for one in found],
        "q": compensate(arm(), path).trajectory.q,
    }


@cases(150)
@given(mutated_table(PATH_HEADER, PATH))
def test_a_trajectory(text: bytes) -> None:
    path = written("path.csv", text)
    judge(lambda: read_trajectory(path, arm()), path, followed)


PLAIN = "".join(",".join(map(str, row)) + "\n" for row in (PATH_HEADER, *PATH))
COMMAS = PLAIN.replace(",", ";").replace(".", ",")
FORMS = (COMMAS.encode(), COMMAS.replace(";", "\t").encode("utf-16"), PLAIN.replace("p", "ä").encode("cp1252"))


@cases(150)
@given(st.one_of(*map(mutated_bytes, FORMS)))
def test_a_trajectory_of_another_country(text: bytes) -> None:
    path = written("path.csv", text)
    judge(lambda: read_trajectory(path, arm()), path, followed)


@pytest.mark.skipif(not find_spec("openpyxl"), reason="no openpyxl is installed")
@cases(100)
@given(st.deferred(lambda: mutated_bytes(_workbook())))
def test_a_workbook(text: bytes) -> None:
    path = written("path.xlsx", text)
    judge(lambda: read_trajectory(path, arm()), path, followed)


@functools.cache
def _workbook() -> bytes:
    from openpyxl import Workbook

    book, file = Workbook(), io.BytesIO()
    for row in (PATH_HEADER, *PATH):
        book.worksheets[0].append([*row])
    book.save(file)
    return file.getvalue()


def linear(data: JointData) -> Mapping[str, Any]:
    found, load, row = train(data), np.full(6, 10.0), Row(np.zeros(0), {})
    law = found.trained.law
    return {"twist": law.twist(load, row), "covariance": law.covariance(load, row), "held out": found.held_out_rms}


def bench(table: str) -> st.SearchStrategy[bytes]:
    header, *rows = [line.split(",") for line in (ROBOTS / "tarm_like" / table).read_text().split()]
    return mutated_table(header, rows)


@cases(100)
@given(bench("a4_table_1.csv"))
def test_joint_data(text: bytes) -> None:
    path = written("joint.csv", text)
    judge(lambda: read_joint_data(path), path, linear)


def placed(points: PointExport) -> Mapping[str, Any]:
    assert all(points.names), "a point without a name"
    return {"position": points.position}


@cases(150)
@given(mutated_bytes(POINTS.encode()))
def test_exported_points(text: bytes) -> None:
    path = written("points.txt", text)
    judge(lambda: read_points(path), path, placed)


@cases(50)
@given(mutated_bytes(POINTS.encode()))
def test_points_of_a_campaign(text: bytes) -> None:
    path = written("points.txt", text)
    header, rows = campaign()
    end = header.index("x")
    table = written(
        "with_points.csv", "".join(",".join(row[:end] + extra) + "\n" for row, extra in _sigmas(header, rows))
    )
    judge(lambda: read_measurements(table, whole(), points=path), path, predicted, names=(table.name,))


def _sigmas(header: tuple[str, ...], rows: tuple[tuple[str, ...], ...]) -> list[tuple[tuple[str, ...], tuple[str]]]:
    return [(header, ("sigma",)), *((row, ("1e-4",)) for row in rows[1:4])]


def _columns() -> st.SearchStrategy[dict[str, list[Any]]]:
    header, rows = PATH_HEADER, PATH
    seed = {name: [_number(row[i]) for row in rows] for i, name in enumerate(header)}
    return st.builds(
        lambda name, values: {**seed, name: values}, st.sampled_from(header), st.lists(_cell, min_size=3, max_size=3)
    )


def _number(cell: str) -> float | str:
    try:
        return float(cell)
    except ValueError:
        return cell


_cell = st.one_of(
    hostile(), st.dates(), st.datetimes(), st.binary(max_size=4), st.none(), st.decimals(allow_nan=True), st.times()
)


@cases(100)
@given(_columns())
def test_parquet(columns: dict[str, list[Any]]) -> None:
    pa = pytest.importorskip("pyarrow")
    arrays = {name: _array(pa, values) for name, values in columns.items()}
    path = written("path.parquet", _parquet(pa.table(arrays)))
    judge(lambda: read_trajectory(path, arm()), path, followed)


def _array(pa: Any, values: list[Any]) -> Any:
    """Return a column of values, or of the first alone where they are of different types, or of what is no UTF-8."""
    for cells in (values, [values[0]] * 3):
        try:
            array = pa.array(cells)
            _parquet(pa.table({"a": array}))
            return array
        except (pa.ArrowException, OverflowError, TypeError, ValueError):
            continue
    return pa.array([b"\xff\xfe"] * 3).cast(pa.string(), safe=False)


def _parquet(table: Any) -> bytes:
    import pyarrow as pa
    from pyarrow import parquet

    sink = pa.BufferOutputStream()
    parquet.write_table(table, sink)
    return sink.getvalue().to_pybytes()


@cases(80)
@given(st.deferred(lambda: mutated_bytes(_seed_parquet())))
def test_damaged_parquet(data: bytes) -> None:
    path = written("path.parquet", data)
    judge(lambda: read_trajectory(path, arm()), path, followed)


@functools.cache
def _seed_parquet() -> bytes:
    import pyarrow as pa

    return _parquet(pa.table({name: [_number(row[i]) for row in PATH] for i, name in enumerate(PATH_HEADER)}))


@cases(40)
@given(mutated_cells(PATH_HEADER, PATH))
def test_parquet_of_text(table: tuple[list[str], list[list[str]]]) -> None:
    pa = pytest.importorskip("pyarrow")
    names, rows = table
    columns = [pa.array([row[i].encode("utf-8", "replace").decode() for row in rows]) for i in range(len(names))]
    path = written("path.parquet", _parquet(pa.table(columns, names=names)))
    judge(lambda: read_trajectory(path, arm()), path, followed)
