"""A search in a file, so that one that was interrupted goes on from the last effect that it accepted.

Strict JSON with a SHA-256 of its content. What fits and searches computed is computed again from what they arrived at:
for every round of the search the rows in use, the effects with their values, what was free of them, and the values of
everything that was fitted; for every accepted effect its proof and what it was chosen among.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal, get_type_hints

import numpy as np

from armflex.arm import Arm
from armflex.conventions import TWIST_NAMES
from armflex.errors import FileError, Place, listing
from armflex.estimate.effect_block import EffectBlock
from armflex.estimate.fit import Fit, realise
from armflex.estimate.robust import huber_weights
from armflex.estimate.view import look
from armflex.laws.effects.catalogue import EVERY
from armflex.laws.effects.effect import Effect, EffectLaw
from armflex.laws.effects.location import Location
from armflex.laws.effects.scene import Scene
from armflex.measured.measurements import Measurements
from armflex.rows.rows import POSE
from armflex.storage.digest import digest
from armflex.storage.schema import strict_json, typed
from armflex.storage.whole_file import write_whole
from armflex.trace.accept import Proof, Step
from armflex.trace.candidates import Candidate
from armflex.trace.polish import Polished
from armflex.trace.state import State, scene_at
from armflex.trace.unrecorded import PoseBlock, RandomTwist
from armflex.version import __version__

FORMAT = "armflex-trace-checkpoint-2"

LARGEST = 2**28
"""Bytes of the largest file that is read: a thousand times what a search of a thousand poses leaves."""

Table = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Progress:
    """How far a search has come.

    Attributes:
        state: After the last round.
        scenes: The campaign as it was seen before the first round and after each: effects remember one of them.
        rounds: What a file says of each round.
        ended: Whether nothing is left to be found.
    """

    state: State
    scenes: tuple[Scene, ...] = ()
    rounds: tuple[Table, ...] = ()
    ended: bool = False

    def after(self, state: State) -> Progress:
        """Return the progress after one more round."""
        return Progress(state, (*self.scenes, state.scene), (*self.rounds, _told_round(state, self.scenes)))


def expected(scene: Scene) -> Table:
    """Return what a file says of a search of a campaign, by type; see `typed`."""
    number = float | Literal["inf", "-inf"]  # JSON has no infinity: nothing is known beforehand, or before all time
    partners = {place.partner for law in EVERY.values() for place in law.places(scene.records)}
    axis: Any = Literal[*TWIST_NAMES]
    twist = {"site": Literal[*scene.sites], "axis": axis, "std": float}
    alike = {**twist, "ratio": float}
    random = {**twist, "alike": list[alike]}
    place = {
        "law": Literal[*EVERY],
        "site": Literal[*scene.sites],
        "axis": axis | None,
        "covariates": tuple[Literal[*scene.row.covariates, *(f"q_{joint}" for joint in scene.joints)], ...],
        "terms": tuple[int, ...],
        "partner": Literal[*sorted({"", *TWIST_NAMES, *scene.sessions, *scene.payloads, *partners})],
        "free": tuple[int, ...],
    }
    effect = {**place, "values": tuple[number, ...], "prior": list[number], "seen": int}
    polished = {**place, "inner": tuple[number, ...], "amplitudes": list[float], "gain": float, "evidence": float}
    proof = get_type_hints(Proof) | {"null": number}
    a_round = {
        "left_out": list[int],
        "heed": bool,
        "effects": list[effect],
        "random": list[random],
        "values": list[float],
    }
    a_step = {"proof": proof, "witness": bool, "ranking": list[polished]}
    return {"format": str, "about": Any, "ended": bool, "rounds": list[a_round], "steps": list[a_step]}


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
    steps = []
    for step in progress.state.steps:
        assert step is not None
        ranking = [
            {
                **_told_place(one.candidate.law, one.candidate.location, one.free),
                "inner": _told_numbers(one.candidate.inner),
                "gain": one.gain,
                "evidence": one.evidence,
                "amplitudes": np.asarray(one.amplitudes).tolist(),
            }
            for one in step.ranking
        ]
        (null,) = _told_numbers([step.proof.null])
        steps.append({"proof": {**asdict(step.proof), "null": null}, "witness": step.witness, "ranking": ranking})
    said = {"format": FORMAT, "about": about, "ended": progress.ended, "rounds": list(progress.rounds), "steps": steps}
    text = json.dumps({**said, "sha256": _sha256(said)}, allow_nan=False, indent=1)
    write_whole(path, (text + "\n").encode())


def _told_round(state: State, scenes: Sequence[Scene]) -> Table:
    return {
        "left_out": np.setdiff1d(state.asked, state.rows).tolist(),
        "heed": state.heed,
        "effects": [
            {
                **_told_place(block.effect.law, block.effect.location, block.free),
                "values": _told_numbers(block.effect.values),
                "prior": _told_numbers(block.prior.tolist()),
                "seen": next(number for number, scene in enumerate(scenes) if scene is block.scene),
            }
            for block in state.effects
        ],
        "random": [
            {"site": one.site, "axis": one.axis, "std": one.std, "alike": [asdict(twist) for twist in one.alike]}
            for one in ((state.random and [state.random]) or [])
        ],
        "values": state.fit.values.tolist(),
    }


def _told_place(law: EffectLaw, location: Location, free: Sequence[int]) -> Table:
    return {"law": law.name, **asdict(location), "free": list(free)}


def _told_numbers(values: Sequence[float]) -> list[float | str]:
    return [value if np.isfinite(value) else str(float(value)) for value in values]


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
    try:
        said = typed(expected(begun.scene), said, "it")
        steps, scenes, state = tuple(_step(one) for one in said["steps"]), [begun.scene], begun
        seen = {effect["seen"] for one in said["rounds"] for effect in one["effects"]}
        for number, one in enumerate(said["rounds"], 1):
            # Only a round that effects remember, and the last, must be computed again.
            if number == len(said["rounds"]) or number in seen:
                state = _state(one, begun, scenes)
            scenes.append(state.scene)
        _expect(len(state.effects) == len(steps), f"{len(steps)} steps for {len(state.effects)} effects")
        return Progress(replace(state, steps=steps), tuple(scenes), tuple(said["rounds"]), said["ended"])
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise FileError(Place(path), f"does not hold a search of this arm: {error}") from None


def _expect(good: bool, problem: str) -> None:
    if not good:
        raise ValueError(problem)


def _state(said: Table, begun: State, scenes: Sequence[Scene]) -> State:
    """Return the state after a round, everything that follows from its values computed again."""
    asked, left_out, last = begun.asked, said["left_out"], len(begun.measurements) - 1
    _expect(all(0 <= row <= last for row in left_out), f"left_out: expected a whole number from 0 to {last} each")
    _expect(set(left_out) <= set(asked.tolist()), "left_out names a row that is not used")
    effects = []
    for place, one in enumerate(said["effects"], len(begun.declared.arm.effects)):
        law, location = _place(one)
        values, prior = tuple(map(float, one["values"])), np.array([float(number) for number in one["prior"]])
        count, free = len(law.amplitudes) + len(law.inner), len(location.terms) + len(one["free"])
        _expect(len(values) == count, f"{len(values)} values of {law.name}, expected {count}")
        _expect(
            len(prior) == free and bool((prior > 0.0).all()), f"prior of {law.name}: expected {free} numbers above 0"
        )
        seen = one["seen"]
        _expect(0 <= seen < len(scenes), f"seen is {seen}, expected a whole number from 0 to {len(scenes) - 1}")
        effects.append(EffectBlock(Effect(law, location, values), one["free"], scenes[seen], place, prior))
    randoms, groups = [], begun.scene.column(POSE).astype(int)
    for one in said["random"]:
        alike = tuple(RandomTwist(**other) for other in one["alike"])
        _expect(one["std"] > 0.0, f"std is {one['std']}, expected more than 0")
        randoms.append(PoseBlock(one["site"], one["axis"], one["std"], groups, alike))
    _expect(len(randoms) < 2, "random: expected one at most")
    blocks = (*begun.blocks, *effects, *randoms)
    values, count = np.array(said["values"]), sum(len(block.labels) for block in blocks)
    _expect(len(values) == count, f"{len(values)} values for {count} parameters")
    view = look(realise(begun.declared, blocks, values), begun.measurements, np.setdiff1d(asked, left_out))
    fitted = Fit(begun.declared, blocks, values, view, huber_weights(view), ())
    scene = scene_at(fitted, begun.measurements)
    known = {
        "rows": view.rows,
        "effects": tuple(effects),
        "random": next(iter(randoms), None),
        "fit": fitted,
        "scene": scene,
    }
    return replace(begun, **known, heed=said["heed"])


def _step(said: Table) -> Step:
    proof = Proof(**{**said["proof"], "null": float(said["proof"]["null"])})
    ranking = []
    for one in said["ranking"]:
        law, location = _place(one)
        inner, amplitudes = tuple(map(float, one["inner"])), np.array(one["amplitudes"])
        fits = len(inner) == len(law.inner) and len(amplitudes) == len(location.terms)
        _expect(fits, f"{law.name} has {len(law.inner)} inner values, and an amplitude for each of its terms")
        candidate = Candidate(law, location, inner)
        ranking.append(Polished(candidate, one["gain"], one["evidence"], amplitudes, one["free"]))
    return Step(tuple(ranking), proof, said["witness"])


def _place(said: Table) -> tuple[EffectLaw, Location]:
    """Return law and location, whose terms and free inner values are some of the law's, each once."""
    law = EVERY[said["law"]]
    some = {"terms": range(len(law.amplitudes)), "free": [i for i, inner in enumerate(law.inner) if inner.smooth]}
    for name, known in some.items():
        asked = said[name]
        good = len(set(asked)) == len(asked) and set(asked) <= set(known) and (asked or name == "free")
        _expect(bool(good), f"{name} of {law.name}: expected different ones of {listing(map(str, known))}")
    return law, Location(**{one.name: said[one.name] for one in fields(Location)})
