"""Pictures of concepts, drawn when the pages are built: the boom's own numbers where there are some."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
import pinocchio as pin

import armflex
from armflex.robot.urdf import drive_of

matplotlib.use("agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle

RIGID, FLEXED, LOAD, GREY = "#7a8699", "#c4502e", "#2a5d9c", "#444a55"
TIMES = 5.0
"""How much larger deflections are drawn."""


def draw(folder: Path) -> str:
    """Draw everything into a folder and return the pictures' names, one a line."""
    folder.mkdir(parents=True, exist_ok=True)
    drawn: dict[str, tuple[Callable[[Axes], None], tuple[float, float]]] = {
        "sag": (sag, (7.2, 4.2)),
        "flexure": (flexure, (7.2, 2.6)),
        "loop": (loop, (7.2, 2.7)),
        "verdict": (verdict, (7.2, 2.2)),
        "frames": (frames, (7.2, 3.0)),
    }
    for name, (function, size) in drawn.items():
        figure, axes = plt.subplots(figsize=size, layout="constrained")
        axes.set_axis_off()
        function(axes)
        figure.savefig(folder / f"{name}.png", dpi=150, facecolor="white")
        plt.close(figure)
    return "\n".join(drawn) + "\n"


def places(arm: armflex.Arm, q: np.ndarray, twists: np.ndarray) -> np.ndarray:
    """Return the (k, 3) places of the chain's joints and the tip, the flexures' twists in them."""
    pose, found = pin.SE3.Identity(), []
    named = dict(zip(arm.flexure_names, twists, strict=True))
    by_joint = {flexure.joint: named[flexure.name] for flexure in arm.flexures}
    position = dict(zip(arm.joint_names, q, strict=True))
    for joint in arm.robot.chain:
        pose = pose * pin.SE3(joint.rotation, joint.origin)
        pose = pose * pin.exp6(drive_of(joint) * position.get(joint.name, 0.0))
        pose = pose * pin.exp6(by_joint.get(joint.name, np.zeros(6)))
        found.append(pose.translation.copy())
    return np.array(found)


def sag(axes: Axes) -> None:
    """Draw the bundled boom from the side, rigid and flexed."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        arm = armflex.load_arm(armflex.bundled_robot("tarm_like") / "arm.toml")
        q = arm.position(M1=3.0, A3=0.5, A4=-0.5)
        found = arm.deflection(q, payload="p600")
    rigid, flexed = places(arm, q, 0.0 * found.twists), places(arm, q, TIMES * found.twists)
    away = np.hypot(*(rigid[-1] - rigid[0])[:2])
    along = (rigid[-1] - rigid[0])[:2] / away
    for points, colour, label in ((rigid, RIGID, "rigid"), (flexed, FLEXED, f"flexed, drawn {TIMES:g} times as large")):
        axes.plot(points[:, :2] @ along, points[:, 2], "-o", color=colour, lw=3, ms=5, label=label)
    at, top = flexed[-1][:2] @ along, flexed[-1][2]
    _arrow(axes, (at, top), (at, top - 1.6), LOAD)
    axes.text(at + 0.2, top - 1.1, "600 kg", color=LOAD, va="center")
    down = float(np.linalg.norm(found.displacement[:3])) * 1e3
    text = f"the tip is {down:.0f} mm from the rigid arm's"
    axes.text(rigid[-1][:2] @ along, rigid[-1][2] + 0.3, text, ha="right", color=GREY)
    axes.legend(frameon=False, loc="center")
    axes.set_aspect("equal")
    axes.set(xlim=(-1.5, at + 1.6), ylim=(top - 1.8, rigid[0][2] + 0.4))


def _arrow(axes: Axes, start: tuple, end: tuple, colour: str, text: str = "", at: tuple = (0.0, 0.0)) -> None:
    axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.8})
    if text:
        axes.text(*at, text, color=colour, ha="center", va="center")


def flexure(axes: Axes) -> None:
    """Draw where a flexure sits in a chain."""
    axes.set_xlim(0, 10)
    axes.set_ylim(-1.7, 1.7)
    axes.plot([0.2, 2.2], [0, 0], color=RIGID, lw=7, solid_capstyle="round")
    axes.add_patch(Circle((2.5, 0), 0.33, fc="white", ec=GREY, lw=2))
    axes.text(2.5, 0.75, "joint: moves by q", ha="center", color=GREY)
    spring = np.linspace(2.83, 4.3, 41)
    axes.plot(
        spring,
        0.16
        * np.sign(np.sin(6 * np.pi * (spring - 2.83) / 1.47))
        * (np.abs(np.sin(6 * np.pi * (spring - 2.83) / 1.47)) > 0.3),
        color=FLEXED,
        lw=2,
    )
    axes.text(3.6, -0.7, "flexure: gives by a twist\ntwist = law(wrench)", ha="center", va="center", color=FLEXED)
    turn = np.deg2rad(-7)
    end = (4.3 + 4.9 * np.cos(turn), 4.9 * np.sin(turn))
    axes.plot([4.3, 9.2], [0, 0], color=RIGID, lw=2, ls=(0, (4, 3)))
    axes.plot([4.3, end[0]], [0, end[1]], color=FLEXED, lw=7, solid_capstyle="round")
    axes.text(7.6, 0.35, "link of the rigid arm", color=RIGID, ha="center")
    _arrow(axes, end, (end[0], end[1] - 0.85), LOAD, "load", (end[0] + 0.4, end[1] - 0.5))
    _arrow(axes, (5.2, 1.45), (5.2, 0.15), LOAD, "wrench: the load on the structure", (6.9, 1.25))


def loop(axes: Axes) -> None:
    """Draw how a model and a machine come together."""
    axes.set_xlim(0, 12)
    axes.set_ylim(0, 4)
    boxes = {
        "declare": (0.1, "arm.toml + URDF\njoint laws, masses", GREY),
        "predict": (2.55, "predict\nwhere the tip is,\nhow surely", LOAD),
        "measure": (5.0, "measure\ntracker, wire,\ninclinometer", GREY),
        "calibrate": (7.45, "calibrate\nwhat [prior] frees", LOAD),
        "trace": (9.9, "trace\nthe effect that\nis missing", FLEXED),
    }
    for left, text, colour in boxes.values():
        axes.add_patch(
            FancyBboxPatch(
                (left, 1.75), 1.95, 1.5, boxstyle="round,pad=0.03,rounding_size=0.15", fc="white", ec=colour, lw=2
            )
        )
        axes.text(left + 0.98, 2.5, text, ha="center", va="center", color=colour, fontsize=8.5)
    for left in (2.13, 4.58, 7.03, 9.48):
        _arrow(axes, (left, 2.5), (left + 0.4, 2.5), GREY)
    axes.plot([10.9, 10.9, 3.5], [1.7, 0.7, 0.7], color=FLEXED, lw=1.8)
    _arrow(axes, (3.5, 0.7), (3.5, 1.7), FLEXED)
    axes.text(
        7.2,
        0.35,
        "the same arm.toml, with [calibration] and [[effect]]: every command uses it",
        ha="center",
        color=FLEXED,
        fontsize=9,
    )


def verdict(axes: Axes) -> None:
    """Draw the three verdicts of a check."""
    axes.set_xlim(0, 12)
    axes.set_ylim(-0.9, 4.2)
    axes.plot([8, 8], [-0.3, 3.6], color=GREY, lw=1.5, ls=(0, (4, 3)))
    axes.text(8, 3.85, "tolerance", ha="center", color=GREY)
    cases = (
        (3.0, 5.2, "ok", "#2f7d4f"),
        (2.0, 7.3, "uncertain: the tolerance is within 2 σ", "#b07a12"),
        (1.0, 9.8, "fail", FLEXED),
    )
    for height, at, text, colour in cases:
        axes.add_patch(Rectangle((0.2, height - 0.22), at - 0.2, 0.44, fc=colour, alpha=0.25, lw=0))
        axes.errorbar(at, height, xerr=1.1, fmt="o", color=colour, capsize=4, lw=2)
        axes.text(0.4, height, text, va="center", color=colour)
    axes.text(
        6.0,
        -0.25,
        "displacement of the tip from the rigid arm's, with two standard uncertainties",
        ha="center",
        color=GREY,
        fontsize=9,
    )


def frames(axes: Axes) -> None:
    """Draw the frames that a measurement goes through."""
    axes.set_xlim(0, 12)
    axes.set_ylim(0, 5)

    def triad(x: float, y: float, text: str, where: str = "below") -> None:
        axes.annotate("", (x + 0.8, y), (x, y), arrowprops={"arrowstyle": "-|>", "color": "#b03030", "lw": 1.8})
        axes.annotate("", (x, y + 0.8), (x, y), arrowprops={"arrowstyle": "-|>", "color": "#2a5d9c", "lw": 1.8})
        axes.text(
            x + 0.1, y - 0.35 if where == "below" else y + 1.05, text, ha="center", va="center", color=GREY, fontsize=9
        )

    axes.plot([1.4, 3.0, 5.4, 6.6], [1.2, 3.4, 3.9, 3.2], "-o", color=RIGID, lw=4, ms=7)
    triad(1.4, 1.2, "base")
    triad(6.6, 3.2, "tip frame", "below")
    axes.plot(7.7, 3.75, "o", color=FLEXED, ms=8)
    axes.plot([6.6, 7.7], [3.2, 3.75], color=FLEXED, lw=1)
    axes.text(7.85, 4.2, "target: `tool` in [prior]".replace("`", ""), color=FLEXED, fontsize=9)
    triad(10.2, 1.3, "instrument")
    axes.plot([10.2, 7.7], [1.3, 3.75], color=LOAD, lw=1.2, ls=(0, (4, 3)))
    axes.text(9.35, 2.5, "x y z as read", color=LOAD, fontsize=9)
    axes.annotate("", (9.9, 0.95), (2.4, 0.95), arrowprops={"arrowstyle": "<|-|>", "color": GREY, "lw": 1.2})
    axes.text(
        6.0,
        0.45,
        'found where frame = "unknown"; a session each: session_translation, session_rotation',
        ha="center",
        color=GREY,
        fontsize=8.5,
    )
