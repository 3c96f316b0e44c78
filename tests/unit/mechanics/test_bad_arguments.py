"""Rows 19 to 28 of the table of bad inputs: positions, poses, names, payloads, units, gravity."""

import numpy as np
import pinocchio as pin
import pytest
from support.two_links import Q, codes, declared

from armflex import Arm, Flexure, Payload, Wrench, load_arm
from armflex.conventions import as_pose, parse_quantity
from armflex.errors import (
    ArmflexWarning,
    ArrayTypeError,
    InputError,
    JointLimitError,
    NotFiniteError,
    PayloadError,
    PoseError,
    ShapeError,
    UnitError,
    UnknownNameError,
)
from armflex.laws import LinearLaw


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Arm:
    return load_arm(declared(tmp_path_factory.mktemp("arm")))


# Rows 19 to 21: joint positions.

POSITIONS = {
    "row19-short": ([0.2], ShapeError, "shoulder, elbow"),
    "row19-long": ([0.2, 0.1, 0.3], ShapeError, r"expected shape \(2,\)"),
    "row19-n-by-1": ([[0.2], [0.1]], ShapeError, "q"),
    "row19-scalar": (0.2, ShapeError, "q"),
    "row19-empty": ([], ShapeError, "q"),
    "row19-three-dimensional": (np.zeros((1, 1, 2)), ShapeError, "q"),
    "row19-ragged": ([[0.2], [0.1, 0.2]], ShapeError, "different length"),
    "row19-complex": ([0.2, 1j], ArrayTypeError, "complex"),
    "row19-text": (["0.2", "0.1"], ArrayTypeError, "q"),
    "row19-word": ("home", ArrayTypeError, "q"),
    "row19-object": ([0.2, None], ArrayTypeError, "object"),
    "row19-dict": ({"shoulder": 0.2}, ArrayTypeError, "q"),
    "row19-bool": ([True, False], ArrayTypeError, "bool"),
    "row20-nan": ([0.2, np.nan], NotFiniteError, "'elbow'"),
    "row20-inf": ([np.inf, 0.2], NotFiniteError, "'shoulder'"),
    "row20-1e300": ([0.2, -1e300], NotFiniteError, "'elbow'"),
    "row20-1001": ([0.2, 1001.0], NotFiniteError, "'elbow'"),
    "row20-nan-in-a-batch": ([Q, [0.2, np.nan]], NotFiniteError, "'elbow'"),
    "row21-above": ([1.61, 0.0], JointLimitError, r"'shoulder' at 1\.61 .*\[-1\.5, 1\.6\]"),
    "row21-below": ([0.0, -2.1], JointLimitError, r"'elbow' at -2\.1 .*\[-2, 2\.1\]"),
    "row21-in-a-batch": ([Q, [0.0, -2.1]], JointLimitError, "'elbow'"),
}


@pytest.mark.parametrize(("q", "error", "words"), POSITIONS.values(), ids=POSITIONS)
def test_bad_position(arm, q, error, words):
    with pytest.raises(error, match=words):
        arm.deflection(q)


@pytest.mark.parametrize("q", [[0, 1], (0.0, 1.0), np.array([0, 1], dtype=np.int8), np.float32([0, 1])], ids=str)
def test_row19_lists_and_integers_are_welcome(arm, q):
    assert np.array_equal(arm.deflection(q).displacement, arm.deflection(np.array([0.0, 1.0])).displacement)


@pytest.mark.parametrize("name", ["v", "a"])
@pytest.mark.parametrize(
    ("values", "error"), [([1.0], ShapeError), ([1.0, np.nan], NotFiniteError), (["1", "2"], ArrayTypeError)], ids=str
)
def test_rows19_and_20_for_motion(arm, name, values, error):
    with pytest.raises(error, match=f"^{name}"):
        arm.deflection(Q, **{name: values})
    with pytest.raises(InputError, match=f"^{name}"):
        arm.deflection([Q, Q], **{name: values})


def test_row21_limits_can_be_flagged_instead(arm):
    result = arm.deflection([1.61, 0.0], enforce_limits=False)
    assert codes(result) == ["outside_limits"] and "'shoulder'" in str(result.flags[0])
    batch = arm.deflection([Q, Q, [1.61, 0.0]], enforce_limits=False)
    assert codes(batch) == ["outside_limits"] and "row 2" in str(batch.flags[0])


# Rows 22 and 23: poses.

TURN = pin.Quaternion(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3)).coeffs()
MATRIX = np.block([[pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([[1.0], [2.0], [3.0]])], [np.zeros(3), np.ones(1)]])


def with_entry(matrix: np.ndarray, place: tuple[int, int], value: float) -> np.ndarray:
    changed = matrix.copy()
    changed[place] = value
    return changed


POSES = {
    "row22-zero-quaternion": (np.zeros(7), PoseError, "norm 0"),
    "row22-norm-2": ([1, 2, 3, *(2 * TURN)], PoseError, "norm 2"),
    "row22-norm-off-by-2e-6": ([1, 2, 3, *(TURN * (1 + 2e-6))], PoseError, "norm"),
    "row22-nan": ([1, 2, 3, np.nan, 0, 0, 1], NotFiniteError, "element 3"),
    "row22-six-numbers": (np.zeros(6), ShapeError, "4, 4"),
    "row22-text": ("home", ArrayTypeError, "pose"),
    "row23-reflected": (MATRIX @ np.diag([1, 1, -1, 1]), PoseError, "reflection"),
    "row23-scaled": (MATRIX @ np.diag([1.001, 1, 1, 1]), PoseError, "orthonormal"),
    "row23-sheared": (with_entry(MATRIX, (0, 1), 0.5), PoseError, "orthonormal"),
    "row23-last-row": (with_entry(MATRIX, (3, 0), 0.5), PoseError, "last row"),
    "row23-nan": (with_entry(MATRIX, (0, 3), np.nan), NotFiniteError, "pose"),
    "row23-3-by-3": (np.eye(3), ShapeError, "4, 4"),
    "row23-se3-not-orthonormal": (pin.SE3(2 * np.eye(3), np.zeros(3)), PoseError, "orthonormal"),
    "row23-se3-nan": (pin.SE3(np.eye(3), np.full(3, np.nan)), NotFiniteError, "pose"),
}


@pytest.mark.parametrize(("pose", "error", "words"), POSES.values(), ids=POSES)
def test_bad_pose(pose, error, words):
    with pytest.raises(error, match=words):
        as_pose(pose)


@pytest.mark.parametrize(
    "pose", [MATRIX, MATRIX.tolist(), [1, 2, 3, *TURN], pin.SE3(MATRIX)], ids=["4x4", "list", "7", "SE3"]
)
def test_rows22_and_23_good_poses(pose):
    np.testing.assert_allclose(as_pose(pose).homogeneous, MATRIX, atol=1e-15)


# Row 24: names.


def test_row24_unknown_names(arm):
    with pytest.raises(UnknownNameError, match="no payload named 'p500', did you mean 'p5'"):
        arm.deflection(Q, payload="p500")
    with pytest.raises(UnknownNameError, match="no payload"):
        arm.deflection([Q, Q], payload=["p5", "p6"])
    with pytest.raises(UnknownNameError, match="no joint named 'sholder', did you mean 'shoulder'"):
        arm.position(sholder=0.1)
    for name in ("toool", "", "flexure:S", "universe"):
        with pytest.raises(UnknownNameError, match="no link named"):
            arm.deflection(Q, wrenches=[Wrench(name, [1, 0, 0], [0, 0, 0])])
    with pytest.raises(InputError, match=r"'newtn'.*did you mean 'newton'"):
        arm.deflection(Q, method="newtn")
    with pytest.raises(InputError, match="axes is 'world'"):
        Wrench("tool", [1, 0, 0], [0, 0, 0], axes="world")


def test_row24_a_flexure_must_be_somewhere(arm):
    law = LinearLaw(np.zeros((6, 6)))
    with pytest.raises(UnknownNameError, match="'elbw', did you mean 'elbow'"):
        Arm(arm.robot, (Flexure("E", "elbw", law),))
    with pytest.raises(InputError, match="two flexures are named 'E'"):
        Arm(arm.robot, (Flexure("E", "elbow", law), Flexure("E", "shoulder", law)))


# Rows 25 to 28: payloads, ratings, units, gravity.

PAYLOADS = {
    "row25-negative": ((-1.0, [0, 0, 0]), "mass is -1"),
    "row25-nan": ((np.nan, [0, 0, 0]), "mass"),
    "row25-inf": ((np.inf, [0, 0, 0]), "mass"),
    "row25-text": (("5 kg", [0, 0, 0]), "mass"),
    "row25-none": ((None, [0, 0, 0]), "mass"),
    "row25-two-masses": (([1.0, 2.0], [0, 0, 0]), "mass"),
    "row25-com-nan": ((1.0, [0, np.nan, 0]), "com"),
    "row25-com-shape": ((1.0, [0, 0]), "com"),
    "row25-inertia-shape": ((1.0, [0, 0, 0], [1, 1, 1]), "inertia"),
    "row25-inertia-negative": ((1.0, [0, 0, 0], [-1, 1, 1, 0, 0, 0]), "principal moments"),
    "row25-inertia-triangle": ((1.0, [0, 0, 0], [1, 1, 3, 0, 0, 0]), "principal moments"),
}


@pytest.mark.parametrize(("arguments", "words"), PAYLOADS.values(), ids=PAYLOADS)
def test_bad_payload(arguments, words):
    with pytest.raises(PayloadError, match=words):
        Payload(*arguments)


def test_row25_payload_far_from_the_tip(arm):
    with pytest.raises(PayloadError, match=r"100 m from the tip.*millimetres"):
        arm.deflection(Q, payload=Payload(5.0, [100, 0, 0]))


@pytest.mark.parametrize("payload", [5.0, 7, ["p5"], {"mass": 5}], ids=str)
def test_row25_payload_is_a_name_or_a_payload(arm, payload):
    with pytest.raises(ArrayTypeError, match="name or a Payload"):
        arm.deflection(Q, payload=payload)


def test_row25_one_payload_name_per_row(arm):
    with pytest.raises(ShapeError, match="one name or 3, got 2"):
        arm.deflection([Q, Q, Q], payload=["p5", "p5"])


def test_row26_beyond_rating_is_flagged(arm):
    assert arm.deflection(Q, payload="p5").flags == ()
    result = arm.deflection(Q, payload="p20")
    assert codes(result) == ["beyond_rating"] and "20 kg" in str(result.flags[0]) and "10 kg" in str(result.flags[0])
    assert codes(arm.deflection([Q, Q], payload=["p5", "p20"])) == ["beyond_rating"]


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [("5mm", "length", 0.005), ("5 mm", "length", 0.005), ("-1.5e-3m", "length", -0.0015),
     ("90deg", "angle", np.pi / 2),
     ("2 kN", "force", 2000.0), ("1kgf", "force", 9.80665), ("3kNm", "moment", 3000.0), ("2min", "time", 120.0)],
)  # fmt: skip
def test_row27_quantities(text, kind, value):
    assert parse_quantity(text, kind) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "kind", "words"),
    [("5", "length", "with its unit, such as 5m"), ("5kg", "length", "'kg' is no unit of length"),
     ("mm", "length", "5m"), ("5Nm", "force", "no unit of force"), ("5mM", "length", "did you mean 'mm'"),
     ("1_0mm", "length", "5m"),
     ("nanmm", "length", "5m"), ("5mm2", "length", "5m"), ("1,5mm", "length", "5m"), ("", "angle", "5mrad")],
)  # fmt: skip
def test_row27_quantities_without_a_proper_unit(text, kind, words):
    with pytest.raises(UnitError, match=words):
        parse_quantity(text, kind)


def test_row27_a_force_of_a_thousand_times_is_flagged(arm):
    assert arm.weight == pytest.approx(32 * 9.81, rel=1e-12)
    light, heavy = (Wrench("tool", [0, 0, -size], [0, 0, 0]) for size in (300.0, 300e3))
    assert arm.deflection(Q, wrenches=[light]).flags == ()
    assert "large_force" in codes(arm.deflection(Q, wrenches=[heavy], allow_large=True))


@pytest.mark.parametrize("values", [[0, 0], [0, 0, np.nan], ["a", 0, 0]], ids=str)
@pytest.mark.parametrize("name", ["force", "moment"])
def test_row27_bad_wrench(values, name):
    with pytest.raises(InputError, match=name):
        Wrench("tool", **({"force": [0, 0, 0], "moment": [0, 0, 0]} | {name: values}))


@pytest.mark.parametrize("gravity", ["[0.0, 0.0, 0.0]", "[0.0, 0.0, 9.81]", "[0.0, 0.0, -9810.0]", "[0, 0, -0.981]"])
def test_row28_gravity_out_of_the_ordinary_is_flagged(tmp_path, gravity):
    with pytest.warns(ArmflexWarning, match="gravity"):
        loaded = load_arm(declared(tmp_path, ("[0.0, 0.0, -9.81]", gravity)))
    assert codes(loaded) == ["gravity"]


def test_row28_gravity_not_given_is_flagged(tmp_path):
    with pytest.warns(ArmflexWarning, match="no gravity given"):
        loaded = load_arm(declared(tmp_path, ("gravity = [0.0, 0.0, -9.81]\n", "")))
    assert loaded.robot.gravity.tolist() == [0.0, 0.0, -9.81]


def test_row28_without_weight_a_force_is_not_called_large(tmp_path):
    with pytest.warns(ArmflexWarning, match="gravity"):
        loaded = load_arm(declared(tmp_path, ("[0.0, 0.0, -9.81]", "[0.0, 0.0, 0.0]")))
    assert loaded.deflection(Q, wrenches=[Wrench("tool", [0, 0, -10])]).flags == loaded.flags
