"""What cheap instruments are worth, on machines drawn from heavy_six; the plant that is measured shares no code.

    python tests/studies/instruments.py wires [--machines 20]
    python tests/studies/instruments.py pairs [--machines 40]
    python tests/studies/instruments.py lengths
    python tests/studies/instruments.py accelerometers --measured DIR

`wires`: 60 wire lengths and one level against 60 tracker positions of the same cost in noise: three numbers a row, each
root three times as uncertain. Printed are how many of the compliances that are told lie in their 95 % interval, and the
error of the tip elsewhere, the best frame of either allowed. `pairs`: of two effects that move the tip alike one is the
machine's, large enough for the tip to show that there is something; printed is how often a tracker leaves both, the
truth alone, the other one alone or nothing, and how often the level or wire that `plan` chooses tells which.
`lengths`: 1042 wire lengths of a small arm that is known by its DH numbers, and 300 more.
`accelerometers`: those of the Hilti machine beside its positions, and what is found with them and without.
"""

import os

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import argparse
import csv
import sys
import tempfile
import tomllib
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from support import wire_file
from support.heavy_campaign import PAYLOADS
from support.instruments import LEVEL, PRIOR, WIRE, Machine, heavy, measured
from support.plant import Push, Rows, State
from support.small_arms import ROBOTS

from armflex import Arm, Measurements, calibrate, load_arm, plan, predict, read_measurements, trace
from armflex.conventions import TWIST_NAMES
from armflex.estimate import Calibration
from armflex.plan.effects_in_question import spelled
from armflex.plan.instruments import declaration
from armflex.readings.instrument import fit_frame
from armflex.trace.findings import Trace

ROWS, WIRE_NOISE, TOLD, INSIDE = 60, 5e-5, 0.5, 1.96
"""Rows of a campaign, noise of a wire [m], share of its prior up to which a compliance is told, standard deviations."""


def elsewhere(machine: Machine, arm: Arm) -> float:
    """Return the RMS error of the tip at other poses [m], the best frame allowed."""
    rows = machine.rows(100)
    truth = machine.plant.relax(rows).frames[:, -1, :3, 3]
    found = arm.deflection(rows.q, [PAYLOADS[i][0] for i in rows.payload]).pose[:, :3, 3]
    frame = fit_frame(found, truth)
    return float(np.sqrt(((found @ frame.rotation.T + frame.translation - truth) ** 2).sum(axis=1).mean()))


def inside(machine: Machine, found: Calibration) -> np.ndarray:
    """Return of every compliance that is told whether the true one is inside its 95 % interval."""
    joints, hits = [joint.name for joint in machine.plant.joints], []
    for one in found.parameters:
        if one.which.group.kind == "compliance" and one.std < TOLD * one.prior:
            truth = machine.factors[joints.index(str(one.which.group.of)), TWIST_NAMES.index(str(one.which.name))]
            hits.append(abs(one.value - truth) < INSIDE * one.std)
    return np.array(hits, dtype=bool)


def wires(folder: Path, machines: int, first: int = 0) -> dict[str, float]:
    """Return coverage, machines all of whose intervals hold, and errors of the tip elsewhere [m]."""
    hits, errors, not_told = [], [], 0
    for seed in range(first, first + machines):
        own = []
        for name, instruments in (("cheap", (WIRE, LEVEL)), ("tracker", ()), ("wire alone", (WIRE,))):
            arm = heavy(folder / name, *instruments)
            machine = Machine.draw(arm, seed)
            tracker = None if instruments else np.sqrt(3.0) * WIRE_NOISE
            rows = measured(machine, arm, machine.rows(ROWS), folder / name / "rows.csv", tracker)
            loaded = load_arm(arm)
            found = calibrate(loaded, read_measurements(rows, loaded))
            if name == "cheap":
                hits.append(inside(machine, found))
            not_told += len(found.undetermined) if name == "wire alone" else 0
            own.append(elsewhere(machine, found.arm))
        errors.append(own)
        print(f"machine {seed}: {hits[-1].sum()} of {len(hits[-1])} inside, tip {np.round(1e6 * np.array(own), 1)} um")
    cheap, tracker, alone = np.sqrt((np.array(errors) ** 2).mean(axis=0))
    return {
        "coverage": float(np.concatenate(hits).mean()),
        "machines": float(sum(one.mean() >= 0.9 for one in hits)),
        "tip_cheap_m": float(cheap),
        "tip_tracker_m": float(tracker),
        "tip_wire_alone_m": float(alone),
        "ratio": float(cheap / tracker),
        "not_told_by_a_wire": not_told / machines,
    }


LOOSE = PRIOR + "tool = 0.2\n"
"""Prior of machines whose target is somewhere on the tool."""

TARGET, TRACKER, STEPS = (0.2, 0.3, 0.1), 2e-4, (5.0, 45.0)
"""Where [m], noise of what looks at it [m], lowest and highest temperature [deg C]."""

FIRST, NEXT = 80, 40
"""Rows of the first campaign, and of those that are planned then."""

Pushing = Callable[[State, Push], None]


def turned(machine: Machine, joint: int, size: float, shape: Callable[[State], np.ndarray]) -> Pushing:
    """Return what moves a joint by `size` times a shape."""

    def act(state: State, push: Push) -> None:
        push.motion[:, joint] += size * shape(state)[:, None] * machine.plant.joints[joint].drive

    return act


def warmed(end: int, twist: Sequence[float]) -> Pushing:
    """Return what moves the end of a link by a twist per kelvin."""

    def act(state: State, push: Push) -> None:
        push.link[:, end] += (state.rows.temperature - 20.0)[:, None] * np.array(twist, float)

    return act


def pulled(machine: Machine, joint: int, size: float) -> Pushing:
    """Return what turns a joint by `size` per radian with a moment of its drive, and so all that its flexure gives."""
    drive = machine.plant.joints[joint].drive
    given = machine.plant.compliance[machine.plant.joints[joint].name] @ drive

    def act(state: State, push: Push) -> None:
        push.flexure[:, joint] += size * (state.rows.q[:, joint] - 0.2)[:, None] * given / (drive @ given)

    return act


def _plays(joint: int) -> Callable[[Machine, float], Pushing]:
    return lambda machine, size: turned(machine, joint, 1.2e-3 * size, lambda state: state.rows.approach[:, joint])


PAIRS: dict[str, dict[str, Callable[[Machine, float], Pushing]]] = {
    "play at coaxial joints": {"backlash:J4": _plays(3), "backlash:J6": _plays(5)},
    "growth of neighbouring links": {
        "thermal_growth:J6": lambda machine, size: warmed(5, [4e-5 * size, 0, 0, 0, 0, 0]),
        "thermal_growth:tool": lambda machine, size: warmed(6, [4e-5 * size, 0, 0, 0, 0, 0]),
    },
    "bending of neighbouring links": {
        "thermal_bending:J6:rx": lambda machine, size: warmed(5, [0, 0, 0, 1e-4 * size, 0, 0]),
        "thermal_bending:tool:rx": lambda machine, size: warmed(6, [0, 0, 0, 1e-4 * size, 0, 0]),
    },
    "encoder scale and dress pack": {
        "encoder_scale:J2": lambda machine, size: turned(
            machine, 1, 2.5e-3 * size, lambda state: state.rows.q[:, 1] - 0.2
        ),
        "dress_pack:J2": lambda machine, size: pulled(machine, 1, 2.5e-3 * size),
    },
}
"""By what they are: either effect of a pair as `plan` spells it, and how it pushes at a machine, 0.7 to 1.4 times.

In the first campaign each moves the target by more than the tracker's noise: what no tip reading shows at all would say
nothing of whether the two are told apart.
"""


LEFT = ("class", "truth", "other", "nothing")


@dataclass(frozen=True)
class Told:
    """What came of a machine that has one effect of a pair.

    Attributes:
        first: What a tracker's campaign left: 'class', 'truth' alone, the 'other' alone, or 'nothing'.
        advised: Whether it was then said that a level or a wire would split it.
        without: Standard deviations that `plan` expects between the two in as many rows at random by the tracker alone.
        told: Whether what was found with the planned rows, read by what `plan` mounted as well, is the truth alone.
        text: In words.
    """

    first: str
    advised: bool
    without: float
    told: bool
    text: str


def one_of_a_pair(folder: Path, name: str, seed: int) -> Told:
    """Trace a machine as its owner would: a campaign, what `plan` says to mount and to drive next, both together."""
    rng, pair = np.random.default_rng([seed, 5]), PAIRS[name]
    truth = list(pair)[int(rng.integers(2))]
    size = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.7, 1.4))
    full = np.array(tomllib.loads((ROBOTS / "heavy_six" / "arm.toml").read_text())["flexure"]["J2"]["compliance"])

    def traced(rows: Rows, instruments: str = "") -> tuple[Arm, Measurements, Trace]:
        """Return what is found in rows, of which those after the first campaign are read by further instruments."""
        arm = heavy(folder, instruments, prior=LOOSE)
        text = arm.read_text()
        own = text.partition("[flexure.J2]")[2].partition("\n[")[0]
        arm.write_text(text.replace(own, f'\njoint = "J2"\nmodel = "linear"\ncompliance = {full.tolist()}\n'))
        machine = drawn(arm)
        machine.rng = np.random.default_rng([seed, 7])
        push, sides = pair[truth](machine, size), {f"approach_J{i + 1}": s for i, s in enumerate(rows.approach.T)}
        given = {"temperature": rows.temperature, "time": rows.time, **sides}
        file = measured(machine, arm, rows, folder / "rows.csv", TRACKER, (push,), **given)
        if instruments:
            header, *lines = (line.split(",") for line in file.read_text().splitlines())
            name = instruments.partition("[instrument.")[2].partition("]")[0]
            own = {i for i, column in enumerate(header) if column.startswith(name)}
            for line in lines[:FIRST]:
                line[:] = ["" if i in own else cell for i, cell in enumerate(line)]
            file.write_text("\n".join(map(",".join, [header, *lines])) + "\n")
        loaded = load_arm(arm)
        known = read_measurements(file, loaded)
        return loaded, known, trace(loaded, known)

    def drawn(arm: Path) -> Machine:
        machine = Machine.draw(arm, seed)
        root = np.exp(0.5 * machine.factors[1])
        machine.plant.compliance["J2"] = root[:, None] * full * root
        machine.plant.target = np.array(TARGET)
        return machine

    def left(found: Trace) -> str:
        """Return which of the pair was found, as `Told.first` has it."""
        own = set().union(*spots(found))
        return "class" if own == set(pair) else "nothing" if not own else "truth" if truth in own else "other"

    def spots(found: Trace) -> list[set[str]]:
        every = [[one.effect, *(other for other, _ in one.equivalent)] for one in found.found]
        return [{one for one in pair for effect in own if f"{spelled(effect)}:".startswith(f"{one}:")} for own in every]

    machine = drawn(heavy(folder, prior=LOOSE))
    rows, count = machine.rows(FIRST), FIRST
    rows.temperature, rows.time = machine.rng.uniform(*STEPS, count), 300.0 * np.arange(count)
    rows.approach = np.repeat(machine.rng.choice([-1.0, 1.0], (count, 1)), rows.q.shape[1], axis=1)
    if name.startswith("play"):
        rows.q[:, 4] = 0.0  # the wrist straight: J4 and J6 on one line
    arm, known, found = traced(rows)
    first = left(found)
    advised = any("a level on " in text or "a wire to " in text for text in found.next_measurement)

    settable = {"temperature": STEPS} if "thermal" in truth else {}
    wanted = dict(after=known, between=tuple(pair), covariates=settable)
    plans = [plan(arm, NEXT, **wanted, instruments=["tracker", word]) for word in ("level", "wire")]
    chosen = max(plans, key=lambda one: one.mounts[0].reached)
    sensor, more = chosen.mounts[0].sensor, chosen.rows.some(np.flatnonzero(chosen.rows.measured))
    both = Rows.plain(np.vstack([rows.q, more.q]), *(np.zeros((count + NEXT, *size)) for size in ((), (3,))))
    both.payload = np.append(rows.payload, [[one[0] for one in PAYLOADS].index(payload) for payload in more.payload])
    both.mass, both.com = (np.array([PAYLOADS[i][k] for i in both.payload], float) for k in (1, 2))
    both.approach = np.vstack([rows.approach, np.where(more.approach == 0.0, 1.0, more.approach)])
    both.time = 300.0 * np.arange(count + NEXT)
    both.temperature = np.append(rows.temperature, more.covariates.get("temperature", np.full(NEXT, 20.0)))
    mounted = f"\n{declaration(sensor)}\n"
    told = traced(both, mounted)[2]
    text = f"{truth} by {sensor.name}: {'; '.join(one.effect.title for one in told.found)}"
    return Told(first, advised, chosen.mounts[0].without, left(told) == "truth", text)


def pairs(folder: Path, machines: int, first: int = 0) -> dict[str, float]:
    """Return shares of machines: what a tracker leaves of the pair, and whether one instrument more tells it."""
    found: dict[str, list[Told]] = {}
    for seed in range(first, first + machines):
        name = list(PAIRS)[seed % len(PAIRS)]
        one = one_of_a_pair(folder / str(seed), name, seed)
        found.setdefault(name, []).append(one)
        alone = f"{one.without:.2g} standard deviations by the tracker alone"
        said = f"{one.first}, {'told' if one.told else 'not told'}"
        print(f"machine {seed}, {name}: {said}, {alone}, {one.text}", flush=True)
    shares = {"every pair": [one for several in found.values() for one in several], **found}
    return {
        f"{name}: {what}": float(np.mean([one.first == what if what in LEFT else getattr(one, what) for one in own]))
        for name, own in shares.items()
        for what in (*LEFT, "advised", "told", "without")
    }


def lengths(folder: Path, machines: int) -> dict[str, float]:
    """Return what wire lengths alone make of an arm by its DH numbers [mm], and how much they leave open."""
    arm, found = load_arm(wire_file.declared(folder)), []
    for seed in range(machines):
        q = wire_file.positions(1342, seed)
        rows, more = (wire_file.write(folder / f"{i}.csv", part, seed) for i, part in enumerate((q[:1042], q[1042:])))
        fitted = calibrate(arm, read_measurements(rows, arm))
        asked = read_measurements(more, fitted.arm)
        errors = predict(fitted.arm, asked).sensors[0][0].values - asked.readings.kinds[0].values
        untold = float(len(fitted.undetermined))
        found.append([1e3 * fitted.declared_rms, 1e3 * fitted.rms, 1e3 * float(np.sqrt((errors**2).mean())), untold])
    names = ("declared_mm", "calibrated_mm", "not_fitted_mm", "not_told")
    return dict(zip(names, np.mean(found, axis=0).tolist(), strict=True))


HILTI = """
[instrument.acc_base]
kind = "acceleration"
link = "base_link"
reads = "specific_force"
mounting_std = 0.05
bias_std = 0.05
sigma = 5e-3

[instrument.acc_column]
kind = "acceleration"
link = "column_top"
reads = "specific_force"
mounting_std = 0.05
bias_std = 0.05
sigma = 5e-3
"""


def accelerometers(machine: Path, folder: Path) -> None:
    """Print what the accelerometers add to the positions of every campaign of the Hilti machine."""
    declared = (machine / "arm.toml").read_text().replace('"trailblazer.urdf"', f'"{machine / "trailblazer.urdf"}"')
    for name in ("flat", "pallet", "seesaw"):
        rows, felt = (list(csv.DictReader((machine / f"{name}{end}.csv").open())) for end in ("", ".accel"))
        for row, own in zip(rows, felt, strict=True):
            row |= {f"acc_{key.replace('_accel', '')}": value for key, value in own.items()}
        file = folder / f"{name}.csv"
        with open(file, "w", newline="") as out:
            writer = csv.DictWriter(out, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
        for title, text in (("positions", declared), ("and accelerometers", declared + HILTI)):
            toml = folder / "arm.toml"
            toml.write_text(text)
            arm = load_arm(toml)
            found = calibrate(arm, read_measurements(file, arm), anyway=True)
            sizes = ", ".join(f"{kind.title} {after:.3g} {kind.unit}" for kind, _, after, _ in found.by_kind)
            spread = np.exp(np.mean([np.log(p.std / p.prior) for p in found.parameters if p.which.group.moves]))
            print(f"{name}, {title}: held out {1e3 * found.held_out[1]:.3f} mm, {sizes}; std over prior {spread:.3f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("wires", "pairs", "lengths", "accelerometers"))
    parser.add_argument("--machines", type=int)
    parser.add_argument("--measured", type=Path)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as scratch:
        if given.what == "accelerometers":
            accelerometers(given.measured, Path(scratch))
        else:
            study, usual = {"wires": (wires, 20), "pairs": (pairs, 40), "lengths": (lengths, 1)}[given.what]
            found = study(Path(scratch), given.machines or usual)
            print("\n".join(f"{name} {value:.4g}" for name, value in found.items()))
