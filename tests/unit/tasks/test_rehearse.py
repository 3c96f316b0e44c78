"""What a rehearsal promises is what a trace of the same campaign then finds."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.command_line import strict_json
from support.small_arms import joint, link, robot

import armflex
from armflex.cli.main import armflex as group
from armflex.cli.rehearse_command import print_rehearsal
from armflex.laws.effects.catalogue import EVERY
from armflex.laws.effects.effect import Effect, full
from armflex.tasks.rehearse import Rehearsal, simulated

ARM = """\
[robot]
urdf = "robot.urdf"
tip = "tip"
gravity = [0.0, 0.0, -9.81]
[payload.p]
mass = 25.0
com = [0.1, 0.0, 0.05]
[flexure.B]
joint = "B"
compliance = [0, 0, 0, 0, 1e-5, 0]
[measurement]
frame = "unknown"
[prior]
joint_offset = 5e-3
"""
SIGMA = 1e-4


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with an arm of two joints and forty rows, each pose with and without its payload."""
    folder = tmp_path_factory.mktemp("rehearsed")
    parts = link("base"), link("upper", 20.0, (0.3, 0, 0)), link("fore", 12.0, (0.3, 0, 0)), link("tip")
    parts += joint("A", "base", "upper", axis=(0, 0, 1)), joint("B", "upper", "fore", (0.7, 0, 0), axis=(0, 1, 0))
    (folder / "robot.urdf").write_text(robot(*parts, joint("T", "fore", "tip", (0.9, 0, 0), kind="fixed")))
    (folder / "arm.toml").write_text(ARM)
    q = np.repeat(np.random.default_rng(1).uniform(-1.5, 1.5, (20, 2)), 2, axis=0)
    lines = [f"{a!r},{b!r},{'p' if i % 2 else 'none'}" for i, (a, b) in enumerate(q.tolist())]
    (folder / "poses.csv").write_text("\n".join(["q_A,q_B,payload", *lines]) + "\n")
    return folder


@pytest.fixture(scope="module")
def arm(folder: Path) -> armflex.Arm:
    return armflex.load_arm(folder / "arm.toml")


@pytest.fixture(scope="module")
def rehearsed(folder: Path) -> Rehearsal:
    """What the command finds; it writes r.json."""
    given = ["rehearse", "arm.toml", "--rows", "poses.csv", "--sigma", "0.1mm", "--draws", "2", "--json", "r.json"]
    given = [str(folder / text) if "." in text and "mm" not in text else text for text in given]
    made: list[Rehearsal] = []
    with pytest.MonkeyPatch.context() as patch:
        made_by = "armflex.cli.rehearse_command.rehearse"
        patch.setattr(made_by, lambda *a, **b: made.append(armflex.rehearse(*a, **b)) or made[0])
        group.main(given, standalone_mode=False)
    assert made[0].sigma == SIGMA and made[0].read == 40
    return made[0]


def test_probabilities_are_such_and_follow_the_noise(arm: armflex.Arm, folder: Path, rehearsed: Rehearsal) -> None:
    coarse = armflex.rehearse(arm, folder / "poses.csv", sigma=3e-3, draws=1)
    for one in rehearsed.effects:
        assert 0.0 <= one.named <= 1.0 and one.named + one.nothing <= 1.0 + 1e-9
        assert one.size <= 1e-3 * (1.0 + 1e-9)
    fine, rough = (np.mean([one.named for one in found.effects]) for found in (rehearsed, coarse))
    assert fine > 2.0 * rough


def test_what_calibration_frees_has_no_name_of_its_own(rehearsed: Rehearsal) -> None:
    offsets = [one for one in rehearsed.effects if one.effect == "encoder_offset"]
    assert offsets and max(one.named for one in offsets) < 0.1


@pytest.mark.parametrize("name", ["backlash", "encoder_eccentricity"])
def test_a_trace_finds_what_the_rehearsal_promises(
    arm: armflex.Arm, folder: Path, rehearsed: Rehearsal, name: str
) -> None:
    law = EVERY[name]
    one = max((one for one in rehearsed.effects if one.effect == name), key=lambda one: one.named)
    assert one.named > 0.95
    rows = armflex.read_measurements(folder / "poses.csv", arm, inputs_only=True)
    few = replace(one.location, terms=one.location.terms[:1])

    def campaign(size: float) -> armflex.Measurements:
        effect = Effect(law, few, full(np.array([size]), few, len(law.amplitudes)))
        return simulated(replace(arm, effects=(effect,) if size else ()), rows, SIGMA, np.random.default_rng(5))

    still, trial = campaign(0.0), campaign(1e-7)
    amplitude = 1e-7 * one.size / float(np.sqrt(((trial.position - still.position) ** 2).sum(axis=1).mean()))
    found = armflex.trace(arm, campaign(amplitude))
    assert [(each.effect.law.name, each.effect.location.site) for each in found.found] == [(name, one.location.site)]


def test_the_table_has_one_way_of_naming_and_calibration_beside_the_names(
    rehearsed: Rehearsal, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    print_rehearsal(rehearsed)
    lines = capsys.readouterr().out.splitlines()
    head = next(line for line in lines if "hidden effect" in line)
    assert " ".join(head.split()) == "hidden effect places size mm own name calibration another mostly in set"
    cells = {line.split()[0]: line.split() for line in lines if line.split()[:1] and line.split()[0] in EVERY}
    assert set(cells) == {one.effect for one in rehearsed.effects}
    for name, (_, _, _, *chances) in cells.items():
        assert 98 <= sum(int(chance.rstrip("%")) for chance in chances[:3]) <= 102, name
    assert int(cells["encoder_offset"][4].rstrip("%")) > int(cells["encoder_offset"][3].rstrip("%"))
    legend = " ".join(lines)
    assert all(f"{word}: " in legend for word in ("size", "own name", "calibration", "another", "in set"))


def test_the_command_writes_what_the_function_returns(folder: Path, rehearsed: Rehearsal) -> None:
    found = strict_json(folder / "r.json")
    assert found["format"] == "armflex-rehearse-1" and found["rows"] == 40
    assert len(found["effects"]) == len(rehearsed.effects)
    play = [one for one in found["effects"] if (one["effect"], one["site"]) == ("backlash", "B")]
    assert play and all(one["probability"] > 0.9 for one in play)
    assert all(one["confused_with"] == [] or one["confused_with"][0]["probability"] <= 1.0 for one in found["effects"])


@pytest.mark.parametrize("given", [{"sigma": 0.0}, {"size": 2.0}, {"draws": 0}])
def test_a_number_out_of_its_range_is_named(arm: armflex.Arm, folder: Path, given: dict) -> None:
    with pytest.raises(armflex.InputError, match=next(iter(given))):
        armflex.rehearse(arm, folder / "poses.csv", **given)
