"""A new effect is one file and one line: an axis that wobbles, as its file would have it, entered in the catalogue."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomlkit
from support.campaigns import draw
from support.effect_arms import arm_and, plain
from support.stage import few, readings

from armflex import calibrate, load_arm, read_measurements, trace
from armflex.arm import Setup
from armflex.files.effect_file import effect_table
from armflex.laws.effects import Effect, Location, TwistLaw
from armflex.laws.effects.catalogue import CATALOGUE, EVERY
from armflex.laws.effects.context import AXES_TURN, Records
from armflex.laws.effects.effect import Amplitude, Words
from armflex.laws.effects.location import drive_axis
from armflex.laws.effects.shapes import on_axis, own_column, twists
from armflex.laws.terms import waves
from armflex.plan.design import instead
from armflex.plan.effects_in_question import named_effect, spelled
from armflex.show.report.words import called, labelled, units_of


def _places(records: Records) -> list[Location]:
    return [
        Location(joint.name, axis, (f"q_{joint.name}",), (0, 1))
        for joint in records.robot.moving
        for axis in AXES_TURN
        if axis != drive_axis(joint)
    ]


AXIS_WOBBLE = TwistLaw(
    name="axis_wobble",
    words=Words("axis wobble", "the joint's axis tilts as it turns", "A sin q + B cos q"),
    instead="measure a target on the joint's housing",
    places=_places,
    amplitudes=(Amplitude("A", "rad"), Amplitude("B", "rad")),
    direction=on_axis,
    terms=lambda here, inner: twists(here.direction, *([wave] for wave in waves(own_column(here), 1.0))),
)
WOBBLE = Effect(AXIS_WOBBLE, Location("J3", "rx", ("q_J3",), (0, 1)), (9e-4, -5e-4))


@pytest.fixture(autouse=True)
def entered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the law in the catalogue, which is the one line."""
    for catalogue in (CATALOGUE, EVERY):
        monkeypatch.setitem(catalogue, AXIS_WOBBLE.name, AXIS_WOBBLE)


@pytest.mark.slow
def test_it_is_searched_for_and_found(tmp_path: Path) -> None:
    truth = draw("none", 5, "six").write(tmp_path)
    arm = load_arm(truth.arm)
    rows = read_measurements(truth.train, arm)
    rows = few(rows, np.flatnonzero(rows.measured)[::4])
    joint = arm.joint_names[2]
    wobble = replace(WOBBLE, location=Location(joint, "rx", (f"q_{joint}",), (0, 1)))
    found = calibrate(arm, rows, as_stated=True)
    setup = Setup(arm, found.fit.setup.instrument)
    moved = readings(setup.with_effect(wobble), rows) - readings(setup, rows)
    traced = trace(arm, replace(rows, position=rows.position + moved))
    (one,) = traced.found
    # Likelier than all else, curves of every drive among it: it has a name.
    assert (one.effect.law, one.effect.location) == (AXIS_WOBBLE, wobble.location) and one.probability > 0.5
    (block,), fit = traced.state.effects, traced.state.fit
    known = np.linalg.inv(fit.posterior.covariance[np.ix_(*2 * [fit.places(block)])])
    off = traced.state.values_of(block) - wobble.values
    assert off @ known @ off < 16.0


def test_it_is_written_and_read_again(tmp_path: Path) -> None:
    text = tomlkit.dumps({"effect": [effect_table(WOBBLE, {"A": 1e-5})]})
    assert 'name = "axis_wobble"' in text
    arm = arm_and(tmp_path, f"\n{text}")
    assert arm.effects == (WOBBLE,)
    q = np.array([0.3, -0.4, 0.5, 0.2, 0.6, -0.1])
    assert np.linalg.norm((arm.deflection(q).displacement - plain().deflection(q).displacement)[3:]) == pytest.approx(
        abs(9e-4 * np.sin(0.5) - 5e-4 * np.cos(0.5)), rel=0.02
    )


def test_it_is_spoken_of() -> None:
    assert called(WOBBLE) == "axis wobble at J3 (rx)" and labelled(WOBBLE) == "axis_wobble J3 rx"
    assert units_of(WOBBLE) == {"A": "rad", "B": "rad"}
    backlash = Effect(EVERY["backlash"], Location("J3", "ry", ("approach_J3",)), (0.0,))
    assert instead(WOBBLE, backlash).endswith(", or measure a target on the joint's housing")


def test_it_can_be_planned_for() -> None:
    asked = named_effect("axis_wobble:J3:rx", plain(), ())
    assert asked == replace(WOBBLE, values=(0.0, 0.0)) and spelled(asked) == "axis_wobble:J3:rx"
