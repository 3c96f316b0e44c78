"""How a boom that gets longer swings after a calibration on its sag alone, against a beam of finite elements."""

import numpy as np
import pytest
from scipy.linalg import eigh
from support.small_arms import joint, link, robot

from armflex import Arm, Measurements, calibrate, load_arm
from armflex.errors import ArmFileError
from armflex.readings import Position, Readings
from armflex.rows import Rows

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


@pytest.mark.filterwarnings("ignore:soft:armflex.ArmflexWarning")
def test_a_boom_that_cannot_be_is_refused(tmp_path) -> None:
    arm = declared(tmp_path, 0.0)
    text = (tmp_path / "arm.toml").read_text()
    for good, bad, key in (
        ("EI = 9000.0", "EI = 0.0", "EI"),
        ("EI = 9000.0", "EI = 9000.0\nGJ = -1.0", "GJ"),
        ("length0 = 0.3", "length0 = -0.1", "length0"),
        ("along = [1, 0, 0]", "along = [0, 0, 0]", "along"),
        ("length0 = 0.3", 'length0 = 0.3\ndepends_on = "bom"', "depends_on"),
    ):
        (tmp_path / "bad.toml").write_text(text.replace(good, bad))
        with pytest.raises(ArmFileError, match=key):
            load_arm(tmp_path / "bad.toml")
    assert arm.flexure_names == ("lift", "boom")
