"""Which kinds of effect a calibrated arm lacks, on machines of the plant: the hidden kind at its joint, no other."""

from dataclasses import replace

import numpy as np
import pytest
from support import six_axes
from support.campaigns import draw

from armflex import calibrate, load_arm, read_measurements, trace
from armflex.readings import Readings
from armflex.trace.families import Families
from armflex.trace.state import State, begin

STRONG = 10.0


def calibrated(tmp_path, kind: str, seed: int, arm: str) -> tuple[State, str]:
    """Return a calibrated machine of which an effect of a kind is hidden, and the joint at which it is."""
    drawn = draw(kind, seed, arm)
    files = drawn.write(tmp_path)
    arm_read = load_arm(files.arm)
    state = begin(calibrate(arm_read, read_measurements(files.train, arm_read), as_stated=True))
    return state, drawn.effects[0].site if drawn.effects else ""


def kinds(state: State) -> Families:
    return state.sized.families


@pytest.mark.parametrize(
    ("kind", "seed", "arm", "family"),
    [
        ("backlash", 7016, "boom", "play by approach"),
        ("gear_harmonic", 7015, "six", "curve of the drives"),
        ("hysteresis", 196000, "six", "hysteresis"),
        ("friction_windup", 196001, "six", "friction wind-up"),
        ("thermal_softening", 7006, "boom", "compliance by temperature"),
    ],
)
def test_the_hidden_kind_comes_first_at_its_joint(tmp_path, kind: str, seed: int, arm: str, family: str) -> None:
    state, site = calibrated(tmp_path, kind, seed, arm)
    families = kinds(state)
    assert families.found[0].name == family and families.found[0].places[0].site == site
    assert families.found[0].evidence > STRONG
    before, after = families.held_out
    assert after < 0.9 * before and families.found[0].held_out_without > after


@pytest.mark.parametrize(("kind", "arm"), [("none", "boom"), ("none_restationed", "six")])
def test_where_nothing_is_hidden_no_kind_is_stated(tmp_path, kind: str, arm: str) -> None:
    families = kinds(calibrated(tmp_path, kind, 7001, arm)[0])
    assert not families.found
    assert families.held_out[1] < 1.02 * families.held_out[0]


def test_what_is_read_behind_is_a_lag_and_no_longer_scale_of_the_tracker() -> None:
    """A thousandth of the way from the row before: on a random path that is a scale, too, and noise."""
    arm, rows = six_axes.campaign(150)
    position, read = rows.readings.kinds[0], rows.position
    behind = np.diff(read, axis=0, prepend=read[:1])
    lagging = replace(position, values=position.values - 1e-3 * behind)
    traced = trace(arm, replace(rows, readings=Readings(len(rows), (lagging,))))
    assert not traced.found
    assert traced.families is not None
    assert [family.name for family in traced.families.found] == ["lag of the instrument"]
    before, after = traced.families.held_out
    assert before > 2.0 * after == pytest.approx(2.0 * np.sqrt(3.0) * six_axes.SIGMA, rel=0.1)


def test_a_campaign_whose_joints_hardly_move_has_kinds_as_well(tmp_path) -> None:
    """A joint that never moves has no curve, and no approach that changes."""
    state, _ = calibrated(tmp_path, "none", 7001, "six")
    columns = {name: np.zeros_like(values) for name, values in state.context.row.covariates.items()}
    still = replace(state.context.row, q=np.zeros_like(state.context.row.q), covariates=columns)
    families = kinds(replace(state, context=replace(state.context, row=still, recorded=())))
    assert np.isfinite(families.held_out).all() and np.isfinite(families.noise)
