"""Effects that no law of any catalogue has the shape of, beyond those of `support.undeclared_outside`."""

import numpy as np

from support.plant import Array, Push, State
from support.undeclared import Context, Effect, Redraw, driven, given
from support.undeclared_outside import Maker, by_name


def cross_terms(s: Context) -> Effect:
    """One joint turns by products of waves over two others."""
    i, a = s.joint(), int(s.rng.integers(3, 6))
    first, second = (int(j) for j in s.rng.choice(len(s.plant.joints), 2, replace=False))
    if i in (first, second):
        raise Redraw
    span = np.ptp(s.rows.q, axis=0)
    waves, phases = s.rng.uniform(1.5, 5.0, (4, 2)), s.rng.uniform(-np.pi, np.pi, (4, 2))
    shares = s.rng.normal(size=4)

    def shape(t: State) -> Array:
        x, y = (t.rows.q[:, j] / span[j] for j in (first, second))
        return sum(
            share * np.sin(k * x + p) * np.sin(m * y + r)
            for share, (k, m), (p, r) in zip(shares, waves, phases, strict=True)
        )

    names = tuple(f"q_{s.plant.joints[j].name}" for j in (first, second))
    return given(s, "unnamed", i, a, shape, lambda x: {"law": "cross_terms", "amplitude": x}, names)


def dahl(s: Context) -> Effect:
    """A drive that follows by Dahl's law: friction that builds up over a way, of another shape than play or stops."""
    i = s.joint()
    way = float(s.rng.uniform(0.02, 0.3) * np.ptp(s.rows.q[:, i]))

    def shape(t: State) -> Array:
        state, states = 0.0, np.empty(len(t.rows.q))
        for k, step in enumerate(np.diff(t.rows.q[:, i], prepend=t.rows.q[0, i])):
            state = np.sign(step) + (state - np.sign(step)) * np.exp(-abs(step) / way)
            states[k] = state
        return states

    name = f"q_{s.plant.joints[i].name}"
    return driven(s, "unnamed", i, shape, lambda x: {"law": "dahl", "amplitude": x, "way": way}, (name,), s.sign())


def cubic_and_square(s: Context) -> Effect:
    """A joint that gives by the square and the cube of its load, and less where it is warm."""
    i, a = s.loaded()
    size = np.abs(s.calm.wrenches[:, i, a]).max()
    bent, warm = s.rng.uniform(-1.0, 1.0), s.rng.uniform(-0.05, 0.05)

    def shape(t: State) -> Array:
        load = t.wrenches[:, i, a] / size
        return (load**3 + bent * load**2) * (1.0 + warm * (t.rows.temperature - 20.0))

    return given(s, "unnamed", i, a, shape, lambda x: {"law": "cubic_and_square", "amplitude": x}, ("temperature",))


def turning_field(s: Context) -> Effect:
    """Readings are bent by a smooth field over where the tip is, which turns with time."""
    period = float(s.rng.uniform(0.3, 1.5) * np.ptp(s.rows.time))
    waves = s.rng.normal(size=(3, 3)) * s.rng.uniform(0.5, 1.5) / s.calm.frames[:, -1, :3, 3].std()
    phases = s.rng.uniform(-np.pi, np.pi, 3)

    def act(state: State, push: Push, amplitude: float) -> None:
        at = state.frames[:, -1, :3, 3]
        push.shift += amplitude * np.sin(at @ waves.T + phases + 2.0 * np.pi * state.rows.time[:, None] / period)

    told = {"law": "turning_field", "period": period}
    return Effect("unnamed", "instrument", None, ("time",), act, lambda x: {"amplitude": x, **told}, 1e-4, 2e-2)


BEYOND: dict[str, Maker] = by_name(cross_terms, dahl, cubic_and_square, turning_field)
