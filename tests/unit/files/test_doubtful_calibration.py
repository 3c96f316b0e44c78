"""What [calibration] may say is flagged where no campaign is likely to have shown it."""

from pathlib import Path

import numpy as np
import pytest
from support.two_arms import two_arms

from armflex import load_arm

OWN = ("column ry", "column rz", "shoulder rx")
NAMES = ("joint_offset to_torso", "joint_offset to_upper", *(f"compliance {one}" for one in OWN))
ZEROS = "[0.0, 0.0, 0.0, 0.0, 0.0, 0.0]"


def codes(folder: Path, names: tuple[str, ...] = NAMES, **instead: str) -> dict[str, str]:
    """Return flags about the numbers of a calibrated arm, by code, with what they are about."""
    two_arms(folder)
    empty = dict.fromkeys(("joint_offset", "geometry", "sessions"), "{}")
    given = {"instrument": ZEROS, "target": "[0.002, 0.0, 0.0]", "scale": "0.0", "compliance": "{}", **empty, **instead}
    given |= {
        "parameters": str(list(names)),
        "covariance": str([row[: i + 1] for i, row in enumerate(np.eye(5).tolist())]),
    }
    table = "\n".join(f"{key} = {value}" for key, value in given.items())
    with (folder / "arm.toml").open("a") as file:
        file.write(f"\n[calibration]\n{table}\n")
    asked = ("soft", "beyond_priors", "parameters_exchanged")
    return {flag.code: flag.about for flag in load_arm(folder / "arm.toml").flags if flag.code in asked}


@pytest.mark.parametrize(
    ("instead", "expected"),
    [
        ({}, {}),
        ({"target": "[0.002, 0.405, 0.0]"}, {"beyond_priors": "tool dy"}),
        ({"joint_offset": "{ to_fore = 0.02 }"}, {"beyond_priors": "joint_offset to_fore"}),
        (
            {"compliance": "{ column = [26.6, 0.0, 0.0, 0.0, 0.0, 0.0] }"},  # 1e-8 m/N becomes 3.6e3 m/N
            {"beyond_priors": "compliance column dx", "soft": "column"},
        ),
    ],
)
def test_values_far_from_their_priors(tmp_path: Path, instead: dict[str, str], expected: dict[str, str]) -> None:
    assert codes(tmp_path, **instead) == expected


@pytest.mark.parametrize(("one", "other"), [(0, 1), (0, 2), (2, 3), (2, 4), (3, 4)])
def test_names_of_parameters_that_are_exchanged(tmp_path: Path, one: int, other: int) -> None:
    names = list(NAMES)
    names[one], names[other] = names[other], names[one]
    assert list(codes(tmp_path, tuple(names))) == ["parameters_exchanged"]
