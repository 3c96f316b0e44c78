"""Tracing with orientations, read in some rows: what counts as a reading, and nothing where nothing is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.campaigns import draw
from support.stage import few

from armflex import calibrate, load_arm, read_measurements, trace
from armflex.trace.projection import Projection, project
from armflex.trace.state import State, begin
from armflex.trace.unrecorded import localise, noticed_from

pytestmark = pytest.mark.slow

SIGMA = 2e-5  # rad


def campaign(folder: Path, kind: str, seed: int, arm: str, share: float = 0.75, every: int = 1) -> tuple:
    """Return what was drawn, the declared arm, and its campaign, every so manieth reading of it, with orientations."""
    drawn = draw(kind, seed, arm)
    truth = drawn.write(folder, every)
    declared = load_arm(truth.arm)
    rows = read_measurements(truth.train, declared)
    turns, read = drawn.orientations(SIGMA, share)
    read &= rows.measured
    rotation, spread = np.where(read[:, None], turns, 0.0), np.where(read, SIGMA, np.inf)
    return truth, declared, replace(rows, rotation=rotation, sigma_r=spread)


# What the positions' noise is over the stated one says nothing of the orientations'.
@pytest.mark.parametrize(("kind", "arm"), [("none_noisier", "six"), ("none_quieter", "boom")])
def test_nothing_is_found_where_one_kind_of_reading_is_worse_than_stated(tmp_path, kind, arm):
    _, declared, rows = campaign(tmp_path, kind, 10, arm, every=3)
    found = trace(declared, rows)
    # Above one half there is a name; an even chance of nothing is no certainty.
    assert all(named.probability < 0.75 for named in found.found) and found.unexplained is None


def test_the_right_effect_alone_is_found(tmp_path):
    truth, declared, rows = campaign(tmp_path, "backlash", 1, "six", every=3)
    (one,) = trace(declared, rows).found
    true = truth.effects[0]
    assert (one.effect.law.name, one.effect.location.site, one.effect.location.axis) == (
        "backlash",
        true.site,
        true.axis,
    )
    assert abs(one.effect.named["gap"] - true.parameters["gap"]) < 4.0 * one.std["gap"]


@pytest.fixture(scope="module")
def state(tmp_path_factory) -> State:
    _, declared, rows = campaign(tmp_path_factory.mktemp("quiet"), "none", 1, "six", 0.25)
    some = np.flatnonzero(rows.measured)[::2]
    return begin(
        calibrate(declared, replace(few(rows, some), rotation=rows.rotation[some], sigma_r=rows.sigma_r[some]))
    )


def noisy(state: State, positions: float, orientations: float) -> Projection:
    """Return the same problem with nothing but noise in it, of these sizes over the stated ones."""
    fit, known = state.fit, project(state.fit)
    noise = np.random.default_rng(5).normal(size=fit.view.sigma.shape) * np.repeat([positions, orientations], 3)
    noise = np.where(np.isfinite(fit.view.sigma), noise, 0.0).ravel()
    return Projection(known.regressors, known.precision, noise, known.count)


@pytest.mark.parametrize(("positions", "orientations"), [(1.0, 1.0), (2.0, 1.0), (0.5, 1.0), (1.0, 3.0)])
def test_noise_of_any_size_is_nowhere(state, positions, orientations):
    places = localise(state.fit, state.context, noisy(state, positions, orientations), state.groups)
    assert places[0].ratio < noticed_from(len(places))
