"""What sister arms have in common is the prior of the next one, and a stranger is left out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import moved_machine
from support.command_line import fine, run_here
from support.moved_machine import Site

import armflex
from armflex.arm import Arm
from armflex.errors import ArmFileError, InputError
from armflex.estimate.calibrate import calibrate
from armflex.estimate.calibrations import common

PRIOR = "joint_offset = 5e-3\ncompliance = 0.3\ntool = 0.005"


def machine(folder: Path, number: int, centre: float = 2e-3, count: int = 40) -> Path:
    """Write the campaign of a sister: zeros of 2 mrad with a spread of 0.1 mrad."""
    folder.mkdir(exist_ok=True)
    moved_machine.declare(folder, PRIOR)
    off = centre + 1e-4 * np.random.default_rng(number).normal(size=3)
    where = {f"c{number}": Site(turn=0.3 * number, count=count)}
    return moved_machine.measure(folder, where, dict(enumerate(off.tolist())), seed=number)[0]


@pytest.fixture(scope="module")
def sisters(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Arm]:
    folder = tmp_path_factory.mktemp("fleet")
    files = [machine(folder, number) for number in range(6)]
    arm = armflex.load_arm(folder / "arm.toml")
    return {file.stem: calibrate(arm, file).arm for file in files}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:gravity_in:armflex.ArmflexWarning")
def test_mean_and_spread_are_found_and_the_next_one_is_no_surprise(sisters: dict[str, Arm]) -> None:
    found = common(sisters)
    zero = [one.label for one in found.parameters].index("joint_offset J2")
    assert found.mean[zero] == pytest.approx(2e-3, abs=2e-4)
    assert 1e-4 < found.std[zero] < 5e-4  # wider than the spread: it is known from six
    assert "joint_offset J1" not in found.each  # the tracker may stand anywhere
    assert not found.strangers


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:gravity_in:armflex.ArmflexWarning")
def test_a_stranger_is_left_out_by_name(sisters: dict[str, Arm], tmp_path: Path) -> None:
    file = machine(tmp_path / "odd", 9, centre=-4e-3)
    odd = calibrate(armflex.load_arm(file.parent / "arm.toml"), file)
    found = common({**sisters, "odd": odd.arm})
    assert list(found.strangers) == ["odd"]
    assert found.mean == pytest.approx(common(sisters).mean, abs=1e-9)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:gravity_in:armflex.ArmflexWarning")
def test_few_rows_and_the_fleet_are_better_than_few_rows(sisters: dict[str, Arm], tmp_path: Path) -> None:
    file = machine(tmp_path, 17, count=40)
    arm = armflex.load_arm(tmp_path / "arm.toml")
    few = armflex.measured.measurements.read_measurements(file, arm).some(np.arange(6))
    told = replace(arm, prior=replace(arm.prior, each=common(sisters).each))
    truth = 2e-3 + 1e-4 * np.random.default_rng(17).normal(size=3)
    off, std = [], []
    for one in (calibrate(told, few), calibrate(arm, few)):
        off.append(abs(one.arm.corrections.joint_offset["J2"] - truth[1]))
        std.append(next(own.std for own in one.parameters if own.name == "joint_offset J2"))
    assert off[0] < off[1]
    assert off[0] < 3.0 * std[0] < 3.0 * std[1]


def test_what_is_no_fleet_is_refused(sisters: dict[str, Arm]) -> None:
    some = dict(list(sisters.items())[:2])
    with pytest.raises(InputError, match="2 arms say nothing of a spread"):
        common(some)
    plain = {name: replace(arm, certainty=None) for name, arm in sisters.items()}
    with pytest.raises(InputError, match="is not calibrated"):
        common(plain)
    wider = replace(sisters["c0"], prior=replace(sisters["c0"].prior, joint_offset=1.0))
    with pytest.raises(InputError, match="not declared like"):
        common({**sisters, "c0": wider})


@pytest.mark.slow
def test_the_command_writes_an_arm_that_calibrates(tmp_path: Path) -> None:
    files = [machine(tmp_path, number) for number in range(4)]
    for i, file in enumerate(files[:3]):
        fine(run_here(tmp_path, "calibrate", "arm.toml", file.name, "-o", f"arm{i}.toml"))
    out = fine(
        run_here(tmp_path, "prior", "arm0.toml", "arm1.toml", "arm2.toml", "-o", "fleet.toml", "--json", "f.json")
    )
    assert "joint_offset J2" in out.stdout
    fine(run_here(tmp_path, "calibrate", "fleet.toml", files[3].name, "-o", "next.toml"))
    once = armflex.load_arm(tmp_path / "next.toml").corrections.joint_offset["J2"]
    assert once == pytest.approx(2e-3, abs=5e-4)
    assert "given twice" in run_here(tmp_path, "prior", "arm0.toml", "arm0.toml", "arm1.toml", "-o", "x.toml").stderr


def test_names_in_the_file_are_checked(tmp_path: Path) -> None:
    moved_machine.declare(tmp_path, f'{PRIOR}\neach = {{ "joint_offset J8" = [0.0, 1e-4] }}')
    with pytest.raises(ArmFileError, match=r"no parameter 'joint_offset J8'.*did you mean"):
        armflex.load_arm(tmp_path / "arm.toml")
    moved_machine.declare(tmp_path, f'{PRIOR}\neach = {{ "geometry J2 dx" = [0.0, 1e-4] }}')
    with pytest.raises(ArmFileError, match="does not free its kind: geometry"):
        armflex.load_arm(tmp_path / "arm.toml")
