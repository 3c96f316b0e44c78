"""Names of halves of a campaign: counted by hand, and those of a campaign in which one effect is missing."""

from pathlib import Path

import pytest
from support.effect_arms import quietly
from support.three_joint_plant import with_play

from armflex import read_measurements, trace
from armflex.cli.trace_command import as_json, print_trace
from armflex.errors import InputError
from armflex.laws.effects import CATALOGUE, Effect, Location
from armflex.show.report import render_report
from armflex.trace.findings import Replicated
from armflex.trace.halves import counted


def named(probability: float, there: float, inside: bool, agree: bool | None) -> Replicated:
    effect = Effect(CATALOGUE["backlash"], Location("A2", "ry", ("approach_A2",)), (1e-3,))
    return Replicated("random 1", 1, effect, probability, there, inside, agree)


def test_names_are_counted_by_the_probability_that_is_stated() -> None:
    names = [named(0.95, 0.9, True, True), named(0.99, 0.7, True, False), named(1.0, 0.2, False, None)]
    sure, doubtful = counted([*names, named(0.3, 0.1, False, None)])
    assert (sure.least, sure.names, sure.inside, sure.agree) == (0.9, 3, pytest.approx(2.0 / 3.0), 0.5)
    assert sure.stated == pytest.approx(0.98) and sure.there == pytest.approx(0.6)
    assert (doubtful.least, doubtful.names, doubtful.agree) == (0.2, 1, None)
    assert doubtful.cells == ["0.2 and more", "1", "30%", "10%", "0%", "-"]
    assert counted([]) == []


@pytest.mark.slow
def test_what_is_there_is_in_both_halves(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    arm = quietly(with_play(tmp_path, poses=60) / "arm.toml")
    found = trace(arm, read_measurements(tmp_path / "rows.csv", arm), halves=1)
    assert found.halves is not None and {one.split for one in found.halves} == {"random 1", "parts 1"}
    own = [one for one in found.halves if (one.effect.law.name, one.effect.location.site) == ("backlash", "J2")]
    assert len(own) == 4 and all(one.in_other_half and one.probability_there > 0.9 for one in own)
    assert sum(bool(one.numbers_agree) for one in own) >= 3
    told = as_json(found)["halves"][0]
    assert {"split", "half", "effect", "site", "axis", "probability", "probability_there"} <= set(told)
    assert told["in_other_half"] is True
    print_trace(found)
    said = capsys.readouterr().out
    assert "What one half of the campaign names" in said and "0.9 and more" in said
    assert "What halves of the campaign name" in render_report(found)


def test_halves_of_few_poses_are_refused(tmp_path: Path) -> None:
    arm = quietly(with_play(tmp_path) / "arm.toml")
    rows = read_measurements(tmp_path / "rows.csv", arm)
    with pytest.raises(InputError, match="halves is -1, expected 0 or more"):
        trace(arm, rows, halves=-1)
