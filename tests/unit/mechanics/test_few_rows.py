"""Few rows are answered by Pinocchio, so that a first question needs no compiling; both engines say the same."""

from __future__ import annotations

import numpy as np
import pytest
from support.arms import bundled, corrected, positions
from support.command_line import fine, run_apart
from support.small_arms import ROBOTS

from armflex import Arm, check, compensate, read_trajectory
from armflex.mechanics import many_rows

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
