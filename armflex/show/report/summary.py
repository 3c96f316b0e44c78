"""The result in sentences: which effects were identified, how large the error is now, what stayed undetermined."""

from collections.abc import Sequence

import numpy as np

from armflex.laws.effects.link_mass import LINK_MASS
from armflex.laws.effects.location import link_of
from armflex.readings import Readings
from armflex.robot import Robot
from armflex.robot.urdf import MOVING
from armflex.show.report.accuracy import Accuracy
from armflex.show.report.words import called, change, joined, measure, millimetres, short, site_words, units_of, words
from armflex.trace.findings import Found, Smallest, Trace, Unexplained

MOST_NAMED = 2
"""Effects that it has room for with their values; of more, the first two are named."""


HALVES_TITLE = "What one half of the campaign names, and the other half"
HALVES_HEAD = ["stated", "names", "mean", "other half", "in its sets", "numbers agree"]
"""Columns of the table of halves: of the names of a probability, what the other half gives them."""


def headline(trace: Trace) -> str:
    """Return what was found, in one sentence."""
    if trace.unfinished:
        names = [called(effect) for effect, _ in trace.accepted] or ["nothing"]
        return f"Accepted so far, not compared: {joined(names)}."
    if len(trace.named) > MOST_NAMED:
        several = joined([called(effect.effect, effect.number) for effect in trace.named[:MOST_NAMED]])
        return f"{len(trace.named)} effects identified, first of all {several}."
    if not trace.named and trace.common:
        return f"The drives have in common: {joined(trace.common[:MOST_NAMED])}."
    if trace.undecided is not None:
        return "These data cannot decide what is missing."
    if trace.named:
        parts = []
        for identified in trace.named:
            effect, units = identified.effect, units_of(identified.effect)
            names = [effect.law.amplitudes[i].name for i in effect.location.terms]
            values = [f"{name} {measure(effect.named[name], identified.std[name], units[name])}" for name in names]
            # Values of an effect that the first sentence has room for.
            few = f": {joined(values)}" if len(values) <= 2 else ""
            parts.append(called(effect, identified.number) + few)
        return f"Identified: {'; and '.join(parts)}."
    if trace.unsettled:
        return "Something is missing whose cause these data do not settle."
    if left := trace.unexplained:
        size = "" if left.std is None else f", {measure(left.std, None, left.unit or '')}"
        where = "" if left.site is None else f"; it acts at {site_words(left.site)} ({left.axis}){size}"
        return f"Something moves this arm that no recorded column explains{where}."
    return "No further effect is observable in this campaign."


def accuracy_sentence(accurate: Accuracy, trace: Trace) -> str:
    """Return the error on held-out poses, before and after, beside the noise."""
    unit = trace.state.fit.view.readings.shown_in
    noise = f"noise as stated: {millimetres(accurate.stated, unit=unit)}"
    if not trace.found:
        return f"Error on held-out poses: {millimetres(accurate.after.rms, unit=unit)} ({noise})."
    return f"Error on held-out poses: {change(accurate.before.rms, accurate.after.rms, unit)} ({noise})."


def further(trace: Trace) -> list[str]:
    """Return what has to be said beside the result: what is not distinguished, what is left, what would have shown."""
    readings, drawn, rivals = trace.state.fit.view.readings, trace.resampled, trace.predicted.rivals
    said = [f"The search was ended {trace.ended}: more effects may be missing."] if trace.ended else []
    said += [_alike(identified) for identified in trace.named if identified.equivalent]
    said += [unsettled(effect) for effect in trace.unsettled]
    for found in trace.found:
        if found.effect.law is LINK_MASS:
            said.append(_of_link(found, trace.state.fit.setup.arm.robot))
        if when := found.effect.another_day:
            said.append(f"On another day, of {called(found.effect, found.number)}: {when}.")
    if trace.common:
        said.append(f"In the arm at all drives, with no single place: {joined(trace.common)}.")
    if drawn is not None and drawn.mismatch > 1.0:
        said.append(
            f"Held-out {drawn.by} differ {short(drawn.mismatch)} times as much as noise and chance allow: something is "
            f"left that nothing here describes."
        )
    if rivals:
        titles = joined(list(dict.fromkeys(rival.effect.title for rival in rivals)))
        said.append(f"Predictions are averages over models, some of which have instead, or beside: {titles}.")
    if trace.undecided is not None:
        said.append(trace.undecided.text)
    if far := trace.outlier_count("unexplained"):
        said.append(f"{far} readings, far off together, are excluded: no candidate explains them.")
    if trace.unexplained:
        said.append(left(trace.unexplained, readings))
    elif not 0.8 < trace.noise < 1.2:
        said.append(f"The readings scatter {short(trace.noise)} times as much as their stated noise.")
    return said if trace.found or not trace.smallest else [*said, _smallest(trace.smallest, readings)]


def _of_link(found: Found, robot: Robot) -> str:
    """Return which link a correction of its mass is of, by the joint that moves it and where its mass is stated.

    The link is named by the joint at its end; the row of a table that has its mass is that of the joint before.
    """
    link = robot.urdf.links[link_of(found.effect.location.site, robot)]
    joint = robot.urdf.parents.get(link.name)
    moved = f", which {joint.name} moves" if joint and joint.kind in MOVING else ""
    declared = f"{link.inertial.mass:.4g} kg at {link.inertial.place}" if link.inertial else "none"
    return f"{found.title} is of the link {link.name}{moved}. Its declared mass: {declared}."


def _alike(identified: Found) -> str:
    """Return what these data do not distinguish from an effect: other causes, or which of its terms act."""
    name = called(identified.effect)
    others = [other for other in dict.fromkeys(called(effect) for effect, _ in identified.equivalent) if other != name]
    if not others:
        return f"These data do not settle which terms of {words(identified.effect.law.name).title} act."
    return f"These data do not distinguish {called(identified.effect, identified.number)} from {_first(others)}."


def _first(names: Sequence[str]) -> str:
    """Return the first three, and how many more there are."""
    return joined([*names[:3], f"{len(names) - 3} more"] if len(names) > 3 else list(names))


def _smallest(sizes: Sequence[Smallest], readings: Readings) -> str:
    """Return the smallest effect that a campaign without any would have shown."""
    unit, least = readings.shown_in, min(sizes, key=lambda size: size.least)
    best, worst = (float(np.median([getattr(size, name) for size in sizes])) for name in ("least", "most"))
    return (
        f"The smallest effect that this campaign would have shown: {words(least.effect).title} from "
        f"{millimetres(least.least, unit=unit)} RMS {readings.where_read}. Half of the {len(sizes)} laws "
        f"would have shown from {millimetres(best, unit=unit)} where they show best, from "
        f"{millimetres(worst, unit=unit)} where they show worst."
    )


def left(unexplained: Unexplained, readings: Readings) -> str:
    """Return what is left unexplained of some readings, with place and size."""
    size = f"{millimetres(unexplained.rms, unit=readings.shown_in)} RMS {readings.where_read}"
    if unexplained.site is None:
        return f"Left unexplained: {size}, at no particular joint."
    twist = "" if unexplained.std is None else f" of {measure(unexplained.std, None, unexplained.unit or '')}"
    where = f"{site_words(unexplained.site)} ({unexplained.axis})"
    text = f"Left unexplained: a change{twist} from pose to pose at {where}, {size}; no cause was recorded"
    if unexplained.equivalent:
        places = [f"{site_words(place.site)} ({place.axis})" for place in unexplained.equivalent[:4]]
        text += f". As likely places: {joined(places)}"
    return text + "."


def unsettled(identified: Found) -> str:
    """Return what something may be that has no name, the likeliest first."""
    name = called(identified.effect, identified.number)
    causes = sorted(
        [(identified.probability, name), *((chance, called(effect)) for effect, chance in identified.credible)],
        reverse=True,
    )
    said = [f"{name} ({chance:.0%})" for chance, name in causes]
    values = "" if identified.determined else ", of which these rows determine no value by itself"
    return f"Not settled: {_first(said)}. The arm has {name}{values}."


def sure(identified: Found) -> str:
    """Return why an effect is accepted."""
    proof = identified.proof
    odds = f"its log odds beside the other effects {short(identified.evidence / 2)}"
    parts = [f"Its probability is {identified.probability:.1%}, {odds}."]
    fall = f"The squared error of poses held out fell by {short(proof.errors_apart)} standard errors"
    if proof.errors_apart <= 0.0:
        fall = "The squared error of poses held out did not fall"
    parts.append(fall + ".")
    if proof.sessions_before is None:  # one session only, or a step between two
        parts.append("No session could be held out: nothing is known about another day.")
    return " ".join(parts)
