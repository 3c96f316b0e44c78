"""A4 from its sub-joints, as in the source paper's equations (1) to (6), against finite elements of the whole joint.

    python compose.py FOLDER

Both rings follow the law that was learned on the upper one alone, from forces to shifts of its node; fork arms are
beams, ended by stiff ones where the solids of the whole end in one body. The drive at the lower ring is linear.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import armflex
from armflex.laws.joint.beam import Beam, Section
from armflex.laws.joint.linear import LinearLaw
from armflex.laws.joint.structural import StructuralLaw, SubJoint
from armflex.laws.law import NOWHERE

sys.path.insert(0, str(Path(__file__).parents[1]))

from boom.structures import BEARINGS, REACH, SPAN

ARM = Section(E=2.1e11, G=8.1e10, A=0.06, Iy=2e-4, Iz=4.5e-4, J=4.7e-4)
STIFF = Section(E=2.1e13, G=8.1e12, A=0.06, Iy=2e-3, Iz=2e-3, J=2e-3)


def composed(folder: Path) -> StructuralLaw:
    """Return A4 of two rings, two arms and a drive."""
    ring = armflex.load_law(folder / "A4_upper.safetensors").law
    turns = LinearLaw(np.diag([0.0, 0.0, 0.0, 0.0, 0.0, 1.0 / BEARINGS["A4"].stiffness]))
    nodes = {"1": (0.0, 0.0, SPAN), "2": (0.0, 0.0, -SPAN), "3": (REACH, 0.0, 0.0)}
    nodes |= {"over": (REACH, 0.0, SPAN), "under": (REACH, 0.0, -SPAN)}
    up = np.array([0.0, 1.0, 0.0])
    beams = [Beam("1", "over", ARM, np.array([0.0, 0.0, 1.0])), Beam("2", "under", ARM, np.array([0.0, 0.0, 1.0]))]
    beams += [Beam("over", "3", STIFF, up), Beam("under", "3", STIFF, up)]
    held = (SubJoint("1", ring, (0, 1, 2)), SubJoint("2", ring, (0, 1, 2)), SubJoint("2", turns, (5,)))
    return StructuralLaw({name: np.array(place) for name, place in nodes.items()}, "3", held, tuple(beams))


def main(folder: Path) -> np.ndarray:
    """Print the RMS of the difference on new loads, and of the deflections themselves [mm, mrad]."""
    rows = np.loadtxt(folder / "A4_new.csv", delimiter=",", skiprows=1)
    law = composed(folder)
    apart = np.array([1e3 * law.twist(load, NOWHERE) for load in rows[:, :6]]) - rows[:, 6:]
    for name, values in (("difference", apart), ("deflection", rows[:, 6:])):
        print(f"{name:12}", *(f"{x:.4g}" for x in np.sqrt((values**2).mean(axis=0))))
    return np.sqrt((apart**2).mean(axis=0))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
