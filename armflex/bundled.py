"""Where the robots that come with the package are."""

from __future__ import annotations

from pathlib import Path

from armflex.arguments import checked_kinds
from armflex.errors import UnknownNameError

ROBOTS = ("tarm_like", "heavy_six", "palletizer", "hybrid_lifter")


@checked_kinds
def bundled_robot(name: str) -> Path:
    """Return the folder of a bundled robot: in a checkout's `robots/`, or inside the installed package.

    Raises:
        UnknownNameError: No such robot.
    """
    if name not in ROBOTS:
        raise UnknownNameError("bundled robot", name, ROBOTS)
    package = Path(__file__).parent
    installed = package / "bundled" / name
    return installed if installed.is_dir() else package.parent / "robots" / name
