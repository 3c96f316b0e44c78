"""What `modes` says of uncertainties: that none is stated, or that some mode is not that of every likely arm."""

from pathlib import Path

import numpy as np
import pytest
from support.small_arms import arm_of, joint, link

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
