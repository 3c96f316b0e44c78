"""A telescope that bends: the beam by hand, where it is offered, its file, in C, and traced in a boom."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomlkit
from support.compiled_arm import compiled
from support.fixtures import ROBOTS

from armflex import Arm, load_arm, predict, read_measurements, trace
from armflex.errors import ArmFileError
from armflex.files.effect_file import effect_table
from armflex.laws import Row
from armflex.laws.effects import Effect, Location
from armflex.laws.effects.context import Records
from armflex.laws.effects.in_arm import BoundTwist
from armflex.laws.effects.location import Here
from armflex.laws.effects.telescope_bending import TELESCOPE_BENDING
from armflex.laws.joint.position_dependent import PositionDependentLaw

EI, GJ = 1.0 / 1.5e-8, 1.0 / 2.5e-8
"""Of a slender mast [N m^2]."""

CLAMPED = 1.2
"""m of it that are out at position 0."""

TARM = ROBOTS / "tarm_like"


def cantilever(length: float) -> np.ndarray:
    """Return the (6, 6) compliance at the end of a beam that hangs down from its clamp, by tables of beams.

    A force +x bends the end towards +x and turns what was below towards +x, which is negative about y.
    """
    found = np.zeros((6, 6))
    found[0, 0] = found[1, 1] = length**3 / (3.0 * EI)
    found[0, 4] = found[4, 0] = -(length**2) / (2.0 * EI)
    found[1, 3] = found[3, 1] = length**2 / (2.0 * EI)
    found[3, 3] = found[4, 4] = length / EI
    found[5, 5] = length / GJ
    return found


def telescope(arm: Arm, declared_at: float, rigid: bool = False, way: str = "out") -> BoundTwist:
    spot = Location("M1", None, ("q_M1",), (0, 1), way)
    law = None if rigid else arm.flexures[0].law
    return BoundTwist(
        Effect(TELESCOPE_BENDING, spot, (1.0 / EI, 1.0 / GJ, CLAMPED, declared_at)), Here(spot, arm.robot, law)
    )


@pytest.mark.parametrize("position", [0.0, 0.7, 3.0, 6.0])
def test_it_bends_as_a_beam_beyond_what_was_declared(tarm, position):
    wrench, row = np.array([300.0, -200.0, -4000.0, 700.0, 900.0, -90.0]), Row(np.array([position]), {"M1": 0})
    whole, declared = cantilever(CLAMPED + position), cantilever(CLAMPED + 2.0)
    np.testing.assert_allclose(telescope(tarm, 2.0, rigid=True).twist(wrench, row), whole @ wrench, rtol=1e-12)
    found = telescope(tarm, 2.0)
    np.testing.assert_allclose(found.twist(wrench, row), (whole - declared) @ wrench, rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(found.tangent(wrench, row), whole - declared, rtol=1e-9, atol=1e-20)


def test_it_adds_to_what_was_declared_or_takes_away_as_its_words_say(tarm):
    """Out of its vertical the end sags by more beyond the declared length, and by less short of it."""
    side = np.array([1000.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    sags = [telescope(tarm, 2.0).twist(side, Row(np.array([q]), {"M1": 0}))[0] for q in (1.0, 2.0, 3.0)]
    assert sags[0] < -1e-9 and abs(sags[1]) < 1e-15 and sags[2] > 1e-9
    assert "beyond which this adds to it and short of which it takes away" in TELESCOPE_BENDING.words.meaning


def test_driven_in_it_is_a_beam_the_other_way_that_gets_shorter(tarm):
    wrench, row = np.array([300.0, -200.0, -4000.0, 700.0, 900.0, -90.0]), Row(np.array([0.5]), {"M1": 0})
    mirrored = cantilever(CLAMPED - 0.5)
    mirrored[:3, 3:] *= -1.0
    mirrored[3:, :3] *= -1.0
    found = telescope(tarm, 0.0, rigid=True, way="in").twist(wrench, row)
    np.testing.assert_allclose(found, mirrored @ wrench, rtol=1e-12)


def test_it_is_offered_where_something_slides_and_nowhere_else(tarm, heavy):
    places = list(TELESCOPE_BENDING.places(Records(tarm.robot)))
    assert {one.site for one in places} == {"M1"} and {one.partner for one in places} == {"out", "in"}
    assert not list(TELESCOPE_BENDING.places(Records(heavy.robot)))


TABLE = """
[[effect]]
name = "unnamed"
shape = "telescope"
site = "M1"
partner = "out"
covariates = ["q_M1"]
parameters = { bending = 1e-9, torsion = 2e-9, length0 = 1.2, declared_at = 2.0 }
"""


def declared(folder: Path, text: str) -> Arm:
    path = folder / "arm.toml"
    path.write_text((TARM / "measured.toml").read_text().replace("robot.urdf", str(TARM / "robot.urdf")) + text)
    return load_arm(path)


def test_what_is_written_is_read_again(tmp_path):
    arm = declared(tmp_path, TABLE)
    table = effect_table(arm.effects[0])
    assert table["partner"] == "out" and arm.effects[0].units == ("1/(N m^2)", "1/(N m^2)", "m", "m")
    assert declared(tmp_path, "\n" + tomlkit.dumps({"effect": [table]})).effects == arm.effects


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("bending = 1e-9", "bending = -1e-9", "bending is -1e-09, expected 0 or more"),
        ('"M1"', '"A1"', "'A1' is no place for unnamed telescope on this arm.*known: M1"),
        ("length0 = 1.2, ", "", r"'length0' \[m\] is missing"),
    ],
)
def test_a_telescope_that_cannot_be_is_refused(tmp_path, old, new, words):
    assert TABLE.count(old) == 1
    with pytest.raises(ArmFileError, match=words):
        declared(tmp_path, TABLE.replace(old, new))


@pytest.mark.slow
def test_it_is_the_same_in_c(tmp_path):
    arm = declared(tmp_path, TABLE)
    rng, code = np.random.default_rng(0), compiled(arm, tmp_path)
    limits = [(joint.lower, joint.upper) for joint in arm.robot.moving]
    q = rng.uniform(*np.array(limits).T, (50, 7))
    codes, poses = code.tips(q, np.full(50, code.payloads.index("p600")))
    wanted = np.array([arm.deflection(one, "p600").pose.translation for one in q])
    without = np.array([replace(arm, effects=()).deflection(one, "p600").pose.translation for one in q])
    assert not codes.any() and np.abs(wanted - without).max() > 1e-4
    np.testing.assert_allclose(poses[:, :, 3], wanted, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_mast_of_which_a_constant_was_declared_is_traced_to_what_bends(tmp_path):
    """The guides give the same everywhere, the beam by its length; declared is what both give at mid-stroke."""
    arm = declared(tmp_path, "")
    guides = np.diag([2.5e-7, 2.5e-7, 3e-9, 3e-8, 3e-8, 5e-8])
    lengths = np.linspace(1.0, 8.0, 8)
    whole = np.array([cantilever(CLAMPED + x).ravel() for x in lengths])
    by_power = np.polynomial.polynomial.polyfit(lengths, whole, 3).reshape(4, 6, 6)
    by_power[0] += guides
    mast = arm.flexures[0]
    true = replace(arm, flexures=(replace(mast, law=PositionDependentLaw("M1", by_power)), *arm.flexures[1:]))
    middle = replace(mast, law=type(mast.law)(guides + cantilever(CLAMPED + 1.8)))
    arm = replace(arm, flexures=(middle, *arm.flexures[1:]))
    rows = read_measurements(TARM / "campaign.csv", arm)
    rows = rows.some(np.arange(0, len(rows), 3))
    tips = predict(true, rows).position
    noise = np.random.default_rng(1).normal(0.0, 2e-4, tips.shape)
    found = trace(arm, replace(rows, position=tips + noise))
    assert found.held_out_before > 1e-2 and found.held_out_after < 4e-4
    assert [one.effect.law.name for one in found.found] == ["unnamed_telescope"]
    values = found.found[0].effect.named
    assert values["bending"] == pytest.approx(1.0 / EI, rel=0.02) and values["length0"] == pytest.approx(CLAMPED, 0.1)


def test_nested_stages_are_as_their_finite_elements_over_the_whole_travel() -> None:
    """The least overlap is at 6 m, where a cubic was 33 % off."""
    law = load_arm(ROBOTS / "tarm_like" / "learned.toml").flexures[0].law
    table = np.loadtxt(ROBOTS.parent / "examples/boom/tables/M1_extension.csv", delimiter=",", skiprows=1)
    extensions, compliance = table[::6, 0], table[:, 1:].reshape(-1, 6, 6)
    assert (extensions.min(), extensions.max()) == (0.0, 6.0)
    for extension, matrix in zip(extensions, compliance, strict=True):
        size = np.sqrt(np.outer(np.diag(matrix), np.diag(matrix)))
        error = (law.tangent(np.zeros(6), Row(np.array([extension]), {"M1": 0})) - matrix) / size
        acting = error[[*range(6), 0, 1], [*range(6), 4, 3]]
        assert np.abs(acting).max() < 0.01
