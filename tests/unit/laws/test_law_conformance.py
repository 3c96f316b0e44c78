"""What must hold of every law of the catalogue: a new one is in here by its line there and its `EXAMPLE`."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.bench import some_law, some_perceptron
from support.small_arms import three_joints

from armflex import Arm, Measurements, Reading, Tracker, calibrate, load_arm, plan
from armflex.conventions import Array
from armflex.errors import ArmFileError
from armflex.estimate.draw import draw_arms
from armflex.laws import LAWS, AtNode, Law, LinearLaw, Row
from armflex.laws.joint.carried import ScaledLaw, scaled
from armflex.laws.joint.linear import LinearFit
from armflex.laws.joint.network import weight_count
from armflex.laws.joint.polynomial import PolynomialLaw
from armflex.laws.law import anywhere
from armflex.readings import Position, Readings
from armflex.rows import Rows
from armflex.testing import check_answers

EXAMPLES = {name: model.example for name, model in LAWS.items()}
COUNT, SIGMA = 60, 1e-5
SIZE = np.repeat([2e3, 1e3], 3)
FACTOR = np.exp(0.5 * np.array([0.0, 0.1, 0.0, 0.2, 0.4, -0.2]))
"""By which the true joint is softer than declared, axis by axis; what the arm does not load stays."""

ARM = """
[robot]
urdf = "robot.urdf"
tip = "tool"
gravity = [0.0, 0.0, -9.81]
[payload.heavy]
mass = 80.0
com = [0.1, 0.0, 0.2]
[measurement]
frame = "base"
[prior]
{prior}
[flexure.yaw]
joint = "yaw"
compliance = [1e-9, 1e-9, 1e-9, 1e-7, 1e-7, 1e-7]
[flexure.pitch]
joint = "pitch"
{learn}
{law}
"""


def arm_with(folder: Path, name: str, prior: str = "", learn: bool = False) -> Arm:
    """Return three joints, the second with a law as its example declares it."""
    three_joints(folder, [np.zeros((6, 6))] * 3)
    text = ARM.format(prior=prior, learn="learn = true" if learn else "", law=EXAMPLES[name])
    (folder / "arm.toml").write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that the other joint is taken as known
        return load_arm(folder / "arm.toml")


@pytest.fixture(scope="module")
def declared(tmp_path_factory) -> dict[str, Arm]:
    """An arm with every declared law, all of them to be found again."""
    return {name: arm_with(tmp_path_factory.mktemp(name), name, "compliance = 0.5") for name in EXAMPLES}


def law_of(arm: Arm) -> Law:
    return arm.flexures[1].law


def other_laws() -> dict[str, Law]:
    """Laws that a bench taught, and laws about a law."""
    diagonal, rng = np.array([1e-8, 2e-8, 1e-8, 1e-6, 2e-6, 1e-6]), np.random.default_rng(1)
    roots = 0.05 * rng.normal(size=(6, 6, 6)) * (diagonal / 6.0)[:, None, None]
    loads, scatter = np.array([-SIZE, SIZE]), np.repeat([1e-7, 1e-6], 3)
    names = ("fx", "fy", "fz", "mx", "my", "mz", "|my|", "radial_force", "fx*my")
    coefficients = np.vstack([np.diag(diagonal), *(0.1 * diagonal * np.array([[1.0], [1.0], [1e-3]]))])
    known = np.array([np.diag((0.05 * np.abs(column).max() * np.ones(9)) ** 2) for column in coefficients.T])
    single = some_law(6, 1)
    root = 0.02 * rng.normal(size=(weight_count(6, single.hidden.shape[1]),) * 2) / 10.0
    linear = LinearLaw(np.diag(diagonal), 0.05)
    return {
        "fitted": LinearLaw(np.diag(diagonal), fit=LinearFit(roots @ roots.swapaxes(1, 2), scatter, loads)),
        "polynomial": PolynomialLaw(names, coefficients, known, scatter, loads),
        "network": replace(single, weight_covariance=root @ root.T),
        "networks": some_law(6, 50),
        "at a node": AtNode(linear, np.array([0.1, 0.0, 0.3])),
        "scaled": ScaledLaw(linear, 2.0 * np.log(FACTOR), (3, 4, 5), 0.05),
    }


OTHERS = other_laws() | {"layer": some_perceptron(6, "Sigmoid"), "layers": some_perceptron(6, "Tanh", "GELU")}
EVERY = (*EXAMPLES, *OTHERS)


@pytest.fixture(params=EVERY)
def law(request, declared) -> Law:
    return OTHERS[request.param] if request.param in OTHERS else law_of(declared[request.param])


def asked(law: Law, count: int = 8) -> tuple[Array, Row]:
    """Return (count, 6) loads within those that a law was trained on, if it was, and as many rows."""
    rng = np.random.default_rng(2)
    size = SIZE if law.trained_on is None else 0.4 * np.abs(law.trained_on).min(axis=0)
    q = rng.uniform(-1.5, 1.5, (count, 3))
    return 0.7 * size * rng.uniform(-1.0, 1.0, (count, 6)), Row(q, {"yaw": 0, "pitch": 1, "roll": 2})


def test_its_answers_belong_together(law):
    check_answers(law, *asked(law, 40))


def test_draws_spread_as_the_covariance_says(law):
    loads, rows = asked(law, 2)
    rng, load, row = np.random.default_rng(5), loads[0], rows.some(0)
    drawn = np.array([law.draw(rng).twist(load, row) for _ in range(600)])
    whole, scatter = law.covariance(load, row), law.certain().scatter(load, row)
    known = whole if scatter is None or len(getattr(law, "hidden", (0,))) > 1 else whole - scatter
    expected = np.sqrt(np.diag(known).clip(0.0))
    if len(getattr(law, "hidden", (0,))) > 1:  # its scatter is that of its members, and the noise
        expected = np.sqrt(np.diag(known) - law.noise**2)
    assert law.uncertain or "hidden" in vars(law) or not law.parameters
    # A standard deviation from 600 draws is right to a root of 1200, at 4 of them; logarithms bend by a twentieth.
    rounding = 1e-3 * expected.max() + 1e-12 * np.abs(drawn).max()
    np.testing.assert_allclose(drawn.std(axis=0), expected, rtol=4.0 / np.sqrt(1200) + 0.05, atol=rounding)
    assert not law.draw(rng).uncertain or "hidden" in vars(law)


def test_scaled_is_what_it_says(law):
    loads, rows = asked(law)
    scale = law.scaling(FACTOR)
    found, expected = scaled(law, FACTOR), law.twist(loads @ scale, rows) @ scale
    np.testing.assert_allclose(found.twist(loads, rows), expected, rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_declared_law_gains_no_energy(name, declared):
    loads, rows = asked(law_of(declared[name]))
    assert (np.einsum("ni,ni->n", loads, law_of(declared[name]).twist(loads, rows)) >= 0.0).all()


@pytest.mark.parametrize("name", EXAMPLES)
def test_prepared_and_batches_answer_as_one_by_one(name, declared):
    arm, q = declared[name], np.random.default_rng(4).uniform(-1.5, 1.5, (6, 3))
    loop, batch = arm.prepared("heavy"), arm.deflection(q, "heavy")
    for i, here in enumerate(q):
        alone = arm.deflection(here, "heavy")
        assert np.abs(alone.twists[1]).max() > 1e-5
        np.testing.assert_allclose(loop(here), alone.displacement, atol=1e-11)
        np.testing.assert_allclose(batch.displacement[i], alone.displacement, atol=1e-11)
        np.testing.assert_allclose(batch.covariance[i], alone.covariance, rtol=1e-6, atol=1e-15)


def tips(arm: Arm, rows: Rows) -> Array:
    """Return where the tip is in every row [m], base axes."""
    pairs = zip(rows.q, rows.payload, strict=True)
    return np.array([arm.deflection(q, payload).pose.translation for q, payload in pairs])


def read_at(arm: Arm, truth: Law, seed: int) -> Measurements:
    """Return what is read of an arm whose second law is another."""
    rng, names = np.random.default_rng(seed), ("none", "heavy")
    q = rng.uniform(-1.5, 1.5, (COUNT, 3))
    rows = Rows.of(arm.joint_names, q, [names[i % 2] for i in range(COUNT)], {}, derived=("time",))
    there = replace(arm, flexures=(arm.flexures[0], replace(arm.flexures[1], law=truth, learn=None)))
    position = tips(there, rows) + rng.normal(0.0, SIGMA, (COUNT, 3))
    return Measurements.of(rows, Readings(COUNT, (Position(position, np.full((COUNT, 3), SIGMA)),)))


def away(arm: Arm, readings: Measurements) -> float:
    """Return the RMS distance of what an arm predicts from what was read [m]."""
    return float(np.sqrt(((tips(arm, readings) - readings.position) ** 2).sum(axis=1).mean()))


FREED = [name for name in EXAMPLES if name != "structural"]
"""What [prior] compliance frees: not laws within laws."""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "learn"), [*((name, False) for name in FREED), *((name, True) for name in EXAMPLES)])
def test_it_is_freed_found_again_saved_drawn_warned_about_planned_for_and_tracked(name, learn, tmp_path):
    arm = arm_with(tmp_path, name, "" if learn else "compliance = 0.5", learn)
    truth = law_of(arm)
    if name == "structural":
        truth = truth.with_laws([scaled(truth.laws[0], FACTOR), truth.laws[1]])
    truth = truth if name == "structural" else scaled(truth, FACTOR)
    campaign, held_out = read_at(arm, truth, 1), read_at(arm, truth, 2)
    assert away(arm, held_out) > 4.0 * np.sqrt(3.0) * SIGMA
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        planned = plan(arm, 6, after=campaign, sigma=SIGMA) if learn else plan(arm, 6, sigma=SIGMA)
        assert len(planned.rows.q) == 6
        found = calibrate(arm, campaign)
        assert away(found.arm, held_out) < 1.3 * np.sqrt(3.0) * SIGMA
        path = found.write(tmp_path / "found.toml")
        again = load_arm(path)
    loads, rows = asked(law_of(arm))
    np.testing.assert_allclose(law_of(again).twist(loads, rows), law_of(found.arm).twist(loads, rows), rtol=1e-8)
    drawn = np.array([law_of(one).twist(loads[0], rows.some(0)) for one in draw_arms(again, 5)])
    assert (drawn.std(axis=0)[4] > 0.0).all()
    if learn:
        assert {flag.code for flag in law_of(again).flags(100.0 * SIZE, rows.some(0))} == {"extrapolating"}
    tracker = Tracker(again)
    for i in range(10):
        tracker.update(Reading(held_out.q[i], held_out.position[i], SIGMA, held_out.payload[i]))
    assert away(tracker.arm, held_out) < 1.4 * np.sqrt(3.0) * SIGMA


@pytest.mark.parametrize("name", FREED)
def test_a_campaign_frees_what_gives(name, declared):
    arm = declared[name]
    of_numbers = {"telescope": {0, 3, 4}}  # EA, GJ and EI of a boom along x
    assert set(law_of(arm).freed(anywhere(arm.robot))) == of_numbers.get(name, set(range(6)))
    assert all(flexure.law.freed(anywhere(arm.robot)) for flexure in arm.flexures)


@pytest.mark.parametrize("name", EXAMPLES)
def test_drawn_arms_differ_by_what_was_declared(name, declared):
    q = np.array([0.3, 0.5, -0.2])
    shifts = np.array([arm.deflection(q, "heavy").displacement for arm in draw_arms(declared[name], 200, 3)])
    expected = np.sqrt(np.diag(declared[name].deflection(q, "heavy").covariance))
    np.testing.assert_allclose(shifts.std(axis=0), expected, rtol=0.3, atol=0.05 * expected[:3].max())


@pytest.mark.slow
def test_what_cannot_harden_is_refused_by_its_line(tmp_path):
    three_joints(tmp_path, [np.zeros((6, 6))] * 3)
    text = ARM.format(prior="", learn="", law=EXAMPLES["hardening"].replace("energy = 0.5", "energy = -0.5"))
    (tmp_path / "arm.toml").write_text(text)
    line = text[: text.index("energy")].count("\n") + 1
    with pytest.raises(ArmFileError, match=rf"arm.toml:{line}: \[flexure.pitch\] energy: expected more than 0 J"):
        load_arm(tmp_path / "arm.toml")
