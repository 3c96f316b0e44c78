"""What wanders in time: terms of a random walk, as on the campaign's clock, and what is left of it afterwards."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.compiled_arm import COMPILER, compiled
from support.effect_arms import plain

from armflex import Arm
from armflex.laws.effects import Effect, Location
from armflex.laws.effects.effect import full
from armflex.laws.effects.wandering import BASE_WANDERING, DRIVE_WANDERING, RATES, WALK_TERMS, walk_terms
from armflex.rows.period import Period

START, END = 100.0, 5000.0
SIZES = 1e-3 * np.random.default_rng(0).normal(size=WALK_TERMS)
EVERY = tuple(range(WALK_TERMS))


def walk(time: np.ndarray) -> np.ndarray:
    """Return the walk as it is asked for."""
    share = (time[:, None] - START) / (END - START)
    return np.sqrt(2.0) * np.sin(RATES * share) / RATES @ SIZES


def wandering(drive: bool) -> Arm:
    """Return an arm whose base or second drive wandered in a campaign."""
    law, site, axis = (DRIVE_WANDERING, "J2", "ry") if drive else (BASE_WANDERING, "base", "dx")
    location = Location(site, axis, ("time",), EVERY)
    effect = Effect(law, location, (*full(SIZES, location, WALK_TERMS), START, END), seen=(("time", START, END),))
    return replace(plain(), effects=(effect,), clock=(Period("a.csv", "0", START, END),))


def shift(arm: Arm, time: np.ndarray | None, count: int) -> np.ndarray:
    """Return (N,) by how much the base is shifted, or the drive turned."""
    covariates = {} if time is None else {"time": time}
    moved = arm.deflection(np.zeros((count, 6)), covariates=covariates).pose
    bare = plain().deflection(np.zeros(6)).pose.homogeneous
    there = np.linalg.inv(bare) @ moved
    turn = np.linalg.norm([there[:, 2, 1] - there[:, 1, 2], there[:, 0, 2] - there[:, 2, 0]], axis=0) / 2.0
    return np.hypot(np.linalg.norm(there[:, :3, 3], axis=1) * (turn < 1e-9), np.arcsin(turn))


def test_its_terms_are_those_of_a_random_walk() -> None:
    share = np.linspace(0.0, 1.0, 40)
    covariance = walk_terms(share) @ walk_terms(share).T
    # What the terms beyond the last would add is less than the sum over them of 2 / rate^2.
    np.testing.assert_allclose(covariance, np.minimum.outer(share, share), atol=2.0 / np.pi**2 / WALK_TERMS)


@pytest.mark.parametrize("drive", [False, True])
def test_on_its_clock_it_is_as_it_was(drive: bool) -> None:
    time = np.linspace(START, END, 301)
    alike = {"atol": np.abs(SIZES / RATES).sum() * 1e-3, "rtol": 5e-3 if drive else 0.0}  # loads turn with a drive
    np.testing.assert_allclose(shift(wandering(drive), time, len(time)), np.abs(walk(time)), **alike)
    ahead = wandering(drive).on_clock(50.0)  # rows are on a clock that is behind
    np.testing.assert_allclose(shift(ahead, time - 50.0, len(time)), np.abs(walk(time)), **alike)


def test_a_base_is_on_average_where_it_was_and_a_drive_where_it_came_to() -> None:
    time = np.linspace(START, END, 2001)
    base, drive = (shift(wandering(turns).left(), None, 1)[0] for turns in (False, True))
    assert base == pytest.approx(abs(walk(time).mean()), abs=0.02 * np.abs(walk(time)).max())
    assert drive == pytest.approx(abs(walk(time)[-1]), rel=5e-3)


@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")
def test_what_is_left_of_it_is_in_c(tmp_path: Path) -> None:
    arm, q = wandering(True).left(), np.random.default_rng(4).uniform(-1.0, 1.0, (20, 6))
    codes, poses = compiled(arm, tmp_path).tips(q, np.zeros(20, dtype=int))
    assert not codes.any()
    wanted = [arm.deflection(row).pose.homogeneous[:3] for row in q]
    np.testing.assert_allclose(poses, wanted, rtol=0, atol=1e-12)
