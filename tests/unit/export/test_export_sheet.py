"""`export --to sheet`: a controller given the sheet stands where the calibrated arm does, as well as promised."""

import re
from dataclasses import replace
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.arms import bundled, corrected, crooked, positions
from support.command_line import fine, run_here
from support.exported import Sheet
from support.heavy_campaign import PAYLOADS, declared
from support.plant import Campaign, Plant
from support.small_arms import arm_of, joint, link, one_joint, robot, three_joints

from armflex import Arm, Flexure, calibrate, load_arm, read_measurements
from armflex.export.sheet import export
from armflex.files.dh_table import in_dh_words
from armflex.laws.effects.candidate import Candidate
from armflex.laws.effects.catalogue import CATALOGUE
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.location import Location
from armflex.laws.joint.linear import LinearFit, LinearLaw
from armflex.parameters import Certainty, ParameterKind, of_compliance, of_effect, of_motions, of_offsets
from armflex.robot import Corrections, load_robot

FORMS = ("dh_standard", "dh_modified")


def rigid(arm: Arm, q: np.ndarray) -> np.ndarray:
    return replace(arm, flexures=(), effects=()).deflection(q, enforce_limits=False).pose


def assert_same_tip(arm: Arm, q: np.ndarray) -> Sheet:
    """Hold both forms of an arm's sheet against it; return the sheet."""
    sheet = Sheet(export(arm).text)
    for form in FORMS:
        found = np.array([sheet.tip(row, form) for row in q])
        np.testing.assert_allclose(found, rigid(arm, q), rtol=0.0, atol=1e-9)
    return sheet


@pytest.mark.parametrize("name", ["heavy_six", "tarm_like", "crooked"])
def test_both_forms_have_the_tip_where_the_calibrated_arm_has_it(name: str, tmp_path: Path) -> None:
    arm = corrected(crooked(tmp_path, {}) if name == "crooked" else bundled(name))
    assert_same_tip(arm, positions(arm, 10))


TURN, PLACE = st.sampled_from([0.0, 0.5 * np.pi, np.pi, 1e-4, 0.05, 0.7]), st.sampled_from([0.0, 0.3, -0.8, 1e-4])
AXES = st.sampled_from([(0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 0, -1), (0.6, 0, 0.8)])
PART = st.tuples(*[PLACE] * 3, *[TURN] * 3, AXES, st.sampled_from(["revolute", "revolute", "prismatic"]))


@pytest.mark.slow
@given(st.lists(PART, min_size=3, max_size=5))
@settings(max_examples=60)
def test_any_chain(tmp_path_factory: pytest.TempPathFactory, parts: list[tuple]) -> None:
    """Parallel, antiparallel, coincident, crossing and skew axes, sliding ones too."""
    lines = [link("l0", 1.0)]
    for i, (*pose, axis, kind) in enumerate(parts):
        lines += [joint(f"j{i}", f"l{i}", f"l{i + 1}", pose[:3], pose[3:], axis, kind), link(f"l{i + 1}", 1.0)]
    path = tmp_path_factory.mktemp("chain") / "r.urdf"
    path.write_text(robot(*lines))
    arm = Arm(load_robot(path, f"l{len(parts)}"))
    twist = np.array([1e-4, -2e-4, 3e-4, 2e-4, -1e-4, 3e-4])
    names = arm.joint_names
    moved = Corrections(dict.fromkeys(names, 1e-3), {name: twist * (i + 1) for i, name in enumerate(names)})
    for one in (arm, replace(arm, corrections=moved)):
        assert_same_tip(one, positions(arm, 3))


def test_a_table_that_an_arm_was_made_from_comes_back(tmp_path: Path) -> None:
    """d, a, alpha of a six-axis arm with a spherical wrist, in the modified form: Tx(a) Rx(alpha) Rz(theta) Tz(d)."""
    table = [(0.0, 0.0, 0.4), (0.18, -0.5 * np.pi, 0.0), (0.6, 0.0, 0.0), (0.12, -0.5 * np.pi, 0.62)]
    table += [(0.0, 0.5 * np.pi, 0.0), (0.0, -0.5 * np.pi, 0.0)]
    lines = [link("l0", 1.0)]
    for i, (a, alpha, d) in enumerate(table):
        place = (a, -d * np.sin(alpha), d * np.cos(alpha))
        lines += [joint(f"j{i}", f"l{i}", f"l{i + 1}", place, (alpha, 0, 0), (0, 0, 1)), link(f"l{i + 1}", 1.0)]
    arm = arm_of(tmp_path, [*lines, joint("f", "l6", "tool", (0, 0, 0.1), kind="fixed"), link("tool")], "tool", {})
    sheet = Sheet(export(arm).text)
    for i, (a, alpha, d) in enumerate(table):
        row = {name: sheet.value["dh_modified", f"j{i}", name] for name in ("theta", "d", "a", "alpha", "beta")}
        base = {"d": 0.0} if i == 0 else {}  # the first joint's height is in the base's pose
        wanted = {"theta": 0.0, "d": d, "a": a, "alpha": alpha, "beta": 0.0} | base
        assert row == pytest.approx(wanted, abs=1e-12)
    assert sheet.value["base", "", "z"] == pytest.approx(0.4) and sheet.value["tool", "", "z"] == pytest.approx(0.1)


def test_nearly_parallel_axes_have_hayatis_parameter_and_what_it_is_worth() -> None:
    arm = bundled("heavy_six")
    assert not any("Hayati" in line for line in export(arm).notes)
    tilt = np.array([0.0, 0.0, 0.0, 1e-3, 0.0, 2e-3])  # of J3's axis, y
    tilted = replace(arm, corrections=Corrections({}, {"J3": tilt}))
    found = export(tilted)
    sheet = assert_same_tip(tilted, positions(arm, 10))
    turned = {name: sheet.value["dh_standard", "J2", name] for name in ("alpha", "beta")}
    assert np.hypot(*turned.values()) == pytest.approx(np.hypot(1e-3, 2e-3), rel=1e-3) and turned["beta"] != 0.0
    assert all(abs(sheet.value["dh_standard", f"J{i}", "d"]) < 1.2 for i in range(1, 7))
    said = next(line for line in found.notes if "Hayati" in line)
    assert "J2 and J3" in said and f"{found.numbers['without_beta_m'] * 1e3:.3g} mm" in said
    q = positions(arm, 300)
    lost = [np.linalg.norm((sheet.tip(row, FORMS[0]) - sheet.tip(row, FORMS[0], beta=False))[:3, 3]) for row in q]
    assert 0.5 * found.numbers["without_beta_m"] < max(lost) < 1.5 * found.numbers["without_beta_m"]


def test_zeros_that_were_traced_are_joint_offsets(tmp_path: Path) -> None:
    arm = three_joints(tmp_path, [np.diag([0.0, 0.0, 0.0, 1e-6, 1e-6, 1e-6])] * 3)
    law = CATALOGUE["encoder_offset"]
    traced = replace(
        arm, corrections=Corrections({"pitch": 1e-3}), effects=(Effect(law, Location("pitch", "ry"), (2e-3,)),)
    )
    spread = Certainty(of_effect(traced.effects[0], 1), np.array([[9e-8]]))
    sheet = Sheet(export(replace(traced, certainty=spread)).text)
    assert sheet.value["joint_offset", "pitch", "offset"] == pytest.approx(3e-3)
    assert sheet.std["joint_offset", "pitch", "offset"] == pytest.approx(3e-4)
    assert sheet.std["joint_offset", "yaw", "offset"] is None  # nobody has looked


def test_uncertainties_are_those_of_the_posterior() -> None:
    """In closed form: an offset's own, a length along a frame's shift, a stiffness by its factor's logarithm."""
    arm = bundled("heavy_six")
    parameters = (*of_offsets(arm.robot), *of_motions(ParameterKind.GEOMETRY, arm.joint_names), *of_compliance("J3"))
    root = np.random.default_rng(4).normal(size=(48, 48)) * 1e-4
    covariance = root @ root.T
    sheet = Sheet(export(replace(arm, certainty=Certainty(parameters, covariance))).text)
    std = np.sqrt(np.diag(covariance))
    alone = Sheet(export(replace(arm, certainty=Certainty(parameters[:6], covariance[:6, :6]))).text)
    for i, name in enumerate(arm.joint_names):
        assert alone.std["joint_offset", name, "offset"] == pytest.approx(std[i], rel=1e-5)
    # J2's frame is that of link 1: x is along a of J1's row, z along d, and about x its axis leans.
    row = {name: sheet.std["dh_standard", "J1", name] for name in ("d", "a", "alpha")}
    assert row == pytest.approx({"a": std[12], "d": std[14], "alpha": std[15]}, rel=1e-3)
    drive = ("stiffness", "J3", "drive")
    assert sheet.std[drive] == pytest.approx(sheet.value[drive] * std[42 + 4], rel=1e-3)
    declared_only = ("stiffness", "J4", "drive")
    assert sheet.std[declared_only] == pytest.approx(sheet.value[declared_only] * arm.flexures[3].law.relative_std)


def test_a_stiffness_from_a_bench_is_as_uncertain_as_the_bench_left_it_not_as_one_of_its_readings() -> None:
    """In closed form, s(1/C) = s(C) / C^2, however much single readings scatter."""
    arm = bundled("heavy_six")
    fit = LinearFit(np.tile(np.diag(np.full(6, 1e-18)), (6, 1, 1)), np.full(6, 1e-5), np.array([[-1e3] * 6, [1e3] * 6]))
    flexure = replace(arm.flexures[2], law=LinearLaw(np.diag([1e-9] * 3 + [9e-7] * 3), fit=fit))
    sheet = Sheet(export(replace(arm, flexures=(*arm.flexures[:2], flexure, *arm.flexures[3:]))).text)
    assert sheet.std["stiffness", flexure.name, "drive"] == pytest.approx(1e-9 / 9e-7**2)


def test_a_zero_and_the_turn_of_its_frame_are_one_number() -> None:
    """Each is known to a milliradian, their sum to 0.03: the sheet has the sum, whichever of them has the error."""
    arm = bundled("heavy_six")
    turn = np.array([0.0, 0.0, 0.0, 0.0, 1e-3, 0.0])  # J2's axis is y
    every = (*of_offsets(arm.robot), *of_motions(ParameterKind.GEOMETRY, arm.joint_names))
    pair, covariance = [1, 6 + 6 + 4], np.zeros((42, 42))
    covariance[np.ix_(pair, pair)] = 1e-6 * np.array([[1.0, -1.0], [-1.0, 1.0]]) + 9e-10 * np.diag([1.0, 0.0])
    known = Certainty(every, covariance)
    both = replace(arm, corrections=Corrections({"J2": 2e-3}, {"J2": turn}), certainty=known)
    split, whole = Sheet(export(both).text), Sheet(export(replace(arm, corrections=Corrections({"J2": 3e-3}))).text)
    assert split.value == pytest.approx(whole.value, abs=1e-12)
    assert split.value["joint_offset", "J2", "offset"] == pytest.approx(3e-3)
    assert split.std["joint_offset", "J2", "offset"] == pytest.approx(3e-5, rel=1e-3)
    assert split.std["dh_standard", "J2", "theta"] is None


def test_what_nothing_determines_is_infinitely_uncertain() -> None:
    arm = bundled("heavy_six")
    covariance = np.eye(6) * 1e-8
    covariance[0, 0] = 0.0
    certainty = Certainty(of_offsets(arm.robot), covariance, directions=np.eye(6)[:1])
    found = export(replace(arm, certainty=certainty))
    sheet = Sheet(found.text)
    assert sheet.std["joint_offset", "J1", "offset"] == np.inf
    assert sheet.std["joint_offset", "J2", "offset"] == pytest.approx(1e-4)
    assert "joint_offset J1" in found.notes[0] and "undetermined" in found.page


def test_an_arm_that_was_not_fitted_has_declared_uncertainties_alone() -> None:
    found = export(bundled("heavy_six"))
    sheet = Sheet(found.text)
    assert "Nothing was fitted" in found.notes[0]
    assert {key[0] for key, std in sheet.std.items() if std is not None} == {"stiffness"}


def test_stiffness_is_that_of_the_drive_and_across_it(tmp_path: Path) -> None:
    """One joint about an oblique axis, soft about it by 1e-5 and 1e-7 across, and by 1e-9 m/N."""
    axis = np.array([0.0, 0.6, 0.8])
    across = np.eye(3) - np.outer(axis, axis)
    compliance = np.zeros((6, 6))
    compliance[3:, 3:] = 1e-5 * np.outer(axis, axis) + 1e-7 * across
    compliance[0, 0] = 1e-9
    parts = [link("base"), joint("j", "base", "body", (0, 0, 1), axis=axis), link("body", 1.0)]
    sheet = Sheet(export(arm_of(tmp_path, parts, "body", {"j": compliance})).text)
    own = {key[2]: (value, sheet.unit[key]) for key, value in sheet.value.items() if key[0] == "stiffness"}
    assert own.pop("drive") == (pytest.approx(1e5), "Nm/rad") and own.pop("dx") == (pytest.approx(1e9), "N/m")
    assert own.pop("rx") == (pytest.approx(1e7), "Nm/rad")
    assert own["ry"][0] == pytest.approx(1.0 / compliance[4, 4]) and set(own) == {"ry", "rz"}


@pytest.mark.parametrize("site", ["j", "link:j"])
def test_a_compliance_that_was_traced_softens_the_drive(tmp_path: Path, site: str) -> None:
    """Also where it is of the link that ends at the joint: about the drive's axis both give as one."""
    arm = one_joint(tmp_path, np.diag([0.0] * 4 + [1e-6, 0.0]), (0.5, 0, 0))
    more = Effect(CATALOGUE["compliance"], Location(site, "ry"), (3e-6, *[0.0] * 6))
    value = Sheet(export(replace(arm, effects=(more,))).text).value
    assert {key[1:]: number for key, number in value.items() if key[0] == "stiffness"} == {
        ("j", "drive"): pytest.approx(2.5e5)
    }
    assert isinstance(arm.flexures[0].law, LinearLaw)


def test_what_is_rounding_is_nought(tmp_path: Path) -> None:
    """A right angle about z and back leaves lengths of 1e-17 m in the rows."""
    parts = [link("l0"), joint("a", "l0", "l1", (0.3, 0, 0.1), rpy=(np.pi / 2, 0, 0)), link("l1", 1.0)]
    parts += [joint("b", "l1", "l2", (0.1, 0.3, 0), rpy=(-np.pi / 2, np.pi, np.pi / 2)), link("l2", 1.0)]
    numbers = Sheet(export(arm_of(tmp_path, parts, "l2", {})).text).value.values()
    assert all(number == 0.0 or abs(number) > 1e-9 for number in numbers)


def test_names_are_text(tmp_path: Path) -> None:
    names = ('a,"b"', "c\nd\te", "=1+1", "[bold]é")
    parts = [link("l0", 1.0)]
    for i, name in enumerate(names):
        escaped = quoteattr(name, {'"': "&quot;"})[1:-1]
        parts += [joint(escaped, f"l{i}", f"l{i + 1}", (0.1, 0.0, 0.3)), link(f"l{i + 1}", 1.0)]
    arm = arm_of(tmp_path, parts, "l4", {name: np.eye(6) * 1e-9 for name in names})
    found = export(arm)
    assert Sheet(found.text).joints == ["'=1+1" if name == "=1+1" else name for name in names]
    assert r"c\nd\te" in found.page and found.page.count("\n") == export(renamed(arm)).page.count("\n")


def renamed(arm: Arm) -> Arm:
    """Return the same arm with plain names."""
    text = arm.robot.urdf.path.read_text()
    for i, line in enumerate(re.findall(r"<joint name=.*?>", text, re.S)):
        text = text.replace(line, f'<joint name="j{i}" type="revolute">')
    path = arm.robot.urdf.path.with_name("plain.urdf")
    path.write_text(text)
    law = LinearLaw(np.eye(6) * 1e-9)
    return Arm(load_robot(path, arm.robot.tip), tuple(Flexure(f"j{i}", f"j{i}", law) for i in range(4)))


PRIOR = """joint_offset = 1e-3
compliance = 0.2
tool = 5e-3
session_translation = 5e-4
session_rotation = 5e-5"""


@pytest.mark.slow
def test_a_machine_that_is_given_the_sheet_is_as_accurate_as_promised(tmp_path: Path) -> None:
    """The machine is the plant of the referee; its controller adds the offsets and goes by the sheet's own rows."""
    file = declared(tmp_path, PRIOR)
    plant, rng = Plant.read(file), np.random.default_rng(11)
    plant.offset = {one.name: float(rng.normal(0.0, 1e-3)) for one in plant.joints}
    drives = {"J1": 5, "J2": 4, "J3": 4, "J4": 3, "J5": 4, "J6": 3}
    factors = {name: np.exp(rng.normal(0.0, 0.2, 6)) for name in plant.compliance}
    plant.compliance = {name: law * factors[name] for name, law in plant.compliance.items()}
    plant.target = rng.normal(0.0, 5e-3, 3)
    Campaign(5, poses=50, noise=5e-5, payloads=PAYLOADS).write(plant, tmp_path / "measurements.csv")
    arm = load_arm(file)
    found = calibrate(arm, read_measurements(tmp_path / "measurements.csv", arm)).arm
    sheet = Sheet(export(found).text)
    # No reading tells a turn about the first axis from one of the instrument, nor one about the last from the target.
    told = [name for name in arm.joint_names if sheet.std["joint_offset", name, "offset"] < 5e-4]
    assert {"J2", "J3", "J4", "J5"} <= set(told)
    pulls = [
        (sheet.value["joint_offset", name, "offset"] - plant.offset[name]) / sheet.std["joint_offset", name, "offset"]
        for name in arm.joint_names
    ]
    for name, axis in drives.items():
        key = ("stiffness", name, "drive")
        pulls.append(
            (np.log(sheet.value[key] * plant.compliance[name][axis, axis])) / (sheet.std[key] / sheet.value[key])
        )
    assert np.abs(pulls).max() < 3.5 and 0.4 < np.sqrt(np.mean(np.square(pulls))) < 1.6
    # Without load the machine's tip is where the controller has it, but for what is known of J1 and J6 alone.
    stiff = replace_compliance(plant)
    q = rng.uniform(-1.0, 1.0, (20, 6))
    given = q.copy()
    given[:, [0, 5]] += [plant.offset[name] - sheet.value["joint_offset", name, "offset"] for name in ("J1", "J6")]
    away, before, promised = [], [], []
    for reading, asked in zip(q, given, strict=True):
        true = stiff.settle(reading, 0.0, np.zeros(3))[-1][:3, 3]
        away.append(true - sheet.tip(asked, "dh_standard")[:3, 3])
        before.append(true - arm.rigid_pose(asked).translation)
        promised.append(spread_of(sheet, asked))
    rms = np.sqrt(np.mean(np.square(away)))
    assert rms < 2.0 * np.sqrt(np.mean(promised)) and rms < 0.2 * np.sqrt(np.mean(np.square(before)))


def replace_compliance(plant: Plant) -> Plant:
    return replace(plant, compliance={})


def spread_of(sheet: Sheet, q: np.ndarray) -> np.ndarray:
    """Return the (3,) variance of the tip by the offsets of J2 to J5 alone, as if they were independent."""
    total = np.zeros(3)
    for i in range(1, 5):
        step = np.zeros(6)
        step[i] = 1e-6
        column = (sheet.tip(q + step, "dh_standard") - sheet.tip(q - step, "dh_standard"))[:3, 3] / 2e-6
        total += (column * sheet.std["joint_offset", sheet.joints[i], "offset"]) ** 2
    return total


@pytest.mark.slow
def test_command_prints_a_page_or_writes_a_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arm = Path(bundled("heavy_six").robot.urdf.path).with_name("arm.toml")
    monkeypatch.setenv("COLUMNS", "40")  # into a pipe: rows of a table stay lines
    page = fine(run_here(tmp_path, "export", arm, "--to", "sheet"))
    assert page.stdout == export(load_arm(arm)).page
    assert "is added to the controller's reading" in page.stdout and "payload 'p200'" in page.stderr
    assert re.search(r"J1 +2\.5e\+06 ± 3\.[78]e\+05 Nm/rad", page.stdout) and not list(tmp_path.iterdir())
    fine(run_here(tmp_path, "export", arm, "--to", "sheet", "-o", "s.csv"))
    assert Sheet((tmp_path / "s.csv").read_text()).joints == [f"J{i}" for i in range(1, 7)]


@pytest.mark.parametrize("form", ["standard", "modified"])
def test_the_first_row_is_as_the_data_sheet_has_it_and_has_its_own_error(tmp_path: Path, form: str) -> None:
    """d of the first axis and the base's height are one number; a page names its error 'd of J1', and so does this."""
    own, after = ("a_mm = 350, alpha_deg = -90", "a_mm = 1150")[:: 1 if form == "standard" else -1]
    rows = [f"J1 = {{ theta_deg = 20, d_mm = 675, {own} }}", f"J2 = {{ {after} }}", "J3 = { a_mm = -41 }"]
    path = tmp_path / "arm.toml"
    path.write_text("\n".join(["[robot]", f'dh = "{form}"', "[robot.joint]", *rows]))
    arm = load_arm(path)
    twist = np.array([2e-4, -3e-4, 1.3e-3, 1e-4, -2e-4, 5e-4])
    for moved, height, zero in ((Corrections(), 0.0, 0.0), (Corrections({}, {"J1": twist}), 1.3e-3, 5e-4)):
        sheet = assert_same_tip(replace(arm, corrections=moved), positions(arm, 4))
        assert sheet.value[f"dh_{form}", "J1", "d"] == pytest.approx(0.675 + height, abs=2e-7)
        assert sheet.value[f"dh_{form}", "J1", "theta"] == pytest.approx(np.radians(20.0), abs=1e-12)
        assert sheet.value["joint_offset", "J1", "offset"] == pytest.approx(zero, abs=1e-6)
        if form == "standard":
            assert abs(sheet.value["base", "", "z"]) < 5e-4 and abs(sheet.value["base", "", "yaw"]) < 1e-6
    assert in_dh_words(arm.robot)["geometry J1 dz"] == ("d of J1", 1.0)


def test_no_stiffness_is_stated_where_a_joint_hangs_back() -> None:
    """A number of what else gives there would be many times too stiff."""
    arm = bundled("heavy_six")
    drive = next(flexure for flexure in arm.flexures if flexure.joint == arm.joint_names[1])
    place = Location(arm.joint_names[1], "ry", terms=(0,))
    plays = Candidate(CATALOGUE["hysteresis"], place, (20.0,)).effect(np.array([1e-6]))
    exported = export(replace(arm, effects=(plays,)))
    texts = export(arm).text, exported.text
    before, after = ({key for key in Sheet(text).value if key[0] == "stiffness"} for text in texts)
    assert {of for _, of, _ in before - after} == {drive.name} and after < before
    assert any("No stiffness is stated where hysteresis" in line for line in exported.notes)
