"""Every kind of law, alone and with effects, for the joints of `small_arms.three_joints`."""

import numpy as np

from armflex.laws import AtNode, Law, LinearLaw, PositionDependentLaw
from armflex.laws.effects import Effect, Location
from armflex.laws.effects.catalogue import EVERY
from armflex.laws.joint.hardening import HardeningLaw
from support.small_arms import random_compliance
from support.structures import nonlinear

COUNT = 9
RNG = np.random.default_rng(8)


Q = RNG.uniform(-1.5, 1.5, (COUNT, 3))
PAYLOAD = RNG.integers(0, 3, COUNT)


KNOWN = {
    "temperature": RNG.uniform(10.0, 30.0, COUNT),
    "temperature_lagged_1800s": RNG.uniform(10.0, 30.0, COUNT),
    "approach_roll": RNG.choice([-1.0, 0.0, 1.0], COUNT),
    "humidity": 40.0,
}


def depending(seed: int) -> PositionDependentLaw:
    """Return a law that turns softer and its axes about as yaw moves."""
    parts = [random_compliance(seed + i, softness) for i, softness in enumerate((1.0, 0.1, 0.1))]
    return PositionDependentLaw("yaw", np.array([parts[0] * 3.0, parts[1], parts[2]]))


def effect(name: str, location: Location, **values: float) -> Effect:
    """Return an effect with some values by name, the others zero."""
    law = EVERY[name]
    names = [part.name for part in (*law.amplitudes, *law.inner)]
    assert set(values) <= set(names)
    return Effect(law, location, tuple(values.get(one, 0.0) for one in names))


def effects() -> tuple[Effect, ...]:
    """Return effects of the load, of columns that differ by row, of one that all rows share, and a pull."""
    warm = ("temperature",)
    return (
        effect("deadband", Location("pitch", "ry"), g=2e-4, tau0=150.0),
        effect("stiffening", Location("pitch", "ry", terms=(0, 1)), c2=-1e-10, c3=3e-14),
        effect("thermal_softening", Location("yaw", None, warm), beta=0.02, reference=20.0, lag=1800.0),
        effect("thermal_growth", Location("link:roll", None, warm), alpha=2e-5, reference=20.0),
        effect("backlash", Location("roll", "rz", ("approach_roll",)), gap=3e-4),
        effect("unnamed_compliance", Location("roll", "rx", ("humidity",), (3, 4)), a3=1e-7, a4=1e-7, high=80.0),
        effect("umbilical", Location("tool"), k=300.0, anchor_x=1.0, anchor_y=-0.5, anchor_z=3.0, rest=0.4),
    )


def laws_of(kind: str) -> list[Law]:
    linear = [LinearLaw(random_compliance(seed)) for seed in (1, 2, 3)]
    return {
        "linear": linear,
        "position dependent": [linear[0], depending(4), depending(7)],
        "hardening": [
            HardeningLaw(5.0 * random_compliance(4), 0.5),
            linear[1],
            HardeningLaw(random_compliance(5), 2.0),
        ],
        "structural": [linear[0], nonlinear(), linear[2]],
        "effects": [linear[0], depending(4), linear[2]],
        "effects on structures": [AtNode(nonlinear(), np.array([0.2, -0.1, 0.3])), linear[1], depending(4)],
    }[kind]


KINDS = ("linear", "position dependent", "hardening", "structural", "effects", "effects on structures")
