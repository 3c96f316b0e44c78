"""Campaigns of arms some of whose joints follow laws that nobody declared: stiffening, yielding, even in the load."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from support.campaign_files import ARMS, declared_text, write_rows
from support.campaigns import SIGMA, Drawn, draw, read
from support.plant import Array, Push, State

CORNER = 0.45  # of the travel of either joint that is never visited
SHARE = 0.25  # of the linear twist under a typical load
SHAPES: dict[str, Callable[[Array, Array], Array]] = {
    "yields": lambda z, other: np.tanh(1.5 * z),
    "stiffens": lambda z, other: -z * np.abs(z) / 1.5,
    "contact": lambda z, other: np.sqrt(z**2 + other**2),
    "coupled": lambda z, other: z * other,
}


@dataclass
class Bent:
    """A drawn campaign and the true laws of two of its joints."""

    drawn: Drawn
    joints: tuple[str, str]
    axes: tuple[int, int]
    shapes: tuple[str, str]
    scale: Array  # (joints, 6) typical loads

    def beyond_linear(self, name: str, wrench: Array) -> Array:
        """What a joint does beyond its declared compliance under (N, 6) loads."""
        plant, twist = self.drawn.plant, np.zeros_like(wrench)
        for joint, axis, shape in zip(self.joints, self.axes, self.shapes, strict=True):
            if joint == name:
                i = [j.name for j in plant.joints].index(joint)
                other = {3: 4, 4: 3, 5: 4}[axis]
                z, across = wrench[:, axis] / self.scale[i, axis], wrench[:, other] / max(self.scale[i, other], 1e-9)
                size = SHARE * plant.compliance[joint][axis, axis] * self.scale[i, axis]
                twist[:, axis] = size * SHAPES[shape](z, across)
        return twist

    def act(self, state: State, push: Push) -> None:
        """Add it at the flexures."""
        for i, joint in enumerate(self.drawn.plant.joints):
            if joint.name in self.joints:
                push.flexure[:, i] += self.beyond_linear(joint.name, state.wrenches[:, i])

    def twist(self, name: str, wrench: Array) -> Array:
        """The true (N, 6) twist of a joint under (N, 6) loads."""
        return wrench @ self.drawn.plant.compliance[name].T + self.beyond_linear(name, wrench)

    def state(self) -> State:
        """The arm at every stop."""
        return self.drawn.plant.relax(self.drawn.rows, (self.act,))

    def carrying(self, number: int) -> Array:
        """Stops with the payload of this number; the heaviest is the last."""
        return self.drawn.rows.payload == number

    def corner(self) -> Array:
        """Stops in one corner of the travel of the two joints that carry the tip furthest."""
        q, frames = self.drawn.rows.q, self.state().frames
        lever = np.linalg.norm(frames[:, -1, None, :3, 3] - frames[:, :-1, :3, 3], axis=2).mean(axis=0)
        slides = np.array([joint.kind == "prismatic" for joint in self.drawn.plant.joints])
        low, travel = q.min(axis=0), np.ptp(q, axis=0)
        far = np.argsort(-travel * np.where(slides, 1.0, lever))[:2]
        share = ((q - low) / travel)[:, far]
        upper = np.random.default_rng([self.drawn.seed, 5]).random(2) < 0.5
        return (np.where(upper, share, 1.0 - share) > 1.0 - CORNER).all(axis=1)

    def write(self, folder: Path, model: str, unseen: Array | None = None) -> Path:
        """Write arm.toml that learns the bent joints as `model`, train.csv, test.csv and unseen.csv; return the arm.

        The stops in `unseen` are read in unseen.csv alone.
        """
        folder.mkdir(parents=True, exist_ok=True)
        drawn, names = self.drawn, [joint.name for joint in self.drawn.plant.joints]
        payloads = [name for name, _, _ in ARMS[drawn.arm].payloads]
        seen = read(drawn.plant, self.state(), drawn.station, drawn.shifts) + drawn.errors
        away = np.zeros(len(seen), bool) if unseen is None else unseen
        for name, shown in (
            ("train", drawn.rows.measured & ~away),
            ("test", drawn.rows.held_out & ~away),
            ("unseen", away & (drawn.rows.measured | drawn.rows.held_out)),
        ):
            write_rows(folder / f"{name}.csv", drawn.rows, names, payloads, seen, shown, SIGMA)
        learned = "|".join(self.joints)
        pattern = rf'(\[flexure\.(?:{learned})\]\njoint = "\w+"\n)model = "linear"\n'
        change = f'\\1model = "{model}"\nlearn = true\n'
        text = re.sub(pattern, change, declared_text(drawn.arm)) if model != "none" else declared_text(drawn.arm)
        (folder / "arm.toml").write_text(text)
        return folder / "arm.toml"


def bent(seed: int, arm: str = "boom") -> Bent:
    """Draw a campaign and two bent joints by seed: axes that matter to the tip, shapes of every kind in turn."""
    drawn, rng = draw("none", seed, arm), np.random.default_rng(seed)
    plant = drawn.plant
    calm = plant.relax(drawn.rows)
    scale = np.sqrt((calm.wrenches**2).mean(axis=0))
    turn = np.array([np.diag(plant.compliance[joint.name])[3:] for joint in plant.joints]) * scale[:, 3:]
    reach = np.linalg.norm(calm.frames[:, -1, None, :3, 3] - calm.frames[:, :-1, :3, 3], axis=2).mean(axis=0)
    moves = turn * reach[:, None]
    loudest = [(int(i), int(moves[i].argmax()) + 3) for i in np.argsort(-moves.max(axis=1))[:4]]
    (i, a), (j, b) = (loudest[k] for k in rng.choice(len(loudest), 2, replace=False))
    shapes = tuple(str(s) for s in rng.choice(list(SHAPES), 2, replace=False))
    return Bent(drawn, (plant.joints[i].name, plant.joints[j].name), (a, b), shapes, scale)
