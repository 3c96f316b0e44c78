"""Rows 1 to 18 of the table of bad inputs: what a URDF may not say.

Each refusal must be a `UrdfError` that names file and line and the nearest valid name; the ids carry the row.
"""

import numpy as np
import pinocchio as pin
import pytest
from support.small_arms import joint, line_of, link, robot, write
from support.two_links import (
    ELBOW,
    ELBOW_AXIS,
    ELBOW_LIMIT,
    ELBOW_ORIGIN,
    FORE,
    GOOD,
    INERTIA,
    MASS,
    UPPER_INERTIAL,
    assert_refused,
    changed,
    codes,
)

from armflex import Arm, Flexure, load_arm
from armflex.errors import ArmflexWarning, UnsupportedError, UrdfError
from armflex.laws import LinearLaw
from armflex.mechanics.pinocchio_model import build_model
from armflex.robot import Site, load_robot


def test_the_good_file_is_good(tmp_path):
    loaded = load_robot(write(tmp_path, GOOD))
    assert loaded.flags == ()
    assert loaded.joint_names == ("shoulder", "elbow") and loaded.tip == "tool" and loaded.base == "base"
    np.testing.assert_allclose(loaded.upper, [1.6, 2.1])


# Rows 1 to 3: files that are no XML, or hostile.

FILES = {
    "row01-empty": (b"", "is empty"),
    "row01-blank": (b" \n\t\n", "is empty"),
    "row01-truncated": (GOOD[: len(GOOD) // 2].encode(), "not well-formed XML"),
    "row01-truncated-in-a-tag": (GOOD[: GOOD.index("<inertia ") + 12].encode(), "not well-formed XML"),
    "row01-binary": (bytes(range(256)) * 40, "not UTF-8"),
    "row01-nul": (GOOD.replace("base", "ba\0se").encode(), "NUL"),
    "row01-utf16-without-mark": (GOOD.encode("utf-16-le"), "NUL"),
    "row01-huge": (b"<robot>" + b" " * 5_000_001 + b"</robot>", "5000000 bytes allowed"),
    "row01-no-xml": (b"q1, q2, q3\n0, 0, 0\n", "not well-formed XML"),
    "row02-dtd": (b"<!DOCTYPE robot []>" + GOOD.split("\n", 1)[1].encode(), "DTD"),
    "row02-dtd-elsewhere": (b'<!DOCTYPE robot SYSTEM "http://127.0.0.1:9/x.dtd"><robot/>', "DTD"),
    "row02-entity": (b'<!DOCTYPE robot [<!ENTITY m "20">]><robot name="&m;"/>', "DTD"),
    "row02-undeclared-entity": (GOOD.replace('"20"', '"&m;"').encode(), "not well-formed XML"),
    "row03-depth-1e5": (b"<robot>" + b"<a>" * 100_000 + b"</a>" * 100_000 + b"</robot>", "robot.urdf:1"),
    "row03-depth-70": (b"<robot><gazebo>" + b"<a>" * 70 + b"</a>" * 70 + b"</gazebo></robot>", "deeper than 64"),
}


@pytest.mark.parametrize(("data", "words"), FILES.values(), ids=FILES)
def test_no_file_for_us(tmp_path, data, words):
    path = tmp_path / "robot.urdf"
    path.write_bytes(data)
    assert_refused(path, (words,))


def test_row01_missing_file_and_folder(tmp_path):
    assert_refused(tmp_path / "none.urdf", ("cannot be read",))
    assert_refused(tmp_path, ("cannot be read",))


def test_row02_billion_laughs(tmp_path):
    levels = [f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 10)]
    text = f'<!DOCTYPE robot [<!ENTITY l0 "lol">{"".join(levels)}]><robot name="&l9;"><link name="b"/></robot>'
    assert_refused(write(tmp_path, text), ())


@pytest.mark.parametrize("kind", ["ENTITY x", "ENTITY % x"])
def test_row02_xxe_reads_no_file(tmp_path, kind):
    secret = write(tmp_path, "s3cret", "secret.txt")
    use = "%x;" if "%" in kind else ""
    text = f'<!DOCTYPE robot [<!{kind} SYSTEM "{secret.as_uri()}">{use}]><robot name="&x;"><link name="b"/></robot>'
    with pytest.raises(UrdfError) as caught:
        load_robot(write(tmp_path, text))
    assert "s3cret" not in str(caught.value)


def chain(count: int) -> str:
    links = [link(f"l{i}", 1.0 if i else 0.0) for i in range(count)]
    return robot(*links, *(joint(f"j{i}", f"l{i}", f"l{i + 1}", (1, 0, 0)) for i in range(count - 1)))


def test_row03_chain_of_20000_links(tmp_path):
    text = chain(20000).replace("\n", "")
    assert len(text) < 30_000_000
    assert_refused(write(tmp_path, text), ("allowed",))


def test_row03_more_links_than_allowed_in_a_small_file(tmp_path):
    text = robot(*(f'<link name="l{i}"/>' for i in range(20000)))
    assert len(text) < 5_000_000
    assert_refused(write(tmp_path, text), ("20000 links", "500 allowed"), 1)


def test_row03_the_longest_allowed_chain_is_computed(tmp_path):
    robot = load_robot(write(tmp_path, chain(500)))
    assert pin.computeTotalMass(build_model(robot).model) == 499.0
    with pytest.raises(UnsupportedError, match="3493 degrees of freedom"):
        build_model(robot, [Site(name, name) for name in robot.joint_names])


# Rows 4 to 17: one edit of the good file each. Old text, new text, words of the message, mark of its line.

EDITS: dict[str, tuple[str, str, tuple[str, ...], str]] = {
    "row04-missing-parent": (
        '<parent link="upper"/>',
        '<parent link="uper"/>',
        ("'elbow'", "'uper'", "did you mean 'upper'?"),
        ELBOW,
    ),
    "row04-missing-child": (
        '<child link="fore"/>',
        '<child link="forearm"/>',
        ("'elbow'", "did you mean 'fore'?"),
        ELBOW,
    ),
    "row04-origin-in-the-axis": (
        ELBOW_AXIS,
        '<axis xyz="0 0 1"><origin xyz="1 0 0"/></axis>',
        ("<origin> is not known inside <axis>", "it belongs inside <joint>"),
        '<axis xyz="0 0 1"><origin',
    ),
    "row04-joint-without-parent": ('<parent link="upper"/>', "", ("'elbow'", "<parent>"), ELBOW),
    "row04-joint-type": (
        ELBOW,
        '<joint name="elbow" type="revolut">',
        ("'revolut'", "did you mean 'revolute'?"),
        'type="revolut"',
    ),
    "row04-joint-without-type": (ELBOW, '<joint name="elbow">', ("'type'",), '<joint name="elbow">'),
    "row05-self-loop": ('<child link="fore"/>', '<child link="upper"/>', ("'elbow'", "'upper'", "itself"), ELBOW),
    "row05-two-parents": (
        "</robot>",
        '<joint name="again" type="fixed"><parent link="base"/><child link="fore"/></joint></robot>',
        ("'fore'", "two parent joints", "'elbow'", "'again'"),
        '<joint name="again"',
    ),
    "row05-two-roots": ('<link name="base"/>', '<link name="base"/><link name="ground"/>', ("2 root", "ground"), ""),
    "row05-no-links": (GOOD[GOOD.index("<link") : GOOD.index("</robot>")], "", ("no links",), "<robot name"),
    "row05-other-root-element": ("<robot name", "<model name", ("",), ""),
    "row06-duplicate-link": (
        '<link name="tool"/>',
        '<link name="fore"/>',
        ("second link", "'fore'"),
        '"fore"/></robot',
    ),
    "row06-duplicate-joint": (
        '<joint name="flange"',
        '<joint name="elbow"',
        ("second joint", "'elbow'"),
        '<joint name="elbow" type="fixed">',
    ),
    "row06-empty-link-name": (FORE, '<link name="">', ("'name'",), '<link name="">'),
    "row06-blank-link-name": (FORE, '<link name="  ">', ("'name'",), '<link name="  ">'),
    "row06-no-link-name": (FORE, "<link>", ("'name'",), "<link>"),
    "row06-no-joint-name": (ELBOW, '<joint type="revolute">', ("'name'",), '<joint type="revolute">'),
    "row06-reserved-joint-name": (ELBOW, ELBOW.replace("elbow", "universe"), ("'universe'",), 'name="universe"'),
    "row07-mass-outside-inertial": (
        '<inertial>\n      <origin xyz="0.4 0 0"/>\n      <mass value="12"/>',
        '<mass value="12"/>\n    <inertial>\n      <origin xyz="0.4 0 0"/>',
        ("<mass>", "<link>", "belongs inside <inertial>"),
        '<mass value="12"/>',
    ),
    "row07-misspelt-tag": (
        '<visual name="tube">\n      <geometry><box size="1.0 0.1 0.1"/></geometry>\n    </visual>',
        "<visul/>",
        ("<visul>", "did you mean 'visual'?"),
        "<visul/>",
    ),
    "row07-two-inertials": (
        '<visual name="tube">',
        '<inertial><mass value="1"/></inertial><visual name="tube">',
        ("more than one <inertial>",),
        '<mass value="1"/>',
    ),
    "row07-two-masses": (MASS, f'{MASS}\n<mass value="7"/>', ("more than one <mass>",), '"7"'),
    "row07-two-inertias": (INERTIA, f'{INERTIA}\n<inertia ixx="9"/>', ("more than one <inertia>",), 'ixx="9"'),
    "row05-loop-joint": ("</robot>", '\n<loop_joint name="l"/></robot>', ("closed loops are not",), "<loop_joint"),
    "row07-inertial-without-mass": (MASS, "", ("<inertial> needs <mass>",), UPPER_INERTIAL),
    "row07-inertial-without-inertia": (INERTIA, "", ("needs <inertia>",), UPPER_INERTIAL),
    "row07-xacro": (MASS, MASS + '<xacro:m xmlns:xacro="http://ros.org/wiki/xacro"/>', ("xacro", "expand"), ":m xmlns"),
    "row07-misspelt-origin": (ELBOW_ORIGIN, '<origin xzy="1.0 0 0"/>', ("'xyz'", "'xzy'"), "xzy"),
    "row07-misspelt-limit": (ELBOW_LIMIT, ELBOW_LIMIT.replace("lower", "lover"), ("'lower'", "'lover'"), "lover"),
    "row07-misspelt-mass": (MASS, '<mass val="20"/>', ("<mass> needs 'value'", "'val'"), "<mass val="),
    "row08-moving-link-without-inertial": (
        GOOD[GOOD.index('<link name="fore">') : GOOD.index('<joint name="flange"')],
        '<link name="fore"/>\n',
        ("'fore'", "'elbow'", "no <inertial>", "allow_massless"),
        '<link name="fore"/>',
    ),
    "row10-mass-zero": (MASS, '<mass value="0"/>', ("'upper'", "0 kg"), UPPER_INERTIAL),
    "row10-mass-negative": (MASS, '<mass value="-100"/>', ("'upper'", "-100 kg"), UPPER_INERTIAL),
    "row10-mass-negative-on-a-fixed-link": (
        '<link name="tool"/>',
        '<link name="tool"><inertial><mass value="-1"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>',
        ("'tool'", "-1 kg"),
        '<link name="tool">',
    ),
    "row13-com-in-mm": (
        '"0.5 0 0.01"',
        '"500 0 10"',
        ("'upper'", "500.1 m", "millimetres"),
        '<inertial>\n      <origin xyz="500',
    ),
    "row14-axis-zero": (ELBOW_AXIS, '<axis xyz="0 0 0"/>', ("'elbow'", "axis is zero"), '<axis xyz="0 0 0"'),
    "row14-axis-nan": (ELBOW_AXIS, '<axis xyz="0 0 nan"/>', ("'nan'",), "0 0 nan"),
    "row15-lower-above-upper": (ELBOW_LIMIT, ELBOW_LIMIT.replace('"-2"', '"3"'), ("'elbow'", "3", "2.1"), 'lower="3"'),
    "row15-nan-limit": (ELBOW_LIMIT, ELBOW_LIMIT.replace('"-2"', '"nan"'), ("'nan'",), 'lower="nan"'),
    "row15-no-limit": (ELBOW_LIMIT, "", ("'elbow'", "revolute", "<limit"), ELBOW),
    "row15-limit-without-range": (
        ELBOW_LIMIT,
        '<limit effort="1" velocity="1"/>',
        ("'elbow'", "lower and upper"),
        '"1" velocity',
    ),
    "row15-negative-effort": (ELBOW_LIMIT, ELBOW_LIMIT.replace("400", "-400"), ("'elbow'", "negative"), "-400"),
    "row15-negative-velocity": (ELBOW_LIMIT, ELBOW_LIMIT.replace("0.8", "-0.8"), ("'elbow'", "negative"), "-0.8"),
    "row16-comma-decimals": (ELBOW_ORIGIN, '<origin xyz="1,0 0,0 0,0"/>', ("'1,0'",), "1,0 0,0"),
    "row16-comma-separated": (ELBOW_ORIGIN, '<origin xyz="1.0, 0, 0"/>', ("'1.0,'",), "1.0, 0"),
    "row16-two-numbers": (ELBOW_ORIGIN, '<origin xyz="1.0 0"/>', ("expected 3 numbers, got 2",), '"1.0 0"'),
    "row16-turned-otherwise": (
        ELBOW_ORIGIN,
        '<origin xyz="1.0 0 0" quat_xyzw="0 0.7071068 0 0.7071068"/>',
        ("needs 'rpy'; 'quat_xyzw' is not known",),
        "quat_xyzw",
    ),
    "row16-four-numbers": (ELBOW_ORIGIN, '<origin rpy="1 0 0 0"/>', ("expected 3 numbers, got 4",), "1 0 0 0"),
    "row16-unit": (ELBOW_ORIGIN, '<origin xyz="1.0m 0 0"/>', ("'1.0m'",), "1.0m"),
    "row17-mimic-of-a-ghost": (
        ELBOW_LIMIT,
        ELBOW_LIMIT + '<mimic joint="sholder"/>',
        ("'elbow'", "'sholder'", "did you mean 'shoulder'?"),
        ELBOW,
    ),
    "row17-mimic-of-itself": (
        ELBOW_LIMIT,
        ELBOW_LIMIT + '<mimic joint="elbow" multiplier="-2" offset="0.3"/>',
        ("'elbow'", "mimics itself"),
        ELBOW,
    ),
    "row17-floating": (
        ELBOW,
        ELBOW.replace("revolute", "floating"),
        ("'elbow'", "'floating'", "not supported"),
        "floating",
    ),
    "row17-planar": (ELBOW, ELBOW.replace("revolute", "planar"), ("'elbow'", "'planar'", "not supported"), "planar"),
}


@pytest.mark.parametrize(("old", "new", "words", "marker"), EDITS.values(), ids=EDITS)
def test_one_edit_spoils_the_file(tmp_path, old, new, words, marker):
    text = changed((old, new))
    marker = marker.replace("</robot", "\n</robot")
    assert_refused(write(tmp_path, text), words, line_of(text, marker) if marker else None)


def test_row05_three_cycle(tmp_path):
    parts = [link(name, 1.0) for name in "abc"] + [joint(x + y, x, y) for x, y in ("ab", "bc", "ca")]
    text = robot(link("base"), *parts)
    with pytest.raises(UrdfError, match=r"robot.urdf:\d+: joints form a loop: . -> . -> .") as caught:
        load_robot(write(tmp_path, text))
    assert {"a", "b", "c"} <= set(str(caught.value).split("loop: ")[1])


def test_row05_no_root(tmp_path):
    assert_refused(
        write(tmp_path, robot(link("a", 1.0), link("b", 1.0), joint("ab", "a", "b"), joint("ba", "b", "a"))), ("loop",)
    )


def test_row05_empty_robot(tmp_path):
    assert_refused(write(tmp_path, "<robot/>"), ("no links",), 1)


def test_row07_lax_flags_what_strict_refuses(tmp_path):
    text = changed((MASS, MASS + "\n<colour/>"))
    path = write(tmp_path, text)
    assert_refused(path, ("<colour>",), line_of(text, "<colour/>"))
    loaded = load_robot(path, strict=False)
    assert codes(loaded) == ["unknown_tag"]
    assert f"{path}:{line_of(text, '<colour/>')}" in str(loaded.flags[0])


def test_row07_lax_does_not_take_a_misplaced_mass(tmp_path):
    text = changed((MASS, ""), ('<visual name="tube">', f'{MASS}<visual name="tube">'))
    assert_refused(write(tmp_path, text), ("needs <mass>",), strict=False)


def test_row08_massless_when_that_is_meant(tmp_path):
    old, new = EDITS["row08-moving-link-without-inertial"][:2]
    loaded = load_robot(write(tmp_path, changed((old, new))), allow_massless=True)
    assert codes(loaded) == ["massless"] and "'fore'" in str(loaded.flags[0])


# Row 9: every way of garbling a number that some reader accepts.

GARBLED = [
    *("nan", "NaN", "inf", "-inf", "Infinity", "1e400", "1200kg", "heavy", "1_000", "２０", "٢٠", "0x64", "0b11", "1e"),
    *("1,5", "1 000", "", "  ", "+", ".", "--5", "1e5.0", "20 kg", "½", "1f", "1d3", "(20)", "0o17", "1.2.3", "1'000"),
]


@pytest.mark.parametrize("spelling", GARBLED, ids=lambda text: f"row09-mass-{text}")
def test_mass_is_no_number(tmp_path, spelling):
    text = changed((MASS, f'<mass value="{spelling}"/>'))
    assert_refused(write(tmp_path, text), ("<mass value=",), line_of(text, f'<mass value="{spelling}"/>'))


@pytest.mark.parametrize("spelling", ["20", " 20 ", "20.", "+20", "2e1", "2E+01", "0.2e2", "20.000", "020", "200e-1"])
def test_row09_plain_decimals_are_read(tmp_path, spelling):
    loaded = load_robot(write(tmp_path, changed((MASS, f'<mass value="{spelling}"/>'))))
    assert loaded.urdf.links["upper"].inertial.mass == pytest.approx(20.0, rel=1e-15)


def test_row10_a_frame_written_as_a_link_may_weigh_nothing(tmp_path):
    text = changed(
        (
            '<link name="tool"/>',
            '<link name="tool"><inertial><mass value="0"/><inertia ixx="0" iyy="0" izz="0"/></inertial></link>',
        )
    )
    assert load_robot(write(tmp_path, text)).flags == ()
    with_inertia = load_robot(write(tmp_path, text.replace('ixx="0"', 'ixx="1"')))
    assert codes(with_inertia) == ["massless_inertia"]
    assert (
        build_model(with_inertia).model.inertias[2] == build_model(load_robot(write(tmp_path, GOOD))).model.inertias[2]
    )


@pytest.mark.parametrize(("mass", "inertia"), [(0.02, 1e-3), (2e4, 1e3)], ids=["row11-tonnes", "row11-grams"])
@pytest.mark.parametrize("name", ["upper", "fore"])  # by its drawn volume; by the masses of the others
def test_mass_in_another_unit_is_flagged(tmp_path, mass, inertia, name):
    inertial = load_robot(write(tmp_path, GOOD)).urdf.links[name].inertial
    scaled = [f'{k}="{v * inertia}"' for k, v in zip(("ixx", "iyy", "izz"), np.diag(inertial.inertia), strict=True)]
    start = GOOD.index("<mass", GOOD.index(f'<link name="{name}">'))
    old = GOOD[start : GOOD.index("</inertial>", start)]
    loaded = load_robot(write(tmp_path, changed((old, f'<mass value="{mass}"/><inertia {" ".join(scaled)}/>'))))
    assert set(codes(loaded)) == {"implausible_mass"}
    assert name == "fore" or any("'upper'" in str(flag) for flag in loaded.flags)  # of two, either may be the odd one


IMPOSSIBLE: dict[str, tuple[str, str, tuple[str, ...], str]] = {
    "row12-triangle": (
        INERTIA,
        '<inertia ixx="0.2" iyy="1.7" izz="2.5"/>',
        ("'upper'", "principal moments 0.2, 1.7, 2.5", "triangle"),
        UPPER_INERTIAL,
    ),
    "row12-not-definite": (
        INERTIA,
        '<inertia ixx="1" ixy="2" iyy="1" izz="1"/>',
        ("principal moments -1, 1, 3", "not all positive"),
        UPPER_INERTIAL,
    ),
    "row12-negative": (
        INERTIA,
        '<inertia ixx="-0.2" iyy="1.7" izz="1.75"/>',
        ("principal moments -0.2", "not all positive"),
        UPPER_INERTIAL,
    ),
    "row12-impossible-with-what-is-fixed-to-it": (
        '<link name="tool"/>',
        '<link name="tool"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="30"/></inertial></link>',
        ("'fore' and what it carries", "triangle"),
        '<link name="fore">',
    ),
    "row12-by-three-per-cent": (
        INERTIA,
        '<inertia ixx="0.2" iyy="1.7" izz="1.957"/>',
        ("'upper'", "principal moments 0.2, 1.7, 1.957", "triangle"),
        UPPER_INERTIAL,
    ),
}
Q, RATE = (0.3, -0.4), (0.1, 0.2)


@pytest.mark.parametrize(("old", "new", "words", "marker"), IMPOSSIBLE.values(), ids=IMPOSSIBLE)
def test_impossible_moments_matter_to_motion_alone(tmp_path, old, new, words, marker):
    """At rest nothing depends on them, so the arm bends as ever; where it is asked to move, the body is named."""
    text = changed((old, new))
    path = write(tmp_path, text)
    with pytest.warns(ArmflexWarning, match="impossible_inertia"):
        arm = flexible(path)
    possible = flexible(
        write(tmp_path, text.replace(new, old if "tool" not in old else POSSIBLE_TOOL), "possible.urdf")
    )
    np.testing.assert_allclose(arm.deflection(Q).wrenches, possible.deflection(Q).wrenches, rtol=1e-12)
    assert np.isfinite(possible.deflection(Q, v=RATE, a=RATE).wrenches).all()
    for motion in ({"v": RATE}, {"a": RATE}):
        with pytest.raises(UrdfError) as caught:
            arm.deflection(Q, **motion)
        assert str(caught.value).startswith(f"{path}:") and all(word in str(caught.value) for word in words)
    with pytest.raises(UrdfError):
        arm.deflection([Q, Q], a=[RATE, RATE])


POSSIBLE_TOOL = '<link name="tool"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>'


def flexible(path, **options: object) -> Arm:
    """Return an arm that gives in every joint."""
    robot = load_arm(path, tip="tool", **options).robot
    law = LinearLaw(np.diag([1e-8] * 3 + [1e-7] * 3))
    return Arm(robot, tuple(Flexure(name, name, law) for name in robot.joint_names))


@pytest.mark.filterwarnings("ignore::armflex.errors.ArmflexWarning")
def test_row12_lax_moves_with_an_impossible_inertia_but_not_with_a_negative_moment(tmp_path):
    arm = flexible(write(tmp_path, changed((INERTIA, IMPOSSIBLE["row12-triangle"][1]))), strict=False)
    assert "0.2, 1.7, 2.5" in str(arm.robot.flags[0])
    assert np.isfinite(arm.deflection(Q, a=RATE).wrenches).all()
    negative = flexible(write(tmp_path, changed((INERTIA, IMPOSSIBLE["row12-negative"][1]))), strict=False)
    with pytest.raises(UrdfError, match=r"-0\.2"):
        negative.deflection(Q, a=RATE)


# What is wrong off the chain: on a link that hangs on the base, and on one that the chain carries.

SIDE = """  <link name="finger">
    <inertial>
      <origin xyz="0 0 0.1"/>
      <mass value="0.5"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.01"/>
    </inertial>
    <visual><geometry><box size="0.1 0.1 0.1"/></geometry></visual>
  </link>
  <joint name="grip" type="prismatic">
    <parent link="PARENT"/>
    <child link="finger"/>
    <origin xyz="0.8 0.1 0"/>
    <axis xyz="0 1 0"/>
    <limit lower="-0.1" upper="0.1" effort="1" velocity="1"/>
  </joint>
</robot>
"""
WEIGHS = {
    "mass-nan": ('<mass value="0.5"/>', '<mass value="nan"/>', "'nan' is not a finite"),
    "mass-infinite": ('<mass value="0.5"/>', '<mass value="1e400"/>', "'1e400' is not a finite"),
    "mass-negative": ('<mass value="0.5"/>', '<mass value="-0.5"/>', "mass is -0.5 kg"),
    "mass-missing": ('<mass value="0.5"/>', "", "<inertial> needs <mass>"),
    "mass-misplaced": (
        '<mass value="0.5"/>\n',
        '</inertial><mass value="0.5"/><inertial>',
        "belongs inside <inertial>",
    ),
    "com-nan": ('<origin xyz="0 0 0.1"/>', '<origin xyz="0 0 nan"/>', "'nan' is not a finite"),
    "joint-origin-nan": ('<origin xyz="0.8 0.1 0"/>', '<origin xyz="0.8 0.1 nan"/>', "'nan' is not a finite"),
    "inertial-misspelt": ("<inertial>", "<inertail>", "did you mean 'inertial'?"),
    "joint-origin-misspelt": ('<origin xyz="0.8 0.1 0"/>', '<orgin xyz="0.8 0.1 0"/>', "did you mean 'origin'?"),
}
HARMLESS = {
    "inertia-nan": ('ixx="0.01"', 'ixx="nan"', "off_the_chain", "the body counts as a point"),
    "inertia-missing": ('<inertia ixx="0.01" iyy="0.01" izz="0.01"/>', "", "off_the_chain", "counts as a point"),
    "inertia-triangle": ('ixx="0.01"', 'ixx="0.03"', "impossible_inertia", "rests does not depend on them"),
    "inertia-negative": ('ixx="0.01"', 'ixx="-0.01"', "impossible_inertia", "not all positive"),
    "stray-tag": ("<visual>", "<colour/><visual>", "off_the_chain", "it is passed over"),
    "stray-origin": ("<inertial>", '<origin xyz="0 0 0"/><inertial>', "unknown_tag", "passed over"),
    "visual-nan": ('size="0.1 0.1 0.1"', 'size="0.1 nan 0.1"', "visual", "the shape is not drawn"),
    "no-limit": ('<limit lower="-0.1" upper="0.1" effort="1" velocity="1"/>', "", "off_the_chain", "held at 0"),
    "no-range": ('lower="-0.1" upper="0.1" ', "", "off_the_chain", "the joint is held at 0"),
    "axis-zero": ('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>', "off_the_chain", "the joint is held at 0"),
    "floating": ("prismatic", "floating", "off_the_chain", "it is held as it stands"),
    "unknown-type": ("prismatic", "prismatik", "off_the_chain", "did you mean 'prismatic'?"),
    "mimic-of-a-ghost": ("<axis", '<mimic joint="elbwo"/><axis', "locked_mimic", "no joint, did you mean 'elbow'?"),
}


def with_side(parent: str, old: str = "<side/>", new: str = "") -> str:
    """Return the good file with a finger on a link, one text of the finger replaced."""
    assert old == "<side/>" or old in SIDE, old
    changed_side = SIDE.replace(old, new)
    if old == "<inertial>" and new == "<inertail>":
        changed_side = changed_side.replace("</inertial>", "</inertail>")
    return GOOD.replace("</robot>\n", changed_side.replace("PARENT", parent))


@pytest.mark.parametrize(("old", "new", "words"), WEIGHS.values(), ids=WEIGHS)
def test_what_weighs_matters_where_it_is_carried(tmp_path, old, new, words):
    assert_refused(write(tmp_path, with_side("fore", old, new)), (words,), tip="tool")
    path = write(tmp_path, with_side("base", old, new), "elsewhere.urdf")
    with pytest.warns(ArmflexWarning, match="off_the_chain") as said:
        arm = flexible(path)
    assert any(words in str(one.message) and f"{path}:" in str(one.message) for one in said)
    good = flexible(write(tmp_path, GOOD, "good.urdf"))
    np.testing.assert_allclose(arm.deflection(Q).wrenches, good.deflection(Q).wrenches, rtol=1e-12)


@pytest.mark.parametrize("parent", ["fore", "base"])
@pytest.mark.parametrize(("old", "new", "code", "words"), HARMLESS.values(), ids=HARMLESS)
def test_what_weighs_nothing_off_the_chain_is_said_and_changes_no_load(tmp_path, parent, old, new, code, words):
    path = write(tmp_path, with_side(parent, old, new))
    with pytest.warns(ArmflexWarning, match=code) as said:
        arm = flexible(path)
    said = [str(one.message) for one in said if code in str(one.message)]
    assert any(words in text and f"{path}:" in text for text in said)
    good = flexible(write(tmp_path, with_side(parent), "good.urdf"))
    np.testing.assert_allclose(arm.deflection(Q).wrenches, good.deflection(Q).wrenches, rtol=1e-12)
    if parent == "base":  # what stands still has no part in motion either
        assert np.isfinite(arm.deflection(Q, a=RATE).wrenches).all()


def test_a_joint_that_cannot_be_read_cannot_be_locked(tmp_path):
    path = write(tmp_path, with_side("fore", '<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>'))
    with pytest.raises(UrdfError, match="'grip': axis is zero"):
        load_robot(path, "tool", locked={"grip": 0.05})


def test_a_carried_finger_without_weight_is_flagged(tmp_path):
    path = write(tmp_path, with_side("fore", '<mass value="0.5"/>', '<mass value="0"/>'))
    assert codes(load_robot(path, "tool")) == ["massless_inertia", "massless"]


def test_row08_the_crossing_of_two_axes_weighs_nothing(tmp_path):
    """Files make one joint of several axes with links that have no extent; one that reaches somewhere would weigh."""
    ball = '<link name="cross"/>' + joint("roll", "upper", "cross", (1, 0, 0), axis=(1, 0, 0))
    edits = [('<parent link="upper"/>', '<parent link="cross"/>'), (ELBOW_ORIGIN, "")]
    loaded = load_robot(write(tmp_path, changed(*edits, ("</robot>", ball + "</robot>"))))
    assert codes(loaded) == ["massless"] and loaded.joint_names == ("shoulder", "roll", "elbow")
    long = changed(edits[0], ("</robot>", ball + "</robot>"))
    assert_refused(write(tmp_path, long), ("'cross'", "no <inertial>", "allow_massless"))


@pytest.mark.parametrize("moment", ["0", "1e-6"])
def test_row12_a_sensor_fixed_to_a_link_may_be_a_point(tmp_path, moment):
    """Files of good robots hold such links; what counts is the body that they are part of."""
    products = f'ixy="{moment}" ixz="{moment}" iyz="{moment}"'
    sensor = (
        f'<inertial><mass value="0.1"/><inertia ixx="{moment}" iyy="{moment}" izz="{moment}" {products}/></inertial>'
    )
    path = write(tmp_path, changed(('<link name="tool"/>', f'<link name="tool">{sensor}</link>')))
    loaded = load_robot(path)
    assert codes(loaded) == ["impossible_inertia"]
    model, reference = build_model(loaded).model, pin.buildModelFromUrdf(str(path))
    q = np.array([0.3, -0.5])
    mine, theirs = pin.crba(model, model.createData(), q), pin.crba(reference, reference.createData(), q)
    np.testing.assert_allclose(mine, theirs, rtol=1e-12)


def test_row12_a_heavy_rotated_inertia_survives_rounding(tmp_path):
    text = changed(
        (MASS, '<mass value="2e6"/>'),
        (INERTIA, '<inertia ixx="1e6" iyy="3e6" izz="3.1e6"/>'),
        ('<origin xyz="0.5 0 0.01"/>', '<origin xyz="0.5 0 0.01" rpy="0.3 0.4 0.5"/>'),
    )
    assert pin.computeTotalMass(build_model(load_robot(write(tmp_path, text))).model) == 2e6 + 12


def test_row13_a_doubtful_com_is_flagged(tmp_path):
    loaded = load_robot(write(tmp_path, changed(('"0.5 0 0.01"', '"6.0 0 0"'))))
    assert codes(loaded) == ["com_outside"]


def test_row14_non_unit_axis_is_normalised_and_flagged(tmp_path):
    text = changed((ELBOW_AXIS, '<axis xyz="0 0 2"/>'))
    loaded, good = load_robot(write(tmp_path, text)), load_robot(write(tmp_path, GOOD, "good.urdf"))
    assert codes(loaded) == ["axis_not_unit"] and f":{line_of(text, '0 0 2')}:" in str(loaded.flags[0])
    np.testing.assert_array_equal(loaded.moving[1].axis, good.moving[1].axis)


DOUBTS = {
    "row14-no-axis": (ELBOW_AXIS, "", "axis_missing", ELBOW),
    "row15-degrees": (ELBOW_LIMIT, ELBOW_LIMIT.replace("2.1", "120"), "limit_in_degrees", 'upper="120"'),
    "row16-millimetres": (ELBOW_ORIGIN, '<origin xyz="1000 0 0"/>', "origin_in_millimetres", ELBOW),
}


@pytest.mark.parametrize(("old", "new", "code", "marker"), DOUBTS.values(), ids=DOUBTS)
def test_doubtful_joints_are_flagged(tmp_path, old, new, code, marker):
    text = changed((old, new))
    loaded = load_robot(write(tmp_path, text))
    assert codes(loaded) == [code] and f":{line_of(text, marker)}: joint 'elbow'" in str(loaded.flags[0])


def test_row16_rpy_in_degrees_is_flagged(tmp_path):
    text = changed((ELBOW_ORIGIN, '<origin xyz="1.0 0 0" rpy="0 90 0"/>'))
    loaded = load_robot(write(tmp_path, text))
    assert codes(loaded) == ["rpy_in_degrees"] and f":{line_of(text, '0 90 0')}:" in str(loaded.flags[0])


@pytest.mark.slow
@pytest.mark.parametrize(
    "file", ["package://ghost/a.stl", "../../../etc/passwd", "/etc/shadow", "file:///dev/zero", "a.dae"]
)
def test_row18_meshes_are_not_opened(tmp_path, file):
    text = changed(('<box size="1.0 0.1 0.1"/>', f'<mesh filename="{file}" scale="1 1 1"/>'))
    loaded = load_robot(write(tmp_path, text))
    assert loaded.flags == () and loaded.urdf.links["upper"].visuals[0].mesh == file


def test_impossible_moments_are_said_once(tmp_path):
    """Of a link, of the body that it is part of and of the others: one flag, in which rounding is 0."""
    rod = '<inertial><mass value="1"/><inertia ixx="0" iyy="2.167e-33" izz="1e-3"/></inertial>'
    text = changed(('<link name="tool"/>', f'<link name="tool">{rod}</link>'))
    text = text.replace("</robot>", f'<link name="probe">{rod}</link><joint name="probe" type="fixed"><parent '
                        'link="tool"/><child link="probe"/></joint></robot>')  # fmt: skip
    found = [flag for flag in load_robot(write(tmp_path, text), tip="tool").flags if flag.code == "impossible_inertia"]
    assert len(found) == 1 and "principal moments 0, 0, 0.001" in found[0].text and "likewise probe;" in found[0].text
