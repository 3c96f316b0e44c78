"""What `trace` names of empty machines that are read with noise which a fit does not suppose, or of one true effect.

    python tests/studies/noises.py [--seed 51000] [--draws 12] [--poses 150] [--only KIND ...] [--beside LAW ...]

Machines of the plant with nothing hidden, or with one effect each of `--beside`, are read with every kind of noise of
`NOISES`; orders that end in "in order" are driven along the first joint there and back. Prints of each machine what is
named at 0.9 and more, and of each kind how many machines have a name, or, beside an effect, have that one.
"""

import argparse
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from support.campaigns import SIGMA, Drawn, approach, draw
from support.scoring import is_named

from armflex import load_arm, read_measurements, trace
from armflex.errors import ArmflexError

SURE = 0.9
CAUSES = {"refraction": "refraction"}
"""Kinds of noise that the catalogue has a law for: its name is right."""
IN_ORDER = " in order"


@dataclass(frozen=True)
class Seen:
    """What an error of a reading may depend on: N rows.

    Attributes:
        read: (N, 3) noise-free readings [m].
        at: (N, 3) the same from their middle.
        range: (N,) distance [m].
        along: (N, 3) direction of the line of sight.
        q: (N, n) joint positions over their range, 0 to 1.
        drawn: The campaign.
    """

    read: np.ndarray
    at: np.ndarray
    range: np.ndarray
    along: np.ndarray
    q: np.ndarray
    drawn: Drawn


Noise = Callable[[np.random.Generator, Seen], np.ndarray]


def _white(rng: np.random.Generator, seen: Seen) -> np.ndarray:
    return rng.normal(size=seen.read.shape)


def _contaminated(rng: np.random.Generator, seen: Seen) -> np.ndarray:
    return _white(rng, seen) * np.where(rng.random((len(seen.read), 1)) < 0.05, 10.0, 1.0)


def _by(share: Callable[[Seen], np.ndarray]) -> Noise:
    """Return noise that grows three times over what a share, from 0 to 1, says."""
    return lambda rng, seen: _white(rng, seen) * (1.0 + 2.0 * share(seen))[:, None]


def _unit(values: np.ndarray) -> np.ndarray:
    return (values - values.min()) / (np.ptp(values) or 1.0)


def _autocorrelated(memory: float) -> Noise:
    def noise(rng: np.random.Generator, seen: Seen) -> np.ndarray:
        errors = _white(rng, seen)
        for row in range(1, len(errors)):
            errors[row] = memory * errors[row - 1] + np.sqrt(1.0 - memory**2) * errors[row]
        return errors

    return noise


def _walk(rng: np.random.Generator, seen: Seen) -> np.ndarray:
    walk = np.cumsum(_white(rng, seen), axis=0)
    return _white(rng, seen) + 2.0 * (walk - walk.mean(axis=0)) / walk.std()


def _field(rng: np.random.Generator, seen: Seen) -> np.ndarray:
    """A smooth field over joint positions, as large as the noise beside it."""
    waves = rng.normal(0.0, 2.0, (seen.q.shape[1], 60))
    smooth = np.cos(seen.q @ waves + rng.uniform(0.0, 2.0 * np.pi, 60)) @ rng.normal(0.0, np.sqrt(2.0 / 60.0), (60, 3))
    return _white(rng, seen) + smooth


def _shared(rng: np.random.Generator, seen: Seen) -> np.ndarray:
    """Rows of a pose share an error."""
    pose = np.unique(seen.drawn.rows.pose, return_inverse=True)[1]
    return np.sqrt(0.5) * (_white(rng, seen) + rng.normal(size=(pose.max() + 1, 3))[pose])


def _range(rng: np.random.Generator, seen: Seen) -> np.ndarray:
    return _white(rng, seen) + 3.0 * rng.normal(size=(len(seen.read), 1)) * seen.along


def _lag(rng: np.random.Generator, seen: Seen) -> np.ndarray:
    """What is read is a thousandth of the way behind, from the row before; two sigma at most, RMS."""
    behind = np.diff(seen.read, axis=0, prepend=seen.read[:1])
    size = np.sqrt((behind**2).mean()) / SIGMA
    return _white(rng, seen) - behind / SIGMA * min(1e-3, 2.0 / size)


def _refraction(rng: np.random.Generator, seen: Seen) -> np.ndarray:
    """Air that is warmer below bends the line up by its length squared, by two sigma RMS, as warm as the day is."""
    up = seen.range**2 * (1.0 + 0.2 * (seen.drawn.rows.temperature - seen.drawn.rows.temperature.mean()))
    up = 2.0 * (up - up.mean()) / up.std()
    return _white(rng, seen) + up[:, None] * np.array([0.0, 0.0, 1.0])


NOISES: dict[str, Noise] = {
    "white": _white,
    "t with 2.5 degrees": lambda rng, seen: rng.standard_t(2.5, seen.read.shape) / np.sqrt(5.0),
    "contaminated": _contaminated,
    "skewed": lambda rng, seen: rng.exponential(size=seen.read.shape) - 1.0,
    "quantised": lambda rng, seen: np.round(_white(rng, seen) / 4.0) * 4.0,
    "three times as stated": lambda rng, seen: 3.0 * _white(rng, seen),
    "growing with reach": _by(lambda seen: _unit(seen.range)),
    "growing by payload": _by(lambda seen: _unit(seen.drawn.rows.mass)),
    "growing by temperature": _by(lambda seen: _unit(seen.drawn.rows.temperature)),
    "autocorrelated 0.8": _autocorrelated(0.8),
    "autocorrelated 0.97": _autocorrelated(0.97),
    "random walk": _walk,
    "autocorrelated 0.8 in order": _autocorrelated(0.8),
    "autocorrelated 0.97 in order": _autocorrelated(0.97),
    "random walk in order": _walk,
    "smooth over joints": _field,
    "shared by repeats": _shared,
    "along the line of sight": _range,
    "lagging": _lag,
    "refraction": _refraction,
}
"""In standard deviations as stated."""


def in_order(drawn: Drawn) -> Drawn:
    """Return an empty campaign driven along the first joint there and back, ten bands of the second one."""
    rows = drawn.rows
    band = np.argsort(np.argsort(rows.q[:, 1])) * 10 // len(rows.q)
    order = np.lexsort((np.where(band % 2, -1.0, 1.0) * rows.q[:, 0], band))
    of_pose = ("q", "mass", "com", "pose", "payload", "measured", "held_out")
    moved = {name: getattr(rows, name)[order] for name in of_pose}
    moved["approach"] = approach(np.random.default_rng(drawn.seed), moved["q"])
    return replace(drawn, rows=replace(rows, **moved))


def noisy(kind: str, hidden: str, seed: int, arm: str, poses: int) -> Drawn:
    """Return a campaign read with a kind of noise."""
    drawn = draw(hidden, seed, arm=arm, poses=poses)
    if kind.endswith(IN_ORDER):
        if hidden != "none":
            raise ValueError("an effect that remembers is driven in the order that it was drawn in")
        drawn = in_order(drawn)
    if kind == "shared by repeats":  # every pose three times
        first = np.arange(len(drawn.rows.q)) // 3 * 3
        again = {name: getattr(drawn.rows, name)[first] for name in ("q", "pose")}
        drawn = replace(drawn, rows=replace(drawn.rows, **again))
    read = drawn.readings()
    far = np.linalg.norm(read, axis=1)
    low = drawn.rows.q.min(axis=0)
    q = (drawn.rows.q - low) / np.maximum(np.ptp(drawn.rows.q, axis=0), 1e-9)
    seen = Seen(read, read - read.mean(axis=0), far, read / far[:, None], q, drawn)
    errors = NOISES[kind](np.random.default_rng([seed, 17, *kind.encode()]), seen)
    return replace(drawn, errors=SIGMA * errors, lost=np.zeros(len(errors), dtype=bool))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=51000)
    parser.add_argument("--draws", type=int, default=12)
    parser.add_argument("--poses", type=int, default=150)
    parser.add_argument("--only", nargs="*", default=[*NOISES], choices=[*NOISES])
    parser.add_argument("--beside", nargs="*", default=["none"], help="laws of the plant, one hidden in each machine")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    counts = {kind: [0, 0, 0] for kind in asked.only}
    for number in range(asked.draws):
        for kind in asked.only:
            hidden, arm = asked.beside[number % len(asked.beside)], ("boom", "six")[number % 2]
            started = time.process_time()
            try:
                drawn = noisy(kind, hidden, asked.seed + number, arm, asked.poses)
                with tempfile.TemporaryDirectory() as folder:
                    files = drawn.write(Path(folder))
                    declared = load_arm(files.arm)
                    account = trace(declared, read_measurements(files.train, declared))
            except (ArmflexError, ValueError) as error:
                print(f"{kind:30s} {hidden:20s} {arm}  {type(error).__name__}: {error}", flush=True)
                continue
            sure = [found for found in account.found if found.probability >= SURE]
            laws = [found.effect.law.name for found in sure]
            right = [
                law == CAUSES.get(kind) or any(is_named(effect, found.effect) for effect in files.effects)
                for law, found in zip(laws, sure, strict=True)
            ]
            counts[kind][0] += 1
            counts[kind][1] += any(right)
            counts[kind][2] += not all(right)
            text = "; ".join(f"{found.effect.title} {found.probability:.2f}" for found in account.found) or "no name"
            kinds = account.families.found if account.families else ()
            beside = ", ".join(f"{family.name} {family.evidence:.0f}" for family in kinds)
            seconds = time.process_time() - started
            print(f"{kind:30s} {hidden:20s} {arm:4s} {text} [{beside}] {seconds:.0f} s", flush=True)
    for kind, (machines, right, false) in counts.items():
        print(f"{kind:30s} {machines:3d} machines: the right name in {right}, a false one at {SURE} in {false}")


if __name__ == "__main__":
    main()
