"""How often the kinds of effect that `trace` states are right, on machines of the plant.

    python tests/studies/kinds.py [--seed 8000] [--draws 1] [--empty 40]

Each kind of effect of the plant is hidden alone in so many machines, and nothing in `--empty` more. A kind that is
stated is right where the hidden effect is one of its laws (`OF`). Prints a line for each machine and the counts.
"""

import argparse
import sys
import tempfile
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.campaigns import KINDS, NULLS, draw

from armflex import calibrate, load_arm, read_measurements
from armflex.errors import ArmflexError
from armflex.trace.families import Families
from armflex.trace.state import begin

STRONG = 10.0

OF = {
    "scale of the encoders": ("encoder_scale", "dress_pack"),
    "eccentricity of the encoders": ("encoder_eccentricity",),
    "curve of the drives": ("encoder_scale", "encoder_eccentricity", "gear_harmonic", "dress_pack"),
    "play by approach": ("backlash", "friction_windup"),
    "friction wind-up": ("friction_windup", "backlash"),
    "hysteresis": ("hysteresis", "deadband", "backlash", "friction_windup"),
    "play by load": ("deadband", "stiffening", "hysteresis", "friction_windup", "even_in_load"),
    "compliance": ("compliance", "cross_coupling", "base_compliance", "link_flexure", "stiffening", "link_mass",
                   "payload_mass", "payload_com", "tip_force"),
    "compliance by position": ("position_dependent_compliance", "dress_pack", "umbilical", "even_in_load"),
    "compliance by temperature": ("thermal_softening",),
    "compliance by hold": ("creep",),
    "compliance by payload_mass": ("payload_mass", "payload_com", "stiffening", "even_in_load"),
    "by payload_mass": ("payload_mass", "payload_com", "even_in_load", "deadband"),
    "by temperature": ("thermal_growth", "thermal_bending", "base_thermal"),
    "wandering of the instrument": ("base_drift", "session_frame", "base_thermal", "tool_shift"),
    "wandering of the drives": ("slip_step",),
}  # fmt: skip
"""Laws that a kind is made of, or that show themselves as it: a load that is not declared is a compliance."""


def stated(kind: str, seed: int, arm: str) -> Families:
    """Return the kinds that are stated of a machine with a hidden effect."""
    with tempfile.TemporaryDirectory() as folder:
        files = draw(kind, seed, arm).write(Path(folder))
        declared = load_arm(files.arm)
        state = begin(calibrate(declared, read_measurements(files.train, declared), as_stated=True))
    return state.sized.families


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=8000)
    parser.add_argument("--draws", type=int, default=1, help="machines for each kind of effect")
    parser.add_argument("--empty", type=int, default=40, help="machines of which nothing is hidden")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    drawn = [kind for kind in KINDS for _ in range(asked.draws)] + [NULLS[i % len(NULLS)] for i in range(asked.empty)]
    right, strong, empty, machines, better = 0, 0, 0, 0, 0
    for number, kind in enumerate(drawn):
        try:
            families = stated(kind, asked.seed + number, ("boom", "six")[number % 2])
        except ArmflexError as error:
            print(f"{kind:30s} {type(error).__name__}: {error}", flush=True)
            continue
        before, after = families.held_out
        machines, better = machines + 1, better + (after <= 1.02 * before)
        text = "; ".join(f"{family.name} {family.evidence:.0f} at {family.places[0].site}" for family in families.found)
        print(f"{kind:30s} {1e3 * before:7.3f} -> {1e3 * after:7.3f} mm  {text}", flush=True)
        if kind in NULLS:
            empty += bool(families.found)
            continue
        for family in families.found:
            if family.evidence >= STRONG:
                strong, right = strong + 1, right + (kind in OF.get(family.name, ()))
    print(f"{right} of {strong} kinds stated with {STRONG:g} nats and more hold the hidden effect")
    print(f"{empty} of {sum(kind in NULLS for kind in drawn)} empty machines have a kind stated")
    print(f"held-out error at most 2 % above that of the calibrated arm on {better} of {machines} machines")


if __name__ == "__main__":
    main()
