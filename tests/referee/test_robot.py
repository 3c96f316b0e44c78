"""The robot's own models against Pinocchio's URDF reader, and which robots of others come through the front door.

The other robots are those of the example-robot-data package. Each file that is refused is listed with the reason, so
that a stricter or a laxer front door is noticed.
"""

from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from lxml import etree
from support.small_arms import ROBOTS

from armflex import Arm
from armflex.errors import UrdfError
from armflex.mechanics.pinocchio_model import FlexModel, build_model
from armflex.robot import Robot, Site, load_robot
from armflex.robot.urdf import MOVING


def example_robots() -> Path | None:
    try:
        return Path(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots"))
    except PackageNotFoundError:
        return None


OTHERS = example_robots()
FILES = {str(path.relative_to(OTHERS)): path for path in sorted(OTHERS.rglob("*.urdf"))} if OTHERS else {}
BUNDLED = {str(path.relative_to(ROBOTS)): path for path in sorted(ROBOTS.rglob("*.urdf"))}

REFUSED = {
    # Nothing to load, whatever the tip.
    "hector_description/robots/quadrotor_base.urdf": "no joint moves",
    "iris_description/robots/iris_simple.urdf": "no joint moves",
    "ur_description/urdf/ur3.urdf": "<robot> has no links",
    # Revolute joints of the chain that the specification gives no range to move in; up to the joint before it loads.
    "quadruped_description/urdf/quadruped.urdf": "'FL_KFE': a revolute joint needs lower and upper limits",
    # The deepest leaf is a finger without weight, or one that mimics another; with the hand as tip they are welcome.
    "romeo_description/urdf/romeo_laas_small.urdf": "'l_gripper' moves with joint 'l_gripper_joint' but has no",
    "alex_description/urdf/alex_psyonic_hands.urdf": "no joint named 'index_q1', did you mean 'Left_index_q1'",
    "romeo_description/urdf/romeo.urdf": "'LFinger11Link': mass is 0 kg",
    "talos_data/robots/talos_full_v2.urdf": "of the chain mimics",
    "talos_data/robots/talos_full_v2_box.urdf": "of the chain mimics",
    "tiago_pro_description/robots/tiago_pro.urdf": "of the chain mimics",
}

HANDS = {
    "panda_description/urdf/panda.urdf": "panda_hand",
    "pr2_description/urdf/pr2.urdf": "r_gripper_palm_link",
    "alex_description/urdf/alex_psyonic_hands.urdf": "Left_thumb_anchor",
    "talos_data/robots/talos_full_v2.urdf": "gripper_right_base_link",
    "talos_data/robots/talos_full_v2_box.urdf": "gripper_right_base_link",
    "tiago_pro_description/robots/tiago_pro.urdf": "gripper_left_base_link",
    "romeo_description/urdf/romeo.urdf": "l_gripper",
    "romeo_description/urdf/romeo_laas_small.urdf": "LArm_effector",
    "quadruped_description/urdf/quadruped.urdf": "FL_upperleg",
    "so_arm_description/urdf/so101.urdf": "gripper_frame_link",
    "centauro_description/urdf/centauro.urdf": "ball1_tip",
    "human_description/robots/human.urdf": "left_hand",
}


def deepest_leaf(path: Path) -> str | None:
    """Return the link with most moving joints above it, by the XML alone; None when the file has no links."""
    root = etree.parse(path).getroot()
    joints = [joint for joint in root.findall("joint") if joint.find("parent") is not None]
    above = {j.find("child").get("link"): (j.find("parent").get("link"), j.get("type") in MOVING) for j in joints}

    def depth(link: str) -> int:
        count = 0
        while link in above:
            link, moves = above[link]
            count += moves
        return count

    return max((link.get("name") for link in root.findall("link")), key=depth, default=None)


def full_configuration(model: pin.Model, robot: Robot, q: np.ndarray) -> np.ndarray:
    """Return Pinocchio's q of the whole file: the chain at q, side joints where they are locked."""
    full = pin.neutral(model)
    for name, value in {**robot.locked, **dict(zip(robot.joint_names, q, strict=True))}.items():
        joint = model.joints[model.getJointId(name)]
        full[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
    return full


def random_positions(robot: Robot, count: int) -> np.ndarray:
    return np.random.default_rng(5).uniform(robot.lower.clip(-3), robot.upper.clip(-3, 3), (count, len(robot.lower)))


def assert_close(mine: np.ndarray, theirs: np.ndarray, tolerance: float = 1e-10) -> None:
    assert np.abs(mine - theirs).max() <= tolerance * max(1.0, np.abs(theirs).max())


def assert_same_mechanics(robot: Robot, flex: FlexModel, reference: pin.Model, q: np.ndarray) -> None:
    full, chain = full_configuration(reference, robot, q), [reference.getJointId(name) for name in robot.joint_names]
    rows = [reference.joints[joint].idx_v for joint in chain]
    data, other = flex.model.createData(), reference.createData()
    assert_close(
        pin.computeGeneralizedGravity(flex.model, data, q), pin.computeGeneralizedGravity(reference, other, full)[rows]
    )
    pin.framesForwardKinematics(flex.model, data, q)
    pin.framesForwardKinematics(reference, other, full)
    assert_close(data.oMf[flex.tip].homogeneous, other.oMf[reference.getFrameId(robot.tip)].homogeneous)
    if "massless_inertia" in [flag.code for flag in robot.flags]:
        return  # Pinocchio takes the inertia of a body without mass, we do not
    mass, whole = pin.crba(flex.model, data, q), pin.crba(reference, other, full)
    assert_close(mass, whole[np.ix_(rows, rows)])
    v = np.linspace(-0.5, 0.7, len(q))
    fast = np.zeros(reference.nv)
    fast[rows] = v
    assert_close(pin.rnea(flex.model, data, q, v, -v), pin.rnea(reference, other, full, fast, -fast)[rows])


FOLLOWING = {"pr2_description/urdf/pr2.urdf": "r_gripper_l_finger_tip_link"}
"""Tips beyond a joint that mimics one of the chain."""

LOADED = [name for name in FILES if name not in REFUSED and name not in FOLLOWING]


@pytest.mark.parametrize("path", [*BUNDLED.values(), *(FILES[name] for name in LOADED)], ids=[*BUNDLED, *LOADED])
def test_rigid_model_against_pinocchios_reader(path):
    robot = load_robot(path, deepest_leaf(path))
    reference = pin.buildModelFromUrdf(str(path))
    flex = build_model(robot)
    for q in random_positions(robot, 3):
        assert_same_mechanics(robot, flex, reference, q)


@pytest.mark.skipif(not FILES, reason="example-robot-data is not installed")
@pytest.mark.parametrize(("name", "tip"), HANDS.items(), ids=HANDS)
def test_hands_with_mimicking_fingers_are_welcome(name, tip):
    robot = load_robot(FILES[name], tip)
    assert_same_mechanics(
        robot, build_model(robot), pin.buildModelFromUrdf(str(FILES[name])), random_positions(robot, 1)[0]
    )


@pytest.mark.skipif(not FILES, reason="example-robot-data is not installed")
@pytest.mark.parametrize(("name", "tip"), FOLLOWING.items(), ids=FOLLOWING)
def test_a_joint_that_mimics_one_of_the_chain_follows_it(name, tip):
    robot = load_robot(FILES[name], tip)
    reference = pin.buildModelFromUrdf(str(FILES[name]))
    data, arm = reference.createData(), Arm(robot)
    for q in random_positions(robot, 3):
        full, at = pin.neutral(reference), dict(zip(robot.joint_names, q, strict=True))
        for follower, (master, factor, offset) in robot.linkage.followers.items():
            at[follower] = factor * at[master] + offset
        for joint, value in at.items():
            own = reference.joints[reference.getJointId(joint)]
            wraps = own.nq == 2  # Pinocchio has a continuous joint as cosine and sine
            full[own.idx_q : own.idx_q + own.nq] = (np.cos(value), np.sin(value)) if wraps else value
        pin.framesForwardKinematics(reference, data, full)
        there, base = (data.oMf[reference.getFrameId(link)] for link in (tip, robot.base))
        expected = (base.inverse() * there).homogeneous
        np.testing.assert_allclose(arm.rigid_pose(q).homogeneous, expected, atol=1e-12)


@pytest.mark.parametrize("locked", [0.0, 0.02, 0.04])
@pytest.mark.skipif(not FILES, reason="example-robot-data is not installed")
def test_side_branches_stay_where_they_are_locked(locked):
    path = FILES["panda_description/urdf/panda.urdf"]
    robot = load_robot(path, "panda_hand", locked={"panda_finger_joint1": locked})
    assert robot.locked == {"panda_finger_joint1": locked, "panda_finger_joint2": locked}
    assert_same_mechanics(robot, build_model(robot), pin.buildModelFromUrdf(str(path)), random_positions(robot, 1)[0])


@pytest.mark.parametrize("name", REFUSED)
@pytest.mark.skipif(not FILES, reason="example-robot-data is not installed")
def test_refused_for_the_right_reason(name):
    with pytest.raises(UrdfError) as caught:
        load_robot(FILES[name], deepest_leaf(FILES[name]))
    assert REFUSED[name] in str(caught.value)
    assert str(caught.value).startswith(f"{FILES[name]}:{caught.value.place.line}: ") and caught.value.place.line > 0


@pytest.mark.parametrize("path", BUNDLED.values(), ids=BUNDLED)
def test_flexures_at_zero_change_nothing(path):
    robot = load_robot(path, "tool")
    sites = [Site(name, name) for name in robot.joint_names] + [Site("base", None)]
    rigid, flex = build_model(robot), build_model(robot, sites)
    assert len(flex.flexure_v) == 6 * len(sites) and flex.model.nv == rigid.model.nv + 6 * len(sites)
    for q in random_positions(robot, 3):
        bent = flex.neutral.copy()
        bent[flex.q_index] = q
        torque = pin.computeGeneralizedGravity(flex.model, flex.model.createData(), bent)[flex.v_index]
        assert_close(torque, pin.computeGeneralizedGravity(rigid.model, rigid.model.createData(), q), 1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("path", BUNDLED.values(), ids=BUNDLED)
def test_a_base_further_out_leaves_out_what_is_above(path):
    robot = load_robot(path, "tool")
    base = robot.moving[1].child
    part = load_robot(path, robot.tip, base)
    assert part.joint_names == robot.joint_names[2:]
    q = random_positions(robot, 1)[0]
    whole, rest = build_model(robot), build_model(part)
    poses = []
    for flex, position, frame in ((whole, q, whole.frame(base)), (whole, q, whole.tip), (rest, q[2:], rest.tip)):
        data = flex.model.createData()
        pin.framesForwardKinematics(flex.model, data, position)
        poses.append(data.oMf[frame])
    assert_close((poses[0].inverse() * poses[1]).homogeneous, poses[2].homogeneous, 1e-13)
    assert pin.computeTotalMass(rest.model) < pin.computeTotalMass(whole.model)
