"""What the data determine of each parameter, and what they do not."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.errors import FEW
from armflex.estimate.fit import Fit
from armflex.estimate.robust import outlier_limit
from armflex.linear_gaussian import ROUNDING, LinearGaussian
from armflex.parameters import ABSURD, ArmParameter, ParameterKind

UNDETERMINED = 0.9
"""Confidence: posterior over prior standard deviation above which the data has said nothing about a parameter."""


@dataclass(frozen=True)
class FittedParameter:
    """One fitted number.

    Attributes:
        which: Which it is; compliance is the logarithm of a factor.
        value, std: Deviation from the declared value and its posterior standard uncertainty, infinite where neither the
            data nor a prior determine it.
        prior: Its prior standard deviation, infinite where nothing was known.
        determined: Whether the data said anything about it.
        trades_against: Parameters that it can be exchanged for without the readings noticing.
        combined: Whether only the priors of those determine it: the readings determine a combination of them.
        moves: RMS by which one prior standard deviation moves the readings, in their standard deviations; infinite
            where nothing was known.
    """

    which: ArmParameter
    value: float
    std: float
    prior: float
    determined: bool
    trades_against: tuple[str, ...]
    combined: bool = False
    moves: float = np.inf

    @property
    def kind(self) -> ParameterKind:
        """What it is of."""
        return self.which.group.kind

    @property
    def block(self) -> str:
        """Name of the block that it was fitted in."""
        return self.which.group.block

    @property
    def label(self) -> str:
        """What it is called there."""
        return self.which.rest

    @property
    def unit(self) -> str:
        """Its unit."""
        return self.which.unit

    @property
    def name(self) -> str:
        """Block and label."""
        return self.which.label

    @property
    def pull(self) -> float:
        """Value in prior standard deviations."""
        return self.value / self.prior

    @property
    def surprising(self) -> bool:
        """Whether the declared value was wrong by more than its prior allows, and the data determine it."""
        return self.determined and abs(self.pull) > outlier_limit(1)

    @property
    def absorbing(self) -> bool:
        """Whether readings that hardly depend on it moved it far from its prior: it makes up for what the arm lacks.

        Readings that scatter as they state and inform so little cannot move a value by more than a prior deviation or
        two. A compliance that is drawn towards zero ends so: the smaller it is, the less the readings depend on it.
        """
        return not self.determined and abs(self.pull) > outlier_limit(1)

    def reason(self, called: Mapping[str, str] | None = None) -> str:
        """Return why the readings do not determine it.

        Args:
            called: What parameters are called where not by their own names.
        """
        if self.absorbing:
            return f"{abs(self.pull):.2g} prior deviations off all the same: it absorbs what the arm lacks"
        if self.trades_against:
            return (
                f"can be exchanged for {', '.join((called or {}).get(label, label) for label in self.trades_against)}"
            )
        if not self.moves:
            return "no row loads it" if self.kind is ParameterKind.COMPLIANCE else "moves no reading"
        size = f" ({self.moves:.1g} of their noise per prior deviation)" if np.isfinite(self.moves) else ""
        return f"moves the readings too little{size}"


def parameters(fit: Fit) -> tuple[FittedParameter, ...]:
    """Return every parameter of a fit with what is known about it."""
    std, names = fit.posterior.std, [which.label for which in fit.parameters]
    determined = std < UNDETERMINED * fit.prior
    posterior = LinearGaussian(fit.information).with_precision(fit.precision)  # others take over within their priors
    combined = [bool(determined[i]) and _only_combined(fit, i) for i in range(len(names))]
    asked = [combined[i] or not determined[i] for i in range(len(names))]
    partners = [partners_of(fit.information, posterior, i, names) if asked[i] else () for i in range(len(names))]
    shown_by = np.sqrt(np.diag(fit.information) / fit.view.count)
    shown = shown_by > ROUNDING * shown_by.max(initial=0.0)
    moves = np.where(shown, fit.prior * np.where(shown, shown_by, 1.0), 0.0)
    numbers = (part.tolist() for part in (fit.values, std, fit.prior, determined))
    parts = zip(fit.parameters, *numbers, partners, combined, moves.tolist(), strict=True)
    return tuple(FittedParameter(*numbers) for numbers in parts)


def below_zero(fit: Fit) -> Iterator[tuple[ArmParameter, float, float]]:
    """Yield compliances that readings would have below zero, were it not for their logarithm: times what was declared,
    with the standard uncertainty of that.

    A factor f enters readings as they are, so that a step of its logarithm is meant to be one of f / f. Every other
    parameter has its prior, this one none.
    """
    noise = max(fit.noise, 1.0)
    score = (
        fit.regressors.T @ fit.residual / noise**2 - np.where(np.isfinite(fit.prior), fit.precision, 0.0) * fit.values
    )
    for i, which in enumerate(fit.parameters):
        factor = float(np.exp(fit.values[i]))
        if which.group.kind is not ParameterKind.COMPLIANCE or not fit.information[i, i] > 0.0:
            continue
        free, crossed = fit.precision.copy(), score.copy()
        free[i], crossed[i] = 0.0, fit.regressors[:, i] @ fit.residual / noise**2
        posterior = LinearGaussian(fit.information / noise**2).with_precision(free)
        size, std = factor * (1.0 + float(posterior.solve(crossed)[i])), factor * float(posterior.std[i])
        if size + outlier_limit(1) * std < 0.0:  # of many compliances some are below zero by chance
            yield which, size, std


def _only_combined(fit: Fit, index: int) -> bool:
    """Return whether the readings determine nothing of a parameter once the others may be `ABSURD` times as far off.

    Where the sum of two alone is determined, each comes out at 0.7 of its prior, however good the readings are.
    """
    prior, noise = fit.prior[index], max(fit.noise, 1.0)
    if not np.isfinite(prior):
        return False
    loose = fit.precision / ABSURD**2
    loose[index] = fit.precision[index]
    left = LinearGaussian(fit.information / noise**2).with_precision(loose)
    return float(left.std[index]) >= UNDETERMINED * prior


def partners_of(normal: Array, posterior: LinearGaussian, index: int, names: Sequence[str]) -> tuple[str, ...]:
    """Return the parameters that take over one parameter's effect on the readings best, the strongest first.

    None unless all others together take over half of it. Nor where the readings do not depend on it: what rounding
    resembles is no finding, and differs between processors.

    Args:
        normal: (P, P) information of the readings alone.
        posterior: The same with the priors.
        index: Which parameter.
        names: Of all parameters.
    """
    others = np.delete(np.arange(len(names)), index)
    sizes = np.sqrt(np.diag(normal))
    if sizes[index] <= ROUNDING * sizes.max():
        return ()
    amount = posterior.conditional(others).solve(normal[others, index])
    if 2.0 * normal[others, index] @ amount < normal[index, index]:
        return ()
    effect = np.abs(amount) * sizes[others]
    strong = [int(i) for i in np.argsort(-effect) if 2.0 * effect[i] >= effect.max()]
    return tuple(names[int(others[i])] for i in strong[:FEW])


def about_zeros(fitted: Iterable[ArmParameter]) -> Iterator[str]:
    """Yield what the uncertainty of an offset is not, where frames may turn about axes of joints as well."""
    if {ParameterKind.OFFSET, ParameterKind.GEOMETRY} <= {parameter.group.kind for parameter in fitted}:
        text = (
            "± of a joint_offset is of that parameter alone. A joint's zero, which is its offset with what turns its "
        )
        yield f"{text}frames about its axis, is known better: see `armflex export FIT.toml --to sheet`."
