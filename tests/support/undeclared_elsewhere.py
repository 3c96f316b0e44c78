"""Undeclared effects of links, base, tool and instrument, and loads that nobody declared."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from support.plant import Array, Push, State, apply
from support.undeclared import AXES, Context, Effect, Numbers, Redraw, Shape, rms, twisting, unit

GROWTHS = (1.2e-5, 2.4e-5, 8e-5)
"""Growth of a link by its temperature [1/K]: of steel, of aluminium, and of plastics or a link warmer than was read."""

MOST_TILT, MOST_SCALE = 0.02, 3e-4
"""Tilt of a base that nobody levelled [rad], and error of scale of a tracker whose air was read badly, at most."""


def link_name(s: Context, end: int) -> str:
    return s.plant.joints[end].name if end < len(s.plant.joints) else "tool"


def any_link(s: Context) -> int:
    """Number of the joint that ends a moving link; one past the last is the tool."""
    return int(s.rng.integers(1, len(s.plant.joints) + 1))


def weight(s: Context) -> float:
    """What the arm weighs [N]."""
    return 9.81 * sum(j.mass for j in s.plant.joints)


def thermal_growth(s: Context) -> Effect:
    end = any_link(s)
    origin = s.plant.joints[end].origin if end < len(s.plant.joints) else s.plant.tip
    along = origin[:3, :3].T @ origin[:3, 3]
    length = float(np.linalg.norm(along))
    if length < 0.05:
        raise Redraw
    warmth, lag = s.warmth()
    direction = np.concatenate([along / length, np.zeros(3)])
    effect = twisting(
        s,
        "link",
        end,
        direction,
        lambda t: length * warmth,
        lambda x: {"alpha": x, **lag},
        "thermal_growth",
        link_name(s, end),
        None,
        ("temperature",),
    )
    return replace(effect, limit=float(s.rng.choice(GROWTHS)), weak=True)


def thermal_bending(s: Context) -> Effect:
    end, a = any_link(s), int(s.rng.integers(3, 6))
    warmth, lag = s.warmth()
    return at_link(
        s, "thermal_bending", end, a, lambda t: warmth, lambda x: {"beta": x, **lag}, ("temperature",), s.sign()
    )


def at_link(
    s: Context,
    name: str,
    end: int,
    a: int,
    shape: Shape,
    tell: Callable[[float], Numbers],
    covariates: tuple[str, ...],
    sign: float = 1.0,
) -> Effect:
    return twisting(s, "link", end, unit(a), shape, tell, name, link_name(s, end), AXES[a], covariates, sign)


def link_flexure(s: Context) -> Effect:
    end, a = any_link(s), int(s.rng.integers(3, 6))
    return at_link(s, "link_flexure", end, a, lambda t: t.end_wrenches[:, end, a], lambda x: {"C": x}, ("load",))


def link_geometry(s: Context) -> Effect:
    end, a = any_link(s), int(s.rng.integers(6))
    return at_link(s, "link_geometry", end, a, lambda t: np.ones(len(t.rows.q)), lambda x: {AXES[a]: x}, (), s.sign())


def link_mass(s: Context) -> Effect:
    end = any_link(s)
    body = s.plant.joints[end - 1]
    if s.rng.random() < 0.5:
        return pulling(
            s,
            "link_mass",
            end,
            None,
            lambda t: pull_down(s, t, end - 1, body.com),
            lambda x: {"mass": x},
            0.1 * weight(s) / 9.81,
        )
    a = int(s.rng.integers(3))
    sign = s.sign()

    def moved(t: State, x: float) -> list[tuple[int, Array, Array]]:
        down = np.tile(body.mass * s.plant.gravity, (len(t.rows.q), 1))
        there = body.com + sign * x * unit(a)[:3]
        return [
            (end - 1, down, apply(t.frames[:, end - 1], there)),
            (end - 1, -down, apply(t.frames[:, end - 1], body.com)),
        ]

    return loading(s, "link_mass", end, AXES[a], moved, lambda x: {"com": sign * x}, 1e-3, 0.4)


def pull_down(s: Context, t: State, body: int, at: Array) -> tuple[int, Array, Array]:
    return body, np.tile(s.plant.gravity, (len(t.rows.q), 1)), apply(t.frames[:, body], at)


def pulling(
    s: Context,
    name: str,
    end: int,
    axis: str | None,
    pull: Callable[[State], tuple[int, Array, Array]],
    tell: Callable[[float], Numbers],
    limit: float,
    covariates: tuple[str, ...] = (),
) -> Effect:
    """A force in proportion to the amplitude."""

    def loads(t: State, x: float) -> list[tuple[int, Array, Array]]:
        body, force, point = pull(t)
        return [(body, x * force, point)]

    return loading(s, name, end, axis, loads, tell, 1e-3 * limit, limit, covariates)


def loading(
    s: Context,
    name: str,
    end: int,
    axis: str | None,
    loads: Callable[[State, float], list[tuple[int, Array, Array]]],
    tell: Callable[[float], Numbers],
    trial: float,
    limit: float,
    covariates: tuple[str, ...] = (),
) -> Effect:
    def act(state: State, push: Push, amplitude: float) -> None:
        push.loads.extend(loads(state, amplitude))

    return Effect(name, link_name(s, end), axis, covariates, act, tell, trial, limit)


def payload_mass(s: Context) -> Effect:
    """The same kg too many on every payload that is one, or every payload heavier by the same share."""
    last, rows = len(s.plant.joints), s.rows
    share, sign = bool(s.rng.random() < 0.5), s.sign()
    heaviest = rows.mass.max()

    def pull(t: State) -> tuple[int, Array, Array]:
        mass = t.rows.mass
        more = sign * (mass / heaviest if share else (mass > 0) * 1.0)
        return last, more[:, None] * s.plant.gravity, apply(t.frames[:, -1], t.rows.com)

    key = "mass_at_heaviest" if share else "mass"
    return pulling(s, "payload_mass", last, None, pull, lambda x: {key: sign * x}, 0.5 * rows.mass.max(), ("payload",))


def payload_com(s: Context) -> Effect:
    last, a = len(s.plant.joints), int(s.rng.integers(3))
    sign = s.sign()

    def moved(t: State, x: float) -> list[tuple[int, Array, Array]]:
        down = t.rows.mass[:, None] * s.plant.gravity
        return [
            (last, down, apply(t.frames[:, -1], t.rows.com + sign * x * unit(a)[:3])),
            (last, -down, apply(t.frames[:, -1], t.rows.com)),
        ]

    return loading(s, "payload_com", last, AXES[a], moved, lambda x: {AXES[a]: sign * x}, 1e-3, 0.7, ("payload",))


def tip_force(s: Context) -> Effect:
    last = len(s.plant.joints)
    towards = s.rng.normal(size=3)
    towards /= np.linalg.norm(towards)

    def pull(t: State) -> tuple[int, Array, Array]:
        return last, np.tile(towards, (len(t.rows.q), 1)), t.frames[:, -1, :3, 3]

    def tell(x: float) -> Numbers:
        return dict(zip(("fx", "fy", "fz"), map(float, x * towards), strict=True))

    return pulling(s, "tip_force", last, None, pull, tell, 0.1 * weight(s))


def umbilical(s: Context) -> Effect:
    """A spring from a point of a link to a fixed point: k (length - rest)."""
    end = any_link(s)
    origin = s.plant.joints[end].origin if end < len(s.plant.joints) else s.plant.tip
    hook = float(s.rng.uniform(0.3, 1.0)) * origin[:3, 3] + s.rng.normal(0.0, 0.1, 3)
    places = apply(s.calm.frames[:, end - 1], hook)
    anchor = places.mean(axis=0) + s.rng.normal(0.0, 1.5, 3)
    far = np.linalg.norm(anchor - places, axis=1)
    if far.min() < 0.3:
        raise Redraw
    rest = float(s.rng.uniform(0.0, 0.9) * far.min() * (s.rng.random() < 0.7))

    def pull(t: State) -> tuple[int, Array, Array]:
        point = apply(t.frames[:, end - 1], hook)
        line = anchor - point
        length = np.linalg.norm(line, axis=1, keepdims=True)
        return end - 1, line * (1.0 - rest / length), point

    points = {
        f"{name}_{a}": float(v)
        for name, p in (("hook", hook), ("anchor", anchor))
        for a, v in zip("xyz", p, strict=True)
    }
    limit = 0.1 * weight(s) / rms(far - rest)
    return pulling(s, "umbilical", end, None, pull, lambda x: {"k": x, "rest": rest, **points}, limit, tuple_of_q(s))


def tuple_of_q(s: Context) -> tuple[str, ...]:
    return tuple(f"q_{j.name}" for j in s.plant.joints)


def magnetic_pull(s: Context) -> Effect:
    """A force toward a point, falling with the square of the distance; the parameter is the force at 1 m."""
    end = len(s.plant.joints) if s.rng.random() < 0.6 else any_link(s)
    tool = end == len(s.plant.joints)
    body, at = (end, np.zeros(3)) if tool else (end - 1, s.plant.joints[end - 1].com)
    places = apply(s.calm.frames[:, body], at)
    magnet = places[s.rng.integers(len(places))] + s.rng.normal(0.0, 1.0, 3)
    if np.linalg.norm(magnet - places, axis=1).min() < 0.4:
        raise Redraw

    def pull(t: State) -> tuple[int, Array, Array]:
        point = apply(t.frames[:, body], at)
        line = magnet - point
        return body, line / np.linalg.norm(line, axis=1, keepdims=True) ** 3, point

    place = {f"magnet_{a}": float(v) for a, v in zip("xyz", magnet, strict=True)}
    limit = 0.2 * weight(s) / float((1 / np.linalg.norm(magnet - places, axis=1) ** 2).max())
    return pulling(s, "magnetic_pull", end, None, pull, lambda x: {"force_at_1m": x, **place}, limit, tuple_of_q(s))


def gravity_tilt(s: Context) -> Effect:
    a, sign = int(s.rng.integers(3, 5)), s.sign()

    def act(state: State, push: Push, amplitude: float) -> None:
        push.tilt = push.tilt + sign * amplitude * unit(a)[3:]

    return Effect("gravity_tilt", "base", AXES[a], (), act, lambda x: {"tilt": sign * x}, 1e-4, MOST_TILT, weak=True)


def tool_shift(s: Context) -> Effect:
    """From some session on, or, one time in five, from the first on."""
    a, sign = int(s.rng.integers(3)), s.sign()
    since = 0 if s.rng.random() < 0.2 else int(s.rng.integers(1, s.sessions))

    def act(state: State, push: Push, amplitude: float) -> None:
        push.target[state.rows.session >= since, a] += sign * amplitude

    covariates = ("session",) if since else ()
    return Effect(
        "tool_shift", "tool", AXES[a], covariates, act, lambda x: {AXES[a]: sign * x, "from": f"s{since}"}, 1e-4, 0.05
    )


def base_compliance(s: Context) -> Effect:
    a = int(s.rng.integers(3, 5))
    return at_base(s, "base_compliance", a, lambda t: t.base_wrench[:, a], lambda x: {"C": x}, ("load",))


def at_base(
    s: Context,
    name: str,
    a: int,
    shape: Shape,
    tell: Callable[[float], Numbers],
    covariates: tuple[str, ...],
    sign: float = 1.0,
) -> Effect:
    return twisting(s, "base", 0, unit(a), shape, tell, name, "base", AXES[a], covariates, sign)


def base_thermal(s: Context) -> Effect:
    warmth, lag = s.warmth()
    a = int(s.rng.integers(6))
    return at_base(s, "base_thermal", a, lambda t: warmth, lambda x: {"beta": x, **lag}, ("temperature",), s.sign())


def base_drift(s: Context) -> Effect:
    a = int(s.rng.integers(6))
    return at_base(s, "base_drift", a, lambda t: t.rows.time - t.rows.time[0], lambda x: {"v": x}, ("time",), s.sign())


def tracker_scale(s: Context) -> Effect:
    sign = s.sign()

    def act(state: State, push: Push, amplitude: float) -> None:
        push.scale += sign * amplitude

    return Effect(
        "tracker_scale", "base", None, ("range",), act, lambda x: {"ppm": sign * x * 1e6}, 1e-5, MOST_SCALE, weak=True
    )


def session_frame(s: Context) -> Effect:
    """One session set up at least four prior standard deviations away."""
    which = int(s.rng.integers(s.sessions))
    towards = s.rng.normal(size=3)
    towards /= np.linalg.norm(towards)

    def act(state: State, push: Push, amplitude: float) -> None:
        push.shift[state.rows.session == which] += amplitude * towards

    def tell(x: float) -> Numbers:
        return {"session": f"s{which}", **dict(zip(AXES, map(float, x * towards), strict=False))}

    return Effect("session_frame", "base", None, ("session",), act, tell, 1e-4, 0.1, least=2e-3)
