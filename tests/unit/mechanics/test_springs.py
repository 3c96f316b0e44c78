from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from support.small_arms import ROBOTS
from support.sprung_arm import BALANCER, JOINTS, STRUT, TIE, sprung

from armflex import Wrench, load_arm
from armflex.errors import ArmFileError, ConvergenceError, InputError, UnknownNameError, UnsupportedError
from armflex.mechanics.many_rows import RowSolver
from armflex.mechanics.response import respond
from armflex.mechanics.spring import CoilSpring, GasSpring
from armflex.robot import Corrections

SPRINGS = (BALANCER, TIE, STRUT)
Q = np.array([0.3, 0.5, 0.4])


@pytest.fixture
def arm(tmp_path):
    return sprung(tmp_path, SPRINGS, full=True)


@pytest.mark.parametrize("law", [BALANCER.law, TIE.law, STRUT.law])
def test_rates_are_the_change_of_the_tension(law):
    length, step = 1.1, 1e-5
    quotient = (law.tension(length + step) - law.tension(length - step)) / (2.0 * step)
    assert law.rate(length) == pytest.approx(quotient, rel=1e-8)


@pytest.mark.parametrize("law", [BALANCER.law, TIE.law, STRUT.law])
def test_tensions_change_with_what_is_found_as_by_finite_differences(law):
    weak = replace(replace(BALANCER, law=law).moved(np.full(len(law.parameters), 0.03)).law, strength=0.7)
    lengths, size = np.array([0.5, 0.8]), 1e-6
    for i, change in enumerate(weak.by_found(lengths)):
        step = size * np.eye(len(weak.parameters))[i]
        ends = [replace(BALANCER, law=weak).moved(side * step).law for side in (1.0, -1.0)]
        quotient = [(ends[0].tension(at) - ends[1].tension(at)) / (2.0 * size) for at in lengths]
        np.testing.assert_allclose(change, quotient, rtol=1e-8)
    assert replace(weak, strength=0.0).tension(0.8) == 0.0


def test_tensions_as_declared():
    assert BALANCER.law.tension(0.7) == pytest.approx(6e3)
    assert TIE.law.tension(1.2) == pytest.approx(2.8e3)
    assert STRUT.law.tension(2.0) == pytest.approx(-9e6 * 1.2e-3 / 2.0**1.3)


@pytest.mark.parametrize("pushes", [(), (Wrench("fore", [30.0, -20.0, 50.0], [4.0, 5.0, 6.0], "frame"),)])
@pytest.mark.parametrize("moves", [False, True])
def test_stiffness_is_the_change_of_the_torque(arm, pushes, moves):
    v, a = ([0.3, -0.5, 0.7], [1.0, 2.0, -1.0]) if moves else (None, None)
    found = arm.deflection(Q, wrenches=pushes, v=v, a=a)
    solved, mechanics = found.solved, found.solved.loaded.mechanics
    load, here, step = mechanics.load(solved.case), solved.placed.configuration, 1e-6
    steps = step * np.eye(mechanics.model.nv)
    ahead, back = ([load(pin.integrate(mechanics.model, here, sign * one)) for one in steps] for sign in (1.0, -1.0))
    quotient = (np.array(ahead) - np.array(back)).T / (2.0 * step)
    stiffness = mechanics.stiffness(here, solved.case)
    places = mechanics.flex.flexure_v  # joints move against the velocities that they have
    np.testing.assert_allclose(stiffness[:, places], quotient[:, places], atol=1e-8 * np.abs(quotient).max())


def test_every_method_batch_and_prepared_agree(arm):
    rows = Q + np.linspace(0.0, 0.4, 5)[:, None]
    single = [arm.deflection(q, method="newton") for q in rows]
    batch = arm.deflection(rows)
    for i, one in enumerate(single):
        np.testing.assert_allclose(batch.displacement[i], one.displacement, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(batch.wrenches[i], one.wrenches, rtol=0.0, atol=1e-6)
        np.testing.assert_allclose(batch.drive_loads[i], one.drive_loads, rtol=0.0, atol=1e-6)
    prepared = arm.prepared()
    np.testing.assert_allclose(prepared(Q), single[0].displacement, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(prepared.wrenches, single[0].wrenches, rtol=0.0, atol=1e-6)


def test_a_spring_carries_what_its_drive_need_not(tmp_path):
    loads = {
        springs: sprung(tmp_path, springs).deflection([0.0, 0.6, 0.0]).drive_loads for springs in ((), (BALANCER,))
    }
    found = sprung(tmp_path, (BALANCER,)).deflection([0.0, 0.6, 0.0])
    poses, (length, tension) = found.link_poses(), found.spring_states[0]
    ends = [(poses[link] @ [*point, 1.0])[:3] for link, point in BALANCER.ends]
    assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(length, abs=1e-12)
    assert tension == pytest.approx(60e3 * (length - 0.6), rel=1e-9)
    pivot = poses["arm"][:3, 3]
    moment = np.cross(ends[1] - pivot, tension / length * (ends[0] - ends[1]))[1]
    assert abs(moment) > 2e3
    # Both bend differently, so the rest of the load is not the same to the last digit.
    assert loads[(BALANCER,)][1] - loads[()][1] == pytest.approx(moment, rel=2e-2)


def test_responses_by_finite_differences(arm):
    step, payload = 1e-5, "none"
    found = respond(arm, np.array([Q, Q + 0.2]), [payload] * 2)
    for i, q in enumerate((Q, Q + 0.2)):
        for joint in range(3):
            moved = [arm.deflection(q + sign * step * np.eye(3)[joint]).pose for sign in (1.0, -1.0)]
            shift = (moved[0].translation - moved[1].translation) / (2.0 * step)
            np.testing.assert_allclose(found.joints[i, :3, joint], shift, atol=2e-8)
        for name in JOINTS:
            corrected = [
                replace(arm, corrections=Corrections(joint_offset={name: sign * step})).deflection(q).pose
                for sign in (1.0, -1.0)
            ]
            shift = (corrected[0].translation - corrected[1].translation) / (2.0 * step)
            axis = np.array(JOINTS[name][3])
            np.testing.assert_allclose(found.site(f"link:{name}")[i, :3, 3:] @ axis, shift, atol=2e-8)


def test_what_a_push_does_by_finite_differences(arm):
    push, found = np.array([100.0, -50.0, 80.0]), arm.deflection(Q)
    moved = [arm.deflection(Q, wrenches=[Wrench("tool", sign * push)]).pose.translation for sign in (1.0, -1.0)]
    np.testing.assert_allclose(found.compliance[:3, :3] @ push, (moved[0] - moved[1]) / 2.0, rtol=0.0, atol=1e-8)


def test_ends_that_meet_are_refused_with_the_row(arm):
    pose = arm.deflection(Q).link_poses()
    point = np.linalg.solve(pose["arm"], pose["column"] @ [0.0, 0.0, 0.5, 1.0])[:3]
    meets = replace(BALANCER, at=np.array([0.0, 0.0, 0.5]), at_to=point, law=CoilSpring(1.0, 1.0))
    rigid = replace(arm, flexures=(), springs=())
    there = rigid.deflection(Q).link_poses()
    point = np.linalg.solve(there["arm"], there["column"] @ [0.0, 0.0, 0.5, 1.0])[:3]
    meets = replace(meets, at_to=point)
    with pytest.raises(ConvergenceError, match=r"row 1.*spring 'balancer': its ends meet"):
        replace(arm, flexures=(), springs=(meets,)).deflection(np.array([Q + 0.1, Q]))


def test_what_cannot_do_springs_says_so(arm):
    with pytest.raises(UnsupportedError, match="springs"):
        RowSolver(arm.loaded(None))


def test_links_that_an_arm_has_not(arm):
    with pytest.raises(UnknownNameError, match="colum"):
        replace(arm, springs=(replace(BALANCER, link="colum"),))
    with pytest.raises(InputError, match="both ends"):
        replace(BALANCER, to="column")


LINEAR = {"rate": "60e3", "free_length": "0.6"}
GAS = {"pressure": "9e6", "area": "1.2e-3", "length0": "0.9"}


def declared(tmp_path, law=LINEAR, **changed):
    """Return the path of an arm.toml with a spring, some of its keys changed, or left out by None."""
    ends = {"link": '"link1"', "at": "[-0.3, 0, -0.1]", "to": '"link2"', "at_to": "[0.1, 0.0, 0.4]"}
    keys = {key: value for key, value in {**ends, **law, **changed}.items() if value is not None}
    folder = ROBOTS / "heavy_six"
    text = (folder / "arm.toml").read_text().replace('"robot.urdf"', f'"{(folder / "robot.urdf").as_posix()}"')
    path = tmp_path / "arm.toml"
    path.write_text("\n".join([text, "[spring.balancer]", *(f"{key} = {value}" for key, value in keys.items())]))
    return path


def test_springs_of_a_file(tmp_path):
    (spring,) = load_arm(declared(tmp_path)).springs
    assert (spring.name, spring.link, spring.to) == ("balancer", "link1", "link2")
    assert spring.law == CoilSpring(60e3, 0.6)
    (spring,) = load_arm(declared(tmp_path, free_length=None, preload="-2e3", length0="0.9")).springs
    assert spring.law == CoilSpring(60e3, 0.9, -2e3)
    (spring,) = load_arm(declared(tmp_path, GAS)).springs
    assert spring.law == GasSpring(9e6, 1.2e-3, 0.9, 1.0)
    (spring,) = load_arm(declared(tmp_path, GAS, exponent="1.4")).springs
    assert spring.law == GasSpring(9e6, 1.2e-3, 0.9, 1.4)


@pytest.mark.parametrize(
    ("law", "changed", "says"),
    [
        (LINEAR, {"link": '"lonk1"'}, "no link 'lonk1'.*link1"),
        (LINEAR, {"to": '"link1"'}, "both ends are on link 'link1'"),
        (LINEAR, {"link": '"link6"', "to": '"tool"'}, "no joint moves 'tool' against 'link6'"),
        (LINEAR, {"at": "[-300, 0, -100]"}, "at: is .* millimetres"),
        (LINEAR, {"rate": "-1.0"}, "rate: expected more than 0 N/m"),
        (LINEAR, {"free_length": None}, "needs 'free_length'"),
        (LINEAR, {"preload": "3.0"}, "preload: stands beside 'free_length'"),
        (LINEAR, {"stiffness": "3.0"}, "unknown key"),
        (GAS, {"rate": "3.0"}, "pressure: is of a gas spring"),
        (GAS, {"exponent": "7.0"}, "exponent: is 7"),
        (GAS, {"area": "0"}, "area: expected more than 0 m"),
    ],
)
def test_what_is_no_spring_is_refused_with_its_line(tmp_path, law, changed, says):
    path = declared(tmp_path, law, **changed)
    with pytest.raises(ArmFileError, match=says) as caught:
        load_arm(path)
    line = caught.value.place.line
    assert path.read_text().split("\n")[line - 1].partition(" ")[0] in (*changed, "[spring.balancer]", "pressure")
