"""Parameters of an arm: told apart as objects, looked up by what files call them."""

from dataclasses import replace

import numpy as np
import pytest
from support.small_arms import ROBOTS

from armflex import Arm, load_arm, predict, read_measurements
from armflex.errors import InputError
from armflex.estimate.block import parameters_of
from armflex.estimate.blocks import declared_blocks
from armflex.estimate.placement import first_guess
from armflex.laws.effects import CATALOGUE, Effect, Location
from armflex.parameters import ArmParameter, Certainty, ParameterGroup, ParameterKind, of_effect
from armflex.readings.instrument import Instrument

TARM = ROBOTS / "tarm_like"


@pytest.fixture(scope="module")
def tarm() -> Arm:
    return load_arm(TARM / "arm.toml")


def test_what_a_fit_frees_is_found_again_by_its_label(tarm: Arm) -> None:
    arm = replace(tarm, prior=replace(tarm.prior, geometry=1e-3))
    rows = read_measurements(TARM / "campaign.csv", arm)
    free = parameters_of(declared_blocks(first_guess(arm, rows, np.flatnonzero(rows.measured))[0], rows))
    seen = replace(arm, instrument=Instrument(sessions=dict.fromkeys(rows.session, np.zeros(6))))
    assert seen.named([one.label for one in free]) == free
    assert {one.group.kind for one in free} >= {
        ParameterKind.INSTRUMENT,
        ParameterKind.OFFSET,
        ParameterKind.GEOMETRY,
        ParameterKind.COMPLIANCE,
    }


def test_names_with_blanks_are_not_taken_apart(tarm: Arm) -> None:
    """The flexure 'A dx' has axes that read like those of a flexure 'A' would go on."""
    flexures = [replace(one, name=name) for one, name in zip(tarm.flexures, ("A", "A dx", "A dx rx"), strict=False)]
    arm = replace(tarm, flexures=tuple(flexures))
    found = arm.named(("compliance A dx rx rz", "compliance A dx rx", "compliance A dx"))
    assert [(one.group.of, one.name) for one in found] == [("A dx rx", "rz"), ("A dx", "rx"), ("A", "dx")]


def test_a_parameter_that_the_arm_has_no_more_stays_what_it_is_called(tarm: Arm) -> None:
    (one,) = tarm.named(("compliance J9 rx",))
    assert one.label == "compliance J9 rx" and one.group.kind is ParameterKind.COMPLIANCE
    arm = replace(tarm, certainty=Certainty((one,), np.eye(1)), instrument=Instrument())
    flags = predict(arm, read_measurements(TARM / "held_out.csv", arm)).flags
    assert "no_certainty" in [flag.code for flag in flags]


def test_two_that_a_file_could_not_tell_apart_are_refused() -> None:
    names = (("A2", "1@n 2@m:dx"), ("A2 1@n", "2@m:dx"))
    with pytest.raises(InputError, match="two parameters are both named 'law A2 1@n 2@m:dx'"):
        Certainty(
            tuple(ArmParameter(ParameterGroup(ParameterKind.LAW, flexure), name) for flexure, name in names), np.eye(2)
        )


@pytest.mark.slow
def test_effects_of_one_name_written_before_they_were_numbered(tarm: Arm) -> None:
    """An inner parameter that both have is that of the effect whose amplitudes were named before it."""
    law = CATALOGUE["tool_shift"]
    moved = tuple(Effect(law, Location("tool", None, ("time",), (term,)), (1e-4, 1e-4, 1e-4, 2.0)) for term in (0, 1))
    first, second = (of_effect(effect, number) for number, effect in enumerate(moved, 1))
    arm = replace(tarm, effects=moved)
    assert arm.named(("effect tool_shift tool dx", "effect tool_shift tool dy")) == (first[0], second[0])
    labels = ("effect tool_shift tool dx", "effect tool_shift tool dy", "effect tool_shift tool since")
    assert arm.named(labels) == (first[0], second[0], second[1])
    assert arm.named([one.label for one in (*first, *second)]) == (*first, *second)
