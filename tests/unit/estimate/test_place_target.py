"""A target is found with the frames of all sessions at once, and one that is where it is declared stays there."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armflex.estimate.seen_rows import place_target

SIGMA = 1e-4


@pytest.mark.parametrize(("lost", "sessions"), [(0.0, 1), (0.1, 1), (0.1, 3)])
@pytest.mark.parametrize("off", [np.zeros(3), np.array([0.1, 0.05, -0.03])])
def test_target_and_frames_are_found_beside_lost_beams(lost: float, sessions: int, off: np.ndarray) -> None:
    rng, shape = np.random.default_rng(3), (1, sessions, 40)
    points = rng.normal(size=(*shape, 3))
    axes = Rotation.random(sessions * 40, rng=np.random.default_rng(1)).as_matrix().reshape(*shape, 3, 3)
    frames = Rotation.random(sessions, rng=np.random.default_rng(2)).as_matrix()
    seen = (points + axes @ off) @ frames.swapaxes(1, 2) + rng.normal(size=(1, sessions, 1, 3))
    seen = seen + SIGMA * rng.normal(size=seen.shape)
    far = rng.random(shape) < lost
    seen[far] += 0.3
    placed = place_target(points, axes, seen, 0.2, rounds=20)
    assert placed.moved.tolist() == [bool(off.any())]
    np.testing.assert_allclose(placed.target[0], off, atol=2.0 * SIGMA)
    np.testing.assert_allclose(placed.turn[0], frames, atol=2.0 * SIGMA)
    assert np.abs(placed.left[~far]).max() < 6.0 * SIGMA


def test_columns_shift_the_arm_and_points_that_are_not_there_count_for_nothing() -> None:
    rng = np.random.default_rng(4)
    points, along = rng.normal(size=(1, 1, 40, 3)), np.array([0.6, 0.8, 0.0])
    axes = Rotation.random(40, rng=np.random.default_rng(1)).as_matrix()[None, None]
    column = rng.normal(size=(40, 1))
    column -= column.mean()
    counted = np.arange(40)[None] < 40
    ridden = points + column * along
    placed = place_target(points, axes, ridden, 0.2, counted, column, turn=None)
    np.testing.assert_allclose(placed.shifts[0, 0], [along], atol=1e-9)
    fixed = place_target(points, axes, ridden, 0.2, columns=column, turn=np.eye(3))
    np.testing.assert_allclose(fixed.shifts[0, 0], [along], atol=1e-9)
    seen = points.copy()
    seen[0, 0, 30:] = 1e3
    np.testing.assert_allclose(
        place_target(points, axes, seen, 0.2, np.arange(40)[None] < 30).left[0, 0, :30], 0.0, atol=1e-9
    )
