"""Figures of the whole: residuals in the workspace, errors by session and pose, places, parameters, what would show."""

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from armflex.conventions import TWIST_NAMES, Shown, shown_in
from armflex.estimate.identify import FittedParameter
from armflex.estimate.robust import outlier_limit
from armflex.readings import Readings
from armflex.show.report.accuracy import Accuracy
from armflex.show.report.svg import AFTER, BEFORE, DASHED, INK, MUTED, PAPER, RULE, canvas, cut, grid, inline
from armflex.show.report.words import words
from armflex.trace.findings import Smallest, Trace
from armflex.trace.unrecorded import RandomTwist, noticed_from


def workspace(trace: Trace) -> str:
    """Return the residual arrows before and after, from the side and from above, all in one scale.

    Where nothing was found there is no before: the views stand side by side.
    """
    fit = trace.state.fit
    kept, tip = trace.judged_rows, fit.view.line.tip
    points = fit.setup.instrument.in_base(tip, fit.view.sessions)[kept]
    before, after = (
        (residual[:, placed.view.foremost] @ placed.setup.instrument.pose.rotation)[kept]
        for placed, residual in ((trace.before, trace.before.view.residual), (fit, trace.state.residual))
    )
    span = max(float(np.ptp(points, axis=0).max()), 1e-3)
    size = float(np.quantile(np.linalg.norm(before, axis=1), 0.95)) or 1e-3
    scale = 0.09 * span / size  # length of a long residual arrow as a share of the workspace
    gravity = trace.arm.robot.gravity
    up = int(np.abs(gravity).argmax()) if np.any(gravity) else 2
    level = [axis for axis in range(3) if axis != up]
    wide = max(level, key=lambda axis: float(np.ptp(points[:, axis])))
    chain = np.vstack([fit.view.line.links[0, :, :3, 3], tip[0, :3, 3]])
    times = [(", before", before, BEFORE), (", after", after, AFTER)] if trace.found else [("", after, AFTER)]
    figure, axes = canvas(10.0, 7.6, 2, 2) if trace.found else canvas(10.0, 4.0, 1, 2)
    panels = iter(axes)
    for title, pair in (("From the side", [wide, up]), ("From above", level)):
        row = [(next(panels), when, arrows, colour) for when, arrows, colour in times]
        for panel, when, arrows, colour in row:
            x, y = points[:, pair].T
            panel.scatter(x, y, s=3, color=MUTED, alpha=0.5, linewidths=0)
            shape = {"scale_units": "xy", "scale": 1.0, "width": 0.0032, "headwidth": 3.6}
            panel.quiver(x, y, *(scale * arrows[:, pair]).T, angles="xy", color=colour, **shape)
            grid(panel)
            # The arm, faintly, in the first measured pose, for orientation.
            panel.plot(*chain[:, pair].T, "-o", color=MUTED, alpha=0.45, linewidth=2.2, markersize=3.5, zorder=0.5)
            panel.set(title=title + when, xlabel=f"{'xyz'[pair[0]]} [m]", ylabel=f"{'xyz'[pair[1]]} [m]")
        both = np.array([[*panel.dataLim.intervalx, *panel.dataLim.intervaly] for panel, *_ in row])
        low, high = both[:, [0, 2]].min(axis=0), both[:, [1, 3]].max(axis=0)
        room = 0.06 * (high - low).max()
        for panel, *_ in row:
            panel.set_aspect("equal", adjustable="box")
            panel.set_xlim(low[0] - room, high[0] + room)
            panel.set_ylim(low[1] - 2.5 * room, high[1] + room)  # below: room for the scale

    # The scale: a bar of 1, 2 or 5 times a power of ten of error.
    power = 10.0 ** np.floor(np.log10(size))
    length = float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= size))
    across, upwards = axes[0].get_xlim(), axes[0].get_ylim()
    x, y = across[0] + 0.03 * np.ptp(across), upwards[0] + 0.04 * np.ptp(upwards)
    axes[0].plot([x, x + scale * length], [y, y], color=INK, linewidth=2.0, solid_capstyle="butt")
    text = f"{1e3 * length:g} mm of error, drawn × {scale:.0f}"
    axes[0].text(x, y + 0.02 * np.ptp(upwards), text, fontsize=8.5, color=INK)
    return inline(figure, "Residual arrows in the workspace")


NORM = " (of norms; dashed: of each number)"
"""What is said of the size of errors of several numbers beside a line at the size of one."""


def by_instrument(trace: Trace) -> str:
    """Return what is left of the readings of every kind, a panel each, in its own unit and beside its own noise.

    Its numbers stand in the order in which they were read; none where a tracker's positions are all there is.
    """
    view, before, after = trace.state.fit.view, trace.before.view.residual, trace.state.residual
    kinds = [(kind, place) for kind, place in view.readings.placed if np.isfinite(kind.sigma).any()]
    if [kind.name for kind, _ in kinds] == [""]:
        return ""
    figure, axes = canvas(10.0, 0.7 + 1.5 * len(kinds), len(kinds), 1, sharex=True)
    judged = view.readings.where(trace.state.judged)
    sizes = [[rms for _, rms in judged.by_kind(errors)] for errors in (before, after, view.sigma)]
    parts = [dict(zip(view.readings.kinds, sizes_of, strict=True)) for sizes_of in sizes]
    for panel, (kind, place) in zip(axes, kinds, strict=True):
        unit, factor = kind.shown_in
        read = np.isfinite(kind.sigma)
        number = np.broadcast_to(view.rows[:, None], read.shape)[read]
        times = [(before, BEFORE, "before"), (after, AFTER, "after")] if trace.found else [(after, AFTER, "calibrated")]
        for residual, colour, word in times:
            panel.scatter(number, factor * residual[:, place][read], s=6, color=colour, linewidths=0, label=word)
        rows = view.rows[read.any(axis=1)]
        noise = factor * np.where(read, kind.sigma, 0.0).max(axis=1)[read.any(axis=1)]
        panel.plot(rows, noise, color=INK, linewidth=1.0, linestyle=DASHED, label="stated noise")
        panel.plot(rows, -noise, color=INK, linewidth=1.0, linestyle=DASHED)
        rms = [f"{factor * part[kind]:.3g}" for part in parts]
        said = f"{rms[0]} before, {rms[1]} after" if trace.found else f"{rms[1]} calibrated"
        panel.set_title(f"{kind.title}: RMS {said}, noise {rms[2]} {unit}{NORM if kind.dimension > 1 else ''}")
        panel.set_ylabel(unit)
        grid(panel, "y")
    axes[0].legend(loc="upper right", bbox_to_anchor=(1.0, 1.25), ncols=3)
    axes[-1].set_xlabel("row of the campaign")
    return inline(figure, "What is left of the readings of every instrument")


def by_session_and_pose(accurate: Accuracy, both: bool, unit: str | Shown) -> str:
    """Return held-out errors by session and by pose, in the unit shown: before and after, or after alone."""
    figure, (left, right) = canvas(10.0, 3.3, 1, 2, gridspec_kw={"width_ratios": [1, 2.6]}, sharey=True)
    shown, factor = shown_in(unit)
    sessions = accurate.by(accurate.sessions)
    place = np.arange(len(sessions))
    for side, which, colour in ((-0.2, 1, BEFORE), (0.2, 2, AFTER)) if both else ((0.0, 2, AFTER),):
        heights, stds = (
            factor * np.array([getattr(session[which], name) for session in sessions]) for name in ("rms", "std")
        )
        left.bar(place + side, heights, 0.36, color=colour)
        left.errorbar(place + side, heights, stds, fmt="none", ecolor=INK, elinewidth=0.9)
    left.set_title("By session")
    step = max(1, len(sessions) // 12)
    slanted = max(len(name) for name, *_ in sessions) > 5
    labels = [cut(name, 12) for name, *_ in sessions[::step]]
    left.set_xticks(place[::step], labels, rotation=40 if slanted else 0, ha="right" if slanted else "center")
    left.set_ylabel(f"RMS error, poses held out [{shown}]")

    poses = sorted(accurate.by(accurate.poses), key=lambda pose: -pose[1].rms)
    place = np.arange(len(poses))
    before, after = (factor * np.array([pose.rms for pose in either]) for either in list(zip(*poses, strict=True))[1:])
    if both:
        right.vlines(place, before, after, color=RULE, linewidth=1.0, zorder=1)
        right.scatter(place, before, s=11, color=BEFORE, linewidths=0, label="before")
    right.scatter(place, after, s=11, color=AFTER, linewidths=0, label="after" if both else "calibrated")
    right.plot([], [], color=INK, linewidth=1.0, linestyle=DASHED, label="stated noise")
    right.set_title("By pose, the worst before first" if both else "By pose, the worst first")
    if len(poses) <= 120 and all(len(name) <= 8 for name, *_ in poses):
        step = max(1, len(poses) // 24)
        right.set_xticks(place[::step], [name for name, *_ in poses[::step]], rotation=90, fontsize=6.5)
    else:
        right.set_xticks([])
        right.set_xlabel(f"{len(poses)} poses")

    for panel in (left, right):
        panel.axhline(factor * accurate.stated, color=INK, linewidth=1.0, linestyle=DASHED)
        grid(panel, "y")
    left.set_ylim(bottom=0.0)
    right.legend(loc="upper right", ncols=3)
    return inline(figure, "Errors by session and by pose")


def heat(trace: Trace, left: Sequence[RandomTwist]) -> str:
    """Return where a random twist would explain the residual, by site and axis: before and after, or once."""
    from matplotlib.patches import Rectangle

    sites = trace.state.context.sites
    noticed = noticed_from(len(trace.places))
    most = max([noticed, *(place.ratio for place in trace.places)])
    pairs = [("Before", trace.places), ("After", left)] if trace.found else [("", trace.places)]
    figure, axes = canvas(10.0 if trace.found else 6.0, 2.9, 1, len(pairs))
    for panel, (title, places) in zip(axes, pairs, strict=True):
        ratios = {(place.site, place.axis): place.ratio for place in places}
        for (column, site), (row, axis) in product(enumerate(sites), enumerate(TWIST_NAMES)):
            ratio = ratios.get((site, axis), 0.0)
            strength, corner = float(np.clip(ratio / most, 0.0, 1.0)), (column - 0.47, row - 0.47)
            for colour, alpha in ((RULE, 0.35), (BEFORE, strength)):
                panel.add_patch(Rectangle(corner, 0.94, 0.94, color=colour, alpha=alpha, linewidth=0))
            if ratio >= noticed:
                ink = PAPER if strength > 0.6 else INK
                panel.text(column, row, f"{ratio:.0f}", ha="center", va="center", fontsize=6.8, color=ink)
        panel.set(xlim=(-0.6, len(sites) - 0.4), ylim=(5.6, -0.6), title=title)
        panel.set_xticks(range(len(sites)), [cut(site, 14) for site in sites], rotation=60, ha="right", fontsize=7)
        panel.set_yticks(range(6), TWIST_NAMES)
        panel.tick_params(length=0)
        panel.spines[:].set_visible(False)
    return inline(figure, "Where the unexplained variance points")


def pulls(
    before: Sequence[FittedParameter],
    after: Sequence[FittedParameter],
    both: bool,
    words: Mapping[str, tuple[str, float]],
) -> str:
    """Return the parameters that moved most against their priors: before and after, or after alone.

    `words` are those of `in_dh_words`.
    """
    earlier = {parameter.name: abs(parameter.pull) for parameter in before}
    named = [words.get(parameter.name, (parameter.name,))[0] for parameter in after]
    pairs = [
        (name, earlier.get(parameter.name, abs(parameter.pull)), abs(parameter.pull))
        for name, parameter in zip(named, after, strict=True)
    ]
    chosen = sorted(pairs, key=lambda row: -max(row[1:]))[:12][::-1]
    place = np.arange(len(chosen))
    figure, (panel,) = canvas(7.6, 0.6 + 0.27 * max(len(chosen), 3))
    old, new = ([row[which] for row in chosen] for which in (1, 2))
    if both:
        panel.hlines(place, old, new, color=RULE, linewidth=1.4, zorder=1)
        panel.scatter(old, place, s=26, color=BEFORE, linewidths=0, label="before")
    panel.scatter(new, place, s=26, color=AFTER, linewidths=0, label="after" if both else None)
    panel.axvline(outlier_limit(1), color=INK, linewidth=1.0, linestyle=DASHED)
    panel.set_yticks(place, [cut(row[0]) for row in chosen])
    panel.set_xlabel("moved by so many standard deviations of its prior (dashed: surprising)")
    panel.set_xlim(left=0.0)
    grid(panel, "x")
    if both:
        panel.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    return inline(figure, "Parameters that moved most against their priors")


def detectable(smallest: Sequence[Smallest], noise: float, readings: Readings) -> str:
    """Return how small an effect of each law would have been seen in readings, from its best place to its worst."""
    from matplotlib.ticker import LogLocator, NullLocator

    rows = sorted(smallest, key=lambda shown_least: -shown_least.most)
    place = np.arange(len(rows))
    figure, (panel,) = canvas(8.4, 0.6 + 0.21 * max(len(rows), 3))
    unit, factor = readings.shown_in
    least, most = (factor * np.array([getattr(row, which) for row in rows]) for which in ("least", "most"))
    panel.hlines(place, least, most, color=AFTER, linewidth=4.0, alpha=0.45)
    panel.scatter(least, place, s=20, color=AFTER, linewidths=0)
    panel.scatter(most, place, s=20, color=AFTER, linewidths=0)
    panel.axvline(factor * noise, color=INK, linewidth=1.0, linestyle=DASHED)
    panel.set_xscale("log")
    panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    panel.xaxis.set_minor_locator(NullLocator())
    panel.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    panel.set_yticks(place, [words(row.effect).title for row in rows])
    panel.set_xlabel(f"RMS {readings.where_read}, best to worst place [{unit}] (dashed: noise)")
    grid(panel, "x")
    return inline(figure, "Smallest effects that would have been observable")
