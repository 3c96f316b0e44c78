"""Calibrate and trace machines with loops, springs and cylinders, simulated by MuJoCo, and count what is right.

    python tests/studies/mechanisms.py calibrate --machines 20
    python tests/studies/mechanisms.py trace --machines 30 --healthy 16

One line per machine as it finishes, then the counts. CPU: about a minute a machine.
"""

import os

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import argparse
import sys
import tempfile
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.machines import MACHINES, Machine
from support.mechanism_plant import GIVES, REVERSING, SIGMA, Truth, campaign, declared

import armflex

OFFSET, SOFTER, GEOMETRY, TOOL, RATE, LENGTH = 1e-3, 0.2, 3e-4, 2e-3, 0.1, 5e-3


def prior(rate: float, length: float) -> str:
    """Return what an arm.toml says of the instrument and of what may be off."""
    return f"""
[measurement]
frame = "unknown"
[prior]
joint_offset = {OFFSET}
compliance = {SOFTER}
tool = {TOOL}
spring = {rate}
spring_length = {length}
"""


@dataclass(frozen=True)
class Drawn:
    """A machine as it was built, and what calibration should find, by the labels of parameters."""

    truth: Truth
    known: dict[str, float]


def draw(machine: Machine, rng: np.random.Generator, geometry: float, rate: float, length: float) -> Drawn:
    """Return a machine that differs from its drawing by standard deviations, as [prior] says."""
    offsets = {one: OFFSET * rng.normal() for one in machine.driven}
    logs = {one: SOFTER * rng.normal() for one in (*machine.gives, *machine.cylinders)}
    pins = {loop: SOFTER * rng.normal(size=3) for loop in machine.loops}
    springs = {one: (rate * rng.normal(), length * rng.normal()) for one in machine.springs}
    frames = {one: geometry * rng.normal(size=6) for one in machine.hinges}
    points = [f"{one}{end}" for one in (*machine.loops, *machine.cylinders) for end in ("", ":to")]
    places = {one: geometry * rng.normal(size=3) for one in points}
    truth = Truth(
        offsets=offsets,
        softer={one: float(np.exp(value)) for one, value in logs.items()},
        springs=springs,
        pins=places,
        frames=frames,
        tool=tuple((TOOL * rng.normal(size=3)).tolist()),
        compliance={loop: np.array(GIVES) * np.exp(value) for loop, value in pins.items()},
    )
    known = {f"joint_offset {one}": value for one, value in offsets.items()}
    axes = ("dx", "dy", "dz", "rx", "ry", "rz")
    for one, value in logs.items():
        turns = one in machine.gives
        axis = axes[3 + int(np.argmax(machine.gives[one][0]))] if turns else "dx"
        known[f"compliance {one} {axis}"] = value
    for loop, values in pins.items():
        known |= {f"compliance {loop} {axis}": value for axis, value in zip(axes, values.tolist(), strict=False)}
    for one, (share, longer) in springs.items():
        known |= {f"spring {one} rate": share, f"spring {one} length": longer}
    if geometry:
        for one, values in (*frames.items(), *places.items()):
            known |= {f"geometry {one} {axis}": value for axis, value in zip(axes, values.tolist(), strict=False)}
    return Drawn(truth, known)


def calibrated(name: str, seed: int, rows: int, held: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Return how far parameters are from the truth in standard deviations, their share of the prior, and held-out RMS.

    The last is over the noise.
    """
    rng = np.random.default_rng([seed, list(MACHINES).index(name)])
    machine = MACHINES[name]
    drawn = draw(machine, rng, GEOMETRY, RATE, LENGTH)
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        arm = declared(machine, folder, prior(RATE, LENGTH) + f"geometry = {GEOMETRY}\n")
        fitted = campaign(machine, arm, drawn.truth, rows, rng, folder / "fitted.csv")
        other = campaign(machine, arm, drawn.truth, held, rng, folder / "held.csv")
        found = armflex.calibrate(arm, fitted).arm
        certainty = found.certainty
        assert certainty is not None
        std = dict(zip(certainty.labels, np.sqrt(np.diag(certainty.covariance)).tolist(), strict=True))
        values = {one.label: found.found(one) for one in certainty.parameters if one.label in drawn.known}
        off = np.array([(values[label] - drawn.known[label]) / std[label] for label in values])
        before = {one.label: arm.prior.of(one)[1] for one in certainty.parameters if one.label in drawn.known}
        share = np.array([std[label] / before[label] for label in values])
        predicted = armflex.predict(found, other)
        errors = predicted.position - other.position
    return off, share, float(np.sqrt((errors**2).mean()) / SIGMA)


def study_calibrate(machines: int, seed: int, rows: int) -> None:
    offs, shares, ratios = [], [], []
    for i in range(machines):
        name, start = list(MACHINES)[i % len(MACHINES)], time.process_time()
        off, share, ratio = calibrated(name, seed + i // len(MACHINES), rows, 40)
        spent = time.process_time() - start
        inside = np.abs(off) < 1.96
        print(f"{name:14s} {inside.sum():3d} of {len(off)} inside, held out {ratio:.3f}, {spent:.0f} s", flush=True)
        offs.append(off)
        shares.append(share)
        ratios.append(ratio)
    off, share = np.concatenate(offs), np.concatenate(shares)
    shown = share < 0.5
    print(f"inside their 95 % intervals: {np.mean(np.abs(off) < 1.96):.1%} of {len(off)} parameters")
    print(f"of those known twice as well as before: {np.mean(np.abs(off[shown]) < 1.96):.1%} of {shown.sum()}")
    print(f"held out over the noise: {np.sqrt(np.mean(np.square(ratios))):.3f}, at most {max(ratios):.3f}")


SPRING, SPRING_LENGTH = 0.02, 1e-3
"""What is not known of springs where one may be weak."""

FAULTS = {
    "pin_play": ("parallelogram", "uneven", "five_bar"),
    "weak_spring": ("uneven",),
    "cylinder_leak": ("crane",),
    "bent_rod": ("parallelogram", "uneven", "five_bar"),
}
"""Effects, and the machines that can have them."""


def broken(truth: Truth, machine: Machine, effect: str, rng: np.random.Generator) -> tuple[Truth, str]:
    """Return a machine with one effect more, and the site of it."""
    if effect == "weak_spring":
        (site,) = machine.springs
        return replace(truth, lost={site: rng.uniform(0.15, 0.3)}), site
    if effect == "cylinder_leak":
        site = str(rng.choice(list(machine.cylinders)))
        return replace(truth, leaks={site: rng.uniform(3e-11, 1e-10)}), site
    site = str(rng.choice(list(machine.loops)))
    if effect == "pin_play":
        return replace(truth, play={site: rng.uniform(0.6e-3, 1.5e-3)}), site
    at = np.array(machine.loops[site][1])
    longer = rng.choice([-1.0, 1.0]) * rng.uniform(2e-3, 5e-3) * at / np.linalg.norm(at)
    return replace(truth, pins={site: longer}), site


def traced(name: str, effect: str | None, seed: int, rows: int) -> tuple[str, str]:
    """Return the verdict on one machine, and what was found."""
    rng, machine = np.random.default_rng([seed, list(MACHINES).index(name), len(effect or "")]), REVERSING[name]
    truth, site = draw(machine, rng, 0.0, SPRING, SPRING_LENGTH).truth, ""
    if effect:
        truth, site = broken(truth, machine, effect, rng)
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        arm = declared(machine, folder, prior(SPRING, SPRING_LENGTH))
        found = armflex.trace(arm, campaign(machine, arm, truth, rows, rng, folder / "read.csv"))
    names = [(one.effect.law.name, one.effect.location.place) for one in found.found]
    also = [(each.law.name, each.location.place) for one in found.found for each, _ in (*one.equivalent, *one.credible)]
    shown = "; ".join(f"{law} {place}" for law, place in names) or "nothing"
    if not effect:
        return ("FALSE" if names else "ok"), shown
    wanted, shown = (effect, site), f"{effect} {site}: {shown}"
    if wanted in names:
        return ("exact" if len(names) == 1 else "exact+"), shown
    return ("class" if wanted in also else "WRONG" if names else "missed"), shown


def study_trace(machines: int, healthy: int, seed: int, rows: int) -> None:
    asked = [(effect, FAULTS[effect]) for effect in FAULTS]
    jobs: list[tuple[str, str | None, int]] = []
    for i in range(machines):
        effect, names = asked[i % len(asked)]
        turn = i // len(asked)
        jobs.append((names[turn % len(names)], effect, seed + turn))
    jobs += [(list(MACHINES)[i % len(MACHINES)], None, seed + i // len(MACHINES)) for i in range(healthy)]
    verdicts: dict[str, list[str]] = {}
    for name, effect, number in jobs:
        start = time.process_time()
        verdict, shown = traced(name, effect, number, rows)
        print(f"{verdict:7s} {name:14s} {shown}, {time.process_time() - start:.0f} s", flush=True)
        verdicts.setdefault(effect or "healthy", []).append(verdict)
    for effect, some in verdicts.items():
        counts = ", ".join(f"{some.count(one)} {one}" for one in dict.fromkeys(some))
        print(f"{effect}: {counts}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("calibrate", "trace"))
    parser.add_argument("--machines", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rows", type=int, default=120)
    parser.add_argument("--healthy", type=int, default=16)
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    if asked.what == "calibrate":
        study_calibrate(asked.machines, asked.seed, asked.rows)
    else:
        study_trace(asked.machines, asked.healthy, asked.seed, asked.rows)


if __name__ == "__main__":
    main()
