"""The account of a search: probabilities, what else an effect may be, errors on poses held out, what could be shown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from armflex.errors import ArmflexError, ConvergenceError
from armflex.estimate.fit import THOROUGH
from armflex.estimate.held_out import excess, held_out, pose_folds
from armflex.estimate.learn import with_posteriors
from armflex.estimate.posterior import certainty_of
from armflex.estimate.robust import robust_limit
from armflex.estimate.view import look
from armflex.laws.effects.effect import Effect
from armflex.parameters import DOUBT, ArmParameter, Certainty
from armflex.plan.asking import Cause
from armflex.plan.design_model import Before, Measured, noises_of
from armflex.plan.next_measurement import Alternatives, lacking, misplaced_centres, next_measurement, warming
from armflex.trace.averaging import Averaged, alone, averaged, beside_calibrated
from armflex.trace.findings import (
    VARIANCE_RATIO,
    Found,
    Smallest,
    Trace,
    Undecided,
    Unexplained,
    Unidentifiable,
    unexplained,
)
from armflex.trace.hypotheses import Hypothesis
from armflex.trace.probabilities import CREDIBLE, Bagged, Credible, bagged, beside_families, competing
from armflex.trace.resampling import Resampled, parted_by, resampled
from armflex.trace.screen import ALMOST, UNIT_MOTION, Dense
from armflex.trace.search import (
    Standing,
    exchanged,
    is_bounded,
    is_full,
    linear,
    refitted,
    spots,
    standing,
    with_families,
)
from armflex.trace.selection import BETTER, SCALES, Chosen, Model, climbed, without
from armflex.trace.state import State, lost_of, refit, sorted_out
from armflex.trace.unrecorded import RandomTwist
from armflex.trace.validate import Folds, Validated, sessions_held_out, validated


@dataclass(frozen=True, eq=False)
class Weighed:
    """A state with what is known of its hypotheses.

    Attributes:
        here: The state.
        credible: What each hypothesis may be, and last what may be missing.
        resampled: The resamples of the campaign over which that is an average.
        validated: How it predicts poses held out; None where nothing was found.
        averaged: The average over the models of those resamples.
    """

    here: Standing
    credible: tuple[Credible, ...]
    resampled: Resampled
    validated: Validated | None
    averaged: Averaged


def weighed(here: Standing) -> Weighed:
    """Return a state with probabilities, without what is likelier to be nothing, or all but certainly something else.

    Where something else is likelier in the place of an effect, the arm is fitted with that, and the better is kept.
    What is likelier missing than not is added, once.
    """
    added = set[tuple]()
    while True:
        state = here.state
        state.reporter.stage("weighing what else the effects may be")
        evidence = competing(here.screen, here.model)
        model, folds = evidence.here(here.model), Folds(evidence, pose_folds(state.groups))
        resamples = resampled(evidence, model, parted_by(state), folds)
        families = beside_families(evidence, model, state, here.screen.unit)
        for times in (resamples.few, resamples.times):
            posterior = bagged(evidence, model, times, families=families)
            credible = posterior.credible
            after = _with_likelier(here, evidence, model, posterior)
            if after is not None or posterior.sure or any(verdict.nothing > CREDIBLE for verdict in credible[:-1]):
                break
        if after is not None:
            here = after
            continue
        gone = [i for i, verdict in enumerate(credible[:-1]) if verdict.is_gone]
        longer = None if gone else _with_missing(here, evidence, model, credible[-1])
        if longer is not None and longer.identity not in added:
            added.add(longer.identity)
            here = standing(longer, here)
            continue
        if not gone:
            here.screen.forget()
            average, seen = averaged(state, evidence, model, posterior.drawn, resamples.parts), None
            if model or state.background.names:
                average = beside_calibrated(average, folds, resamples)
            if model:
                assert average.errors is not None
                seen = validated(here, folds, average.errors)
            return Weighed(here, credible, resamples, seen, average)
        withdrawn = [i for i in gone if credible[i].nothing > CREDIBLE]
        withdrawn = withdrawn or [min(gone, key=lambda i: credible[i].probability)]
        titles = (here.screen.groups[here.model[i].number].hypothesis.title for i in withdrawn)
        state.reporter.stage(f"withdrawing {', '.join(titles)}")
        after = refitted(here, without(here.model, *withdrawn))
        if after is None:  # an arm that does not come to rest without it is left with nothing of what was found
            after = refitted(here, ())
        if after is None:
            raise ConvergenceError("the arm with nothing added does not come to rest, or its fit does not settle", ())
        after = with_families(after)  # what it was taken for may be one
        here = replace(standing(after, here), rejected=[*here.rejected, spots(here.screen, here.model)])


def _with_likelier(here: Standing, evidence: Dense, model: Model, posterior: Bagged) -> Standing | None:
    """Return the state with something else in the place of an effect that is less likely than it.

    None where no effect is doubtful, or nothing comes out better. The state itself where rivals were fitted and came
    out worse: they are charged with that from then on.
    """
    doubted = [rival for rival, seen in zip(here.model, posterior.credible, strict=False) if seen.is_doubtful]
    if not doubted:
        return None
    full, tried = is_full(here), len(here.rejected)
    # Each fit takes seconds where more is missing than can be named: there the likeliest is tried.
    models = map(evidence.there, {climbed(evidence, model)} if full else posterior.visited)
    spots_before, unlikely = spots(here.screen, here.model), spots(here.screen, tuple(doubted))
    after = exchanged(here, [rival for rival in models if any((spots_before - spots(here.screen, rival)) & unlikely)])
    return here if after is None and len(here.rejected) > tried and not full else after


def _with_missing(here: Standing, evidence: Dense, model: Model, missing: Credible) -> State | None:
    """Return the state with what is likelier missing beside its effects than not, None where nothing is.

    The most probable model may do without what most models have: see `Credible.is_gone` for the median.
    """
    if not missing.suspects or missing.suspects[0][1] <= 0.5 or is_full(here) or is_bounded(here):
        return None
    likeliest, beside = missing.suspects[0][0], evidence.beside(model)
    number = next(i for i, group in enumerate(evidence.groups) if group.hypothesis is likeliest)
    longer = evidence.there((*model, Chosen(number, int(beside.odds_at(number).argmax()))))
    state = refitted(here, longer)
    return None if state is None else with_families(state)


def settled_exactly(here: Standing) -> Standing:
    """Return the state fitted to the end, with a linear problem of its own where that makes it more probable."""
    state = sorted_out(here.state)
    with suppress(ArmflexError):  # else what was reached stands
        exact = refit(state, state.effects, state.random, state.fit.values, THOROUGH)
        limit = robust_limit(exact.fit.view)
        rise = 0.5 * (state.fit.cost(limit) - exact.fit.cost(limit)) / state.quiet**2
        if state is here.state and rise < BETTER:
            return replace(here, state=exact)
        state = exact
    return here if state is here.state else standing(state, here)


def conclude(
    here: Standing,
    places: tuple[RandomTwist, ...],
    ask: int = 0,
    settable: Mapping[str, Sequence[float]] | None = None,
    ended: str = "",
    begun: State | None = None,
) -> Trace:
    """Return the account of a search that has come to its end; `ask` and `settable` as in `armflex.trace`.

    `places` are where a random twist would have explained what was left at first; `ended` is as in `Trace`. Where no
    family stays those of the state are said that it had `begun` with, if any.
    """
    here.state.reporter.stage("fitting to the end")
    outcome = weighed(settled_exactly(here))
    here, state = outcome.here, outcome.here.state
    findings = tuple(_found(outcome, number) for number in range(len(state.known)))
    left = unexplained(state, here.scattered)
    left_out = np.setdiff1d(state.asked[~(lost_of(state, heed=True)[1] | state.undirected)], state.rows)
    if left is None and len(left_out):  # although their neighbours are far off, too
        view = look(state.fit.setup, state.measurements, left_out)
        squares = view.readings.row_squares(view.residual)
        left = Unexplained(None, None, None, None, float(np.sqrt(squares.sum() / len(state.asked))))
    state.reporter.stage("weighing which kinds of effect are missing")
    families = (state if state.background.names else begun or state).sized.families
    state.reporter.stage("looking what would decide what is in question")
    errors, seen = _errors(outcome.averaged, outcome.validated), outcome.validated
    open_places, texts, asked = [place for place in _places(outcome, findings) if place.pairs], tuple[str, ...](), None
    if open_places:
        before = _before(state, errors["arm"].certainty)
        texts, asked = next_measurement(before, open_places, ask, settable or {})
    wrong = misplaced_centres(state.fitted, state.fit.setup.arm.robot)
    wrong += warming(state.fitted, tuple(state.measurements.covariates))
    return Trace(
        **errors,
        found=findings,
        families=families,
        unexplained=left,
        places=places,
        undecided=None if state.effects or left is not None else _undecided(outcome),
        not_identifiable=not_identifiable(here),
        smallest=smallest(here),
        next_measurement=(*wrong, *texts, *lacking(state.measurements, state.context)),
        asked=asked,
        compared=None if seen is None else seen.compared,
        nothing=0.0 if state.known or left is not None else outcome.credible[-1].nothing,
        suspects=_suspects(outcome),
        resampled=outcome.resampled,
        ended=ended,
    )


def so_far(state: State, places: tuple[RandomTwist, ...], ended: str, begun: State | None = None) -> Trace:
    """Return the account of a search that was ended at a state: what was accepted, without comparing it."""
    left = unexplained(state, linear(state).scattered)
    errors, families = _errors(alone(state)), None if begun is None else begun.sized.families
    return Trace(**errors, found=(), unexplained=left, places=places, families=families, unfinished=True, ended=ended)


def _errors(predicted: Averaged, seen: Validated | None = None) -> dict:
    """Return the parts of an account that every state has, once it is `seen` how held-out poses are predicted."""
    state = predicted.state
    fit, calibration = state.fit, state.calibration
    folds, judged = pose_folds(state.groups), state.judged
    certainty = certainty_of(fit) if seen is None else certainty_of(fit, least=0.0)
    if seen is not None and predicted.errors is not None and fit.view.readings.unit in ("m", "px"):
        chosen = excess(fit, folds, predicted.errors, judged, certainty.design_effect)
        certainty = replace(certainty, misfit=max(certainty.misfit, chosen))
    setup = predicted.setup
    arm = with_posteriors(setup.arm, fit, predicted.certainty(certainty))
    # A random twist stays behind, because nobody can foresee it.
    effects = (*calibration.arm.effects, *predicted.effects)
    return {
        "arm": replace(arm, effects=effects, instrument=setup.instrument).left(),
        "predicted": predicted,
        "held_out_before": held_out(state.calibrated, folds, judged=judged).rms,
        "held_out_after": held_out(fit, folds, judged=judged).rms,
        "held_out_sessions": sessions_held_out(state, range(len(state.effects))),
    }


def _found(outcome: Weighed, number: int) -> Found:
    state, credible, seen = outcome.here.state, outcome.credible[number], outcome.validated
    assert seen is not None
    return Found(
        effect=state.fitted[number],
        std=outcome.averaged.std_of(state.effects[number]),
        evidence=2.0 * credible.ranking[0][1],
        proof=seen.proofs[number],
        ranking=tuple((hypothesis, 2.0 * odds) for hypothesis, odds in credible.ranking),
        index=number,
        number=state.effects[number].number,
        probability=credible.probability,
        credible=_others(credible),
        determined=_is_determined(outcome.averaged, number),
    )


def _is_determined(averaged: Averaged, number: int) -> bool:
    """Return whether the amplitudes of an effect differ from zero beyond chance, whatever all other values are.

    As uncertain as they are stated: parts of the campaign that disagree about them count, too.
    """
    fit, block = averaged.state.fit, averaged.state.effects[number]
    places = fit.places(block)[: len(block.effect.location.terms)]
    places = places[np.isfinite(fit.posterior.std[places])]  # what nothing determines shows nothing
    covariance = fit.posterior.covariance[np.ix_(places, places)]
    wider = np.sqrt(np.maximum(averaged.scatter[places] / np.diag(covariance), 1.0))
    covariance, values = covariance * wider * wider[:, None], fit.values[places]
    return bool(values @ np.linalg.pinv(covariance, hermitian=True) @ values > chdtri(len(places) or 1, DOUBT))


def _suspects(outcome: Weighed) -> tuple[tuple[Effect, float], ...]:
    """Return every single effect that competes for any place with its probability, the likeliest first."""
    chances = dict[tuple, tuple[Hypothesis, float]]()
    pairs = zip(outcome.here.state.known, outcome.credible, strict=False)
    named = ((hypothesis, seen.probability) for hypothesis, seen in pairs)
    for hypothesis, chance in (*named, *(pair for seen in outcome.credible for pair in seen.suspects)):
        first, before = chances.get(hypothesis.spot, (hypothesis, 0.0))
        chances[hypothesis.spot] = first, min(before + chance, 1.0)
    ranked = sorted(chances.values(), key=lambda pair: -pair[1])
    return tuple(
        (hypothesis.one.effect(np.zeros(len(hypothesis.one.location.terms))), chance) for hypothesis, chance in ranked
    )


def _others(credible: Credible) -> tuple[tuple[Effect, float], ...]:
    """Return what else may be in a place, single effects without a size, with the probability of each."""
    single = [(candidate.one, chance) for candidate, chance in credible.others]
    return tuple((candidate.effect(np.zeros(len(candidate.location.terms))), chance) for candidate, chance in single)


def _places(outcome: Weighed, findings: Sequence[Found]) -> list[Alternatives]:
    """Return what may be in the place of every effect that was found, or what may be missing where nothing was."""
    count = len(outcome.here.state.declared.arm.effects)
    causes: Sequence[Cause | None] = [
        Cause(finding.effect, finding.probability, count + finding.index) for finding in findings
    ]
    single = outcome.credible[: len(outcome.here.state.known)]
    if not outcome.here.state.known:
        causes, single = [None], [outcome.credible[-1]]
    return [
        Alternatives(cause, [Cause(*pair) for pair in _others(credible)], credible.nothing)
        for cause, credible in zip(causes, single, strict=True)
    ]


def _before(state: State, certainty: Certainty) -> Before:
    """Return arm and campaign as a plan takes them; a random twist knows only the poses it was fitted to.

    Readings that scatter less than they state count as they state; see `certainty_of`.
    """
    fit, effects = state.fit, (*state.effects, *state.background.effects)
    count = len(state.declared.arm.effects) + len(effects)
    setup = replace(fit.setup, arm=replace(fit.setup.arm, effects=fit.setup.arm.effects[:count]))
    effect = max(certainty.design_effect * min(fit.noise, 1.0) ** 2, 1.0)
    measured, noise_floor = Measured.of(fit, state.measurements, replace(certainty, design_effect=effect), setup), 1.0
    if state.random is not None:
        left = measured.view.whitened[fit.view.rows] * np.sqrt(fit.weights)
        noise_floor = float(np.sqrt(fit.view.readings.row_squares(left).sum() / max(fit.view.count, 1)))
    return Before(setup, measured, {name: max(noise, noise_floor) for name, noise in noises_of(fit).items()})


def _undecided(outcome: Weighed) -> Undecided | None:
    """Return what is left where it is much although no effect is likelier than none, None elsewhere."""
    state, fit = outcome.here.state, outcome.here.state.fit
    if fit.noise**2 < VARIANCE_RATIO:
        return None
    likeliest = max((chance for _, chance in outcome.credible[-1].suspects), default=0.0)
    poses, stated = int(state.groups.max()) + 1, fit.view.rms(fit.view.sigma)
    return Undecided(fit.rms, stated, poses, likeliest, fit.view.readings.unit)


def not_identifiable(here: Standing) -> tuple[Unidentifiable, ...]:
    """Return laws and sites of which fitted parameters take over all but nothing, with the parameter that does most."""
    regressors, fit = here.state.fit.regressors, here.state.fit
    sizes = np.maximum(np.sqrt((regressors**2).sum(axis=0)), 1e-300)
    added = {(effect.law.name, effect.location) for effect in here.state.fitted}
    taken_over: dict[tuple[str, str], Unidentifiable] = {}
    for number, share in here.screen.single().items():
        candidate = here.screen.groups[number].hypothesis.one
        key = (candidate.law.name, candidate.location.place)
        if key in taken_over or (candidate.law.name, candidate.location) in added or not candidate.law.physical:
            continue
        if share is not None and share > ALMOST:
            continue
        partner: ArmParameter | None = None
        if share is not None:  # the parameter whose column is most like its own
            column = here.screen.columns(here.screen.groups[number].places)[:, 0]
            likeness = np.abs(regressors.T @ column) / (sizes * float(np.linalg.norm(column)))
            partner = fit.parameters[int(likeness.argmax())]
        taken_over[key] = Unidentifiable(*key, partner)
    return tuple(taken_over.values())


def smallest(here: Standing) -> tuple[Smallest, ...]:
    """Return for every law the range over its places of the tip motion (RMS) from which an effect is probable.

    That is the size at which the log odds of the effect beside what was found are 0, at the scale that it is drawn at.
    """
    screen, sizes_of = here.screen, dict[str, list[float]]()
    noise = screen.beside(here.model).noise  # beyond the scatter that columns are whitened by
    unit = UNIT_MOTION * screen.fit.view.per_metre * noise
    for number, share in screen.single().items():
        hypothesis = screen.groups[number].hypothesis
        if share is None or share <= ALMOST or not hypothesis.one.law.physical:
            continue
        information = share * screen.unit
        needed = np.log1p(SCALES**2 * information) - 2.0 * (hypothesis.prior - np.log(len(SCALES)))
        charged = needed / information * (1.0 + 1.0 / (SCALES**2 * information))
        sizes_of.setdefault(hypothesis.one.law.name, []).append(unit * float(np.sqrt(charged.min())))
    return tuple(Smallest(name, min(sizes), max(sizes)) for name, sizes in sizes_of.items())
