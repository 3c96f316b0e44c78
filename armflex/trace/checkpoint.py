"""A search in a file, so that one that was interrupted goes on from the last effect that it accepted.

Strict JSON with a SHA-256 of its content. What fits and searches computed is computed again from what they arrived at:
for every round of the search the rows in use, the effects with their values, what was free of them, and the values of
everything that was fitted; for every accepted effect its proof and what it was chosen among.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from armflex.arm import Arm
from armflex.conventions import TWIST_NAMES, Array
from armflex.errors import FileError, Place, did_you_mean, listing
from armflex.estimate.block import EffectBlock
from armflex.estimate.fit import Fit, realise
from armflex.estimate.robust import huber_weights
from armflex.estimate.view import look
from armflex.laws.effects.catalogue import EVERY
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import EffectLaw
from armflex.laws.effects.location import Location
from armflex.measured.measurements import Measurements
from armflex.storage.digest import digest
from armflex.storage.schema import strict_json, typed
from armflex.storage.whole_file import write_whole
from armflex.trace.accept import Step
from armflex.trace.state import State, context_at
from armflex.trace.unrecorded import PoseBlock
from armflex.version import __version__

FORMAT = "armflex-trace-checkpoint-2"

LARGEST = 2**28
"""Bytes of the largest file that is read: a thousand times what a search of a thousand poses leaves."""

Table = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Kept:
    """What a file says of the state after a round: all that cannot be computed again.

    Attributes:
        left_out: Rows that were to be used and are not.
        heed, effects, random: See `State`.
        values: Of everything that was fitted.
    """

    left_out: tuple[int, ...]
    heed: bool
    effects: tuple[EffectBlock, ...]
    random: PoseBlock | None
    values: Array


@dataclass(frozen=True, eq=False)
class Progress:
    """How far a search has come.

    Attributes:
        state: After the last round.
        contexts: The campaign as it was seen before the first round and after each: effects remember one of them.
        rounds: What a file says of each round.
        ended: Whether nothing is left to be found.
    """

    state: State
    contexts: tuple[Context, ...] = ()
    rounds: tuple[Kept, ...] = ()
    ended: bool = False

    def after(self, state: State) -> Progress:
        """Return the progress after one more round."""
        left_out = tuple(np.setdiff1d(state.asked, state.rows).tolist())
        kept = Kept(left_out, state.heed, state.effects, state.random, state.fit.values)
        return Progress(state, (*self.contexts, state.context), (*self.rounds, kept))


def identity(arm: Arm, measurements: Measurements, rows: np.ndarray | None, keep: bool) -> Table:
    """Return what a search depends on, by name: digests of the arm's and the campaign's parts, and the options."""
    return {
        "arm": _digests(arm),
        "measurements": _digests(measurements),
        "options": {"rows": "all" if rows is None else digest(np.asarray(rows)), "keep": keep},
        "version": {"armflex": __version__},
    }


def _digests(value: Any) -> dict[str, str]:
    return {one.name: digest(getattr(value, one.name)) for one in fields(value)}


def write_checkpoint(path: Path, about: Mapping[str, Any], progress: Progress) -> None:
    """Write how far a search has come, whole or not at all; raise `FileError` where it cannot be written."""
    rounds, steps = (_plain(one, progress.contexts) for one in (progress.rounds, progress.state.steps))
    said = {"format": FORMAT, "about": about, "ended": progress.ended, "rounds": rounds, "steps": steps}
    text = json.dumps({**said, "sha256": _sha256(said)}, allow_nan=False, indent=1)
    write_whole(path, (text + "\n").encode())


def _plain(value: Any, contexts: Sequence[Context]) -> Any:
    """Return what JSON says of a value: a law by its name, a context by its number, infinity as text."""
    if isinstance(value, EffectLaw):
        return value.name
    if isinstance(value, Context):
        return next(number for number, context in enumerate(contexts) if context is value)
    if is_dataclass(value):
        return {one.name: _plain(getattr(value, one.name), contexts) for one in fields(value)}
    if isinstance(value, tuple | np.ndarray):
        return [_plain(one, contexts) for one in (value.tolist() if isinstance(value, np.ndarray) else value)]
    return str(value) if isinstance(value, float) and not np.isfinite(value) else value


def read_checkpoint(path: Path, about: Mapping[str, Any]) -> Table:
    """Return what a file says of a search.

    Args:
        path: The file.
        about: What the search that is to go on depends on; see `identity`.

    Raises:
        FileError: There is no such file, it is damaged, or of a search that depends on something else.
    """
    try:
        if path.stat().st_size > LARGEST:
            raise FileError(Place(path), f"is no checkpoint of a search: larger than {LARGEST} bytes")
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise FileError(Place(path), "does not exist: there is no interrupted search to go on with") from None
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(Place(path), f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    try:
        said = strict_json(text)
    except ValueError as error:
        raise FileError(Place(path), f"is damaged ({error}): delete it and begin anew") from None
    if not isinstance(said, dict) or said.get("format") != FORMAT:
        raise FileError(Place(path), f"is no checkpoint of a search: expected format {FORMAT!r}")
    sha256 = said.pop("sha256", None)
    if sha256 != _sha256(said):
        raise FileError(Place(path), "its SHA-256 is not that of its content: it is damaged, delete it and begin anew")
    differ = list(_differences(said.get("about"), about))
    if differ:
        raise FileError(Place(path), f"belongs to another search: {'; '.join(differ)}")
    return said


def _sha256(said: Mapping[str, Any]) -> str:
    text = json.dumps(said, allow_nan=False, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _differences(there: Any, here: Mapping[str, Any]) -> Iterator[str]:
    """Yield in words what a search depended on that is otherwise now."""
    for name, parts in here.items():
        was = there.get(name) if isinstance(there, dict) else None
        if was == parts:
            continue
        was = was if isinstance(was, dict) else {}
        differ = [part for part in {**parts, **was} if was.get(part) != parts.get(part)]
        if name in ("arm", "measurements"):
            yield f"the {name} {'is' if name == 'arm' else 'are'} not the same (in {listing(differ)})"
        else:
            parted = (f"{part} was {was.get(part)!r} and is {parts.get(part)!r}" for part in differ)
            yield f"the {name} {'is' if name == 'version' else 'are'} not the same ({', '.join(parted)})"


def restored(path: Path, said: Table, begun: State) -> Progress:
    """Return the progress that a file tells of.

    Args:
        path: The file, for errors.
        said: What it says; see `read_checkpoint`.
        begun: The state before the first round, as the calibration left it.

    Raises:
        FileError: What it says is no search of this arm and campaign.
    """
    contexts, rounds, state, context = [begun.context], [], begun, begun.context
    partners = {place.partner for law in EVERY.values() for place in law.places(context.records)}
    partners |= {"", *TWIST_NAMES, *context.sessions, *context.payloads}

    def seen(number: Any) -> Context:
        return contexts[_whole(number, len(contexts), "context")]

    makers = {
        float: _number,
        Array: lambda values: np.array([_number(one) for one in values]),
        np.ndarray: lambda values: np.array([_whole(one, 2**31, "group") for one in values]),
        EffectLaw: _law,
        Location: partial(_location, context, partners),
        Context: seen,
    }
    try:
        steps = typed(tuple[Step, ...], said["steps"], "steps", makers)
        for one in (polished for step in steps for polished in step.ranking):
            law, location = one.candidate.law, one.candidate.location
            _check_places(law, location, one.free)
            fits = len(one.candidate.inner) == len(law.inner) and len(one.amplitudes) == len(location.terms)
            _expect(fits, f"{law.name} has {len(law.inner)} inner values, and an amplitude for each of its terms")
        wanted = {effect["context"] for one in said["rounds"] for effect in one["effects"]}
        for number, one in enumerate(said["rounds"], 1):
            rounds.append(typed(Kept, one, f"rounds[{number - 1}]", makers))
            # Only a round that effects remember, and the last, must be computed again.
            if number == len(said["rounds"]) or number in wanted:
                state = _state(rounds[-1], begun)
            contexts.append(state.context)
        _expect(len(state.effects) == len(steps), f"{len(steps)} steps for {len(state.effects)} effects")
        ended = typed(bool, said["ended"], "ended")
        return Progress(replace(state, steps=steps), tuple(contexts), tuple(rounds), ended)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        what = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) and error.args else error
        raise FileError(Place(path), f"does not hold a search of this arm: {what}") from None


def _state(kept: Kept, begun: State) -> State:
    """Return the state after a round, everything that follows from its values computed again."""
    asked, effects, random, values = begun.asked, kept.effects, kept.random, kept.values
    left_out = [_whole(row, len(begun.measurements), "left_out") for row in kept.left_out]
    _expect(set(left_out) <= set(asked.tolist()), "left_out names a row that is not used")
    for block in effects:
        law, location = block.effect.law, block.effect.location
        _check_places(law, location, block.free)
        count, free = len(law.amplitudes) + len(law.inner), len(location.terms) + len(block.free)
        found = len(block.effect.values)
        _expect(found == count, f"{found} values of {law.name}, expected {count}")
        good = len(block.prior) == free and bool((block.prior > 0.0).all())
        _expect(good, f"prior of {law.name}: expected {free} numbers above 0")
    if random is not None:
        _expect(random.std > 0.0, f"std is {random.std}, expected more than 0")
    blocks = (*begun.blocks, *effects, *(() if random is None else (random,)))
    count = sum(len(block.labels) for block in blocks)
    _expect(len(values) == count, f"{len(values)} values for {count} parameters")
    view = look(realise(begun.declared, blocks, values), begun.measurements, np.setdiff1d(asked, left_out))
    fitted = Fit(begun.declared, blocks, values, view, huber_weights(view), ())
    context = context_at(fitted, begun.measurements)
    return replace(begun, rows=view.rows, effects=effects, random=random, fit=fitted, context=context, heed=kept.heed)


def _expect(good: bool, problem: str) -> None:
    if not good:
        raise ValueError(problem)


def _number(value: Any) -> float:
    if value in ("inf", "-inf"):  # nothing is known beforehand, or a beginning before all time
        return float(value)
    good = type(value) in (int, float) and bool(np.isfinite(float(value)))
    _expect(good, f"{value!r} is no finite number, expected a finite number")
    return float(value)


def _whole(value: Any, count: int, name: str) -> int:
    _expect(
        type(value) is int and 0 <= value < count, f"{name} is {value!r}, expected a whole number from 0 to {count - 1}"
    )
    return value


def _law(name: Any) -> EffectLaw:
    _expect(name in EVERY, f"no law {name!r}{did_you_mean(str(name), EVERY)}")
    return EVERY[name]


def _location(context: Context, partners: Set[str], said: Any) -> Location:
    """Return a place that a campaign has, and a partner that some law has there."""
    found = Location(**typed(get_type_hints(Location), said, "location"))
    unknown = set(found.covariates) - {*context.row.covariates, *(f"q_{joint}" for joint in context.joints)}
    _expect(found.site in context.sites, f"no site {found.site!r}{did_you_mean(found.site, context.sites)}")
    _expect(found.axis in (None, *TWIST_NAMES), f"no axis {found.axis!r}{did_you_mean(str(found.axis), TWIST_NAMES)}")
    _expect(not unknown, f"no columns {listing(sorted(unknown))} in this campaign")
    _expect(found.partner in partners, f"no partner {found.partner!r} in this campaign")
    return found


def _check_places(law: EffectLaw, location: Location, free: Sequence[int]) -> None:
    """Raise `ValueError` where terms or free inner values are not some of the law's, each once."""
    smooth = [i for i, inner in enumerate(law.inner) if inner.smooth]
    for name, asked, known in (("terms", location.terms, range(len(law.amplitudes))), ("free", free, smooth)):
        good = len(set(asked)) == len(asked) and set(asked) <= set(known) and (len(asked) > 0 or name == "free")
        _expect(good, f"{name} of {law.name}: expected different ones of {listing(map(str, known))}")
