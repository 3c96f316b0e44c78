"""Robots in xacro and MJCF: tips and loads as MuJoCo has them, and errors as good as those of a URDF."""

import re
import sys
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from support.command_line import fine, run_here, strict_json
from support.robot_files import MJCF
from support.small_arms import line_of, write
from support.two_links import GOOD, Q, declared

from armflex import Arm, load_arm, make_arm
from armflex.errors import ArmFileError, ArmflexWarning, UnsupportedError, UrdfError
from armflex.export.urdf_file import export
from armflex.robot import load_robot

JOINTS = ("slew", "luff", "roll", "reach")


def at(model: mujoco.MjModel, arm: Arm, q: np.ndarray) -> mujoco.MjData:
    data = mujoco.MjData(model)
    for name, value in zip(arm.joint_names, q, strict=True):
        data.qpos[model.joint(name).qposadr[0]] = value
    for name, value in arm.robot.locked.items():
        data.qpos[model.joint(name).qposadr[0]] = value
    mujoco.mj_forward(model, data)
    return data


def drives(arm: Arm, q: np.ndarray) -> np.ndarray:
    """Return what the weight does along or about every joint."""
    loads = arm.deflection(q).joint_loads.reshape(-1, 2, 3)
    return np.array([j.axis @ w[int(j.kind != "prismatic")] for j, w in zip(arm.robot.moving, loads, strict=True)])


def some_q(arm: Arm, count: int) -> np.ndarray:
    lower, upper = (np.clip(limit, -3.0, 3.0) for limit in (arm.robot.lower, arm.robot.upper))
    return np.random.default_rng(4).uniform(lower, upper, (count, len(lower)))


@pytest.mark.parametrize("tip", ["hook", "tcp_site"])
def test_mjcf_is_what_mujoco_makes_of_it(tmp_path: Path, tip: str) -> None:
    path = write(tmp_path, MJCF, "crane.xml")
    with pytest.warns(ArmflexWarning):  # that it is rigid
        arm = load_arm(path, tip=tip)
    assert arm.joint_names == JOINTS
    model = mujoco.MjModel.from_xml_path(str(path))
    for q in some_q(arm, 6):
        data = at(model, arm, q)
        seen = data.site(tip) if tip == "tcp_site" else data.body(tip)
        pose = arm.rigid_pose(q)
        np.testing.assert_allclose(pose.translation, seen.xpos, rtol=0, atol=1e-12)
        np.testing.assert_allclose(pose.rotation.ravel(), seen.xmat, rtol=0, atol=1e-12)
        torque = [-data.qfrc_bias[model.joint(name).dofadr[0]] for name in arm.joint_names]
        np.testing.assert_allclose(drives(arm, q), torque, rtol=1e-11, atol=1e-9)
    np.testing.assert_allclose(arm.robot.lower, [np.radians(-170), np.radians(-60), -np.inf, -0.2])
    assert [joint.effort for joint in arm.robot.moving] == [900.0, 300.0, np.inf, np.inf]
    assert arm.robot.moving[2].kind == "continuous"


def test_a_robot_of_mjcf_bends_and_is_exported(tmp_path: Path) -> None:
    path = write(tmp_path, MJCF.replace('range="-0.2 0.9"', 'range="-0.2 0.9" limited="true"'), "crane.xml")
    arm = make_arm(path, {"luff": 2e5, "reach": 1e6}, tip="hook", gravity=[0, 0, -9.81], tool={"xyz": [0, 0, -0.3]})
    q = some_q(arm, 1)[0]
    assert 1e-3 < np.linalg.norm(arm.deflection(q).displacement[:3]) < 0.2
    text = export(arm).text
    model = pin.buildModelFromXML(text)
    data, configuration = model.createData(), pin.neutral(model)
    for name, value in {**dict(zip(arm.joint_names, q, strict=True)), **arm.robot.locked}.items():
        joint = model.joints[model.getJointId(name)]
        configuration[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else [np.cos(value), np.sin(value)]
    pin.framesForwardKinematics(model, data, configuration)
    tip = data.oMf[model.getFrameId("tcp", pin.BODY)]
    np.testing.assert_allclose(tip.homogeneous, arm.rigid_pose(q).homogeneous, rtol=0, atol=1e-12)
    assert sum(inertia.mass for inertia in model.inertias) == pytest.approx(76.0)
    assert "allow_massless" in " ".join(export(arm).notes)
    again = load_robot(write(tmp_path, text, "again.urdf"), "tcp", allow_massless=True)
    assert again.joint_names == arm.joint_names


def test_degrees_that_mjcf_says_are_radians_are_asked_about(tmp_path: Path) -> None:
    assert not load_robot(write(tmp_path, MJCF, "crane.xml"), "hook").flags
    text = MJCF.replace('angle="degree"', 'angle="radian"')
    first = load_robot(write(tmp_path, text, "crane.xml"), "hook").flags[0]
    assert first.code == "limit_in_degrees" and "-170 to 170 rad exceed two turns" in first.text


@pytest.mark.parametrize("far", ["1e15", "1500"])
def test_a_body_of_mjcf_that_is_too_far_away_is_flagged_as_one_of_a_urdf_is(tmp_path: Path, far: str) -> None:
    text = MJCF.replace('name="boom" pos="0.3 0 0.8"', f'name="boom" pos="{far} 0 0"')
    first = load_robot(write(tmp_path, text, "crane.xml"), "hook").flags[0]
    assert first.code == "origin_in_millimetres"
    line = line_of(text, '<joint name="luff"')
    assert f"crane.xml:{line}: joint 'luff': origin is 1" in first.text and "m from its parent link" in first.text


def test_a_spring_or_a_tendon_of_mjcf_that_is_left_out_is_flagged(tmp_path: Path) -> None:
    text = MJCF.replace('name="roll"', 'name="roll" stiffness="40"')
    tendon = '<tendon><fixed name="belt"><joint joint="luff" coef="1"/><joint joint="roll" coef="2"/></fixed></tendon>'
    text = text.replace("</mujoco>", f"{tendon}</mujoco>")
    flags = {flag.code: flag.text for flag in load_robot(write(tmp_path, text, "crane.xml"), "hook").flags}
    assert f"crane.xml:{line_of(text, 'stiffness=')}: joint 'roll' has a spring of 40" in flags["joint_spring"]
    assert "tendon 'belt' is no spring or cylinder" in flags["tendon"]


def test_the_gravity_of_mjcf_is_taken_where_nothing_else_is_said(tmp_path: Path) -> None:
    text = MJCF.replace("<worldbody>", '<option gravity="0 6.9 -6.9"/><worldbody>', 1)
    path = write(tmp_path, text, "crane.xml")
    arm = make_arm(path, {}, tip="hook")
    np.testing.assert_array_equal(arm.robot.gravity, [0.0, 6.9, -6.9])
    assert any("which is the <option gravity> of crane.xml" in flag.text for flag in arm.flags)
    (tmp_path / "floor.xml").write_text('<mujoco><option gravity="0 6.9 -6.9"/></mujoco>')
    path.write_text(MJCF.replace("<worldbody>", '<include file="floor.xml"/><worldbody>', 1))
    np.testing.assert_array_equal(make_arm(path, {}, tip="hook").robot.gravity, [0.0, 6.9, -6.9])
    given = make_arm(path, {}, tip="hook", gravity=[0.0, 0.0, -9.81])
    np.testing.assert_array_equal(given.robot.gravity, [0.0, 0.0, -9.81])
    np.testing.assert_allclose(make_arm(path, {}, tip="hook", mount={"rpy": [0, 0, 0]}).robot.gravity[:2], 0.0)


def test_commands_take_mjcf(tmp_path: Path) -> None:
    write(tmp_path, MJCF, "crane.xml")
    text = '[robot]\nurdf = "crane.xml"\ntip = "hook"\n[flexure.L]\njoint = "luff"\njoint_stiffness = 2e5\n'
    write(tmp_path, text, "arm.toml")
    fine(run_here(tmp_path, "deflect", "arm.toml", "--q", "luff=20deg", "--json", "d.json"))
    assert np.linalg.norm(strict_json(tmp_path / "d.json")["displacement"]) > 1e-3
    fine(run_here(tmp_path, "deflect", "crane.xml", "--tip", "hook"))


TIED = '<joint joint1="reach" joint2="{}" polycoef="{}"/>'


def test_a_joint_that_an_equality_ties_in_proportion_follows_as_in_mujoco(tmp_path: Path) -> None:
    tied = MJCF.replace("<actuator>", f"<equality>{TIED.format('luff', '0.1 0.3 0 0 0')}</equality><actuator>")
    path = write(tmp_path, tied, "crane.xml")
    arm = make_arm(path, {"luff": 2e5}, tip="hook", gravity=[0, 0, -9.81])
    assert arm.joint_names == ("slew", "luff", "roll")
    model, rng = mujoco.MjModel.from_xml_path(str(path)), np.random.default_rng(3)
    for q in rng.uniform(-0.8, 0.8, (5, 3)):
        data = mujoco.MjData(model)
        for name, value in zip(arm.joint_names, q, strict=True):
            data.qpos[model.joint(name).qposadr[0]] = value
        data.qpos[model.joint("reach").qposadr[0]] = 0.05 + 0.1 + 0.3 * (q[1] - np.radians(15.0))
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(arm.rigid_pose(q).translation, data.body("hook").xpos, rtol=0, atol=1e-12)


BAD_MJCF = {
    "element": (('<joint name="luff"', '<joynt name="luff"'), r"MuJoCo cannot read it: .*joynt", "joynt"),
    "attribute": (('range="-60 75"', 'range="-60"'), r"MuJoCo cannot read it", 'range="-60"'),
    "twice": (('name="roll"', 'name="luff"'), r"MuJoCo cannot read it: .*luff", ""),
    "xml": (("</worldbody>", "</worldbod>"), r"not well-formed XML", "</worldbod>"),
    "ball": (
        ('name="roll" axis="1 0 0" pos="0.2 0.1 0"', 'name="roll" type="ball"'),
        r"joint 'roll': type 'ball' is not supported",
        'name="roll"',
    ),
    "loop": (
        ("<actuator>", '<equality><connect body1="slide" body2="world" anchor="0 0 0"/></equality><actuator>'),
        r"an equality ties body 'slide' to 'world', which closes a loop",
        "",
    ),
    "follows": (
        ("<actuator>", '<equality><joint joint1="luff" joint2="lid"/></equality><actuator>'),
        r"joint 'luff' of the chain mimics 'lid', which is not one that moves between base and tip",
        'name="luff"',
    ),
    "follows by a curve": (
        ("<actuator>", f"<equality>{TIED.format('luff', '0 1 0.2 0 0')}</equality><actuator>"),
        r"joint 'reach' follow 'luff' by a curve, which is not supported: in proportion",
        "",
    ),
    "follows nothing": (
        ("<actuator>", '<equality><joint joint1="luff"/></equality><actuator>'),
        r"joint 'luff' follow a constant, which is not supported",
        "",
    ),
    "mesh": (
        ('<geom fromto="0 0 0 1.2 0 0.1" mass="22"/>', '<geom type="mesh" mesh="m" mass="22"/>'),
        r"MuJoCo cannot read it: .*",
        "",
    ),
    "endless place": (
        ('pos="0.3 0 0.8"', 'pos="inf 0 0.8"'),
        r"body 'boom': pos is inf, 0\.0, 0\.8, expected finite numbers",
        'name="boom"',
    ),
    "endless turn": (
        ('<inertial pos="0 0 -0.1"', '<inertial pos="0 0 -0.1" quat="inf 0 0 0"'),
        r"body 'hook': iquat is .*, expected finite numbers",
        'name="hook"',
    ),
}


@pytest.mark.parametrize("name", BAD_MJCF)
def test_bad_mjcf_is_refused_with_its_line(tmp_path: Path, name: str) -> None:
    edit, match, mark = BAD_MJCF[name]
    assert MJCF.count(edit[0]) == 1
    path = write(tmp_path, MJCF.replace(*edit), "crane.xml")
    with pytest.raises(UrdfError, match=match) as caught:
        load_robot(path, "hook")
    assert str(caught.value).startswith(str(path))
    if mark:
        assert caught.value.place.line == line_of(path.read_text(), mark)


def test_mjcf_may_have_no_sites_or_no_joints(tmp_path: Path) -> None:
    text = re.sub(r"<site name=[^>]*/>", "", MJCF)
    assert "<site" not in text and len(load_robot(write(tmp_path, text, "crane.xml"), "hook").moving) == 4
    still = re.sub(r"<joint name=[^>]*/>|<actuator>.*</actuator>", "", text)
    with pytest.raises(UrdfError, match=r"crane\.xml:\d+: no joint moves between base 'world' and tip 'hook'"):
        load_robot(write(tmp_path, still, "crane.xml"), "hook")


def test_what_mujoco_warns_of_is_said_and_no_file_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path, MJCF.replace('pos="0.7 0 0" axisangle', 'pos="nan 0 0" axisangle'), "crane.xml")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UrdfError, match=r"crane\.xml: MuJoCo says: .*NaN"):
        load_robot(path, "hook")
    assert [one.name for one in tmp_path.iterdir()] == ["crane.xml"]


def test_meshes_that_weigh_nothing_may_be_missing(tmp_path: Path) -> None:
    text = MJCF.replace("<worldbody>", '<asset><mesh name="m" file="ghost.stl"/></asset><worldbody>')
    text = text.replace("<site name", '<geom type="mesh" mesh="m"/><site name')
    robot = load_robot(write(tmp_path, text, "crane.xml"), "hook")
    assert [flag.code for flag in robot.flags] == ["visual"] and "ghost.stl" in robot.flags[0].text


def test_a_loop_beside_the_chain_is_held(tmp_path: Path) -> None:
    text = MJCF.replace(
        "<actuator>", '<equality><connect body1="lamp" body2="boom" anchor="0 0 0"/></equality><actuator>'
    )
    robot = load_robot(write(tmp_path, text, "crane.xml"), "hook")
    assert [flag.code for flag in robot.flags] == ["off_the_chain"] and "closes a loop" in robot.flags[0].text


def test_without_mujoco_mjcf_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(UrdfError, match=r"crane\.xml: is MJCF, which MuJoCo itself reads: pip install mujoco"):
        load_robot(write(tmp_path, MJCF, "crane.xml"), "hook")


SDF = """<sdf version="1.4">
<model name="m"><link name="base"/></model>
</sdf>
"""


@pytest.mark.parametrize("name", ["arm.sdf", "arm.xml"])
def test_sdf_is_refused_with_what_converts_it(tmp_path: Path, name: str) -> None:
    path = write(tmp_path, SDF, name)
    with pytest.raises(UrdfError, match=rf"{name}:1: is SDF, .*sdf2mjcf {name} arm\.xml \(pip install sdformat-mjcf\)"):
        load_arm(path)


# --- xacro ---------------------------------------------------------------------------------------------------------

OPEN = '<robot name="two_link" xmlns:xacro="http://www.ros.org/wiki/xacro">'
XACRO = GOOD.replace('<robot name="two_link">', f'{OPEN}<xacro:property name="reach" value="${{0.5 + 0.5}}"/>')
XACRO = XACRO.replace('xyz="1.0 0 0"', 'xyz="${reach} 0 0"')


def test_without_a_library_xacro_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("armflex.robot.formats.find_spec", lambda name: None)
    with pytest.raises(UrdfError, match=r"robot\.urdf\.xacro: is a xacro file.*pip install xacrodoc \(or xacro\)"):
        load_robot(write(tmp_path, XACRO, "robot.urdf.xacro"))


with_xacro = pytest.mark.skipif(not (find_spec("xacro") or find_spec("xacrodoc")), reason="no xacro is installed")


@with_xacro
def test_xacro_is_expanded(tmp_path: Path) -> None:
    other = load_arm(declared(tmp_path))
    path = declared(tmp_path, ('"robot.urdf"', '"robot.urdf.xacro"'))
    write(tmp_path, XACRO, "robot.urdf.xacro")
    arm = load_arm(path)
    np.testing.assert_array_equal(arm.deflection(Q).displacement, other.deflection(Q).displacement)
    assert "xacro" not in export(arm).text
    write(tmp_path, XACRO.replace("${reach}", "${raech}"), "robot.urdf.xacro")
    with pytest.raises(UrdfError, match=r"robot\.urdf\.xacro: xacro(doc)? cannot expand it: NameError: .*raech"):
        load_arm(path)
    write(tmp_path, XACRO.replace('<mass value="20"/>', '<mass value="2o"/>'), "robot.urdf.xacro")
    with pytest.raises(UrdfError, match=r"robot\.urdf\.xacro: .*'2o' is not a finite decimal number"):
        load_arm(path)


BELOW = {
    "a file of its folder": ("${k}", '<xacro:include filename="inside/k.xacro"/>'),
    "numbers of its folder": ("${xacro.load_yaml('inside/k.yaml')['k']}", ""),
    "a package that it names": ("${k}", '<xacro:include filename="$(find armtest)/k.xacro"/>'),
}
REFUSED = {
    "a file elsewhere": ("${k}", '<xacro:include filename="../k.xacro"/>', r"opens .*\.\./k\.xacro, which is not"),
    "an optional one": ("1", '<xacro:include filename="/etc/passwd" optional="true"/>', "opens /etc/passwd, which is"),
    "a link to elsewhere": ("${k}", '<xacro:include filename="link.xacro"/>', r"opens .*link\.xacro, which is not"),
    "numbers elsewhere": ("${xacro.load_yaml('../k.yaml')['k']}", "", r"opens .*\.\./k\.yaml, which is not below"),
    "the environment": ("${len('$(env HOME)')}", "", "reads the environment variable 'HOME'"),
    "it, where it is there": ("$(optenv HOME 1)", "", "reads the environment variable 'HOME'"),
    "all of Python": ("$(eval 1+1)", "", r"evaluates \$\(1\+1\)"),
    "no package": ("1", '<xacro:include filename="$(find ..)/k.xacro"/>', r"names a package '\.\.'"),
    "a class": ("${().__class__}", "", "'__class__' leads into Python itself"),
    "a class in a function": ("${(lambda: ().__class__.__base__)()}", "", "leads into Python itself"),
    "a frame": ("${(x for x in [1]).gi_frame}", "", "'gi_frame' leads into Python itself"),
}
WRONG = {
    "much memory": ("${len('a'*10**11)}", "", "cannot expand it: MemoryError"),
    "itself for ever": ("1", '<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>', "RecursionError"),
    "long": ("${9**9**9}", "", "cannot be expanded within 1 s and 1024 MB"),
}


def asking(folder: Path, reach: str, head: str) -> Path:
    """Return a xacro file in the folder of a package, with files of one number about it."""
    number = f'{OPEN}<xacro:property name="k" value="1.0"/></robot>'
    write(folder, "<package><name>armtest</name></package>", "package.xml")
    (folder / "urdf" / "inside").mkdir(parents=True)
    for place in (folder, folder / "urdf" / "inside"):
        write(place, number, "k.xacro")
        write(place, "k: 1.0\n", "k.yaml")
    (folder / "urdf" / "link.xacro").symlink_to(folder / "k.xacro")
    text = GOOD.replace('<robot name="two_link">', OPEN + head).replace('xyz="1.0 0 0"', f'xyz="{reach} 0 0"')
    return write(folder / "urdf", text, "robot.xacro")


@with_xacro
@pytest.mark.parametrize(("reach", "head"), BELOW.values(), ids=BELOW)
def test_xacro_reads_what_lies_below_its_folder_or_a_package(tmp_path: Path, reach: str, head: str) -> None:
    assert load_robot(asking(tmp_path, reach, head)).reach == load_robot(write(tmp_path, GOOD)).reach


@with_xacro
@pytest.mark.parametrize(("reach", "head", "match"), REFUSED.values(), ids=REFUSED)
def test_xacro_reaches_no_further(tmp_path: Path, reach: str, head: str, match: str) -> None:
    remedy = r"which no robot file may; read it, and expand it yourself: xacro robot\.xacro > robot\.urdf"
    with pytest.raises(UrdfError, match=rf"robot\.xacro: is xacro that .*{match}.*, {remedy}"):
        load_arm(asking(tmp_path, reach, head))


ARGUED = XACRO.replace(OPEN, f'{OPEN}<xacro:arg name="long"/>').replace("${0.5 + 0.5}", "$(arg long)")


@with_xacro
@pytest.mark.parametrize("value", ["1.0", '"1.0"'])
def test_arguments_of_xacro_are_a_key(tmp_path: Path, value: str) -> None:
    """Also where the file has no suffix of xacro."""
    write(tmp_path, ARGUED, "robot.xml")
    path = declared(tmp_path, ('"robot.urdf"', f'"robot.xml"\nxacro_arguments = {{ long = {value} }}'))
    assert load_arm(path).robot.reach == load_robot(write(tmp_path, GOOD)).reach


@with_xacro
@pytest.mark.parametrize(
    ("given", "match"),
    {
        "": r"its argument 'long' has no value; \[robot\] xacro_arguments = .*xacro robot\.xml NAME:=VALUE",
        "long = 1.0, lnog = 2": r"it has no argument 'lnog' \(known: .*long",
        "long = [1]": r"is \[1\], expected a text, a number, true or false",
        'long = "short"': r"'short' is not a finite decimal number",
    }.items(),
)
def test_arguments_of_xacro_that_cannot_be(tmp_path: Path, given: str, match: str) -> None:
    write(tmp_path, ARGUED, "robot.xml")
    path = declared(tmp_path, ('"robot.urdf"', f'"robot.xml"\nxacro_arguments = {{ {given} }}'))
    with pytest.raises((UrdfError, ArmFileError), match=match):
        load_arm(path)


def test_a_urdf_has_no_arguments(tmp_path: Path) -> None:
    with pytest.raises(UrdfError, match="is no xacro file, and has no arguments"):
        load_robot(write(tmp_path, GOOD), xacro_arguments={"a": "1"})


@with_xacro
@pytest.mark.parametrize(("name", "place"), [("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")])
def test_packages_of_xacro_are_where_ros_has_them(
    tmp_path: Path, name: str, place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "ws" / place / "far_away"
    package.mkdir(parents=True)
    write(package, f'{OPEN}<xacro:property name="k" value="1.0"/></robot>', "k.xacro")
    (tmp_path / "own").mkdir()
    head = '<xacro:include filename="$(find far_away)/k.xacro"/>'
    text = GOOD.replace('<robot name="two_link">', OPEN + head).replace('xyz="1.0 0 0"', 'xyz="${k} 0 0"')
    path = write(tmp_path / "own", text, "robot.xacro")
    with pytest.raises(
        UrdfError, match=r"no package 'far_away'.*ROS_PACKAGE_PATH.*AMENT_PREFIX_PATH.*xacro robot\.xacro"
    ):
        load_robot(path)
    monkeypatch.setenv(name, f"{tmp_path / 'nothing'}:{tmp_path / 'ws'}")
    assert load_robot(path).reach == load_robot(write(tmp_path, GOOD)).reach


@with_xacro
def test_xacro_knows_the_folder_of_its_file(tmp_path: Path) -> None:
    (tmp_path / "inside").mkdir()
    write(tmp_path / "inside", f'{OPEN}<xacro:property name="k" value="1.0"/></robot>', "k.xacro")
    head = '<xacro:include filename="$(dirname)/inside/k.xacro"/>'
    text = GOOD.replace('<robot name="two_link">', OPEN + head).replace('xyz="1.0 0 0"', 'xyz="${k} 0 0"')
    assert load_robot(write(tmp_path, text, "r.xacro")).reach == load_robot(write(tmp_path, GOOD)).reach


@with_xacro
@pytest.mark.parametrize(("reach", "head", "match"), WRONG.values(), ids=WRONG)
def test_xacro_has_so_much_time_and_memory(
    tmp_path: Path, reach: str, head: str, match: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armflex.robot.xacro_process.SECONDS", 1)
    monkeypatch.setattr("armflex.robot.xacro_process.PATIENCE", 1 if "9**9" in reach else 60)
    with pytest.raises(UrdfError, match=match):
        load_arm(asking(tmp_path, reach, head))


def test_a_slide_without_limits_is_no_urdf(tmp_path: Path) -> None:
    path = write(tmp_path, MJCF.replace('range="-0.2 0.9"', ""), "crane.xml")
    with pytest.raises(UnsupportedError, match="joint 'reach' slides without limits, which no URDF can say"):
        export(Arm(load_robot(path, "hook")))
