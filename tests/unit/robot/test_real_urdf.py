"""What URDF files of others hold besides: extras, side branches, mimics, names; and damage anywhere."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.small_arms import ROBOTS, joint, link, write
from support.two_links import ELBOW, ELBOW_AXIS, ELBOW_LIMIT, GOOD, INERTIA, MASS, assert_refused, changed, codes

from armflex import load_arm
from armflex.cli.options import declared_arm
from armflex.errors import ArmflexError, ArmflexWarning, JointLimitError, NotFiniteError, UnknownNameError, UrdfError
from armflex.mechanics.pinocchio_model import build_model
from armflex.robot import load_robot

# Real files stay welcome.

EXTRAS = {
    "gazebo": ("</robot>", '<gazebo reference="upper"><mu1>0.2</mu1><material>Gazebo/Grey</material></gazebo></robot>'),
    "transmission": (
        "</robot>",
        '<transmission name="t"><type>x</type><joint name="elbow"><hardwareInterface>y</hardwareInterface></joint>'
        '<actuator name="a"><mechanicalReduction>1</mechanicalReduction></actuator></transmission></robot>',
    ),
    "ros2_control": ("</robot>", '<ros2_control name="c" type="system"><joint name="elbow"/></ros2_control></robot>'),
    "material": ("</robot>", '<material name="red"><color rgba="1 0 0 1"/></material></robot>'),
    "safety_controller": (ELBOW_AXIS, f'{ELBOW_AXIS}<safety_controller k_velocity="10"/><dynamics damping="1"/>'),
    "calibration": (ELBOW_AXIS, f'{ELBOW_AXIS}<calibration rising="0.1"/>'),
    "self_filter": (MASS + "\n      " + INERTIA + "\n    </inertial>", f"{MASS}{INERTIA}</inertial><self_filter/>"),
    "collision": ('<visual name="tube">', '<collision><geometry><sphere radius="1"/></geometry></collision><visual>'),
    "unknown-shape": ('<box size="1.0 0.1 0.1"/>', '<capsule radius="0.1" length="1"/>'),
    "comment": ("</robot>", "<!-- <link/> --><?pi x?></robot>"),
    "extra-limit-attributes": (ELBOW_LIMIT, ELBOW_LIMIT.replace("/>", ' acceleration="3" jerk="9"/>')),
    "limit-without-effort": (ELBOW_LIMIT, '<limit lower="-2" upper="2.1"/>'),
    "massless-frame": (
        "</robot>",
        '<link name="camera"/><joint name="c" type="fixed"><parent link="tool"/><child link="camera"/></joint></robot>',
    ),
    "namespace": ('name="two_link"', 'name="two_link" xmlns:xacro="http://ros.org/wiki/xacro"'),
}


@pytest.mark.parametrize(("old", "new"), EXTRAS.values(), ids=EXTRAS)
def test_real_files_stay_welcome(tmp_path, old, new):
    loaded = load_robot(write(tmp_path, changed((old, new))))
    assert loaded.flags == () and loaded.joint_names == ("shoulder", "elbow")


DECLARED = GOOD.split("\n", 1)[1]
ENCODED = {
    "a default namespace": GOOD.replace("<robot ", '<robot xmlns="http://www.ros.org" ', 1).encode(),
    "that of Drake": GOOD.replace(
        "<robot ",
        '<robot xmlns="http://drake.mit.edu" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"'
        ' xsi:schemaLocation="http://drake.mit.edu ../doc/drakeURDF.xsd" ',
        1,
    ).encode(),
    "one of a part": GOOD.replace("<inertial>", '<inertial xmlns="urn:x">').encode(),
    "Latin-1": f'<?xml version="1.0" encoding="ISO-8859-1"?>\n<!-- Gr\u00f6\u00dfe -->{DECLARED}'.encode("latin-1"),
    "Windows-1252": f"<?xml version='1.0'  encoding = 'windows-1252' ?><!-- \u20ac -->{DECLARED}".encode("cp1252"),
    "UTF-16": f'<?xml version="1.0" encoding="UTF-16"?>{DECLARED}'.encode("utf-16"),
    "UTF-16 with its mark alone": DECLARED.encode("utf-16"),
    "Shift_JIS": f'<?xml version="1.0" encoding="Shift_JIS"?><!-- \u7532 -->{DECLARED}'.encode("shift_jis"),
    "a blank line first": b"\n \t\n" + GOOD.encode(),
    "a mark and a blank line first": "\ufeff\n".encode() + GOOD.encode(),
    "a comment first": b"<!-- made by hand -->\n" + GOOD.encode(),
}


@pytest.mark.parametrize("data", ENCODED.values(), ids=ENCODED)
def test_xml_as_others_write_it(tmp_path, data):
    (tmp_path / "robot.urdf").write_bytes(data)
    loaded, plain = load_robot(tmp_path / "robot.urdf"), load_robot(write(tmp_path, GOOD, "plain.urdf"))
    assert loaded.flags == () and loaded.reach == plain.reach and loaded.joint_names == plain.joint_names


def test_lines_are_those_of_the_file_whatever_stands_before_it(tmp_path):
    text = "\n\n" + GOOD.replace('<mass value="20"/>', '<mass value="2o"/>')
    line = text[: text.index("2o")].count("\n") + 1
    with pytest.raises(UrdfError, match=rf"robot\.urdf:{line}: .*2o"):
        load_robot(write(tmp_path, text))


@pytest.mark.parametrize("inside", ["<sensor:camera/>", '<a sensor:x="1"/>'])
def test_a_prefix_that_nothing_declares_is_a_warning(tmp_path, inside):
    loaded = load_robot(write(tmp_path, changed(("</robot>", f"<gazebo>{inside}</gazebo></robot>"))))
    assert codes(loaded) == ["undeclared_prefix"] and "'sensor'" in loaded.flags[0].text
    text = changed((MASS, f"<my:mass value='1'/>{MASS}"), ("</robot>", "<my:link name='a'/></robot>"))
    with pytest.raises(UrdfError, match=r"my:link.* is not known inside <robot>"):
        load_robot(write(tmp_path, text))


@pytest.mark.parametrize("encoding", ["no-such", "zlib", "rot13"])
def test_an_encoding_that_is_none_is_refused(tmp_path, encoding):
    with pytest.raises(UrdfError, match=f"{encoding}.*expected UTF-8, or the encoding"):
        load_robot(write(tmp_path, f'<?xml version="1.0" encoding="{encoding}"?>{DECLARED}'))


def test_a_garbled_colour_is_only_flagged(tmp_path):
    text = changed(("</robot>", '<material name="red"><color rgba="1 0 0"/></material></robot>'))
    assert codes(load_robot(write(tmp_path, text))) == ["color"]


def test_continuous_joints_need_no_limit(tmp_path):
    loaded = load_robot(write(tmp_path, changed((ELBOW, ELBOW.replace("revolute", "continuous")), (ELBOW_LIMIT, ""))))
    assert loaded.flags == () and loaded.upper[1] == np.inf


def test_links_may_be_called_universe(tmp_path):
    loaded = load_robot(write(tmp_path, GOOD.replace('"base"', '"universe"').replace('"tool"', '"world"')))
    flex = build_model(loaded)
    assert flex.model.frames[flex.tip].name == "world" and flex.frame("universe") == flex.base


GRIPPER = (
    "</robot>",
    link("finger", 0.5, (0, 0, 0.1), 0.01)
    + joint("grip", "fore", "finger", (0.8, 0.1, 0), axis=(0, 1, 0), kind="prismatic", inside='<mimic joint="elbow"/>')
    + "</robot>",
)


def test_side_branches_are_locked_and_weigh(tmp_path):
    path = write(tmp_path, changed(GRIPPER))
    assert_refused(path, ("name the tip link with tip= or --tip", "tool", "finger"))
    loaded = load_robot(path, "tool", locked={"grip": 0.25})
    assert loaded.joint_names == ("shoulder", "elbow") and loaded.locked == {"grip": 0.25}
    assert pin.computeTotalMass(build_model(loaded).model) == 32.5
    reference = pin.buildModelFromUrdf(str(path))
    expected = pin.computeGeneralizedGravity(reference, reference.createData(), np.array([0.2, 0.3, 0.25]))[:2]
    model = build_model(loaded).model
    got = pin.computeGeneralizedGravity(model, model.createData(), np.array([0.2, 0.3]))
    np.testing.assert_allclose(got, expected, rtol=1e-12)


def side(name: str, mimic: str) -> str:
    """Return a side joint of the fore arm that mimics another, and its link."""
    return link(f"{name}_body", 0.5, moment=0.01) + joint(name, "fore", f"{name}_body", inside=mimic)


MIMICS = {
    "of-the-chain": ({}, {"a": 0.0, "b": 0.0}, ["a", "b"]),
    "named": ({"a": 0.4}, {"a": 0.4, "b": -0.7}, []),
    "out-of-reach": ({"a": 2.0}, {"a": 2.0, "b": -3.0}, ["b"]),
}


@pytest.mark.parametrize(("locked", "held", "doubted"), MIMICS.values(), ids=MIMICS)
def test_side_joints_that_mimic(tmp_path, locked, held, doubted):
    """A counterweight follows the chain, which it cannot here; what follows the counterweight can."""
    parts = side("a", '<mimic joint="elbow"/>') + side("b", '<mimic joint="a" multiplier="-2" offset="0.1"/>')
    loaded = load_robot(write(tmp_path, changed(("</robot>", f"{parts}</robot>"))), "tool", locked=locked)
    assert loaded.locked == pytest.approx(held)
    assert codes(loaded) == ["locked_mimic"] * len(doubted)
    assert all(f"joint {name!r}" in str(flag) for name, flag in zip(doubted, loaded.flags, strict=True))


def test_side_joints_that_mimic_each_other(tmp_path):
    parts = side("a", '<mimic joint="b"/>') + side("b", '<mimic joint="a"/>')
    loaded = load_robot(write(tmp_path, changed(("</robot>", f"{parts}</robot>"))), "tool")
    assert codes(loaded) == ["locked_mimic"] * 2


def test_unknown_names_of_links_and_joints(tmp_path):
    path = write(tmp_path, changed(GRIPPER))
    with pytest.raises(UnknownNameError, match="no link named 'toool', did you mean 'tool'"):
        load_robot(path, "toool")
    with pytest.raises(UnknownNameError, match="no link named 'bas', did you mean 'base'"):
        load_robot(path, "tool", "bas")
    with pytest.raises(UnknownNameError, match="'gripp', did you mean 'grip'"):
        load_robot(path, "tool", locked={"gripp": 0.0})
    with pytest.raises(NotFiniteError, match="locked grip"):
        load_robot(path, "tool", locked={"grip": np.nan})
    with pytest.raises(JointLimitError, match="'grip' is locked at 9"):
        load_robot(path, "tool", locked={"grip": 9.0})


@pytest.mark.parametrize(("tip", "base", "words"), [("base", None, "no joint moves"), ("upper", "fore", "not descend")])
def test_a_chain_must_lead_from_base_to_tip(tmp_path, tip, base, words):
    assert_refused(write(tmp_path, GOOD), (words, f"'{tip}'"), tip=tip, base=base)


@pytest.mark.slow
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    place=st.integers(0, len(GOOD)),
    length=st.integers(0, 30),
    new=st.one_of(
        st.sampled_from(
            ["nan", "1e400", "<link/>", '"', "-", "<", "0", "&", "\0", "é", "<joint>", "</link>", "]]>", "1e308"]
        ),
        st.text(max_size=5),
    ),
    strict=st.booleans(),
)
def test_any_damage_is_refused_or_harmless(tmp_path, place, length, new, strict):
    """Cut a piece out, put something in: a typed error, or a robot whose gravity torque is finite."""
    path = tmp_path / "fuzz.urdf"
    path.write_bytes((GOOD[:place] + new + GOOD[place + length :]).encode("utf-8", "surrogatepass"))
    try:
        flex = build_model(load_robot(path, strict=strict))
    except ArmflexError as error:
        assert isinstance(error, UrdfError)
        return
    torque = pin.computeGeneralizedGravity(flex.model, flex.model.createData(), flex.neutral)
    assert not np.isnan(torque).any()


def test_flags_are_warned_of_when_an_arm_is_loaded(tmp_path):
    with pytest.warns(ArmflexWarning, match="axis_not_unit"), pytest.warns(ArmflexWarning, match="rigid"):
        load_arm(write(tmp_path, changed((ELBOW_AXIS, '<axis xyz="0 0 2"/>'))))


@pytest.mark.slow
def test_row12_what_is_calibrated_needs_no_lax(tmp_path):
    """Boom 1 of the TARM-like arm breaks the triangle inequality by five per cent; a campaign is taken at rest."""
    folder = ROBOTS / "tarm_like"
    text = (folder / "robot.urdf").read_text()
    boom = 'ixx="61" ixy="0" ixz="0" iyy="676.5"'
    assert text.count(boom) == 1
    write(tmp_path, text.replace(boom, boom.replace("676.5", "759.6")))
    path = write(tmp_path, (folder / "arm.toml").read_text(), "arm.toml")
    for name in folder.glob("*.safetensors"):
        (tmp_path / name.name).write_bytes(name.read_bytes())
    with pytest.warns(ArmflexWarning, match="impossible_inertia.*'boom1'"):
        arm = declared_arm(path, "calibrate")
    q = np.array([2.0, 0.3, 0.1, 0.5, -0.4, 0.2, 0.6])
    np.testing.assert_array_equal(
        arm.deflection(q).displacement, load_arm(folder / "arm.toml").deflection(q).displacement
    )
