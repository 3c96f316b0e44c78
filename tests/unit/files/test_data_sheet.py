"""What a data sheet says: stiffness, a tool, how the base is mounted; in a file and from Python."""

import re
import warnings
from inspect import getdoc
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from support.campaign_files import write_columns
from support.command_line import fine, run_here, strict_json
from support.compiled_arm import COMPILER, compiled
from support.exported import Sheet
from support.small_arms import ROBOTS, line_of, write
from support.two_links import ARM, GOOD, Q, codes, declared, edited

from armflex import Arm, Payload, Wrench, load_arm, make_arm
from armflex.arm import Flexure
from armflex.errors import ArmFileError, ArmflexWarning, ConvergenceError, UnknownNameError, UrdfError
from armflex.export.sheet import export as export_sheet
from armflex.export.urdf_file import export as export_urdf
from armflex.laws import LinearLaw
from armflex.show.view.arm_scene import Motion, arm_scene

DIAGONAL = "compliance = [1e-9, 1e-9, 6e-10, 4e-8, 4.5e-8, 2e-7]"
JOINT = 'joint = "shoulder"'
TIP = 'tip = "tool"'
GRAVITY = "gravity = [0.0, 0.0, -9.81]\n"
XYZ, RPY = [0.1, -0.05, 0.2], [0.4, -0.3, 1.1]
TOOL = f"{TIP}\ntool = {{ xyz = {XYZ}, rpy = {RPY} }}"


def compliance(arm: Arm, name: str) -> np.ndarray:
    return next(flexure.law.compliance for flexure in arm.flexures if flexure.name == name)


def random_stiffness() -> np.ndarray:
    root = np.random.default_rng(3).normal(size=(6, 6))
    scale = np.array([1e4, 1e4, 1e4, 1e3, 1e3, 1e3])
    stiffness = (root @ root.T + np.eye(6)) * np.outer(scale, scale)
    return 0.5 * (stiffness + stiffness.T)


# --- stiffness -----------------------------------------------------------------------------------------------------


def test_a_joint_stiffness_is_about_the_joints_own_axis(tmp_path: Path) -> None:
    arm = load_arm(declared(tmp_path, (DIAGONAL, "joint_stiffness = 1.6e4")))
    np.testing.assert_array_equal(compliance(arm, "S"), np.diag([0, 0, 0, 0, 1 / 1.6e4, 0]))
    assert arm.flexures[0].law.relative_std == 0.1
    path = declared(tmp_path, (DIAGONAL, "joint_stiffness = 2e6"))
    skew = GOOD.replace('<axis xyz="0 1 0"/>', '<axis xyz="0.6 0.8 0"/>').replace(
        '"shoulder" type="revolute"', '"shoulder" type="prismatic"'
    )
    write(tmp_path, skew)
    expected = np.zeros((6, 6))
    expected[:2, :2] = np.outer([0.6, 0.8], [0.6, 0.8]) / 2e6
    np.testing.assert_allclose(compliance(load_arm(path), "S"), expected, rtol=1e-15)


def test_a_stiffness_is_the_inverse_of_a_compliance(tmp_path: Path) -> None:
    numbers = [1e9, 2e9, 1e9, 2e7, 1.6e4, 5e6]
    arm = load_arm(declared(tmp_path, (DIAGONAL, f"stiffness = {numbers}")))
    np.testing.assert_allclose(compliance(arm, "S"), np.diag(1.0 / np.array(numbers)), rtol=1e-15)
    full = random_stiffness()
    arm = load_arm(declared(tmp_path, (DIAGONAL, f"stiffness = {full.tolist()}")))
    np.testing.assert_allclose(full @ compliance(arm, "S"), np.eye(6), rtol=0, atol=1e-10)


def test_laws_that_have_a_compliance_take_a_stiffness(tmp_path: Path) -> None:
    base = "compliance = [1e-9, 1e-9, 6e-10, 4e-8, 4e-8, 3e-7]"
    numbers = [1 / value for value in (1e-9, 1e-9, 6e-10, 4e-8, 4e-8, 3e-7)]
    one, other = (load_arm(declared(tmp_path, (base, given))) for given in (base, f"stiffness = {numbers}"))
    hard = load_arm(declared(tmp_path, (base, "joint_stiffness = 3e6")))
    for arm in (one, other):
        assert arm.flexures[1].law.coefficients[1][5, 5] == 1e-8
    np.testing.assert_allclose(other.deflection(Q).displacement, one.deflection(Q).displacement, rtol=1e-12)
    assert hard.flexures[1].law.coefficients[0][5, 5] == 1 / 3e6


BROKEN = {
    "both": (
        f"{DIAGONAL}\nstiffness = [1, 1, 1, 1, 1, 1]",
        r"\[flexure.S\] stiffness: stands beside a compliance",
        "stiffness =",
    ),
    "joint and compliance": (
        f"{DIAGONAL}\njoint_stiffness = 1e4",
        r"joint_stiffness: stands beside 'compliance'",
        "joint_st",
    ),
    "joint and six": (
        "stiffness = [1, 1, 1, 1, 1, 1]\njoint_stiffness = 1e4",
        r"stands beside 'stiffness'",
        "joint_st",
    ),
    "negative": ("joint_stiffness = -1e4", r"joint_stiffness: expected more than 0 Nm/rad, got -10000", "joint_st"),
    "zero": ("joint_stiffness = 0", r"expected more than 0 Nm/rad, got 0", "joint_st"),
    "text": ('joint_stiffness = "1e4 Nm/rad"', r"joint_stiffness: expected a number, got '1e4 Nm/rad'", "joint_st"),
    "axis zero": (
        "stiffness = [1e9, 1e9, 1e9, 1e6, 0, 1e6]",
        r"stiffness: of ry is 0, expected more than 0",
        "stiffness =",
    ),
    "axis negative": ("stiffness = [1e9, -1e9, 1e9, 1e6, 1, 1e6]", r"stiffness: of dy is -1e\+09", "stiffness ="),
    "five": ("stiffness = [1, 1, 1, 1, 1]", r"expected 6 numbers or 6 x 6 numbers", "stiffness ="),
    "skew": (
        f"stiffness = {(np.eye(6) + np.eye(6, k=1)).tolist()}",
        r"is not symmetric: K\[0\]\[1\] = 1, K\[1\]\[0\] = 0",
        "stiffness =",
    ),
    "singular": (
        f"stiffness = {np.ones((6, 6)).tolist()}",
        r"is not positive definite: some load would move it without bound",
        "stiffness =",
    ),
    "misspelt": ("stifness = [1, 1, 1, 1, 1, 1]", r"stifness: unknown key, did you mean 'stiffness'", "stifness"),
    "misspelt joint": (
        "joint_stifness = 1e4",
        r"joint_stifness: unknown key, did you mean 'joint_stiffness'",
        "joint_stifness",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_stiffness_is_refused_with_its_line(tmp_path: Path, name: str) -> None:
    given, match, mark = BROKEN[name]
    path = declared(tmp_path, (DIAGONAL, given))
    with pytest.raises(ArmFileError, match=match) as caught:
        load_arm(path)
    assert caught.value.place.line == line_of(path.read_text(), mark)


def test_a_fixed_joint_has_no_axis_to_be_stiff_about(tmp_path: Path) -> None:
    path = declared(tmp_path, (DIAGONAL, "joint_stiffness = 1e4"), (JOINT, 'joint = "flange"'))
    with pytest.raises(
        ArmFileError, match=r"joint 'flange' is fixed and has no axis of its own: give a stiffness of 6"
    ):
        load_arm(path)


@pytest.mark.parametrize(
    ("given", "questioned"),
    [("[0, 0, 0, 0, 0, 6e-5]", True), ("[1e-9, 1e-9, 1e-9, 6e-5, 0, 0]", True), ("[0, 0, 0, 6e-5, 0, 6e-5]", False),
     ("[0, 0, 0, 0, 6e-5, 0]", False), ("[0, 0, 0, 6e-7, 6e-5, 0]", False), ("[1e-9, 0, 0, 0, 0, 0]", False)],
)  # fmt: skip
def test_a_compliance_about_another_axis_than_the_drives_is_questioned(
    tmp_path: Path, given: str, questioned: bool
) -> None:
    path = declared(tmp_path, (DIAGONAL, f"compliance = {given}"))
    if not questioned:
        assert codes(load_arm(path)) == []
        return
    with pytest.warns(ArmflexWarning, match=r"flexure 'S' gives about r[xz] alone, but .* joint 'shoulder' is ry"):
        assert codes(load_arm(path)) == ["not_the_drive"]


def test_stiffness_of_a_data_sheet_about_z_of_every_joint_does_not_vanish_in_silence(tmp_path: Path) -> None:
    """A bundled arm whose drives turn about z, y and x: millimetres become micrometres, and each joint is named."""
    stiffness = dict(zip("123456", (2.5e6, 3.3e6, 2.2e6, 5.5e5, 5e5, 3.3e5), strict=True))  # Nm/rad, of the drives
    head = f'[robot]\nurdf = "{ROBOTS / "heavy_six" / "robot.urdf"}"\ntip = "tool"\ngravity = [0, 0, -9.81]\n'
    head += "[payload.p200]\nmass = 200.0\ncom = [0.1, 0, 0]\n"
    forms = {"right": "joint_stiffness = {}", "wrong": "compliance = [0, 0, 0, 0, 0, {}]"}
    sags, q = {}, np.array([0.0, 0.3, -0.2, 0.0, 0.3, 0.0])
    for name, form in forms.items():
        values = {i: k if name == "right" else 1.0 / k for i, k in stiffness.items()}
        tables = (f'[flexure.J{i}]\njoint = "J{i}"\n{form.format(value)}\n' for i, value in values.items())
        path = write(tmp_path, head + "".join(tables), f"{name}.toml")
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            arm = load_arm(path)
        sags[name] = np.linalg.norm(arm.deflection(q, "p200").displacement[:3])
        named = [str(one.message) for one in said]
        assert [flag.code for flag in arm.flags] == ["not_the_drive"] * (5 if name == "wrong" else 0)
        assert [f"'J{i}'" in " ".join(named) for i in "123456"] == [name == "wrong" and i != "1" for i in "123456"]
    assert sags["right"] > 5e-3 and sags["wrong"] < 1e-3 * sags["right"]


def test_a_flexure_about_the_drive_answers_for_its_neighbour(tmp_path: Path) -> None:
    more = "[flexure.tilt]\njoint = 'shoulder'\nrelative_std = 0.1\ncompliance = [0, 0, 0, 6e-6, 0, 0]\n[measurement]"
    assert codes(load_arm(declared(tmp_path, ("[measurement]", more)))) == []


# --- tool and mount ------------------------------------------------------------------------------------------------


def with_link(folder: Path) -> Arm:
    """Return the good arm whose URDF has the tool as a link."""
    text = GOOD.replace(
        "</robot>",
        f"""<joint name="mounted" type="fixed"><parent link="tool"/><child link="spindle"/>
    <origin xyz="{" ".join(map(str, XYZ))}" rpy="{" ".join(map(str, RPY))}"/></joint><link name="spindle"/></robot>""",
    )
    write(folder, text, "spindle.urdf")
    return load_arm(write(folder, edited(ARM, ('"robot.urdf"', '"spindle.urdf"'), (TIP, 'tip = "spindle"')), "s.toml"))


def test_a_tool_is_a_link_more(tmp_path: Path) -> None:
    arm, other = load_arm(declared(tmp_path, (TIP, TOOL))), with_link(tmp_path)
    assert arm.robot.tip == "tcp" and arm.flags == () == other.flags
    force = np.array([30.0, -20.0, 10.0])
    for payload in ("none", "p5"):
        one, two = (
            each.deflection(Q, payload, wrenches=[Wrench(each.robot.tip, force, np.zeros(3))]) for each in (arm, other)
        )
        np.testing.assert_array_equal(one.displacement, two.displacement)
        np.testing.assert_array_equal(one.pose.homogeneous, two.pose.homogeneous)
    plain = load_arm(declared(tmp_path))
    tool = pin.SE3(pin.rpy.rpyToMatrix(np.array(RPY)), np.array(XYZ))
    np.testing.assert_allclose(arm.rigid_pose(Q).homogeneous, (plain.rigid_pose(Q) * tool).homogeneous, atol=1e-15)


def test_a_name_that_the_file_has_is_left_to_it(tmp_path: Path) -> None:
    path = declared(tmp_path, (TIP, TOOL))
    write(tmp_path, GOOD.replace('"fore"', '"tcp"'))
    assert load_arm(path).robot.tip == "tcp_2"


def test_exports_have_the_tool(tmp_path: Path) -> None:
    arm = load_arm(declared(tmp_path, (TIP, TOOL)))
    found = export_urdf(arm)
    model = pin.buildModelFromXML(found.text)
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(Q))
    tip = data.oMf[model.getFrameId("tcp", pin.BODY)].homogeneous
    np.testing.assert_allclose(tip, arm.rigid_pose(Q).homogeneous, rtol=0, atol=1e-12)
    assert "'tcp'" in " ".join(found.notes)
    rows = [Sheet(export_sheet(one).text).value for one in (arm, with_link(tmp_path))]
    assert rows[0] == rows[1] and np.linalg.norm([rows[0]["tool", "", axis] for axis in "xyz"]) > 0.5


def test_what_an_export_leaves_out_is_that_of_the_forces_too(tmp_path: Path) -> None:
    arm, rows = load_arm(declared(tmp_path, (TIP, TOOL))), tmp_path / "rows.csv"
    columns = {f"q_{name}": [value] for name, value in zip(arm.joint_names, Q, strict=True)}
    write_columns(rows, columns | {"force_fz_kN": [-2.0]})
    moved = arm.deflection(Q, wrenches=[Wrench("tcp", [0.0, 0.0, -2e3], np.zeros(3))]).displacement[:3]
    (one,) = export_urdf(arm, rows).numbers["left_out"]
    assert one["most"] == pytest.approx(np.linalg.norm(moved), rel=1e-9)


@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")
def test_c_has_the_tool_and_the_mount(tmp_path: Path) -> None:
    arm = load_arm(declared(tmp_path, (TIP, TOOL), (GRAVITY, "mount = { rpy = [0.6, 0.2, 0] }\n")))
    codes_of, poses = compiled(arm, tmp_path).tips(np.array([Q]), np.array([1]))
    assert codes_of.tolist() == [0]
    np.testing.assert_allclose(poses[0], arm.deflection(Q, "p5").pose.homogeneous[:3], rtol=0, atol=1e-9)


@pytest.mark.parametrize("command", ["deflect", "view"])
def test_commands_take_an_arm_with_a_tool_and_a_mount(tmp_path: Path, command: str) -> None:
    path = declared(tmp_path, (TIP, TOOL), (GRAVITY, "mount = { rpy = [0.2, 0, 0] }\n"))
    options = ["-o", "page.html"] if command == "view" else ["--q", "shoulder=0.2"]
    fine(run_here(tmp_path, command, path, *options, "--json", "out.json"))
    assert strict_json(tmp_path / "out.json")["tip"] == "tcp"


def test_a_mount_turns_gravity_into_the_base(tmp_path: Path) -> None:
    roll = 0.7
    arm = load_arm(declared(tmp_path, (GRAVITY, f"mount = {{ rpy = [{roll}, 0, 0] }}\n")))
    expected = [0.0, -9.81 * float(np.sin(roll)), -9.81 * float(np.cos(roll))]
    np.testing.assert_allclose(arm.robot.gravity, expected, rtol=0, atol=1e-12)
    turned = load_arm(declared(tmp_path, (GRAVITY, f"gravity = {expected}\n")))
    np.testing.assert_allclose(arm.deflection(Q).displacement, turned.deflection(Q).displacement, rtol=1e-12)
    both = load_arm(declared(tmp_path, (GRAVITY, f"gravity = {expected}\nmount = {{ rpy = [{roll}, 0, 0] }}\n")))
    assert arm.flags == both.flags == ()
    hung = load_arm(declared(tmp_path, (GRAVITY, f"mount = {{ rpy = [{np.pi}, 0, 0] }}\n")))
    assert hung.flags == () and hung.robot.gravity[2] > 9.8


def test_pictures_stand_as_the_base_is_mounted(tmp_path: Path) -> None:
    """Hanging from a ceiling, what sags does so downwards in the picture, and the base stays where it is."""
    path = declared(tmp_path, (GRAVITY, f"mount = {{ rpy = [{np.pi}, 0, 0] }}\n"))
    arm = load_arm(path)
    scene = arm_scene(arm, Motion(np.zeros(1), (arm.deflection(Q, "p5"),), 0), magnification=1.0)
    shift = next(line for line in scene.polylines if line.name == "displacement").points
    assert (shift[1] - shift[0])[2] < 0.0 and scene.floor_z < 0.0
    node = next(node for node in scene.nodes if node.name == "flexed/upper")
    np.testing.assert_allclose(node.poses[0, :3, 3], [0.0, 0.0, -0.5], atol=1e-3)


PLACES = {
    "conflict": (
        TIP,
        f"{TIP}\nmount = {{ rpy = [0.5, 0, 0] }}",
        r"\[robot\] mount: gravity \[0.0, 0.0, -9.81\] is not that of a base so mounted, .*give one",
        "mount",
    ),
    "instrument": (
        TIP,
        f"{TIP}\nmount = {{ rpy = [0, 0, 0] }}",
        r'gravity_in: gravity_in = "measurement" .* mount',
        "gravity_in",
    ),
    "millimetres": (
        TIP,
        f"{TIP}\ntool = {{ xyz = [100, 0, 200] }}",
        r"\[robot\] tool: it ends 223.607 m from 'tool', more than the arm's reach: millimetres",
        "tool = {",
    ),
    "key": (
        TIP,
        f"{TIP}\ntool = {{ xzy = [0, 0, 0] }}",
        r"\[robot.tool\] xzy: unknown key, did you mean 'xyz'",
        "tool = {",
    ),
    "mount xyz": (TIP, f"{TIP}\nmount = {{ xyz = [0, 0, 1] }}", r"\[robot.mount\] xyz: unknown key", "mount"),
    "empty": (TIP, f"{TIP}\ntool = {{}}", r"\[robot\] tool: expected xyz and rpy", "tool = {"),
    "number": (TIP, f"{TIP}\ntool = 0.1", r"tool: expected a table \[robot.tool\], got 0.1", "tool = 0.1"),
    "nan": (TIP, f"{TIP}\ntool = {{ xyz = [nan, 0, 0] }}", r"\[robot.tool\] xyz: not finite", "tool = {"),
    "misspelt": (
        TIP,
        f"{TIP}\nmont = {{ rpy = [0, 0, 0] }}",
        r"\[robot\] mont: unknown key, did you mean 'mount'",
        "mont",
    ),
}


@pytest.mark.parametrize("name", PLACES)
def test_a_broken_tool_or_mount_is_refused_with_its_line(tmp_path: Path, name: str) -> None:
    old, new, match, mark = PLACES[name]
    level = [('gravity_in = "base"', 'gravity_in = "measurement"')] if name == "instrument" else []
    path = declared(tmp_path, (old, new), *level)
    with pytest.raises(ArmFileError, match=match) as caught:
        load_arm(path)
    assert caught.value.place.line == line_of(path.read_text(), mark)


@pytest.mark.parametrize("key", ["tool", "mount"])
def test_degrees_of_a_tool_or_mount_are_refused(tmp_path: Path, key: str) -> None:
    edits = [(GRAVITY, "")] if key == "mount" else []
    with pytest.raises(ArmFileError, match=rf"arm.toml:\d+: \[robot\] {key}: rpy .* exceeds a full turn: degrees"):
        load_arm(declared(tmp_path, (TIP, f"{TIP}\n{key} = {{ rpy = [90, 0, 0] }}"), *edits))


@pytest.mark.parametrize(("stiffness", "asks"), [(1.6e4, False), (1.6e4 / 57.3, True), (16.0, True), (4.65, True)])
def test_a_joint_stiffness_in_other_units_is_asked_about(tmp_path: Path, stiffness: float, asks: bool) -> None:
    """Right; in Nm/deg, kNm/rad and Nm/arcmin."""
    arm = load_arm(declared(tmp_path, (DIAGONAL, f"joint_stiffness = {stiffness}")))
    said = [flag.text for flag in arm.flags if flag.code == "soft"]
    assert len(said) == asks and all("joint_stiffness" in text and "Nm/arcmin" in text for text in said)


def test_a_payload_heavier_than_the_arm_is_asked_about(tmp_path: Path) -> None:
    arm = load_arm(declared(tmp_path, ("mass = 5.0", "mass = 33.0")))
    assert "heavy_payload: payload of 33 kg is heavier than the arm itself, 32 kg: grams?" in map(
        str, arm.deflection(Q, "p5").flags
    )
    assert not arm.deflection(Q).flags
    rated = load_arm(
        declared(tmp_path, ("mass = 5.0", "mass = 33.0"), ("payload_rating = 10.0", "payload_rating = 33.0"))
    )
    assert not rated.deflection(Q, "p5").flags  # nobody rates an arm for grams


def test_no_equilibrium_names_its_loads(tmp_path: Path) -> None:
    arm = load_arm(
        declared(tmp_path, (DIAGONAL, "compliance = [0, 0, 0, 0.01, 0.01, 0.01]"), ("mass = 5.0", "mass = 9e5"))
    )
    load = Wrench("tool", [0.0, 0.0, -7e6], [0.0, 0.0, 0.0])
    with pytest.raises(ConvergenceError, match=r"under a payload of 900000 kg and a force from outside of 7e\+06 N"):
        arm.deflection(Q, "p5", wrenches=[load], method="newton", allow_large=True)


def test_a_tilted_or_moving_base_is_told(tmp_path: Path) -> None:
    """Gravity is -z of the base where nobody says it, also where a joint has turned that base, or moves it."""
    urdf = GOOD.replace('<joint name="shoulder" type="revolute">', """<link name="world"/>
  <joint name="stand" type="fixed">
    <parent link="world"/>
    <child link="base"/>
    <origin rpy="0.5235987755982988 0 0"/>
  </joint>
  <joint name="shoulder" type="revolute">""")  # fmt: skip
    path = declared(tmp_path, (GRAVITY, ""))
    write(tmp_path, urdf)
    (flag,) = [flag for flag in load_arm(path).flags if flag.code == "gravity"]
    assert flag.text.endswith("z of base 'base' is tilted by 30 degrees from that of the URDF's root")
    path = declared(tmp_path, ('base = "base"', 'base = "upper"'), (JOINT, 'joint = "elbow"'))
    (flag,) = [flag for flag in load_arm(path).flags if flag.code == "moving_base"]
    assert flag.text.endswith("base 'upper' moves with joint 'shoulder': gravity is constant in the axes of that base")


# --- an arm from Python --------------------------------------------------------------------------------------------


def test_an_arm_from_python_is_that_of_a_file(tmp_path: Path) -> None:
    write(tmp_path, GOOD)
    full = random_stiffness()
    arm = make_arm(tmp_path / "robot.urdf", {"shoulder": 1.6e4, "elbow": full}, {"p": Payload(5.0, [0.1, 0.0, 0.0])},
                   tool={"xyz": np.array(XYZ), "rpy": RPY}, gravity=np.array([0.0, 0.0, -9.81]))  # fmt: skip
    laws = [LinearLaw(np.diag([0, 0, 0, 0, 1 / 1.6e4, 0])), LinearLaw(np.linalg.inv(full))]
    other = Arm(arm.robot, tuple(Flexure(n, n, law) for n, law in zip(("shoulder", "elbow"), laws, strict=True)))
    found = arm.deflection(arm.position(shoulder=0.2), "p")
    np.testing.assert_allclose(
        found.displacement, other.deflection([0.2, 0.0], Payload(5.0, [0.1, 0.0, 0.0])).displacement, rtol=1e-9
    )
    assert arm.flags == () and arm.flexure_names == ("shoulder", "elbow") and arm.robot.tip == "tcp"


def test_an_arm_from_python_says_how_well_its_stiffnesses_are_known(tmp_path: Path) -> None:
    write(tmp_path, GOOD)
    stiffness, down = {"shoulder": 1.6e4, "elbow": 9e3}, [0.0, 0.0, -9.81]
    shares = {"shoulder": 0.1, "elbow": 0.2}
    arms = [make_arm(tmp_path / "robot.urdf", stiffness, relative_std=std, gravity=down)
            for std in (0.1, shares, {"elbow": 0.2}, 0.0)]  # fmt: skip
    found = [[flexure.law.relative_std for flexure in arm.flexures] for arm in arms]
    assert found == [[0.1, 0.1], [0.1, 0.2], [0.0, 0.2], [0.0, 0.0]]
    one = arms[0].deflection([0.2, 0.1])
    np.testing.assert_array_equal(arms[0].total_covariance([0.2, 0.1]), one.covariance)
    assert arms[0].total_covariance([0.2, 0.1]).shape == (6, 6) and arms[3].total_covariance([0.2, 0.1]) is None
    assert arms[0].total_covariance([[0.2, 0.1], [0.0, 0.0]], relative=True).shape == (2, 6, 6)
    with pytest.raises(UnknownNameError, match="no joint with a stiffness named 'elbo', did you mean 'elbow'"):
        make_arm(tmp_path / "robot.urdf", stiffness, relative_std={"elbo": 0.2})


def test_the_five_lines_of_the_docstring_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    lines = [line for line in (getdoc(make_arm) or "").splitlines() if line.startswith("    ")]
    lines = lines[: next(i for i, line in enumerate(lines) if "print" in line) + 1]
    assert len(lines) == 5
    monkeypatch.chdir(ROBOTS / "heavy_six")
    with pytest.warns(ArmflexWarning, match="no gravity given"):
        exec("\n".join(line.strip() for line in lines), {})  # what is documented is what runs
    assert re.search(r"\[.*-\d\.\d+.*\]", capsys.readouterr().out)  # mm, downwards


@pytest.mark.slow
def test_an_arm_from_python_is_refused_as_a_file_is(tmp_path: Path) -> None:
    write(tmp_path, GOOD)
    urdf = tmp_path / "robot.urdf"
    for stiffness, options, match in (
        ({"elbo": 1e4}, {}, r"\[flexure.elbo\] joint: no joint 'elbo' between base and tip, did you mean 'elbow'"),
        ({"elbow": -1.0}, {}, r"\[flexure.elbow\] joint_stiffness: expected more than 0 Nm/rad, got -1"),
        ({"elbow": [1.0, 2.0]}, {}, r"\[flexure.elbow\] stiffness: expected 6 numbers or 6 x 6 numbers"),
        ({"elbow": "stiff"}, {}, r"joint_stiffness: expected a number, got 'stiff'"),
        ({}, {"tol": {"xyz": XYZ}}, r"\[robot\] tol: unknown key, did you mean 'tool'"),
        ({"elbow": 1e4}, {"relative_std": 20.0}, r"\[flexure.elbow\] relative_std: .* 0.2 means 20 %"),
        ({}, {"tip": "tol"}, r"\[robot\] tip: no link named 'tol', did you mean 'tool'"),
    ):
        with pytest.raises(ArmFileError, match=match):
            make_arm(urdf, stiffness, **options)
    with pytest.raises(UrdfError, match="cannot be read"):
        make_arm(tmp_path / "ghost.urdf", {})
    with pytest.raises(UnknownNameError, match="no payload named 'q'"):
        make_arm(urdf, {}, gravity=[0, 0, -9.81]).deflection(Q, "q")
