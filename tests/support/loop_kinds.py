"""A machine with everything: two loops in chain, closed in every way, pins that give, a cylinder and a spring on
passive joints, and what gives across their axes.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import armflex
from support.machines import UNEVEN, Hinge, Machine, X, Y, Z

PAYLOAD = 120.0
MACHINE = Machine(
    hinges={
        **UNEVEN.hinges,
        "crank": Hinge("column", "crank", (0.21, 0.0, 0.31), Y),
        "eye": Hinge("fore", "eye", (-0.42, 0.0, 0.01), Y, passive=True),
        "wrist": Hinge("fore", "hand", (1.2, 0.0, 0.0), Y, passive=True),
        "bell": Hinge("arm", "bell", (0.0, 0.05, 1.1), Y, passive=True),
        "stay": Hinge("column", "stay", (0.02, 0.05, 0.42), Y, passive=True),
    },
    bodies={
        **UNEVEN.bodies,
        "eye": (2.0, (0.0, 0.0, 0.05)),
        "hand": (35.0, (0.1, 0.02, -0.1)),
        "bell": (6.0, (0.05, 0.0, 0.1)),
        "stay": (9.0, (0.0, 0.0, 0.5)),
    },
    gives={**UNEVEN.gives, "elbow": (X, 8e5), "wrist": (Z, 4e5), "foot": (X, 3e6)},
    loops={
        "tail": ("rod", (0.01, -0.03, 1.13), "eye", (0.0, 0.0, 0.0), None),
        "level": ("stay", (0.0, 0.0, 1.12), "bell", (-0.21, 0.0, 0.1), Y),
    },
    cylinders={"tie": ("bell", (0.05, 0.0, 0.21), "hand", (-0.03, 0.04, 0.2), 9e6, 0.9, 1.5)},
    springs=UNEVEN.springs,
    tool=("hand", (0.3, 0.1, -0.1)),
)
"""A palletizing arm, not quite parallel, whose wrist is kept level by a second loop and a cylinder."""


@dataclass(frozen=True)
class Closed:
    """How the first loop is closed: its kind, what its pin gives, and whether the rod's eye turns by itself."""

    kind: str
    gives: tuple[float, ...] = (0.0,) * 6
    eye: bool = False


CLOSED = {
    "revolute": Closed("revolute"),
    "revolute, gives": Closed("revolute", (2e-8, 3e-8, 1e-8, 1e-7, 0.0, 2e-7)),
    "spherical": Closed("spherical"),
    "spherical, gives": Closed("spherical", (2e-8, 3e-8, 1e-8, 0.0, 0.0, 0.0)),
    "cylindrical": Closed("cylindrical"),
    "cylindrical, gives": Closed("cylindrical", (2e-8, 0.0, 1e-8, 1e-7, 0.0, 2e-7)),
    "fixed": Closed("fixed", eye=True),
    "fixed, gives": Closed("fixed", (2e-8, 3e-8, 1e-8, 1e-7, 2e-7, 2e-7), eye=True),
}


def built(closed: Closed, folder: Path) -> tuple[Machine, armflex.Arm]:
    """Return the machine closed in a way, and as armflex reads it."""
    machine, at = MACHINE, ("eye", (0.0, 0.0, 0.0))
    if not closed.eye:
        hinges, bodies = ({k: v for k, v in one.items() if k != "eye"} for one in (machine.hinges, machine.bodies))
        at = ("fore", MACHINE.hinges["eye"].place)
        machine = replace(machine, hinges=hinges, bodies=bodies)
    machine = replace(machine, loops={**machine.loops, "tail": (*machine.loops["tail"][:2], *at, None)})
    machine.load(folder)
    axis = "" if closed.kind in ("spherical", "fixed") else "axis = [0.0, 1.0, 0.0]\n"
    compliance = f"compliance = {list(closed.gives)}\n" if any(closed.gives) else ""
    file = folder / "arm.toml"
    text = file.read_text().replace('kind = "spherical"', f'kind = "{closed.kind}"\n{axis}{compliance}', 1)
    file.write_text(f"{text}\n[payload.p]\nmass = {PAYLOAD}\ncom = [0.0, 0.0, 0.0]\n")
    return machine, armflex.load_arm(file)
