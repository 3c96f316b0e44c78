"""Rows 19 to 35 of the table of bad inputs: positions, poses, names, payloads, units, laws, equilibria, arm.toml."""

from __future__ import annotations

import tomllib
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import brentq
from support.small_arms import GOOD, line_of, one_joint, random_compliance, three_joints, write

from armflex import Arm, Flexure, Payload, Wrench, load_arm
from armflex.conventions import as_pose, parse_quantity
from armflex.declaration import Source
from armflex.errors import (
    ArmFileError,
    ArmflexWarning,
    ArrayTypeError,
    ConvergenceError,
    InputError,
    JointLimitError,
    NotFiniteError,
    PayloadError,
    PoseError,
    ShapeError,
    SmallDisplacementError,
    TableError,
    UnitError,
    UnknownNameError,
    UnstableEquilibriumError,
    UrdfError,
)
from armflex.laws import LinearLaw
from armflex.measured.joint_data import read_joint_data

ARM = """[robot]
urdf = "robot.urdf"
tip = "tool"
base = "base"
gravity = [0.0, 0.0, -9.81]
payload_rating = 10.0

[payload.p5]
mass = 5.0
com = [0.1, 0.0, 0.0]
inertia = [0.3, 0.3, 0.3, 0.0, 0.0, 0.0]

[payload.p20]
mass = 20.0
com = [0.1, 0.0, 0.05]

[flexure.S]
joint = "shoulder"
model = "linear"
relative_std = 0.1
compliance = [1e-9, 1e-9, 6e-10, 4e-8, 4.5e-8, 2e-7]

[flexure.E]
joint = "elbow"
model = "position_dependent"
depends_on = "elbow"
relative_std = 0.2
compliance = [1e-9, 1e-9, 6e-10, 4e-8, 4e-8, 3e-7]
compliance_q1 = [0.0, 0.0, 0.0, 0.0, 0.0, 1e-8]

[measurement]
frame = "unknown"
gravity_in = "base"

[prior]
joint_offset = 1e-3
compliance = 0.2
"""


def declared(folder: Path, *edits: tuple[str, str]) -> Path:
    """Write the good arm.toml, with texts replaced, beside its URDF."""
    text = ARM
    for old, new in edits:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    write(folder, GOOD)
    return write(folder, text, "arm.toml")


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Arm:
    return load_arm(declared(tmp_path_factory.mktemp("arm")))


def codes(flags) -> list[str]:
    return [flag.code for flag in flags]


Q = [0.2, -0.3]


def test_the_good_arm_is_good(arm):
    assert arm.flags == () and arm.deflection(Q, payload="p5").flags == ()
    assert arm.flexure_names == ("S", "E") and arm.prior.compliance == 0.2


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
    assert codes(result.flags) == ["outside_limits"] and "'shoulder'" in str(result.flags[0])
    batch = arm.deflection([Q, Q, [1.61, 0.0]], enforce_limits=False)
    assert codes(batch.flags) == ["outside_limits"] and "row 2" in str(batch.flags[0])


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
    flags = arm.deflection(Q, payload="p20").flags
    assert codes(flags) == ["beyond_rating"] and "20 kg" in str(flags[0]) and "10 kg" in str(flags[0])
    assert codes(arm.deflection([Q, Q], payload=["p5", "p20"]).flags) == ["beyond_rating"]


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
     ("nanmm", "length", "5m"), ("5mm2", "length", "5m"), ("1,5mm", "length", "5m"), ("", "angle", "5rad")],
)  # fmt: skip
def test_row27_quantities_without_a_proper_unit(text, kind, words):
    with pytest.raises(UnitError, match=words):
        parse_quantity(text, kind)


def test_row27_a_force_of_a_thousand_times_is_flagged(arm):
    assert arm.weight == pytest.approx(32 * 9.81, rel=1e-12)
    light, heavy = (Wrench("tool", [0, 0, -size], [0, 0, 0]) for size in (300.0, 300e3))
    assert arm.deflection(Q, wrenches=[light]).flags == ()
    assert "large_force" in codes(arm.deflection(Q, wrenches=[heavy], allow_large=True).flags)


@pytest.mark.parametrize("values", [[0, 0], [0, 0, np.nan], ["a", 0, 0]], ids=str)
@pytest.mark.parametrize("name", ["force", "moment"])
def test_row27_bad_wrench(values, name):
    with pytest.raises(InputError, match=name):
        Wrench("tool", **({"force": [0, 0, 0], "moment": [0, 0, 0]} | {name: values}))


@pytest.mark.parametrize("gravity", ["[0.0, 0.0, 0.0]", "[0.0, 0.0, 9.81]", "[0.0, 0.0, -9810.0]", "[0, 0, -0.981]"])
def test_row28_gravity_out_of_the_ordinary_is_flagged(tmp_path, gravity):
    with pytest.warns(ArmflexWarning, match="gravity"):
        loaded = load_arm(declared(tmp_path, ("[0.0, 0.0, -9.81]", gravity)))
    assert codes(loaded.flags) == ["gravity"]


def test_row28_gravity_not_given_is_flagged(tmp_path):
    with pytest.warns(ArmflexWarning, match="no gravity given"):
        loaded = load_arm(declared(tmp_path, ("gravity = [0.0, 0.0, -9.81]\n", "")))
    assert loaded.robot.gravity.tolist() == [0.0, 0.0, -9.81]


def test_row28_without_weight_a_force_is_not_called_large(tmp_path):
    with pytest.warns(ArmflexWarning, match="gravity"):
        loaded = load_arm(declared(tmp_path, ("[0.0, 0.0, -9.81]", "[0.0, 0.0, 0.0]")))
    assert loaded.deflection(Q, wrenches=[Wrench("tool", [0, 0, -10], [0, 0, 0])]).flags == loaded.flags


# Rows 29 to 32 as far as an arm.toml declares a compliance, and everything else that it may get wrong.
# Old text, new text, words of the message, mark of its line.

DIAGONAL = "compliance = [1e-9, 1e-9, 6e-10, 4e-8, 4.5e-8, 2e-7]"
FULL = np.diag([1e-9, 1e-9, 6e-10, 4e-8, 4e-8, 2e-7])
SKEW, INDEFINITE = FULL.copy(), FULL.copy()
SKEW[0, 4], SKEW[4, 0] = 1e-9, 1.00001e-9
INDEFINITE[3, 4] = INDEFINITE[4, 3] = 5e-8
JOINT = 'joint = "shoulder"'

DECLARATIONS: dict[str, tuple[str, str, tuple[str, ...], str]] = {
    "row29-not-symmetric": (
        DIAGONAL,
        f"compliance = {SKEW.tolist()}",
        ("[flexure.S]", "not symmetric", "C[0][4]"),
        "[[",
    ),
    "row29-not-definite": (DIAGONAL, f"compliance = {INDEFINITE.tolist()}", ("not positive semi-definite",), "[["),
    "row29-negative": (DIAGONAL, "compliance = [1e-9, -1e-9, 6e-10, 4e-8, 4e-8, 2e-7]", ("dy is negative",), "-1e-9"),
    "row29-five-numbers": (DIAGONAL, "compliance = [1, 2, 3, 4, 5]", ("6 numbers or 6 x 6 numbers",), "[1, 2"),
    "row29-six-by-five": (DIAGONAL, f"compliance = {[[1.0] * 5] * 6}", ("6 x 6 numbers",), "[["),
    "row29-ragged": (DIAGONAL, "compliance = [[1], [1, 2]]", ("rows of different length",), "[[1]"),
    "row29-text": (DIAGONAL, 'compliance = "stiff"', ("6 numbers",), '"stiff"'),
    "row29-negative-std": ("relative_std = 0.1", "relative_std = -0.1", ("negative", "-0.1"), "-0.1"),
    "row29-std-in-percent": ("relative_std = 0.1", "relative_std = 10", ("a fraction, 0.2 means 20 %",), "_std = 10"),
    "row29-range": (
        "[0.0, 0.0, 0.0, 0.0, 0.0, 1e-8]",
        "[0.0, 0.0, 0.0, 0.0, 0.0, 1e-6]",
        ("at elbow = -2", "negative"),
        "",
    ),
    "row32-infinite": (DIAGONAL, "compliance = [inf, 1, 1, 1, 1, 1]", ("not finite",), "[inf"),
    "row32-nan": (DIAGONAL, "compliance = [nan, 1, 1, 1, 1, 1]", ("not finite",), "[nan"),
    "toml-not-toml": ('tip = "tool"', "tip = tool", ("not valid TOML",), "tip = tool"),
    "toml-unfinished": ('frame = "unknown"', 'frame = "unknown', ("not valid TOML",), 'frame = "unknown'),
    "toml-key-twice": ('tip = "tool"', 'tip = "tool"\ntip = "to"', ("not valid TOML",), 'tip = "to"'),
    "toml-unknown-key": (
        JOINT,
        f"{JOINT}\ncomplience = 1",
        ("[flexure.S]", "unknown key", "'compliance'"),
        "complience",
    ),
    "toml-unknown-key-in-robot": ('tip = "tool"', 'tip = "tool"\ngravty = 1', ("[robot]", "'gravity'"), "gravty"),
    "toml-unknown-key-in-payload": ("mass = 5.0", "mass = 5.0\nmas = 5.0", ("[payload.p5]", "'mass'"), "mas ="),
    "toml-unknown-key-in-prior": ("compliance = 0.2", "complianse = 0.2", ("[prior]", "'compliance'"), "complianse"),
    "toml-unknown-table": (
        "[measurement]",
        "[mesurement]",
        ("mesurement: unknown key", "'measurement'"),
        "[mesurement]",
    ),
    "toml-unknown-model": ('model = "linear"', 'model = "liner"', ("'liner'", "did you mean 'linear'"), '"liner"'),
    "toml-unknown-joint": (JOINT, 'joint = "sholder"', ("no joint 'sholder'", "did you mean 'shoulder'"), "sholder"),
    "toml-unknown-depends-on": ('depends_on = "elbow"', 'depends_on = "elbo"', ("did you mean 'elbow'",), '"elbo"'),
    "toml-unknown-tip": ('tip = "tool"', 'tip = "toool"', ("[robot] tip", "did you mean 'tool'"), "toool"),
    "toml-unknown-base": ('base = "base"', 'base = "bas"', ("[robot] base", "did you mean 'base'"), '"bas"'),
    "toml-unknown-locked": ("[payload.p5]", "[robot.locked]\nelbw = 0.1\n[payload.p5]", ("'elbw'",), ""),
    "toml-unknown-frame": ('frame = "unknown"', 'frame = "unknwn"', ("'unknwn'", "did you mean 'unknown'"), "unknwn"),
    "toml-no-robot": ("[robot]", "[rob0t]", ("needs a table [robot]; is 'rob0t' meant to be it?",), "[rob0t]"),
    "toml-payload-none": ("[payload.p5]", "[payload.none]", ("nothing is carried",), "[payload.none]"),
    "toml-after-a-matrix": (
        DIAGONAL,
        f"compliance = [\n{''.join(f'  {row},{chr(10)}' for row in FULL.tolist())}]\nnode = [0, 0]",
        ("[flexure.S] node", "3 numbers"),
        "node =",
    ),
    "toml-after-a-text-like-a-header": (
        JOINT,
        f'{JOINT} # [x]\nmodle = """\n[payload.p5]\nmass = 1"""',
        ("[flexure.S] modle",),
        "modle",
    ),
    "toml-missing-urdf": ('urdf = "robot.urdf"\n', "", ("[robot] needs 'urdf'",), "[robot]"),
    "toml-missing-tip": ('tip = "tool"\n', "", ("[robot] needs 'tip'",), "[robot]"),
    "toml-misspelt-mass": ("mass = 5.0\n", "mas = 5.0\n", ("needs 'mass'; is 'mas' meant to be it?",), "mas ="),
    "toml-missing-mass": ("mass = 5.0\n", "", ("[payload.p5] needs 'mass'",), "[payload.p5]"),
    "toml-missing-joint": (JOINT, "", ("[flexure.S] needs 'joint'",), "[flexure.S]"),
    "toml-missing-compliance": (DIAGONAL, "", ("[flexure.S] needs 'compliance'",), "[flexure.S]"),
    "toml-gravity-shape": ("[0.0, 0.0, -9.81]", "-9.81", ("gravity: expected 3 numbers",), "gravity = -9.81"),
    "toml-gravity-nan": ("[0.0, 0.0, -9.81]", "[0.0, 0.0, nan]", ("not finite",), "nan"),
    "toml-com-shape": ("com = [0.1, 0.0, 0.0]", "com = [0.1, 0.0]", ("com: expected 3 numbers",), "com = [0.1, 0.0]"),
    "toml-mass-text": ("mass = 5.0", 'mass = "5 kg"', ("mass: expected a number",), "5 kg"),
    "toml-mass-bool": ("mass = 5.0", "mass = true", ("mass: expected a number",), "mass = true"),
    "toml-mass-negative": ("mass = 5.0", "mass = -5.0", ("mass: payload mass is -5",), "-5.0"),
    "toml-inertia": ("[0.3, 0.3, 0.3, 0.0, 0.0, 0.0]", "[0.3, 0.3, 0.9, 0, 0, 0]", ("principal moments",), "0.9"),
    "toml-prior-negative": ("joint_offset = 1e-3", "joint_offset = -1e-3", ("cannot be negative",), "-1e-3"),
    "toml-model-not-text": ('model = "linear"', "model = 1", ("expected a text, got 1",), "model = 1"),
    "toml-missing-law-file": (DIAGONAL, 'file = "ghost.safetensors"', ("ghost.safetensors", "cannot be read"), "ghost"),
}


PLACES = """a.b = 1
"x y" = { c = 1 }
[t."u.v"] # [no]
m = [
  [1, 2],   # k = 3
  [3, 4],
]
k = "[[t.w]]"
[[t.w]]
n = '''
[t.w]
n = 1'''
at = 1
[[t.w.sub]]
at = 2
[[t.w.sub]]
at = 3
[[t.w]]
at = 4
[t.w.sub2]
at = 5
"""


@pytest.mark.parametrize(
    ("keys", "line"),
    [(("a", "b"), 1), (("x y",), 2), (("x y", "c"), 2), (("t", "u.v"), 3), (("t", "u.v", "m"), 4),
     (("t", "u.v", "k"), 8), (("t", "w", 0), 9), (("t", "w", 0, "at"), 13), (("t", "w", 0, "sub", 0, "at"), 15),
     (("t", "w", 0, "sub", 1), 16), (("t", "w", 0, "sub", 1, "at"), 17), (("t", "w", 0, "sub", 1, "none"), 16),
     (("t", "w", 1, "at"), 19), (("t", "w", 1, "sub2", "at"), 21), (("ghost",), 0)],
)  # fmt: skip
def test_every_key_has_its_line(keys, line):
    tomllib.loads(PLACES)
    assert Source(Path("a.toml"), PLACES).place(keys).line == line


@pytest.mark.parametrize(("old", "new", "words", "marker"), DECLARATIONS.values(), ids=DECLARATIONS)
def test_bad_arm_file(tmp_path, old, new, words, marker):
    path = declared(tmp_path, (old, new))
    with pytest.raises(ArmFileError) as caught:
        load_arm(path)
    line = f":{line_of(path.read_text(), marker)}: " if marker else ""
    assert str(caught.value).startswith(f"{path}{line}")
    for word in words:
        assert word in str(caught.value)


def test_arm_file_that_cannot_be_read(tmp_path):
    for path, words in ((tmp_path / "none.toml", "cannot be read"), (tmp_path, "cannot be read")):
        with pytest.raises(ArmFileError, match=words):
            load_arm(path)
    (tmp_path / "a.toml").write_bytes(ARM.encode("utf-16"))
    with pytest.raises(ArmFileError, match="not UTF-8"):
        load_arm(tmp_path / "a.toml")


@pytest.mark.parametrize("text", ["robot = 5", "[robot]\nurdf = 'robot.urdf'\ntip = 'tool'\n[payload]\nx = 5"])
def test_a_table_must_be_a_table(tmp_path, text):
    write(tmp_path, GOOD)
    with pytest.raises(ArmFileError, match=r"expected a table|not valid TOML"):
        load_arm(write(tmp_path, text, "arm.toml"))


def test_the_urdf_of_an_arm_is_checked(tmp_path):
    path = declared(tmp_path)
    write(tmp_path, GOOD.replace('<mass value="20"/>', '<mass value="2o"/>'))
    with pytest.raises(UrdfError, match=r"robot\.urdf:14: .*'2o'"):
        load_arm(path)
    with pytest.raises(UrdfError, match=r"ghost\.urdf: cannot be read"):
        load_arm(declared(tmp_path, ('"robot.urdf"', '"ghost.urdf"')))


def test_a_network_without_a_file_needs_to_be_learned(tmp_path):
    what = "[flexure.T]\njoint = 'elbow'\nmodel = 'neural'\ncompliance = [0,0,0,0,0,0]"
    path = declared(tmp_path, ("[measurement]", f"{what}\n[measurement]"))
    with pytest.raises(ArmFileError, match=r"arm\.toml:\d+.*'file'.*or learn = true"):
        load_arm(path)


def test_row08_massless_links_in_an_arm_file(tmp_path):
    path = declared(tmp_path, ('tip = "tool"', 'tip = "tool"\nallow_massless = true'))
    start = GOOD.index("<inertial>", GOOD.index('<link name="fore">'))
    write(tmp_path, GOOD[:start] + GOOD[GOOD.index("</inertial>", start) + len("</inertial>") :])
    with pytest.warns(ArmflexWarning, match="massless"):
        assert codes(load_arm(path).flags) == ["massless"]


@pytest.mark.parametrize(
    "compliance",
    [[1e9, 1e9, 1.5e9, 6e7, 6e7, 8e6], [1e-3, 1e-3, 1e-3, 4e-8, 4e-8, 2e-7], [1e-9, 1e-9, 1e-9, 4e-8, 4e-8, 2e-2]],
    ids=["row30-stiffness", "row31-mm-per-kN", "row31-rotation"],
)
def test_a_compliance_softer_than_steel_is_flagged(tmp_path, compliance):
    with pytest.warns(ArmflexWarning, match="flexure 'S'.*stiffness, or"):
        loaded = load_arm(declared(tmp_path, (DIAGONAL, f"compliance = {compliance}")))
    assert codes(loaded.flags) == ["soft"]


def test_row32_zero_compliance_is_rigid(tmp_path):
    rigid = load_arm(declared(tmp_path, (DIAGONAL, "compliance = [0, 0, 0, 0, 0, 0]")))
    assert not rigid.deflection(Q, payload="p5").twists[0].any()


# Rows 33 and 34: one joint, k theta = +-m g h sin(theta0 + theta); fixed points say nothing about stability.

MASS, GRAVITY, HEIGHT = 2.0, 9.81, 0.4


def pendulum(folder: Path, ratio: float, upright: bool) -> Arm:
    """Return one joint whose compliance is such that m g h / k = ratio."""
    compliance = np.zeros((6, 6))
    compliance[4, 4] = ratio / (MASS * GRAVITY * HEIGHT)
    com = (0, 0, HEIGHT if upright else -HEIGHT)
    return one_joint(folder, compliance, com, MASS, com)


def root(ratio: float, start: float, upright: bool) -> float:
    sign = 1.0 if upright else -1.0
    return brentq(lambda angle: angle - sign * ratio * np.sin(start + angle), -0.3, 0.3, xtol=1e-15)


@pytest.mark.parametrize("ratio", [1.05, 2.0])
def test_row33_hanging_the_fixed_point_never_converges_and_newton_does(tmp_path, ratio):
    arm, start = pendulum(tmp_path, ratio, upright=False), 0.1
    with pytest.raises(ConvergenceError) as caught:
        arm.deflection([start], method="fixed_point")
    history = caught.value.history
    assert len(history) == 200 and min(history) > 1e-5 and "last residuals" in str(caught.value)
    result = arm.deflection([start])
    assert result.twists[0] == pytest.approx([0, 0, 0, 0, root(ratio, start, False), 0], abs=1e-13)
    assert len(result.residuals) <= 5


@pytest.mark.parametrize("start", [0.0, 0.02])
def test_row34_upright_at_half_the_critical_load_stands(tmp_path, start):
    result = pendulum(tmp_path, 0.5, upright=True).deflection([start])
    # The residual is below 1e-12 and the tangent 0.5, so the twist is right to 2e-12.
    assert result.twists[0] == pytest.approx([0, 0, 0, 0, root(0.5, start, True), 0], abs=2e-12)
    assert np.linalg.eigvals(result.tangent).real.min() == pytest.approx(1 - 0.5 * np.cos(start + result.twists[0, 4]))


@pytest.mark.parametrize("method", ["newton", "fixed_point"])
@pytest.mark.parametrize("ratio", [1.05, 2.0])
def test_row34_upright_beyond_the_critical_load_buckles(tmp_path, ratio, method):
    with pytest.raises(UnstableEquilibriumError, match="buckles") as caught:
        pendulum(tmp_path, ratio, upright=True).deflection([0.0], method=method)
    assert caught.value.eigenvalue == pytest.approx(1.0 - ratio, abs=1e-9)


@pytest.mark.parametrize("start", [0.001, 0.02])
def test_row34_upright_and_leaning_beyond_the_critical_load(tmp_path, start):
    """Newton may find the unstable root or the one that has fallen over: neither is an answer."""
    with pytest.raises((UnstableEquilibriumError, SmallDisplacementError, ConvergenceError)):
        pendulum(tmp_path, 2.0, upright=True).deflection([start])


def test_rows33_and_34_exactly_at_the_critical_load(tmp_path):
    """Numbers that are exact in binary: the tangent is zero, so nothing holds the arm, nor is there a Newton step."""
    compliance = np.zeros((6, 6))
    compliance[4, 4] = 1.0 / 8.0
    arm = one_joint(tmp_path, compliance, (0, 0, 1), 1.0, (0, 0, 1), gravity=np.array([0.0, 0.0, -8.0]))
    with pytest.raises(UnstableEquilibriumError) as caught:
        arm.deflection([0.0])
    assert caught.value.eigenvalue == 0.0
    with pytest.raises(ConvergenceError, match="singular"):
        arm.deflection([0.0], wrenches=[Wrench("tool", [2.0**-30, 0, 0], [0, 0, 0])])


def test_row33_numbers_that_overflow_do_not_converge(tmp_path):
    arm = three_joints(tmp_path, [random_compliance(1) * 1e290] * 3)
    with pytest.raises(ConvergenceError) as caught:
        arm.deflection(np.zeros(3))
    assert len(caught.value.history) > 1


# Row 35: small displacements.


def test_row35_a_flexure_turning_by_over_a_tenth_radian(tmp_path):
    arm, start = pendulum(tmp_path, 2.0, upright=False), 0.3
    with pytest.raises(SmallDisplacementError, match=r"flexure 'j' turns by 0\.2") as caught:
        arm.deflection([start])
    assert np.shape(caught.value.twists) == (1, 6)
    result = arm.deflection([start], allow_large=True)
    assert result.twists[0, 4] == pytest.approx(root(2.0, start, False), abs=1e-13)


@pytest.mark.parametrize("method", ["fixed_point", "first_order"])
def test_row35_for_every_method(tmp_path, method):
    with pytest.raises(SmallDisplacementError):
        pendulum(tmp_path, 0.5, upright=False).deflection([0.5], method=method)


def test_row35_sag_beyond_a_tenth_of_the_reach_is_flagged(tmp_path):
    soft, stiff = ([np.diag([c, c, c, 0, 0, 0])] * 3 for c in (1e-4, 1e-6))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert three_joints(tmp_path, stiff).deflection(np.zeros(3)).flags == ()
        result = three_joints(tmp_path, soft).deflection(np.zeros(3))
    assert (
        codes(result.flags) == ["large_sag"] and np.linalg.norm(result.displacement[:3]) > 0.1 * 2.0
    )  # m, about the length of the chain


def test_a_moving_payload_without_inertia_is_flagged(tarm):
    q = np.zeros(7)
    still, moving = tarm.deflection(q, Payload(10.0, np.zeros(3))), np.ones(7)
    found = tarm.deflection(q, Payload(10.0, np.zeros(3)), a=moving)
    assert "no_inertia" in [flag.code for flag in found.flags]
    assert not still.flags and not tarm.deflection(q, "p600", a=moving).flags


def test_flexures_without_an_uncertainty_beside_others_are_flagged(tmp_path):
    with pytest.warns(ArmflexWarning, match="taken as exactly known: E"):
        assert codes(load_arm(declared(tmp_path, ("relative_std = 0.2\n", ""))).flags) == ["partly_certain"]
    none = (("relative_std = 0.2\n", ""), ("relative_std = 0.1\n", ""))
    rigid = (("relative_std = 0.1\n", ""), (DIAGONAL, "compliance = [0, 0, 0, 0, 0, 0]"))
    for edits in (none, rigid):
        assert load_arm(declared(tmp_path, *edits)).flags == ()


@pytest.mark.parametrize(("upper", "good"), [(7.0, False), (2.0, True)])
def test_a_law_is_looked_at_over_the_whole_travel(tmp_path, upper, good):
    """A prismatic joint may go further than a turn's 6.28."""
    path = declared(tmp_path, ("[0.0, 0.0, 0.0, 0.0, 0.0, 1e-8]", "[0.0, 0.0, 0.0, 0.0, 0.0, -4.5e-8]"))
    limits = f'lower="-2" upper="{upper}"'
    write(tmp_path, GOOD.replace('"elbow" type="revolute"', '"elbow" type="prismatic"').replace(ELBOW_RANGE, limits))
    if good:
        assert load_arm(path).flags == ()
        return
    with pytest.raises(ArmFileError, match=r"at elbow = 6\.\d+: .*negative"):
        load_arm(path)


ELBOW_RANGE = 'lower="-2" upper="2.1"'


def test_a_urdf_in_capitals_is_one(tmp_path):
    with pytest.warns(ArmflexWarning, match="rigid"):
        assert load_arm(write(tmp_path, GOOD, "ROBOT.URDF")).joint_names == ("shoulder", "elbow")


def test_tables_separated_by_tabs(tmp_path):
    table = write(tmp_path, "fx_N\tdx_mm\n1,5\t2\n", "a.csv")
    with pytest.raises(TableError, match="separated by tabs"):
        read_joint_data(table)


JOINT_HEADER = "fx_N,fy_N,fz_N,dx_mm,dy_mm,dz_mm"


@pytest.mark.parametrize("name", ["day", "day_s", "dry", "max", "mixer", "force", "temperature", "fan", "tray"])
def test_covariates_near_a_column_are_welcome(tmp_path, name):
    rows = "".join(f"{i},{i * i},{i % 3},1,2,3,x\n" for i in range(6))
    assert list(read_joint_data(write(tmp_path, f"{JOINT_HEADER},{name}\n{rows}", "a.csv")).covariates) == [name]


@pytest.mark.parametrize("name", ["mxx_Nm", "xd", "dyy", "Fx", "fxx_kN", "rzz_mrad", "mx_rep"])
def test_misspelt_columns_are_not(tmp_path, name):
    rows = "".join(f"{i},{i * i},{i % 3},1,2,3,4\n" for i in range(6))
    with pytest.raises(TableError, match=f"{name}.*(did you mean|is no unit)"):
        read_joint_data(write(tmp_path, f"{JOINT_HEADER},{name}\n{rows}", "a.csv"))
