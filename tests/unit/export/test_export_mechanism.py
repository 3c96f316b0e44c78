"""Exports of arms with loops: the tree with its passive joints where the rigid loops close; C is the engine itself."""

import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from support.arms import bundled
from support.compiled_arm import COMPILER, compiled
from support.exported import Sheet
from support.machines import MACHINES, poses, skewed
from support.sprung_arm import BALANCER, STRUT, TIE, sprung

from armflex import Arm
from armflex.errors import UnsupportedError
from armflex.export import c_code, sheet, urdf_file, yaml_files
from armflex.laws.joint.hardening import HardeningLaw
from armflex.robot import Corrections

FOUND = {
    "five_bar": Corrections(
        {"left": 2e-3}, {"pitch": np.full(6, 1e-3), "right": np.full(6, -8e-4), "left_side": np.full(6, 5e-4)}
    ),
    "crane": Corrections({"slew": 1e-3, "lift": 4e-3}, {"boom": np.array([2e-3, 1e-3, -1e-3, 0, 1e-3, 0])}),
}
"""What calibration may have found: zeros, a cylinder's among them, and frames on the chain and beside it."""


@pytest.fixture(params=FOUND)
def arm(request: pytest.FixtureRequest, tmp_path: Path) -> Arm:
    return replace(MACHINES[request.param].load(tmp_path), corrections=FOUND[request.param])


@pytest.fixture
def rows(arm: Arm, tmp_path: Path) -> Path:
    """Return a file of rows in which the loops close."""
    text = "\n".join(",".join(map(repr, q.tolist())) for q in rows_of(arm))
    path = tmp_path / "rows.csv"
    path.write_text(",".join(f"q_{name}" for name in arm.joint_names) + f"\n{text}\n")
    return path


def rows_of(arm: Arm) -> np.ndarray:
    return poses("crane" if "lift" in arm.joint_names else "five_bar")


def rigid(arm: Arm) -> list[tuple[dict[str, float], np.ndarray]]:
    """Return where all joints stand in some rows, and the pose of the tip of the calibrated arm that does not give."""
    stiff, found = replace(arm, flexures=()), []
    for q in rows_of(arm):
        one = stiff.deflection(q)
        found.append(({**dict(zip(arm.joint_names, q.tolist(), strict=True)), **one.passive}, one.pose.homogeneous))
    return found


def test_the_urdf_has_the_tip_where_its_joints_stand_as_in_the_closed_loops(arm: Arm, rows: Path) -> None:
    exported = urdf_file.export(arm, rows)
    model = pin.buildModelFromXML(exported.text)
    data = model.createData()
    for known, wanted in rigid(arm):
        at = pin.neutral(model)
        for joint in list(model.joints)[1:]:
            at[joint.idx_q] = known[model.names[joint.id]]
        pin.framesForwardKinematics(model, data, at)
        np.testing.assert_allclose(data.oMf[model.getFrameId("tool", pin.BODY)].homogeneous, wanted, atol=1e-9)
    told = " ".join(exported.notes)
    for name in (*arm.robot.linkage.closures, *(one.name for one in arm.robot.swept if one.name in known)):
        assert name in told or name in arm.joint_names
    assert ("lift by 4 mm" in told) == ("lift" in arm.joint_names)
    assert exported.numbers["left_out"][0]["most"] > 1e-4 and exported.numbers["loops_open_m"] > 1e-3


def test_the_sheet_has_a_row_for_every_joint_of_the_chain_and_the_zeros_of_all_drives(
    arm: Arm, rows: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sheet, "configurations", rows_of)
    found = Sheet(sheet.export(arm, rows).text)
    offsets, chain = arm.corrections.joint_offset, [joint.name for joint in arm.robot.swept]
    for known, wanted in rigid(arm):
        # Passive joints have no reading and no zero.
        for form in ("dh_standard", "dh_modified"):
            np.testing.assert_allclose(found.tip(np.array([known[name] for name in chain]), form), wanted, atol=1e-9)
    for name, value in offsets.items():
        assert found.value["joint_offset", name, "offset"] == pytest.approx(value, abs=1e-2)  # and what frames turn
    assert "joint_offset" not in {section for section, of, _ in found.value if of not in arm.joint_names}


def test_robot_calibration_has_zeros_of_drives_and_frames_of_all_joints(arm: Arm, rows: Path) -> None:
    text = yaml_files.export(arm, "robot_calibration", rows).text
    lines = dict(line.split(": ") for line in text.splitlines())
    offsets, cylinders = arm.corrections.joint_offset, [one.name for one in arm.robot.linkage.cylinders]
    drives = {name: offsets.get(name, 0.0) for name in arm.joint_names if name not in cylinders}
    assert {name: float(lines[name]) for name in arm.joint_names if name in lines} == drives
    assert not {*arm.robot.linkage.free} & {*lines}
    for name in arm.corrections.geometry:
        assert float(lines[f"{name}_x"]) != 0.0


@pytest.mark.parametrize("name", ["palletizer", "hybrid_lifter"])
def test_no_loops_are_refused_by_name(name: str) -> None:
    with pytest.raises(UnsupportedError, match="ur_calibration"):
        yaml_files.export(bundled(name), "ur_calibration")


# C.

EXPORTED: dict[str, Callable[[Path], Arm]] = {
    **{name: lambda _, name=name: bundled(name) for name in ("palletizer", "hybrid_lifter")},
    **{name: lambda folder, name=name: MACHINES[name].load(folder) for name in MACHINES},
    "skewed": lambda folder: skewed(MACHINES["crane"].load(folder)),
    "calibrated": lambda folder: replace(MACHINES["crane"].load(folder), corrections=FOUND["crane"]),
    "springs": lambda folder: sprung(folder, (BALANCER, TIE, STRUT), full=True),
}


def configurations(name: str, arm: Arm, count: int) -> np.ndarray:
    """Return positions of the drives, each not far from the one before."""
    machine = {"calibrated": "crane", "skewed": "crane"}.get(name, name)
    if machine in MACHINES:
        return poses(machine, count)
    way, ends = np.linspace(-0.3, 0.3, count)[:, None], (arm.robot.lower, arm.robot.upper)
    return np.clip(arm.position() + way * np.minimum(ends[1] - ends[0], 1.0), *ends)


@pytest.mark.slow
@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")
@pytest.mark.filterwarnings("ignore::armflex.errors.ArmflexWarning")
@pytest.mark.parametrize("name", EXPORTED)
def test_loops_and_springs_in_c_are_those_of_the_reference(name: str, tmp_path: Path) -> None:
    """Cold and followed, under every payload; and where the flexed tip is brought to."""
    arm = EXPORTED[name](tmp_path)
    code, q = compiled(arm, tmp_path), configurations(name, arm, 6)
    payload = np.arange(len(q)) % len(code.payloads)
    codes, cold = code.tips(q, payload)
    assert not codes.any()
    codes, followed = code.followed(q, payload)
    assert not codes.any()
    expected = [
        arm.deflection(row, code.payloads[number], method="newton").pose.homogeneous[:3]
        for row, number in zip(q, payload.tolist(), strict=True)
    ]
    np.testing.assert_allclose(cold, expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(followed, expected, rtol=0, atol=1e-12)
    inner = q[1:-1]
    codes, found = code.compensated(inner, payload[1:-1])
    assert not codes.any()
    for row, reached, number in zip(inner, found, payload[1:-1].tolist(), strict=True):
        tip = arm.deflection(reached, code.payloads[number], enforce_limits=False).pose.translation
        np.testing.assert_allclose(tip, arm.rigid_pose(row).translation, rtol=0, atol=1e-10)


@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")
def test_c_of_loops_has_a_code_for_what_it_cannot_answer(tmp_path: Path) -> None:
    arm = MACHINES["crane"].load(tmp_path)
    code, q = compiled(arm, tmp_path), np.tile(poses("crane")[0], (5, 1))
    q[1, 1:], q[2, 0], q[3, 0] = (1.55, 1.9), np.nan, 999.0
    codes, found = code.tips(q, np.array([0, 0, 0, 0, 99]))
    assert codes.tolist() == [0, 7, 1, 2, 3] and np.isnan(found[1:]).all()
    state = np.array([1.0, *q[0], *([np.nan] * len(arm.robot.linkage.free))])
    assert code.followed(q[:1], np.zeros(1, int), state)[0].tolist() == [1]


@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")
def test_c_of_loops_takes_no_more_stack_than_it_says(tmp_path: Path) -> None:
    found = c_code.export(MACHINES["five_bar"].load(tmp_path))
    (tmp_path / "arm.c").write_text(found.text)
    run = [COMPILER, "-std=c99", "-O2", "-fstack-usage", "-c", "arm.c"]
    subprocess.run(run, cwd=tmp_path, check=True, timeout=600)
    rows = (line.split("\t") for line in (tmp_path / "arm.su").read_text().splitlines())
    taken = {place.rpartition(":")[2]: int(size) for place, size, _ in rows}
    own = {name: taken.pop(f"arm_{name}") for name in ("tip", "follow", "compensate")}
    below = sum(taken.values())
    for name, size in own.items():
        assert size + below <= found.numbers["stack_bytes"][name]


def test_c_of_loops_refuses_laws_that_it_does_not_know_by_name(tmp_path: Path) -> None:
    arm = MACHINES["five_bar"].load(tmp_path)
    first, *others = arm.flexures
    arm = replace(arm, flexures=(replace(first, law=HardeningLaw(np.eye(6) * 1e-7, 1.0)), *others))
    with pytest.raises(UnsupportedError, match=f"flexure '{first.name}' is curved in the load"):
        c_code.export(arm)
