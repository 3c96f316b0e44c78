"""A residual seen along an effect's own direction, against what the effect depends on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from armflex.conventions import SHOWN, TWIST_NAMES, WRENCH_NAMES, Array
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import Act, Effect
from armflex.laws.effects.shapes import ABOVE, LAG
from armflex.show.report.numbers import scaled
from armflex.trace.findings import Trace

STRAIGHT = 1e-6
"""Share of a twist across its main direction below which it has one direction."""

FUNCTION = 0.03
"""Scatter of an effect about a curve, as a share of its range, below which it is drawn as one."""


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
        return bool(len(rough) and np.quantile(rough, 0.9) <= FUNCTION * np.ptp(y))


@dataclass(frozen=True, eq=False)
class Direction:
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
    after = trace.residual[:, where]
    residuals = (trace.before.view.residual[:, where], after + motion, after)
    seen = [(unit / sigma**2 * residual).sum(axis=1) / information for residual in residuals]
    kept = trace.believed & np.isfinite(direction.value)
    factor, name = scaled(float(np.quantile(np.abs(direction.value[kept]), 0.9)), direction.base)
    numbers = (array[kept] / factor for array in (*seen, direction.value, 1.0 / np.sqrt(information)))
    return Suspicion(x[kept], *numbers, x_label=x_label, y_label=f"{direction.name} [{name}]")


def motion_of(trace: Trace, effect: Effect) -> Array:
    """Return the (M, 3) change of the readings by an effect [m]."""
    view, context = trace.state.fit.view, trace.state.context
    return view.effect_jacobian(effect, context)[:, view.foremost] @ effect.acting


def _seen(trace: Trace, effect: Effect, motion: Array) -> tuple[Direction, Array, str]:
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
        return Direction(unit, size, "residual along it", shown), factor * size, label
    x, x_label = _suspect(trace, effect, axis)
    view = trace.state.fit.view
    unit, value = view.to_twist(effect.location.site)[:, view.foremost] @ axis, twist @ axis
    if np.any(axis[:3]) and np.any(axis[3:]):
        return _usual(trace, unit, value), x, x_label
    gain, per = _gain(trace, effect)
    name = f"{'rotation' if np.any(axis[3:]) else 'shift'} at the place{per}"
    return Direction(unit * gain[:, None], value / gain, name, "rad" if np.any(axis[3:]) else "m"), x, x_label


def _usual(trace: Trace, unit: Array, value: Array) -> Direction:
    """Return a direction in the unit of a typical reading: metres at the target, where that is read."""
    size = float(np.sqrt((unit**2).sum(axis=1).mean())) or 1.0
    return Direction(
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
    own = location.place in context.joints and np.ptp(context.column(f"q_{location.place}")[rows]) > 0.0
    return _column(context, f"q_{location.place}" if own and not law.constant else "time", rows)


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
