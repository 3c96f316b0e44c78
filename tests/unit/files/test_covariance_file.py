"""The covariance of many parameters stands in a file beside the arm.toml: both belong together, or are refused."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file
from support.small_arms import ROBOTS

from armflex import Arm, load_arm
from armflex.errors import ArmFileError
from armflex.files.arm_file import write_arm
from armflex.files.calibration_table import LAYOUT, Campaign
from armflex.laws.joint.carried import scaled
from armflex.storage.array_file import write_arrays

LABELS = ("joint_offset A1", "joint_offset A2", "joint_offset A3")
MATRIX = 1e-6 * (np.eye(3) + 0.5 * np.eye(3, k=1) + 0.5 * np.eye(3, k=-1))
POSE = ", ".join(["0.0"] * 6)


def calibrated(folder: Path, matrix: np.ndarray = MATRIX, labels: tuple[str, ...] = LABELS) -> Path:
    """Write an arm whose covariance is in a file."""
    shutil.copytree(ROBOTS / "tarm_like", folder, dirs_exist_ok=True)
    path = folder / "arm.covariance.safetensors"
    digest = write_arrays(path, LAYOUT, {"covariance": matrix}, {"parameters": labels})
    table = f"\n[calibration]\ninstrument = [{POSE}]\ntarget = [0.0, 0.0, 0.0]\nscale = 0.0\n"
    table += "".join(f"{name} = {{}}\n" for name in ("joint_offset", "geometry", "compliance", "sessions"))
    table += f"parameters = {list(LABELS)}\n"
    table += f'covariance_file = "{path.name}"\ncovariance_sha256 = "{digest}"\n'
    with (folder / "arm.toml").open("a") as file:
        file.write(table)
    return path


def loaded(path: Path) -> Arm:
    return load_arm(path.parent / "arm.toml")


@pytest.mark.filterwarnings("ignore")
def test_there_and_back(tmp_path: Path) -> None:
    found = loaded(calibrated(tmp_path)).certainty
    assert found.labels == LABELS
    np.testing.assert_array_equal(found.covariance, MATRIX)


@pytest.mark.filterwarnings("ignore")
def test_what_is_written_says_what_its_numbers_are(tmp_path: Path) -> None:
    calibrated(tmp_path)
    arm = load_arm(tmp_path / "arm.toml")
    factors = np.array([0, 0, 0, 0, -0.5, 0])
    flexures = [
        replace(one, law=scaled(one.law, np.exp(0.5 * factors))) if one.name == "A2" else one for one in arm.flexures
    ]
    arm = replace(arm, flexures=tuple(flexures), factors={"A2": factors})
    lines = write_arm(arm, Campaign("", 1, 0.0), tmp_path / "again.toml").read_text().split("\n")
    assert any(line.startswith("[calibration.compliance] # natural logarithms of the factors") for line in lines)
    np.testing.assert_array_equal(load_arm(tmp_path / "again.toml").factors["A2"], arm.factors["A2"])


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("spoil", "problem"),
    [
        (lambda path: path.write_bytes(path.read_bytes()[:-1] + b"\x01"), "SHA-256"),
        (lambda path: path.unlink(), "cannot be read: No such file"),
        (lambda path: save_file({"covariance": MATRIX}, path), "was not written by armflex"),
        (lambda path: write(path, 2.0 * MATRIX), "is not the file that was written with this table"),
        (lambda path: write(path, MATRIX, LABELS[::-1]), "is not the file that was written with this table"),
    ],
)
def test_another_file_is_refused(tmp_path: Path, spoil, problem: str) -> None:
    path = calibrated(tmp_path)
    spoil(path)
    expected = rf"arm\.toml:\d+: \[calibration\] covariance_file: {path.name} .*calibrate the arm anew"
    with pytest.raises(ArmFileError, match=expected) as caught:
        loaded(path)
    assert problem in str(caught.value)


def write(path: Path, matrix: np.ndarray, labels: tuple[str, ...] = LABELS) -> None:
    write_arrays(path, LAYOUT, {"covariance": matrix}, {"parameters": labels})


@pytest.mark.slow
def test_one_of_another_version_is_refused(tmp_path: Path) -> None:
    path = calibrated(tmp_path)
    older = replace(LAYOUT, format="armflex-covariance-0")
    write_arrays(path, older, {"covariance": MATRIX}, {"parameters": LABELS})
    with pytest.raises(ArmFileError, match="made by another version"):
        loaded(path)
    text = (tmp_path / "arm.toml").read_text()
    (tmp_path / "arm.toml").write_text(text[: text.index("covariance_sha256")])
    with pytest.raises(ArmFileError, match=r"\[calibration\] needs 'covariance_sha256'"):
        loaded(path)
