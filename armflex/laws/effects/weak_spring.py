"""A spring that is weak or broken: it has lost a share of every tension that it has as declared."""

from dataclasses import replace

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import Act, Amplitude, ChangeableModel, Effect, ModelLaw, Plausible, Solved, Words
from armflex.laws.effects.location import Here, Location


def _lost(here: Here, view: Solved, context: Context) -> Array:
    """Return the (M, 1, 1) change of the tension per share that is lost."""
    spring = next(weak for weak in view.arm.springs if weak.name == here.location.site)
    whole = replace(spring.law, strength=1.0)
    return -np.array([whole.tension(length) for length in view.length_of(spring).tolist()])[:, None, None]


def _change(effect: Effect, model: ChangeableModel) -> ChangeableModel:
    def changed(law):
        return replace(law, strength=law.strength - effect.amplitudes[0])

    springs = [
        replace(spring, law=changed(spring.law)) if spring.name == effect.location.site else spring
        for spring in model.springs
    ]
    return replace(model, springs=tuple(springs))


WEAK_SPRING = ModelLaw(
    name="weak_spring",
    words=Words("weak spring", "the spring pulls less than declared, or not at all", "− share · tension"),
    instead="weigh what the spring carries at two lengths",
    plausible=Plausible(
        2.0, 2.0, "on its short lever a balancer pulls several times what an arm weighs, and may break"
    ),
    places=lambda records: [Location(name) for name in records.springs],
    amplitudes=(Amplitude("share", "1", positive=True, most=1.0),),
    act=Act.TENSION,
    made=_lost,
    changed=_change,
    stands_for=("spring",),
)
