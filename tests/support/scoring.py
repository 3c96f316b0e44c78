"""One drawn campaign traced, and the account judged against what was hidden in it."""

import tempfile
import time
import traceback
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from itertools import chain
from pathlib import Path

import numpy as np

import armflex
from armflex.laws.effects import Effect
from armflex.trace.findings import Found, Trace
from support.absorbed import visible, visible_each
from support.campaigns import SEVERAL, Drawn, TrueEffect, Truth, draw

SEEN = 16.0  # fall of the information criterion by an effect that shows
SHOWN_RMS, SHOWN_STRAIN = 5e-5, 3.0
"""Left behind by calibration [m], and moved by it [prior deviations], below which nobody could know of an effect."""

Mark = tuple[str, str]
"""Name and site as a report gives them; every shape goes by 'unnamed', every link by the joint that ends it."""

RENAMED = {
    "c": ("c_moment", "c_square"),
    "mass_at_heaviest": ("mass",),
    "force_at_1m": ("F1",),
    "ppm": ("lambda",),
    "gain1": ("gain",),
    "radius1": ("radius",),
    **{f"magnet_{axis}": (f"point_{axis}",) for axis in "xyz"},
}
"""Parameters of the truth that a law calls otherwise."""

UNLIKE = {"umbilical", "unnamed", "slip_step"}
"""Effects whose parameters mean something else in the law."""


@dataclass
class Score:
    """What one draw came to.

    Attributes:
        verdict: ok, FALSE (null draws); exact, exact+ (and something else), class, unexplained (seen, not named),
            hidden (calibration hides it), missed, WRONG, ERROR.
        first: Whether the first effect found is a hidden one, by name and site.
        axis: Whether it has the right axis, too.
        rank: Place of the truth in the first round's ranking, None where it was not in it.
        truth, found, equivalents, unexplained: What was hidden and what was said.
        named: Where there are several, of each that was hidden: exact (also its axis), class, missed, or hidden: beside
            the others, which with their constants and calibration take over what they can, these very readings have
            less evidence of it than a search asks of anything (`SEEN`).
        false: Names found that are none of theirs, nor have one among their equivalents.
        before, after, floor: RMS on the held-out rows with calibration, with the trace, and of the noise itself [mm].
        shown, strain: What calibration leaves of the effects [mm], and how far they move it.
        stated: Of each name found and of what else it may be, the probability stated of it and whether it is a hidden
            one; and the same of nothing, which is right where calibration hides all that there is, too.
        sets: Of each 95 % credible set whether it holds a hidden one, and how many names it has.
        within: Share of the coordinates of the held-out rows whose error by the trace is within 1.96 of its standard
            deviation, `sigma` of the prediction and the noise together.
        checked, covered: Parameters with a true value, and those within 1.96 standard deviations of it.
        seconds: Of the processor, of the last trace.
        asked: How often rows were asked for, driven and read before the account that is judged.
        unasked: The verdict of the first account.
        log: What the search said it was doing; or the error.
    """

    kind: str
    seed: int
    arm: str
    size: float
    verdict: str = "ERROR"
    first: bool = False
    axis: bool = False
    rank: int | None = None
    truth: list = field(default_factory=list)
    found: list = field(default_factory=list)
    equivalents: list = field(default_factory=list)
    unexplained: list = field(default_factory=list)
    named: list = field(default_factory=list)
    stated: list = field(default_factory=list)
    sets: list = field(default_factory=list)
    false: int = 0
    before: float = np.nan
    after: float = np.nan
    floor: float = np.nan
    shown: float = np.nan
    strain: float = np.nan
    within: float = np.nan
    checked: int = 0
    covered: int = 0
    seconds: float = np.nan
    asked: int = 0
    unasked: str = ""
    log: str = ""

    @property
    def detected(self) -> bool:
        """Whether anything at all was reported."""
        return bool(self.found or self.unexplained)

    def hear(self, said: str) -> None:
        """Note what the search says it is doing, as far as it is about one effect."""
        if not said.startswith(("searching", "calibrating", "comparing")):
            self.log += f"; {said}" if self.log else said

    def as_row(self) -> dict:
        """Return the columns of a table."""
        return asdict(self)


TWICE = 2
"""How often rows are asked for at most."""


def score(kind: str, seed: int, arm: str, size: float, ask: int = 0) -> Score:
    """Draw, write, read, trace and judge one campaign; an exception is a verdict, too.

    With `ask` so many rows that decide what is in question are driven, read, and everything is traced again.
    """
    result = Score(kind, seed, arm, size)
    try:
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            drawn = draw(kind, seed, arm=arm, size=size, spare=TWICE * ask)
            _judge(result, drawn, Path(folder), ask)
    except Exception:
        result.log = f"{result.log}; {traceback.format_exc()[-800:]}"
    return result


def _judge(result: Score, drawn: Drawn, folder: Path, ask: int) -> None:
    while True:
        truth = drawn.write(folder)
        arm = armflex.load_arm(truth.arm)
        start, wanted = time.process_time(), ask if drawn.spare else 0
        account = armflex.trace(arm, armflex.read_measurements(truth.train, arm), report=result.hear, ask=wanted)
        result.seconds = time.process_time() - start
        result.unasked = result.unasked or verdict(truth.effects, account)
        if account.asked is None:
            break
        drawn, result.asked = drawn.asked(account.asked.rows), result.asked + 1
    judge(result, drawn, truth, account)


def judge(result: Score, drawn: Drawn, truth: Truth, account: Trace) -> None:
    """Note in a score what the account of a drawn campaign, as it was written, comes to."""
    arm = armflex.load_arm(truth.arm)
    rows = armflex.read_measurements(truth.test, arm)
    believed = rows.measured & ~truth.lost
    result.floor = 1e3 * _rms((rows.position - truth.clean)[believed])
    arms = [armflex.as_in(one, truth.train) for one in (account.calibration.arm, account.arm)]  # held out of that clock
    predicted = [armflex.predict(one, rows) for one in arms]
    errors = [(one.position - rows.position)[believed] for one in predicted]
    result.before, result.after = (1e3 * _rms(one) for one in errors)
    if (sigma := predicted[1].sigma) is not None:
        std = np.hypot(sigma, min(1.0, account.noise) * rows.sigma)[believed]
        result.within = float((np.abs(errors[1]) < 1.96 * std).mean())
    result.truth = [(e.name, e.site, e.axis, e.parameters) for e in truth.effects]
    result.found = [described(one.effect, one.evidence) for one in account.found]
    result.equivalents = [[described(other) for other, _ in one.equivalent] for one in account.found]
    result.unexplained = _unexplained(account)
    pairs = [[(one.effect, one.probability), *one.credible] for one in account.found]
    names_of_each = [
        [(chance, any(is_named(e, effect) for e in truth.effects)) for effect, chance in own] for own in pairs
    ]
    result.stated = [*chain(*names_of_each)]
    result.sets = [(any(right for _, right in own), len(own)) for own in names_of_each]
    result.verdict = verdict(truth.effects, account)
    result.first, result.axis, result.rank = first_found(truth.effects, account)
    result.checked, result.covered = coverage(truth.effects, account.found)
    if result.kind in SEVERAL:
        shown = [v.evidence >= SEEN for v in visible_each(drawn)]
        named, result.false = names(truth.effects, account.found)
        result.named = [word if seen else "hidden" for word, seen in zip(named, shown, strict=True)]
        right = not result.false and "missed" not in result.named
        result.verdict = "WRONG" if not right else "class" if "class" in result.named else "exact"
    elif truth.effects and result.verdict not in ("exact", "exact+"):
        left = visible(drawn)
        result.shown, result.strain = 1e3 * left.rms, left.strain
        if result.verdict in ("missed", "unexplained", "WRONG") and not _could_show(result):
            result.verdict = "hidden"
    result.stated.append((account.nothing, not truth.effects or set(result.named or [result.verdict]) == {"hidden"}))


def _could_show(result: Score) -> bool:
    return result.shown >= 1e3 * SHOWN_RMS or result.strain >= SHOWN_STRAIN


def _rms(errors: np.ndarray) -> float:
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def described(effect: Effect, evidence: float | None = None) -> tuple:
    """Return what a table keeps of an effect."""
    location = effect.location
    values = {name: float(f"{value:.4g}") for name, value in effect.named.items()}
    known = (effect.law.name, location.place, location.axis, location.partner, location.covariates, values)
    return known if evidence is None else (*known, round(evidence, 1))


def _unexplained(account: Trace) -> list:
    left = account.unexplained
    return [] if left is None else [(left.site, left.axis), *((p.site, p.axis) for p in left.equivalent)]


def mark(name: str, site: str | None) -> Mark:
    """Return name and site as they are compared."""
    return ("unnamed" if name.startswith("unnamed") else name, (site or "").removeprefix("link:"))


def mark_of(effect: Effect) -> Mark:
    """Return the same of an effect of the library."""
    return mark(effect.law.name, effect.location.site)


def verdict(truth: Sequence[TrueEffect], account: Trace) -> str:
    """Return how right an account is, by names and sites."""
    wanted = {mark(e.name, e.site) for e in truth}
    found = [mark_of(one.effect) for one in account.found]
    if not wanted:
        return "FALSE" if found or account.unexplained else "ok"
    if any(name == "unexplained" for name, _ in wanted):
        return _random_verdict(wanted, found, account)
    if wanted <= set(found):
        return "exact" if wanted == set(found) else "exact+"
    said = set(found).union(*({mark_of(other) for other, _ in one.equivalent} for one in account.found))
    if found and wanted <= said:
        return "class"
    if found:
        return "WRONG"
    return "unexplained" if account.unexplained else "missed"


def names(truth: Sequence[TrueEffect], found: Sequence[Found]) -> tuple[list[str], int]:
    """Return of each hidden effect whether it is named exactly, in a class or not, and how many names are of none."""

    exact = [any(is_named(e, one.effect) for one in found) for e in truth]
    others = [one for one in found if not any(is_named(e, one.effect) for e in truth)]
    like = [
        [mark(e.name, e.site) in {mark_of(o) for o in (one.effect, *dict(one.equivalent))} for e in truth]
        for one in others
    ]
    words = [
        "exact" if known else "class" if any(one[i] for one in like) else "missed" for i, known in enumerate(exact)
    ]
    return words, sum(not any(one) for one in like)


def is_named(truth: TrueEffect, effect: Effect) -> bool:
    """Return whether an effect is a hidden one, by name, site and axis."""
    return mark(truth.name, truth.site) == mark_of(effect) and same_axis(truth, effect)


def _random_verdict(wanted: set[Mark], found: list[Mark], account: Trace) -> str:
    """A cause that nobody recorded is right where it is called unexplained at its place."""
    places = [mark("unexplained", site) for site, _ in _unexplained(account)]
    if not places:
        return "WRONG" if found else "missed"
    if places[0] in wanted:
        return "exact+" if found else "exact"
    return "class" if wanted & set(places) and not found else "WRONG"


def first_found(truth: Sequence[TrueEffect], account: Trace) -> tuple[bool, bool, int | None]:
    """Return whether the first effect is a hidden one, whether its axis is right, and the truth's rank at first."""
    wanted = {mark(e.name, e.site) for e in truth}
    if not account.found:
        places = _unexplained(account)
        return bool(places) and mark("unexplained", places[0][0]) in wanted, False, None
    first = account.found[0]
    ranked = [mark(one.one.law.name, one.one.location.site) for one, _ in first.ranking]
    rank = min((ranked.index(one) for one in wanted if one in ranked), default=None)
    match = [e for e in truth if mark(e.name, e.site) == mark_of(first.effect)]
    return bool(match), any(same_axis(e, first.effect) for e in match), rank


def same_axis(truth: TrueEffect, effect: Effect) -> bool:
    """Return whether an effect moves what the true one does; coupled axes go in either order."""
    if truth.name == "cross_coupling":
        return {truth.axis, truth.parameters["with"]} == {effect.location.axis, effect.location.partner}
    acting = [effect.law.amplitudes[i].name for i in effect.location.terms]
    return (
        truth.axis is None or effect.location.axis in (None, truth.axis) or any(truth.axis in name for name in acting)
    )


def coverage(truth: Sequence[TrueEffect], found: Iterable[Found]) -> tuple[int, int]:
    """Return how many parameters have a true value, and how many of those are within 1.96 standard deviations."""
    checked = covered = 0
    for one in found:
        for e in truth:
            if mark(e.name, e.site) != mark_of(one.effect) or not same_axis(e, one.effect) or e.name in UNLIKE:
                continue
            for name, value in true_values(e, one):
                checked += 1
                covered += abs(one.effect.named[name] - value) <= 1.96 * one.std[name]
    return checked, covered


def true_values(truth: TrueEffect, one: Found) -> Iterable[tuple[str, float]]:
    """Yield the law's name and the true value of every parameter that means the same."""
    if "gain2" in truth.parameters or _another_kind(truth, one.effect):
        return
    for key, value in truth.parameters.items():
        if isinstance(value, str):
            continue
        names = (key, f"{key}_{truth.axis}", truth.axis, f"com_{(truth.axis or '')[1:]}", *RENAMED.get(key, ()))
        for name in names:
            if name in one.std:
                yield name, value
                break


def _another_kind(truth: TrueEffect, effect: Effect) -> bool:
    """Return whether a law with several kinds of amplitude took another one than the truth."""
    if truth.name == "even_in_load":
        return (truth.parameters["of"] == "tau^2") != ("c_square" in effect.named)
    if truth.name == "payload_mass":
        return ("mass" in truth.parameters) != (effect.location.partner == "each")
    if truth.name == "session_frame":
        return truth.parameters["session"] != effect.location.partner
    return False
