"""Figures of one effect: the residual along its own direction against its covariate, its hypotheses, its posterior."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from armflex.conventions import SHOWN, TWIST_NAMES, WRENCH_NAMES, Array
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import Act, DependsOn, Effect
from armflex.laws.effects.shapes import ABOVE, LAG
from armflex.show.report.svg import AFTER, BEFORE, INK, MARK, MUTED, RULE, canvas, cut, grid, inline
from armflex.show.report.words import labelled, measure, scaled, units_of, with_std
from armflex.trace.findings import Found, Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes


STRAIGHT = 1e-6
"""Share of a twist across its main direction below which it has one direction."""


@dataclass(frozen=True, eq=False)
class Suspicion:
    """Residuals of M readings along one effect's direction.

    Attributes:
        x: (M,) what it depends on.
        calibrated: (M,) residual before anything was added.
        without: (M,) residual with everything else fitted and only this effect left out.
        after: (M,) residual with the effect.
        effect: (M,) what the effect says.
        std: (M,) standard uncertainty of one reading along that direction.
        x_label, y_label: What the axes show, with units.
    """

    x: Array
    calibrated: Array
    without: Array
    after: Array
    effect: Array
    std: Array
    x_label: str
    y_label: str

    @property
    def is_curve(self) -> bool:
        """Whether the effect is a function of x alone."""
        order = np.lexsort((self.effect, self.x))
        x, y = self.x[order], self.effect[order]
        if len(kinds := np.unique(x)) > 8:
            rough = np.abs(y[1:-1] - 0.5 * (y[2:] + y[:-2]))
        else:
            rough = np.array([np.ptp(y[x == value]) for value in kinds])
        # Scatter of an effect about a curve, as a share of its range, below which it is drawn as one.
        return bool(len(rough) and np.quantile(rough, 0.9) <= 0.03 * np.ptp(y))


@dataclass(frozen=True, eq=False)
class EffectResponse:
    """How readings answer to one unit of an effect, and how much of it there is.

    Attributes:
        unit: (M, 3) change of a reading per unit [m].
        value: (M,) the effect in that unit.
        name: What the unit measures.
        base: 'rad' or 'm'.
    """

    unit: Array
    value: Array
    name: str
    base: str


def suspicion(trace: Trace, index: int) -> Suspicion:
    """Return the residuals along the direction of one found effect, counted rows only, in a unit that suits them."""
    effect, fit = trace.found[index].effect, trace.state.fit
    motion = motion_of(trace, effect)
    direction, x, x_label = _seen(trace, effect, motion)
    unit, where = direction.unit, fit.view.foremost
    sigma = fit.view.sigma[:, where]
    information = np.maximum((unit**2 / sigma**2).sum(axis=1), 1e-300)
    after = trace.state.residual[:, where]
    residuals = (trace.before.view.residual[:, where], after + motion, after)
    seen = [(unit / sigma**2 * residual).sum(axis=1) / information for residual in residuals]
    kept = trace.judged_rows & np.isfinite(direction.value)
    factor, name = scaled(float(np.quantile(np.abs(direction.value[kept]), 0.9)), direction.base)
    numbers = (array[kept] / factor for array in (*seen, direction.value, 1.0 / np.sqrt(information)))
    return Suspicion(x[kept], *numbers, x_label=x_label, y_label=f"{direction.name} [{name}]")


def motion_of(trace: Trace, effect: Effect) -> Array:
    """Return the (M, 3) change of the readings by an effect [m]."""
    view, context = trace.state.fit.view, trace.state.context
    return view.effect_jacobian(effect, context)[:, view.foremost] @ effect.acting


def _seen(trace: Trace, effect: Effect, motion: Array) -> tuple[EffectResponse, Array, str]:
    """Return the direction of an effect, what it depends on, and the label of that."""
    twist, axis = _twist(trace, effect)
    if ABOVE in effect.law.inner and (axis is None or effect.law.loaded):
        x, x_label = _suspect(trace, effect, None)
        # It grows with a temperature above its reference: its change with one kelvin less of that.
        place = effect.law.inner.index(ABOVE)
        lower = [value - (i == place) for i, value in enumerate(effect.inner)]
        moved = motion_of(trace, replace(effect, values=(*effect.amplitudes, *lower)))
        return _usual(trace, moved - motion, x - effect.inner[place]), x, x_label
    if axis is None:
        size = np.linalg.norm(motion, axis=1)
        unit = motion / np.maximum(size, 1e-300)[:, None]
        shown = trace.state.fit.view.readings.unit
        name, factor = SHOWN[shown]
        label = f"{'motion' if shown == 'm' else 'change'} that the effect predicts [{name}]"
        return EffectResponse(unit, size, "residual along it", shown), factor * size, label
    x, x_label = _suspect(trace, effect, axis)
    view = trace.state.fit.view
    unit, value = view.to_twist(effect.location.site)[:, view.foremost] @ axis, twist @ axis
    if np.any(axis[:3]) and np.any(axis[3:]):
        return _usual(trace, unit, value), x, x_label
    gain, per = _gain(trace, effect)
    name = f"{'rotation' if np.any(axis[3:]) else 'shift'} at the place{per}"
    return EffectResponse(unit * gain[:, None], value / gain, name, "rad" if np.any(axis[3:]) else "m"), x, x_label


def _usual(trace: Trace, unit: Array, value: Array) -> EffectResponse:
    """Return a direction in the unit of a typical reading: metres at the target, where that is read."""
    size = float(np.sqrt((unit**2).sum(axis=1).mean())) or 1.0
    return EffectResponse(
        unit / size, value * size, "residual along it,\nas in a typical reading", trace.state.fit.view.readings.unit
    )


def _twist(trace: Trace, effect: Effect) -> tuple[Array, Array | None]:
    """Return the (M, 6) twist of an effect and the one (6,) direction that it has, None where it has several."""
    law, state = effect.law, trace.state
    if law.act is not Act.TWIST:
        return np.zeros((0, 6)), None
    features = law.features(effect.location, effect.inner, state.fit.view, state.context)
    twist = np.einsum("mka,k->ma", features, effect.acting)
    _, sizes, directions = np.linalg.svd(twist, full_matrices=False)
    if sizes[0] == 0.0 or sizes[1] > STRAIGHT * sizes[0]:
        return twist, None
    axis = np.where(np.abs(directions[0]) > STRAIGHT, directions[0], 0.0)
    return twist, axis * np.sign(axis[np.abs(axis).argmax()])


def _gain(trace: Trace, effect: Effect) -> tuple[Array, str]:
    """Return what the effect is divided by, so that it depends on its column alone: the load, where it is a product."""
    location, law, rows = effect.location, effect.law, trace.state.rows
    is_product = (
        law.loaded and location.axis and location.covariates and not location.covariates[0].startswith("approach_")
    )
    if not is_product:
        return np.ones(len(rows)), ""
    load = trace.state.context.wrench(trace.state.fit.view, location.site)[rows, TWIST_NAMES.index(location.axis)]
    usual = float(np.median(np.abs(load))) or 1.0
    tiny = 1e-3 * usual
    gain = np.where(np.abs(load) < tiny, tiny, load) / usual
    kind = "Nm" if location.turns else "N"
    load = f"{usual / 1e3:.3g} k{kind}" if usual >= 1e3 else f"{usual:.3g} {kind}"
    return gain, f"\nunder its median load ({load})"


def _suspect(trace: Trace, effect: Effect, axis: Array | None) -> tuple[Array, str]:
    """Return (M,) what an effect depends on, and its label with unit."""
    state, location, law = trace.state, effect.location, effect.law
    rows, context = state.rows, state.context
    if law.memory:
        here, wrench = context.here(location, state.fit.setup.arm), context.wrench(state.fit.view, location.site)
        values = law.memory.over(context.pieces, here, wrench, context.row, effect.inner)[rows]
        if not location.covariates:
            return _loads(values, "m" if location.turns else "f", f"load {location.axis} that play passes on")
        name, lag = location.covariates[0], effect.named.get(LAG, 0.0)
        return values, f"{name}, {lag / 3600.0:.2g} h behind" if lag else name
    if location.covariates and not (law.loaded and location.covariates[0].startswith("approach_")):
        return _column(context, location.covariates[0], rows)
    if law.loaded and axis is not None:
        main = int(np.abs(axis).argmax())
        load = context.wrench(state.fit.view, location.site)[rows, main]
        return _loads(load, WRENCH_NAMES[main], f"load {WRENCH_NAMES[main]} at {location.place}")
    about_itself = location.place in context.joints and np.ptp(context.column(f"q_{location.place}")[rows]) > 0.0
    by_position = about_itself and law.depends_on is not DependsOn.NOTHING
    return _column(context, f"q_{location.place}" if by_position else "time", rows)


def _loads(values: Array, kind: str, label: str) -> tuple[Array, str]:
    unit = "Nm" if kind.startswith("m") else "N"
    return (values / 1e3, f"{label} [k{unit}]") if np.abs(values).max() >= 2e3 else (values, f"{label} [{unit}]")


def _column(context: Context, name: str, rows: np.ndarray) -> tuple[Array, str]:
    if name == "time" and not context.timed:
        return rows.astype(float), "row"
    values = context.column(name)[rows]
    if name in ("time", "hold"):
        return (values / 3600.0, f"{name} [h]") if values.max() > 7200.0 else (values, f"{name} [s]")
    kinds = {f"q_{joint.name}": "m" if joint.kind == "prismatic" else "rad" for joint in context.robot.moving}
    return values, f"{name} [{kinds[name]}]" if name in kinds else name


MOST_CURVES = 6
GOLDEN = 0.6180339887
FEW = 8
"""Values of a column up to which every one is a bin of its own."""


def against_suspect(trace: Trace, index: int) -> str:
    """Return the residual along an effect's direction against what it depends on: before, left out, and after."""
    seen = suspicion(trace, index)
    figure, axes = canvas(10.0, 3.3, 1, 3, sharey=True, sharex=True)
    panels = (
        ("Before: calibrated arm", seen.calibrated, BEFORE),
        ("All refitted without this effect", seen.without, BEFORE),
        ("After: with the effect", seen.after, AFTER),
    )
    for number, (panel, (title, values, colour)) in enumerate(zip(axes, panels, strict=True)):
        _cloud(panel, seen, values, colour)
        if number == 1 and seen.is_curve and len(np.unique(seen.x)) > FEW:
            order = np.argsort(seen.x)
            panel.plot(seen.x[order], seen.effect[order], color=MARK, linewidth=2.2, zorder=3)
        elif number == 1:
            size = 900 if seen.is_curve else 13
            panel.scatter(seen.x, seen.effect, s=size, marker="_", color=MARK, zorder=3)
        panel.axhline(0.0, color=MUTED, linewidth=0.8)
        panel.set_title(title)
        grid(panel)
    axes[0].set_ylabel(seen.y_label, fontsize=8.0)
    axes[1].set_xlabel(cut(seen.x_label, 60))
    good = seen.std <= 2.0 * np.median(seen.std)
    every = np.concatenate([values[good] for values in (seen.calibrated, seen.without, seen.after, seen.effect)])
    low, high = np.quantile(every, [0.003, 0.997])
    room = 0.08 * (high - low) + 1e-12
    axes[0].set_ylim(float(low - room), float(high + room))
    return inline(figure, f"Residual against its possible cause, effect {index + 1}")


def _cloud(panel: Axes, seen: Suspicion, values: Array, colour: str) -> None:
    """Draw every reading, fainter the less it informs, and means where the readings lie close."""
    faint = np.clip((np.median(seen.std) / seen.std) ** 2, 0.06, 1.0) * 0.45
    spread = np.zeros(len(seen.x))
    kinds = np.unique(seen.x)
    if len(kinds) <= FEW:
        even = np.arange(len(values)) * GOLDEN % 1.0 - 0.5  # no two neighbours alike, and the same every time
        spread = even * 0.4 * (np.diff(kinds).min() if len(kinds) > 1 else 1.0)
        panel.set_xticks(kinds)
    for level in np.unique(np.round(faint, 1)):
        at_level = np.round(faint, 1) == level
        x, y = seen.x[at_level] + spread[at_level], values[at_level]
        panel.scatter(x, y, s=9, color=colour, alpha=max(level, 0.08), linewidths=0)
    if seen.is_curve:
        panel.errorbar(*_means(seen, values), fmt="o", color=INK, markersize=4, elinewidth=1.2, capsize=2, zorder=4)


def _means(seen: Suspicion, values: Array) -> tuple[Array, Array, Array]:
    """Return centres, weighted means and their standard uncertainties in bins of x."""
    kinds = np.unique(seen.x)
    edges = kinds if len(kinds) <= FEW else np.unique(np.quantile(seen.x, np.linspace(0.0, 1.0, 13)))[:-1]
    place = np.clip(np.searchsorted(edges, seen.x, side="right") - 1, 0, len(edges) - 1)
    weight = seen.std**-2.0
    total = np.bincount(place, weight, len(edges))
    x, y = (np.bincount(place, weight * column, len(edges)) / total for column in (seen.x, values))
    scatter = np.bincount(place, weight * (values - y[place]) ** 2, len(edges)) / total
    count = np.bincount(place, minlength=len(edges))
    return x, y, np.sqrt(np.maximum(scatter / np.maximum(count - 1, 1), 1.0 / total * (count < 2)))


def ranking(found_effect: Found, number: int) -> str:
    """Return the log odds of what competes for the effect's place; what these data cannot distinguish is marked."""
    same = {(effect.law.name, effect.location) for effect, _ in found_effect.equivalent}
    key_of_effect = (found_effect.effect.law.name, found_effect.effect.location)
    bars: dict[str, tuple[float, str]] = {}  # of every candidate once, the best first
    for hypothesis, odds in found_effect.ranking:
        candidate = hypothesis.one
        key = (candidate.law.name, candidate.location)
        label = labelled(candidate.effect(np.zeros(len(candidate.location.terms))))
        bars.setdefault(label, (0.5 * odds, AFTER if key == key_of_effect else MARK if key in same else RULE))
    rows = list(bars.items())[:14][::-1]
    if not rows:
        return ""
    place = np.arange(len(rows))
    figure, (panel,) = canvas(8.4, 0.75 + 0.25 * len(rows))
    panel.barh(place, [evidence for _, (evidence, _) in rows], 0.66, color=[colour for _, (_, colour) in rows])
    for height, (_, (evidence, _)) in zip(place, rows, strict=True):
        panel.annotate(f"{evidence:.0f}", (max(evidence, 0.0), height), (4, 0), textcoords="offset points", va="center",
                       fontsize=7.5, color=MUTED)  # fmt: skip
    panel.set_yticks(place, [cut(label, 48) for label, _ in rows])
    panel.set_xlabel("log odds")
    panel.set_xlim(0.0, 1.08 * max(1.0, *(evidence for _, (evidence, _) in rows)))
    grid(panel, "x")
    return inline(figure, f"Ranking of the candidates, effect {number}")


def wave(trace: Trace, index: int) -> tuple[str, ...]:
    """Return amplitude and phase, 'name = value', of an effect of the shape A sin x + B cos x; nothing of others.

    It is C sin(x + phase), largest where x is 90 degrees less the phase; standard uncertainties to first order.
    """
    effect = trace.found[index]
    sine, _, rest = effect.effect.law.words.formula.removeprefix("A sin ").partition(" + B cos ")
    if not rest or rest != sine or not {"A", "B"} <= set(effect.effect.named):
        return ()
    amplitudes = np.array([effect.effect.named["A"], effect.effect.named["B"]])
    size = float(np.hypot(*amplitudes))
    names = [name for name in ("A", "B") if 0.0 < effect.std.get(name, 0.0) < np.inf]
    if size == 0.0:
        return ()
    fit, block = trace.state.fit, trace.state.effects[effect.index]
    start = sum(len(other.labels) for other in fit.blocks[: fit.blocks.index(block)])
    places = [start + list(effect.std).index(name) for name in names]
    covariance = np.zeros((2, 2))
    at = np.array([("A", "B").index(name) for name in names], dtype=int)
    covariance[np.ix_(at, at)] = fit.posterior.covariance[np.ix_(places, places)]
    scale = [effect.std[name] / np.sqrt(covariance[i, i]) for name, i in zip(names, at, strict=True)]
    covariance[np.ix_(at, at)] *= np.outer(scale, scale)  # as the page has them, the scatter of the readings counted
    along, across = amplitudes / size, np.array([-amplitudes[1], amplitudes[0]]) / size**2
    std, turn = (float(np.sqrt(direction @ covariance @ direction)) for direction in (along, across))
    degrees = with_std(float(np.degrees(np.arctan2(amplitudes[1], amplitudes[0]))), float(np.degrees(turn)))
    unit = units_of(effect.effect)["A"]
    return (
        f"amplitude = {measure(size, std, unit)} of C sin({sine} + phase)",
        f"phase = {'' if amplitudes[1] < 0.0 else '+'}{degrees.replace('-', '−')}°",
        *(
            f"{name} = {measure(effect.effect.named[name], effect.std.get(name), unit)}"
            for name, unit in units_of(effect.effect).items()
            if name not in ("A", "B")
        ),
    )


def posterior(trace: Trace, index: int) -> str:
    """Return the marginal distribution of every fitted parameter and, of the first two, their joint one."""
    effect = trace.found[index]
    units = units_of(effect.effect)
    names = [name for name in effect.std if 0.0 < effect.std[name] < np.inf]
    pair = len(names) >= 2
    if not 0 < len(names) <= MOST_CURVES:  # the knots of a free shape mean nothing one by one
        return ""
    figure, axes = canvas(min(10.0, 3.3 * (len(names[:3]) + pair)), 2.5 if len(names) <= 3 else 4.6,
                          1 if len(names) <= 3 else 2, min(len(names), 3) + pair)  # fmt: skip
    across = min(len(names), 3) + pair
    free = [panel for i, panel in enumerate(axes) if not (pair and i % across == across - 1)]
    for panel, name in zip(free, names, strict=False):
        _bell(panel, name, effect.effect.named[name], effect.std[name], units[name])
    for panel in free[len(names) :]:
        panel.set_axis_off()
    if pair:
        fit, block = trace.state.fit, trace.state.effects[effect.index]
        start = sum(len(other.labels) for other in fit.blocks[: fit.blocks.index(block)])
        row, other = (start + list(effect.std).index(name) for name in names[:2])
        covariance = fit.posterior.covariance
        rho = covariance[row, other] / (np.sqrt(covariance[row, row]) * np.sqrt(covariance[other, other]))
        _ellipse(axes[across - 1], effect, float(np.clip(rho, -0.999999, 0.999999)), units, names[:2])
        for panel in axes[2 * across - 1 :: across]:
            panel.set_axis_off()
    return inline(figure, f"Posterior of the parameters, effect {index + 1}")


def _bell(panel: Axes, name: str, value: float, std: float, unit: str) -> None:
    factor, shown = scaled(max(abs(value), std), unit)
    x = np.linspace(value - 4.0 * std, value + 4.0 * std, 161) / factor
    y = np.exp(-0.5 * ((x * factor - value) / std) ** 2)
    inside = np.abs(x * factor - value) <= std
    panel.fill_between(x, y, color=AFTER, alpha=0.15, linewidth=0)
    panel.fill_between(x[inside], y[inside], color=AFTER, alpha=0.3, linewidth=0)
    panel.plot(x, y, color=AFTER, linewidth=1.6)
    panel.set_title(f"{name} = {measure(value, std, unit)}", fontsize=8.5)
    panel.set_xlabel(f"{name} [{shown}]" if shown else name)
    panel.set_yticks([])
    panel.set_ylim(bottom=0.0)
    panel.spines["left"].set_visible(False)
    panel.locator_params(axis="x", nbins=5)


def _ellipse(panel: Axes, effect: Found, rho: float, units: dict[str, str], names: list[str]) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    circle = np.linalg.cholesky(np.array([[1.0, rho], [rho, 1.0]])) @ np.array([np.cos(angle), np.sin(angle)])
    values = [effect.effect.named[name] for name in names]
    scales = [scaled(max(abs(v), effect.std[n]), units[n]) for v, n in zip(values, names, strict=True)]
    for reach, alpha in ((np.sqrt(5.991), 0.15), (np.sqrt(2.296), 0.3)):
        edge = [
            (value + effect.std[name] * reach * line) / factor
            for value, name, line, (factor, _) in zip(values, names, circle, scales, strict=True)
        ]
        panel.fill(*edge, color=AFTER, alpha=alpha, linewidth=0)
    panel.plot(values[0] / scales[0][0], values[1] / scales[1][0], "+", color=INK)
    panel.set_title(f"68 % and 95 %, correlation {rho:.2f}", fontsize=8.5)
    panel.set_xlabel(f"{names[0]} [{scales[0][1]}]" if scales[0][1] else names[0])
    panel.set_ylabel(f"{names[1]} [{scales[1][1]}]" if scales[1][1] else names[1])
    panel.locator_params(nbins=5)
    grid(panel)
