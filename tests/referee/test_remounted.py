"""A target that every session mounts anew: found session by session, kept, and uncertain where nobody saw it yet."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from support import three_joint_plant
from support.campaign_files import numbers, write_columns
from support.plant import Rows, apply

from armflex import Arm, Measurements, Reading, Tracker, calibrate, load_arm, predict, read_measurements
from armflex.errors import ArmFileError
from armflex.estimate.fit import realise
from armflex.estimate.view import look

SHIFTS = {"mon": (0.0, 0.0, 0.0), "tue": (0.008, -0.003, 0.004), "wed": (-0.006, 0.005, -0.007)}
"""Of the target in the tip frame [m]."""

PRIOR = "session_translation = 1e-4\nsession_rotation = 1e-5\nsession_target = 0.01\ncompliance"
NOISE = np.sqrt(3.0) * three_joint_plant.SIGMA


def campaign(
    folder: Path, prior: str = PRIOR, count: int = 90, sessions: tuple[str, ...] = tuple(SHIFTS), seed: int = 5
):
    """Return an arm and a campaign of it whose sessions have targets of their own."""
    plant, rng = three_joint_plant.declared(folder), np.random.default_rng(seed)
    file = folder / "arm.toml"
    file.write_text(file.read_text().replace("compliance =", f"{prior} =").replace(f"{prior} = [", "compliance = ["))
    names = [sessions[i * len(sessions) // count] for i in range(count)]
    plant.target = np.array([SHIFTS[name] for name in names])
    plant.offset = {joint.name: 1e-3 for joint in plant.joints[1:3]}
    q, still = rng.uniform(-1.2, 1.2, (count, 3)), np.zeros((count, 3))
    read = apply(three_joint_plant.STATION, plant.points(plant.relax(Rows.plain(q, np.zeros(count), still))))
    read += rng.normal(0.0, three_joint_plant.SIGMA, read.shape)
    columns = {f"q_J{i + 1}": numbers(q[:, i]) for i in range(3)} | dict(zip("xyz", map(numbers, read.T), strict=True))
    write_columns(folder / "rows.csv", columns | {"session": names, "sigma": [three_joint_plant.SIGMA] * count})
    arm = load_arm(file)
    return arm, read_measurements(folder / "rows.csv", arm)


def error(arm: Arm, rows: Measurements) -> float:
    """Return the RMS of the 3-D error of what an arm predicts, over the noise."""
    return float(np.sqrt(((predict(arm, rows).position - rows.position) ** 2).sum(axis=1).mean()) / NOISE)


def test_every_session_has_its_own_target(tmp_path: Path) -> None:
    arm, rows = campaign(tmp_path)
    found = calibrate(arm, rows)
    targets = {name: found.arm.instrument.targets[name][:3] for name in SHIFTS}
    for name in ("tue", "wed"):
        np.testing.assert_allclose(targets[name] - targets["mon"], SHIFTS[name], rtol=0, atol=2e-4)
    assert found.arm.corrections.joint_offset["J2"] == pytest.approx(1e-3, abs=1e-4)
    told = {one.name: (one.determined, one.trades_against) for one in found.parameters}
    assert not told["joint_offset J3"][0]  # of which a target on the last link tells nothing, wherever it was mounted
    assert any(name.startswith("session_target") for name in told["joint_offset J3"][1])
    written = load_arm(found.write(tmp_path / "fitted.toml"))
    assert 0.9 < error(found.arm, rows) < 1.1
    np.testing.assert_allclose(predict(written, rows).position, predict(found.arm, rows).position, rtol=0, atol=1e-9)
    scale = np.sqrt(np.diag(found.arm.certainty.covariance))  # an entry beside much larger ones is rounding
    there, here = (one.certainty.covariance / np.outer(scale, scale) for one in (written, found.arm))
    np.testing.assert_allclose(there, here, rtol=0, atol=1e-9)
    bare = replace(arm, prior=replace(arm.prior, session_target=0.0))
    assert error(calibrate(bare, rows, anyway=True).arm, rows) > 20.0


def test_a_session_that_nobody_saw_is_as_uncertain_as_its_target(tmp_path: Path) -> None:
    arm, rows = campaign(tmp_path)
    known = calibrate(arm, rows).arm
    seen, new = (predict(known, replace(rows, session=(name,) * len(rows))) for name in ("tue", "thu"))
    assert np.sqrt((seen.sigma**2).sum(axis=1)).max() < 1e-3
    assert np.sqrt((new.sigma**2).sum(axis=1)).min() > 0.01 * np.sqrt(3.0)
    assert {flag.code for flag in new.flags} >= {"new_session"} and "new_session" not in {f.code for f in seen.flags}


def test_what_is_kept_is_shown_another_target(tmp_path: Path) -> None:
    arm, rows = campaign(tmp_path)
    known = calibrate(arm, rows).arm
    (tmp_path / "later").mkdir()
    _, later = campaign(tmp_path / "later", sessions=("wed",), seed=9)
    again = calibrate(known, later, keep=True)
    assert error(again.arm, later) < 1.2 and again.arm.corrections.joint_offset == known.corrections.joint_offset


def test_what_the_frame_tells_as_well_is_said(tmp_path: Path) -> None:
    # Without a prior for where the instrument stands, and no pose that turns the tool: frame and target are one.
    arm, rows = campaign(tmp_path, PRIOR.replace("1e-4", "1.0").replace("1e-5", "1.0"))
    still = replace(rows, q=rows.q * [1.0, 0.0, 0.0])
    at = np.array([arm.rigid_pose(q).translation for q in still.q])
    found = calibrate(arm, replace(still, position=at @ three_joint_plant.STATION[:3, :3].T), anyway=True)
    open_ = {one.name: one.trades_against for one in found.undetermined}
    assert any(name.startswith("session_target") for name in open_)


def test_its_columns_are_its_changes(tmp_path: Path) -> None:
    arm, rows = campaign(tmp_path)
    found = calibrate(arm, rows).fit
    block = next(one for one in found.blocks if one.kind == "session_target")
    jacobian, own = block.jacobian(found.view), found.places(block)
    assert len(own) == 9
    for number, place in enumerate(own):
        ends = []
        for side in (1e-5, -1e-5):
            values = found.values.copy()
            values[place] += side
            view = look(realise(found.declared, found.blocks, values), rows, found.view.rows)
            ends.append(-view.residual)
        np.testing.assert_allclose(jacobian[:, :, number], (ends[0] - ends[1]) / 2e-5, rtol=0, atol=1e-6)


def test_orientations_are_mounted_anew_as_well(tmp_path: Path) -> None:
    arm, rows = campaign(tmp_path)
    turns = {"mon": (0.0, 0.0, 0.0), "tue": (0.4, -1.2, 2.0), "wed": (-0.3, 0.2, 0.1)}
    tips = calibrate(arm, rows).fit.view.line.tip
    read = [
        pin.log3(three_joint_plant.STATION[:3, :3] @ tip[:3, :3] @ pin.exp3(np.array(turns[name])))
        for tip, name in zip(tips, rows.session, strict=True)
    ]
    turned = Measurements.of(rows, rows.readings)
    turned = replace(turned, rotation=np.array(read), sigma_r=np.full(len(rows), 1e-4))
    found = calibrate(arm, turned)
    assert not any(one.kind == "mounting" for one in found.parameters)
    instrument = found.arm.instrument
    for name, turn in turns.items():
        mounted = pin.exp3(instrument.mounting_in([name])[0])
        assert np.linalg.norm(pin.log3(mounted.T @ pin.exp3(np.array(turn)))) < 1e-3
    np.testing.assert_allclose(predict(found.arm, turned).position, rows.position, rtol=0, atol=6e-4)
    with pytest.raises(Exception, match="sessions turned the target"):
        Tracker(found.arm)


def test_a_tracker_takes_a_new_target_in_a_new_session(tmp_path: Path) -> None:
    arm, rows = campaign(tmp_path)
    tracker = Tracker(calibrate(arm, rows).arm)
    (tmp_path / "later").mkdir()
    _, later = campaign(tmp_path / "later", sessions=("wed",), seed=9)
    for q, position in zip(later.q, later.position, strict=True):
        tracker.update(Reading(q, position, three_joint_plant.SIGMA, session="new"))
    assert error(tracker.arm, replace(later, session=("new",) * len(later))) < 2.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("session_target = -0.01", "session_target"),
        ("session_target = [0.01]", "expected a number"),
        ("session_targets = 0.01", "did you mean 'session_target'"),
    ],
)
def test_what_a_prior_may_get_wrong(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ArmFileError, match=said):
        campaign(tmp_path, PRIOR.replace("session_target = 0.01", text))
