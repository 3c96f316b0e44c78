"""The joint of the source paper as presets of tarm_like: its files, what each reading does, and the composed joint."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.small_arms import ROBOTS, skew_parts

from armflex import Arm, load_arm, load_law, read_joint_data, save_law, train
from armflex.errors import ArmflexWarning, SmallDisplacementError, UnknownNameError
from armflex.laws import AtNode, LinearLaw, Row, StructuralLaw

FOLDER = ROBOTS / "tarm_like"
Preset = Callable[[str], Arm]
STRAIGHT = np.zeros(7)


def fitted(unit: str) -> np.ndarray:
    """Return Table I's (3, 3) compliance by plain least squares, [m/N]."""
    table = np.genfromtxt(FOLDER / "a4_table_1.csv", delimiter=",", skip_header=1)
    return np.linalg.lstsq(table[:, :3] * 1e3, table[:, 3:6] * {"mm": 1e-3, "um": 1e-6}[unit], rcond=None)[0].T


@pytest.mark.parametrize("unit", ["mm", "um"])
def test_committed_files_are_what_train_makes(unit: str, tmp_path: Path) -> None:
    committed = load_law(FOLDER / f"paper_A4_{unit}.safetensors")
    made = train(read_joint_data(FOLDER / "a4_table_1.csv", {"mm": unit})).trained
    made = load_law(save_law(made, tmp_path / "a.safetensors"))
    assert committed.model == made.model == "linear"
    np.testing.assert_allclose(committed.law.compliance, made.law.compliance, rtol=1e-9, atol=1e-20)
    for name in ("row_covariance", "residual_std", "loads"):
        np.testing.assert_allclose(getattr(committed.law.fit, name), getattr(made.law.fit, name), rtol=1e-9, atol=1e-40)
    assert set(committed.metadata) == set(made.metadata)
    for name in ("data", "sha256", "rows", "units", "structure", "held_out"):
        assert committed.metadata[name] == made.metadata[name], name
    for name in ("train_rms", "held_out_rms"):
        np.testing.assert_allclose(committed.metadata[name], made.metadata[name], rtol=1e-9)
    np.testing.assert_allclose(committed.law.compliance[:3, :3], fitted(unit), rtol=1e-9)


@pytest.mark.parametrize(("unit", "preset"), [("mm", "paper_A4_literal"), ("um", "paper_A4_um")])
def test_joint_gives_the_table_times_its_load(tarm_preset: Preset, unit: str, preset: str) -> None:
    """The law acts at the upper bearing, 0.25 m up: forces only, no lever arm, no rotation of its own."""
    arm = tarm_preset(preset)
    found = arm.deflection(STRAIGHT, "p600", allow_large=True)
    place = arm.flexure_names.index("A4")
    np.testing.assert_allclose(found.twists[place, :3], fitted(unit) @ found.wrenches[place, :3], rtol=1e-9)
    assert not found.twists[place, 3:].any()
    drive = arm.flexure_names.index("A4_drive")
    turned = [4e-8, 4e-8, 2.5e-7] * found.wrenches[drive, 3:]
    rounding = np.finfo(float).eps * np.abs(turned).max()  # of axes that bear almost nothing beside one that does
    np.testing.assert_allclose(found.twists[drive, 3:], turned, rtol=1e-9, atol=rounding)
    assert not found.twists[drive, :3].any()


def test_table_as_printed_is_no_machine(tarm_preset: Preset) -> None:
    found = tarm_preset("paper_A4_literal").deflection(STRAIGHT, "p600", allow_large=True)
    place = found.names.flexures.index("A4")
    assert np.linalg.norm(found.wrenches[place, :3]) == pytest.approx(16.28e3, rel=1e-3)
    assert np.linalg.norm(found.twists[place, :3]) == pytest.approx(0.767, abs=5e-4)
    assert "large_sag" in {flag.code for flag in found.flags}
    with pytest.warns(ArmflexWarning, match="soft: flexure 'A4'"):
        load_arm(FOLDER / "arm.toml", preset="paper_A4_literal")


def test_read_in_micrometres_it_gives_a_thousandth(tarm_preset: Preset) -> None:
    found, printed = (
        tarm_preset(name).deflection(STRAIGHT, "p600", allow_large=True) for name in ("paper_A4_um", "paper_A4_literal")
    )
    place = found.names.flexures.index("A4")
    gives, printed_gives = (np.linalg.norm(one.twists[place, :3]) for one in (found, printed))
    assert gives == pytest.approx(1e-3 * printed_gives, rel=0.02)  # the loads turn with a sag of a metre
    assert 0.7e-3 < gives < 0.8e-3 and "large_sag" not in {flag.code for flag in found.flags}
    assert "soft" not in {flag.code for flag in tarm_preset("paper_A4_um").flags}
    assert "soft" in {flag.code for flag in tarm_preset("paper_A4_literal").flags}


def test_preset_changes_only_its_own_flexures(tarm: Arm, tarm_preset: Preset) -> None:
    arm = tarm_preset("paper_A4_um")
    assert set(arm.flexure_names) == {*tarm.flexure_names, "A4_drive"} and len(arm.flexure_names) == 8
    mine = {flexure.name: flexure for flexure in tarm.flexures}
    for flexure in arm.flexures:
        if flexure.name not in ("A4", "A4_drive"):
            assert type(flexure.law) is type(mine[flexure.name].law)
            row = Row(STRAIGHT, {name: i for i, name in enumerate(arm.joint_names)})
            wrench = np.arange(1.0, 7.0)
            np.testing.assert_array_equal(flexure.law.twist(wrench, row), mine[flexure.name].law.twist(wrench, row))
    law = next(flexure.law for flexure in arm.flexures if flexure.name == "A4")
    assert isinstance(law, AtNode) and isinstance(law.law, LinearLaw) and law.node.tolist() == [0.0, 0.0, 0.25]


def beam(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the (12, 12) stiffness of a fork arm, by inverting the textbook's flexibility of a cantilever."""
    e, g, area, iy, iz, twist = 210e9, 81e9, 0.024, 1.28e-5, 1.8e-4, 4.26e-5
    length = np.linalg.norm(end - start)
    x = (end - start) / length
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    turn = np.kron(np.eye(2), np.column_stack([x, y, np.cross(x, y)]))
    bending = [length**3 / (3 * e * iz), length**3 / (3 * e * iy)]
    turning = [length / (g * twist), length / (e * iy), length / (e * iz)]
    flexibility = np.diag([length / (e * area), *bending, *turning])
    flexibility[1, 5] = flexibility[5, 1] = length**2 / (2 * e * iz)
    flexibility[2, 4] = flexibility[4, 2] = -(length**2) / (2 * e * iy)
    free_end = turn @ np.linalg.inv(flexibility) @ turn.T
    carry = np.eye(6)  # motion of the far end when the near end moves as a rigid body
    carry[:3, 3:] = -skew_parts(end - start)
    both = np.hstack([-carry, np.eye(6)])
    return both.T @ free_end @ both


def by_hand() -> np.ndarray:
    """Return the (6, 6) compliance of the bundled nodes, with Table I's rows at the bearings."""
    nodes = [np.array(node) for node in ((0, 0, 0.25), (0, 0, -0.25), (0.3, 0, 0))]
    stiffness = np.zeros((18, 18))
    bearing = np.linalg.inv(fitted("um"))
    stiffness[0:3, 0:3] += bearing
    stiffness[6:9, 6:9] += bearing
    stiffness[11, 11] += 1.0 / 2.5e-7
    for start in (0, 1):
        dofs = np.concatenate([6 * start + np.arange(6), 12 + np.arange(6)])
        stiffness[np.ix_(dofs, dofs)] += beam(nodes[start], nodes[2])
    tip = np.linalg.inv(stiffness)[12:, 12:]
    to_origin = np.eye(6)  # motion of the joint's origin when the tip node moves as a rigid body
    to_origin[:3, 3:] = skew_parts(nodes[2])
    return to_origin @ tip @ to_origin.T


def test_composed_joint_is_the_assembly_by_hand(tarm_preset: Preset, tmp_path: Path) -> None:
    """Two bearings that hold translations, a drive that holds the turn about z, and two fork arms to the tip.

    So is the paper's linear model, learned on 91 random loads of that assembly: its elements are linear.
    """
    arm, expected = tarm_preset("paper_A4_composed"), by_hand()
    law = next(flexure.law for flexure in arm.flexures if flexure.name == "A4")
    assert isinstance(law, StructuralLaw)
    rows = np.random.default_rng(0).uniform(-5e3, 5e3, (91, 6))
    head = "fx_N,fy_N,fz_N,mx_Nm,my_Nm,mz_Nm,dx_mm,dy_mm,dz_mm,rx_mrad,ry_mrad,rz_mrad"
    np.savetxt(tmp_path / "r.csv", np.c_[rows, 1e3 * rows @ expected.T], "%.17g", ",", header=head, comments="")
    learned = train(read_joint_data(tmp_path / "r.csv")).trained.law.constant
    assert learned is not None
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(law.constant / scale, expected / scale, atol=1e-9)
    np.testing.assert_allclose(learned / scale, law.constant / scale, atol=1e-9)


def test_composed_joint_loads_and_is_a_machine(tarm_preset: Preset) -> None:
    found = tarm_preset("paper_A4_composed").deflection(STRAIGHT, "p600")
    place = found.names.flexures.index("A4")
    assert np.linalg.norm(found.twists[place, 3:]) > 1e-5 and found.covariance is not None
    assert "large_sag" not in {flag.code for flag in found.flags}


def test_composed_joint_of_such_soft_bearings_is_refused(tarm_preset: Preset) -> None:
    """With bearings as the table is printed the joint would turn beyond what a compliance describes."""
    arm = tarm_preset("paper_A4_composed")
    composed = next(flexure for flexure in arm.flexures if flexure.name == "A4")
    soft = [type(sub)(sub.node, LinearLaw(1e3 * sub.law.compliance), sub.holds) for sub in composed.law.subjoints]
    law = StructuralLaw(composed.law.nodes, composed.law.tip, tuple(soft), composed.law.beams)
    flexures = tuple(type(f)(f.name, f.joint, law) if f.name == "A4" else f for f in arm.flexures)
    with pytest.raises(SmallDisplacementError, match="flexure 'A4' turns by"):
        Arm(arm.robot, flexures, arm.payloads).deflection(STRAIGHT, "p600")


@pytest.mark.slow
def test_unknown_preset() -> None:
    with pytest.raises(UnknownNameError, match="no preset named 'paper_A4_m', did you mean 'paper_A4_um'"):
        load_arm(FOLDER / "arm.toml", preset="paper_A4_m")
    with pytest.raises(UnknownNameError, match=r"no preset named 'paper_A4_um' \(known: none\)"):
        load_arm(FOLDER / "robot.urdf", preset="paper_A4_um")
