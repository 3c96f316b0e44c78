"""A machine over its calibrations: a jump, a drift, and nothing, each said as what it is."""

from pathlib import Path

import numpy as np
import pytest
from support import moved_machine
from support.command_line import fine, run_here
from support.moved_machine import Site

import armflex
from armflex.errors import InputError
from armflex.estimate.calibrate import calibrate
from armflex.estimate.calibrations import History, history

PRIOR = "joint_offset = 5e-3\ncompliance = 0.3\ntool = 0.005"


def over(folder: Path, zeros: list[float]) -> History:
    """Calibrate a machine whose second joint has these zeros [rad], one after the other."""
    arms = {}
    moved_machine.declare(folder, PRIOR)
    for i, zero in enumerate(zeros):
        site = {f"c{i}": Site(turn=0.4 * i)}
        file = moved_machine.measure(folder, site, {1: zero}, seed=30 + i)[0]
        arms[f"c{i}"] = calibrate(armflex.load_arm(folder / "arm.toml"), file).arm
    return history(arms, [10.0 * i for i in range(len(zeros))])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("zeros", "change", "since"),
    [([1e-3, 1e-3, 1e-3, 2e-3, 2e-3], "jump", 3), ([0.0, 5e-4, 1e-3, 1.5e-3, 2e-3], "drift", 0), ([1e-3] * 5, "", 0)],
)
@pytest.mark.filterwarnings("ignore:gravity_in:armflex.ArmflexWarning")
def test_what_changed_and_since_when(tmp_path: Path, zeros: list[float], change: str, since: int) -> None:
    found = over(tmp_path, zeros)
    changed = {one.parameter.label: one for one in found.changed}
    assert set(changed) == ({"joint_offset J2"} if change else set())
    if change:
        one = changed["joint_offset J2"]
        assert (one.change, one.since) == (change, since)
        assert one.size == pytest.approx(zeros[-1] - zeros[0], abs=4.0 * one.size_std)
        assert found.courses[0] is one
        assert [course.parameter.label for course, *_ in found.between(0, 4)] == ["joint_offset J2"]


def test_dates_ascend(tmp_path: Path) -> None:
    some = dict.fromkeys("ab", armflex.load_arm(moved_machine.declare(tmp_path, PRIOR)))
    with pytest.raises(InputError, match=r"expected dates that ascend, one for each of 2 calibrations, got \[3, 2\]"):
        history(some, [3, 2])
    with pytest.raises(InputError, match="expected two calibrations or more to compare, got 1"):
        history(dict.fromkeys("a", some["a"]), [0])


@pytest.mark.slow
def test_the_command_writes_a_page(tmp_path: Path) -> None:
    moved_machine.declare(tmp_path, PRIOR)
    for i, zero in enumerate([1e-3, 2.5e-3, 2.5e-3]):
        file = moved_machine.measure(tmp_path, {f"c{i}": Site(turn=0.4 * i)}, {1: zero}, seed=40 + i)[0]
        fine(run_here(tmp_path, "calibrate", "arm.toml", file.name, "-o", f"a{i}.toml"))
    dates = ("--dates", "2026-01-10,2026-02-11,2026-04-01")
    out = fine(run_here(tmp_path, "history", "a0.toml", "a1.toml", "a2.toml", *dates, "-o", "h.html")).stdout
    assert "joint_offset J2" in out
    assert "since 2026-02-11" in out
    page = (tmp_path / "h.html").read_text()
    assert "since 2026-02-11" in page
    assert np.char.count(page, "<svg") >= 1
    wrong = run_here(tmp_path, "history", "a0.toml", "a1.toml", "--dates", "2026-02-11,2026-01-10")
    assert "dates that ascend" in wrong.stderr
