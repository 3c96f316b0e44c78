"""What `modes` says of uncertainties: that none is stated, or that some mode is not that of every likely arm."""

from pathlib import Path

import numpy as np
import pytest
from support.command_line import fine, run_here
from support.small_arms import ROBOTS, arm_of, joint, link

from armflex.cli.modes_command import print_modes


@pytest.mark.parametrize(
    ("std", "said"), [(None, "states no relative_std"), ([0.3, None], "not known of 1 modes"), ([0.3, 0.4], "")]
)
def test_a_stated_uncertainty_is_not_said_to_be_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], std: list[float | None] | None, said: str
) -> None:
    parts = [link("base"), link("arm", 50.0, (1.0, 0.0, 0.0), 5.0), link("tool")]
    parts += [joint("j", "base", "arm"), joint("f", "arm", "tool", (2.0, 0.0, 0.0), kind="fixed")]
    arm = arm_of(tmp_path, parts, "tool", {"j": np.diag([0.0, 0.0, 0.0, 0.0, 1e-6, 1e-6])})
    print_modes(arm.modes(np.zeros(1), count=2), std)
    text = " ".join(capsys.readouterr().out.split())
    assert (said in text) if said else ("not known" not in text)
    assert ("relative_std" in text) == (std is None)


def test_a_path_brings_its_own_positions(tmp_path: Path) -> None:
    """A cylinder's length is never zero: without positions it is taken in the middle of its limits, with a flag."""
    lifter = ROBOTS / "hybrid_lifter"
    rows = (lifter / "trajectory.csv").read_text().splitlines()[:2]
    (tmp_path / "t.csv").write_text("\n".join(rows) + "\n")
    done = fine(run_here(tmp_path, "modes", lifter / "arm.toml", "--traj", "t.csv", "--count", "2"))
    assert "not_at_zero" not in done.stderr
    assert "not_at_zero" in fine(run_here(tmp_path, "modes", lifter / "arm.toml", "--count", "2")).stderr
