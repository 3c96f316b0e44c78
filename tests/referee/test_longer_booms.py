"""How a boom that gets longer swings after a calibration on its sag alone, against a beam of finite elements."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigh
from support.small_arms import joint, link, robot

from armflex import Arm, Measurements, calibrate, load_arm
from armflex.declaration import Declaration, Source
from armflex.errors import ArmFileError
from armflex.laws import Row
from armflex.laws.joint.carried import scaled
from armflex.laws.joint.telescope import read_telescope
from armflex.readings import Position, Readings
from armflex.rows import Rows
from armflex.show.view.arm_scene import Motion, arm_scene

LENGTHS, WEIGHTS = np.linspace(0.8, 3.2, 7), {"none": 0.0, "p1": 1.0, "p2": 2.0}
HEAD, SIGMA, ELEMENTS = 1.5, 1e-3, 24

ARM = """
[robot]
urdf = "robot.urdf"
tip = "head"
gravity = [0.0, 0.0, -9.81]
damping_ratio = 0.01
[payload.p1]
mass = 1.0
com = [0.0, 0.0, 0.0]
[payload.p2]
mass = 2.0
com = [0.0, 0.0, 0.0]
[flexure.lift]
joint = "lift"
joint_stiffness = 2e4
[flexure.boom]
joint = "boom"
model = "telescope"
EI = 9000.0
length0 = 0.3
along = [1, 0, 0]
[measurement]
frame = "base"
[prior]
compliance = 0.5
"""


def beam(length: float, tip: float, bending: float, hinge: float, density: float) -> tuple[float, float]:
    """Return the sag of the tip [m] and the first frequency [Hz] of a hinged beam: cubic elements in a plane.

    Args:
        length: Of the beam [m].
        tip: Mass at its end [kg].
        bending: EI [N m^2].
        hinge: Stiffness of the hinge that holds it [Nm/rad].
        density: Mass per metre [kg/m].
    """
    size, count = length / ELEMENTS, 2 * ELEMENTS + 2
    stiff = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]], dtype=float)
    heavy = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]], dtype=float)
    turn = np.diag([1.0, size, 1.0, size])
    stiff = bending / size**3 * turn @ stiff @ turn
    heavy = density * size / 420.0 * turn @ heavy @ turn
    stiffness, mass, load = np.zeros((count, count)), np.zeros((count, count)), np.zeros(count)
    for i in range(ELEMENTS):
        at = slice(2 * i, 2 * i + 4)
        stiffness[at, at] += stiff
        mass[at, at] += heavy
        load[at] += 9.81 * density * size * np.array([0.5, size / 12.0, 0.5, -size / 12.0])
    mass[-2, -2] += tip
    load[-2] += 9.81 * tip
    stiffness[1, 1] += hinge
    free = np.arange(1, count)  # the hinge turns and does not shift
    sag = np.linalg.solve(stiffness[np.ix_(free, free)], load[free])[-2]
    slowest = eigh(mass[np.ix_(free, free)], stiffness[np.ix_(free, free)], eigvals_only=True)[-1]
    return float(sag), float(1.0 / (2.0 * np.pi * np.sqrt(slowest)))


def declared(folder, boom: float) -> Arm:
    """Return the boom as it is declared: 40 % too stiff, what it weighs as a body at its end."""
    parts = link("base"), link("carriage", 5.0, moment=1e-3), link("head", HEAD + boom, moment=1e-3)
    out = joint("boom", "carriage", "head", (0.3, 0, 0), axis=(1, 0, 0), kind="prismatic")
    parts += joint("lift", "base", "carriage"), out.replace('lower="-3"', 'lower="0"')
    (folder / "robot.urdf").write_text(robot(*parts))
    (folder / "arm.toml").write_text(ARM)
    return load_arm(folder / "arm.toml")


@pytest.mark.parametrize(("density", "worst"), [(0.0, 0.02), (0.3, 0.05)])
@pytest.mark.filterwarnings("ignore:soft:armflex.ArmflexWarning")
def test_a_boom_calibrated_on_its_sag_swings_as_a_beam(density: float, worst: float, tmp_path) -> None:
    """True EI and hinge differ by 30 % and 25 % from the declared ones; the boom weighs up to a quarter of its load."""
    bending, hinge, rng = 9000.0 / 1.3, 2e4 / 1.25, np.random.default_rng(3)
    arm = declared(tmp_path, 33.0 / 140.0 * density * LENGTHS.mean())
    rows = [(length, name) for length in LENGTHS for name in WEIGHTS]
    q = np.array([[0.0, length - 0.3] for length, _ in rows])
    sags = [beam(length, HEAD + WEIGHTS[name], bending, hinge, density)[0] for length, name in rows]
    tips = np.array([[length, 0.0, -sag] for (length, _), sag in zip(rows, sags, strict=True)])
    tips += rng.normal(0.0, SIGMA, tips.shape)
    position = Position(tips, np.full(3, SIGMA) * np.array([np.inf, np.inf, 1.0]) + np.zeros_like(tips))
    commanded = Rows.of(arm.joint_names, q, tuple(name for _, name in rows), {}, session="s", derived=("time",))
    found = calibrate(arm, Measurements.of(commanded, Readings(len(rows), (position,)))).arm
    away = []
    for length in LENGTHS:
        for name in ("none", "p2"):
            truth = beam(length, HEAD + WEIGHTS[name], bending, hinge, density)[1]
            away.append(found.modes([0.0, length - 0.3], name).frequencies[0] / truth - 1.0)
    assert np.median(np.abs(away)) < worst


ALONG = {"x": np.array([1.0, 0.0, 0.0]), "oblique": np.ones(3) / np.sqrt(3.0), "out of true": np.array([0.6, 0.0, 0.8])}


def parts_of(along: np.ndarray, length: float) -> dict[str, np.ndarray]:
    """Return the (6, 6) compliance of a cantilever along a unit vector that each stiffness of 1 gives."""
    own, lever = np.outer(along, along), length * np.cross(along, np.eye(3)).T  # of the end seen from half way
    turns, shifts = np.zeros((2, 6, 6))
    turns[3:, 3:] = length * (np.eye(3) - own)
    shifts[:3, :3] = length**3 / 12.0 * (np.eye(3) - own)
    carried = np.eye(6)
    carried[:3, 3:] = -0.5 * lever  # a turn half way shifts the end
    bent = carried @ turns @ carried.T + shifts
    slides, twists = np.zeros((2, 6, 6))
    slides[:3, :3], twists[3:, 3:] = length * own, length * own
    return {"EI": bent, "GJ": twists, "EA": slides}


@pytest.mark.parametrize("along", ALONG.values(), ids=ALONG)
@pytest.mark.parametrize("stated", [("EI",), ("EI", "GJ"), ("EI", "GJ", "EA"), ("EI", "EA")])
def test_every_stiffness_that_is_stated_is_one_number(along: np.ndarray, stated: tuple[str, ...]) -> None:
    """10 % of EI are 10 % of the sag, however the boom lies in its frame; a fit has a factor for each of them."""
    values = {"EI": 2e6, "GJ": 1e6, "EA": 5e8}
    text = "\n".join(f"{name} = {values[name]}" for name in stated)
    text += f"\nalong = {along.tolist()}\nlength0 = 0.5\nrelative_std = 0.1\n"
    table = Declaration(tomllib.loads(text), ("flexure", "boom"), Source(Path("arm.toml"), text))
    law, row = read_telescope(table, "boom", {"boom": (0.0, 3.0)}), Row(np.array([2.0]), {"boom": 0})
    each = {name: part / values[name] for name, part in parts_of(along, 2.5).items() if name in stated}
    load = np.array([300.0, -200.0, 900.0, 50.0, 70.0, -90.0])
    np.testing.assert_allclose(law.twist(load, row), sum(each.values()) @ load, rtol=1e-10)
    expected = sum(np.outer(part @ load, part @ load) for part in each.values())
    np.testing.assert_allclose(law.covariance(load, row), 0.01 * expected, rtol=1e-9, atol=1e-24)
    freed = law.freed(row)
    assert len(freed) == len(stated) == len(law.parameters) == len(law.learned({}).parameters)
    for name in stated:
        softer = []
        for axis in freed:
            factor = np.ones(6)
            factor[axis] = np.sqrt(1.3)
            softer.append(scaled(law, factor).twist(load, row))
        wanted = sum(part * (1.3 if name == other else 1.0) for other, part in each.items()) @ load
        assert sum(np.allclose(twist, wanted, rtol=1e-10, atol=0.0) for twist in softer) == 1


def stages(folder: Path, flexure: str, mimic: str = '<mimic joint="ext1" multiplier="0.5" offset="0.1"/>') -> Arm:
    """Return a boom of two stages, the second of which follows the first by a belt."""
    parts = link("base"), link("first", 20.0), link("second", 10.0, (0.1, 0.0, 0.0))
    slide = {"xyz": (0.5, 0, 0), "axis": (1, 0, 0), "kind": "prismatic"}
    slides = joint("ext1", "base", "first", **slide), joint("ext2", "first", "second", **slide, inside=mimic)
    (folder / "robot.urdf").write_text(robot(*parts, *slides))
    head = '[robot]\nurdf = "robot.urdf"\ntip = "second"\ngravity = [0.0, 0.0, -9.81]\n'
    (folder / "arm.toml").write_text(f'{head}[flexure.tube]\njoint = "ext2"\n{flexure}\n')
    return load_arm(folder / "arm.toml")


GROWS = "compliance = [0, 0, 1e-6, 0, 1e-7, 0]\ncompliance_q2 = [0, 0, 2e-6, 0, 0, 0]"


@pytest.mark.filterwarnings("ignore:soft:armflex.ArmflexWarning")
def test_a_stage_that_follows_another_is_as_long_as_the_factor_of_its_belt_says(tmp_path: Path) -> None:
    boom = stages(tmp_path, 'model = "telescope"\nEI = 9e3\nlength0 = 2.0\nalong = [1, 0, 0]')
    law, load = boom.flexures[0].law, np.array([0.0, 0.0, -100.0, 0.0, 30.0, 0.0])
    for q in (0.0, 0.4, 1.2):
        length = 2.0 + 0.1 + 0.5 * q
        twist = law.twist(load, Row(np.array([q]), boom.joint_index))
        assert twist[2] == pytest.approx((-100.0 * length**3 / 3 - 30.0 * length**2 / 2) / 9e3, rel=1e-12)
    grows = stages(tmp_path, f'model = "position_dependent"\n{GROWS}').flexures[0].law
    twist = grows.twist(load, Row(np.array([1.2]), boom.joint_index))
    assert twist[2] == pytest.approx(-100.0 * (1e-6 + 2e-6 * 0.7**2), rel=1e-12)
    back = '<mimic joint="ext1" multiplier="-1" offset="-0.2"/>'
    with pytest.raises(ArmFileError, match="m long at the upper limit of 'ext1'"):
        stages(tmp_path, 'model = "telescope"\nEI = 9e3\nlength0 = 1.0\nalong = [1, 0, 0]', back)


def test_a_page_draws_the_tube_of_a_stage_that_follows(tmp_path: Path) -> None:
    boom = stages(tmp_path, "compliance = [0, 0, 1e-6, 0, 1e-7, 0]")
    shown = Motion(np.zeros(1), (boom.deflection([0.8]),), 0)
    lengths = {
        node.link: max(shape.size[-1] for shape in node.shapes)
        for node in arm_scene(boom, shown).nodes
        if node.name in ("flexed/first", "flexed/second")
    }
    assert lengths["second"] == pytest.approx(0.5) and lengths["first"] == pytest.approx(0.8)


@pytest.mark.filterwarnings("ignore:soft:armflex.ArmflexWarning")
def test_a_boom_that_cannot_be_is_refused(tmp_path) -> None:
    arm = declared(tmp_path, 0.0)
    text = (tmp_path / "arm.toml").read_text()
    for good, bad, key in (
        ("EI = 9000.0", "EI = 0.0", "EI"),
        ("EI = 9000.0", "EI = 9000.0\nGJ = -1.0", "GJ"),
        ("length0 = 0.3", "length0 = -0.1", "length0"),
        ("along = [1, 0, 0]", "along = [0, 0, 0]", "along"),
        ("along = [1, 0, 0]", "along = [-1, 0, 0]", r"joint 'boom' moves out, .* write along = \[1.0, 0.0, 0.0\]"),
        ("along = [1, 0, 0]", "along = [0, 0, 1]", r"joint 'boom' moves out, .* write along = \[1.0, 0.0, 0.0\]"),
        ("length0 = 0.3", 'length0 = 0.3\ndepends_on = "bom"', "depends_on"),
    ):
        (tmp_path / "bad.toml").write_text(text.replace(good, bad))
        with pytest.raises(ArmFileError, match=key):
            load_arm(tmp_path / "bad.toml")
    assert arm.flexure_names == ("lift", "boom")
