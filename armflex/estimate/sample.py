"""The posterior of learned laws by sampling, where Laplace's parabola may be too simple: networks bend their values.

The laws are followed exactly along their values; the loads on them stay those of the most probable arm, since they
change by what the arm gives more or less over its length. What else was fitted goes along in straight lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.errors import InputError
from armflex.estimate.block import LawBlock, learned_laws
from armflex.estimate.fit import Fit
from armflex.laws import Row
from armflex.laws.learned import LearnedLaw
from armflex.linear_gaussian import ROUNDING
from armflex.progress import Progress
from armflex.sampling.diagnostics import FEWEST_DRAWS, Diagnostics, diagnose


@dataclass(frozen=True, eq=False)
class LawSamples:
    """Draws from the posterior of all learned laws of an arm.

    Attributes:
        laws: The laws at their most probable values, by flexure.
        values: (S, k) drawn values by flexure.
        diagnostics: Of what the laws answer at the observed loads.
    """

    laws: dict[str, LearnedLaw]
    values: dict[str, Array]
    diagnostics: Diagnostics

    def twists(self, flexure: str, wrench: Array, row: Row) -> Array:
        """Return the (S, ..., 6) twists of the drawn laws under (..., 6) wrenches [m, rad]."""
        law = self.laws[flexure]
        return np.array([law.at(values).twist(wrench, row) for values in self.values[flexure]])

    def band(self, flexure: str, wrench: Array, row: Row, coverage: float = 0.95) -> tuple[Array, Array]:
        """Return the (..., 6) lower and upper end of what the twist is with a probability of `coverage`."""
        ends = 0.5 * (1.0 - coverage)
        lower, upper = np.quantile(self.twists(flexure, wrench, row), [ends, 1.0 - ends], axis=0)
        return lower, upper


def sample_laws(
    fit: Fit, draws: int = 250, seed: int = 0, progress: Progress | None = None, chains: int = 4
) -> LawSamples:
    """Return draws from the posterior of the learned laws of a fit, by NUTS in coordinates whitened by Laplace's.

    Where neither readings nor a prior determine a combination of other parameters, it stays where it was fitted.

    Args:
        fit: A fit with learned laws.
        draws: Of each chain, after as many in which it finds its step.
        seed: The same seed gives the same draws.
        progress: Called with (chains done, in all).
        chains: How many.

    Raises:
        InputError: Nothing was learned, or there are too few draws to judge.
        UnsupportedError: The sampler is not installed (`pip install armflex[bayes]`).
    """
    from armflex.sampling.nuts import SampledChain, no_u_turn  # loads the optional sampler

    if draws < FEWEST_DRAWS:
        raise InputError(f"{draws} draws: expected {FEWEST_DRAWS} or more of each chain, or they cannot be judged")
    blocks = [block for block in fit.blocks if isinstance(block, LawBlock)]
    if not blocks:
        raise InputError("no flexure has learn = true: there is no law to sample")
    block, laws, view = blocks[0], learned_laws(fit.setup.arm), fit.view
    line, row, names, places = view.line, view.line.row, fit.setup.arm.flexure_names, fit.places(blocks[0])
    noise, prior = max(fit.noise, 1.0), fit.prior

    # Of every law the (n, 6) whitened answer of the readings to its twists, its (M, 6) loads, and itself.
    weight = (np.sqrt(fit.weights) / view.sigma)[:, :, None]
    seen = [
        (weight * view.answer(lambda line, i=i: line.laws[:, :, i]), line.flexure_wrenches[:, i], law)
        for i, law in ((names.index(name), law) for name, law in laws.items())
    ]
    others = fit.regressors.copy()
    others[:, places] = 0.0
    directions = _determined(fit.posterior.covariance)

    def density(steps: Array) -> tuple[float, Array]:
        """Return the log posterior density, but for a constant, (k,) steps from the fit, and its gradient."""
        values = fit.values + directions @ steps
        moved, regressors = others @ (values - fit.values), others.copy()
        part_of_laws = zip(seen, block.split(values[places]), block.split(places), strict=True)
        for (answer, loads, law), part, here in part_of_laws:
            there = law.at(part)
            moved += (answer @ (there.twist(loads, row) - law.twist(loads, row))[..., None]).ravel()
            regressors[:, here] = (answer @ there.by_values(loads, row)).reshape(len(regressors), -1)
        residual = (fit.residual - moved) / noise
        pull = np.where(np.isfinite(prior), values / prior**2, 0.0)
        value = -0.5 * float(residual @ residual) - 0.5 * float(pull @ values)
        return value, directions.T @ (regressors.T @ residual / noise - pull)

    walks: list[SampledChain] = []
    for sequence in np.random.SeedSequence(seed).spawn(chains):
        start, whitened = np.zeros(directions.shape[1]), np.eye(directions.shape[1])
        walks.append(no_u_turn(density, start, whitened, draws, draws, sequence))
        if progress:
            progress(len(walks), chains)
    every = (fit.values + np.array([walk.draws for walk in walks]) @ directions.T)[:, :, places]
    # Judged by what the laws say at ten of the loads seen: values of networks may change places, answers not.
    thinned = np.linspace(0, len(view.rows) - 1, 10).astype(int)
    few, of_rows = [(loads[thinned], law) for _, loads, law in seen], row.some(thinned)
    judged = np.array([_said(few, of_rows, block.split(values)) for values in every.reshape(-1, len(places))])
    judged = judged.reshape(*every.shape[:2], -1)
    report = diagnose(judged, sum(walk.divergences for walk in walks), float(np.mean([w.acceptance for w in walks])))
    split = block.split(every.reshape(-1, len(places)).T)
    return LawSamples(laws, dict(zip(block.flexures, [part.T for part in split], strict=True)), report)


def _said(laws: Sequence[tuple[Array, LearnedLaw]], row: Row, parts: Sequence[Array]) -> Array:
    """Return what laws of these values answer to loads, of all that answer at all."""
    twists = [law.at(part).twist(loads, row) for (loads, law), part in zip(laws, parts, strict=True)]
    return np.concatenate([twist[:, twist.any(axis=0)].ravel() for twist in twists])


def _determined(covariance: Array) -> Array:
    """Return (P, k) directions that are determined, each a standard deviation of Laplace's posterior long."""
    scale = np.sqrt(np.diag(covariance))
    unit = np.where(scale > 0.0, scale, 1.0)
    size, axes = np.linalg.eigh(covariance / np.outer(unit, unit))
    determined = size > ROUNDING * size[-1]
    return unit[:, None] * axes[:, determined] * np.sqrt(size[determined])
