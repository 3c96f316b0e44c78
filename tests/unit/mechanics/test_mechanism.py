"""Machines with loops: how they answer, which way they close, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import brentq
from support.machines import CRANE, FIVE_BAR, MACHINES, PARALLELOGRAM, UNEVEN, Hinge, Machine, Y, Z, poses
from support.small_arms import central_difference

import armflex
from armflex.errors import ArmFileError, ClosureError
from armflex.laws import LinearLaw
from armflex.mechanics.deflection import Deflection
from armflex.mechanics.response import respond
from armflex.rows.wrench import Wrench


def bent(machine: Machine, folder) -> armflex.Arm:
    """Return a machine that gives about and along all axes, with a pin and gravity springs that do."""
    full = "[2e-8, 3e-8, 1e-8, 5e-7, 4e-7, 6e-7]"
    machine.load(folder)
    text = (folder / "arm.toml").read_text()
    lines = [f"compliance = {full}" if line.startswith("compliance") else line for line in text.splitlines()]
    lines = [f"{line}\ncompliance = [3e-8, 2e-8, 4e-8, 0, 0, 0]" if line.startswith("kind") else line for line in lines]
    lines = [
        f"{line}\naxis = [0, 1, 0]" if 'kind = "revolute"' in line else line for line in lines if "axis = " not in line
    ]
    (folder / "arm.toml").write_text("\n".join(lines))
    return armflex.load_arm(folder / "arm.toml")


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_the_response_of_a_mechanism_is_its_derivative(name, tmp_path):
    arm, q = bent(MACHINES[name], tmp_path), poses(name)[0]
    line = respond(arm, q[None], ["none"])
    found = arm.deflection(q)

    def turned(result: Deflection) -> np.ndarray:
        turn = pin.log3(result.pose.rotation @ found.pose.rotation.T)
        return np.concatenate([result.pose.translation, turn])

    by_drive = central_difference(lambda at: turned(arm.deflection(at)), q, 1e-5)
    np.testing.assert_allclose(line.joints[0], by_drive, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(found.total_jacobian, by_drive, rtol=1e-6, atol=1e-7)

    def pushed(force: np.ndarray, link: str = "tool") -> np.ndarray:
        return turned(arm.deflection(q, wrenches=(Wrench(link, force[:3], force[3:]),)))

    by_load = central_difference(pushed, np.zeros(6), 1.0)
    np.testing.assert_allclose(found.compliance, by_load, rtol=1e-5, atol=1e-13)
    carried = next(link for link in line.link_names if link not in ("base", "tool"))
    by_load = central_difference(lambda force: pushed(force, carried), np.zeros(6), 1.0)
    np.testing.assert_allclose(line.link_loads[0, line.link_names.index(carried)], by_load, rtol=1e-5, atol=1e-13)

    def falling(gravity: np.ndarray) -> np.ndarray:
        return turned(replace(arm, robot=replace(arm.robot, gravity=gravity)).deflection(q))

    by_gravity = central_difference(falling, arm.robot.gravity, 1e-3)
    np.testing.assert_allclose(line.gravity[0], by_gravity, rtol=1e-5, atol=1e-9)
    # First order adds up: what flexures give, of which the loops' pins are some, is what the tip moves by.
    assert np.linalg.norm(found.remainder[:3]) < 0.02 * np.linalg.norm(found.displacement[:3])


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_laws_of_flexures_pins_and_cylinders_move_the_tip_as_the_response_says(name, tmp_path):
    arm, q = bent(MACHINES[name], tmp_path), poses(name)[1]
    line, step = respond(arm, q[None], ["none"]), 1e-3
    for i, flexure in enumerate(arm.flexures):
        load, law = line.flexure_wrenches[0, i], flexure.law
        assert isinstance(law, LinearLaw)
        for axis in np.flatnonzero(np.abs(law.constant @ load) > 1e-12):
            tips = []
            for side in (1.0, -1.0):
                softer = law.constant.copy()
                softer[axis, axis] *= 1.0 + side * step
                own = (*arm.flexures[:i], replace(flexure, law=replace(law, compliance=softer)), *arm.flexures[i + 1 :])
                tips.append(replace(arm, flexures=own).deflection(q).pose.translation)
            predicted = line.laws[0, :3, i, axis] * law.constant[axis, axis] * load[axis]
            measured = (tips[0] - tips[1]) / (2.0 * step)
            np.testing.assert_allclose(predicted, measured, rtol=1e-5, atol=1e-11)


def test_many_rows_answer_as_each_by_itself(tmp_path):
    arm, q = UNEVEN.load(tmp_path), poses("uneven", 6)
    batch, line = arm.deflection(q), respond(arm, q, ["none"] * len(q))
    for i in range(len(q)):
        alone = arm.deflection(q[i])
        np.testing.assert_allclose(batch.displacement[i], alone.displacement, atol=1e-12)
        np.testing.assert_allclose(batch.contributions[i], alone.contributions, atol=1e-12)
        np.testing.assert_allclose(batch.drive_loads[i], alone.drive_loads, atol=1e-6)
        np.testing.assert_allclose(line.tip[i], alone.pose.homogeneous, atol=1e-12)
        load = alone.wrenches[alone.names.flexures.index("crank")]
        np.testing.assert_allclose(line.load_at("crank")[i], load, atol=1e-6)
    prepared = arm.prepared()
    np.testing.assert_allclose(prepared(q[2]), batch.displacement[2], atol=1e-12)


def test_what_is_said_of_a_mechanism_is_in_its_plain_values(tmp_path):
    found = CRANE.load(tmp_path).deflection(poses("crane")[0])
    told = found.to_dict()
    assert set(told["passive"]) == {"boom", "jib"}
    assert told["cylinder_states"]["lift"][1] == pytest.approx(found.drive_loads[1])
    assert told["loop_loads"] == {}


def test_the_branch_is_chosen_by_q0_and_followed(tmp_path):
    """A four-bar closes with its rod on either side; the drive alone does not choose."""
    machine = replace(PARALLELOGRAM, loops={"tail": ("rod", (0.0, 0.0, 0.9), "fore", (-0.5, 0.0, 0.0), (0, 1, 0))})
    arm = machine.load(tmp_path)
    text = (tmp_path / "arm.toml").read_text()
    found = arm.deflection(np.zeros(3)).passive
    (tmp_path / "other.toml").write_text(
        text.replace("[joint.elbow]\npassive = true", "[joint.elbow]\npassive = true\nq0 = 2.5").replace(
            "[joint.foot]\npassive = true", "[joint.foot]\npassive = true\nq0 = 1.0"
        )
    )
    other = armflex.load_arm(tmp_path / "other.toml")
    elsewhere = other.deflection(np.zeros(3)).passive
    assert abs(elsewhere["elbow"] - found["elbow"]) > 0.5
    q = np.linspace([0.0, 0.0, 0.0], [0.0, 0.3, -0.2], 12)
    steps = np.diff([other.deflection(row).passive["elbow"] for row in q])
    assert np.abs(steps).max() < 0.2


def test_a_pose_that_cannot_close_is_an_error_with_row_loop_and_gap(tmp_path):
    arm = CRANE.load(tmp_path)
    q = np.tile(poses("crane")[0], (3, 1))
    q[1, 1:] = (1.55, 1.9)  # longer than boom and jib are ever apart
    with pytest.raises(ClosureError, match=r"row 1: loop 'fold' cannot close here.* gaps by [0-9.]+ mm") as caught:
        arm.deflection(q)
    assert caught.value.loop == "fold" and 1e-3 < caught.value.gap < 2.0


FOUR_BAR = Machine(
    hinges={
        "drive": Hinge("base", "crank", (0.0, 0.0, 0.0), Z),
        "rocker": Hinge("base", "rocker", (1.0, 0.0, -0.5), Y, passive=True),
        "lift": Hinge("crank", "cross", (0.3, 0.0, 0.0), Y, passive=True),
        "swing": Hinge("cross", "rod", (0.0, 0.0, 0.0), Z, passive=True),
    },
    bodies={
        "crank": (5.0, (0.1, 0.0, 0.0)),
        "rocker": (5.0, (0.0, 0.0, 0.2)),
        "cross": (1.0, (0.0, 0.0, 0.01)),
        "rod": (2.0, (0.3, 0.0, 0.0)),
    },
    gives={"drive": (Z, 1e5)},
    loops={"ball": ("rod", (0.7, 0.0, 0.0), "rocker", (0.0, 0.0, 0.5), None)},
    tool=("rocker", (0.0, 0.0, 0.5)),
)
"""A spatial four-bar: two hinges across each other, and a rod of 0.7 m with a ball at its end."""


@pytest.mark.parametrize("beyond", [1e-5, 1e-3, 0.1, 0.3])
def test_a_pose_beyond_closing_says_at_which_position_and_by_how_much(beyond: float, tmp_path: Path) -> None:
    """The end of the rocker is on a circle: how far the drive is beyond reaching it with the rod is known."""

    def gap(at: float) -> float:
        x, y = 0.3 * np.cos(at), 0.3 * np.sin(at)
        return float(np.hypot(np.hypot(1.0 - x, 0.5) - 0.5, y) - 0.7)

    last = brentq(gap, 0.5, 3.0)
    arm, at = FOUR_BAR.load(tmp_path), last + beyond
    assert "ball" in arm.deflection([last - 1e-4]).loop_loads
    with pytest.raises(ClosureError, match=rf"row 1: loop 'ball' cannot close here, at drive={at:.6g}: ") as caught:
        arm.deflection([[0.0], [at], [0.1]])
    assert caught.value.gap == pytest.approx(gap(at), rel=1e-3, abs=1e-9)
    with pytest.raises(ClosureError, match="cannot close here, at drive=") as caught:
        FOUR_BAR.load(tmp_path).deflection([at])
    assert caught.value.gap == pytest.approx(gap(at), rel=1e-3, abs=1e-9)


def test_a_singular_pose_is_an_error_that_names_the_joint(tmp_path):
    """The parallelogram lies flat: its rod could go on either way."""
    arm = PARALLELOGRAM.load(tmp_path)
    with pytest.raises(ClosureError, match=r"'tail' is singular here: it does not hold passive joint '(elbow|foot)'"):
        arm.deflection([0.0, 0.0, np.pi / 2])
    with pytest.raises(ClosureError, match="leads through a singular pose"):
        arm.deflection([0.0, 0.0, 1.8])


REFUSED = {
    "a loop onto its own link": ('to = "fore"', 'to = "rod"', "both ends are on link 'rod'"),
    "a link that does not exist": ('link = "rod"', 'link = "rood"', "no link 'rood'.*did you mean 'rod'"),
    "a point metres off": ("at = [0.0, 0.0, 1.1]", "at = [0.0, 0.0, 2.4]", "'tail' closes nowhere.* gaps by"),
    "a point in millimetres": ("at = [0.0, 0.0, 1.1]", "at = [0.0, 0.0, 1100.0]", "millimetres"),
    "an unknown kind": ('kind = "revolute"', 'kind = "revolut"', "did you mean 'revolute'"),
    "no axis": ("axis = [0.0, 1.0, 0.0]", "", "axis"),
    "an axis without direction": ("axis = [0.0, 1.0, 0.0]", "axis = [0.0, 0.0, 0.0]", "no direction"),
    "a passive joint that nothing holds": (
        "[joint.foot]",
        "[joint.turn]\npassive = true\n[joint.foot]",
        "nothing would hold it",
    ),
    "a cylinder around a joint with a drive": (
        "[joint.foot]",
        '[cylinder.jack]\nlink = "column"\nat = [0.3, 0.0, 0.0]\nto = "arm"\nat_to = [0.0, 0.0, 0.5]\n'
        "lower = 0.1\nupper = 2.0\n[joint.foot]",
        "'jack' joins 'column' to 'arm', and lower between them has a drive: .*passive = true",
    ),
    "a passive joint that does not exist": ("[joint.foot]", "[joint.fot]", "no joint 'fot'.*did you mean 'foot'"),
    "a flexure nowhere": ('joint = "crank"', 'joint = "cranc"', "did you mean 'crank'"),
    "a loop of a joint's name": ('name = "tail"', 'name = "foot"', "choose another one"),
    "a key that is none": ('kind = "revolute"', 'kind = "revolute"\nkinds = 1', "did you mean 'kind'"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_declaration_that_cannot_be_meant_is_refused_with_its_line(case, tmp_path):
    PARALLELOGRAM.load(tmp_path)
    file = tmp_path / "arm.toml"
    old, new, said = REFUSED[case]
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(ArmFileError, match=said) as caught:
        armflex.load_arm(file)
    assert caught.value.place.line > 0


SAME = {
    "at the same point": (*PARALLELOGRAM.loops["tail"][:4], None),
    "along the same axis": ("rod", (0.0, 0.2, 1.1), "fore", (-0.4, 0.2, 0.0), (0, 1, 0)),
}


@pytest.mark.parametrize("case", SAME)
def test_two_loops_that_say_the_same_are_refused(case, tmp_path):
    machine = replace(PARALLELOGRAM, loops={**PARALLELOGRAM.loops, "again": SAME[case]})
    with pytest.raises(ArmFileError, match="'again' says what 'tail' says"):
        machine.load(tmp_path)


def test_a_mimic_joint_follows_and_loads_its_drive(tmp_path):
    """The elbow turns with the shoulder by a belt: as if its position were given, but for the load of the drive."""
    machine = replace(PARALLELOGRAM, loops={}, gives={"lower": ((0, 1, 0), 3e5)})
    hinges = {name: replace(machine.hinges[name], passive=False) for name in ("turn", "lower", "elbow")}
    bodies = {name: machine.bodies[name] for name in ("column", "arm", "fore")}
    machine = replace(machine, hinges=hinges, bodies=bodies)
    driven = machine.load(tmp_path)
    file = tmp_path / "robot.urdf"
    head, tail = file.read_text().split('<joint name="elbow"')
    file.write_text(f'{head}<joint name="elbow"{tail.replace("</joint>", MIMIC + "</joint>", 1)}')
    tied = armflex.load_arm(tmp_path / "arm.toml")
    assert tied.joint_names == ("turn", "lower")
    found, free = tied.deflection([0.2, 0.4]), driven.deflection([0.2, 0.4, -0.7])
    assert found.passive == {"elbow": pytest.approx(-0.7)}
    assert np.linalg.norm(found.pose.translation - free.pose.translation) < 1e-12
    own, elbow = free.drive_loads[1:]
    assert found.drive_loads[1] == pytest.approx(own - 2.0 * elbow)


MIMIC = '<mimic joint="lower" multiplier="-2" offset="0.1"/>'


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_frames_pins_and_zeros_move_the_tip_as_the_response_says(name, tmp_path):
    arm, q = bent(MACHINES[name], tmp_path), poses(name)[2]
    line, step, base = respond(arm, q[None], ["none"]), 1e-5, arm.corrections
    for frame in arm.robot.frames:
        predicted = line.site(f"link:{frame}")[0]

        def moved(twist: np.ndarray, frame: str = frame) -> np.ndarray:
            return replace(arm, corrections=replace(base, geometry={frame: twist})).deflection(q).pose.translation

        measured = central_difference(moved, np.zeros(6), step)
        np.testing.assert_allclose(predicted[:3], measured, rtol=1e-4, atol=2e-6, err_msg=frame)

    def zeroed(offset: np.ndarray) -> np.ndarray:
        offsets = dict(zip(arm.joint_names, offset.tolist(), strict=True))
        return replace(arm, corrections=replace(base, joint_offset=offsets)).deflection(q).pose.translation

    np.testing.assert_allclose(line.joints[0, :3], central_difference(zeroed, np.zeros(len(q)), step), atol=1e-7)


OIL = "bore = 0.14\nrod = 0.09\nbulk_modulus = 1.4e9\ndead_volume = 2e-4"


def test_an_oil_column_is_as_stiff_as_the_oil_on_both_sides_of_its_piston(tmp_path):
    CRANE.load(tmp_path)
    file = tmp_path / "arm.toml"
    file.write_text(file.read_text().replace("stiffness = 20000000.0", OIL, 1))
    arm, q = armflex.load_arm(file), poses("crane")[0]
    found = arm.deflection(q)
    (length, tension), column = found.cylinder_states["lift"], q[1]
    head, ring = np.pi / 4 * 0.14**2, np.pi / 4 * (0.14**2 - 0.09**2)
    stiffness = 1.4e9 * (head**2 / (head * (column - 0.9) + 2e-4) + ring**2 / (ring * (2.2 - column) + 2e-4))
    assert tension == pytest.approx(stiffness * (length - column), rel=1e-9)
    by_drive = central_difference(lambda at: arm.deflection(at).pose.translation, q, 1e-5)
    np.testing.assert_allclose(found.total_jacobian[:3], by_drive, rtol=1e-6, atol=1e-8)
    law = next(one.law for one in arm.flexures if one.name == "lift")
    row, load = arm.loaded(None).row(q, {}), np.array([-2e4, 0, 0, 0, 0, 0.0])
    changed = central_difference(lambda values: law.at(values).twist(load, row), law.values, 1e4)
    np.testing.assert_allclose(law.by_values(load, row), changed, rtol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [("rod = 0.09", "rod = 0.2", "less than the bore"), ("bulk_modulus = 1.4e9\n", "", "bulk_modulus"),
     ("bore", "stiffness = 1e7\nbore", "give one of them"), ("2e-4", "-1.0", "0 m.3 or more")],
)  # fmt: skip
def test_an_oil_column_that_cannot_be_is_refused(old, new, said, tmp_path):
    CRANE.load(tmp_path)
    file = tmp_path / "arm.toml"
    file.write_text(file.read_text().replace("stiffness = 20000000.0", OIL.replace(old, new), 1))
    with pytest.raises(ArmFileError, match=said):
        armflex.load_arm(file)


@pytest.mark.parametrize(("bore", "doubted"), [("0.14", False), ("140.0", True)])
def test_a_bore_in_millimetres_is_asked_about(tmp_path: Path, bore: str, doubted: bool) -> None:
    CRANE.load(tmp_path)
    file = tmp_path / "arm.toml"
    file.write_text(file.read_text().replace("stiffness = 20000000.0", OIL.replace("0.14", bore), 1))
    said = [flag.text for flag in armflex.load_arm(file).flags if flag.code == "long"]
    text = "cylinder 'lift': its bore of 140 m is more than its shortest length, 0.9 m: millimetres? Taken as metres"
    assert said == [text] * doubted


def test_what_is_doubtful_of_a_mechanism_is_flagged(tmp_path):
    arm = PARALLELOGRAM.load(tmp_path)
    assert [flag.code for flag in arm.deflection(np.zeros(3)).flags] == ["undetermined_loads"]
    file = tmp_path / "robot.urdf"
    head, tail = file.read_text().split('<joint name="elbow"')
    file.write_text(head + '<joint name="elbow"' + tail.replace('lower="-3"', 'lower="-0.1"', 1))
    found = armflex.load_arm(tmp_path / "arm.toml").deflection([0.0, 0.3, 0.0])
    assert any(flag.code == "passive_limits" and "'elbow'" in flag.text for flag in found.flags)
    assert not FIVE_BAR.load(tmp_path).deflection(np.zeros(2)).flags
