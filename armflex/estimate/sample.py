"""The posterior of learned laws by sampling, where Laplace's parabola may be too simple: networks bend their values.

The laws are followed exactly along their values; the loads on them stay those of the most probable arm, since they
change by what the arm gives more or less over its length. What else was fitted goes along in straight lines.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.errors import InputError
from armflex.estimate.fit import Fit
from armflex.estimate.law_block import LawBlock, learned_laws
from armflex.estimate.view import Progress
from armflex.laws import Row
from armflex.laws.learned import LearnedLaw
from armflex.linear_gaussian import ROUNDING
from armflex.sampling.diagnostics import FEWEST_DRAWS, Diagnostics, diagnose

CHAINS = 4
TUNE = 150
"""Draws of each chain that are thrown away while it finds its step."""


@dataclass(frozen=True, eq=False)
class LawSamples:
    """Draws from the posterior of all learned laws of an arm.

    Attributes:
        laws: The laws at their most probable values, by flexure.
        values: (S, k) drawn values by flexure.
        diagnostics: Of what the laws answer at the loads seen.
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


def sample_laws(found: Fit, draws: int = 250, seed: int = 0, progress: Progress | None = None) -> LawSamples:
    """Return draws from the posterior of the learned laws of a fit, by NUTS in coordinates whitened by Laplace's.

    Where neither readings nor a prior tell a combination of other parameters, it stays where it was fitted.

    Args:
        found: A fit with learned laws.
        draws: Of each of four chains.
        seed: The same seed gives the same draws.
        progress: Called with (chains done, in all).

    Raises:
        InputError: Nothing was learned, or there are too few draws to judge.
        UnsupportedError: The sampler is not installed (`pip install armflex[bayes]`).
    """
    from armflex.sampling.nuts import Walk, no_u_turn  # loads the optional sampler

    if draws < FEWEST_DRAWS:
        raise InputError(f"{draws} draws: expected {FEWEST_DRAWS} or more of each chain, or they cannot be judged")
    blocks = [block for block in found.blocks if isinstance(block, LawBlock)]
    if not blocks:
        raise InputError("no flexure has learn = true: there is no law to sample")
    problem = _Problem(found, blocks[0], learned_laws(found.setup.arm))
    size = problem.directions.shape[1]
    walks: list[Walk] = []
    for one in np.random.SeedSequence(seed).spawn(CHAINS):
        walks.append(no_u_turn(problem.along, np.zeros(size), np.eye(size), draws, TUNE, one))
        if progress:
            progress(len(walks), CHAINS)
    chains = found.values + np.array([walk.draws for walk in walks]) @ problem.directions.T
    answers = np.array([[problem.answers(values) for values in chain] for chain in chains])
    report = diagnose(answers, sum(walk.divergences for walk in walks), float(np.mean([w.acceptance for w in walks])))
    own = problem.block.split(chains.reshape(-1, chains.shape[2])[:, problem.places].T)
    return LawSamples(problem.laws, dict(zip(problem.block.flexures, [part.T for part in own], strict=True)), report)


@dataclass(frozen=True, eq=False)
class _Problem:
    """The posterior about a fit, loads as they are there."""

    found: Fit
    block: LawBlock
    laws: dict[str, LearnedLaw]

    @cached_property
    def places(self) -> np.ndarray:
        """Places of the laws' values among all."""
        return self.found.places(self.block)

    @cached_property
    def seen(self) -> list[tuple[Array, Array, LearnedLaw]]:
        """For every law the (n, 6) whitened answer of the readings to its twists, its (M, 6) loads, itself."""
        line, names = self.found.view.line, self.found.setup.arm.flexure_names
        view = self.found.view
        weight = np.sqrt(self.found.weights)[:, None, None] / view.sigma[:, :, None]
        found = []
        for name, law in self.laws.items():
            i = names.index(name)
            found.append((weight * view.answer(line.laws[:, :, i]), line.flexure_wrenches[:, i], law))
        return found

    @cached_property
    def others(self) -> Array:
        """(n, P) whitened columns of what is no law's, zero for laws."""
        columns = self.found.columns.copy()
        columns[:, self.places] = 0.0
        return columns

    @cached_property
    def directions(self) -> Array:
        """(P, k) directions that are told, each a standard deviation of Laplace's posterior long."""
        covariance = self.found.posterior.covariance
        scale = np.sqrt(np.diag(covariance))
        unit = np.where(scale > 0.0, scale, 1.0)
        size, axes = np.linalg.eigh(covariance / np.outer(unit, unit))
        told = size > ROUNDING * size[-1]
        return unit[:, None] * axes[:, told] * np.sqrt(size[told])

    def along(self, steps: Array) -> tuple[float, Array]:
        """Return the same as `density` at (k,) steps from the fit along `directions`."""
        value, gradient = self.density(self.found.values + self.directions @ steps)
        return value, self.directions.T @ gradient

    def density(self, values: Array) -> tuple[float, Array]:
        """Return the logarithm of the posterior density, but for a constant, and its gradient."""
        noise, prior = max(self.found.noise, 1.0), self.found.prior
        change = values - self.found.values
        moved = self.others @ change
        columns = self.others.copy()
        row, start = self.found.view.line.row, 0
        for (answer, loads, law), own in zip(self.seen, self.block.split(values[self.places]), strict=True):
            there, here = law.at(own), self.places[start : start + len(own)]
            moved += (answer @ (there.twist(loads, row) - law.twist(loads, row))[..., None]).ravel()
            columns[:, here] = (answer @ there.by_values(loads, row)).reshape(len(columns), -1)
            start += len(own)
        residual = (self.found.residual - moved) / noise
        pull = np.where(np.isfinite(prior), values / prior**2, 0.0)
        value = -0.5 * float(residual @ residual) - 0.5 * float(pull @ values)
        return value, columns.T @ residual / noise - pull

    def answers(self, values: Array) -> Array:
        """Return what the laws say at ten of the loads seen: values of networks may change places, answers not."""
        row = self.found.view.line.row
        some = np.linspace(0, len(self.found.view.rows) - 1, 10).astype(int)
        parts = zip(self.seen, self.block.split(values[self.places]), strict=True)
        twists = [law.at(own).twist(loads[some], row.some(some)) for (_, loads, law), own in parts]
        return np.concatenate([twist[:, twist.any(axis=0)].ravel() for twist in twists])
