"""`trace` by the posterior over sets of effects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from armflex.arm import Arm
from armflex.errors import ArmflexError, ConventionError
from armflex.estimate.calibrate import calibrate
from armflex.estimate.misread import check_scatter
from armflex.laws.effects.effect import Effect
from armflex.measured.measurements import Measurements
from armflex.trace.account import conclude, so_far
from armflex.trace.asking import Ask
from armflex.trace.candidates import Candidate
from armflex.trace.findings import Trace
from armflex.trace.hypotheses import Hypothesis, sought
from armflex.trace.search import Standing, own_model, refitted, search, standing
from armflex.trace.state import begin
from armflex.trace.telling import Doing, Report, Teller, tell_steps


def trace(
    arm: Arm,
    measurements: Measurements,
    rows: np.ndarray | None = None,
    report: Report | None = None,
    keep: bool = False,
    account: Callable[[Trace], None] | None = None,
    progress: Callable[[Doing], None] | None = None,
    anyway: bool = False,
    ask: Ask | None = None,
    accepted: Sequence[Effect] = (),
) -> Trace:
    """Return the traced arm and its account; `armflex.trace` says what goes in."""
    teller = Teller(report, progress)
    teller.stage("calibrating")
    steps = partial(tell_steps, teller.step)
    calibration = calibrate(arm, measurements, rows, steps, keep=keep, as_stated=True, anyway=anyway)
    begun = standing(begin(calibration, teller.step, teller.stage))
    places = begun.places

    def passing(here: Standing) -> None:
        effects = tuple(one.title for one in here.state.fitted)
        teller.say(effects=effects, rms=here.state.fit.rms, unit=here.state.fit.view.readings.unit)
        if account is None:
            return
        try:
            if not anyway:
                check_scatter(here.state.fit)  # more effects may explain it
            account(so_far(here, places))
        except ConventionError:
            return
        except ArmflexError as error:  # a search is not ended because there is no account yet
            teller.stage(f"no account so far: {error}")

    if accepted:
        begun = _with_accepted(begun, accepted)
    traced = conclude(search(begun, passing), places, ask)
    if not anyway:
        check_scatter(traced.state.fit)
    if account is not None:
        account(traced)
    return traced


def _with_accepted(begun: Standing, accepted: Sequence[Effect]) -> Standing:
    """Return the state with effects that an earlier search of the same campaign had accepted."""
    screen, left, known = begun.screen, list(accepted), list[Hypothesis]()
    every = [group.hypothesis for group in screen.groups]
    for family in (one for one in every if one.family):
        own = [one for one in left if any(_is(one, member) for member in family.members)]
        if len(own) == len(family.members) and all(one.inner == own[0].inner for one in own):
            known.append(family)
            left = [one for one in left if one not in own]
    for one in left:
        candidate = Candidate(one.law, one.location, one.inner)
        like = [each for each in every if not each.family and _is(one, each.one)]
        like += sought(one.law, [one.location], begun.state.context) if one.law.sought else []
        known += [replace(each, members=(candidate,)) for each in like[:1]]
    after = refitted(begun, own_model(screen, known))
    return begun if after is None else standing(after, begun)


def _is(effect: Effect, candidate: Candidate) -> bool:
    """Return whether an effect is a candidate's law at its place, with the same terms."""
    there = (effect.location.site, effect.location.axis, effect.location.partner, effect.location.terms)
    own = candidate.location
    return effect.law is candidate.law and there == (own.site, own.axis, own.partner, own.terms)
