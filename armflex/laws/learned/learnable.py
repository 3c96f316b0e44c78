"""`learn = true` in an arm.toml: what of a flexure's law is free, and how it is made for the loads of a campaign."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from armflex.conventions import TWIST_NAMES
from armflex.declaration import Declaration
from armflex.laws.law import Law, Ranges
from armflex.laws.learned.corrections import NetworkCorrection, PolynomialCorrection
from armflex.laws.learned.learned_law import LearnedLaw
from armflex.laws.learned.seen import Seen

CORRECTED = ("polynomial", "neural", "bayesian")
"""Models with a correction on top of a compliance; without a file they are declared by the compliance."""

NETWORKS = ("neural", "bayesian")
"""Those whose correction is a network."""

TRAINED_ALONE = ("torch",)
"""Models that stand in a file alone, and stay as they were trained; a correction about them is a network."""

MOST_NEURONS = 64


@dataclass(frozen=True)
class Learning:
    """What is to be learned of a flexure's law.

    Attributes:
        model: Name of the law, a key of `LAWS` or `FORMS`.
        neurons: Hidden neurons of a network.
        travel: Lowest and highest position of every joint [rad or m], where a law may depend on them.
    """

    model: str
    neurons: int = 6
    travel: Ranges = field(default_factory=dict)


def read_learning(table: Declaration, model: str, law: Law, ranges: Ranges) -> Learning:
    """Return what `learn = true` frees; `neurons` is a network's size."""
    if all(leaf.constant is not None and not leaf.constant.any() for leaf in law.leaves):
        raise table.fail("compliance", "is zero: there is nothing that could be learned about it, give a rough one")
    if model not in (*CORRECTED, *TRAINED_ALONE) and law.learned(ranges) is None:
        text = "has no parameters to learn: its compliance is not symmetric, or a structure not linear"
        raise table.fail("model", f"{text}; learn a correction about it: {', '.join(CORRECTED)}")
    if table.has("neurons") and model not in NETWORKS:
        raise table.fail("neurons", f"a {model} law has none: only {' and '.join(NETWORKS)} laws do")
    neurons = table.number("neurons", 6.0)
    if neurons not in range(1, MOST_NEURONS + 1):
        raise table.fail("neurons", f"expected a whole number from 1 to {MOST_NEURONS}, got {neurons:g}")
    return Learning(model, int(neurons), ranges)


def learned_law(law: Law, learning: Learning, seen: Seen) -> LearnedLaw:
    """Return a declared law with its parameters, at values that change nothing but a network's hidden weights.

    A correction has no other axes than those in which the declared law gives, and looks at their loads.
    """
    free, form = law.learned(learning.travel), None
    axes = tuple(np.flatnonzero(seen.twist_scale > 0.0).tolist())
    scales = (axes, axes, seen.load_scale, seen.twist_scale)
    if learning.model in (*NETWORKS, *TRAINED_ALONE):
        form = NetworkCorrection.start(scales, learning.neurons)
    elif learning.model in CORRECTED:
        straight = free is None or set(TWIST_NAMES).isdisjoint(one.name for one in free.parameters)
        form = PolynomialCorrection.start(scales, linear=straight)
    found = LearnedLaw(law, free, form, seen, np.zeros(0), ())
    return found.at(found.start).rescaled(group.std for group in found.groups)
