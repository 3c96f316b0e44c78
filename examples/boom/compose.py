"""A4 from its sub-joints, as in the source paper's equations (1) to (6), against finite elements of the whole joint.

    python compose.py FOLDER

Both rings follow one law, learned on a ring alone (table A4_ring), and nodes translate and turn; fork arms are meshes.
The upper ring has no drive: it turns freely.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

import armflex
from armflex.laws.joint.beam import MeshedBeam
from armflex.laws.joint.structural import StructuralLaw, SubJoint
from armflex.laws.law import NOWHERE

sys.path.insert(0, str(Path(__file__).parents[1]))

from boom.structures import REACH, SPAN
from boom.tables import solved


def composed(folder: Path) -> StructuralLaw:
    """Return A4 of two rings and two arms."""
    ring = armflex.load_law(folder / "A4_ring.safetensors").law
    unit = 100.0  # N and Nm: small enough for the arm to be linear
    arm = solved("A4_arm", unit * np.eye(6)).twists.T / unit  # at the origin of its ring
    nodes, beams = {"3": np.array([REACH, 0.0, 0.0])}, []
    for name, z in (("1", SPAN), ("2", -SPAN)):
        nodes[name] = np.array([0.0, 0.0, z])
        there = pin.SE3(np.eye(3), nodes[name] - nodes["3"]).action
        beams.append(MeshedBeam(name, "3", there @ (0.5 * (arm + arm.T)) @ there.T))
    held = (SubJoint("1", ring, (0, 1, 2, 3, 4)), SubJoint("2", ring))
    return StructuralLaw(nodes, "3", held, tuple(beams))


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
