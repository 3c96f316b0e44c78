"""Joint positions that a log counts within one turn are those of the joint's limits, and one line says so."""

import re
from dataclasses import replace

import numpy as np
from support.small_arms import ROBOTS

from armflex import load_arm
from armflex.arm import Arm
from armflex.measured.data_flags import turned_back


def limited(lower: float, upper: float) -> Arm:
    """Return a six-axis arm all of whose joints have such limits."""
    arm = load_arm(ROBOTS / "heavy_six" / "arm.toml")
    moving = {joint.name for joint in arm.robot.moving}
    chain = tuple(
        replace(joint, lower=lower, upper=upper) if joint.name in moving else joint for joint in arm.robot.chain
    )
    return replace(arm, robot=replace(arm.robot, chain=chain))


def positions(size: float) -> np.ndarray:
    return np.random.default_rng(0).uniform(-size, size, (50, 6))


def test_what_is_beyond_the_limits_is_taken_a_turn_back() -> None:
    q = positions(1.8)
    found, flag = turned_back(q % (2.0 * np.pi), limited(-3.1, 3.1))
    np.testing.assert_allclose(found, q, atol=1e-12)
    assert flag is not None
    counts = [int(count) for count in re.findall(r"q_J\d in (\d+) of 50 rows", flag.text)]
    assert counts == np.count_nonzero(q < 0.0, axis=0).tolist()


def test_a_joint_without_limits_is_cut_at_its_gap() -> None:
    q = positions(1.5)
    found, flag = turned_back(q % (2.0 * np.pi), limited(-np.inf, np.inf))
    np.testing.assert_allclose(found, q, atol=1e-12)
    assert flag is not None


def test_what_can_be_meant_is_left_as_it_is() -> None:
    for arm in (limited(-3.1, 3.1), limited(-np.inf, np.inf), limited(-6.2, 6.2)):
        for q in (
            positions(1.5),
            positions(3.14),
            positions(3.14) + np.pi if arm.robot.upper[0] > 3.2 else positions(2.9),
        ):
            assert turned_back(q, arm)[1] is None
    q = positions(1.5)
    q[3, 1] = 3.19  # measured a little outside
    assert turned_back(q, limited(-3.1, 3.1))[1] is None
