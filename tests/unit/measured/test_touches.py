"""Touches: sockets found with the arm, a length that is needed, surfaces, and poses on the contact."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from armflex import Arm, calibrate, load_arm, plan, predict, read_measurements
from armflex.arm import Setup
from armflex.errors import ArmFileError, ConventionError, InputError
from armflex.estimate.blocks import declared_blocks, parameters_of
from armflex.estimate.fit import realise
from armflex.estimate.view import look
from armflex.plan.drive import write_plan
from armflex.readings.instrument import Instrument

pytestmark = pytest.mark.filterwarnings("ignore:weightless:armflex.ArmflexWarning")

ARM = """[robot]
dh = "standard"
gravity = [0.0, 0.0, -9.81]
allow_massless = true
[robot.joint]
J1 = { d_mm = 290, alpha_deg = -90 }
J2 = { theta_deg = -90, a_mm = 270 }
J3 = { a_mm = 70, alpha_deg = -90 }
J4 = { d_mm = 302, alpha_deg = 90 }
J5 = { alpha_deg = -90 }
J6 = { theta_deg = 180, d_mm = 72 }
[prior]
joint_offset = 0.01
geometry = 2e-3
tool = 0.02
[instrument.block]
kind = "touch"
sigma = 1e-4
"""
PAIR = 'distances = [["a", "b", 0.25]]\n'
SOCKETS = {"a": [0.35, -0.1, 0.1], "b": [0.35, 0.15, 0.1]}
TARGET = np.array([0.01, -0.005, 0.12])
OFFSETS = np.array([0.0, 4e-3, -6e-3, 5e-3, -3e-3, 0.0])


ROWS = ((0, 290, 0, -90), (-90, 0, 270, 0), (0, 0, 70, -90), (0, 302, 0, 90), (0, 0, 0, -90), (180, 72, 0, 0))
"""theta, d, a and alpha of each joint in degrees and mm, as in `ARM`."""


def tips(q: np.ndarray) -> np.ndarray:
    """Return the true touching point for (N, 6) readings of the joints, by Denavit and Hartenberg's product."""
    found = []
    for row in q + OFFSETS:
        turn, place = np.eye(3), np.zeros(3)
        for joint, (theta, d, a, alpha) in zip(row, ROWS, strict=True):
            (s, c), (v, w) = [(np.sin(x), np.cos(x)) for x in (joint + np.radians(theta), np.radians(alpha))]
            place = place + turn @ [1e-3 * a * c, 1e-3 * a * s, 1e-3 * d]
            turn = turn @ [[c, -s * w, s * v], [s, c * w, -c * v], [0.0, v, w]]
        found.append(place + turn @ TARGET)
    return np.array(found)


def held(gap, rng: np.random.Generator) -> np.ndarray:
    """Return a configuration of the true arm whose point has no gap."""
    while True:
        start = rng.uniform([-1, -0.5, -0.5, -2, -1.5, -2], [1, 1, 0.7, 2, 1.5, 2])
        found = least_squares(lambda q: gap(tips(q[None])[0]), start, max_nfev=40)
        if np.abs(found.fun).max() < 1e-8:
            return found.x


def campaign(folder: Path, gaps: dict, count: int = 20, seed: int = 1) -> Path:
    """Write touches of sockets by name, each known by its gap of a point."""
    rng = np.random.default_rng(seed)
    rows = []
    for i in range(count * len(gaps)):
        name = list(gaps)[i % len(gaps)]
        noise = rng.normal(0.0, 5e-5, 3)
        q = held(lambda p, name=name, noise=noise: gaps[name](p + noise), rng)
        rows.append([*q, name])
    path = folder / "touches.csv"
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([[*(f"q_J{i}" for i in range(1, 7)), "block"], *rows])
    return path


def _written(folder: Path, text: str, name: str = "arm.toml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def touched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with 32 touches of two sockets 0.25 m apart."""
    folder = tmp_path_factory.mktemp("touches")
    campaign(folder, {name: (lambda p, s=place: p - s) for name, place in SOCKETS.items()}, 16)
    return folder


@pytest.mark.slow
def test_sockets_are_found_with_the_arm_and_rows_elsewhere_predicted(touched: Path, tmp_path: Path) -> None:
    path = _written(touched, ARM + PAIR, "known.toml")
    arm = load_arm(path)
    found = calibrate(arm, touched / "touches.csv")
    assert found.declared_rms > 1e-3 > 2e-4 > found.rms
    q = np.random.default_rng(5).uniform(-0.8, 0.8, (30, 6))
    truth = tips(q)
    rows = {f"q_J{i + 1}": q[:, i] for i in range(6)}
    file = tmp_path / "rows.csv"
    with file.open("w", newline="") as out:
        csv.writer(out).writerows([list(rows), *q.tolist()])

    def spread(arm: Arm) -> float:
        """RMS error of the distances between points: where the base stands, touches do not show."""
        here = predict(arm, file).position
        apart = [np.linalg.norm(p[:, None] - p[None], axis=2) for p in (here, truth)]
        return float(np.sqrt(((apart[0] - apart[1]) ** 2).mean()))

    assert spread(found.arm) < 0.5e-3 < spread(arm)
    # written and read again it is the same arm, sockets included
    again = load_arm(found.write(tmp_path / "fitted.toml"))
    assert np.allclose(predict(again, file).position, predict(found.arm, file).position, atol=1e-12)
    places = again.sensors["block"].of("place", ["a", "b"])
    assert np.linalg.norm(places[0] - places[1]) == pytest.approx(0.25, abs=3e-4)


@pytest.mark.slow
def test_touches_without_a_length_are_refused(touched: Path) -> None:
    arm = load_arm(_written(touched, ARM, "no_length.toml"))
    with pytest.raises(ConventionError, match=r"nothing in this campaign carries a length.*distances = \[\[.a., .b."):
        calibrate(arm, touched / "touches.csv")
    for lengths in ("place = { a = [0.35, -0.1, 0.1] }\n",):
        calibrate(load_arm(_written(touched, ARM + lengths, "length.toml")), touched / "touches.csv")
    trusted = replace(arm, prior=replace(arm.prior, geometry=0.0))
    calibrate(trusted, touched / "touches.csv")
    assert calibrate(arm, touched / "touches.csv", anyway=True).rms < 2e-4


def test_a_touch_comes_from_no_side_unless_it_is_recorded(touched: Path, tmp_path: Path) -> None:
    arm = load_arm(_written(touched, ARM + PAIR, "known.toml"))
    rows = read_measurements(touched / "touches.csv", arm)
    assert not rows.approach.any()
    lines = (touched / "touches.csv").read_text().splitlines()
    other = tmp_path / "sided.csv"
    other.write_text("\n".join([f"{lines[0]},approach_J1", *(f"{line},1" for line in lines[1:])]))
    assert (read_measurements(other, arm).approach[:, 0] == 1.0).all()


@pytest.mark.parametrize("extra", [PAIR, PAIR + 'link = "flange"\npoint = [0.0, 0.0, 0.1]\npoint_std = 0.02\n'])
def test_jacobians_are_finite_differences(touched: Path, extra: str) -> None:
    """Sockets, distances, a plane and a sphere: what every parameter does to every number."""
    shapes = 'shape = { p = "plane", s = "sphere" }\nradius = { s = 0.02 }\nnormal = { p = [0.2, 0.1, 1.0] }\n'
    arm = load_arm(_written(touched, ARM + extra + shapes, "shapes.toml"))
    lines = (touched / "touches.csv").read_text().splitlines()[:25]
    renamed = [line.replace(",a", ",p") if i % 4 == 3 else line.replace(",b", ",s") if i % 4 == 2 else line
               for i, line in enumerate(lines)]  # fmt: skip
    path = touched / "shapes.csv"
    path.write_text("\n".join(renamed) + "\n")
    rows = read_measurements(path, arm)
    setup = Setup(arm, Instrument())
    blocks = declared_blocks(setup, rows)
    values = np.random.default_rng(3).normal(0.0, 1e-2, len(parameters_of(blocks)))
    at, every = realise(setup, blocks, values), np.arange(len(rows))
    view = look(at, rows, every)
    jacobian = np.concatenate([block.jacobian(view) for block in blocks], axis=2)
    for i in range(len(values)):
        ends = []
        for sign in (1.0, -1.0):
            moved = values.copy()
            moved[i] += sign * 1e-6
            seen = look(realise(setup, blocks, moved), rows, every)
            ends.append(seen.residual)
        slope = np.where(np.isfinite(view.sigma), (ends[1] - ends[0]) / 2e-6, 0.0)
        analytic = np.where(np.isfinite(view.sigma), jacobian[:, :, i], 0.0)
        if parameters_of(blocks)[i].group.kind in ("sensor", "tool"):  # of the others the deviation is no small one
            assert np.abs(slope - analytic).max() < 1e-5 * max(1.0, np.abs(slope).max()), parameters_of(blocks)[i].label


@pytest.mark.slow
def test_a_plane_and_a_sphere_calibrate_too(tmp_path: Path) -> None:
    normal, centre = np.array([0.05, 0.0, 1.0]) / np.linalg.norm([0.05, 0.0, 1.0]), np.array([0.4, 0.1, 0.15])
    gaps = {
        "table": lambda p: np.array([p @ normal - 0.1]),
        "ball": lambda p: np.array([np.linalg.norm(p - centre) - 0.03]),
    }
    file = campaign(tmp_path, gaps, count=30)
    more = (
        'shape = { table = "plane", ball = "sphere" }\nradius = { ball = 0.03 }\nplace = { ball = [0.4, 0.1, 0.15] }\n'
    )
    found = calibrate(load_arm(_written(tmp_path, ARM.replace("2e-3", "2e-4") + more)), file)
    assert found.rms < 1e-4 < 4e-4 < found.declared_rms


@pytest.mark.slow
def test_a_plan_puts_the_point_into_the_sockets(touched: Path, tmp_path: Path) -> None:
    path = _written(touched, ARM + PAIR, "known.toml")
    arm = load_arm(path)
    with pytest.raises(InputError, match="no place of a socket is known"):
        plan(arm, 6)
    near = "place = { a = [0.35, -0.1, 0.1], b = [0.35, 0.15, 0.1] }\nplace_std = 0.02\n"
    arm = load_arm(_written(touched, ARM + PAIR + near, "near.toml"))
    found = plan(arm, 6)
    file = write_plan(found, tmp_path / "poses.csv")
    rows = read_measurements(file, arm)
    touch = rows.readings.kinds[0]
    poses = arm.deflection(rows.q, "none", enforce_limits=False).pose
    gap = np.asarray(poses)[:, :3, 3] - np.array([SOCKETS[name] for name in touch.texts or ()])
    assert np.abs(gap).max() < 1e-5
    assert found.goal.value(found.known) > found.reached[0]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ('shape = { a = "cone" }', "'cone' is not known"),
        ('shape = { a = "sphere" }', "give radius"),
        ('distances = [["a", "a", 0.1]]', "length in m"),
        ('distances = [["a", "b", -0.1]]', "length in m"),
        ("place = { a = [1.0, 2.0] }", "expected 3 numbers"),
        ("point_std = 0.1", "needs `link`"),
        ("distance = 3", "unknown key, did you mean 'distances'"),
    ],
)
def test_what_is_declared_wrongly_is_named(tmp_path: Path, wrong: str, said: str) -> None:
    with pytest.raises(ArmFileError, match=said.replace("(", r"\(")):
        load_arm(_written(tmp_path, ARM + wrong + "\n"))


def test_the_table_of_a_campaign_names_its_sockets(touched: Path) -> None:
    arm = load_arm(_written(touched, ARM + PAIR, "known.toml"))
    rows = read_measurements(touched / "touches.csv", arm)
    assert set(rows.table["block"]) == {"a", "b"}
