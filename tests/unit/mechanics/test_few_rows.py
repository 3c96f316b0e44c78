"""Few rows are answered by Pinocchio, so that a first question needs no compiling; both engines say the same."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.arms import bundled, corrected, crooked, positions
from support.command_line import fine, run_apart
from support.every_law import KNOWN, effects, laws_of
from support.small_arms import ROBOTS, random_compliance, three_joints

from armflex import Arm, Payload, Wrench, check, compensate, load_arm, read_trajectory
from armflex.laws import LinearLaw
from armflex.mechanics import many_rows
from armflex.mechanics.response import respond

EVERYTHING = ("displacement", "twists", "wrenches", "pose", "rigid_pose", "contributions", "drive_loads", "corrected")


@pytest.fixture
def cold(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that has not loaded the kernel, nor asked about a row."""
    monkeypatch.setattr(many_rows, "_loaded", [])
    monkeypatch.setattr(many_rows, "_rows", [0])


@pytest.mark.parametrize(
    "arm", [bundled("tarm_like"), bundled("heavy_six"), corrected(bundled("tarm_like"))], ids=["tarm", "six", "moved"]
)
@pytest.mark.parametrize("method", ["exact", "first_order"])
def test_few_rows_are_as_the_same_among_many(arm: Arm, method: str, cold: None, monkeypatch) -> None:
    q, payload = positions(arm, 12), next(iter(arm.payloads))
    few = arm.deflection(q, payload, method=method)
    assert not many_rows._loaded
    monkeypatch.setattr(many_rows, "LOADED_AFTER", 0)
    monkeypatch.setattr(many_rows, "COMPILED_AFTER", 0)
    many = arm.deflection(q, payload, method=method)
    assert (few.asked.few, many.asked.few) == (True, False)
    for name in EVERYTHING:
        found, expected = getattr(few, name), getattr(many, name)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * max(1.0, np.abs(expected).max()), err_msg=name)
    if method == "exact" and many.covariance is not None:
        np.testing.assert_allclose(few.covariance, many.covariance, rtol=1e-9, atol=1e-18)


RESPONSE = ("flexure_wrenches", "flexure_twists", "laws", "per_load", "tip", "links", "joints", "twists", "wrenches")
RESPONSE = (*RESPONSE, "link_loads", "gravity")


def everywhere(folder: Path) -> Arm:
    """Flexures at the base, at a fixed joint, before a joint, two at one joint; moved, with curved laws and pulls."""
    law = [LinearLaw(random_compliance(i, 2.0)) for i in range(6)]
    where = {"tip": ("flange", law[0]), "foot": (None, law[1]), "roll": ("roll", law[2])}
    return crooked(folder, where | {"end": ("slide", law[3], True), "again": ("roll", law[5])})


RESPONDING = {
    "tarm": lambda folder: bundled("tarm_like"),
    "learned": lambda folder: load_arm(ROBOTS / "tarm_like" / "learned.toml"),
    "six": lambda folder: corrected(bundled("heavy_six")),
    "everywhere": lambda folder: corrected(everywhere(folder)),
    "effects": lambda folder: replace(three_joints(folder, laws_of("effects")), effects=effects()),
}


@pytest.mark.parametrize("name", RESPONDING)
def test_few_rows_respond_as_the_same_among_many(name: str, tmp_path: Path, cold: None, monkeypatch) -> None:
    arm = RESPONDING[name](tmp_path)
    q, known = positions(arm, 5), {}
    if name == "effects":
        q, known = positions(bundled("heavy_six"), 5)[:, :3], {one: np.resize(value, 5) for one, value in KNOWN.items()}
    bodies = [Payload(15.0, [0.2, 0.1, 0.0]), "none"] * 2 + ["none"]
    end = arm.link_names[len(arm.link_names) // 2]
    pushed = [
        Wrench(arm.link_names[-1], [30.0, -20.0, 10.0], [1.0, 2.0, -3.0], axes="frame"),
        Wrench(end, [0.0, 9.0, 0.0]),
    ]
    few = respond(arm, q, bodies, known, wrenches=pushed)
    kept = few.some(np.array([3, 1])), few.of(end)
    asked = [{one: getattr(line, one) for one in RESPONSE} for line in (few, *kept)]
    assert not many_rows._loaded
    monkeypatch.setattr(many_rows, "COMPILED_AFTER", 0)
    monkeypatch.setattr(many_rows, "LOADED_AFTER", 0)
    many = respond(arm, q, bodies, known, wrenches=pushed)
    near = 1e-6 if name == "effects" else 1e-12  # tangents of effects are differences, which magnify rounding
    for found, line in zip(asked, (many, many.some(np.array([3, 1])), many.of(end)), strict=True):
        for one in RESPONSE:
            expected = getattr(line, one)
            far = near * np.abs(expected).max()
            np.testing.assert_allclose(found[one], expected, rtol=0, atol=far, err_msg=one)


def test_the_kernel_is_loaded_when_rows_add_up_and_compiled_when_they_are_many_more(cold: None, monkeypatch) -> None:
    class Kernel:
        kept = False

        def is_kept(self) -> bool:
            return self.kept

    stand_in = Kernel()
    monkeypatch.setattr(many_rows, "_imported", lambda: stand_in)
    assert not many_rows.kernel_pays(many_rows.LOADED_AFTER - 1)
    assert not many_rows.kernel_pays(1)
    stand_in.kept = True
    assert many_rows.kernel_pays(1)
    stand_in.kept = False
    assert not many_rows.kernel_pays(1) and many_rows.kernel_pays(many_rows.COMPILED_AFTER)


def test_parts_that_are_compiled_side_by_side_have_no_function_in_common(monkeypatch) -> None:
    """One would wait for the other, and say that another process compiles."""
    asked: list[str] = []

    @contextmanager
    def noted(*functions):
        asked.extend(one.__name__ for one in functions)
        yield

    monkeypatch.setattr("armflex.storage.kept_code.compiled_once", noted)
    for compiles in many_rows.compilations():
        compiles()
    assert sorted(asked) == ["respond_rows", "rest_rows", "rigid_tips", "solve_many", "solve_one"]


def test_a_path_is_compensated_and_checked_alike(cold: None, monkeypatch) -> None:
    arm = bundled("heavy_six")
    path = read_trajectory(ROBOTS / "heavy_six" / "trajectory.csv", arm)
    monkeypatch.setattr(many_rows, "LOADED_AFTER", 10**9)
    few, checked = compensate(arm, path), check(arm, path, 5e-3)
    assert not many_rows._loaded
    monkeypatch.setattr(many_rows, "LOADED_AFTER", 0)
    monkeypatch.setattr(many_rows, "COMPILED_AFTER", 0)
    many, expected = compensate(arm, path), check(arm, path, 5e-3)
    assert many_rows._loaded
    np.testing.assert_allclose(few.trajectory.q, many.trajectory.q, rtol=0, atol=1e-8)
    assert (checked.ok, checked.samples) == (expected.ok, expected.samples)
    assert checked.path_worst.displacement_m == pytest.approx(expected.path_worst.displacement_m, rel=1e-9)


@pytest.mark.parametrize("arguments", [("check", "--tolerance", "100mm"), ("compensate", "-o", "moved.csv")])
def test_a_first_command_compiles_nothing(tmp_path, arguments: tuple[str, ...]) -> None:
    name, *options = arguments
    files = [ROBOTS / "heavy_six" / file for file in ("arm.toml", "trajectory.csv")]
    ended = fine(run_apart(tmp_path, name, *files, *options, NUMBA_CACHE_DIR=str(tmp_path / "empty")))
    assert "compiling" not in ended.stderr and not list(tmp_path.rglob("*.nbc"))


@pytest.mark.slow
def test_a_first_calibration_of_few_rows_compiles_nothing(tmp_path: Path) -> None:
    rows = (ROBOTS / "tarm_like" / "campaign.csv").read_text().splitlines()
    some = [row for row in rows[1:] if ",,,," not in row][:20]  # read by the tracker
    (tmp_path / "some.csv").write_text("\n".join([rows[0], *some]))
    arm, cache = ROBOTS / "tarm_like" / "measured.toml", str(tmp_path / "empty")
    ended = fine(run_apart(tmp_path, "calibrate", arm, "some.csv", "-o", "fit.toml", NUMBA_CACHE_DIR=cache))
    assert "compiling" not in ended.stderr and not list(tmp_path.rglob("*.nbc"))


@pytest.mark.parametrize("name", ["tarm_like", "heavy_six"])
def test_the_engine_is_compiled_for_one_kind_of_arrays(name: str, monkeypatch) -> None:
    """An array in another order would be compiled for once more, wherever it comes, for a quarter of a minute."""
    monkeypatch.setattr(many_rows, "LOADED_AFTER", 0)
    monkeypatch.setattr(many_rows, "COMPILED_AFTER", 0)
    arm = bundled(name)
    path = read_trajectory(ROBOTS / name / "trajectory.csv", arm)
    check(arm, path, 0.1)
    compiled = many_rows.kernel()
    assert [len(one.signatures) for one in compiled.ENTRIES] == [1] * len(compiled.ENTRIES)
