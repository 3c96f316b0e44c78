"""How probable each effect is, and what else it may be: the posterior, averaged over resamples of the campaign.

In each resample (`armflex.trace.resampling`) a climb finds the most probable model, and Gibbs' sampler goes on from
there: one hypothesis after the other is taken out and drawn anew beside the others. What is drawn from is its exact
conditional distribution over all hypotheses, all scales, and nothing. The average of those over sweeps and resamples is
the bagged posterior, one distribution for each effect that was found and one for what may still be missing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logit, logsumexp

from armflex.conventions import Array
from armflex.laws.effects.candidate import places_of
from armflex.laws.effects.effect import Search
from armflex.parameters import DOUBT
from armflex.plan.next_measurement import POSSIBLE
from armflex.trace.hypotheses import Hypothesis, oddness, of_family
from armflex.trace.projection import LEAST_INFORMED
from armflex.trace.refine import refine
from armflex.trace.screen import ALMOST, Dense, Screen
from armflex.trace.selection import MOST_COMPETING, SCALES, WITHIN, Chosen, Model, climbed, rivals, without
from armflex.trace.state import State

SWEEPS = 2
"""Tolerance: sweeps of the sampler in every resample."""

CREDIBLE = 1.0 - DOUBT
"""Confidence: probability of a credible set, beside which nothing is in question."""


@dataclass(frozen=True, eq=False)
class Credible:
    """What one effect of a model may be.

    Attributes:
        probability: Of the effect itself: its law and place, whatever is inside the law, in any of the places.
        nothing: Probability that there is no effect in its place, nor it in that of another.
        suspects: What else it may be with the probability of each, from 1 % on, the likeliest first.
        ranking: All hypotheses that compete with their log odds beside the other effects, the best first.
    """

    probability: float
    nothing: float
    suspects: tuple[tuple[Hypothesis, float], ...]
    ranking: tuple[tuple[Hypothesis, float], ...]

    @property
    def others(self) -> tuple[tuple[Hypothesis, float], ...]:
        """Those of what else it may be that make up the credible set with it."""
        before = np.cumsum([self.probability + self.nothing, *(chance for _, chance in self.suspects)])[:-1]
        return self.suspects[: int((before < CREDIBLE).sum())]

    @property
    def is_doubtful(self) -> bool:
        """Whether something else in its place is likelier than it, and than nothing."""
        return bool(self.suspects) and self.suspects[0][1] > max(self.probability, self.nothing)

    @property
    def is_gone(self) -> bool:
        """Whether nothing in its place is likelier than anything, or it is not among what is credible there.

        The median probability model has what is more probable than not (Barbieri and Berger 2004, "Optimal predictive
        model selection", Annals of Statistics 32).
        """
        return self.nothing > 0.5 or self.probability < DOUBT


def competing(screen: Screen, model: Model) -> Dense:
    """Return the evidence of what competes for any place in a model of a screen.

    What fitted parameters take over does not: no reading could show it, and no prediction lacks it.
    """
    aliased = {number for number, share in screen.single().items() if share is None or share <= ALMOST}
    mine = {chosen.number for chosen in model}
    candidates = {screen.groups[number].hypothesis.one for number in mine}
    screen.extend(_elsewhere(screen, model))
    beside, best, charges = screen.beside(model), dict[int, float](), dict[int, float]()
    for rest in (*map(beside.without, range(len(model))), beside):
        for rival in rivals(rest, refine, most=MOST_COMPETING, within=4.0 * WITHIN):  # a resample may bring it forward
            number = rival.chosen.number
            if number in aliased:
                continue
            if screen.groups[number].hypothesis.one in candidates and number not in mine:
                continue  # the same again, from the grid: it would count twice
            odds = float(rest.odds_at(number).max())
            if rival.odds > best.get(number, -np.inf):  # of the amplitudes that it has where it competes most
                best[number], charges[number] = rival.odds, max(odds - rival.odds, 0.0)
    for chosen, amplitudes in zip(model, beside.amplitudes, strict=True):
        charges[chosen.number] = screen.charge(chosen.number, amplitudes)
    priors = np.array([screen.prior(number) - charge for number, charge in charges.items()])
    return screen.dense(tuple(charges), priors)


def beside_families(evidence: Dense, model: Model, state: State, unit: float) -> tuple[Dense, Model]:
    """Return what competes with the families that a resample may have or do without as further hypotheses.

    A name that explains no more than a family does not survive where it is: it must beat that in every resample, as a
    name beside families that stay as they are need not. A family that does at the place of a name most of what the name
    does is no rival of it: it says the same of that place.

    Args:
        evidence: What competes beside the families of a state.
        model: Of it.
        state: The state.
        unit: Square of a whitened column that moves the target by 1 mm, RMS.

    Returns:
        What competes, families last, and the model with those of them that the state has.
    """
    if not model:
        return evidence, model
    sized, background, count = state.sized, state.background, len(evidence.groups)
    doubted = sized.doubted(background)
    projection = state.bare_without(*doubted).condensed
    families, columns, where = list[Hypothesis](), list[Array](), list[dict[str, Array]]()
    for name in (*doubted, *(name for name in sized.kinds.names if name not in background.names)):
        together, places = sized.together(name, background)
        together *= np.sqrt(unit / max(float((together**2).sum()), 1e-300))
        information, axes = np.linalg.eigh(projection.inside(together))
        axes = axes[:, information * SCALES[0] ** 2 > LEAST_INFORMED]
        families.append(of_family(name, len(sized.kinds.names)))
        columns.append(together @ axes)
        where.append({place: together[:, places == place] @ axes[places == place] for place in set(places)})
    whole, with_common = evidence.extended(families, columns, projection), model
    for number in range(count, count + len(doubted)):
        scale = int(whole.beside(with_common).odds_at(number).argmax())
        with_common = (*with_common, Chosen(number, scale))
    competes = np.arange(len(families)) < len(doubted)
    for place, chosen in enumerate(model):
        others, beside = without(with_common, place), whole.beside(with_common)
        named = evidence.columns[:, evidence.groups[chosen.number].places] @ beside.values[beside.own[place]]
        site = evidence.groups[chosen.number].hypothesis.one.location.place
        odds = whole.beside(others).odds
        for i in np.flatnonzero(odds[count:].max(axis=1) > max(odds[chosen.number].max() - 4.0 * WITHIN, 0.0)):
            instead = whole.beside((*others, Chosen(int(count + i), int(odds[count + i].argmax()))))
            there = where[i][site] @ instead.values[instead.own[-1]] if site in where[i] else 0.0
            left = projection.inside(np.column_stack([named, named - there]))
            competes[i] |= left[1, 1] > 0.5 * left[0, 0]
    kept = np.flatnonzero(competes).tolist()  # those that the state has come first and keep their numbers
    return evidence.extended([families[i] for i in kept], [columns[i] for i in kept], projection), with_common


def _elsewhere(screen: Screen, model: Model) -> list[Hypothesis]:
    """Return shapes of a model that were only sought where they are, at all other places over the same columns."""
    held, elsewhere = {group.hypothesis.one for group in screen.groups}, list[Hypothesis]()
    for shape in (screen.groups[chosen.number].hypothesis for chosen in model):
        law, covariates = shape.one.law, shape.one.location.covariates
        for place in places_of(law, screen.context) if law.search is Search.RESIDUAL else ():
            moved = replace(shape.one, location=place)
            if place.covariates == covariates and moved not in held:
                odd = oddness(moved)
                elsewhere.append(replace(shape, one=moved, prior=shape.prior + odd - shape.odd, odd=odd))
    return elsewhere


def named(evidence: Dense, own: Model) -> np.ndarray:
    """Return (H,) which hypothesis stands for each: the model's, or the likeliest, that says the same of a place."""
    hypotheses, numbers = [group.hypothesis for group in evidence.groups], [chosen.number for chosen in own]
    numbers += [i for i in np.argsort(-evidence.beside(own).odds.max(axis=1)).tolist() if i not in numbers]
    names = np.arange(len(hypotheses))
    for place, i in enumerate(numbers):
        names[i] = next((j for j in numbers[:place] if names[j] == j and hypotheses[j].alike(hypotheses[i])), i)
    return names


@dataclass(frozen=True, eq=False)
class Drawn:
    """A model that was drawn in a resample of a campaign, with its most probable values there.

    Attributes:
        model: In the places of the model that it was drawn instead of.
        amplitudes: Of each of its hypotheses [the law's unit].
        spread: (K, K) covariance of all of those.
        rest: (P,) values of what is fitted anyway.
    """

    model: Model
    amplitudes: tuple[Array, ...]
    spread: Array
    rest: Array


@dataclass(frozen=True, eq=False)
class Bagged:
    """The posterior of every place of a model, averaged over resamples of a campaign.

    Attributes:
        credible: What every hypothesis of the model may be, last what may be missing beside them.
        visited: Models that the sampler visited.
        drawn: Models as sweeps of the sampler left them.
        sure: Whether every hypothesis of the model is so much likelier than all else in these resamples, by four
            standard deviations of its log odds, that more of them would say the same.
    """

    credible: tuple[Credible, ...]
    visited: set[Model]
    drawn: tuple[Drawn, ...]
    sure: bool


def bagged(
    evidence: Dense, own: Model, times: Iterable[Array], seed: int = 0, families: tuple[Dense, Model] | None = None
) -> Bagged:
    """Return the posterior of every place of a model, averaged over resamples of a campaign.

    Args:
        evidence: What competes.
        own: The model.
        times: (R, n) how often every reading counts in each resample of the campaign.
        seed: Of what is drawn.
        families: What competes `beside_families`; what they have is nothing in the place of an effect. When not given
            they are as the evidence has them.
    """
    rng, names, visited = np.random.default_rng(seed), named(evidence, own), set[Model]()
    mine, count = [int(names[chosen.number]) for chosen in own], len(names)
    other = ~np.isin(np.arange(count), mine)
    chances, nothing = np.zeros((len(own) + 1, count)), np.zeros(len(own) + 1)
    whole, begun = families or (evidence, own)
    part, plain, best = None, evidence, own
    sweeps, margins = list[Drawn](), [list[float]() for _ in own]
    for each in times:
        before, part = part, whole.resampled(each)
        if part is not before:  # from what was found, and from nothing: where both lead the likelier is taken
            best = max((climbed(part, start) for start in (begun, ())), key=part.log_posterior)
            plain = evidence.resampled(each) if families else part
        slots = _placed(tuple(chosen for chosen in best if chosen.number < count), own, names)
        common = {chosen.number: chosen for chosen in best if chosen.number >= count}
        for i in [*range(len(own) + 1)] * SWEEPS:
            if i == len(own):
                sweeps.append(_drawn(plain, slots, own))
                common = _drawn_families(part, slots, common, count, rng)
                if None in slots:
                    continue  # what is drawn beside a model that lacks one is that one
            elsewhere = _present(slots[:i] + slots[i + 1 :])
            beside = part.beside((*elsewhere, *common.values()))
            odds = beside.odds.copy()
            odds[list(common)] = -np.inf
            scale = float(np.logaddexp(0.0, logsumexp(odds)))
            weights, none = np.exp(odds - scale), float(np.exp(-scale))
            chance = np.bincount(names, weights[:count].sum(axis=1), count)
            unnamed = none + float(weights[count:].sum())
            if i == len(own):
                chances[i] += chance
                nothing[i] += unnamed
                continue
            # Effects may have changed places: one that is in another's is there, and its own place says nothing of it.
            held = sum(names[there.number] == mine[i] for there in elsewhere)
            if held >= mine.count(mine[i]):
                chances[i, mine[i]] += 1.0
            else:
                chances[i] += np.where(other | (np.arange(count) == mine[i]), chance, 0.0)
                nothing[i] += unnamed
                margins[i].append(float(logit(np.clip(chance[mine[i]], 1e-12, 1.0 - 1e-12))))
            slots[i] = _chosen(np.append(weights.ravel(), none), rng)
            if (drawn := slots[i]) is not None and drawn.number >= count:
                common, slots[i] = common | {drawn.number: drawn}, None
            visited.add(tuple(_present(slots)))
    counted = np.maximum(chances.sum(axis=1) + nothing, 1e-300)
    nothing /= counted
    credible = []
    for i, chance in enumerate(chances / counted[:, None]):
        odds = evidence.beside(without(own, i)).odds.max(axis=1)
        best_of = dict[int, tuple[Hypothesis, float]]()
        for number in np.argsort(-odds).tolist():
            best_of.setdefault(int(names[number]), (evidence.groups[number].hypothesis, float(odds[number])))
        suspects = [
            (best_of[name][0], float(chance[name])) for name in best_of if other[name] and chance[name] >= POSSIBLE
        ]
        probability = float(chance[mine[i]]) if i < len(own) else 0.0
        suspects.sort(key=lambda pair: -pair[1])
        credible.append(Credible(probability, float(nothing[i]), tuple(suspects), tuple(best_of.values())))
    sure = all(len(odds) > 1 and np.mean(odds) > 4.0 * np.std(odds) for odds in margins)
    return Bagged(tuple(credible), visited, tuple(sweeps), sure)


def _present(slots: Sequence[Chosen | None]) -> list[Chosen]:
    return [chosen for chosen in slots if chosen is not None]


def _chosen(weights: Array, rng: np.random.Generator) -> Chosen | None:
    """Return a hypothesis at a scale, or none, as likely as (H T + 1,) weights say."""
    drawn = int(rng.choice(len(weights), p=weights / weights.sum()))
    return None if drawn == len(weights) - 1 else Chosen(*divmod(drawn, len(SCALES)))


def _drawn_families(
    part: Dense, slots: Sequence[Chosen | None], common: dict[int, Chosen], count: int, rng: np.random.Generator
) -> dict[int, Chosen]:
    """Return which families there are beside a model, each drawn anew; the first `count` hypotheses are none."""
    for number in range(count, len(part.groups)):
        others = {other: chosen for other, chosen in common.items() if other != number}
        odds = part.beside((*_present(slots), *others.values())).odds_at(number)
        drawn = _chosen(np.exp(np.append(odds, 0.0) - logsumexp(np.append(odds, 0.0))), rng)
        common = others if drawn is None else others | {number: Chosen(number, drawn.scale)}
    return common


def _drawn(part: Dense, slots: Sequence[Chosen | None], own: Model) -> Drawn:
    """Return a model that was drawn in a resample; an effect in its own place is as it was found there.

    Unless that is doubtful there: values inside its law are then others.
    """
    slots = list(slots)
    for i, (now, before) in enumerate(zip(slots, own, strict=True)):
        if now is None or now.number == before.number or before.number in {slot.number for slot in slots if slot}:
            continue
        if part.groups[now.number].hypothesis.spot != part.groups[before.number].hypothesis.spot:
            continue
        others = [slot for slot in slots if slot is not None]
        model = tuple(before if slot is now else slot for slot in others)
        if part.log_posterior(model) > part.log_posterior(tuple(others)) + np.log(DOUBT):
            slots[i] = before
    model = tuple(slot for slot in slots if slot is not None)
    beside = part.beside(model)
    rest = part.projection.absorbed(part.projection.data - part.columns[:, beside.places] @ beside.values)
    scale = np.concatenate([np.zeros(0), *(part.groups[chosen.number].scale for chosen in model)])
    spread = beside.noise**2 * (beside.inverse.T @ beside.inverse) * scale * scale[:, None]
    return Drawn(model, beside.amplitudes, spread, rest)


def _placed(model: Model, own: Model, names: np.ndarray) -> list[Chosen | None]:
    """Return a model in the places of another: what has the same name in its place, the rest where places are free."""
    rest, slots = list(model), list[Chosen | None]()
    for chosen in own:
        slots.append(next((other for other in rest if names[other.number] == names[chosen.number]), None))
        rest = [other for other in rest if other is not slots[-1]]
    return [rest.pop(0) if slot is None and rest else slot for slot in slots]
