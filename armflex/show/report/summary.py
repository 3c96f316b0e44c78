"""The result in sentences: what the arm lacked, how large the error is now, what could not be told."""

from __future__ import annotations

import numpy as np

from armflex.show.report.accuracy import Accuracy
from armflex.show.report.numbers import change, measure, millimetres, short
from armflex.show.report.words import called, joined, site_words, units_of, words
from armflex.trace.result import Found, Trace, Unexplained

MOST_VALUES = 2
"""Values of an effect that the first sentence has room for."""


MOST_NAMED = 2
"""Effects that it has room for with their values; of more, the first two are named."""


def headline(trace: Trace) -> str:
    """Return what was found, in one sentence."""
    pairs = list(zip(trace.found, trace.numbers, strict=True))
    if len(trace.found) > MOST_NAMED:
        several = joined([called(one.effect, number) for one, number in pairs[:MOST_NAMED]])
        return f"The arm lacked {len(trace.found)} effects, first of all {several}."
    if not trace.found and trace.withdrawn:
        return "Nothing that was tried predicts poses not used better than the calibrated arm."
    if trace.found:
        parts = [called(one.effect, number) + _values(one) for one, number in pairs]
        return f"The arm lacked {'; and '.join(parts)}."
    if trace.unexplained:
        return f"Something moves this arm that no recorded column explains{_where(trace.unexplained)}."
    return "Nothing is missing that this campaign could show."


def _where(left: Unexplained) -> str:
    if left.site is None:
        return ""
    size = "" if left.std is None else f", {measure(left.std, None, left.unit or '')}"
    return f"; it acts at {site_words(left.site)} ({left.axis}){size}"


def _values(found: Found) -> str:
    """Return ': gap 1.003 ± 0.013 mrad', the amplitudes where they are few enough to read."""
    effect, units = found.effect, units_of(found.effect)
    names = [effect.law.amplitudes[i].name for i in effect.spot.terms]
    if len(names) > MOST_VALUES:
        return ""
    return ": " + joined([f"{name} {measure(effect.named[name], found.std[name], units[name])}" for name in names])


def accuracy_sentence(accurate: Accuracy, trace: Trace) -> str:
    """Return the error on poses not used, before and after, beside the noise."""
    noise = f"noise as stated: {millimetres(accurate.stated)}"
    if not trace.found:
        return f"Error on poses not used: {millimetres(accurate.after.rms)} ({noise})."
    return f"Error on poses not used: {change(accurate.before.rms, accurate.after.rms)} ({noise})."


def further(trace: Trace, accurate: Accuracy) -> list[str]:
    """Return what has to be said beside the result: what is not told apart, what is left, what would have shown."""
    pairs = zip(trace.found, trace.numbers, strict=True)
    said = [_not_told(one, number) for one, number in pairs if one.equivalent]
    said += [
        f"Adding {words(one.effect.law.name).title} hardly lowers the error; it is believed because fitted "
        "parameters no longer strain against what was known of them."
        for one in trace.found
        if one.witness
    ]
    said += [
        f"Withdrawn: {one.title}. With it poses not used are predicted to {change(*reversed(one.errors))} "
        "(the calibrated arm)."
        for one in trace.withdrawn
    ]
    if trace.said_of_limit:
        said.append(trace.said_of_limit)
    if trace.told("unexplained"):
        said.append(f"{trace.told('unexplained')} readings far off together are left out: nothing explains them.")
    if trace.unexplained:
        said.append(left(trace.unexplained))
    elif not 0.8 < trace.noise < 1.2:
        said.append(f"The readings scatter {short(trace.noise)} times as much as their stated noise.")
    if not trace.found and trace.smallest:
        said.append(would_show(trace))
    return said


def _not_told(found: Found, number: int) -> str:
    rivals = list(dict.fromkeys(called(effect) for effect, _ in found.equivalent))
    own = called(found.effect)
    others = [rival for rival in rivals if rival != own]
    if not others:
        return f"These data do not settle which terms of {words(found.effect.law.name).title} act."
    shown = [*others[:3], f"{len(others) - 3} more"] if len(others) > 3 else others
    return f"These data do not tell {called(found.effect, number)} from {joined(shown)}."


def left(unexplained: Unexplained) -> str:
    """Return what is left unexplained, with place and size."""
    size = f"{millimetres(unexplained.rms)} RMS at the target"
    if unexplained.site is None:
        return f"Left unexplained: {size}, without a place."
    twist = "" if unexplained.std is None else f" of {measure(unexplained.std, None, unexplained.unit or '')}"
    where = f"{site_words(unexplained.site)} ({unexplained.axis})"
    text = f"Left unexplained: a change{twist} from pose to pose at {where}, {size}; no cause was recorded"
    if unexplained.equivalent:
        places = [f"{site_words(place.site)} ({place.axis})" for place in unexplained.equivalent[:4]]
        text += f". As likely places: {joined(places)}"
    return text + "."


def would_show(trace: Trace) -> str:
    """Return how small an effect this campaign would have shown."""
    least = min(trace.smallest, key=lambda one: one.least)
    usual = float(np.median([one.least for one in trace.smallest]))
    most = float(np.median([one.most for one in trace.smallest]))
    return (
        f"The smallest effect that this campaign would have shown: {words(least.effect).title} from "
        f"{millimetres(least.least)} RMS at the target. Half of the {len(trace.smallest)} laws would have shown from "
        f"{millimetres(usual)} where they show best, from {millimetres(most)} where they show worst."
    )


def sure(found: Found) -> str:
    """Return why an effect is believed."""
    proof = found.proof
    chance = f"the best that chance gave any candidate was {short(proof.null)}"
    worth = f"Its evidence (fall of the Bayesian information criterion, 10 is strong) is {short(found.evidence)}"
    parts = [f"{worth} beside everything else that was fitted; when it was added, {chance}."]
    fall = f"The squared error of poses held out fell by {short(proof.errors_apart)} standard errors"
    if proof.errors_apart <= 0.0:
        fall = "The squared error of poses held out did not fall"
    parts.append(fall + ".")
    if proof.sessions_before is None:  # one session only, or a step between two
        parts.append("No session can be left out and the others still show it: nothing is known about another day.")
    if found.witness:
        parts.append(
            "It is believed because fitted parameters no longer strain against their priors, not because held-out "
            "poses are predicted better."
        )
    return " ".join(parts)


def where_effect(found: Found, number: int) -> str:
    """Return the heading of an effect: its law and its place, and its number where the arm has another such."""
    text = called(found.effect, number)
    return text[0].upper() + text[1:]
