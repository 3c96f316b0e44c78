"""A tracker that was moved between two halves of a campaign that says nothing of sessions."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.lost_campaign import SIGMA, write_arm, write_campaign

from armflex import load_arm, read_measurements, trace

SHIFT, TURN = np.array([2e-3, -1e-3, 1.5e-3]), np.array([4e-4, -6e-4, 8e-4])
STATION = np.array([2.1, -1.4, 0.9])


@pytest.mark.slow
def test_it_is_named_with_the_moment_at_which_it_was_moved(tmp_path: Path) -> None:
    """Without the law a shape at the base and slips of the first joint took its place, and left twice the noise."""
    arm = load_arm(write_arm(tmp_path))
    path, wrong = write_campaign(tmp_path, 0, 60)
    head, *lines = path.read_text().splitlines()
    rows = np.array([list(map(float, line.split(","))) for i, line in enumerate(lines) if i not in wrong])
    late = np.arange(len(rows)) >= len(rows) // 2
    turned = Rotation.from_rotvec(TURN).apply(rows[late, 6:9] - STATION) + STATION + SHIFT
    rows[late, 6:9] = turned
    rows = np.column_stack([rows, 60.0 * np.arange(len(rows))])
    path.write_text("\n".join([f"{head},time", *(",".join(map(repr, row)) for row in rows.tolist())]) + "\n")
    found = trace(arm, read_measurements(path, arm))
    (one,) = found.found
    assert one.effect.law.name == "instrument_moved"
    begun = one.effect.named["at"]
    assert 60.0 * (late.argmax() - 1) <= begun <= 60.0 * late.argmax()
    assert found.held_out[1] < 1.5 * np.sqrt(3.0) * SIGMA < 0.2 * found.held_out[0]
