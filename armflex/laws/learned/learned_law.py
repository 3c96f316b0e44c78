"""A law learned on the whole arm: what was declared, with parameters, and a correction at the loads that were seen.

`learn = true` in an arm.toml says that a flexure's law is to be learned.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import groupby

import numpy as np

from armflex.conventions import TWIST_NAMES, Array
from armflex.declaration import Declaration
from armflex.errors import Flag
from armflex.laws.law import Law, Parameter, Ranges, Row, SteppedLaw, beyond
from armflex.laws.learned.correction import Correction, NetworkCorrection, PolynomialCorrection, fading
from armflex.laws.learned.seen import Seen
from armflex.laws.terms import Terms

CORRECTED = ("polynomial", "neural", "bayesian")
"""Models with a correction on top of a compliance; without a file they are declared by the compliance."""

NETWORKS = ("neural", "bayesian")
"""Those whose correction is a network."""

TRAINED_ALONE = ("torch",)
"""Models that stand in a file alone, and stay as they were trained; a correction about them is a network."""

MOST_NEURONS = 64


@dataclass(frozen=True, eq=False)
class LearnedLaw(Law):
    """The declared law with the parameters that it lets learn, and a correction that counts at the observed loads.

    Attributes:
        declared: The law that it is learned about.
        free: The same with parameters; values are steps from its own. None where it has none to learn.
        form: The correction as it is where it counts fully, with parameters; None for none.
        seen: The loads that it was learned under, and how a correction ends beyond them.
        values: (k,) values of both in their units, those of `free` first.
        scales: Prior standard deviation of every group of parameters.
        posterior: (k, k) covariance of the values in their units, None where nobody says.
        reach: (6,) largest correction at the observed loads, its uncertainty included [m, rad]; None for none.
    """

    declared: Law
    free: Law | None
    form: Law | None
    seen: Seen
    values: Array
    scales: tuple[float, ...]
    posterior: Array | None = None
    reach: Array | None = None

    @cached_property
    def expected(self) -> tuple[Parameter, ...]:
        """The parameters of both, as uncertain as they were expected beforehand."""
        return tuple(parameter for law in (self.free, self.form) if law is not None for parameter in law.parameters)

    @cached_property
    def groups(self) -> tuple[list[int], ...]:
        """Places of the parameters of one group and size, in order, as expected beforehand."""
        kinds = [(parameter.group, parameter.prior, parameter.sized) for parameter in self.expected]
        return tuple(list(places) for _, places in groupby(range(len(kinds)), kinds.__getitem__))

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The same with the scale that every group has now."""
        return tuple(
            replace(parameter, prior=float(std)) for parameter, std in zip(self.expected, self.prior, strict=True)
        )

    @property
    def prior(self) -> Array:
        """(k,) prior standard deviations about zero, in the parameters' units."""
        return np.repeat(self.scales, [len(places) for places in self.groups])

    @property
    def start(self) -> Array:
        """(k,) values where learning starts, in their units: the law as declared."""
        return np.concatenate([np.zeros(self._count), np.zeros(0) if self.form is None else self.form.values])

    @cached_property
    def plain(self) -> Law:
        """What holds under every load, at its values."""
        return self.declared if self.free is None else self.free.at(self.free.values + self.values[: self._count])

    @cached_property
    def correction(self) -> Correction | None:
        """What counts within the window alone, at its values."""
        return None if self.form is None else Correction(self.form.at(self.values[self._count :]), self.seen)

    @property
    def _count(self) -> int:
        """How many of the values are those of `free`."""
        return 0 if self.free is None else len(self.free.values)

    @property
    def parts(self) -> tuple[Law, ...]:
        """The plain law's parts, and the correction."""
        return (*self.plain.parts, *(() if self.correction is None else (self.correction,)))

    def terms(self) -> Terms:
        return [term for part in self.parts for term in part.terms()]

    @property
    def constant(self) -> Array | None:
        """The plain law's where there is no correction."""
        return self.plain.constant if self.form is None else None

    def at(self, values: Array) -> LearnedLaw:
        return replace(self, values=values, posterior=None)

    def without_correction(self) -> LearnedLaw:
        """Return the plain part alone."""
        count = sum(places[-1] < self._count for places in self.groups)
        values, scales = self.values[: self._count], self.scales[:count]
        return replace(self, form=None, values=values, scales=scales, posterior=None, reach=None)

    def twist(self, wrench: Array, row: Row) -> Array:
        twist = self.plain.twist(wrench, row)
        return twist if self.correction is None else twist + self.correction.twist(wrench, row)

    def tangent(self, wrench: Array, row: Row) -> Array:
        tangent = np.broadcast_to(self.plain.tangent(wrench, row), (*wrench.shape[:-1], 6, 6))
        return tangent if self.correction is None else tangent + self.correction.tangent(wrench, row)

    def by_values(self, wrench: Array, row: Row) -> Array:
        laws = (None if self.free is None else self.plain, self.correction)
        parts = [law.by_values(wrench, row) for law in laws if law is not None]
        return np.concatenate([np.zeros((*wrench.shape, 0)), *parts], axis=-1)

    def std(self, posterior: Array, wrench: Array, row: Row) -> Array:
        """Return the (..., 6) standard deviation of the twist [m, rad] for a (k, k) covariance of the values."""
        by = self.by_values(wrench, row)
        return np.sqrt(np.maximum(np.einsum("...ak,kl,...al->...a", by, posterior, by, optimize=True), 0.0))

    @property
    def values_covariance(self) -> Array | None:
        """As the campaign left it."""
        return self.posterior

    def scatter(self, wrench: Array, row: Row) -> Array | None:
        """Return the declared law's scatter, and beyond the loads what may be left of a correction.

        Beyond the observed loads a correction may be as large as it was among them, and grow with the load.
        """
        covariance = self.declared.scatter(wrench, row)
        if self.reach is not None:
            std = self.seen.unknown(wrench)[..., None] * self.reach
            unknown = std[..., None] ** 2 * np.eye(6)
            covariance = unknown if covariance is None else covariance + unknown
        return covariance

    def certain(self) -> LearnedLaw:
        return replace(self, posterior=None)

    def with_posterior(self, posterior: Array, wrenches: Array, row: Row) -> LearnedLaw:
        """Return the law with the (k, k) covariance of its values, fitted at (M, 6) wrenches, all in SI units."""
        posterior_law = replace(self, posterior=posterior)
        seen = replace(self.seen, loads=np.array([wrenches.min(axis=0), wrenches.max(axis=0)]))
        if self.correction is None:
            return replace(posterior_law, seen=seen)
        form, of_form = self.correction.law, posterior[self._count :, self._count :]
        sizes, by = form.twist(wrenches, row), form.by_values(wrenches, row)
        variance = np.einsum("nak,kl,nal->na", by, of_form, by, optimize=True)
        faded, energy = fading(self.plain, self.correction, wrenches, row)
        reach = np.sqrt((sizes**2 + variance).max(axis=0))
        return replace(posterior_law, seen=replace(seen, faded=faded, energy=energy), reach=reach)

    def moved(self, step: Array) -> LearnedLaw:
        """Return the law whose twist is that of a (k,) step of its values away, to first order; it has no parameters.

        Values are logarithms and weights: far from where they were fitted a law bends in them, and what they do against
        each other no longer cancels.
        """
        count = self._count
        plain = self.plain if self.free is None else self.plain.moved(step[:count])
        form = None if self.correction is None else SteppedLaw(self.correction.law, step[count:])
        return replace(self, declared=plain, free=None, form=form, values=np.zeros(0), scales=(), posterior=None)

    @property
    def trained_on(self) -> Array:
        return self.seen.loads

    def flags(self, wrench: Array, row: Row) -> tuple[Flag, ...]:
        """Return a flag for every component of the load beyond those seen, by more than anybody knows them."""
        low, high = self.seen.loads
        # Of the range of a load, by which it may be beyond those seen: a campaign's loads are those of the arm as it
        # bends
        return beyond(np.array([low, high]) + 0.02 * (high - low) * np.array([[-1.0], [1.0]]), wrench)


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
    """Return a declared law with its parameters, at values that change nothing but a network's hidden weights."""
    free, form = law.learned(learning.travel), None
    if learning.model in (*NETWORKS, *TRAINED_ALONE):
        form = NetworkCorrection.start(seen, learning.neurons)
    elif learning.model in CORRECTED:
        straight = free is None or set(TWIST_NAMES).isdisjoint(parameter.name for parameter in free.parameters)
        form = PolynomialCorrection.start(seen, linear=straight)
    learned = LearnedLaw(law, free, form, seen, np.zeros(0), ())
    return replace(
        learned, values=learned.start, scales=tuple(learned.expected[place[0]].prior for place in learned.groups)
    )
