"""Rows 29 to 32 of the table of bad inputs: what an arm.toml may not say, and what it says in vain."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from support.small_arms import line_of, write
from support.two_links import ARM, GOOD, Q, codes, declared

from armflex import Arm, Payload, load_arm
from armflex.declaration import Source
from armflex.errors import ArmFileError, ArmflexWarning, TableError, UrdfError
from armflex.measured.joint_data import read_joint_data


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Arm:
    return load_arm(declared(tmp_path_factory.mktemp("arm")))


def test_the_good_arm_is_good(arm):
    assert arm.flags == () and arm.deflection(Q, payload="p5").flags == ()
    assert arm.flexure_names == ("S", "E") and arm.prior.compliance == 0.2


# Rows 29 to 32 as far as an arm.toml declares a compliance, and everything else that it may get wrong.
# Old text, new text, words of the message, mark of its line.

DIAGONAL = "compliance = [1e-9, 1e-9, 6e-10, 4e-8, 4.5e-8, 2e-7]"
FULL = np.diag([1e-9, 1e-9, 6e-10, 4e-8, 4e-8, 2e-7])
SKEW, INDEFINITE, TINY = FULL.copy(), FULL.copy(), FULL.copy()
SKEW[0, 4], SKEW[4, 0] = 1e-9, 1.00001e-9
INDEFINITE[3, 4] = INDEFINITE[4, 3] = 5e-8
TINY[3:5, 3:5] = [[1e-310, 5e-8], [5e-8, 1e-310]]
JOINT = 'joint = "shoulder"'

DECLARATIONS: dict[str, tuple[str, str, tuple[str, ...], str]] = {
    "row29-not-symmetric": (
        DIAGONAL,
        f"compliance = {SKEW.tolist()}",
        ("[flexure.S]", "not symmetric", "C[0][4]"),
        "[[",
    ),
    "row29-not-definite": (DIAGONAL, f"compliance = {INDEFINITE.tolist()}", ("not positive semi-definite",), "[["),
    "row29-definite-beyond-floats": (DIAGONAL, f"compliance = {TINY.tolist()}", ("not positive semi-definite",), "[["),
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
        assert codes(load_arm(path)) == ["massless"]


@pytest.mark.parametrize(
    "compliance",
    [[1e9, 1e9, 1.5e9, 6e7, 6e7, 8e6], [1e-3, 1e-3, 1e-3, 4e-8, 4e-8, 2e-7], [1e-9, 1e-9, 1e-9, 4e-8, 4e-8, 2e-2]],
    ids=["row30-stiffness", "row31-mm-per-kN", "row31-rotation"],
)
def test_a_compliance_softer_than_steel_is_flagged(tmp_path, compliance):
    with pytest.warns(ArmflexWarning, match="flexure 'S'.*stiffness, or"):
        loaded = load_arm(declared(tmp_path, (DIAGONAL, f"compliance = {compliance}")))
    assert codes(loaded) == ["soft"]


def test_row32_zero_compliance_is_rigid(tmp_path):
    rigid = load_arm(declared(tmp_path, (DIAGONAL, "compliance = [0, 0, 0, 0, 0, 0]")))
    assert not rigid.deflection(Q, payload="p5").twists[0].any()


def test_a_payload_of_no_mass_needs_no_place(tmp_path):
    empty = load_arm(declared(tmp_path, (DIAGONAL, f"{DIAGONAL}\n[payload.empty]\nmass = 0")))
    assert np.array_equal(empty.deflection(Q, "empty").displacement, empty.deflection(Q).displacement)


def test_a_moving_payload_without_inertia_is_flagged(tarm):
    q = np.zeros(7)
    still, moving = tarm.deflection(q, Payload(10.0, np.zeros(3))), np.ones(7)
    found = tarm.deflection(q, Payload(10.0, np.zeros(3)), a=moving)
    assert "no_inertia" in [flag.code for flag in found.flags]
    assert not still.flags and not tarm.deflection(q, "p600", a=moving).flags


def test_flexures_without_an_uncertainty_beside_others_are_flagged(tmp_path):
    with pytest.warns(ArmflexWarning, match="taken as exactly known: E"):
        assert codes(load_arm(declared(tmp_path, ("relative_std = 0.2\n", "")))) == ["partly_certain"]
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
    table = write(tmp_path, "fx_N\tfy_N\tdx_mm\n1,5\t2\n", "a.csv")
    with pytest.raises(TableError, match=r"a\.csv:2: has 2 cells, the header has 3"):
        read_joint_data(table)


@pytest.mark.parametrize(("key", "value"), [("mass", "3,5"), ("com", "[0,2, 0, 0]")])
def test_decimal_commas_in_toml_are_named(tmp_path, key, value):
    old = {"mass": "mass = 3.5", "com": "com = [0.2, 0, 0]"}[key]
    text = '[robot]\nurdf = "robot.urdf"\ntip = "tool"\n[payload.p]\nmass = 3.5\ncom = [0.2, 0, 0]\n'
    path = write(tmp_path, text.replace(old, f"{key} = {value}"), "comma.toml")
    write(tmp_path, GOOD)
    line = {"mass": 5, "com": 6}[key]
    point = {"mass": "3.5", "com": "0.2"}[key]
    with pytest.raises(ArmFileError, match=rf"comma.toml:{line}: .*a decimal comma\? TOML has points, {point}"):
        load_arm(path)


JOINT_HEADER = "fx_N,fy_N,fz_N,dx_mm,dy_mm,dz_mm"


@pytest.mark.parametrize("name", ["day", "day_s", "dry", "max", "mixer", "force", "temperature", "fan", "tray"])
def test_covariates_near_a_column_are_welcome(tmp_path, name):
    rows = "".join(f"{i},{i * i},{i % 3},1,2,3,x\n" for i in range(6))
    assert list(read_joint_data(write(tmp_path, f"{JOINT_HEADER},{name}\n{rows}", "a.csv")).covariates) == [name]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mxx_Nm", "xd", "dyy", "Fx", "fxx_kN", "rzz_mrad", "mx_rep"])
def test_misspelt_columns_are_not(tmp_path, name):
    rows = "".join(f"{i},{i * i},{i % 3},1,2,3,4\n" for i in range(6))
    with pytest.raises(TableError, match=f"{name}.*(did you mean|is no unit)|two columns mean .*{name}"):
        read_joint_data(write(tmp_path, f"{JOINT_HEADER},{name}\n{rows}", "a.csv"))


def test_a_centre_of_mass_needs_a_mass(tmp_path):
    (tmp_path / "arm.toml").write_text('[robot]\ndh = "standard"\n[robot.joint]\nA1 = { a = 1.0, com = [0, 0, 0.1] }\n')
    with pytest.raises(ArmFileError, match=r"arm.toml:4: \[robot.joint.A1\] com: stands without the mass"):
        load_arm(tmp_path / "arm.toml")
