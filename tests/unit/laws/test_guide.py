"""Guides of a telescopic joint: the law by hand, where it is offered, its file, and traced in a column of our own."""

from pathlib import Path

import numpy as np
import pytest
import tomlkit
from hypothesis import given
from hypothesis import strategies as st
from support.measurement_rows import written
from support.small_arms import joint, link, robot, write

from armflex import Arm, calibrate, load_arm, read_measurements, trace
from armflex.errors import ArmFileError
from armflex.files.effect_file import effect_table
from armflex.laws import Row
from armflex.laws.effects import Effect, Location
from armflex.laws.effects.context import Records
from armflex.laws.effects.guide import GUIDE
from armflex.laws.effects.in_arm import BoundTwist
from armflex.laws.effects.location import Here
from armflex.trace.findings import Trace

SPOT = Location("lift", "ry", ("q_lift",), (0, 1))
INNER = (200.0, 0.5, 2.0)
"""Load at which the gap is taken up [Nm], spare overlap [m], and where it is least [m]."""


def guide(arm: Arm, gap: float = 1e-3, compliance: float = 1e-6, location: Location = SPOT) -> BoundTwist:
    return BoundTwist(Effect(GUIDE, location, (gap, compliance, *INNER)), Here(location, arm.robot, None))


def about_y(moment: float) -> np.ndarray:
    return np.array([300.0, -200.0, -4000.0, 70.0, moment, -90.0])


def at(position: float) -> Row:
    return Row(np.array([position, 0.3, -0.2, 0.1]), {"lift": 0, "turn": 1, "shoulder": 2, "elbow": 3})


# The column: a prismatic lift, a turn about z, two pitches; its links as (mass, centre along x, centre along z).

PARTS = [
    link("ground"),
    joint("lift", "ground", "column", axis=(0, 0, 1), kind="prismatic"),
    link("column", 40.0, (0.0, 0.0, 0.2)),
    joint("turn", "column", "head", (0.0, 0.0, 0.4), axis=(0, 0, 1)),
    link("head", 25.0, (0.1, 0.0, 0.05)),
    joint("shoulder", "head", "upper", (0.2, 0.0, 0.1)),
    link("upper", 20.0, (0.5, 0.0, 0.0)),
    joint("elbow", "upper", "fore", (1.0, 0.0, 0.0)),
    link("fore", 12.0, (0.4, 0.0, 0.0)),
    joint("flange", "fore", "tool", (0.8, 0.0, 0.0), kind="fixed"),
    link("tool"),
]
DECLARED = """[robot]
urdf = "robot.urdf"
tip = "tool"
gravity = [0.0, 0.0, -9.81]

[payload.empty]
mass = 0.0
com = [0.1, 0.0, 0.0]

[payload.p40]
mass = 40.0
com = [0.1, 0.0, 0.0]

[measurement]
frame = "unknown"

[prior]
joint_offset = 1e-3
compliance = 0.2
tool = 5e-3
session_translation = 5e-4
session_rotation = 5e-5
"""
TARGET = np.array([0.804, 0.003, -0.002])
"""m from the elbow: 5 mm beside the tip."""

HEIGHTS = (0.0, 0.45, 0.9, 1.3, 1.7, 2.0)
GAP, GIVES, TAU0, SPARE, OUT = 3e-4, 1e-7, 150.0, 0.3, 2.0
NOISE = 1e-4
GRAVITY = 9.81


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Arm:
    """The column as declared: rigid."""
    return with_table(tmp_path_factory.mktemp("column"), "")


# The law.

BY_HAND = [
    (2.0, 100.0, (1e-3 * 0.5 + 1e-4) / 0.5),
    (2.0, 400.0, (1e-3 + 4e-4) / 0.5),
    (1.5, 400.0, 1.4e-3),
    (0.5, 400.0, 0.7e-3),
    (0.0, -100.0, -6e-4 / 2.5),
    (-1.5, -200.0, -1.2e-3 / 4.0),
    (3.0, 200.0, 1.2e-3 / 1.5),
    (1.0, 0.0, 0.0),
]


@pytest.mark.parametrize(("position", "moment", "turn"), BY_HAND)
def test_the_turn_by_hand(arm, position, moment, turn):
    found = guide(arm).twist(about_y(moment), at(position))
    np.testing.assert_allclose(found, [0, 0, 0, 0, turn, 0], rtol=1e-13, atol=1e-20)


def test_gap_and_compliance_are_parts_of_a_sum(arm):
    load, row = about_y(130.0), at(0.7)
    gap, compliance = guide(arm, 1e-3, 0.0), guide(arm, 0.0, 1e-6)
    assert gap.twist(load, row)[4] == pytest.approx(1e-3 * 0.65 / 1.8)
    assert compliance.twist(load, row)[4] == pytest.approx(1.3e-4 / 1.8)
    np.testing.assert_allclose(guide(arm).twist(load, row), gap.twist(load, row) + compliance.twist(load, row))


moments, positions = st.floats(-1e4, 1e4), st.floats(-3.0, 3.0)


@given(moment=moments, position=positions)
def test_a_load_reversed_turns_it_as_far_the_other_way(arm, moment, position):
    one, other = (guide(arm).twist(about_y(side * moment), at(position)) for side in (1.0, -1.0))
    np.testing.assert_array_equal(one, -other)


@given(moment=st.floats(1.0, 1e4), pair=st.tuples(positions, positions))
def test_less_overlap_turns_further(arm, moment, pair):
    near, far = sorted(pair, key=lambda position: abs(position - 2.0))
    short, long = (guide(arm).twist(about_y(moment), at(position))[4] for position in (near, far))
    assert short >= long > 0.0
    assert abs(far - 2.0) - abs(near - 2.0) < 1e-6 or short > long


@given(moment=moments, position=positions)
def test_a_harder_push_never_turns_it_less(arm, moment, position):
    less, more = (guide(arm).twist(about_y(push), at(position))[4] for push in (moment, moment + 5.0))
    assert more > less


@given(moment=moments.filter(lambda m: abs(abs(m) - 200.0) > 5.0 and abs(m) > 1.0), position=positions)
def test_its_tangent_by_hand(arm, moment, position):
    taken_up = abs(moment) > 200.0
    expected = np.zeros((6, 6))
    expected[4, 4] = (1e-6 + (0.0 if taken_up else 1e-3 / 200.0)) / (0.5 + abs(position - 2.0))
    np.testing.assert_allclose(guide(arm).tangent(about_y(moment), at(position)), expected, rtol=1e-6, atol=1e-16)


# Where it is offered.


def test_it_is_offered_about_every_axis_of_what_slides_and_nowhere_else(arm, tarm, heavy):
    locations = list(GUIDE.places(Records(arm.robot)))
    assert {(location.site, location.axis) for location in locations} == {("lift", axis) for axis in ("rx", "ry", "rz")}
    assert {location.covariates for location in locations} == {("q_lift",)}
    assert {location.terms for location in locations} == {(0,), (1,), (0, 1)} and len(locations) == 9
    sliding = {joint.name for joint in tarm.robot.moving if joint.kind == "prismatic"}
    assert sliding and {location.site for location in GUIDE.places(Records(tarm.robot))} == sliding
    assert not list(GUIDE.places(Records(heavy.robot)))


# Its file.

TABLE = """
[[effect]]
name = "unnamed"
shape = "guide"
site = "lift"
axis = "ry"
covariates = ["q_lift"]
parameters = { g = 1e-3, c = 1e-6, tau0 = 200.0, spare = 0.5, out = 2.0 }
"""


def with_table(folder: Path, table: str) -> Arm:
    write(folder, robot(*PARTS))
    return load_arm(write(folder, DECLARED + table, "arm.toml"))


def test_a_guide_declared_by_hand_tilts_the_arm(tmp_path):
    arm = with_table(tmp_path, TABLE)
    assert arm.effects == (Effect(GUIDE, SPOT, (1e-3, 1e-6, *INNER)),)
    q = arm.position(lift=1.5)
    moment = moment_about_y(q, 0.0)
    expected = (1e-3 + 1e-6 * moment) / 1.0
    found = arm.deflection(q)
    assert moment > 200.0 and found.displacement[4] == pytest.approx(expected, rel=2e-3)
    np.testing.assert_allclose(found.displacement[[0, 2]], [0.5 * expected, -2.0 * expected], rtol=3e-3)
    np.testing.assert_allclose(found.displacement[[1, 3, 5]], 0.0, atol=1e-9)


@pytest.mark.parametrize("terms", [(0,), (1,), (0, 1)])
def test_what_is_written_is_read_again(tmp_path, terms):
    values = tuple(value * (i in terms) for i, value in enumerate((7e-4, 3e-7)))
    effect = Effect(GUIDE, Location("lift", "rx", ("q_lift",), terms), (*values, 123.0, 0.25, -0.1))
    table = effect_table(effect, {name: 0.1 for name in effect.named})
    assert (table["name"], table["shape"]) == ("unnamed", "guide")
    assert with_table(tmp_path, "\n" + tomlkit.dumps({"effect": [table]})).effects == (effect,)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("g = 1e-3", "g = -1e-3", "g is -0.001, expected 0 or more"),
        ("c = 1e-6", "c = -1e-6", "c is -1e-06, expected 0 or more"),
        ("spare = 0.5", "spare = 0.0", "spare is 0, expected more than 0"),
        ("tau0 = 200.0", "tau0 = -1.0", "tau0 is -1, expected more than 0"),
        ("out = 2.0", "uot = 2.0", "no parameter 'uot', did you mean 'out'"),
        (", out = 2.0", "", r"'out' \[m\] is missing"),
        ("q_lift", "q_lfit", "the arm has no 'q_lfit', did you mean 'q_lift'"),
    ],
)
def test_a_guide_that_cannot_be_is_refused(tmp_path, old, new, words):
    assert TABLE.count(old) == 1
    with pytest.raises(ArmFileError, match=words):
        with_table(tmp_path, TABLE.replace(old, new))


# End to end, against a column in plain numpy.


def turned(axis: str, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) if axis == "y" else np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def chain(q: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return rotation and origin of head, upper and fore, seen from the column's end."""
    head, upper = turned("z", q[1]), turned("z", q[1]) @ turned("y", q[2])
    places = [np.array([0.0, 0.0, 0.4])]
    places.append(places[0] + head @ [0.2, 0.0, 0.1])
    places.append(places[1] + upper @ [1.0, 0.0, 0.0])
    return list(zip((head, upper, upper @ turned("y", q[3])), places, strict=True))


def moment_about_y(q: np.ndarray, payload: float) -> float:
    """Return what hangs on the column's end, about y there: a weight ahead of it pushes it forward."""
    head, upper, fore = chain(q)
    hung = [(25.0, head, (0.1, 0.0, 0.05)), (20.0, upper, (0.5, 0.0, 0.0)), (12.0, fore, (0.4, 0.0, 0.0))]
    hung.append((payload, fore, (0.9, 0.0, 0.0)))
    return GRAVITY * sum(mass * (place + turn @ centre)[0] for mass, (turn, place), centre in hung)


def tilt(q: np.ndarray, payload: float) -> float:
    moment = moment_about_y(q, payload)
    return (GAP * np.clip(moment / TAU0, -1.0, 1.0) + GIVES * moment) / (SPARE + abs(q[0] - OUT))


def target(q: np.ndarray, payload: float) -> np.ndarray:
    turn, place = chain(q)[2]
    return np.array([0.0, 0.0, q[0]]) + turned("y", tilt(q, payload)) @ (place + turn @ TARGET)


def campaign(folder: Path, seed: int, count: int = 150) -> Path:
    """Write a campaign of a column whose guides have play, read from a place of its own in two sessions."""
    rng = np.random.default_rng(seed)
    station, stands = turned("z", 0.7) @ turned("y", 0.1), np.array([3.0, -2.0, 1.0])
    rows = []
    for i in range(count):
        q = np.array([rng.choice(HEIGHTS), *rng.uniform((-2.8, -1.0, -1.5), (2.8, 0.8, 1.5))])
        payload = rng.choice([0.0, 40.0])
        seen = station @ target(q, payload) + stands + rng.normal(0.0, NOISE, 3)
        identity = {"pose": f"p{i}", "session": f"s{2 * i // count}", "time": 60.0 * i}
        joints = dict(zip(("q_lift", "q_turn", "q_shoulder", "q_elbow"), q.tolist(), strict=True))
        place = dict(zip("xyz", seen.tolist(), strict=True))
        rows.append(identity | {"payload": "p40" if payload else "empty"} | joints | place | {"sigma": NOISE})
    return written(folder, rows, "campaign.csv")


def giving() -> str:
    """Return flexures, for a column whose builders say that every joint gives a little."""
    joints = ("lift", "turn", "shoulder", "elbow")
    tables = [f'[flexure.{name}]\njoint = "{name}"\ncompliance = [0, 0, 0, 1e-8, 1e-8, 1e-8]\n' for name in joints]
    return "\n" + "\n".join(tables)


@pytest.fixture(scope="module", params=["rigid", "linear"])
def traced(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Trace:
    folder = tmp_path_factory.mktemp("campaign")
    arm = with_table(folder, giving() if request.param == "linear" else "")
    return trace(arm, read_measurements(campaign(folder, 1), arm))


def test_the_column_sags_too_little_for_its_loads_to_change():
    q = np.array([2.0, 0.0, 0.0, 0.0])
    assert 1e-3 < tilt(q, 40.0) < 3e-3


@pytest.mark.slow
def test_the_guide_is_found_where_it_is(traced):
    first = traced.found[0].effect
    assert (first.law.name, first.location.site, first.location.axis) == ("unnamed_guide", "lift", "ry")
    assert first.named["out"] == pytest.approx(OUT)
    assert len(traced.found) == 1


@pytest.mark.slow
def test_held_out_errors_fall_to_the_noise(traced):
    assert traced.held_out_before > 3.0 * NOISE * np.sqrt(3.0)
    assert traced.held_out_after < 1.1 * NOISE * np.sqrt(3.0)


@pytest.mark.slow
@pytest.mark.parametrize("height", [0.0, 1.0, 2.0])
def test_the_traced_column_tilts_as_the_true_one(traced, height):
    """Between ahead and aside, because what is the same everywhere is the instrument's place."""
    ends = [traced.arm.position(lift=height, elbow=0.5, turn=turn) for turn in (0.0, np.pi / 2.0)]
    true = [tilt(q, 40.0) for q in ends]
    found = [traced.arm.deflection(q, "p40").twists[0, 4] for q in ends]
    assert found[0] - found[1] == pytest.approx(true[0] - true[1], rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("compliance", "times"), [("1e-8", 10.0), ("1e-7", 10.0)])
def test_calibration_settles_where_the_model_is_far_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compliance: str, times: float
) -> None:
    monkeypatch.setattr("test_guide.GAP", times * GAP)
    monkeypatch.setattr("test_guide.GIVES", times * GIVES)
    arm = with_table(tmp_path, giving().replace("1e-8", compliance))
    found = calibrate(arm, read_measurements(campaign(tmp_path, 1), arm))
    assert found.rms > 2.0 * found.noise_rms
    assert found.rms <= found.declared_rms
