"""Every law of the catalogue, and every shape without a name, at work in an arm and as columns of a fit."""

from __future__ import annotations

import multiprocessing
import pickle
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
import pinocchio as pin
import pytest
from campaigns import draw

from armflex import Arm, load_arm, read_measurements
from armflex.conventions import TWIST_NAMES, Array
from armflex.errors import MissingCovariateError
from armflex.estimate.effect_block import EffectBlock, shy_prior
from armflex.estimate.view import View, look
from armflex.laws.effects import Effect, EffectLaw, LoadLaw, Spot, TwistLaw
from armflex.laws.effects.catalogue import CATALOGUE, EVERY
from armflex.laws.effects.guide import GUIDE
from armflex.laws.effects.remember import known_rows
from armflex.laws.effects.scene import Scene, survey
from armflex.laws.effects.tool_shift import ALWAYS
from armflex.laws.effects.unnamed import PRODUCT, SHAPES, WAVE_PRODUCT
from armflex.measured.measurements import Measurements
from armflex.mechanics.response import respond
from armflex.readings.instrument import Instrument
from armflex.setup import Setup
from armflex.trace.candidates import Candidate, grid

ROWS = 14
SHIFT = 1e-3
"""m at the target: the size at which columns are checked."""

SECOND_ORDER = {"hysteresis": 0.02, "gravity_tilt": 0.02}
"""Relative errors of columns: a memory is of the load without the effect, and two turns of gravity do not commute."""

LARGEST = {("payload_com", "m"): 0.5, ("link_mass", "m"): 0.5, ("link_mass", "kg"): 50.0, ("gravity_tilt", "rad"): 0.02}
"""Amplitudes beyond which a body or gravity is no longer nearly what was declared."""

INSTRUMENT_ONLY = ("tracker_scale", "session_frame")


@dataclass(frozen=True)
class Stage:
    """A short campaign of one arm, looked at."""

    setup: Setup
    rows: Measurements
    view: View
    scene: Scene

    def with_effect(self, effect: Effect) -> Setup:
        return effect.law.apply(effect, self.setup)


def few(rows: Measurements, chosen: np.ndarray) -> Measurements:
    """Return a campaign of some rows, all of them measured."""
    names = ("pose", "session", "payload", "places")
    arrays = ("time", "q", "approach", "position", "sigma", "hold")
    changes = {name: tuple(getattr(rows, name)[i] for i in chosen) for name in names}
    changes |= {name: getattr(rows, name)[chosen] for name in arrays}
    covariates = {name: values[chosen] for name, values in rows.covariates.items()}
    return replace(rows, **changes, covariates=covariates, measured=np.ones(len(chosen), bool))


@pytest.fixture(scope="module", params=["boom", "six"])
def stage(request, tmp_path_factory) -> Stage:
    truth = draw("none", 5, request.param).write(tmp_path_factory.mktemp("campaign"))
    arm = load_arm(truth.arm)
    rows = few(read_measurements(truth.train, arm), np.linspace(0, 459, ROWS).astype(int))
    operator = ("ann", "bob", "ann", "cy", "bob", "ann", "ann") * 2
    rows = replace(rows, covariates={**rows.covariates, "operator": operator})
    pose = pin.SE3(pin.exp3(np.array([0.2, -0.1, 2.0])), np.array([1.0, -2.0, 0.5]))
    setup = Setup(arm, Instrument(pose, {"s1": np.repeat([1e-3, 0.0], 3)}, np.array([0.01, 0.02, -0.03])))
    view = look(setup, rows, np.arange(ROWS))
    line = respond(arm, rows.q, rows.payload)
    wrenches = {site: line.load_at(site) for site in line.sites}
    points = line.links[:, :, :3, 3]
    return Stage(setup, rows, view, survey(rows, arm, known_rows(arm, rows), wrenches, points))


def everywhere(law: EffectLaw, scene: Scene) -> list[Spot]:
    if law in (PRODUCT, WAVE_PRODUCT):
        joint = scene.joints[1]
        return [Spot(joint, "ry", (f"q_{joint}", "temperature"), tuple(range(len(law.amplitudes))))]
    return list(law.spots(scene))


def some_effects(law: EffectLaw, stage: Stage, count: int, shift: float = SHIFT) -> list[Effect]:
    """Return the law at places drawn at random with values that move the target by about `shift` each."""
    rng, found = np.random.default_rng(3), []
    spots = [spot for spot in everywhere(law, stage.scene) if is_loaded(law, spot, stage)]
    for index in rng.permutation(len(spots)):
        inner = list(grid(law, spots[index], stage.scene))
        candidate = Candidate(law, spots[index], inner[rng.integers(len(inner))])
        columns = law.columns(candidate.spot, candidate.inner, stage.view, stage.scene)
        sizes = np.sqrt((columns**2).sum(axis=1).mean(axis=0))
        acting = [law.amplitudes[i] for i in candidate.spot.terms]
        signs = [1.0 if one.positive or one.unit == "kg" else rng.choice((-1.0, 1.0)) for one in acting]
        largest = np.array([LARGEST.get((law.name, one.unit), 1e9) for one in acting])
        seen = sizes > 1e-3 * sizes.max()
        values = np.where(seen, shift * np.array(signs) / np.where(seen, sizes, 1.0), 0.0)
        scale = np.min(largest / np.maximum(np.abs(values), largest))
        if (seen.all() or law.name in SHAPES) and sizes.max() > 0.0 and scale > 0.01:
            found.append(candidate.effect(values * scale))
        if len(found) == count:
            return found
    if law is GUIDE and not any(joint.kind == "prismatic" for joint in stage.scene.robot.moving):
        assert not spots
        pytest.skip("nothing slides")
    assert found, law.name
    return found


def is_loaded(law: EffectLaw, spot: Spot, stage: Stage) -> bool:
    """Return whether there is a load worth the name on every axis that a law of the load needs."""
    if not getattr(law, "loaded", False) and law.name != "hysteresis":
        return True
    suffixes = [law.amplitudes[i].name.rpartition("_")[2] for i in spot.terms]
    named = {spot.axis, spot.partner, *suffixes} & set(TWIST_NAMES)
    wanted = [TWIST_NAMES.index(axis) for axis in named or ("rx", "ry", "rz")]
    sizes = np.sqrt((stage.scene.wrenches[spot.site] ** 2).mean(axis=0))
    share = sizes / np.repeat([sizes[:3].max(), sizes[3:].max()], 3)
    return bool((share[wanted] > 0.1).all())


def readings(setup: Setup, rows: Measurements) -> Array:
    """Return what the instrument reads, row by row through `Arm.deflection`."""
    known = known_rows(setup.arm, rows)
    tips = [
        setup.arm.deflection(q, payload, covariates={name: values[i] for name, values in known.items()}).pose
        for i, (q, payload) in enumerate(zip(rows.q, rows.payload, strict=True))
    ]
    return setup.instrument.readings(np.array([tip.homogeneous for tip in tips]), rows.session)


@pytest.mark.parametrize("name", EVERY)
def test_columns_are_the_readings_changes(name, stage):
    law = EVERY[name]
    for effect in some_effects(law, stage, 2):
        free = tuple(i for i in Candidate(law, effect.spot, effect.inner).searched if law.inner[i].smooth)
        prior = shy_prior(effect, free, stage.view, stage.scene)
        block = EffectBlock(effect, free, stage.scene, 0, prior)
        assert len(block.labels) == len(block.units) == len(block.prior) == len(block.start)
        columns = block.columns(look(block.apply(stage.setup, block.start), stage.rows, np.arange(ROWS)))
        for k in range(len(block.start)):
            step = np.zeros(len(block.start))
            amplitude = k < len(effect.spot.terms)
            step[k] = 1e-2 * (abs(block.start[k]) or np.abs(block.start).max()) if amplitude else 1e-4
            ends = [readings(block.apply(stage.setup, block.start + side * step), stage.rows) for side in (1.0, -1.0)]
            numeric = (ends[0] - ends[1]) / (2.0 * step[k])
            largest = np.abs(numeric).max()
            tolerance = SECOND_ORDER.get(name, 1e-5 if amplitude else 1e-3) * largest + 1e-12 / step[k]
            assert np.abs(columns[:, :, k] - numeric).max() <= tolerance, (effect.name, block.labels[k])


@pytest.mark.parametrize("name", EVERY)
def test_a_small_effect_moves_the_tip_by_its_column(name, stage):
    """At a hundredth of the size: the tip itself, not only its change, is what first order says."""
    law, size = EVERY[name], 1e-5
    for effect in some_effects(law, stage, 3, size):
        amplitudes = np.array([effect.amplitudes[i] for i in effect.spot.terms])
        expected = law.columns(effect.spot, effect.inner, stage.view, stage.scene) @ amplitudes
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
    np.testing.assert_array_equal(arm.deflection(q).displacement, stage.setup.arm.deflection(q).displacement)


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
        joints = {f"q_{joint}" for joint in stage.scene.joints}
        wanted = set(effect.spot.covariates) - joints - {"payload_mass"} if isinstance(law, TwistLaw) else set()
        remembered = isinstance(law, TwistLaw) and law.memory is not None
        if remembered and (not effect.spot.covariates or effect.inner[-1] > 0.0):
            wanted = {law.memory.name(effect.spot, effect.inner)}
        if name == "tool_shift":
            wanted = {"time"}
        assert asked == wanted, effect.name


def untimed(stage: Stage) -> Scene:
    known = {name: values for name, values in stage.scene.row.covariates.items() if name != "time"}
    return replace(stage.scene, row=replace(stage.scene.row, covariates=known), recorded=("temperature",))


@pytest.mark.parametrize("name", [name for name in EVERY if name not in (PRODUCT.name, WAVE_PRODUCT.name, GUIDE.name)])
def test_without_a_time_nothing_that_needs_one_is_tried(name, stage):
    scene, law = untimed(stage), EVERY[name]
    spots = list(law.spots(scene))
    assert bool(spots) == (name not in ("slip_step", "base_drift", "creep"))
    for spot in spots[:: max(1, len(spots) // 20)]:
        for inner in grid(law, spot, scene):
            assert np.isfinite(law.columns(spot, inner, stage.view, scene)).all()


def test_a_tool_that_moved_a_second_before_the_first_row_has_not_always_been_there(stage):
    late = Effect(CATALOGUE["tool_shift"], Spot("tool", "dx", terms=(0,)), (1e-3, 0.0, 0.0, -1.0))
    always = replace(late, values=(1e-3, 0.0, 0.0, ALWAYS))
    time = np.linspace(-2.0, 1.0, ROWS)
    row = replace(stage.scene.row, covariates={**stage.scene.row.covariates, "time": time})
    moved = [
        (late.law.columns(e.spot, e.inner, stage.view, replace(stage.scene, row=row)) != 0.0).any(axis=(1, 2))
        for e in (late, always)
    ]
    assert moved[0].tolist() == (time >= -1.0).tolist() and moved[1].all()
    assert list(always.named) == ["dx"] and len(always.units) == 1 and late.named["since"] == -1.0


def test_an_entry_that_asked_rows_never_have_is_not_missing(stage):
    spot = Spot(stage.scene.joints[1], "ry", ("operator=dan",))
    arm = stage.with_effect(Effect(EVERY["unnamed_level"], spot, (1e-3,))).arm
    assert not known_rows(arm, stage.rows)["operator=dan"].any()
    bare = replace(stage.rows, covariates={"temperature": stage.rows.covariates["temperature"]})
    assert "operator=dan" not in known_rows(arm, bare)


def test_a_misspelt_covariate_is_guessed(stage):
    effect = some_effects(CATALOGUE["thermal_growth"], stage, 1)[0]
    still = replace(effect, values=(*effect.values[:2], 0.0))
    with pytest.raises(MissingCovariateError, match=r"'temperature'.*did you mean 'temprature'"):
        stage.with_effect(still).arm.deflection(stage.rows.q[0], covariates={"temprature": 20.0})


@pytest.mark.parametrize("name", [name for name, law in EVERY.items() if isinstance(law, TwistLaw)])
def test_one_row_and_many_rows_are_alike(name, stage):
    """A law answers single rows and whole campaigns with the same numbers."""
    law = EVERY[name]
    for effect in some_effects(law, stage, 2):
        setup = stage.with_effect(effect)
        here = stage.scene.here(effect.spot, setup.arm)
        known = known_rows(setup.arm, stage.rows)
        row = replace(stage.scene.row, covariates=known)
        wrench = stage.scene.wrenches[effect.spot.site]
        whole = law.basis(here, wrench, row, effect.inner)
        assert whole.shape == (ROWS, len(law.amplitudes), 6)
        for i in range(ROWS):
            one = replace(row, q=row.q[i], covariates={key: values[i] for key, values in known.items()})
            np.testing.assert_allclose(law.basis(here, wrench[i], one, effect.inner), whole[i], rtol=1e-13)


@pytest.mark.parametrize("name", [name for name, law in EVERY.items() if isinstance(law, LoadLaw)])
def test_pulls_answer_one_pose_and_many(name, stage):
    law = EVERY[name]
    effect = some_effects(law, stage, 1)[0]
    here = stage.scene.here(effect.spot, stage.setup.arm)
    poses = stage.view.line.links[:, 3]
    whole = law.pull(here, poses, effect.inner)
    for i in range(ROWS):
        np.testing.assert_allclose(law.pull(here, poses[i], effect.inner), whole[i], rtol=1e-13)


@pytest.mark.parametrize("name", EVERY)
def test_values_have_names_and_units(name, stage):
    for effect in some_effects(EVERY[name], stage, 2):
        assert len(effect.named) == len(effect.units) and all(unit and "{" not in unit for unit in effect.units)
        assert effect.name.startswith(name) and np.isfinite(list(effect.named.values())).all()


def loaded_with_everything(stage: Stage) -> Setup:
    setup = stage.setup
    for law in CATALOGUE.values():
        effect = some_effects(law, stage, 1, 1e-4)[0]
        setup = effect.law.apply(effect, setup)
    return setup


def displacement_of(packed: bytes) -> Array:
    arm, q, payload, known = pickle.loads(packed)
    return arm.deflection(q, payload, covariates=known).displacement


def test_an_arm_with_every_effect_goes_to_another_process(stage):
    arm, rows = loaded_with_everything(stage).arm, stage.rows
    assert len(arm.effects) == len(CATALOGUE)
    known = {name: float(values[2]) for name, values in known_rows(arm, rows).items()}
    here = arm.deflection(rows.q[2], rows.payload[2], covariates=known).displacement
    packed = pickle.dumps((arm, rows.q[2], rows.payload[2], known))
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        there = pool.submit(displacement_of, packed).result()
    np.testing.assert_array_equal(here, there)
    plain = stage.setup.arm.deflection(rows.q[2], rows.payload[2]).displacement
    assert 1e-5 < np.abs(here - plain)[:3].max() < 1e-1


def test_every_law_has_a_name_of_its_own_and_is_found_by_it():
    assert all(law.name == name for name, law in EVERY.items())
    for law in EVERY.values():
        again = pickle.loads(pickle.dumps(law))
        assert again is law or again == law, law.name


@cache
def shapes_of(count: int) -> Callable[[Array, float, float], list[Array]]:
    from armflex.laws.effects.unnamed import hats

    return partial(hats, count=count)


def test_hats_are_a_partition_and_stay_at_their_ends():
    x = np.linspace(-1.0, 3.0, 101)
    tents = np.array(shapes_of(5)(x, 0.0, 2.0))
    assert tents.shape == (5, 101) and tents.min() >= 0.0 and tents.sum(axis=0).max() <= 1.0 + 1e-12
    np.testing.assert_array_equal(tents[:, x <= 0.0], np.tile(tents[:, :1], (x <= 0.0).sum()))
    assert (tents[:, x >= 2.0] == 0.0).all()
