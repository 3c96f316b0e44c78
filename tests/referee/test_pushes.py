"""An arm whose stiffness is a fifth wrong, pushed forty times with a known force: the drives' own come out of it.

The machine is plain numpy and shares no code with armflex; its forces act on its bodies as `force_*` columns say.
"""

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.campaign_files import write_columns
from support.command_line import fine, run_here, strict_json
from support.plant import Array, Plant, Push, Rows, State, pose
from support.small_arms import ROBOTS

from armflex import Arm, Measurements, Reading, Tracker, Wrench, calibrate, load_arm, predict, read_measurements
from armflex.errors import InputError, ShapeError, UnknownNameError

JOINTS = tuple(f"J{i}" for i in range(1, 7))
DECLARED = np.array([2.5e6, 3.3e6, 2.2e6, 5.5e5, 5e5, 3.3e5])  # Nm/rad, about the drives
FACTORS = np.array([1.2, 0.8, 1.2, 0.8, 1.2, 0.8])  # of the true compliances to the declared ones
FORCE, NOISE = 1500.0, 2e-5

URDF = ROBOTS / "heavy_six" / "robot.urdf"
TOOL = (0.1, 0.25, 0.05)  # beside the last axis: pushes turn every drive
ROBOT = f"""[robot]
urdf = "{URDF}"
tip = "tool"
tool = {{ xyz = {list(TOOL)} }}
base = "base"
gravity = [0.0, 0.0, -9.81]
"""
REST = """
[measurement]
frame = "base"
[prior]
compliance = 0.3
"""


@functools.cache
def machine() -> Plant:
    """Return the true machine."""
    plain = "".join(f'[flexure.{name}]\njoint = "{name}"\ncompliance = [0, 0, 0, 0, 0, 0]\n' for name in JOINTS)
    plant = Plant.read_text(ROBOT + plain)
    plant.tip = plant.tip @ pose(np.array(TOOL), np.eye(3))
    for joint, factor, stiffness in zip(plant.joints, FACTORS, DECLARED, strict=True):
        plant.compliance[joint.name] = np.diag(joint.drive * factor / stiffness)
    return plant


def pushed(folder: Path, seed: int, links: tuple[str, ...], count: int = 40, held: int = 0) -> Path:
    """Write a campaign of pushes in random poses and directions, at each of some links in turn; '' is the tip.

    The first `held` of them turn with their links.
    """
    rng, plant = np.random.default_rng(seed), machine()
    q = rng.uniform(-1.0, 1.0, (count, 6))
    force = rng.normal(size=(count, 3))
    force *= FORCE / np.linalg.norm(force, axis=1)[:, None]
    bodies = np.array([["link1", "link2", "link3", "link4", "link5", "link6", ""].index(links[i % len(links)])
                       for i in range(count)])  # fmt: skip
    turning = np.arange(count) < held

    def push(state: State, into: Push) -> None:
        for body in np.unique(bodies):
            frame, own = state.frames[:, body], (bodies == body)[:, None]
            turned = np.where(turning[:, None], (frame[:, :3, :3] @ force[:, :, None])[:, :, 0], force)
            into.loads.append((int(body), np.where(own, turned, 0.0), frame[:, :3, 3]))

    rows = Rows.plain(q, np.zeros(count), np.zeros((count, 3)))
    seen = plant.points(plant.relax(rows, [push])) + rng.normal(0.0, NOISE, (count, 3))
    columns: dict[str, list] = {f"q_{name}": q[:, i].tolist() for i, name in enumerate(JOINTS)}
    columns |= {axis: seen[:, i].tolist() for i, axis in enumerate("xyz")} | {"sigma": [NOISE] * count}
    columns |= {f"force_f{axis}_kN": (1e-3 * force[:, i]).tolist() for i, axis in enumerate("xyz")}
    columns["force_frame"] = [links[i % len(links)] for i in range(count)]
    columns["force_axes"] = ["link" if one else "base" for one in turning]
    path = folder / f"pushes_{seed}.csv"
    write_columns(path, columns)
    return path


def declared(folder: Path) -> Path:
    text = "".join(
        f'[flexure.{name}]\njoint = "{name}"\njoint_stiffness = {value}\n'
        for name, value in zip(JOINTS, DECLARED, strict=True)
    )
    path = folder / "arm.toml"
    path.write_text(ROBOT + text + REST)
    return path


def factors(arm: Arm) -> Array:
    """Return what the drives' compliances are of those declared."""
    drives = [joint.axis for joint in arm.robot.moving]
    tangents = [flexure.law.tangent(np.zeros(6), None)[3:, 3:] for flexure in arm.flexures]
    return np.array([a @ c @ a for a, c in zip(drives, tangents, strict=True)]) * DECLARED


@pytest.mark.parametrize(("links", "held"), [(("",), 0), (("", "link6", "link4"), 20)])
def test_forty_pushes_tell_the_stiffness(tmp_path: Path, links: tuple[str, ...], held: int) -> None:
    arm = load_arm(declared(tmp_path))
    rows = read_measurements(pushed(tmp_path, 1, links, held=held), arm)
    found = calibrate(arm, rows)
    known = found.arm.certainty
    std = np.sqrt(np.diag(known.covariance))  # of the factors' logarithms
    alone = std / np.sqrt(known.design_effect)  # were all readings independent
    assert len(std) == 6 and alone.max() < 0.04 * np.sqrt(len(links))  # as many fewer push at the tip
    assert (np.abs(np.log(factors(found.arm) / FACTORS)) < 3.0 * std).all()
    again = read_measurements(pushed(tmp_path, 2, links, held=held), arm)
    before, after = (rms(one, again) for one in (arm, found.arm))
    assert after < 1.3 * np.sqrt(3.0) * NOISE and before > 10.0 * after
    # Without the columns the same rows say nothing of what gives.
    silent = calibrate(arm, replace(rows, wrenches=()))
    assert np.abs(factors(silent.arm) - FACTORS).max() > 0.1


def test_a_tracker_takes_pushes_one_by_one(tmp_path: Path) -> None:
    """At the tip and other links, in base and link axes; saved and restored between, with those it keeps."""
    arm = load_arm(declared(tmp_path))
    rows = read_measurements(pushed(tmp_path, 1, ("", "link6", "link4"), held=20), arm)
    readings = [Reading.of(rows, row) for row in range(len(rows))]
    assert {one.frame for reading in readings for one in reading.wrenches} == {"tcp", "link6", "link4"}
    tracker = Tracker(arm)
    for i, reading in enumerate(readings):
        if i == 3:
            tracker = Tracker.restore(tracker.save(tmp_path / "state"), arm)
        tracker.update(reading)
        if tracker.stale:
            tracker.relinearise()
    whole = calibrate(arm, rows).arm
    std = np.sqrt(np.diag(whole.certainty.covariance))  # of the factors' logarithms
    assert (np.abs(np.log(factors(tracker.arm) / factors(whole))) < 0.1 * std).all()
    silent = Tracker(arm)
    for reading in readings:
        silent.update(replace(reading, wrenches=()))
    assert np.abs(factors(silent.arm) - FACTORS).max() > 0.1
    before = tracker.values
    for bad, kind, said in (
        ([Wrench("link7", np.ones(3), np.zeros(3))], UnknownNameError, "no link named 'link7', did you mean 'link6'"),
        ([Wrench("tcp", np.ones((2, 3)), np.zeros(3))], ShapeError, r"expected force and moment \(3,\)"),
        ([(1.0, 0.0, 0.0)], InputError, "wrenches: expected loads from outside"),
    ):
        with pytest.raises(kind, match=said):
            tracker.update(replace(readings[0], wrenches=bad))
    assert (tracker.values == before).all() and tracker.readings == len(readings)


def rms(arm: Arm, rows: Measurements) -> float:
    """Return how far readings are from what is predicted [m]."""
    return float(np.sqrt(((predict(arm, rows).position - rows.position) ** 2).sum(axis=1).mean()))


def test_a_calibrated_file_keeps_the_stiffness_it_was_given(tmp_path: Path) -> None:
    path = declared(tmp_path)
    arm = load_arm(path)
    rows = read_measurements(pushed(tmp_path, 3, ("",)), arm)
    found = calibrate(arm, rows)
    text = found.write(tmp_path / "calibrated.toml").read_text()
    assert "joint_stiffness = 2500000.0" in text and "compliance = [" not in text.partition("[calibration]")[0]
    np.testing.assert_allclose(factors(load_arm(tmp_path / "calibrated.toml")), factors(found.arm), rtol=1e-9)


@pytest.mark.slow
def test_calibrate_and_report_take_a_force_for_rows_that_name_none(tmp_path: Path) -> None:
    """The first twenty rows without columns and pushed alike, the rest with columns of their own."""
    arm, path = declared(tmp_path), pushed(tmp_path, 5, ("",))
    head, *lines = path.read_text().splitlines()
    names, rows = head.split(","), [line.split(",") for line in lines]
    forces, blank = [names.index(f"force_f{axis}_kN") for axis in "xyz"], [row.copy() for row in rows]
    for row, bare in zip(rows[:20], blank[:20], strict=True):
        for place, value in zip(forces, ("0", "0.25", "-1.5"), strict=True):
            row[place], bare[place] = value, ""
        bare[names.index("force_axes")] = ""
    told = {}
    for name, table, options in (("full", rows, ()), ("bare", blank, ("--force", "fz=-1.5kN,fy=250N"))):
        (tmp_path / f"{name}.csv").write_text("\n".join([head, *(",".join(row) for row in table)]) + "\n")
        asked = ["arm.toml", f"{name}.csv", *options, "--json", f"{name}.json"]
        fine(run_here(tmp_path, "calibrate", *asked, "-o", f"{name}.toml", "--anyway"))
        told[name] = strict_json(tmp_path / f"{name}.json")
    assert told["full"] == told["bare"] and arm.exists()
    wrong = ["arm.toml", "bare.csv", "-o", "w.toml"]
    for option, said in (("fz=5mm", "'mm' is no unit of force"), ("fz=5N,frame=link7", "no link named 'link7'")):
        assert said in fine(run_here(tmp_path, "calibrate", *wrong, "--force", option), 2).stderr
        assert said in fine(run_here(tmp_path, "trace", *wrong, "--force", option), 2).stderr
        assert said in fine(run_here(tmp_path, "report", "--iso9283", *wrong, "--force", option), 2).stderr
    assert "no payload named 'p1'" in fine(run_here(tmp_path, "trace", *wrong, "--payload", "p1"), 2).stderr
    assert not (tmp_path / "w.toml").exists()
