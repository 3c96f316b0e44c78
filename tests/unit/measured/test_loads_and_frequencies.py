"""Frequencies, torques and forces as readings: from arm.toml and CSV to a calibrated arm, and what is refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.small_arms import ROBOTS

from armflex import Arm, Wrench, calibrate, load_arm, predict, read_measurements
from armflex.arm import Setup
from armflex.errors import ArmFileError, InputError, TableError
from armflex.estimate.view import look
from armflex.measured.table import write_table
from armflex.readings import Readings
from armflex.readings.instrument import Instrument
from armflex.rows import Rows

SENSORS = """
[instrument.ring]
kind = "frequency"
sigma = 0.002
[instrument.motor]
kind = "torque"
joint = "A2"
ratio = 120.0
friction_std = 2.0
sigma = 1.0
[instrument.cell]
kind = "force"
sigma = 5.0
[instrument.platform]
kind = "moment"
site = "base"
sigma = 50.0
"""

BOOM = ROBOTS / "tarm_like"


def declared(folder: Path, sensors: str = SENSORS, prior: str = "compliance = 0.3\nmass = 0.1\n") -> Path:
    """Return an arm.toml of the bundled boom with other instruments and priors."""
    text = (BOOM / "arm.toml").read_text().replace('"robot.urdf"', f'"{BOOM / "robot.urdf"}"')
    path = folder / "arm.toml"
    path.write_text(f"{text.partition('[prior]')[0]}\n[prior]\n{prior}{sensors}")
    return path


@pytest.fixture
def boom(tmp_path: Path) -> Arm:
    return load_arm(declared(tmp_path))


def poses(arm: Arm, count: int) -> np.ndarray:
    rng = np.random.default_rng(3)
    return 0.6 * rng.uniform(arm.robot.lower, arm.robot.upper, (count, len(arm.joint_names)))


def campaign(arm: Arm, path: Path, count: int = 8, noise: float = 0.0, **cells: list[str]) -> Path:
    """Write what an arm's instruments read, with so much of the stated noise."""
    q, rng = poses(arm, count), np.random.default_rng(8)
    rows = Rows.of(arm.joint_names, q, ("p600",) * count, {}, session="s", derived=("time",))
    kinds = tuple(one.kind.unread(count, one.sigma, name) for name, one in arm.sensors.items())
    view = look(Setup(arm, Instrument()), rows, readings=Readings(count, kinds))
    columns: dict = {"payload": ["p600"] * count} | {f"q_{name}": q[:, i] for i, name in enumerate(arm.joint_names)}
    for kind, place in view.readings.placed:
        read = -view.residual[:, place] + noise * kind.sigma * rng.normal(size=kind.sigma.shape)
        columns |= dict(zip(kind.columns(kind.name), read.T, strict=True))
    write_table(path, {name: list(values) for name, values in (columns | cells).items()})
    return path


def test_loads_are_those_of_the_arm(boom: Arm) -> None:
    """A drive's torque is the deflection's, a cell at the tool carries the payload, a platform everything."""
    q, push = poses(boom, 3), Wrench("tool", force=np.array([30.0, -20.0, 50.0]))
    rows = Rows.of(boom.joint_names, q, ("p600",) * 3, {}, session="s", derived=("time",))
    rows = replace(rows, wrenches=(push,))
    kinds = tuple(one.kind.unread(3, one.sigma, name) for name, one in boom.sensors.items())
    view = look(Setup(boom, Instrument()), rows, readings=Readings(3, kinds))
    read = {kind.name: -view.residual[:, place] for kind, place in view.readings.placed}
    drive, weight = boom.joint_names.index("A2"), np.array([0.0, 0.0, -9.81])
    for row in range(3):
        found = boom.deflection(q[row], "p600", wrenches=[push])
        approach = rows.approach[row, drive]
        assert boom.sensors["motor"].of("friction", ("s",)).item() == 0.0 and abs(approach) <= 1.0
        assert read["motor"][row, 0] == pytest.approx(-found.drive_loads[drive] / 120.0, rel=1e-9)
        carried = found.pose.rotation.T @ (600.0 * weight + push.force)
        np.testing.assert_allclose(read["cell"][row], carried, atol=1e-6 * np.linalg.norm(carried))
        ring = boom.modes(q[row], "p600", wrenches=[push]).frequencies[0]
        assert read["ring"][row, 0] == pytest.approx(ring, rel=1e-9)
    bodies = [boom.robot.urdf.links[name] for name in boom.link_names]
    levers = np.zeros(3)
    for link in bodies:
        if link.inertial is not None:
            pose = view.pose_of(link.name)[0]
            levers += link.inertial.mass * (pose[:3, 3] + pose[:3, :3] @ link.inertial.origin)
    tip = view.line.tip[0]
    levers += 600.0 * (tip[:3, 3] + tip[:3, :3] @ boom.payloads["p600"].com)
    moment = np.cross(levers, weight) + np.cross(tip[:3, 3], push.force)
    np.testing.assert_allclose(read["platform"][0], moment, atol=1e-6 * np.linalg.norm(moment))


@pytest.mark.slow
def test_masses_and_compliances_are_found_from_what_is_read(boom: Arm, tmp_path: Path) -> None:
    """What was put in, within its uncertainty; the file that is written gives the same arm, and its covariance."""
    wanted = {"boom1": 0.08, "boom2": -0.06}
    truth = boom.with_masses(wanted)
    path = campaign(truth, tmp_path / "campaign.csv", 12, noise=1.0)
    found = calibrate(boom, path)
    known = {one.name: one for one in found.parameters}
    for name, value in wanted.items():
        assert abs(known[f"mass {name}"].value - value) < 2.5 * known[f"mass {name}"].std
    back = load_arm(found.write(tmp_path / "fitted.toml"))
    assert back.masses == pytest.approx(found.arm.masses)
    assert back.certainty is not None and {f"mass {name}" for name in wanted} <= set(back.certainty.labels)
    declared, fitted, true = (
        {kind.name: (kind.values, std) for kind, std in predict(one, path).sensors} for one in (boom, back, truth)
    )
    for name in boom.sensors:
        before, after = (np.abs(one[name][0] - true[name][0]).max() for one in (declared, fitted))
        assert after < 0.5 * before or after < 2.0 * boom.sensors[name].sigma
        std = fitted[name][1]
        assert std is not None and np.isfinite(std).all() and std.max() > 0.0


def test_a_row_may_name_its_mode(boom: Arm, tmp_path: Path) -> None:
    q = poses(boom, 8)
    second = [boom.modes(one, "p600").frequencies[1] for one in q]
    path = campaign(boom, tmp_path / "rows.csv", ring=second, ring_mode=["2"] * 7 + [""])
    found = read_measurements(path, boom)
    view = look(Setup(boom, Instrument()), found)
    (place,) = (place for kind, place in view.readings.placed if kind.name == "ring")
    np.testing.assert_allclose(view.residual[:, place], 0.0, atol=1e-9)  # the last by its nearest
    assert found.table["ring_mode"][:7].tolist() == [2.0] * 7
    with pytest.raises(InputError, match=r"rows.csv:2: ring: there is no mode 99; the arm has \d+"):
        look(Setup(boom, Instrument()), read_measurements(campaign(boom, path, ring_mode=["99"] * 8), boom))
    with pytest.raises(InputError, match=r"rows.csv:2: ring reads 77 Hz, and no mode is near.*name the mode"):
        look(Setup(boom, Instrument()), read_measurements(campaign(boom, path, ring=["77"] * 8), boom))
    for cell in ("0", "1.5"):
        with pytest.raises(TableError, match=r"rows.csv:2: ring_mode is .*whole number"):
            read_measurements(campaign(boom, path, ring_mode=[cell] * 8), boom)
    with pytest.raises(TableError, match=r"rows.csv:2: ring is -1 Hz, expected more than 0"):
        read_measurements(campaign(boom, path, ring=["-1"] * 8), boom)


def test_an_axis_picks_the_mode_that_swings_along_it(boom: Arm, tmp_path: Path) -> None:
    q = boom.position(A2=0.3)
    for axis in ("[0, 0, 1]", "[0, 1, 0]"):
        arm = load_arm(declared(tmp_path, f'[instrument.hit]\nkind = "frequency"\naxis = {axis}\nsigma = 0.01\n'))
        rows = Rows.of(arm.joint_names, q[None], ("p600",), {}, session="s", derived=("time",))
        hit = arm.sensors["hit"].kind.unread(1, 0.01, "hit")
        view = look(Setup(arm, Instrument()), rows, readings=Readings(1, (hit,)))
        modes = arm.modes(q, "p600", count=12)
        way = arm.deflection(q, "p600").pose.rotation @ np.array(json.loads(axis), dtype=float)
        along = (modes.shapes[:, :3] @ way) ** 2 / modes.masses
        assert -view.residual[0, 0] == pytest.approx(modes.frequencies[along.argmax()], rel=1e-9)


@pytest.mark.parametrize(
    ("sensor", "said"),
    [
        ('kind = "torque"\nsigma = 1.0', "joint"),
        ('kind = "torque"\njoint = "A22"\nsigma = 1.0', "did you mean 'A2'"),
        ('kind = "torque"\njoint = "M1"\nsigma = 1.0', "slides: give `ratio`"),
        ('kind = "torque"\njoint = "A2"\nratio = 0.0\nsigma = 1.0', "turns of the motor"),
        ('kind = "frequency"\nmode = 0\nsigma = 0.1', "number of a mode"),
        ('kind = "frequency"\naxis = [0, 0, 0]\nsigma = 0.1', "expected a direction"),
        ('kind = "frequency"\nlink = "tool"\nsigma = 0.1', "link"),
        ('kind = "force"\nsite = "A9"\nsigma = 1.0', "known: base"),
        ('kind = "frequency"\nsigma = 0.0', "sigma"),
    ],
)
def test_a_declaration_that_says_nothing_is_refused(tmp_path: Path, sensor: str, said: str) -> None:
    with pytest.raises(ArmFileError, match=said):
        load_arm(declared(tmp_path, f"[instrument.one]\n{sensor}\n"))
