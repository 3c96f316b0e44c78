"""Compare a traced arm's error at other poses with what the same fit leaves when it knows what was hidden.

    python tests/studies/declared.py several.csv

The CSV is of `study.py`. Every machine in it is drawn again, and fitted with those candidates alone that its hidden
effects are: nothing else can be selected, and values inside laws are refined as ever.
"""

import sys
import tempfile
import warnings
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from unittest.mock import patch

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from study import read_scores
from support.campaigns import draw
from support.scoring import Score, is_named

import armflex
from armflex.estimate.calibrate import calibrate
from armflex.measured.joined import as_campaign

search, state, account, known = (
    import_module(f"armflex.trace.{n}") for n in ("search", "state", "account", "hypotheses")
)


def declared(one: Score) -> float:
    """Return the RMS error at the other poses of a machine of which the hidden effects are known [mm]."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        truth = draw(one.kind, one.seed, arm=one.arm, size=one.size).write(Path(folder))
        arm = armflex.load_arm(truth.arm)

        def hidden(context):
            every = known.hypotheses(context)
            pairs = [(each, each.one.effect(np.ones(len(each.one.location.terms)))) for each in every]
            return [each for each, effect in pairs if any(is_named(e, effect) for e in truth.effects)]

        with patch.object(search, "hypotheses", hidden), patch.object(search, "families", lambda view, context: []):
            rows = as_campaign(armflex.read_measurements(truth.train, arm), arm)
            here = after = search.standing(state.begin(calibrate(arm, rows, as_stated=True)))
            while after is not None:
                here, after = after, search._more_probable(after)
            fitted = account.settled_exactly(here).state.fit
        setup, rows = fitted.setup, armflex.read_measurements(truth.test, arm)
        believed = rows.measured & ~truth.lost
        errors = armflex.predict(replace(setup.arm, instrument=setup.instrument), rows).position - rows.position
        return 1e3 * float(np.sqrt((errors[believed] ** 2).sum(axis=1).mean()))


def main(path: str) -> None:
    ratios = []
    for one in read_scores(Path(path)):
        if one.truth and one.verdict not in ("ERROR", "hidden"):
            ratios.append(one.after / declared(one))
            print(f"{one.kind} {one.seed} {one.arm}: {ratios[-1]:.4f}", flush=True)
    print(f"{len(ratios)} machines: median {np.median(ratios):.4f}, worst {max(ratios):.4f}")


if __name__ == "__main__":
    main(sys.argv[1])
