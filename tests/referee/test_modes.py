"""Frequencies and shapes against MuJoCo (mass matrix, differences of its forces), Exudyn, and a closed form."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.exudyn_arm import exudyn_frequencies
from support.mujoco_arm import Referee, Sprung
from support.small_arms import CROOKED, ROBOTS, joint, link, robot
from support.sprung_campaign import driven

from armflex import Arm, InputError, Payload, load_arm, make_arm
from armflex.errors import ArmFileError
from armflex.laws import LinearLaw

SPRINGS = {"tarm_like": 4e6, "heavy_six": 1e5}
"""N m/rad of turning drives; of sliding ones as many N/m."""

EVERY = {**SPRINGS, "oblique": 4e4}

SLIDING = """[robot]
urdf = "robot.urdf"
tip = "tool"
gravity = [0.3, -0.2, -9.8]
[payload.bar]
mass = 15.0
com = [0.3, -0.1, 0.05]
inertia = [0.4, 2.0, 1.9, 0.1, -0.05, 0.02]
[flexure.yaw]
joint = "yaw"
compliance = [0, 0, 0, 0, 0, 1e-6]
"""


@pytest.fixture
def folders(tmp_path: Path) -> dict[str, Path]:
    """Folders of three arms; the third has oblique mounts, a wrist that slides, and leans."""
    slide = (
        joint("slide", "fore", "wrist", (0.6, 0.05, 0.1), (0, 0.4, 0), (0.8, 0, 0.6), kind="prismatic"),
        link("wrist", 12.0, (0.1, 0.03, -0.02), 0.3),
        joint("flange", "wrist", "tool", (0.2, 0, 0.05), kind="fixed"),
        link("tool"),
    )
    (tmp_path / "robot.urdf").write_text(robot(*CROOKED[:-2], *slide))
    (tmp_path / "arm.toml").write_text(SLIDING)
    return {name: ROBOTS / name for name in SPRINGS} | {"oblique": tmp_path}


def sprung(folder: Path, stiffness: float) -> Iterator[tuple[Arm, Sprung, np.ndarray, str]]:
    """Yield an arm whose drives are springs with its plant, at 20 positions, with and without a payload."""
    declared, referee, rng = load_arm(folder / "arm.toml"), Referee(folder), np.random.default_rng(4)
    arm = driven(declared, stiffness)
    for number in range(20):
        payload = ["none", list(referee.toml["payload"])[-1]][number % 2]
        q = rng.uniform(arm.robot.lower, arm.robot.upper)
        yield arm, Sprung(referee, arm.joint_names, payload, np.full(len(q), stiffness), {}), q, payload


@pytest.mark.parametrize(("name", "stiffness"), EVERY.items())
def test_frequencies_and_shapes_are_those_of_mujoco(name: str, stiffness: float, folders: dict[str, Path]) -> None:
    sags = []
    for arm, plant, q, payload in sprung(folders[name], stiffness):
        found = arm.modes(q, payload, count=4)
        frequencies, shapes = plant.swings(q)
        shapes = shapes / np.linalg.norm(shapes[:, :3], axis=1)[:, None]
        np.testing.assert_allclose(found.frequencies, frequencies[:4], rtol=1e-6)
        signs = np.sign(np.einsum("mi,mi->m", found.shapes, shapes[:4]))
        np.testing.assert_allclose(found.shapes * signs[:, None], shapes[:4], atol=1e-6 * np.abs(shapes[:4]).max())
        sags.append(np.linalg.norm(arm.deflection(q, payload).displacement[:3]))
        assert not found.flags
    assert max(sags) > 0.005


@pytest.mark.parametrize(("name", "stiffness"), EVERY.items())
def test_frequencies_are_those_of_exudyn(name: str, stiffness: float, folders: dict[str, Path]) -> None:
    pytest.importorskip("exudyn", reason="pip install 'armflex[bench]'")
    for arm, plant, q, payload in sprung(folders[name], stiffness):
        found = arm.modes(q, payload, count=4).frequencies
        np.testing.assert_allclose(found, exudyn_frequencies(plant, q)[:4], rtol=1e-6)


def test_a_mass_on_one_spring(tmp_path) -> None:
    """A point mass on a lever about a vertical axis: w^2 = k / (m l^2 + I)."""
    parts = link("base"), link("a", 50.0, (2.0, 0, 0), moment=3.0), link("tip")
    parts += joint("A", "base", "a", axis=(0, 0, 1)), joint("T", "a", "tip", (2.0, 0, 0), kind="fixed")
    (tmp_path / "robot.urdf").write_text(robot(*parts))
    text = """[robot]
urdf = "robot.urdf"
tip = "tip"
gravity = [0.0, 0.0, -9.81]
damping_ratio = 0.05
[flexure.A]
joint = "A"
compliance = [0, 0, 0, 0, 0, 1e-5]
"""
    (tmp_path / "arm.toml").write_text(text)
    arm = load_arm(tmp_path / "arm.toml")
    found = arm.modes([0.3])
    np.testing.assert_allclose(found.frequencies, [np.sqrt(1e5 / (50.0 * 4.0 + 3.0)) / (2.0 * np.pi)], rtol=1e-12)
    assert found.damping_ratios.tolist() == [0.05] and found.sensitivities.ravel() == pytest.approx([0.5])
    for bad in ("0.0", "1.0", "-0.1"):
        (tmp_path / "bad.toml").write_text(text.replace("0.05", bad))
        with pytest.raises(ArmFileError, match="damping_ratio"):
            load_arm(tmp_path / "bad.toml")
    with pytest.raises(InputError, match="no flexure"):
        replace(arm, flexures=()).modes([0.3])
    with pytest.raises(InputError, match="count is 0"):
        arm.modes([0.3], count=0)


@pytest.mark.parametrize("name", SPRINGS)
def test_stiffening_a_flexure_raises_frequencies_by_as_much_as_is_said(name: str) -> None:
    """On arms whose flexures give every way; equilibrium and geometric stiffness change little by 1e-4."""
    arm = load_arm(ROBOTS / name / "arm.toml")
    arm = replace(arm, robot=replace(arm.robot, gravity=np.zeros(3)))
    q, payload = arm.robot.home, list(arm.payloads)[-1]
    found = arm.modes(q, payload)
    np.testing.assert_allclose(found.sensitivities.sum(axis=1), 0.5, rtol=1e-6)
    for number, one in enumerate(arm.flexures):
        law = LinearLaw(one.law.tangent(np.zeros(6), arm.loaded(payload).row(q, {})))
        ends = []
        for share in (1e-4, -1e-4):
            stiffer = replace(one, law=LinearLaw(law.compliance * np.exp(-share)))
            flexures = tuple(stiffer if i == number else other for i, other in enumerate(arm.flexures))
            ends.append(replace(arm, flexures=flexures).modes(q, payload).frequencies)
        np.testing.assert_allclose(np.log(ends[0] / ends[1]) / 2e-4, found.sensitivities[:, number], atol=1e-6)


@pytest.mark.filterwarnings("ignore:impossible_inertia")
def test_what_links_without_inertia_would_change_is_said(tmp_path) -> None:
    """A rod of 30 kg and 2 m declared as a point: its own inertia lowers the frequency as first order says."""
    frequencies = []
    for moment in (1e-9, 30.0 * 4.0 / 12.0):
        point = link("a", 30.0, (1.0, 0, 0), moment=moment).replace('"1e-09"', '"0"')
        parts = link("base"), point, link("tip", 100.0, moment=0.1)
        parts += joint("A", "base", "a", axis=(0, 0, 1)), joint("T", "a", "tip", (2.0, 0, 0), kind="fixed")
        (tmp_path / "robot.urdf").write_text(robot(*parts))
        arm = make_arm(tmp_path / "robot.urdf", {"A": 1e5}, damping_ratio=0.01, gravity=[0.0, 0.0, -9.81])
        found = arm.modes([0.0])
        frequencies.append(found.frequencies[0])
        said = [flag.text for flag in found.flags if flag.code == "no_inertia"]
        assert bool(said) == (moment < 1e-6)
        if said:
            share = float(re.search(r"by ([\d.]+)%", said[0])[1])
    assert share == pytest.approx(100.0 * (1.0 - frequencies[1] / frequencies[0]), rel=0.05)
    (flag,) = [one for one in arm.modes([0.0], Payload(10.0, [0.5, 0.0, 0.0])).flags if one.code == "no_inertia"]
    wide = arm.modes([0.0], Payload(10.0, [0.5, 0.0, 0.0], [0.9, 0.9, 0.9, 0.0, 0.0, 0.0])).frequencies[0]
    point = arm.modes([0.0], Payload(10.0, [0.5, 0.0, 0.0])).frequencies[0]
    share = float(re.search(r"by ([\d.]+)%", flag.text)[1])
    assert share == pytest.approx(100.0 * (1.0 - wide / point), rel=0.05) and "0.3 m" in flag.text
