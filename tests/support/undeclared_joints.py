"""Undeclared effects of joints: of the motion itself, of the flexure under load, and with a memory."""

from dataclasses import replace

import numpy as np

from support.plant import Array, State
from support.undeclared import (
    AXES,
    Context,
    Effect,
    Numbers,
    Shape,
    drive_axis,
    driven,
    given,
    play,
    rms,
    twisting,
    unit,
)

HOSES = (50.0, 100.0, 200.0)
"""Stiffness of a bundle of hoses about a joint at most [Nm/rad].

Estimated: four to eight hydraulic hoses of a bending stiffness of 10 to 20 Nm^2 each, in a loop of 0.5 to 1 m, turn it
by that stiffness over the loop's length; packs that retract pull 100 to 250 N at 0.3 to 0.5 m from the axis.
"""


def within_elastic(s: Context, i: int, a: int, effect: Effect, shape: Shape) -> Effect:
    """Bound the effect by the elastic twist, so that the joint still gives in the direction of its load."""
    soft = float(s.plant.compliance[s.plant.joints[i].name][a, a])
    largest = 0.9 * soft * np.abs(s.calm.wrenches[:, i, a]).max() / np.abs(shape(s.calm)).max()
    effect.limit = min(effect.limit, float(largest))
    return effect


def encoder_offset(s: Context) -> Effect:
    i = s.joint()
    return driven(s, "encoder_offset", i, lambda t: np.ones(len(t.rows.q)), lambda x: {"offset": x}, (), s.sign())


def encoder_scale(s: Context) -> Effect:
    i = s.joint()
    q0 = float(s.rng.uniform(*np.quantile(s.rows.q[:, i], (0.3, 0.7))))
    covariate = (f"q_{s.plant.joints[i].name}",)
    return driven(
        s, "encoder_scale", i, lambda t: t.rows.q[:, i] - q0, lambda x: {"scale": x, "q0": q0}, covariate, s.sign()
    )


def periodic(s: Context, name: str, i: int, k: float) -> Effect:
    phase = float(s.rng.uniform(-np.pi, np.pi))
    told = {} if k == 1.0 else {"k": k}
    return driven(
        s,
        name,
        i,
        lambda t: np.sin(k * t.rows.q[:, i] + phase),
        lambda x: {"A": x * np.cos(phase), "B": x * np.sin(phase), **told},
        (f"q_{s.plant.joints[i].name}",),
    )


def encoder_eccentricity(s: Context) -> Effect:
    return periodic(s, "encoder_eccentricity", s.joint(turning=True), 1.0)


def gear_harmonic(s: Context) -> Effect:
    i = s.joint(turning=True)
    least = max(2.0, 3.0 / float(np.ptp(s.rows.q[:, i])))
    return periodic(s, "gear_harmonic", i, s.log(least, max(14.0, 3.0 * least)))


def backlash(s: Context) -> Effect:
    i = s.joint()
    covariate = (f"approach_{s.plant.joints[i].name}",)
    return driven(s, "backlash", i, lambda t: t.rows.approach[:, i] / 2, lambda x: {"gap": x}, covariate)


def friction_windup(s: Context) -> Effect:
    i, a = s.loaded(drive=True)
    name = s.plant.joints[i].name
    b = s.log(0.5, 4.0) / s.spread[i, a]
    return driven(
        s,
        "friction_windup",
        i,
        lambda t: t.rows.approach[:, i] * (1.0 + b * np.abs(t.wrenches[:, i, a])),
        lambda x: {"a": x, "b": x * b},
        (f"approach_{name}", "load"),
    )


def hysteresis(s: Context) -> Effect:
    i, a = s.loaded()
    moment = s.calm.wrenches[:, i, a]
    radii = [s.log(0.15, 1.2) * float(moment.std()) for _ in range(int(s.rng.integers(1, 4)))]
    gains = s.rng.uniform(0.3, 1.0, len(radii))

    def shape(t: State) -> Array:
        return sum(g * play(t.wrenches[:, i, a], r) for g, r in zip(gains, radii, strict=True))

    def tell(x: float) -> Numbers:
        pairs = enumerate(zip(gains, radii, strict=True), start=1)
        return {key: v for n, (g, r) in pairs for key, v in ((f"gain{n}", float(x * g)), (f"radius{n}", r))}

    return within_elastic(s, i, a, given(s, "hysteresis", i, a, shape, tell, ("load", "order")), shape)


def stiffening(s: Context) -> Effect:
    i, a = s.loaded()
    typical, cubic = s.spread[i, a], float(s.rng.choice((0.0, 1.0, s.rng.uniform(0.2, 0.8))))

    def shape(t: State) -> Array:
        x = t.wrenches[:, i, a] / typical
        return (1.0 - cubic) * x * np.abs(x) + cubic * x**3

    def tell(x: float) -> Numbers:
        return {"c2": x * (1.0 - cubic) / typical**2, "c3": x * cubic / typical**3}

    return within_elastic(s, i, a, given(s, "stiffening", i, a, shape, tell, ("load",), s.sign()), shape)


def deadband(s: Context) -> Effect:
    i, a = s.loaded()
    reach = float(np.quantile(np.abs(s.calm.wrenches[s.rows.measured, i, a]), 0.9))
    tau0 = s.log(0.1, 0.8) * reach
    return given(
        s,
        "deadband",
        i,
        a,
        lambda t: np.clip(t.wrenches[:, i, a] / tau0, -1.0, 1.0),
        lambda x: {"g": x, "tau0": tau0},
        ("load",),
    )


def even_in_load(s: Context) -> Effect:
    """The square of a moment, or the size of the moment across the axis about which the joint gives."""
    i, a = s.loaded()
    across = [b for b in (3, 4, 5) if b != a]
    if s.rng.random() < 0.5:

        def shape(t: State) -> Array:
            return t.wrenches[:, i, a] ** 2

        effect = given(s, "even_in_load", i, a, shape, lambda x: {"c": x, "of": "tau^2"}, ("load",), s.sign())
        return within_elastic(s, i, a, effect, shape)
    free = int(s.rng.choice(across))
    across = [b for b in (3, 4, 5) if b != free]

    def size(t: State) -> Array:
        return np.linalg.norm(t.wrenches[:, i, across], axis=1)

    return given(s, "even_in_load", i, free, size, lambda x: {"c": x, "of": "|w_perp|"}, ("load",), s.sign())


def compliance(s: Context) -> Effect:
    i, a = s.joint(), int(s.rng.integers(6))
    found = given(s, "compliance", i, a, lambda t: t.wrenches[:, i, a], lambda x: {"C": x}, ("load",))
    found.least = 0.6 * float(s.plant.compliance[s.plant.joints[i].name][a, a])
    return found


def cross_coupling(s: Context) -> Effect:
    i, b = s.loaded()
    a, name = int(s.rng.choice([x for x in (3, 4, 5) if x != b])), s.plant.joints[i].name

    def shape(t: State) -> Array:
        out = np.zeros((len(t.rows.q), 6))
        out[:, a], out[:, b] = t.wrenches[:, i, b], t.wrenches[:, i, a]
        return out

    def tell(x: float) -> Numbers:
        return {"C": x, "with": AXES[b]}

    sign = s.sign()
    effect = twisting(s, "flexure", i, unit(a), shape, tell, "cross_coupling", name, AXES[a], ("load",), sign)
    soft = s.plant.compliance[name]
    effect.limit = min(effect.limit, 0.8 * float(np.sqrt(soft[a, a] * soft[b, b])))
    return effect


def position_dependent_compliance(s: Context) -> Effect:
    i, a = s.loaded()
    name, q = s.plant.joints[i].name, s.rows.q[:, i]
    typical, mix = rms(q), float(s.rng.uniform(-np.pi, np.pi))
    c1, c2 = float(np.cos(mix) / typical), float(np.sin(mix) / typical**2)
    covariates = (f"q_{name}", "load")

    def shape(t: State) -> Array:
        return (c1 * t.rows.q[:, i] + c2 * t.rows.q[:, i] ** 2) * t.wrenches[:, i, a]

    def tell(x: float) -> Numbers:
        return {"C1": x * c1, "C2": x * c2}

    effect = given(s, "position_dependent_compliance", i, a, shape, tell, covariates)
    soft = float(s.plant.compliance[name][a, a])
    effect.limit = min(effect.limit, 0.9 * soft / float(np.abs(c1 * q + c2 * q**2).max()))
    return effect


def thermal_softening(s: Context) -> Effect:
    i, _ = s.loaded()
    joint = s.plant.joints[i]
    warmth, lag = s.warmth()
    law = s.plant.compliance[joint.name]
    effect = twisting(
        s,
        "flexure",
        i,
        np.zeros(6),
        lambda t: warmth[:, None] * (t.wrenches[:, i] @ law.T),
        lambda x: {"beta": x, **lag},
        "thermal_softening",
        joint.name,
        None,
        ("temperature", "load"),
        s.sign(),
    )
    effect.limit = min(effect.limit, 0.08)
    return effect


def creep(s: Context) -> Effect:
    i, a = s.loaded()
    t0 = s.log(20.0, 600.0)

    def shape(t: State) -> Array:
        return t.wrenches[:, i, a] * np.log1p(t.rows.hold / t0)

    effect = given(s, "creep", i, a, shape, lambda x: {"c": x, "t0": t0}, ("hold", "load"))
    return within_elastic(s, i, a, effect, shape)


def slip_step(s: Context) -> Effect:
    i = s.joint()
    when = float(np.quantile(s.rows.time, s.rng.uniform(0.2, 0.8)) + 1.0)
    return driven(
        s,
        "slip_step",
        i,
        lambda t: (t.rows.time > when) * 1.0,
        lambda x: {"size": x, "time": when},
        ("time",),
        s.sign(),
    )


def dress_pack(s: Context) -> Effect:
    i = s.joint(turning=True)
    joint, a = s.plant.joints[i], drive_axis(s.plant.joints[i])
    q0 = float(s.rng.uniform(*np.quantile(s.rows.q[:, i], (0.2, 0.8))))
    soft = float(s.plant.compliance[joint.name][a, a])
    effect = given(
        s,
        "dress_pack",
        i,
        a,
        lambda t: soft * (t.rows.q[:, i] - q0),
        lambda x: {"k": x, "q0": q0},
        (f"q_{joint.name}",),
        s.sign(),
    )
    return replace(effect, limit=float(s.rng.choice(HOSES)), weak=True)
