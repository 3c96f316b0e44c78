"""Campaigns of planned and of random poses on machines that share no code with armflex, and what came of them.

    python tests/studies/planned.py [--machines 6]

prints how many random poses it takes for the certainty, and the error, of a planned campaign, and how far apart two
hypothesis effects are when both are fitted to the readings of a machine that has one of them.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.campaign_files import ARMS, declared_text, write_columns
from support.campaigns import true_machine
from support.plant import Array, Plant, Push, Rows, State, apply, pose, turn
from support.undeclared import AXES

from armflex import Arm, Measurements, Trajectory, calibrate, load_arm, plan, predict, read_measurements, write_plan
from armflex.estimate.block import EffectBlock, amplitude_prior
from armflex.estimate.blocks import declared_blocks
from armflex.estimate.fit import fit
from armflex.estimate.placement import first_guess
from armflex.estimate.view import look
from armflex.linear_gaussian import LinearGaussian
from armflex.plan.effects_in_question import named_effect
from armflex.plan.planned_rows import Plan

SIGMA = 2e-4  # m
Hidden = Callable[[State, Push], None]


@dataclass(frozen=True)
class Stops:
    """What was driven: positions, number of the payload, side that every joint came from, and what is read."""

    q: Array
    payload: Array
    approach: Array
    read: Array


@dataclass(frozen=True)
class Machine:
    """A true machine and an instrument somewhere."""

    arm: str
    plant: Plant
    station: Array

    @classmethod
    def draw(cls, arm: str, seed: int) -> Machine:
        rng = np.random.default_rng([seed, 77])
        station = pose(rng.normal(0.0, 3.0, 3), turn(np.array([0.0, 0.0, rng.uniform(-3.0, 3.0)])))
        return cls(arm, true_machine(rng, arm), station)

    def places(self, stops: Stops, effects: Sequence[Hidden] = ()) -> Array:
        """Return (N, 3) what an instrument without noise would read."""
        carried = ARMS[self.arm].payloads
        mass = np.array([carried[k][1] for k in stops.payload])
        com = np.array([carried[k][2] for k in stops.payload], float)
        rows = replace(Rows.plain(stops.q, mass, com), approach=stops.approach)
        return apply(self.station, self.plant.points(self.plant.relax(rows, effects)))

    def measure(self, path: Path, stops: Stops, seed: int, effects: Sequence[Hidden] = ()) -> Path:
        """Write a campaign of one session."""
        noise = np.random.default_rng([seed, 78]).normal(0.0, SIGMA, (len(stops.q), 3))
        seen = self.places(stops, effects) + noise
        names = [joint.name for joint in self.plant.joints]
        columns = {
            "pose": [f"p{i}" for i in range(len(seen))],
            "payload": [ARMS[self.arm].payloads[k][0] for k in stops.payload],
            **{f"q_{name}": stops.q[:, i].tolist() for i, name in enumerate(names)},
            **{f"approach_{name}": stops.approach[:, i].astype(int).tolist() for i, name in enumerate(names)},
            **{axis: _where(stops.read, seen[:, i]) for i, axis in enumerate("xyz")},
            "sigma": [SIGMA] * len(seen),
        }
        write_columns(path, columns)
        return path


def _where(read: Array, values: Array) -> list:
    return [value if here else "" for value, here in zip(values.tolist(), read, strict=True)]


def at_random(arm: Arm, count: int, seed: int) -> Stops:
    """Return poses spread evenly over the joint limits, payloads and sides at random."""
    rng = np.random.default_rng([seed, 79])
    q = rng.uniform(arm.robot.lower, arm.robot.upper, (count, len(arm.joint_names)))
    return Stops(q, rng.integers(0, len(arm.payloads), count), rng.choice((-1.0, 1.0), q.shape), np.ones(count, bool))


def as_planned(arm: Arm, rows: Measurements) -> Stops:
    """Return what a table of planned rows says, as its reader has it."""
    names = list(arm.payloads)
    approach = np.where(rows.approach == 0.0, 1.0, rows.approach)
    read = np.array([not name.startswith("to ") for name in rows.pose])
    return Stops(rows.q, np.array([names.index(name) for name in rows.payload]), approach, read)


@cache
def declared(name: str) -> Arm:
    """Return a declared arm."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.toml"
        path.write_text(declared_text(name))
        return load_arm(path)


def written(arm: Arm, found: Plan, folder: Path) -> Stops:
    """Write a plan and read it again, as somebody would who drives it."""
    return as_planned(arm, read_measurements(write_plan(found, folder / "poses.csv"), arm, inputs_only=True))


@dataclass(frozen=True)
class Came:
    """What came of a campaign.

    Attributes:
        certainty: Geometric mean of the standard deviations of the arm's parameters over their priors.
        stated, error: Uncertainty and true error of predicted readings, both RMS in 3-D [m].
    """

    certainty: float
    stated: float
    error: float


def outcome(machine: Machine, stops: Stops, judged: Stops, seed: int, folder: Path) -> Came:
    """Calibrate with a campaign; predict readings at stops that were not measured."""
    arm = declared(machine.arm)
    found = calibrate(arm, read_measurements(machine.measure(folder / "m.csv", stops, seed), arm))
    asked = read_measurements(machine.measure(folder / "judged.csv", judged, 0), arm)
    there = predict(found.arm, asked)
    error = np.sqrt(((there.position - machine.places(judged)) ** 2).sum(axis=1).mean())
    places = [i for i, (block, _) in enumerate(found.fit.labels) if block in ("joint_offset", "compliance")]
    prior = found.fit.prior[places]
    # At stated noise: chance scatters readings, too.
    known = LinearGaussian.of(found.fit.regressors, found.fit.precision).covariance
    block = known[np.ix_(places, places)] / np.outer(prior, prior)
    mean = np.exp(0.5 * np.linalg.slogdet(block)[1] / len(places))
    return Came(float(mean), float(np.sqrt((there.sigma**2).sum(axis=1).mean())), float(error))


def way(arm: Arm, seed: int = 0) -> Stops:
    """Return 40 stops on straight ways between four poses, carrying the heaviest payload."""
    corners = at_random(arm, 4, 20_000 + seed).q
    q = np.array([np.interp(np.linspace(0.0, 3.0, 40), range(4), column) for column in corners.T]).T
    heaviest = int(np.argmax([payload.mass for payload in arm.payloads.values()]))
    return Stops(q, np.full(40, heaviest), np.ones(q.shape), np.ones(40, bool))


def as_trajectory(arm: Arm, stops: Stops) -> Trajectory:
    names, count = list(arm.payloads), len(stops.q)
    payload = tuple(names[k] for k in stops.payload)
    return Trajectory(arm.joint_names, np.arange(float(count)), stops.q, payload, ("",) * count)


def certainty_study(
    name: str, count: int, machines: int, factors: Sequence[float], along: bool = False
) -> dict[float, Came]:
    """Return the geometric mean over machines of what came of `factor * count` random poses, of a plan at factor 0.

    What is judged are predictions on a way that the plan is for, else anywhere.
    """
    arm = declared(name)
    judged = way(arm) if along else at_random(arm, 150, 10_000)
    found = plan(arm, count, sigma=SIGMA, along=as_trajectory(arm, judged) if along else None)
    results: dict[float, list[Came]] = {}
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        planned = written(arm, found, folder)
        for seed in range(machines):
            machine = Machine.draw(name, seed)
            for factor in (0.0, *factors):
                stops = at_random(arm, round(factor * count), seed) if factor else planned
                results.setdefault(factor, []).append(outcome(machine, stops, judged, seed, folder))
    return {factor: _mean(came) for factor, came in results.items()}


def _mean(found: Sequence[Came]) -> Came:
    columns = zip(*(vars(came).values() for came in found), strict=True)
    return Came(*(float(np.exp(np.mean(np.log(values)))) for values in columns))


def hidden(machine: Machine, name: str, size: Sequence[float]) -> Hidden:
    """Return what pushes at the machine for an effect as it is spelled, with its law's values."""
    law, site = name.split(":")[:2]
    i = next(i for i, joint in enumerate(machine.plant.joints) if joint.name == site)
    joint = machine.plant.joints[i]
    turns: dict[str, Callable[[State], Array]] = {
        "backlash": lambda state: 0.5 * size[0] * state.rows.approach[:, i],
        "encoder_scale": lambda state: size[0] * state.rows.q[:, i],
        "encoder_eccentricity": lambda state: (
            size[0] * np.sin(state.rows.q[:, i]) + size[1] * np.cos(state.rows.q[:, i])
        ),
    }
    if law == "stiffening":
        return lambda state, push: _stiffen(state, push, i, AXES.index(name.split(":")[2]), size)

    def act(state: State, push: Push) -> None:
        push.motion[:, i] += turns[law](state)[:, None] * joint.drive

    return act


def _stiffen(state: State, push: Push, i: int, axis: int, size: Sequence[float]) -> None:
    tau = state.wrenches[:, i, axis]
    push.flexure[:, i, axis] += size[0] * tau * np.abs(tau) + size[1] * tau**3


def apart(arm: Arm, campaign: Measurements, true: str, false: str) -> float:
    """Return -2 log odds of the wrong effect against the true one, both fitted: the more, the surer."""
    costs = []
    for name in (true, false):
        rows = np.flatnonzero(campaign.measured)
        setup, _ = first_guess(arm, campaign, rows)
        view = look(setup, campaign)
        effect = named_effect(name, arm, ())
        prior = amplitude_prior(effect, (), view, view.context)
        blocks = (*declared_blocks(setup, campaign), EffectBlock(effect, (), view.context, 0, prior))
        costs.append(fit(setup, blocks, campaign, rows).cost(1e9))
    return costs[1] - costs[0]


def rival_study(
    name: str, pair: tuple[str, str], count: int, machines: int, share: float = 0.5, factor: int = 3
) -> tuple[Array, Array]:
    """Return (machines, 2) -2 log odds with a plan, and with `factor` times as many random rows.

    Either effect of the pair in turn is the true one, `share` times as large as the plan takes it to be.
    """
    arm = declared(name)
    found = plan(arm, count, between=pair, sigma=SIGMA)
    planned, at_chance = np.zeros((2, machines, 2))
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        stops = written(arm, found, folder)
        for seed in range(machines):
            machine = Machine.draw(name, seed)
            for which, hypothesis in enumerate(found.hypotheses):
                push = hidden(machine, hypothesis.name, share * hypothesis.size)
                names = hypothesis.name, found.hypotheses[1 - which].name
                for told, rows in ((planned, stops), (at_chance, at_random(arm, factor * count, seed))):
                    path = machine.measure(folder / "m.csv", rows, seed, [push])
                    told[seed, which] = apart(arm, read_measurements(path, arm), *names)
    return planned, at_chance


PAIRS = (
    ("boom", ("encoder_scale:A4", "encoder_eccentricity:A4")),
    ("boom", ("encoder_scale:A2", "stiffening:A2:ry")),
    ("six", ("encoder_scale:J2", "stiffening:J2:ry")),
    ("six", ("encoder_scale:J3", "encoder_eccentricity:J3")),
    ("six", ("backlash:J2", "backlash:J3")),
)
"""Hypotheses; poses at random tell the last pair easily."""


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--machines", type=int, default=6)
    machines = options.parse_args().machines
    for name, count, along in (("boom", 20, 0), ("six", 20, 0), ("boom", 12, 0), ("boom", 20, 1), ("six", 20, 1)):
        print(
            f"{name}, {count} readings planned for {'a path' if along else 'parameters'}, mean of {machines} machines"
        )
        for factor, came in certainty_study(name, count, machines, (1, 1.5, 2, 2.5, 3), bool(along)).items():
            title = f"random, {factor:g} times as many" if factor else "planned"
            stated, error = came.stated * 1e3, came.error * 1e3
            print(f"  {title:27} {came.certainty:.3f} of the prior, stated {stated:.3f} mm, true {error:.3f} mm")
    for name, pair in PAIRS:
        told = rival_study(name, pair, 12, machines)
        print(
            f"{name} {' / '.join(pair)}: -2 log odds, mean of {machines} machines, of the truth that is harder to see"
        )
        for title, odds in zip(("12 planned", "36 random"), told, strict=True):
            print(f"  {title:12} {odds.mean(axis=0).min():6.1f}, right in {np.mean(odds > 0.0):.0%}")


if __name__ == "__main__":
    main()
