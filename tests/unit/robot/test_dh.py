"""Arms by their Denavit-Hartenberg parameters instead of a URDF, and what a wire alone tells of one."""

import csv
import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from support import wire_file
from support.command_line import fine, run_here, strict_json
from support.small_arms import ROBOTS

from armflex import Arm, calibrate, load_arm, plan, predict, read_measurements
from armflex.errors import ArmFileError, ConventionError, TableError
from armflex.export.sheet import export as sheet
from armflex.export.urdf_file import export as urdf
from armflex.files.dh_table import in_dh_words, in_other_form
from armflex.robot import Corrections

MODIFIED = """[robot]
dh = "modified"
[robot.joint]
slew = { d = 0.4, mass = 20.0, com = [0.1, 0.0, 0.0] }
luff = { alpha_deg = -90, a_mm = 150, theta_deg = 30, mass = 12.0 }
reach = { kind = "prismatic", alpha = 1.5707963267948966, a = 0.2, d_mm = 50, upper_mm = 300, lower = 0, mass = 3.0 }
"""


def read(folder: Path, text: str) -> Arm:
    (folder / "arm.toml").write_text(text)
    return load_arm(folder / "arm.toml")


def step(theta: float = 0.0, d: float = 0.0, a: float = 0.0, alpha: float = 0.0) -> tuple[pin.SE3, pin.SE3]:
    """Return Rz(theta) Tz(d) and Tx(a) Rx(alpha)."""
    z, x = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    return pin.SE3(pin.exp3(theta * z), d * z), pin.SE3(pin.exp3(alpha * x), a * x)


def test_standard_rows_are_what_they_are_elsewhere(tmp_path: Path) -> None:
    arm = load_arm(wire_file.declared(tmp_path))
    q = wire_file.positions(20, 3)
    expected = wire_file.tips(q, np.array(wire_file.DH)[:, :4])
    found = arm.deflection(np.radians(q)).pose
    np.testing.assert_allclose(found[:, :3, 3], 1e-3 * expected[:, :3, 3], atol=1e-12)
    np.testing.assert_allclose(found[:, :3, :3], expected[:, :3, :3], atol=1e-12)
    assert arm.robot.tip == "flange" and arm.joint_names == tuple(f"J{i + 1}" for i in range(6))
    assert any(flag.code == "weightless" for flag in arm.flags)


@pytest.mark.parametrize("form", ["standard", "modified"])
def test_a_centre_of_mass_is_where_the_joint_is(tmp_path: Path, form: str) -> None:
    """Of a link along its x: the lever of its weight is that of com, not of the far end of a standard row."""
    row = "J1 = { theta_deg = 30, d = 0.4, a = 1.0, alpha_deg = 90, mass = 10.0, com = [0.3, 0.0, 0.0] }"
    arm = read(tmp_path, f'[robot]\ndh = "{form}"\ngravity = [0.0, -9.81, 0.0]\n[robot.joint]\n{row}\n')
    q, across = 0.2, np.cos(np.radians(30.0) + 0.2)
    axis = np.array([0.0, 0.0, 1.0]) if form == "standard" else np.array([0.0, -1.0, 0.0])
    weight = arm.deflection(np.array([q])).joint_loads[0]
    if form == "standard":
        assert weight[5] == pytest.approx(-10.0 * 9.81 * 0.3 * across, rel=1e-9)
    else:  # its axis is along gravity: nothing about it, all across
        assert axis @ [0.0, -9.81, 0.0] > 0.0 and abs(weight[5]) < 1e-9
        assert np.linalg.norm(weight[3:5]) == pytest.approx(10.0 * 9.81 * 0.3, rel=1e-9)


def test_a_weight_at_a_point_has_no_inertia_by_rounding(tmp_path: Path) -> None:
    """The mass of this row about its own centre came out at 6e-34 kg m^2, and was called impossible."""
    row = "d_mm = 620.0, alpha_deg = 90.0, mass = 12, com = [0.0, -0.03, 0.05]"
    arm = read(tmp_path, f'[robot]\ndh = "standard"\n[robot.joint]\nA4 = {{ {row} }}\n')
    assert "impossible_inertia" not in [flag.code for flag in arm.flags]


def test_modified_rows_with_a_slide_and_weights(tmp_path: Path) -> None:
    arm, q = read(tmp_path, MODIFIED), np.array([0.3, -0.7, 0.2])
    parts = [
        *step(q[0], 0.4)[:1],
        *reversed(step(np.radians(30) + q[1], 0.0, 0.15, -np.pi / 2)),
        *reversed(step(0.0, 0.05 + q[2], 0.2, np.pi / 2)),
    ]
    expected = pin.SE3.Identity()
    for part in parts:
        expected = expected * part
    np.testing.assert_allclose(arm.rigid_pose(q).homogeneous, expected.homogeneous, atol=1e-12)
    assert arm.robot.upper[2] == pytest.approx(0.3) and not any(flag.code == "weightless" for flag in arm.flags)
    weight = arm.deflection(q).joint_loads[0, :3]
    np.testing.assert_allclose(np.linalg.norm(weight), 35.0 * np.linalg.norm(arm.robot.gravity), rtol=1e-9)


@pytest.mark.parametrize("form", ["standard", "modified"])
def test_rows_are_taken_to_be_of_the_other_form(tmp_path: Path, form: str) -> None:
    """Every row with all five parameters: the same arm as that of the same numbers under the other name."""
    text = MODIFIED.replace("a_mm = 150,", "a_mm = 150, beta = 0.1, d = 0.3,").replace("d = 0.4,", "d = 0.4, a = 0.1,")
    (tmp_path / "other").mkdir()
    one, other = (text.replace("modified", dh) for dh in (form, "standard" if form == "modified" else "modified"))
    expected, found = read(tmp_path / "other", other).robot, in_other_form(read(tmp_path, one).robot)
    assert found.urdf.dh == expected.urdf.dh
    for joint, same in zip(found.chain, expected.chain, strict=True):
        np.testing.assert_allclose(joint.origin, same.origin, atol=1e-12)
        np.testing.assert_allclose(joint.rotation, same.rotation, atol=1e-12)


@pytest.mark.slow
def test_rows_of_the_other_form_are_named_before_anything_is_fitted(tmp_path: Path) -> None:
    arm = wire_file.declared(tmp_path)
    rows = wire_file.write(tmp_path / "rows.csv", wire_file.positions(80, 0), 7)
    arm.write_text(arm.read_text().replace("standard", "modified"))
    with pytest.raises(ConventionError, match="are of the standard form"):
        calibrate(load_arm(arm), rows)


@pytest.mark.parametrize("form", ["standard", "modified"])
def test_what_a_sheet_says_is_read_again(tmp_path: Path, form: str) -> None:
    """The rows that `export --to sheet` writes make the same arm, from the first row's frame to the last one's."""
    arm = load_arm(ROBOTS / "heavy_six" / "arm.toml")
    rows: dict[str, list[str]] = {}
    ends: dict[str, dict[str, float]] = {"base": {}, "tool": {}}
    for row in csv.DictReader(sheet(arm).text.splitlines()):
        if row["section"] == f"dh_{form}":
            rows.setdefault(row["of"], []).append(f"{row['quantity']} = {float(row['value'])!r}")
        elif row["section"] in ends:
            ends[row["section"]][row["quantity"]] = float(row["value"])
    lines = [f"{name} = {{ {', '.join(own)} }}" for name, own in rows.items()]
    again = read(tmp_path, f'[robot]\ndh = "{form}"\n[robot.joint]\n' + "\n".join(lines) + "\n")
    base, tool = (
        pin.SE3(pin.rpy.rpyToMatrix(*(own[key] for key in ("roll", "pitch", "yaw"))), np.array([own[k] for k in "xyz"]))
        for own in ends.values()
    )
    for q in np.random.default_rng(1).uniform(-1.0, 1.0, (5, 6)):
        expected = arm.rigid_pose(q).homogeneous
        np.testing.assert_allclose((base * again.rigid_pose(q) * tool).homogeneous, expected, atol=1e-6)


def test_other_commands_take_an_arm_without_a_urdf(tmp_path: Path) -> None:
    arm = read(tmp_path, MODIFIED)
    (tmp_path / "again.urdf").write_text(urdf(arm).text)
    again = load_arm(tmp_path / "again.urdf")
    q = np.array([0.3, -0.7, 0.2])
    np.testing.assert_allclose(again.rigid_pose(q).homogeneous, arm.rigid_pose(q).homogeneous, atol=1e-9)
    assert fine(run_here(tmp_path, "view", "arm.toml", "-o", "view.html"))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"modified"', '"modifed"', "'modifed' is not known, did you mean 'modified'"),
        ('dh = "modified"', 'dh = "modified"\nurdf = "r.urdf"', "dh: stands beside 'urdf'"),
        ("alpha_deg = -90", "alpha = -90", r"\[robot.joint.luff\] alpha: -90 rad exceeds a full turn.*alpha_deg"),
        ("a_mm = 150", "a = 150", r"\[robot.joint.luff\] a: 150 m is farther than any joint.*a_mm"),
        ("a_mm = 150", "a_mn = 150", "a_mn: 'mn' is no unit of length, did you mean"),
        ("a_mm = 150", "a_mm = 150, a = 0.15", "a: stands beside 'a_mm'"),
        ("a_mm = 150", "aa = 150", "aa: unknown key, did you mean 'a'"),
        ("mass = 12.0", "mass = -12.0", "mass: is -12 kg"),
        ("upper_mm = 300", "upper_mm = -300", "expected more than lower"),
        ("[robot.joint]", "[robot.joints]", r"needs a table \[robot.joint\]|unknown key"),
    ],
)
def test_what_is_wrong_in_a_row_is_named(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in MODIFIED
    with pytest.raises(ArmFileError, match=said) as raised:
        read(tmp_path, MODIFIED.replace(old, new))
    assert raised.value.place.line > 0


def test_wire_lengths_alone_make_a_small_arm_accurate(tmp_path: Path) -> None:
    """No URDF, no x y z: millimetres become the wire's noise, in rows that were not fitted too; the rest is said."""
    arm, q = wire_file.declared(tmp_path), wire_file.positions(400, 0)
    rows, more = (wire_file.write(tmp_path / f"{i}.csv", some, 7) for i, some in enumerate((q[:250], q[250:])))
    loaded = load_arm(arm)
    found = calibrate(loaded, read_measurements(rows, loaded))
    assert found.declared_rms > 1e-3 and found.rms < 1.1e-4 and not found.flags
    asked = read_measurements(more, found.arm)
    ((kind, std),) = predict(found.arm, asked).sensors
    errors = kind.values - asked.readings.kinds[0].values
    assert np.sqrt((errors**2).mean()) < 1.5 * 1e-4 and std is not None
    # What a turn of the wire's box about the first axis does, too, no wire tells; it is said with what stands for it.
    untold = [one.name for one in found.undetermined]
    assert {"joint_offset J1", "geometry J1 rz", "geometry J1 dx"} <= set(untold)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("L_mm", "L"), "in mm, not m"),
        (("q_J2_deg", "q_J2"), "q_J2 is in degrees"),
        (("L_mm", "L_in"), "'in' is no unit of length"),
    ],
)
def test_units_of_such_a_file_are_asked_about(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    arm = wire_file.declared(tmp_path)
    rows = wire_file.write(tmp_path / "rows.csv", wire_file.positions(80, 0), 7)
    rows.write_text(rows.read_text().replace(*change, 1))
    loaded = load_arm(arm)
    with pytest.raises((ConventionError, TableError), match=said):
        calibrate(loaded, read_measurements(rows, loaded))


@pytest.mark.slow
def test_a_wire_of_which_little_is_known_and_that_was_moved_is_suspected_of_that(tmp_path: Path) -> None:
    """Not of standing elsewhere: its anchor is where it may well be."""
    arm = wire_file.declared(tmp_path)
    rows = wire_file.write(tmp_path / "rows.csv", wire_file.positions(120, 0), 7)
    head, *lines = (line.split(",") for line in rows.read_text().splitlines())
    for line in lines[50:]:
        line[-1] = f"{float(line[-1]) + 30.0}"
    rows.write_text("\n".join(",".join(line) for line in [head, *lines]) + "\n")
    loaded = load_arm(arm)
    found = calibrate(loaded, read_measurements(rows, loaded), anyway=True)
    flag = next(flag for flag in found.flags if flag.code == "instrument_moved")
    assert re.search(r"rows\.csv:5\d", flag.text)


def test_headers_may_have_their_unit_in_brackets(tmp_path: Path) -> None:
    arm = load_arm(wire_file.declared(tmp_path))
    rows = wire_file.write(tmp_path / "rows.csv", wire_file.positions(20, 0), 7)
    plain = read_measurements(rows, arm)
    head, _, rest = rows.read_text().partition("\n")
    head = head.replace("q_J1_deg", "q_J1[deg]").replace("q_J2_deg", "q_J2 (deg)").replace("L_mm", "L [mm]")
    rows.write_text(f"{head}\n{rest}")
    again = read_measurements(rows, arm)
    np.testing.assert_array_equal(again.q, plain.q)
    np.testing.assert_array_equal(again.readings.kinds[0].values, plain.readings.kinds[0].values)


@pytest.mark.parametrize(
    ("instead", "line", "said"),
    [
        (("upper_mm = 300, lower = 0", "upper_mm = 300"), 6, "[robot.joint.reach] lower: is not given, but upper is"),
        (("luff = { alpha_deg", "luff = { lower_deg = -90, alpha_deg"), 5, "[robot.joint.luff] upper: is not given"),
        (("luff", "flange"), 5, "joint 'flange': this name is the joint of the last frame"),
        (("luff", "universe"), 5, "joint 'universe': this name is taken by the mechanics, choose another"),
        (("luff", '"flexure:slew"'), 5, "joint 'flexure:slew': this name is taken by the mechanics, choose another"),
    ],
)
def test_limits_and_names_that_no_joint_can_have(
    tmp_path: Path, instead: tuple[str, str], line: int, said: str
) -> None:
    with pytest.raises(ArmFileError) as caught:
        read(tmp_path, MODIFIED.replace(*instead))
    assert f"arm.toml:{line}: " in str(caught.value) and said in str(caught.value)


def test_masses_are_points_and_say_so_where_the_arm_moves(tmp_path: Path) -> None:
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        arm = read(tmp_path, MODIFIED.replace("[robot.joint]", "gravity = [0.0, 0.0, -9.81]\n[robot.joint]"))
    assert told == [] and arm.flags == ()
    q, v = np.zeros(3), np.ones(3)
    assert "point_masses" not in {flag.code for flag in arm.deflection(q).flags}
    for found in (arm.deflection(q, v=v), arm.deflection(q, a=v), arm.deflection(q[None], v=v[None]).row(0)):
        assert [flag.code for flag in found.flags].count("point_masses") == 1


ROWS = {  # theta, d, a, alpha, beta of rows whose numbers are each a twist of a joint's frame by itself, or are not
    "one": (0.3, 0.4, 0.1, -np.pi / 2, 0.0),
    "two": (-np.pi / 2, 0.0, 0.3, 0.0, 0.0),
    "three": (np.pi, 0.2, 0.2, 0.4, 0.0),
    "four": (0.0, 0.0, 0.1, np.pi / 2, 0.2),
    "five": (0.7, 0.1, 0.0, 0.1, 0.0),
}
NUMBERS = ("theta", "d", "a", "alpha", "beta")


@pytest.mark.parametrize("form", ["standard", "modified"])
def test_geometry_goes_by_the_numbers_of_the_rows(tmp_path: Path, form: str) -> None:
    """What is called one of them moves the arm as that number does, with its sign."""

    def arm(**more: float) -> Arm:
        rows = {
            name: {key: value + more.get(f"{key} of {name}", 0.0) for key, value in zip(NUMBERS, row, strict=True)}
            for name, row in ROWS.items()
        }
        joints = "\n".join(
            f"{name} = {{ {', '.join(f'{key} = {value!r}' for key, value in row.items())} }}"
            for name, row in rows.items()
        )
        return read(tmp_path, f'[robot]\ndh = "{form}"\n[robot.joint]\n{joints}\n')

    plain, q, small = arm(), np.array([0.2, -0.4, 0.5, 0.3, -0.6]), 1e-6
    words = in_dh_words(plain.robot)
    assert {number.partition(" ")[0] for number, _ in words.values()} == set(NUMBERS)
    assert {sign for _, sign in words.values()} == {1.0, -1.0} and 14 <= len(words) < 30
    for label, (number, sign) in words.items():
        _, joint, axis = label.split()
        twist = sign * small * np.eye(6)[("dx", "dy", "dz", "rx", "ry", "rz").index(axis)]
        found = replace(plain, corrections=Corrections(geometry={joint: twist})).deflection(q).pose
        expected = arm(**{number: small}).rigid_pose(q)
        assert isinstance(found, pin.SE3)
        assert np.abs(found.homogeneous - expected.homogeneous).max() < 1e-3 * small, (label, number)
    assert in_dh_words(load_arm(ROBOTS / "heavy_six" / "arm.toml").robot) == {}


@pytest.mark.slow
def test_people_read_numbers_of_rows_and_factors_and_programs_what_files_have(tmp_path: Path) -> None:
    """A compliance half as large again: x1.5 in the terminal, the plan and on the page, its logarithm in JSON."""
    text = MODIFIED.replace("[robot]\n", "[robot]\ngravity = [0.0, 0.0, -9.81]\n")
    text += '[flexure.luff]\njoint = "luff"\ncompliance = [0, 0, 0, 0, 0, SOFT]\n[prior]\ncompliance = 0.5\n'
    text += 'geometry = 1e-3\n[measurement]\nframe = "base"\n'
    arm, rng = read(tmp_path, text.replace("SOFT", "3e-5")), np.random.default_rng(0)
    slewed = replace(arm, corrections=Corrections(geometry={"reach": np.array([2e-3, 0, 0, 0, 0, 0])}))
    q = rng.uniform([-2.0, -1.0, 0.0], [2.0, 1.0, 0.3], (40, 3))
    tip = slewed.deflection(q).pose
    assert isinstance(tip, np.ndarray)
    cells = np.column_stack([q, tip[:, :3, 3] + rng.normal(0.0, 1e-5, (40, 3)), np.full(40, 1e-5)])
    header = ",".join([*(f"q_{name}" for name in arm.joint_names), "x,y,z,sigma"])
    np.savetxt(tmp_path / "rows.csv", cells, delimiter=",", header=header, comments="")
    read(tmp_path, text.replace("SOFT", "2e-5"))
    done = fine(
        run_here(
            tmp_path, "calibrate", "arm.toml", "rows.csv", "-o", "c.toml", "--json", "c.json", "--report", "c.html"
        )
    )
    (own,) = (line.split() for line in done.stdout.splitlines() if line.strip().startswith("compliance luff rz"))
    factor, percent = float(own[3].removeprefix("×")), float(own[4])
    assert abs(factor / 1.5 - 1.0) < 0.03 * percent < 0.5 and own[5] == "%"
    assert "a of reach" in done.stdout and "geometry reach dx" not in done.stdout
    told = {one["name"]: one for one in strict_json(tmp_path / "c.json")["parameters"]}
    logarithm = told["compliance luff rz"]
    assert logarithm["value"] == pytest.approx(np.log(factor), abs=1e-3) and logarithm["std"] == pytest.approx(
        0.01 * percent, rel=0.1
    )
    assert told["geometry reach dx"]["value"] == pytest.approx(2e-3, rel=0.2)
    page = (tmp_path / "c.html").read_text()
    assert (
        re.search(r"compliance luff rz</td><td>×1\.[3-7]\d ± 0\.\d+<", page)
        and "a of reach" in page
        and "geometry reach dx" not in page
    )
    planned = fine(run_here(tmp_path, "plan", "arm.toml", "--rows", "4", "-o", "p.csv")).stdout
    assert "a of reach" in planned and "geometry reach dx" not in planned
    read(tmp_path, text.replace("SOFT", "2e-5").replace("geometry = 1e-3", "geometry = 0"))
    planned = fine(run_here(tmp_path, "plan", "arm.toml", "--rows", "4", "-o", "p.csv")).stdout
    assert re.search(r"compliance luff rz +50 +[\d.]+ +%", planned)


def test_where_an_arm_stands_is_no_matter_of_its_links(tmp_path: Path) -> None:
    """A wire from anywhere: the first row's place is told by marks on the base, that of others by more targets."""
    arm = load_arm(wire_file.declared(tmp_path))
    found = plan(arm, 4, instruments=["L"])
    base, links = (
        next(line for line in found.advice if text in line) for text in ("in the base frame", "second target")
    )
    assert "geometry J1 dx" in base and "d of J1" in base and "joint_offset J1" in base
    assert "J1" not in links.replace("of J1", "") and "level" not in links


NEARLY_PARALLEL = """[robot]
dh = "standard"
allow_massless = true
[robot.joint]
J1 = { d = 0.0893, a = 0.0003, alpha = 1.5709 }
J2 = { theta = -0.774, d = 232.67, a = -0.3039, alpha = -0.001276817, mass = 2.0, com = [0.1, 0.0, -232.6] }
J3 = { theta = 0.728, d = -229.36, a = -0.3917, alpha = -0.005461927 }
J4 = { theta = 0.046, d = -3.197, a = 0.0001, alpha = 1.5699 }
"""


def test_rows_of_nearly_parallel_axes_are_an_arm_of_its_reach(tmp_path: Path) -> None:
    """Calibrated tables have d of hundreds of metres that cancel: the arm and where it weighs are those of the rows."""
    arm, q = read(tmp_path, NEARLY_PARALLEL), np.array([0.3, -0.7, 0.4, 1.1])
    assert 0.5 < arm.robot.reach < 1.5 and any(flag.code == "slid" for flag in arm.flags)
    rows = [(0.0, 0.0893, 0.0003, 1.5709), (-0.774, 232.67, -0.3039, -0.001276817)]
    rows += [(0.728, -229.36, -0.3917, -0.005461927), (0.046, -3.197, 0.0001, 1.5699)]
    expected, carried = pin.SE3.Identity(), pin.SE3.Identity()
    for number, (row, at) in enumerate(zip(rows, q, strict=True)):
        along, across = step(row[0] + at, *row[1:])
        carried = expected * along if number == 1 else carried
        expected = expected * along * across
    np.testing.assert_allclose(arm.rigid_pose(q).homogeneous, expected.homogeneous, atol=1e-9)
    body = arm.robot.urdf.links[arm.robot.urdf.joints["J2"].child].inertial
    assert body is not None and abs(body.origin[2]) < 1.0
    lever = (carried.act(np.array([0.1, 0.0, -232.6])))[:2]
    moment = arm.deflection(q).joint_loads[0, 3:]  # about the first joint, whose axis is vertical
    assert np.linalg.norm(moment[:2]) == pytest.approx(2.0 * 9.81 * np.linalg.norm(lever), rel=1e-2)
