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
from typing import Any

import numpy as np

from armflex.arm import Arm
from armflex.conventions import TWIST_NAMES
from armflex.errors import FileError, Place, did_you_mean, listing
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
from armflex.storage.whole_file import write_whole
from armflex.trace.candidates import Candidate
from armflex.trace.findings import Proof, Step
from armflex.trace.localise import RandomTwist
from armflex.trace.polish import Polished
from armflex.trace.pose_block import PoseBlock
from armflex.trace.state import State, scene_at
from armflex.version import __version__

FORMAT = "armflex-trace-checkpoint-1"

LARGEST = 2**28
"""Bytes of the largest file that is read: a thousand times what a search of a thousand poses leaves."""

INFINITE = {"inf": np.inf, "-inf": -np.inf}
"""How JSON, which has no infinity, says it: nothing is known beforehand, or a beginning before all time."""

Table = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Progress:
    """How far a search has come.

    Attributes:
        state: After the last round.
        steps: One for every accepted effect.
        scenes: The campaign as it was seen before the first round and after each: effects remember one of them.
        rounds: What a file says of each round.
        ended: Whether nothing is left to be found.
    """

    state: State
    steps: tuple[Step, ...] = ()
    scenes: tuple[Scene, ...] = ()
    rounds: tuple[Table, ...] = ()
    ended: bool = False

    def after(self, state: State, steps: Sequence[Step]) -> Progress:
        """Return the progress after one more round."""
        said = _told_round(state, self.scenes)
        return Progress(state, tuple(steps), (*self.scenes, state.scene), (*self.rounds, said))


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
    said = {
        "format": FORMAT,
        "about": about,
        "ended": progress.ended,
        "rounds": list(progress.rounds),
        "steps": [_told_step(step) for step in progress.steps],
    }
    text = json.dumps({**said, "sha256": _sha256(said)}, allow_nan=False, indent=1)
    write_whole(path, (text + "\n").encode())


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
        said = json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
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


def _refuse(name: str) -> float:
    raise ValueError(f"{name} is no number")


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
        rounds = _listed(said["rounds"], dict, "rounds")
        steps = tuple(_step(one, begun.scene) for one in _listed(said["steps"], dict, "steps"))
        wanted = {
            _whole(block["seen"], 0, number, "seen") for number, one in enumerate(rounds) for block in one["effects"]
        }
        scenes, state = [begun.scene], begun
        for number, one in enumerate(rounds, 1):
            last = number == len(rounds)
            # Only a round that effects remember, and the last, must be computed again.
            if last or number in wanted:
                state = _state(one, begun, scenes)
            scenes.append(state.scene)
        if len(state.effects) != len(steps):
            raise ValueError(f"{len(steps)} steps for {len(state.effects)} effects")
        return Progress(state, steps, tuple(scenes), tuple(rounds), _flag(said["ended"], "ended"))
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        what = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) and error.args else error
        raise FileError(Place(path), f"does not hold a search of this arm: {what}") from None


def _told_round(state: State, scenes: Sequence[Scene]) -> Table:
    random = state.random
    return {
        "left_out": np.setdiff1d(state.asked, state.rows).tolist(),
        "heed": state.heed,
        "effects": [_told_effect(block, scenes) for block in state.effects],
        "random": None
        if random is None
        else {
            "site": random.site,
            "axis": random.axis,
            "std": random.std,
            "alike": [asdict(one) for one in random.alike],
        },
        "values": state.fit.values.tolist(),
    }


def _told_effect(block: EffectBlock, scenes: Sequence[Scene]) -> Table:
    effect = block.effect
    return {
        **_told_place(effect.law, effect.location),
        "values": _told_numbers(effect.values),
        "free": list(block.free),
        "prior": _told_numbers(block.prior.tolist()),
        "seen": next(number for number, scene in enumerate(scenes) if scene is block.scene),
    }


def _told_place(law: EffectLaw, location: Location) -> Table:
    return {"law": law.name, **asdict(location), "covariates": list(location.covariates), "terms": list(location.terms)}


def _told_numbers(values: Sequence[float]) -> list[float | str]:
    return [
        value if np.isfinite(value) else {value: name for name, value in INFINITE.items()}[value] for value in values
    ]


def _told_step(step: Step) -> Table:
    return {
        "proof": {**asdict(step.proof), "null": _told_numbers([step.proof.null])[0]},
        "witness": step.witness,
        "ranking": [
            {
                **_told_place(one.candidate.law, one.candidate.location),
                "inner": _told_numbers(one.candidate.inner),
                "gain": one.gain,
                "evidence": one.evidence,
                "amplitudes": np.asarray(one.amplitudes).tolist(),
                "free": list(one.free),
            }
            for one in step.ranking
        ],
    }


def _state(said: Table, begun: State, scenes: Sequence[Scene]) -> State:
    """Return the state after a round, everything that follows from its values computed again."""
    asked = begun.asked
    left_out = [
        _whole(row, 0, len(begun.measurements) - 1, "left_out") for row in _listed(said["left_out"], int, "left_out")
    ]
    if not set(left_out) <= set(asked.tolist()):
        raise ValueError("left_out names a row that is not used")
    rows = np.setdiff1d(asked, left_out)
    first = len(begun.declared.arm.effects)
    effects = tuple(
        _effect(one, begun.scene, scenes, first + place)
        for place, one in enumerate(_listed(said["effects"], dict, "effects"))
    )
    random = None if said["random"] is None else _random(said["random"], begun.scene)
    blocks = (*begun.blocks, *effects, *(() if random is None else (random,)))
    values = np.array(_numbers(said["values"], "values"))
    count = sum(len(block.labels) for block in blocks)
    if len(values) != count:
        raise ValueError(f"{len(values)} values for {count} parameters")
    view = look(realise(begun.declared, blocks, values), begun.measurements, rows)
    fitted = Fit(begun.declared, blocks, values, view, huber_weights(view), ())
    scene, heed = scene_at(fitted, begun.measurements), _flag(said["heed"], "heed")
    return replace(begun, rows=rows, effects=effects, random=random, fit=fitted, scene=scene, heed=heed)


def _effect(said: Table, scene: Scene, scenes: Sequence[Scene], ordinal: int) -> EffectBlock:
    law, location = _law(said), _spot(said, scene)
    values = _numbers(said["values"], "values", infinite=True)
    if len(values) != len(law.amplitudes) + len(law.inner):
        raise ValueError(f"{len(values)} values of {law.name}, expected {len(law.amplitudes) + len(law.inner)}")
    free = _free(said, law)
    prior = np.array(_numbers(said["prior"], "prior", infinite=True))
    if len(prior) != len(location.terms) + len(free) or not (prior > 0.0).all():
        raise ValueError(f"prior of {law.name}: expected {len(location.terms) + len(free)} numbers above 0")
    seen = _whole(said["seen"], 0, len(scenes) - 1, "seen")
    return EffectBlock(Effect(law, location, tuple(values)), free, scenes[seen], ordinal, prior)


def _random(said: Table, scene: Scene) -> PoseBlock:
    alike = tuple(_twist(one, scene) for one in _listed(said["alike"], dict, "alike"))
    site, axis, std = _site(said, scene), _axis(said), _number(said["std"], "std")
    if std <= 0.0:
        raise ValueError(f"std is {std}, expected more than 0")
    return PoseBlock(site, axis, std, scene.column(POSE).astype(int), alike)


def _twist(said: Table, scene: Scene) -> RandomTwist:
    return RandomTwist(_site(said, scene), _axis(said), _number(said["ratio"], "ratio"), _number(said["std"], "std"))


def _step(said: Table, scene: Scene) -> Step:
    optional = {name: said["proof"][name] for name in ("sessions_before", "sessions_after")}
    numbers: dict[str, Any] = {name: _number(said["proof"][name], name) for name in ("before", "after", "errors_apart")}
    numbers["null"] = _numbers([said["proof"]["null"]], "null", infinite=True)[0]
    numbers |= {name: None if value is None else _number(value, name) for name, value in optional.items()}
    proof = Proof(**numbers)
    ranking = tuple(_polished(one, scene) for one in _listed(said["ranking"], dict, "ranking"))
    return Step(ranking, proof, _flag(said["witness"], "witness"))


def _polished(said: Table, scene: Scene) -> Polished:
    law, location = _law(said), _spot(said, scene)
    inner, amplitudes = _numbers(said["inner"], "inner", infinite=True), _numbers(said["amplitudes"], "amplitudes")
    if len(inner) != len(law.inner) or len(amplitudes) != len(location.terms):
        raise ValueError(f"{law.name} has {len(law.inner)} inner values, and an amplitude for each of its terms")
    gain, worth = (_number(said[name], name) for name in ("gain", "evidence"))
    return Polished(Candidate(law, location, tuple(inner)), gain, worth, np.array(amplitudes), _free(said, law))


def _law(said: Table) -> EffectLaw:
    name = said["law"]
    if name not in EVERY:
        raise ValueError(f"no law {name!r}{did_you_mean(str(name), EVERY)}")
    return EVERY[name]


def _spot(said: Table, scene: Scene) -> Location:
    law = _law(said)
    known = {*scene.row.covariates, *(f"q_{joint}" for joint in scene.joints)}
    covariates = tuple(_listed(said["covariates"], str, "covariates"))
    if not known.issuperset(covariates):
        raise ValueError(f"no columns {listing(sorted(set(covariates) - known))} in this campaign")
    terms = tuple(_whole(one, 0, len(law.amplitudes) - 1, "terms") for one in _listed(said["terms"], int, "terms"))
    if not terms or len(set(terms)) < len(terms):
        raise ValueError(f"terms of {law.name}: expected different ones, one or more")
    if not isinstance(said["partner"], str):
        raise ValueError(f"partner is {said['partner']!r}, expected a text")
    axis = None if said["axis"] is None else _axis(said)
    location = Location(_site(said, scene), axis, covariates, terms, said["partner"])
    partners = {"", *TWIST_NAMES, *scene.sessions, *scene.payloads, *(one.partner for one in law.places(scene.records))}
    if location.partner not in partners:
        raise ValueError(f"no partner {location.partner!r} of {law.name} in this campaign")
    return location


def _site(said: Table, scene: Scene) -> str:
    if said["site"] not in scene.sites:
        raise ValueError(f"no site {said['site']!r}{did_you_mean(str(said['site']), scene.sites)}")
    return said["site"]


def _axis(said: Table) -> str:
    if said["axis"] not in TWIST_NAMES:
        raise ValueError(f"no axis {said['axis']!r}{did_you_mean(str(said['axis']), TWIST_NAMES)}")
    return said["axis"]


def _free(said: Table, law: EffectLaw) -> tuple[int, ...]:
    free = tuple(_whole(one, 0, len(law.inner) - 1, "free") for one in _listed(said["free"], int, "free"))
    if len(set(free)) < len(free) or not all(law.inner[i].smooth for i in free):
        raise ValueError(f"free of {law.name}: expected different inner values in which it is smooth")
    return free


def _listed(value: Any, kind: type, name: str) -> list:
    if not isinstance(value, list) or not all(isinstance(one, kind) for one in value):
        raise ValueError(f"{name}: expected a list of {kind.__name__}")
    return value


def _numbers(value: Any, name: str, infinite: bool = False) -> list[float]:
    if not isinstance(value, list):
        raise ValueError(f"{name}: expected a list of numbers")
    return [INFINITE[one] if infinite and one in ("inf", "-inf") else _number(one, name) for one in value]


def _number(value: Any, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(float(value)):
        raise ValueError(f"{name} is {value!r}, expected a finite number")
    return float(value)


def _whole(value: Any, least: int, most: int, name: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise ValueError(f"{name} is {value!r}, expected a whole number from {least} to {most}")
    return value


def _flag(value: Any, name: str) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{name} is {value!r}, expected true or false")
    return value
