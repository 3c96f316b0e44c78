"""A short campaign of one arm, looked at, and effects of every law at work in it."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from armflex import Arm, load_arm, read_measurements
from armflex.arm import Setup
from armflex.conventions import TWIST_NAMES, Array
from armflex.estimate.view import View, look
from armflex.laws import Row
from armflex.laws.effects import Effect, EffectLaw, Location
from armflex.laws.effects.candidate import Candidate, grid
from armflex.laws.effects.context import Context, survey
from armflex.laws.effects.effect import Act
from armflex.laws.effects.guide import GUIDE, GUIDES
from armflex.laws.effects.in_arm import bending
from armflex.laws.effects.pin_play import PIN_PLAY
from armflex.laws.effects.support_lift import SUPPORT_LIFT
from armflex.laws.effects.telescope_bending import TELESCOPE_BENDING
from armflex.laws.effects.unnamed import PRODUCT, WAVE_PRODUCT
from armflex.measured.measurements import Measurements
from armflex.mechanics.history import known_rows
from armflex.mechanics.response import respond
from armflex.readings import Position, Postures
from armflex.readings.instrument import Instrument
from support.campaigns import draw
from support.effect_arms import MECHANICAL, MOST_TERMS
from support.machines import LIFTED

ROWS = 14
SHIFT = 1e-3
"""m at the target: the size at which columns are checked."""

LARGEST = {("payload_com", "m"): 0.5, ("link_mass", "m"): 0.5, ("link_mass", "kg"): 50.0, ("gravity_tilt", "rad"): 0.02}
"""Amplitudes beyond which a body or gravity is no longer nearly what was declared."""


TURN = 0.05
"""rad: half of what a flexure may turn by; axes that hardly move the target would turn by more."""


IN_LOOP = 10.0
"""Times the target's shift by which a place moves or turns [m, rad] at most: a rod that turns jams first."""


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


def mechanism(folder: Path) -> tuple[Arm, Measurements]:
    """Return a machine with a loop, a cylinder and a spring, and a campaign of it that read nothing of interest."""
    LIFTED.load(folder)
    path, rng = folder / "arm.toml", np.random.default_rng(4)
    loads = "".join(
        f"[payload.{name}]\nmass = {mass}\ncom = [0.1, 0, 0]\n" for name, mass in (("half", 80), ("full", 160))
    )
    gives = 'kind = "spherical"\ncompliance = [2e-8, 1e-6, 2e-8, 0, 0, 0]\n'  # else frames out of true would jam it
    path.write_text(path.read_text().replace('kind = "revolute"\naxis = [0.0, 1.0, 0.0]\n', gives) + loads)
    arm = load_arm(path)
    q = np.array([0.0, 0.0, 0.95]) + np.array([0.9, 0.4, 0.1]) * rng.uniform(-1.0, 1.0, (ROWS, 3))
    columns = {f"q_{joint}": q[:, i] for i, joint in enumerate(arm.joint_names)}
    columns |= {f"approach_{joint}": rng.choice([-1, 1], ROWS) for joint in arm.joint_names}
    columns |= {"time": 300.0 * np.arange(ROWS), "hold": rng.uniform(10.0, 600.0, ROWS), "sigma": np.full(ROWS, 1e-4)}
    columns |= {"temperature": 20.0 + rng.uniform(-5.0, 9.0, ROWS)} | dict(zip("xyz", np.ones((3, ROWS)), strict=True))
    texts = {"pose": [f"p{i}" for i in range(ROWS)], "session": [f"s{i // 7}" for i in range(ROWS)]}
    texts |= {"payload": ["none", "half", "full", "full", "half"] * 2 + ["full", "none", "half", "full"]}
    table = {**texts, **{name: [repr(one) for one in values.tolist()] for name, values in columns.items()}}
    lines = [",".join(table), *(",".join(row) for row in zip(*table.values(), strict=True))]
    (folder / "rows.csv").write_text("\n".join(lines))
    return arm, read_measurements(folder / "rows.csv", arm)


@pytest.fixture(scope="module", params=["boom", pytest.param("mechanism", marks=pytest.mark.slow)])
def stage(request, tmp_path_factory) -> Stage:
    if request.param == "mechanism":
        arm, rows = mechanism(tmp_path_factory.mktemp("campaign"))
    else:
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
    looped = bool(stage.context.robot.linkage)
    count = 1 if looped else count  # rows of a mechanism take ten times as long
    locations = [location for location in everywhere(law, stage.context) if is_loaded(law, location, stage)]
    for index in rng.permutation(len(locations)):
        inner = list(grid(law, locations[index], stage.context))
        if not inner:  # so few rows tell no wave there from its aliases
            continue
        few = replace(locations[index], terms=locations[index].terms[:MOST_TERMS])
        candidate = Candidate(law, few, inner[rng.integers(len(inner))])
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
            moved = np.abs(values @ done)
            if looped and moved.max() > IN_LOOP * shift:
                continue
            scale = min(scale, TURN / max(moved[:, 3:].max(), TURN))
        if (seen.all() or law.shape) and sizes.max() > 0.0 and scale > 0.01:
            found.append(candidate.effect(values * scale))
        if len(found) == count:
            return found
    slides = any(joint.kind == "prismatic" for joint in stage.context.robot.jointed)
    if (law in (GUIDE, GUIDES, TELESCOPE_BENDING) and not slides) or (
        law.name in MECHANICAL and not stage.context.robot.linkage
    ):
        assert not locations
        pytest.skip("nothing slides, or no loop is closed")
    assert found, law.name
    return found


def is_loaded(law: EffectLaw, location: Location, stage: Stage) -> bool:
    """Return whether there is a load worth the name on every axis that a law of the load needs."""
    if not law.of_load(location):
        return True
    suffixes = [law.amplitudes[i].name.rpartition("_")[2] for i in location.terms]
    if law in (TELESCOPE_BENDING, PIN_PLAY, SUPPORT_LIFT):
        return True  # whatever axis a beam or a pin is loaded on; a stop at an angle bears any load
    named = {location.axis, location.partner, *suffixes} & set(TWIST_NAMES)
    wanted = [TWIST_NAMES.index(axis) for axis in named or ("rx", "ry", "rz")]
    sizes = np.sqrt((stage.context.wrenches[location.site] ** 2).mean(axis=0))
    share = sizes / np.maximum(np.repeat([sizes[:3].max(), sizes[3:].max()], 3), 1e-300)
    # Across the plane of a loop hardly anything is loaded: what gives there would have to be soft enough to buckle.
    return bool((share[wanted] > (0.5 if stage.context.robot.linkage else 0.1)).all())


def readings(setup: Setup, rows: Measurements) -> Array:
    """Return what the instrument reads, row by row through `Arm.deflection`."""
    known = known_rows(setup.arm, rows)
    tips = [
        setup.arm.deflection(q, payload, covariates={name: values[i] for name, values in known.items()}).pose
        for i, (q, payload) in enumerate(zip(rows.q, rows.payload, strict=True))
    ]
    row = Row(rows.q, {name: i for i, name in enumerate(rows.joint_names)}, known)
    poses, bend = np.array([tip.homogeneous for tip in tips]), bending(setup.arm.effects, row, len(tips))
    gravity = setup.arm.robot.gravity
    at = Postures(lambda _: poses, rows.session, setup.instrument, gravity=gravity, bend=bend)
    return Position.unread(len(tips)).predicted(at)
