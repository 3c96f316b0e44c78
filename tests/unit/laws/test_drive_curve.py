"""A curve over a drive's position: a sum of sines, of which it has the columns, the same in a file and in C."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.compiled_arm import COMPILER, compiled
from support.effect_arms import arm_and, plain

from armflex import Arm
from armflex.files.effect_file import effect_table
from armflex.laws.effects import Effect, Location
from armflex.laws.effects.drive_curve import DRIVE_CURVE, FINE, MOST_SINES
from armflex.laws.effects.effect import full
from armflex.laws.effects.in_arm import BoundTwist
from armflex.laws.effects.location import resolve
from armflex.laws.row import Row
from armflex.laws.terms import twist_of

LOW, HIGH = -2.0, 2.5
TERMS = (0, 1, 4, 11, 39)
SIZES = 1e-3 * np.array([1.0, -0.7, 0.4, 0.2, -0.05])


def curve(q: np.ndarray) -> np.ndarray:
    """Return the sum of sines that is asked for, zero beyond both ends."""
    share = np.clip((q - LOW) / (HIGH - LOW), 0.0, 1.0)
    return sum(size * np.sin((i + 1) * np.pi * share) for i, size in zip(TERMS, SIZES, strict=True))


def effect(joint: str, axis: str) -> Effect:
    location = Location(joint, axis, (f"q_{joint}",), TERMS)
    return Effect(DRIVE_CURVE, location, (*full(SIZES, location, MOST_SINES), LOW, HIGH))


def curved() -> Arm:
    """Return an arm with a curve about a drive's own axis and one about another."""
    return replace(plain(), effects=(effect("J2", "ry"), effect("J4", "rz")))


def test_it_is_the_sum_of_its_sines() -> None:
    arm, q = plain(), np.linspace(LOW - 0.5, HIGH + 0.5, 2000)
    row = Row(np.outer(q, np.ones(6)), arm.joint_index, {})
    bound = BoundTwist(effect("J2", "ry"), resolve(effect("J2", "ry").location, arm.robot, arm.flexures))
    done = twist_of(bound.terms(), np.zeros((len(q), 6)), row)
    wanted = curve(q)
    # A cubic of Catmull and Rom at h to the knot errs by h^3 / 24 of a sine, and less.
    most = np.abs(SIZES).max() * (np.pi / FINE) ** 3 / 24.0
    np.testing.assert_allclose(done[:, 4], wanted, atol=most)
    assert not done[:, [0, 1, 2, 3, 5]].any() and len(bound.terms()) == 1
    # Of each sine it is the same table: what a fit has as columns is exactly what the arm does.
    each = DRIVE_CURVE.twists(bound.here, np.zeros((len(q), 6)), row, (LOW, HIGH))
    np.testing.assert_allclose(SIZES @ each[:, list(TERMS), 4].T, done[:, 4], atol=1e-15)


def test_what_a_file_has_is_read_as_it_was(tmp_path: Path) -> None:
    import tomlkit

    text = "".join(f"\n[[effect]]\n{tomlkit.dumps(effect_table(one))}\n" for one in curved().effects)
    again = arm_and(tmp_path, text.replace("[parameters]", "[effect.parameters]"))
    assert [one.values for one in again.effects] == [one.values for one in curved().effects]
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (20, 6))
    np.testing.assert_array_equal(again.deflection(q).displacement, curved().deflection(q).displacement)
    assert np.abs(again.deflection(q).displacement - plain().deflection(q).displacement).max() > 1e-4


@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")
def test_it_is_in_c_as_it_is_here(tmp_path: Path) -> None:
    arm, q = curved(), np.random.default_rng(4).uniform(-1.0, 1.0, (20, 6))
    codes, poses = compiled(arm, tmp_path).tips(q, np.zeros(20, dtype=int))
    assert not codes.any()
    wanted = [arm.deflection(row).pose.homogeneous[:3] for row in q]
    np.testing.assert_allclose(poses, wanted, rtol=0, atol=1e-12)
