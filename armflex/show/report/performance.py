"""What the page of pose characteristics shows: texts, tables of them, and figures as SVG."""

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np

from armflex.show.report.cover import facts
from armflex.show.report.svg import AFTER, BEFORE, MUTED, canvas, cut, grid, inline
from armflex.show.report.words import measure, millimetres
from armflex.tasks.iso9283 import AttainedPose, Characteristic, PosePerformance

MOST_BARS = 40
"""Poses that the figure has room for; of more the worst are drawn, and it says so."""


def account(performance: PosePerformance) -> SimpleNamespace:
    """Return what the template shows."""
    arm, measurements, poses = performance.arm, performance.measurements, performance.poses
    (head, rows), cycles = table(performance), sum(pose.cycles for pose in poses)
    least = max(poses, key=lambda pose: pose.accuracy.value if pose.accuracy else 0.0)
    loosest = max(poses, key=lambda pose: pose.repeatability.value)
    accuracy, repeated = _said(least.accuracy), millimetres(loosest.repeatability.value)
    drawn = sorted(poses, key=lambda pose: -pose.accuracy.value if pose.accuracy else 0.0)[:MOST_BARS]
    more = f" The {MOST_BARS} least accurate of {len(poses)} are drawn." if len(poses) > MOST_BARS else ""
    return SimpleNamespace(
        title=f"{arm.robot.urdf.name}: pose characteristics after ISO 9283:1998",
        headline=f"Pose accuracy {accuracy}, pose repeatability {repeated}, each of the worst pose.",
        lead=[text for text in (*[text for text in performance.remarks[:1] if "AP" in text], more.strip()) if text],
        cards=tuple(_cards(performance, least, loosest)),
        head=head,
        poses=rows,
        rotations=tuple(
            (pose.pose, *(measure(angle, None, "rad") for angle in (*pose.rotation, *pose.rotation_repeatability)))
            for pose in poses
            if pose.rotation is not None and pose.rotation_repeatability is not None
        ),
        bars=_bars(drawn),
        worst=_scatter(loosest),
        worst_caption=f"Attained positions of {loosest.pose}, least repeatable, about their barycentre; circle: RP.",
        variations=tuple(
            (
                characteristic.pose,
                characteristic.of,
                str(characteristic.number),
                ("vAP " if characteristic.of == "directions" else "dAP ") + millimetres(characteristic.accuracy),
                "" if characteristic.repeatability is None else f"dRP {millimetres(characteristic.repeatability)}",
                millimetres(characteristic.shift),
            )
            for characteristic in (*performance.directions, *performance.drifts)
        ),
        remarks=performance.remarks,
        campaign=(*facts(arm, measurements, f"{cycles} cycles of {len(measurements)} rows driven"),),
        flags=[flag.text for flag in (*arm.flags, *measurements.flags)],
    )


def _cards(performance: PosePerformance, least: AttainedPose, loosest: AttainedPose) -> Iterator[tuple[str, str, str]]:
    """Yield each characteristic at its worst; of the poses the `least` accurate and the `loosest` in repeating."""
    poses = performance.poses
    if least.accuracy:
        yield "Pose accuracy AP", _said(least.accuracy), f"worst of {len(poses)}, {least.pose}"
    yield "Pose repeatability RP", _said(loosest.repeatability), f"worst of {len(poses)}, {loosest.pose}"
    if modelled := [pose.predicted for pose in poses if pose.predicted is not None]:
        note = "distance of barycentres from where the calibrated model has them, worst"
        yield "AP with this model", millimetres(max(modelled)), note
    for name, several in (("Direction vAP", performance.directions), ("Drift dAP", performance.drifts)):
        if several:
            worst = max(several, key=lambda characteristic: characteristic.accuracy)
            yield name, millimetres(worst.accuracy), f"worst of {len(several)}, {worst.pose}"


def table(performance: PosePerformance) -> tuple[list[str], tuple[tuple[str, ...], ...]]:
    """Return heads and rows, one for each pose."""
    modelled = any(pose.predicted is not None for pose in performance.poses)
    head = ["pose", "payload", "session", "cycles", "AP [mm]", "noise", "x [mm]", "y", "z", "RP [mm]", "of noise"]
    return head + ["AP with model"] * modelled, tuple(_row(pose, modelled) for pose in performance.poses)


def _said(characteristic: Characteristic | None) -> str:
    return "not stated" if characteristic is None else millimetres(characteristic.value, characteristic.std)


def _row(pose: AttainedPose, modelled: bool) -> tuple[str, ...]:
    """Return a row of the table, lengths in mm; an asterisk where directions are mixed."""

    def plain(*lengths: float | None) -> tuple[str, ...]:
        return tuple(millimetres(length).removesuffix(" mm") for length in lengths)

    cycles = f"{pose.cycles} (+ {pose.excluded} excluded)" if pose.excluded else str(pose.cycles)
    named = (pose.pose + " *" * (pose.direction is None), pose.payload, pose.session, cycles)
    about, again = (_said(figure).removesuffix(" mm") for figure in (pose.accuracy, pose.repeatability))
    sizes = (None,) * 4 if pose.accuracy is None or pose.offset is None else (pose.accuracy.instrument, *pose.offset)
    figures, model = plain(*sizes), plain(pose.predicted) if modelled else ()
    return (*named, about, *figures, again, *plain(pose.repeatability.instrument), *model)


def _bars(poses: list[AttainedPose]) -> str:
    """Return AP above and RP below, pose by pose."""
    figure, axes = canvas(10.0, 4.4, 2, 1, sharex=True)
    place = np.arange(len(poses))
    for panel, name, colour in zip(axes, ("accuracy", "repeatability"), (BEFORE, AFTER), strict=True):
        values = [getattr(pose, name) or Characteristic(0.0, None, None) for pose in poses]
        panel.bar(place, [1e3 * value.value for value in values], width=0.7, color=colour)
        std = [1e3 * (value.std or 0.0) for value in values]
        panel.errorbar(place, [1e3 * value.value for value in values], std, fmt="none", ecolor=MUTED, linewidth=1.0)
        panel.bar(place, [1e3 * (value.instrument or 0.0) for value in values], width=0.7, color=MUTED, alpha=0.6)
        grid(panel, "y")
        panel.set(ylabel="mm", title="AP" if name == "accuracy" else "RP")
    axes[-1].set_xticks(place, [cut(pose.pose, 10) for pose in poses], rotation=90 if len(poses) > 12 else 0)
    return inline(figure, "pose accuracy and repeatability")


def _scatter(pose: AttainedPose) -> str:
    """Return the attained positions of a pose about their barycentre, from three sides."""
    figure, axes = canvas(10.0, 3.4, 1, 3)
    apart, radius = 1e3 * (pose.attained - pose.attained.mean(axis=0)), 1e3 * pose.repeatability.value
    angle = np.linspace(0.0, 2.0 * np.pi, 90)
    for panel, (i, j) in zip(axes, ((0, 1), (0, 2), (1, 2)), strict=True):
        panel.plot(radius * np.cos(angle), radius * np.sin(angle), color=MUTED, linewidth=1.0)
        panel.scatter(apart[:, i], apart[:, j], s=14, color=AFTER, linewidths=0)
        panel.set(xlabel=f"{'xyz'[i]} [mm]", ylabel=f"{'xyz'[j]} [mm]", aspect="equal")
        grid(panel)
    return inline(figure, f"attained positions of {pose.pose}")
