"""A hinge that bends by one number is as uncertain however its link's frame is drawn."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.small_arms import joint, link, robot, write

import armflex
from armflex.arm import Setup
from armflex.estimate.block import factor_block
from armflex.estimate.draw import drawn_frequencies
from armflex.laws.law import anywhere
from armflex.readings.instrument import Instrument

STIFFNESS, REACH, MASS, SHARE = 1e6, 2.0, 100.0, 0.1
SAG = MASS * 9.81 * 1.0 * REACH / STIFFNESS
DRAWN = {"straight": np.zeros(3), "oblique": np.array([-0.63, 0.21, 0.5]), "askew": np.array([0.9, -1.1, 0.3])}


def hinge(folder: Path, turn: np.ndarray, how: str = f"joint_stiffness = {STIFFNESS}", prior: str = "") -> armflex.Arm:
    """Return an arm of one hinge about the base's y, whose link's frame is turned by a rotation vector."""
    turned = Rotation.from_rotvec(turn)
    own = turned.inv().apply
    origin = turned.as_euler("xyz").tolist()
    parts = [
        link("base"),
        link("arm", MASS, own([1.0, 0.0, 0.0]).tolist(), 1.0),
        link("tool"),
        joint("j", "base", "arm", rpy=origin, axis=own([0.0, 1.0, 0.0]).tolist()),
        joint("f", "arm", "tool", own([REACH, 0.0, 0.0]).tolist(), kind="fixed"),
    ]
    write(folder, robot(*parts))
    if "matrix" in how:
        axis = np.concatenate([np.zeros(3), own([0.0, 1.0, 0.0])])
        how = how.replace("matrix", f"compliance = {(np.outer(axis, axis) / STIFFNESS).tolist()}")
    head = '[robot]\nurdf = "robot.urdf"\ntip = "tool"\ngravity = [0.0, 0.0, -9.81]\n'
    text = f'{head}{prior}[flexure.j]\njoint = "j"\n{how}\nrelative_std = {SHARE}\n'
    path = folder / "arm.toml"
    path.write_text(text)
    return armflex.load_arm(path)


HOW = (
    f"joint_stiffness = {STIFFNESS}",
    "matrix",
    f"joint_stiffness = {STIFFNESS}\nlearn = true",
    f'joint_stiffness = {STIFFNESS}\nmodel = "hardening"\nenergy = 1e9',
    f'joint_stiffness = {STIFFNESS}\nmodel = "position_dependent"',
    f'joint_stiffness = {STIFFNESS}\nmodel = "position_dependent"\nlearn = true',
)


@pytest.mark.parametrize("how", HOW)
@pytest.mark.parametrize("turn", DRAWN.values(), ids=DRAWN)
def test_its_uncertainty_does_not_depend_on_the_drawing(tmp_path: Path, turn: np.ndarray, how: str) -> None:
    arm = hinge(tmp_path, turn, how)
    found = arm.deflection([0.0])
    assert found.covariance is not None
    std = np.sqrt(np.diag(found.covariance)[:3].clip(0.0))
    assert abs(std[2] - SHARE * SAG) < 2e-3 * SHARE * SAG
    assert std[1] < 1e-6 * std[2] and std[0] < 2e-3 * std[2]  # rigid sideways, and hardly along it


def test_so_are_its_frequencies(tmp_path: Path) -> None:
    spread = []
    for name, turn in DRAWN.items():
        (tmp_path / name).mkdir()
        found = drawn_frequencies(hinge(tmp_path / name, turn), [0.0])
        assert found is not None
        spread.append(found.std(axis=0))
    assert np.allclose(spread, spread[0], rtol=1e-6)


@pytest.mark.parametrize("how", [how for how in HOW if "learn" not in how])
@pytest.mark.parametrize("turn", DRAWN.values(), ids=DRAWN)
def test_a_fit_gives_it_one_factor_that_does_not_turn_it(tmp_path: Path, turn: np.ndarray, how: str) -> None:
    arm = hinge(tmp_path, turn, how, prior="[prior]\ncompliance = 0.3\n")
    block = factor_block(arm, {"j": arm.flexures[0].law.freed(anywhere(arm.robot))}, arm.prior.compliance)
    assert len(block.parameters) == 1
    softer = block.apply(Setup(arm, Instrument()), np.log([1.5])).arm
    row = anywhere(arm.robot)
    before, after = (each.flexures[0].law.tangent(np.zeros(6), row) for each in (arm, softer))
    assert np.allclose(after, 1.5 * before, rtol=1e-12)
