"""What the true machine does and its declaration does not say: how an effect is drawn and how it pushes.

An effect pushes at the plant in proportion to its amplitude, which the campaign scales; everything else about it is
drawn here, relative to the calm arm: which joint, which axis, which constants.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from support.plant import Array, Joint, Plant, Push, Rows, State

AXES = ("dx", "dy", "dz", "rx", "ry", "rz")
REFERENCE = 20.0  # degC
LARGEST = 5e-3  # rad; four times as many m: a twist beyond it is no undeclared effect but a broken arm
Shape = Callable[[State], Array]
Numbers = dict[str, float | str]


class Redraw(Exception):
    """This site, axis or constant cannot matter: draw again."""


@dataclass
class Effect:
    """One undeclared effect; `act` pushes for a given amplitude, `tell` says what that is in the law's parameters."""

    name: str
    site: str
    axis: str | None
    covariates: tuple[str, ...]
    act: Callable[[State, Push, float], None]
    tell: Callable[[float], Numbers]
    trial: float  # an amplitude small enough to be linear
    limit: float  # the largest sane one
    least: float = 0.0  # below it the effect is within what calibration may move anyway
    weak: bool = False  # whether it is as large as it can be where that moves the readings less than is wanted
    amplitude: float = 0.0
    nearby: Callable[[], list[Effect]] = list  # the same with one of its drawn constants a little elsewhere

    def __call__(self, state: State, push: Push) -> None:
        self.act(state, push, self.amplitude)


@dataclass
class Context:
    """Where an effect is to be drawn: the arm, what was driven, and the arm's state without effects."""

    rng: np.random.Generator
    plant: Plant
    rows: Rows
    calm: State
    sessions: int
    lagging: bool = False
    spread: Array = field(init=False)

    def __post_init__(self) -> None:
        self.spread = np.sqrt((self.calm.wrenches[self.rows.measured] ** 2).mean(axis=0))

    def sign(self) -> float:
        return float(self.rng.choice((-1.0, 1.0)))

    def log(self, low: float, high: float) -> float:
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def joint(self, *, turning: bool = False) -> int:
        """Index of any joint, or of any that turns."""
        fit = [i for i, j in enumerate(self.plant.joints) if not turning or j.kind != "prismatic"]
        return int(self.rng.choice(fit))

    def loaded(self, *, drive: bool = False) -> tuple[int, int]:
        """Joint and rotation axis (3 to 5) about which there is a moment worth the name."""
        strong = self.spread[:, 3:] > 0.03 * self.spread[:, 3:].max()
        pairs = [(i, a + 3) for i, a in np.argwhere(strong) if not drive or drive_axis(self.plant.joints[i]) == a + 3]
        return tuple(int(x) for x in self.rng.choice(pairs))

    def warmth(self) -> tuple[Array, Numbers]:
        """Temperature above the reference that the effect feels, and its lag."""
        if not self.lagging:
            return self.rows.temperature - REFERENCE, {"T_ref": REFERENCE}
        tau = self.log(0.2, 3.0) * 3600.0
        return lagged(self.rows.time, self.rows.temperature, tau) - REFERENCE, {"T_ref": REFERENCE, "lag": tau}


class Nudged:
    """The draws of a generator again, one of its continuous numbers moved by a little of their range."""

    def __init__(self, state: dict, which: int, step: float) -> None:
        self.rng = np.random.default_rng()
        self.rng.bit_generator.state = state
        self.left, self.step = which, step
        self.choice, self.integers, self.random = self.rng.choice, self.rng.integers, self.rng.random

    def _moved(self, drawn: Array | float, span: float) -> Array | float:
        values = np.atleast_1d(np.array(drawn, float))
        if 0 <= self.left < len(values):
            values[self.left] += self.step * span
        self.left -= len(values)
        return values if np.ndim(drawn) else float(values[0])

    def uniform(self, low: float, high: float, size: int | None = None) -> Array | float:
        return self._moved(self.rng.uniform(low, high, size), high - low)

    def normal(self, mean: float = 0.0, scale: float = 1.0, size: int | None = None) -> Array | float:
        return self._moved(self.rng.normal(mean, scale, size), scale)


def drive_axis(joint: Joint) -> int:
    return int(np.abs(joint.drive).argmax())


def unit(axis: int) -> Array:
    return np.eye(6)[axis]


def rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def lagged(time: Array, temperature: Array, tau: float) -> Array:
    """First-order lag of a temperature that runs straight between the rows; in equilibrium at the first."""
    felt = temperature.astype(float).copy()
    for k in range(1, len(time)):
        step = time[k] - time[k - 1]
        ramp = (temperature[k] - temperature[k - 1]) / step * tau
        felt[k] = temperature[k] - ramp + (felt[k - 1] - temperature[k - 1] + ramp) * np.exp(-step / tau)
    return felt


def play(load: Array, radius: float) -> Array:
    """Play operator of a load in row order, from rest at zero."""
    state, found = 0.0, np.empty_like(load)
    for k, value in enumerate(load):
        state = min(max(state, value - radius), value + radius)
        found[k] = state
    return found


def pushing(slot: str, index: int, sign: float, direction: Array, shape: Shape) -> Callable[[State, Push, float], None]:
    """Return the action of a twist along a direction; a shape with six columns brings its own."""

    def act(state: State, push: Push, amplitude: float) -> None:
        value = shape(state)
        getattr(push, slot)[:, index] += sign * amplitude * (value if value.ndim == 2 else value[:, None] * direction)

    return act


def twisting(
    context: Context,
    slot: str,
    index: int,
    direction: Array,
    shape: Shape,
    tell: Callable[[float], Numbers],
    name: str,
    site: str,
    axis: str | None,
    covariates: tuple[str, ...],
    sign: float = 1.0,
) -> Effect:
    """Return an effect whose site twists by `amplitude * shape`."""
    measured = context.rows.measured
    value = shape(context.calm)[measured]
    turned = axis is None or axis.startswith("r")
    size = rms(value) if value.ndim == 1 else float(np.sqrt((value[:, 3:] ** 2).sum(axis=1).mean()))
    if size < 1e-300:
        raise Redraw
    largest = LARGEST if turned else 4 * LARGEST
    act = pushing(slot, index, sign, direction, shape)
    return Effect(name, site, axis, covariates, act, lambda x: tell(sign * x), 1e-4 / size, largest / size)


def driven(
    context: Context,
    name: str,
    i: int,
    shape: Shape,
    tell: Callable[[float], Numbers],
    covariates: tuple[str, ...],
    sign: float = 1.0,
) -> Effect:
    """An error of the joint's own motion, in the sense of its q."""
    joint = context.plant.joints[i]
    axis = AXES[drive_axis(joint)]
    return twisting(context, "motion", i, joint.drive, shape, tell, name, joint.name, axis, covariates, sign)


def given(
    context: Context,
    name: str,
    i: int,
    a: int,
    shape: Shape,
    tell: Callable[[float], Numbers],
    covariates: tuple[str, ...],
    sign: float = 1.0,
) -> Effect:
    """Something that adds to the joint's flexure about one axis."""
    joint = context.plant.joints[i]
    return twisting(context, "flexure", i, unit(a), shape, tell, name, joint.name, AXES[a], covariates, sign)
