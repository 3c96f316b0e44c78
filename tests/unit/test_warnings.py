"""What a flag says to those who do not look at flags is said once in a process, wherever it is asked from."""

import subprocess
import sys
from pathlib import Path

ASKED_TWICE = """
import armflex
one = armflex.load_arm("robots/tarm_like/arm.toml")
two = armflex.load_arm("robots/tarm_like/arm.toml")
urdf = armflex.load_arm("robots/tarm_like/robot.urdf", tip="tool")
again = armflex.load_arm("robots/tarm_like/robot.urdf", tip="tool")
"""


def test_a_warning_is_shown_once_in_a_process() -> None:
    folder = Path(__file__).parents[2]
    found = subprocess.run([sys.executable, "-c", ASKED_TWICE], capture_output=True, text=True, cwd=folder, timeout=600)
    assert found.returncode == 0, found.stderr
    said = [line.partition("ArmflexWarning: ")[2] for line in found.stderr.splitlines() if "ArmflexWarning" in line]
    assert any("rigid" in one for one in said) and len(set(said)) == len(said)
