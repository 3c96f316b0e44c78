"""How probable each effect is, and what else it may be: Gibbs' sampler over the hypotheses that compete.

One hypothesis of a model after the other is taken out and drawn anew beside the others. What is drawn from is its exact
conditional distribution over all hypotheses, all scales, and nothing; the average of those over the sweeps is the
posterior (Rao and Blackwell), one distribution for each effect that was found and one for what may still be missing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from armflex.laws.effects.candidate import places_of
from armflex.parameters import DOUBT
from armflex.trace.hypotheses import Hypothesis, oddness
from armflex.trace.refine import refine
from armflex.trace.screen import ALMOST, Dense, Screen
from armflex.trace.selection import MOST_COMPETING, Chosen, Model, rivals, without

SWEEPS = 60
"""Tolerance: sweeps of the sampler."""

CREDIBLE = 1.0 - DOUBT
"""Confidence: probability of a credible set, beside which nothing is in question."""


@dataclass(frozen=True, eq=False)
class Credible:
    """What one effect of a model may be.

    Attributes:
        probability: Of the effect itself: its law and place, whatever is inside the law, in any of the places.
        nothing: Probability that there is no effect in its place, nor it in that of another.
        others: The hypotheses beside it that make up the credible set, with the probability of each, the likeliest
            first.
        ranking: All hypotheses that compete with their log odds beside the other effects, the best first.
    """

    probability: float
    nothing: float
    others: tuple[tuple[Hypothesis, float], ...]
    ranking: tuple[tuple[Hypothesis, float], ...]

    @property
    def doubtful(self) -> bool:
        """Whether something else in its place is likelier than it, and than nothing."""
        return bool(self.others) and self.others[0][1] > max(self.probability, self.nothing)


def competing(screen: Screen, model: Model) -> Dense:
    """Return the evidence of what competes for any place in a model of a screen.

    What fitted parameters take over does not: no reading could show it, and no prediction lacks it.
    """
    aliased = {number for number, share in screen.single().items() if share is None or share <= ALMOST}
    own, mine = {screen.groups[one.number].hypothesis.members for one in model}, {one.number for one in model}
    screen.extend(_elsewhere(screen, model))
    beside, found, charges = screen.beside(model), dict[int, float](), dict[int, float]()
    for rest in (*map(beside.without, range(len(model))), beside):
        for one in rivals(rest, refine, most=MOST_COMPETING):
            if one.chosen.number in aliased:
                continue
            if screen.groups[one.chosen.number].hypothesis.members in own and one.chosen.number not in mine:
                continue  # the same again, from the grid: it would count twice
            number, odds = one.chosen.number, float(rest.odds_at(one.chosen.number).max())
            if one.odds > found.get(number, -np.inf):  # of the amplitudes that it has where it competes most
                found[number], charges[number] = one.odds, max(odds - one.odds, 0.0)
    for one, amplitudes in zip(model, beside.amplitudes, strict=True):
        charges[one.number] = screen.charge(one.number, amplitudes)
    priors = np.array([screen.prior(number) - charge for number, charge in charges.items()])
    return screen.dense(tuple(charges), priors)


def _elsewhere(screen: Screen, model: Model) -> list[Hypothesis]:
    """Return shapes of a model that were only sought where they are, at all other places over the same columns."""
    known, found = {one.hypothesis.members for one in screen.groups}, list[Hypothesis]()
    for shape in (screen.groups[one.number].hypothesis for one in model):
        law, covariates = shape.one.law, shape.one.location.covariates
        for place in places_of(law, screen.context) if law.sought else ():
            one = replace(shape.one, location=place)
            if place.covariates == covariates and (one,) not in known:
                found.append(replace(shape, members=(one,), prior=shape.prior + oddness(one) - oddness(shape.one)))
    return found


def named(evidence: Dense, own: Model) -> np.ndarray:
    """Return (H,) which hypothesis stands for each: the model's, or the likeliest, that says the same of a place."""
    known, numbers = [one.hypothesis for one in evidence.groups], [one.number for one in own]
    numbers += [i for i in np.argsort(-evidence.beside(own).odds.max(axis=1)).tolist() if i not in numbers]
    found = np.arange(len(known))
    for place, i in enumerate(numbers):
        found[i] = next((j for j in numbers[:place] if found[j] == j and known[j].alike(known[i])), i)
    return found


def sampled(evidence: Dense, own: Model, seed: int = 0) -> tuple[tuple[Credible, ...], set[Model]]:
    """Return what every hypothesis of a model may be, last what may be missing beside them; and the models drawn."""
    rng, slots = np.random.default_rng(seed), list[Chosen | None](own)
    names = named(evidence, own)
    mine = [int(names[one.number]) for one in own]
    other = ~np.isin(np.arange(len(names)), mine)
    chances, nothing = np.zeros((len(own) + 1, len(names))), np.zeros(len(own) + 1)
    visited = set[Model]()
    for _ in range(SWEEPS):
        for i in range(len(own) + 1):
            if i == len(own) and None in slots:
                continue  # what is drawn beside a model that lacks one is that one
            beside = evidence.beside(tuple(one for j, one in enumerate(slots) if j != i and one is not None))
            whole = float(np.logaddexp(0.0, logsumexp(beside.odds)))
            weights, none = np.exp(beside.odds - whole), float(np.exp(-whole))
            chance = np.bincount(names, weights.sum(axis=1), len(names))
            if i == len(own):
                chances[i] += chance
                nothing[i] += none
                continue
            # Effects may have changed places: one that is in another's is there, and its own place says nothing of it.
            held = sum(names[one.number] == mine[i] for j, one in enumerate(slots) if j != i and one is not None)
            if held >= mine.count(mine[i]):
                chances[i, mine[i]] += 1.0
            else:
                chances[i] += np.where(other | (np.arange(len(names)) == mine[i]), chance, 0.0)
                nothing[i] += none
            every = np.append(weights.ravel(), none)
            drawn = rng.choice(len(every), p=every / every.sum())
            slots[i] = None if drawn == weights.size else Chosen(*map(int, np.unravel_index(drawn, weights.shape)))
            visited.add(tuple(one for one in slots if one is not None))
    counted = np.maximum(chances.sum(axis=1) + nothing, 1e-300)
    nothing /= counted
    found = []
    for i, chance in enumerate(chances / counted[:, None]):
        odds = evidence.beside(without(own, i)).odds.max(axis=1)
        best = dict[int, tuple[Hypothesis, float]]()
        for number in np.argsort(-odds).tolist():
            best.setdefault(int(names[number]), (evidence.groups[number].hypothesis, float(odds[number])))
        probability = float(chance[mine[i]]) if i < len(own) else 0.0
        others, reached = [], probability + float(nothing[i])
        for name in sorted(best, key=lambda one: -chance[one]):
            if other[name] and (reached < CREDIBLE or i == len(own)):
                others.append((best[name][0], float(chance[name])))
                reached += chance[name]
        found.append(Credible(probability, float(nothing[i]), tuple(others), tuple(best.values())))
    return tuple(found), visited
