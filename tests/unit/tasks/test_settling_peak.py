"""The swing of a tip: its peak is where it is farthest off, whatever distance counts as settled."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.small_arms import arm_of, joint, link

from armflex import Arm, InputError, Trajectory
from armflex.tasks.settle import settle

UPRIGHT = (0.0, 0.0, 1.0)


@pytest.fixture
def beating(tmp_path: Path) -> Arm:
    """A light hand that swings as fast as the boom, so that it is farthest off long after the drives stop."""
    parts = [
        link("base"),
        link("boom", 100.0, (1.0, 0.0, 0.0), 30.0),
        link("hand", 0.05, (0.3, 0.0, 0.0), 5e-6),
        link("tool"),
        joint("slew", "base", "boom", axis=UPRIGHT),
        joint("wrist", "boom", "hand", (2.0, 0.0, 0.0), axis=UPRIGHT),
        joint("flange", "hand", "tool", (0.3, 0.0, 0.0), kind="fixed"),
    ]
    laws = {name: np.diag([0.0, 0.0, 0.0, 0.0, 0.0, 1.0 / k]) for name, k in (("slew", 47362.3), ("wrist", 1.60065))}
    return replace(arm_of(tmp_path, parts, "tool", laws), damping_ratio=0.01)


def stop(arm: Arm) -> Trajectory:
    time = np.linspace(0.0, 0.33, 21)
    q = np.column_stack([0.02 * (time / 0.33) ** 2, 0.0 * time])
    return Trajectory(arm.joint_names, time, q, ("none",) * len(time), ("",) * len(time))


def test_the_peak_does_not_depend_on_the_tolerance(beating: Arm) -> None:
    found = [settle(beating, stop(beating), within).via_points[-1] for within in (1e-5, 0.05, 0.5)]
    assert max(one.peak_m for one in found) == pytest.approx(min(one.peak_m for one in found), rel=1e-9)
    assert found[0].settle_s > found[1].settle_s > found[2].settle_s == 0.0
    assert found[0].peak_m > 0.12  # of the first period alone it is a third


def test_what_is_stated_is_not_asked_for(beating: Arm) -> None:
    slow = replace(beating, damping_ratio=1e-6)
    with pytest.raises(InputError, match=r"damping ratio of 1e-06: state a wider tolerance"):
        settle(slow, stop(slow), 1e-6)
