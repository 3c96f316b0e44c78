"""A short campaign of one arm, looked at, and effects of every law at work in it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest

from armflex import load_arm, read_measurements
from armflex.arm import Setup
from armflex.conventions import TWIST_NAMES, Array
from armflex.estimate.view import View, look
from armflex.laws.effects import Effect, EffectLaw, Location
from armflex.laws.effects.context import Context, survey
from armflex.laws.effects.effect import Act
from armflex.laws.effects.guide import GUIDE
from armflex.laws.effects.telescope import TELESCOPE
from armflex.laws.effects.unnamed import PRODUCT, WAVE_PRODUCT
from armflex.measured.measurements import Measurements
from armflex.mechanics.history import known_rows
from armflex.mechanics.response import respond
from armflex.readings.instrument import Instrument
from armflex.trace.candidates import Candidate, grid
from support.campaigns import draw

ROWS = 14
SHIFT = 1e-3
"""m at the target: the size at which columns are checked."""

LARGEST = {("payload_com", "m"): 0.5, ("link_mass", "m"): 0.5, ("link_mass", "kg"): 50.0, ("gravity_tilt", "rad"): 0.02}
"""Amplitudes beyond which a body or gravity is no longer nearly what was declared."""


TURN = 0.05
"""rad: half of what a flexure may turn by; axes that hardly move the target would turn by more."""


@dataclass(frozen=True)
class Stage:
    """A short campaign of one arm, looked at."""

    setup: Setup
    rows: Measurements
    view: View
    context: Context

    def with_effect(self, effect: Effect) -> Setup:
        return self.setup.with_effect(effect)


def few(rows: Measurements, chosen: np.ndarray) -> Measurements:
    """Return a campaign of some rows, all of them measured."""
    names = ("pose", "session", "payload", "places")
    arrays = ("time", "q", "approach", "position", "sigma", "hold")
    changes = {name: tuple(getattr(rows, name)[i] for i in chosen) for name in names}
    changes |= {name: getattr(rows, name)[chosen] for name in arrays}
    covariates = {name: values[chosen] for name, values in rows.covariates.items()}
    return replace(rows, **changes, covariates=covariates, measured=np.ones(len(chosen), bool))


@pytest.fixture(scope="module", params=["boom", pytest.param("six", marks=pytest.mark.slow)])
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


def everywhere(law: EffectLaw, context: Context) -> list[Location]:
    if law in (PRODUCT, WAVE_PRODUCT):
        joint = context.joints[1]
        return [Location(joint, "ry", (f"q_{joint}", "temperature"), tuple(range(len(law.amplitudes))))]
    return list(law.places(context.records))


def some_effects(law: EffectLaw, stage: Stage, count: int, shift: float = SHIFT) -> list[Effect]:
    """Return the law at places drawn at random with values that move the target by about `shift` each."""
    rng, found = np.random.default_rng(3), []
    locations = [location for location in everywhere(law, stage.context) if is_loaded(law, location, stage)]
    for index in rng.permutation(len(locations)):
        inner = list(grid(law, locations[index], stage.context))
        if not inner:  # so few rows tell no wave there from its aliases
            continue
        candidate = Candidate(law, locations[index], inner[rng.integers(len(inner))])
        columns = stage.view.jacobian(law, candidate.location, candidate.inner, stage.context)
        sizes = np.sqrt((columns**2).sum(axis=1).mean(axis=0))
        acting = [law.amplitudes[i] for i in candidate.location.terms]
        signs = [1.0 if one.positive or one.unit == "kg" else rng.choice((-1.0, 1.0)) for one in acting]
        largest = np.array([LARGEST.get((law.name, one.unit), 1e9) for one in acting])
        seen = sizes > 1e-3 * sizes.max()
        values = np.where(seen, shift * np.array(signs) / np.where(seen, sizes, 1.0), 0.0)
        scale = np.min(largest / np.maximum(np.abs(values), largest))
        if law.act is Act.TWIST:
            done = law.features(candidate.location, candidate.inner, stage.view, stage.context)
            scale = min(scale, TURN / max(np.abs(values @ done)[:, 3:].max(), TURN))
        if (seen.all() or law.shape) and sizes.max() > 0.0 and scale > 0.01:
            found.append(candidate.effect(values * scale))
        if len(found) == count:
            return found
    if law in (GUIDE, TELESCOPE) and not any(joint.kind == "prismatic" for joint in stage.context.robot.moving):
        assert not locations
        pytest.skip("nothing slides")
    assert found, law.name
    return found


def is_loaded(law: EffectLaw, location: Location, stage: Stage) -> bool:
    """Return whether there is a load worth the name on every axis that a law of the load needs."""
    if not law.of_load(location):
        return True
    suffixes = [law.amplitudes[i].name.rpartition("_")[2] for i in location.terms]
    if law is TELESCOPE:
        return True  # as a beam bends, whatever it is loaded about
    named = {location.axis, location.partner, *suffixes} & set(TWIST_NAMES)
    wanted = [TWIST_NAMES.index(axis) for axis in named or ("rx", "ry", "rz")]
    sizes = np.sqrt((stage.context.wrenches[location.site] ** 2).mean(axis=0))
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
