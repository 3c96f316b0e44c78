"""URDF, spoilt: refused by name, or the arm of it deflects in numbers."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from harness import CELLS, cases, judge, mutated_bytes, written
from hypothesis import given
from hypothesis import strategies as st
from lxml import etree
from seeds import ARM, URDF
from support.robot_files import MJCF
from support.small_arms import ROBOTS

from armflex import Arm, load_arm

PLAIN = ARM.replace("LEARN", "").partition("[[effect]]")[0]
HEAVY = (ROBOTS / "heavy_six" / "robot.urdf").read_text()


def bent(arm: Arm) -> Mapping[str, Any]:
    q = np.clip(np.zeros(len(arm.joint_names)), arm.robot.lower, arm.robot.upper)
    rate = np.full(len(q), 0.1)
    found, moving = arm.deflection(q), arm.deflection(q, v=rate, a=rate)
    return {"displacement": found.displacement, "moving": moving.displacement, "covariance": found.covariance}


@st.composite
def mutated_xml(draw: st.DrawFn, seed: str) -> bytes:
    """Return XML with one to three attributes or elements spoilt."""
    root = etree.fromstring(seed.encode())
    for _ in range(draw(st.integers(1, 3))):
        element = draw(st.sampled_from([one for one in root.iter() if isinstance(one.tag, str)]))
        how = draw(
            st.sampled_from(("word", "word", "word", "attribute", "drop", "drop attribute", "double", "rename", "wrap"))
        )
        key = draw(st.sampled_from(sorted(element.attrib))) if element.attrib else None
        parent = element.getparent()
        if how == "word" and key is not None:
            words = element.get(key).split(" ")
            words[draw(st.integers(0, len(words) - 1))] = draw(_WORDS)
            element.set(key, " ".join(words))
        elif how == "attribute" and key is not None:
            element.set(key, draw(_WORDS))
        elif how == "drop attribute" and key is not None:
            del element.attrib[key]
        elif how == "rename":
            element.tag = draw(
                st.sampled_from(("link", "joint", "inertial", "mass", "mimic", "x", "gazebo", "loop_joint"))
            )
        elif how == "drop" and parent is not None:
            parent.remove(element)
        elif how == "double" and parent is not None:
            parent.append(etree.fromstring(etree.tostring(element)))
        elif how == "wrap":
            for _ in range(draw(st.sampled_from((1, 3, 100)))):
                inner = etree.SubElement(element, element.tag, dict(element.attrib))
                element = inner
    return etree.tostring(root)


_WORDS = st.sampled_from(
    [cell for cell in CELLS if "\x00" not in cell and len(cell) < 1000]
    + ["base", "tool", "upper", "yaw", "roll", "fixed", "prismatic", "revolute", "continuous", "floating", "planar"]
)


@cases(150)
@given(mutated_xml(URDF))
def test_a_spoilt_urdf_of_an_arm(text: bytes) -> None:
    path = written("spoilt.urdf", text)
    arm = written("of_spoilt.toml", PLAIN.replace("robot.urdf", "spoilt.urdf"))
    judge(lambda: load_arm(arm), path, bent, names=(arm.name,))


@cases(120)
@given(st.sampled_from((URDF, HEAVY)).flatmap(lambda text: st.one_of(mutated_xml(text), mutated_bytes(text.encode()))))
def test_a_spoilt_bare_urdf(text: bytes) -> None:
    path = written("bare.urdf", text)
    judge(lambda: load_arm(path), path, bent)


@cases(80)
@given(st.one_of(mutated_xml(MJCF), mutated_bytes(MJCF.encode())))
def test_a_spoilt_mjcf(text: bytes) -> None:
    path = written("crane.xml", text)
    judge(lambda: load_arm(path, tip="hook"), path, hung, names=("hook", "crane"))


def hung(arm: Arm) -> Mapping[str, Any]:
    """Return where the rigid arm is and what hangs on its joints."""
    found = arm.deflection(arm.robot.home)
    return {"pose": found.pose.homogeneous, "loads": found.joint_loads}
