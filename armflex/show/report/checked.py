"""What the page of a checked path shows: every via-point with its margin, a picture, and what it all rests on."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array, number
from armflex.errors import ArmflexError, listing, naming
from armflex.mechanics.deflection import Deflection
from armflex.show.report.svg import AFTER, BEFORE, DASHED, INK, MARK, MUTED, canvas, cut, grid, inline, label
from armflex.show.report.words import MADE_WITH, millimetres
from armflex.show.view.arm_scene import Motion, nice_magnification
from armflex.tasks.check import CheckReport, Point
from armflex.tasks.settle import ModesAt, Settling, SettlingReport, modes_along, settle
from armflex.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {"ok": AFTER, "uncertain": MARK, "fail": BEFORE}

MOST = 60
"""Via-points that a figure has room for."""


@dataclass(frozen=True)
class CheckedPath:
    """A path that was checked, with all that its page says.

    Attributes:
        arm: The arm.
        path: The path as it was checked, with its loads.
        report: Of `check`.
        within: Distance from rest up to which the tip counts as settled [m].
        covariates: What the arm's effects depend on and no column gives.
        files: What was read, by what it is: arm, path, desired path.
        swing: Of `settle` where that is known already.
    """

    arm: Arm
    path: Trajectory
    report: CheckReport
    within: float
    covariates: Mapping[str, float] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    swing: SettlingReport | None = None


def account(checked: CheckedPath) -> SimpleNamespace:
    """Return what the template shows."""
    arm, report = checked.arm, checked.report
    points = report.via_points or tuple(sorted(report.rows, key=lambda point: point.badness))[:MOST]
    swing, modes, left = _swings(checked)
    frequencies = {(modes_at.name, modes_at.time): modes_at for modes_at in modes}
    settled = {(point.name, point.time): point for point in swing.via_points} if swing else {}
    worst, moves = report.path_worst, "off by" if checked.path.is_moved or "desired path" in checked.files else "moves"
    asked = report.asked
    verdict = "within" if report.ok else "NOT within" if worst.verdict == "fail" else "not certain to be within"
    where = f"at {worst.name}" if worst.name else f"between via-points, at {worst.time:g} s"
    cards = (
        ("Largest displacement", millimetres(worst.displacement_m, worst.sigma_m), where),
        ("Smallest margin", millimetres(min(point.margin_m for point in (*points, worst))), f"of {asked}"),
        *_slowest(modes, swing, checked.within),
    )
    angle = report.angle_rad is not None
    by_row = report.by_row
    head = [
        "via-point",
        "time s",
        "payload",
        f"{moves} mm",
        *(["allowed mm"] * by_row),
        "margin mm",
        "turns mrad",
        *(["margin mrad"] * angle),
    ]
    rows = tuple(
        _row(point, by_row, frequencies.get((point.name, point.time)), settled.get((point.name, point.time)))
        for point in points
    )
    flags = dict.fromkeys((*arm.flags, *report.flags, *(swing.flags if swing else ())))
    return SimpleNamespace(
        title=f"{arm.robot.urdf.name}: loaded path against {asked}",
        headline=f"The path is {verdict} {asked}.",
        lead=(
            f"{len(report.via_points) or 'No'} via-points and the path between them, {report.samples} configurations. "
            "The displacement is that of the loaded tip from where "
            + ("it is meant to be." if moves == "off by" else "the rigid arm would have it."),
            *([] if report.via_points else [f"The path names no via-points: its {len(points)} worst rows are listed."]),
            *(
                f"{point.name or 'between'} at {point.time:g} s: {point.reason}."
                for point in (*points, worst)
                if point.reason
            ),
        ),
        cards=cards,
        picture=_picture(checked, points),
        bars=_bars(points),
        head=[*head, "verdict", "cause", "first frequency Hz", "settles in s", "peak mm"],
        points=rows,
        worst=(_row(worst, by_row, None, None)[: len(head) + 2],),
        worst_head=[*head, "verdict", "cause"],
        left=left,
        campaign=_rests_on(checked, asked),
        flags=[flag.text for flag in flags],
    )


def _slowest(modes: Sequence[ModesAt], swing: SettlingReport | None, within: float) -> Iterator[tuple[str, str, str]]:
    """Yield the cards of the slowest mode and of the longest settling."""
    slow = min((at for at in modes if len(at.frequencies)), key=lambda at: at.frequencies[0], default=None)
    if slow is not None:
        yield "Slowest first frequency", f"{slow.frequencies[0]:.3g} Hz", f"at {slow.name}"
    if swing and swing.via_points:
        last = max(swing.via_points, key=lambda point: point.settle_s)
        note = f"until within {within * 1e3:g} mm, at {last.name or 'the last row'}"
        if last.settle_s > 0.0:
            yield "Longest settling", f"{number(last.settle_s, 3)} s", note
        else:
            yield "Longest settling", "none", f"no via-point swings by more than {within * 1e3:g} mm"


def _swings(checked: CheckedPath) -> tuple[SettlingReport | None, tuple[ModesAt, ...], str]:
    """Return how the arm swings at the via-points, and why that is not known where it is not."""
    try:
        modes = modes_along(checked.arm, checked.path, checked.covariates, 1)
        return checked.swing or settle(checked.arm, checked.path, checked.within, checked.covariates), modes, ""
    except ArmflexError as error:
        return None, (), f"First frequencies and settling times are not computed: {error}"


def _row(point: Point, by_row: bool, modes: ModesAt | None, swing: Settling | None) -> tuple[str, ...]:
    """Return the cells of a via-point; lengths in mm, angles in mrad."""
    return (
        point.name or "between",
        f"{point.time:g}",
        point.payload,
        millimetres(point.displacement_m, point.sigma_m).removesuffix(" mm"),
        *([number(point.tolerance_m * 1e3)] if by_row else []),
        number(point.margin_m * 1e3, 3),
        number(point.rotation_rad * 1e3, 3),
        *([] if point.margin_rad is None else [number(point.margin_rad * 1e3, 3)]),
        point.verdict,
        point.cause or "none",
        "–" if modes is None or not len(modes.frequencies) else f"{modes.frequencies[0]:.3g}",
        "–" if swing is None else number(swing.settle_s, 3),
        "–" if swing is None else number(swing.peak_m * 1e3, 3),
    )


def _picture(checked: CheckedPath, points: tuple[Point, ...]) -> str:
    """Return the arm at its worst via-point, rigid and flexed, and the path of its rigid tip: from side and above."""
    arm = checked.arm
    path = checked.path.with_constants(arm, checked.covariates).prepared(arm)
    row = int(np.argmin(np.abs(path.time - points[0].time)))

    def at(i: int) -> Deflection:
        with naming(path.where(i)):
            return arm.deflection(path.q[i], path.payload[i], **path.asked(i), enforce_limits=False)

    try:
        here = at(row)
        rows = np.unique(np.linspace(0, len(path) - 1, 120).astype(int)).tolist()  # enough to show a path
        tips = np.array([at(i).link_poses(0.0)[arm.robot.tip][:3, 3] for i in rows]) @ arm.robot.mount.T
        named = {point: at(int(np.argmin(np.abs(path.time - point.time)))) for point in points[:MOST]}
    except ArmflexError as error:  # a joint beyond its limit, an arm that buckles
        return f"<p>No picture: {cut(str(error), 200).replace('<', '(').replace('&', '+')}</p>"
    factor = nice_magnification(arm, Motion(np.zeros(1), (here,), 0))
    figure, axes = canvas(10.0, 4.6, 1, 2)
    names: dict[Axes, list[tuple[str, tuple[float, float]]]] = {panel: [] for panel in axes}
    for panel, up, name in zip(axes, (2, 1), ("from the side", "from above"), strict=True):
        panel.plot(tips[:, 0], tips[:, up], color=MUTED, linewidth=1.0)
        for scale, colour, style in ((0.0, MUTED, DASHED), (factor, INK, "solid")):
            for line, width in _lines(here, scale):
                style_of = {"color": colour, "linestyle": style, "marker": "o", "markersize": 3}
                panel.plot(line[:, 0], line[:, up], linewidth=width, **style_of)
        for point, stands in named.items():
            tip = arm.robot.mount @ stands.link_poses(0.0)[arm.robot.tip][:3, 3]
            panel.plot(tip[0], tip[up], "o", color=COLOURS[point.verdict], markersize=6)
            if point.name and len(named) <= 12:
                names[panel].append((cut(point.name, 18), (float(tip[0]), float(tip[up]))))
        panel.set(xlabel="x [m]", ylabel=f"{'xyz'[up]} [m]", title=name, aspect="equal")
        panel.set_adjustable("datalim")
        grid(panel)
    axes[0].set_title(f"from the side, at {cut(points[0].name or f'{points[0].time:g} s')}, bent {factor:g} times")
    for panel, placed in names.items():
        label(panel, placed)
    return inline(figure, "the arm at its worst via-point")


def _lines(deflection: Deflection, factor: float) -> Iterator[tuple[Array, float]]:
    """Yield (k, 3) points of lines in a level world [m], and their width: the chain, what loops hold, and thick ties.

    The chain is the origins of its links from base to tip, a link beside it the way from its joint to its pin.
    """
    arm, poses = deflection.arm, deflection.link_poses(factor)
    robot = arm.robot

    def at(link: str, point: Array) -> Array:
        pose = poses.get(link, np.eye(4))
        return robot.mount @ (pose[:3, :3] @ point + pose[:3, 3])

    origin, chain = np.zeros(3), {robot.base, *(joint.child for joint in robot.chain)}
    yield np.array([robot.mount @ origin, *(at(joint.child, origin) for joint in robot.chain)]), 1.6
    for joint in robot.linkage.beside:
        yield np.array([at(joint.parent, origin), at(joint.child, origin)]), 1.0
    for loop in robot.linkage.loops:
        for link, pin in ((loop.link, loop.at), (loop.to, loop.at_to)):
            if link not in chain:
                yield np.array([at(link, origin), at(link, pin)]), 1.0
    for tie in (*robot.linkage.cylinders, *arm.springs):
        yield np.array([at(tie.link, tie.at), at(tie.to, tie.at_to)]), 4.0


def _bars(points: tuple[Point, ...]) -> str:
    """Return the displacement of every via-point beside the tolerance, in the order of the path."""
    shown = sorted(points[:MOST], key=lambda point: point.time)
    figure, (axes,) = canvas(10.0, 2.8)
    place = np.arange(len(shown))
    finite = [min(1e3 * point.displacement_m, 1e6) for point in shown]
    axes.bar(place, finite, width=0.6, color=[COLOURS[point.verdict] for point in shown])
    std = [2e3 * point.sigma_m if point.sigma_m is not None and np.isfinite(point.sigma_m) else 0.0 for point in shown]
    axes.errorbar(place, finite, std, fmt="none", ecolor=INK, linewidth=1.0)
    allowed = [1e3 * point.tolerance_m for point in shown]
    axes.hlines(allowed, place - 0.5, place + 0.5, color=MUTED, linestyle=DASHED, linewidth=1.0)
    axes.set_xticks(place, [cut(point.name or f"{point.time:g} s", 12) for point in shown],
                    rotation=90 if len(shown) > 12 else 0)  # fmt: skip
    axes.set(ylabel="mm")
    grid(axes, "y")
    return inline(figure, "displacement of every via-point")


def _rests_on(checked: CheckedPath, asked: str) -> tuple[tuple[str, str], ...]:
    """Return what the verdict rests on: files, how the arm is known, loads, versions, date."""
    arm, path = checked.arm, checked.path
    if arm.certainty is not None:
        source = "calibrated: ± is of the fit to its campaign, and of the compliances that state a deviation"
    elif any(flexure.law.uncertain for flexure in arm.flexures):
        source = "as declared, not calibrated: ± is of the compliances that state a deviation"
    else:
        source = "as declared, not calibrated; no uncertainty is stated, so none is in the verdict"
    rows = [(f"File of the {what}", f"{name}{_sha256(name)}") for what, name in checked.files.items()]
    loads = f"payload {listing(dict.fromkeys(path.payload))}"
    sizes = (float(np.max(wrench.sizes[0], initial=0.0)) for wrench in path.wrenches if not wrench.hangs)
    pushed = max(sizes, default=0.0)
    loads += f", loads from outside up to {pushed:.4g} N" if pushed else ", no load from outside"
    effects = listing(effect.title for effect in arm.effects) if arm.effects else "none"
    damping = "0.01, assumed" if arm.damping_ratio is None else f"{arm.damping_ratio:g}"
    covariates = listing(f"{name} = {value:g}" for name, value in checked.covariates.items())
    return (
        ("Arm", f"{arm.robot.urdf.name}, {arm.robot.base} to {arm.robot.tip}"),
        ("How it is known", source),
        ("Effects beside the flexures", effects),
        *rows,
        ("Tolerance", asked),
        ("Loads", loads),
        *([("Taken as", covariates)] if checked.covariates else []),
        ("Uncertain", "the margin is within two standard uncertainties"),
        ("Swing", f"drives stop at the via-point; settled within {checked.within * 1e3:g} mm; damping ratio {damping}"),
        ("Made on", date.today().isoformat()),
        ("Made with", MADE_WITH),
    )


def _sha256(name: str) -> str:
    """Return the digest of a file, as a remark; nothing where it cannot be read again."""
    from pathlib import Path

    from armflex.storage.read_file import sha256_of

    try:
        return f", SHA-256 {sha256_of(Path(name))}" if Path(name).is_file() else ""
    except ArmflexError:
        return ""
