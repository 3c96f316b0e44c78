"""URDF text and small arms that the tests build on; every part stands on a line of its own."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from armflex import Arm, Flexure
from armflex.laws import Law, LinearLaw
from armflex.robot import load_robot

ROBOTS = Path(__file__).parents[2] / "robots"
LIMIT = 'lower="-3" upper="3" effort="1e6" velocity="1"'


def spaced(values: Sequence[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def link(name: str, mass: float | str = 0.0, com: Sequence[float] = (0, 0, 0), moment: float = 0.1) -> str:
    """Return a link; without mass it has no <inertial>."""
    if not mass:
        return f'<link name="{name}"/>'
    inertia = f'<inertia ixx="{moment}" ixy="0" ixz="0" iyy="{moment}" iyz="0" izz="{moment}"/>'
    return f"""<link name="{name}">
<inertial>
<origin xyz="{spaced(com)}"/>
<mass value="{mass}"/>
{inertia}
</inertial>
</link>"""


def joint(
    name: str,
    parent: str,
    child: str,
    xyz: Sequence[float] = (0, 0, 0),
    rpy: Sequence[float] = (0, 0, 0),
    axis: Sequence[float] = (0, 1, 0),
    kind: str = "revolute",
    inside: str = "",
) -> str:
    """Return a joint."""
    moving = f'<axis xyz="{spaced(axis)}"/>\n<limit {LIMIT}/>' if kind != "fixed" else ""
    return f"""<joint name="{name}" type="{kind}">
<parent link="{parent}"/>
<child link="{child}"/>
<origin xyz="{spaced(xyz)}" rpy="{spaced(rpy)}"/>
{moving}
{inside}
</joint>"""


def robot(*parts: str) -> str:
    """Return the text of a URDF."""
    return "\n".join(('<robot name="r">', *parts, "</robot>"))


def write(folder: Path, text: str, name: str = "robot.urdf") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def line_of(text: str, marker: str) -> int:
    """Return the line, from 1, that holds a text which occurs once."""
    assert text.count(marker) == 1, f"{marker!r} occurs {text.count(marker)} times"
    return text[: text.index(marker)].count("\n") + 1


def arm_of(folder: Path, parts: Sequence[str], tip: str, laws: dict[str, Law | np.ndarray], **options: object) -> Arm:
    """Return an arm of URDF parts with a law, or a compliance, at each named joint."""
    loaded = load_robot(write(folder, robot(*parts)), tip, **options)
    flexures = [
        Flexure(name, name, LinearLaw(law) if isinstance(law, np.ndarray) else law) for name, law in laws.items()
    ]
    return Arm(loaded, tuple(flexures))


def one_joint(
    folder: Path,
    law: Law | np.ndarray,
    com: Sequence[float],
    mass: float = 2.0,
    tool: Sequence[float] = (1, 0, 0),
    **options: object,
) -> Arm:
    """Return one joint about y with a link of a given mass and CoM, and its tool."""
    parts = [
        link("base"),
        joint("j", "base", "body"),
        link("body", mass, com),
        joint("flange", "body", "tool", tool, kind="fixed"),
        link("tool"),
    ]
    return arm_of(folder, parts, "tool", {"j": law}, **options)


CROOKED = (
    link("base"),
    joint("yaw", "base", "column", (0.1, -0.05, 0.4), (0.1, 0.05, -0.2), (0, 0, 1)),
    link("column", 80.0, (0.05, 0.02, 0.2), 4.0),
    joint("pitch", "column", "upper", (0.1, 0, 0.5), (0, -0.3, 0.2), (0, 1, 0)),
    link("upper", 60.0, (0.5, 0.05, 0.02), 5.0),
    joint("roll", "upper", "fore", (1.0, 0.02, 0.1), (0.2, 0.1, 0), (0.6, 0, 0.8)),
    link("fore", 30.0, (0.3, -0.04, 0), 2.0),
    joint("flange", "fore", "tool", (0.6, 0.05, 0.1), (0, 0.4, 0), kind="fixed"),
    link("tool"),
)
"""Yaw, pitch and roll joints on oblique mounts, 2.2 m long."""


def three_joints(folder: Path, compliances: Sequence[Law | np.ndarray], **options: object) -> Arm:
    """Return the crooked arm with a law, or a compliance, at each of its joints."""
    return arm_of(folder, CROOKED, "tool", dict(zip(("yaw", "pitch", "roll"), compliances, strict=True)), **options)


def random_compliance(seed: int, softness: float = 1.0) -> np.ndarray:
    """Return a full symmetric positive definite (6, 6): about 1e-8 m/N and 1e-6 rad/Nm times `softness`."""
    mix = np.random.default_rng(seed).normal(size=(6, 6))
    size = np.sqrt(softness * np.array([1e-8] * 3 + [1e-6] * 3))
    return (mix @ mix.T / 6.0 + np.eye(6)) * np.outer(size, size)


def skew_parts(vector: Sequence[float]) -> np.ndarray:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def central_difference(function, at: np.ndarray, step: float) -> np.ndarray:
    """Return the (m, n) derivative of a vector function by central differences."""
    columns = []
    for i in range(len(at)):
        change = np.zeros(len(at))
        change[i] = step
        columns.append((function(at + change) - function(at - change)) / (2.0 * step))
    return np.array(columns).T


def standing(folder, softness: float, height: float, across: float = 0.0, law: Law | None = None) -> Arm:
    """Return a joint about y with 2 kg at a height above it (below it when negative)."""
    return one_joint(folder, law or LinearLaw(np.diag([1e-8] * 3 + [1e-6, softness, 1e-6])), (across, 0.0, height))
