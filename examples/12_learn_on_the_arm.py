"""A mast that gives as nobody declared, learned from readings of the tip alone, and the picture of its law."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import armflex
from armflex.laws import LinearLaw, Row
from armflex.laws.law import WithoutParameters

FOLDER = armflex.bundled_robot("tarm_like")
NOISE = 2e-4  # m per axis


class Yielding(WithoutParameters):
    """What the machine has: guides with play, which tilt under small moments and hold under large ones."""

    def __init__(self, linear: LinearLaw):
        self.linear = linear

    def twist(self, wrench: np.ndarray, row: Row) -> np.ndarray:
        twist = self.linear.twist(wrench, row).copy()
        twist[..., 3] += 1e-3 * np.tanh(wrench[..., 3] / 4e4)
        return twist

    def tangent(self, wrench: np.ndarray, row: Row) -> np.ndarray:
        tangent = np.broadcast_to(self.linear.tangent(wrench, row), (*wrench.shape, 6)).copy()
        tangent[..., 3, 3] += 1e-3 / 4e4 / np.cosh(wrench[..., 3] / 4e4) ** 2
        return tangent


def measured(declared: armflex.Arm, table: str, seed: int) -> armflex.Measurements:
    """Drive the machine through the rows of a table and read its tip; the bundled readings are another machine's."""
    flexures = [replace(f, law=Yielding(f.law)) if f.name == "M1" else f for f in declared.flexures]
    rows = armflex.read_measurements(FOLDER / table, declared)
    read = armflex.predict(replace(declared, flexures=tuple(flexures)), rows).position
    noise = np.random.default_rng(seed).normal(0.0, NOISE, read.shape)
    return replace(rows, position=np.where(rows.measured[:, None], read + noise, np.nan))


def arms(folder: Path) -> tuple[armflex.Arm, armflex.Arm]:
    """Return the arm as declared, and with a line in its file that has the mast's law learned."""
    text = (FOLDER / "measured.toml").read_text().replace('"robot.urdf"', f'"{(FOLDER / "robot.urdf").as_posix()}"')
    file = folder / "learn.toml"
    file.write_text(text.replace('joint = "M1"\nmodel = "linear"', 'joint = "M1"\nmodel = "polynomial"\nlearn = true'))
    return armflex.load_arm(FOLDER / "measured.toml"), armflex.load_arm(file)


def away(found: armflex.Arm, held_out: armflex.Measurements) -> np.ndarray:
    """Return the (M, 3) errors [m] on rows that were not used."""
    return (armflex.predict(found, held_out).position - held_out.position)[held_out.measured]


def main(folder: str = ".") -> tuple[float, float]:
    declared, learning = arms(Path(folder))
    campaign, held_out = measured(declared, "campaign.csv", 0), measured(declared, "held_out.csv", 1)

    errors = []
    for arm in (declared, learning):
        found = armflex.calibrate(arm, campaign).arm
        errors.append(float(np.sqrt((away(found, held_out) ** 2).sum(axis=1).mean())) / (np.sqrt(3.0) * NOISE))
    print(f"error on held-out poses, over the noise: not learned {errors[0]:.2f}, learned {errors[1]:.2f}")
    armflex.draw_laws(found, Path(folder) / "laws.png")
    return errors[0], errors[1]


if __name__ == "__main__":
    main(*sys.argv[1:2])
