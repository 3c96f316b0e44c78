"""What `trace` makes of a cause that no law of the catalogue has the shape of.

    python tests/studies/outside.py [--seed 61000] [--draws 12] [--only KIND ...]

Machines of the plant hide one effect each of `support.undeclared_beyond`. Prints of each machine what is named, and of
each kind on how many a law of the catalogue is named at 0.9 and more at another place than the cause's, how far poses
that were held out are off by the traced and by the calibrated arm, and the share of their coordinates within 1.96 of
their stated standard deviation.
"""

import argparse
import sys
import tempfile
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from support.campaigns import draw
from support.scoring import Score, judge, mark_of
from support.undeclared_beyond import BEYOND

from armflex import load_arm, read_measurements, trace
from armflex.errors import ArmflexError

SURE = 0.9
FRAMES = {"session_frame", "base_drift", "instrument_moved", "tracker_scale", "refraction"}
"""What is said of an instrument, which is no cause elsewhere where it is the instrument that errs."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=61000)
    parser.add_argument("--draws", type=int, default=12)
    parser.add_argument("--only", nargs="*", default=[*BEYOND], choices=[*BEYOND])
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    counts: dict[str, list[tuple[bool, float, float]]] = {kind: [] for kind in asked.only}
    for number in range(asked.draws):
        for kind in asked.only:
            arm = ("boom", "six")[number % 2]
            result = Score(kind, asked.seed + number, arm, 1.0)
            try:
                with tempfile.TemporaryDirectory() as folder:
                    drawn = draw(kind, asked.seed + number, arm=arm)
                    truth = drawn.write(Path(folder))
                    declared = load_arm(truth.arm)
                    account = trace(declared, read_measurements(truth.train, declared))
                    judge(result, drawn, truth, account)
            except ArmflexError as error:
                print(f"{kind:18s} {arm:4s} {type(error).__name__}: {error}", flush=True)
                continue
            site = truth.effects[0].site
            sure = [found.effect for found in account.found if found.probability >= SURE and found.effect.law.physical]
            there = [FRAMES.intersection([e.law.name]) if site == "instrument" else mark_of(e)[1] == site for e in sure]
            ratio = result.after / result.before
            counts[kind].append((not all(there), ratio, result.within))
            text = "; ".join(f"{found.effect.title} {found.probability:.2f}" for found in account.found) or "no name"
            held = f"{result.before:.3f} -> {result.after:.3f} mm of {result.floor:.3f}, {result.within:.0%} inside"
            print(f"{kind:18s} {arm:4s} at {site}: {text}; {held}{'' if all(there) else ' ELSEWHERE'}", flush=True)
    for kind, machines in counts.items():
        if machines:
            elsewhere, ratios, inside = (np.array(values) for values in zip(*machines, strict=True))
            print(
                f"{kind:18s} {len(machines):3d} machines: a cause elsewhere at {SURE} on {elsewhere.sum()}, held-out "
                f"error over the calibrated arm's {np.median(ratios):.2f} (median), {ratios.max():.2f} (worst), "
                f"{inside.mean():.1%} inside (least {inside.min():.1%})"
            )


if __name__ == "__main__":
    main()
