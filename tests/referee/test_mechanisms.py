"""Machines with loops, springs and cylinders by MuJoCo: calibrated, traced, planned for, tracked, rehearsed.

`tests/studies/mechanisms.py` counts over many of them.
"""

from dataclasses import replace

import numpy as np
import pytest
from support.machines import CRANE
from support.mechanism_plant import GIVES, REVERSING, SIGMA, Truth, campaign, declared
from support.small_arms import ROBOTS

import armflex
from armflex.laws.effects import CATALOGUE, Effect, Location
from armflex.track.reading import Reading

pytestmark = pytest.mark.slow

PRIOR = """
[measurement]
frame = "unknown"
[prior]
joint_offset = 1e-3
compliance = 0.2
spring = 0.1
spring_length = 5e-3
"""
DRAWN = {"lift": 8e-4, "fold": -5e-4, "slew": 6e-4}


def std_of(arm: armflex.Arm) -> dict[str, float]:
    assert arm.certainty is not None
    return dict(zip(arm.certainty.labels, np.sqrt(np.diag(arm.certainty.covariance)).tolist(), strict=True))


def test_a_spring_is_found_as_it_was_built(tmp_path):
    machine, rng = REVERSING["uneven"], np.random.default_rng(2)
    pins, springs = {"tail": np.array(GIVES)}, {"balancer": (0.08, -4e-3)}
    truth = Truth(offsets={"lower": 1e-3}, softer={"lower": 1.2}, springs=springs, compliance=pins)
    arm = declared(machine, tmp_path, PRIOR)
    found = armflex.calibrate(arm, campaign(machine, arm, truth, 45, rng, tmp_path / "read.csv"))
    known = {"spring balancer rate": 0.08, "spring balancer length": -4e-3, "joint_offset lower": 1e-3}
    known |= {"compliance lower ry": np.log(1.2)}
    std = std_of(found.arm)
    values = {one.label: found.arm.found(one) for one in found.arm.certainty.parameters if one.label in known}
    for label, value in known.items():
        assert abs(values[label] - value) < 3.5 * std[label], label
    assert std["spring balancer rate"] < 0.5 * 0.1
    assert found.rms < 1.1 * np.sqrt(3.0) * SIGMA
    # It is written and read with the arm.
    found.write(tmp_path / "found.toml")
    again = armflex.load_arm(tmp_path / "found.toml")
    assert again.springs[0].law == found.arm.springs[0].law


def test_a_leaking_cylinder_is_named(tmp_path):
    rng, truth = np.random.default_rng(3), Truth(offsets=DRAWN, leaks={"lift": 6e-11})
    arm = declared(CRANE, tmp_path, PRIOR)
    read = campaign(CRANE, arm, truth, 60, rng, tmp_path / "read.csv")
    (found,) = armflex.trace(arm, read).found
    asked = "column `hold` how long each pose has stood [s], and let it differ: whether lift, fold leaks was not looked"
    without = armflex.trace(arm, replace(read, hold=None))
    assert any(asked in text for text in without.next_measurement)
    assert "cylinder_leak" not in [one.effect.law.name for one in without.found]
    assert (found.effect.law.name, found.effect.location.site) == ("cylinder_leak", "lift")
    assert found.effect.acting == pytest.approx([6e-11], abs=3.5 * found.std["c"])


@pytest.mark.parametrize("name", ["pin_play", "cylinder_leak", "weak_spring", "bent_rod"])
def test_effects_of_mechanisms_are_read_as_they_were_written(name, tmp_path):
    law, machine = CATALOGUE[name], CRANE if name == "cylinder_leak" else REVERSING["uneven"]
    declared(machine, tmp_path, "")
    site = {"pin_play": "tail", "cylinder_leak": "lift", "weak_spring": "balancer", "bent_rod": "link:tail:to"}[name]
    axis, covariates = ("dx", ("hold",)) if name == "cylinder_leak" else (None, ())
    effect = Effect(law, Location(site, axis, covariates), (2e-4, *(5.0 for _ in law.inner)))
    values = "".join(f"{key} = {value!r}, " for key, value in effect.named.items()).rstrip(", ")
    text = f'[[effect]]\nname = "{name}"\nsite = "{effect.location.place}"\nparameters = {{ {values} }}\n'
    (tmp_path / "with.toml").write_text((tmp_path / "arm.toml").read_text() + text)
    assert armflex.load_arm(tmp_path / "with.toml").effects == (effect,)


def test_rows_are_planned_where_loops_close():
    arm = armflex.load_arm(ROBOTS / "hybrid_lifter" / "arm.toml")
    planned = armflex.plan(arm, 4).rows
    assert len(planned) == 4
    assert np.isfinite(arm.deflection(planned.q, planned.payload).displacement).all()


def test_a_cylinder_whose_zero_moved_is_tracked(tmp_path):
    rng, truth = np.random.default_rng(5), Truth(offsets=DRAWN)
    arm = declared(CRANE, tmp_path, PRIOR)
    known = armflex.calibrate(arm, campaign(CRANE, arm, truth, 30, rng, tmp_path / "read.csv")).arm
    moved = replace(truth, offsets={**DRAWN, "lift": DRAWN["lift"] + 2e-3})
    later = campaign(CRANE, arm, moved, 15, rng, tmp_path / "later.csv")
    tracker = armflex.Tracker(known, {"joint_offset lift": 1e-4})
    for row in range(len(later)):
        tracker.update(Reading.of(later, row))
    tracker.relinearise()
    at = tracker.labels.index("joint_offset lift")
    found = tracker.arm.corrections.joint_offset["lift"]
    assert abs(found - moved.offsets["lift"]) < 3.5 * tracker.std[at]
    assert tracker.std[at] < 5e-4


def test_a_rehearsal_says_whether_a_leak_would_show(tmp_path):
    rng, arm = np.random.default_rng(6), declared(CRANE, tmp_path, PRIOR)
    rows = campaign(CRANE, arm, Truth(), 24, rng, tmp_path / "rows.csv")
    found = armflex.rehearse(arm, rows, draws=1)
    leaks = {one.location.site: one.named for one in found.effects if one.effect == "cylinder_leak"}
    assert set(leaks) == {"lift", "fold"} and max(leaks.values()) > 0.5
