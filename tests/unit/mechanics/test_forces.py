"""Known forces, one for each row: in batches, in campaigns, and what a table that holds them may get wrong."""

from pathlib import Path

import numpy as np
import pytest
from support.arms import bundled, crooked, positions
from support.measurement_rows import campaign, codes, written
from support.small_arms import random_compliance

from armflex import Arm, Wrench, predict, read_measurements
from armflex.errors import ShapeError, TableError
from armflex.laws import LinearLaw
from armflex.measured.data_flags import duplicates
from armflex.mechanics.many_rows import RowSolver
from armflex.mechanics.response import respond
from armflex.rows.wrench import wrenches_in


def pushes(links: tuple[str, ...], count: int, axes: str) -> list[Wrench]:
    """Return a wrench at each link, for every row, each zero in some of the rows."""
    rng = np.random.default_rng(7)
    found = []
    for i, link in enumerate(links):
        loads = np.where(np.arange(count)[:, None] % 3 == i, 0.0, rng.normal(0.0, 300.0, (count, 6)))
        found.append(Wrench(link, loads[:, :3], loads[:, 3:], axes))
    return found


@pytest.mark.parametrize("method", ["exact", "newton"])
@pytest.mark.parametrize("axes", ["base", "frame"])
def test_a_wrench_for_each_row_is_that_of_the_row_alone(tmp_path: Path, axes: str, method: str) -> None:
    law = [LinearLaw(random_compliance(i), relative_std=0.1) for i in range(3)]
    arm = crooked(tmp_path, {"foot": (None, law[0]), "roll": ("roll", law[1]), "tip": ("flange", law[2])})
    q, wrenches = positions(arm, 7), pushes(("boom", "tool"), 7, axes)
    still = Wrench("fore", [40.0, -70.0, 30.0], [5.0, 0.0, -8.0], axes)
    found = arm.deflection(q, wrenches=[*wrenches, still], method=method)
    for i, row in enumerate(q):
        one = arm.deflection(row, wrenches=[*wrenches_in(wrenches, i), still], method=method)
        np.testing.assert_allclose(found.displacement[i], one.displacement, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.wrenches[i], one.wrenches, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.row(i).joint_loads, one.joint_loads, rtol=0, atol=1e-9)
        loads = [
            joint.axis @ load.reshape(2, 3)[int(joint.kind != "prismatic")]
            for joint, load in zip(arm.robot.moving, one.joint_loads, strict=True)
        ]
        np.testing.assert_allclose(found.drive_loads[i], loads, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.covariance[i], one.covariance, rtol=1e-7, atol=1e-16)


@pytest.mark.parametrize("axes", ["base", "frame"])
def test_a_wrench_for_each_row_with_payloads_and_responses(axes: str) -> None:
    arm = bundled("heavy_six")
    q, payloads = positions(arm, 9), ["p200", "none", "p100"] * 3
    wrenches = pushes((arm.link_names[3], "tool"), 9, axes)
    line = respond(arm, q, payloads, wrenches=wrenches)
    for i in range(9):
        one = arm.deflection(q[i], payloads[i], wrenches=wrenches_in(wrenches, i))
        np.testing.assert_allclose(line.tip[i], one.pose.homogeneous, rtol=0, atol=1e-12)
        np.testing.assert_allclose(line.flexure_wrenches[i], one.wrenches, rtol=0, atol=1e-8)
        column = line.link_loads[i, line.link_names.index("tool")]
        np.testing.assert_allclose(column, one.compliance, rtol=0, atol=1e-12)
        np.testing.assert_allclose(line.joints[i], one.total_jacobian, rtol=0, atol=1e-9)


def test_a_batch_is_proven_to_stay_under_loads_that_turn_with_their_links(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled code alone settles it, once, and no row's tangent is asked for: that took 70 times as long."""
    arm = bundled("heavy_six")
    solver = RowSolver(arm.loaded("p100"), pushes(("tool",), 50, "frame"))
    assert solver.bound is not None and solver.bound.proven
    monkeypatch.setattr("armflex.mechanics.many_rows.responded", None)
    monkeypatch.setattr(RowSolver, "_in_rounds", None)
    arm.deflection(positions(arm, 50), "p100", wrenches=pushes(("tool",), 50, "frame"))


def test_wrenches_for_other_rows_are_refused() -> None:
    arm = bundled("heavy_six")
    q, three = positions(arm, 2), Wrench("tool", np.ones((3, 3)), np.zeros(3))
    assert three.moment.shape == (3, 3)
    for ask in (
        lambda: arm.deflection(q, wrenches=[three]),
        lambda: arm.deflection(q[0], wrenches=[three]),
        lambda: arm.deflection(q[0], v=np.zeros(6), wrenches=[three]),
        lambda: arm.deflection(q[0], a=np.zeros(6), wrenches=[three]),
        lambda: arm.prepared(wrenches=[three]),
        lambda: respond(arm, q, ["none"] * 2, wrenches=[three]),
    ):
        with pytest.raises(ShapeError, match=r"wrench at 'tool': expected force and moment .*, got \(3, 3\)"):
            ask()
    with pytest.raises(ShapeError, match=r"moment: expected shape \(3, 3\), got \(2, 3\)"):
        Wrench("tool", np.ones((3, 3)), np.ones((2, 3)))


def pulled(rows: list[dict[str, object]], **columns: object) -> list[dict[str, object]]:
    """Return rows with further columns, each a value or one per row."""
    return [row | {k: v[i] if isinstance(v, list) else v for k, v in columns.items()} for i, row in enumerate(rows)]


def test_forces_are_read_with_units_links_and_axes(heavy: Arm, tmp_path: Path) -> None:
    link, tip = heavy.link_names[3], heavy.robot.tip
    rows = pulled(
        campaign(4),
        force_fz_kN=["-0.5", "", "0", "0.1"],
        force_mx=["3", "", "0", "0"],
        force_frame=["", "", link, link],
        force_axes=["base", "", "", "link"],
    )
    found = read_measurements(written(tmp_path, rows), heavy)
    (first, second) = found.wrenches
    assert (first.frame, first.axes, second.frame, second.axes) == (tip, "base", link, "frame")
    np.testing.assert_allclose(first.force, [[0, 0, -500.0], [0, 0, 0], [0, 0, 0], [0, 0, 0]])
    np.testing.assert_allclose(first.moment[0], [3.0, 0.0, 0.0])
    np.testing.assert_allclose(second.force[3], [0.0, 0.0, 100.0])
    assert not found.covariates and not found.flags
    assert [len(found.some([row]).wrenches) for row in range(4)] == [1, 0, 0, 1]


def test_predict_bends_the_arm_by_the_forces_of_its_rows(heavy: Arm, tmp_path: Path) -> None:
    rows = pulled(campaign(3), force_fx=[100.0, 0.0, -50.0], force_axes=["link", "", "base"])
    found = predict(heavy, read_measurements(written(tmp_path, rows), heavy))
    for i, (force, axes) in enumerate(((100.0, "frame"), (0.0, "base"), (-50.0, "base"))):
        q = [rows[i][f"q_{name}"] for name in heavy.joint_names]
        one = heavy.deflection(q, wrenches=[Wrench("tool", [force, 0.0, 0.0], np.zeros(3), axes)])
        np.testing.assert_allclose(found.displacement[i], one.displacement, rtol=0, atol=1e-12)


def test_rows_that_differ_by_their_forces_are_no_repeats(heavy: Arm, tmp_path: Path) -> None:
    row = campaign(1)[0]
    path = written(tmp_path, [row | {"force_fz": force} for force in (0.0, -300.0, -300.0)])
    found = read_measurements(path, heavy)
    assert found.load_number.tolist() == [0, 1, 1] and duplicates(found).tolist() == [2]


def test_kilonewtons_are_questioned_where_the_table_is_read(heavy: Arm, tmp_path: Path) -> None:
    rows = pulled(campaign(3), force_fz=[0.0, -5e5, -5e5])
    found = read_measurements(written(tmp_path, rows), heavy)
    assert codes(found) == ["large_force"]
    assert (
        "rows.csv:3" in found.flags[0].text and "kN or kgf?" in found.flags[0].text and "2 rows" in found.flags[0].text
    )


BROKEN = {
    "link": (
        {"force_fx": 1.0, "force_frame": ["tool", "tol", "tool"]},
        r"rows.csv:3: force_frame: .*'tol', did you mean 'tool'",
    ),
    "axes": (
        {"force_fx": 1.0, "force_axes": "bas"},
        r"rows.csv:2: force_axes is 'bas', expected base or link, did you mean 'base'",
    ),
    "part": ({"force_fx": 1.0, "force_fy": [1.0, "", 2.0]}, r"rows.csv:3: only some of force_fx, force_fy are given"),
    "number": ({"force_fx": [1.0, "1,5N", 0.0]}, r"rows.csv:3: column 'force_fx' is '1,5N', not a finite number"),
    "unit": ({"force_fx_lbf": 1.0}, r"column 'force_fx_lbf': 'lbf' is no unit of force"),
    "name": ({"forcefx": 1.0}, r"unknown column 'forcefx', did you mean 'force_fx'"),
    "no force": ({"force_frame": "tool"}, r"rows.csv:1: has 'force_frame' but none of force_fx .. force_mz"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_force_is_refused_with_its_line(heavy: Arm, tmp_path: Path, name: str) -> None:
    columns, match = BROKEN[name]
    with pytest.raises(TableError, match=match):
        read_measurements(written(tmp_path, pulled(campaign(3), **columns)), heavy)


def test_a_load_is_its_own(tmp_path):
    force = np.array([10.0, 0.0, 0.0])
    load = Wrench("tool", force, np.zeros(3))
    force[0] = 1e6
    assert load.force[0] == 10.0
    with pytest.raises(ValueError, match="read-only"):
        load.force[0] = 1.0
