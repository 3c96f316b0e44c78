"""Every law of the catalogue, and every shape without a name, at work in an arm and as columns of a fit."""

import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from support.effect_arms import MECHANICAL
from support.stage import ROWS, Stage, readings, some_effects

from armflex import Arm, Trajectory
from armflex.arm import Setup
from armflex.conventions import Array
from armflex.errors import MissingCovariateError
from armflex.estimate.block import EffectBlock, amplitude_prior
from armflex.estimate.view import look
from armflex.laws.effects import Effect, EffectLaw, Location
from armflex.laws.effects.candidate import Candidate, grid
from armflex.laws.effects.catalogue import CATALOGUE, EVERY
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import Act
from armflex.laws.effects.guide import GUIDE, GUIDES
from armflex.laws.effects.hysteresis import play
from armflex.laws.effects.telescope_bending import TELESCOPE_BENDING
from armflex.laws.effects.tool_shift import ALWAYS
from armflex.laws.effects.unnamed import PRODUCT, WAVE_PRODUCT
from armflex.laws.row import Row
from armflex.laws.terms import tents as hats
from armflex.measured.measurements import Measurements
from armflex.mechanics.history import known_rows

SECOND_ORDER = {"hysteresis": 0.02, "gravity_tilt": 0.02}
"""Relative errors of columns: a memory is of the load without the effect, and two turns of gravity do not commute."""


INSTRUMENT_ONLY = ("tracker_scale", "session_frame", "refraction")


@pytest.mark.parametrize("name", EVERY)
def test_columns_are_the_readings_changes(name, stage):
    law, rng = EVERY[name], np.random.default_rng(5)
    for effect in some_effects(law, stage, 2):
        free = tuple(i for i in Candidate(law, effect.location, effect.inner).searched if law.inner[i].smooth)
        prior = amplitude_prior(effect, free, stage.view, stage.context)
        block = EffectBlock(effect, free, stage.context, 0, prior)
        assert len(block.labels) == len(block.units) == len(block.prior) == len(block.start)
        columns = block.jacobian(look(block.apply(stage.setup, block.start), stage.rows, np.arange(ROWS)))
        sizes, every = np.abs(columns).max(axis=(0, 1)), np.arange(len(block.start))
        amplitude = every < len(effect.location.terms)
        usual = np.where(amplitude, 1e-2 * np.where(block.start, np.abs(block.start), np.abs(block.start).max()), 1e-4)
        for among, relative in ((amplitude, SECOND_ORDER.get(name, 1e-5)), (~amplitude, SECOND_ORDER.get(name, 1e-3))):
            if not among.any():
                continue
            # Some values together, each by what moves the readings as far as the others do.
            moved = np.min((usual * sizes)[among & (sizes > 0.0)], initial=np.inf)
            step = np.where(among, np.minimum(usual, moved / np.maximum(sizes, 1e-300)), 0.0)
            step *= rng.choice((-1.0, 1.0), len(step))
            ends = [readings(block.apply(stage.setup, block.start + side * step), stage.rows) for side in (1.0, -1.0)]
            numeric = (ends[0] - ends[1]) / 2.0
            least = np.min(np.abs(sizes * step)[among])
            assert np.abs(columns @ step - numeric).max() <= relative * least + 1e-12, (effect.name, step)


@pytest.mark.parametrize("name", EVERY)
def test_a_small_effect_moves_the_tip_by_its_column(name, stage):
    """At a hundredth of the size: the tip itself, not only its change, is what first order says."""
    law, size = EVERY[name], 1e-5
    for effect in some_effects(law, stage, 3, size):
        expected = stage.view.effect_jacobian(effect, stage.context) @ effect.acting
        moved = readings(stage.with_effect(effect), stage.rows) - readings(stage.setup, stage.rows)
        largest = np.abs(expected).max()
        assert largest > 0.01 * size
        # What is left goes by the square: some um of a metre's lever per 10 um of motion.
        tolerance = max(SECOND_ORDER.get(name, 0.0), 2e-3) * largest
        np.testing.assert_allclose(moved, expected, rtol=0.0, atol=tolerance, err_msg=effect.name)


@pytest.mark.parametrize("name", INSTRUMENT_ONLY)
def test_an_instruments_fault_leaves_the_arm_alone(name, stage):
    effect = some_effects(EVERY[name], stage, 1)[0]
    arm = stage.with_effect(effect).arm
    q = stage.rows.q[3]
    # Loops are followed from the row before, whose rounding is left.
    plain = stage.setup.arm.deflection(q).displacement
    np.testing.assert_allclose(arm.deflection(q).displacement, plain, rtol=0, atol=1e-14)


def needs(effect: Effect, arm: Arm, rows: Measurements) -> set[str]:
    """Return the covariates without which a deflection is not to be had."""
    known, needed = known_rows(arm, rows), set()
    for name in known:
        given = {other: values[0] for other, values in known.items() if other != name}
        try:
            arm.deflection(rows.q[0], rows.payload[0], covariates=given)
        except MissingCovariateError as error:
            assert error.name == name and effect.name in str(error)
            needed.add(name)
    return needed


@pytest.mark.parametrize("name", EVERY)
def test_a_missing_covariate_is_named_with_the_effect(name, stage):
    law = EVERY[name]
    for effect in some_effects(law, stage, 3):
        if name == "tool_shift" and effect.inner[0] == ALWAYS:
            continue  # moved for the whole campaign: no time is asked for
        asked = needs(effect, stage.with_effect(effect).arm, stage.rows)
        joints = {f"q_{joint}" for joint in stage.context.joints}
        known = {*joints, "payload_mass", "hold"}  # without a time under load it has just been put on
        wanted = set(effect.location.covariates) - known if law.act is Act.TWIST else set()
        remembered = law.memory is not None
        if remembered and (not effect.location.covariates or effect.inner[-1] > 0.0):
            wanted = set()  # as after this load alone
        if name == "tool_shift":
            wanted = {"time"}
        assert asked == wanted, effect.name


def untimed(stage: Stage) -> Context:
    known = {name: values for name, values in stage.context.row.covariates.items() if name != "time"}
    return replace(stage.context, row=replace(stage.context.row, covariates=known), recorded=("temperature",))


TIMED = ("slip_step", "base_drift", "base_wandering", "drive_wandering", "instrument_moved", "creep", "cylinder_leak")
NOT_EVERYWHERE = (PRODUCT.name, WAVE_PRODUCT.name, GUIDE.name, GUIDES.name, TELESCOPE_BENDING.name)


@pytest.mark.parametrize("name", [name for name in EVERY if name not in NOT_EVERYWHERE])
def test_without_a_time_nothing_that_needs_one_is_tried(name, stage):
    context, law = untimed(stage), EVERY[name]
    locations = list(law.places(context.records))
    here = bool(stage.context.robot.linkage) or name not in MECHANICAL
    assert bool(locations) == (here and name not in TIMED)
    for location in locations[:: max(1, len(locations) // 20)]:
        for inner in grid(law, location, context):
            assert np.isfinite(stage.view.jacobian(law, location, inner, context)).all()


def test_a_tool_that_moved_a_second_before_the_first_row_has_not_always_been_there(stage):
    late = Effect(CATALOGUE["tool_shift"], Location("tool", "dx", terms=(0,)), (1e-3, 0.0, 0.0, -1.0))
    always = replace(late, values=(1e-3, 0.0, 0.0, ALWAYS))
    time = np.linspace(-2.0, 1.0, ROWS)
    row = replace(stage.context.row, covariates={**stage.context.row.covariates, "time": time})
    moved = [
        (stage.view.effect_jacobian(e, replace(stage.context, row=row)) != 0.0).any(axis=(1, 2)) for e in (late, always)
    ]
    assert moved[0].tolist() == (time >= -1.0).tolist() and moved[1].all()
    assert list(always.named) == ["dx"] and len(always.units) == 1 and late.named["since"] == -1.0


def test_an_entry_that_asked_rows_never_have_is_not_missing(stage):
    location = Location(stage.context.joints[1], "ry", ("operator=dan",))
    arm = stage.with_effect(Effect(EVERY["unnamed_level"], location, (1e-3,))).arm
    assert not known_rows(arm, stage.rows)["operator=dan"].any()
    bare = replace(stage.rows, covariates={"temperature": stage.rows.covariates["temperature"]})
    assert "operator=dan" not in known_rows(arm, bare)


def test_a_misspelt_covariate_is_guessed(stage):
    effect = some_effects(CATALOGUE["thermal_growth"], stage, 1)[0]
    still = replace(effect, values=(*effect.values[:2], 0.0))
    with pytest.raises(MissingCovariateError, match=r"'temperature'.*did you mean 'temprature'"):
        stage.with_effect(still).arm.deflection(stage.rows.q[0], covariates={"temprature": 20.0})


@pytest.mark.parametrize("name", [name for name, law in EVERY.items() if hasattr(law, "twists")])
def test_one_row_and_many_rows_are_alike(name, stage):
    """A law answers single rows and whole campaigns with the same numbers."""
    law = EVERY[name]
    for effect in some_effects(law, stage, 2):
        setup = stage.with_effect(effect)
        here = stage.context.here(effect.location, setup.arm)
        known = known_rows(setup.arm, stage.rows)
        row = replace(stage.context.row, covariates=known)
        wrench = stage.context.wrenches[effect.location.site]
        whole = law.twists(here, wrench, row, effect.inner)
        assert whole.shape == (ROWS, len(law.amplitudes), 6)
        for i in range(ROWS):
            one = replace(row, q=row.q[i], covariates={key: values[i] for key, values in known.items()})
            np.testing.assert_allclose(law.twists(here, wrench[i], one, effect.inner), whole[i], rtol=1e-13)


@pytest.mark.parametrize("moving", [False, True])
def test_a_remembered_load_is_that_of_row_by_row(moving, stage):
    """Play follows the load of each row as the arm carries it without the play, at rest and in motion."""
    joint = stage.context.joints[1]
    if moving and stage.context.robot.linkage:
        pytest.skip("an arm with loops does not move")
    effect = Effect(EVERY["hysteresis"], Location(joint, "ry"), (1e-8, 50.0))
    arm, rows = stage.setup.arm, stage.rows
    rng = np.random.default_rng(4)
    v, a = (rng.normal(size=rows.q.shape) if moving else None for _ in range(2))
    path = Trajectory(rows.joint_names, np.arange(ROWS, dtype=float), rows.q, rows.payload, ("",) * ROWS, v, a)
    state = known_rows(stage.with_effect(effect).arm, path)[effect.state]
    loads = []
    for i in range(ROWS):
        found = arm.deflection(rows.q[i], rows.payload[i], **path.motion(i), enforce_limits=False)
        load = pin.Force(found.joint_loads[1])
        for site, twist in zip(arm.sites, found.twists, strict=True):
            if site.joint == joint and not site.before:
                load = pin.exp6(pin.Motion(twist)).actInv(load)
        loads.append(load.vector[4])
    np.testing.assert_allclose(state, play(np.array(loads), 50.0), rtol=1e-9, atol=1e-6)
    assert np.abs(state).max() > 0.0


@pytest.mark.parametrize("name", [name for name, law in EVERY.items() if hasattr(law, "pull")])
def test_pulls_answer_one_pose_and_many(name, stage):
    law = EVERY[name]
    effect = some_effects(law, stage, 1)[0]
    here = stage.context.here(effect.location, stage.setup.arm)
    poses = stage.view.line.links[:, 3]
    whole = law.pull(here, poses, effect.inner)
    for i in range(ROWS):
        np.testing.assert_allclose(law.pull(here, poses[i], effect.inner), whole[i], rtol=1e-13)


@pytest.mark.parametrize("name", EVERY)
def test_values_have_names_and_units(name, stage):
    for effect in some_effects(EVERY[name], stage, 2):
        assert len(effect.named) == len(effect.units) and all(unit and "{" not in unit for unit in effect.units)
        assert effect.name.startswith(name) and np.isfinite(list(effect.named.values())).all()


def laws_of(stage: Stage) -> list[EffectLaw]:
    return [law for name, law in CATALOGUE.items() if stage.context.robot.linkage or name not in MECHANICAL]


def loaded_with_everything(stage: Stage) -> Setup:
    setup = stage.setup
    for law in laws_of(stage):
        effect = some_effects(law, stage, 1, 1e-4)[0]
        setup = setup.with_effect(effect)
    return setup


def displacement_of(packed: bytes) -> Array:
    arm, q, payload, known = pickle.loads(packed)
    return arm.deflection(q, payload, covariates=known).displacement


@pytest.mark.slow
def test_an_arm_with_every_effect_goes_to_another_process(stage):
    arm, rows = loaded_with_everything(stage).arm, stage.rows
    assert len(arm.effects) == len(laws_of(stage))
    known = {name: float(values[2]) for name, values in known_rows(arm, rows).items()}
    here = arm.deflection(rows.q[2], rows.payload[2], covariates=known).displacement
    packed = pickle.dumps((arm, rows.q[2], rows.payload[2], known))
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        there = pool.submit(displacement_of, packed).result()
    np.testing.assert_allclose(here, there, rtol=0, atol=1e-14)  # loops are followed from the row before
    plain = stage.setup.arm.deflection(rows.q[2], rows.payload[2]).displacement
    assert 1e-5 < np.abs(here - plain)[:3].max() < 1e-1


def test_every_law_has_a_name_of_its_own_and_is_found_by_it():
    assert all(law.name == name for name, law in EVERY.items())
    for law in EVERY.values():
        again = pickle.loads(pickle.dumps(law))
        assert again is law or again == law, law.name


def test_hats_are_a_partition_and_stay_at_their_ends():
    x = np.linspace(-1.0, 3.0, 101)
    tents = np.array([hat.at(Row(np.zeros((101, 0)), {}, {"x": x})) for hat in hats("x", 0.0, 2.0, 5)[:-1]])
    assert tents.shape == (5, 101) and tents.min() >= 0.0 and tents.sum(axis=0).max() <= 1.0 + 1e-12
    np.testing.assert_array_equal(tents[:, x <= 0.0], np.tile(tents[:, :1], (x <= 0.0).sum()))
    assert (tents[:, x >= 2.0] == 0.0).all()
