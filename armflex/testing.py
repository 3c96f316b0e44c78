"""What must hold of an effect, a joint law, a kind of reading and an exporter, for who writes one outside armflex.

Each check puts the object into the bundled arm `heavy_six` and raises AssertionError where armflex could not rely on
it: derivatives that are not those of what they belong to, rows at once that differ from rows one by one, a file that
does not say what was written. No test framework is needed; in a test a check is one line.
"""

import json
import tomllib
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from armflex.arm import Arm, Setup
from armflex.bundled import bundled_robot
from armflex.conventions import Array
from armflex.declaration import Declaration, Source
from armflex.errors import MissingCovariateError
from armflex.estimate.block import EffectBlock, amplitude_prior
from armflex.estimate.calibrate import calibrate
from armflex.estimate.view import View, look
from armflex.export import Exported, exporter_fault
from armflex.files.arm_file import load_arm
from armflex.files.effect_file import effect_table, read_effect
from armflex.files.sensor_table import read_sensors
from armflex.laws.declared import LawModel, columns_beyond_joints
from armflex.laws.effects import CATALOGUE, Effect, EffectLaw
from armflex.laws.effects.candidate import Candidate, grid
from armflex.laws.effects.context import Context, survey
from armflex.laws.effects.effect import Act
from armflex.laws.law import Law, Row
from armflex.laws.terms import tangent_of, twist_of
from armflex.measured.measurements import Measurements
from armflex.mechanics.history import known_rows
from armflex.readings import SENSOR_KINDS, Kind, Position, Postures, Readings
from armflex.readings.instrument import Instrument
from armflex.readings.sensor import Sensor
from armflex.result import plain
from armflex.rows import Rows

ROWS, PAYLOAD, SIGMA = 24, "p200", 2e-5
"""Of the campaign in which an object is looked at: rows, what is carried, and one standard deviation [m]."""

SESSIONS = ("morning", "evening")

SIZE = np.repeat([4e3, 3e3], 3)
"""Loads under which a joint law is asked [N, Nm]."""


STEP = 1e-6
"""Of difference quotients of readings, in m, rad and the units of nuisances."""


def check_law(model: LawModel, joint: str = "J2") -> None:
    """Check a joint law, as its example declares it at a joint of `heavy_six`.

    Its derivatives are those of its twist, its terms are its twist, one row is answered as many are, no load gains
    energy, a deflection is the same alone, prepared and in a batch, and calibration finds it again where it is softer.

    Args:
        model: What an entry point of `armflex.laws` names.
        joint: At which it is; J1 to J6.

    Raises:
        AssertionError: One of these does not hold.
        ArmFileError: The example cannot be read.
    """
    heavy = _heavy()
    table = Declaration(tomllib.loads(model.example), ("flexure", joint), Source(Path("example"), model.example))
    table.has("model")
    ranges = {moving.name: (moving.lower, moving.upper) for moving in heavy.robot.moving}
    law = model.read(table, joint, ranges)
    table.finish()
    beyond = columns_beyond_joints(law, ranges)
    assert not beyond, f"its terms depend on the column {beyond[0]!r}: what depends on a recorded column is an effect"
    rng = np.random.default_rng(2)
    rows, loads = Row(_positions(heavy, 8, 1), heavy.joint_index), SIZE * rng.uniform(-1.0, 1.0, (8, 6))
    check_answers(law, loads, rows)
    assert (np.einsum("ni,ni->n", loads, law.twist(loads, rows)) >= 0.0).all(), "a load that does negative work"
    # By which the joint of a simulated arm gives more than declared
    softer = law.scaled(np.full(6, np.sqrt(1.3)))
    if softer:
        more = np.einsum("ni,ni->n", loads, softer.twist(loads, rows) - law.twist(loads, rows))
        assert more.min() >= 0.0 < more.max(), "scaled by a factor above 1 it gives more"
    arm = _with_law(heavy, joint, law)
    _check_deflections(arm, {})
    if softer:
        driven = Rows.of(arm.joint_names, _positions(arm, 60, 5), (PAYLOAD, "empty") * 30, {}, derived=("time",))
        arm = replace(arm, prior=replace(arm.prior, compliance=0.3), instrument=None)
        truth = look(Setup(_with_law(arm, joint, softer), Instrument()), driven).line.tip[:, :3, 3]
        read = truth + rng.normal(0.0, SIGMA, truth.shape)
        campaign = Measurements.of(driven, Readings(60, (Position(read, np.full(truth.shape, SIGMA)),)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            calibrated = calibrate(arm, campaign)
        left = float(np.sqrt((calibrated.fit.view.residual**2).mean()))
        assert left < 1.3 * SIGMA, f"a softer joint is not found by calibration: {left:.3g} m left of {SIGMA:g}"


def check_answers(law: Law, loads: Array, rows: Row) -> None:
    """Check what a joint law answers, for one that is a Python object and that no arm.toml declares.

    Its values are what they are set to, its derivatives those of its twist, its terms and its affine form its twist, no
    tangent is steeper than its bound, and one row is answered as many are.

    Args:
        law: It.
        loads: (N, 6) wrenches that it is asked under [N, Nm].
        rows: The N rows.

    Raises:
        AssertionError: One of these does not hold.
    """
    names = [parameter.name for parameter in law.parameters]
    assert len(names) == len(set(names)) == len(law.values), f"{names}: a name for every value, each once"
    assert not any(" " in name for name in names), f"{names}: a name has no blank"
    for values in (law.values, law.values + 0.01 * np.abs(law.values) + 1e-9):
        _close(law.at(values).values, values, 1e-12, "values of `at`, and those that it was given,")
    _check_law_derivatives(law, loads, rows)
    for ask in (law.twist, law.tangent, law.by_values, law.covariance):
        many, each = ask(loads, rows), [ask(load, rows.some(i)) for i, load in enumerate(loads)]
        if many is not None:
            _close(many, np.array(each), 1e-9, f"{ask.__name__} of many rows beside one by one")
    if law.known_terms is not None:
        _close(twist_of(law.known_terms, loads, rows), law.twist(loads, rows), 1e-9, "twist of the terms")
        _close(tangent_of(law.known_terms, loads, rows), law.tangent(loads, rows), 1e-9, "tangent of the terms")
    for form in (law.affine(rows), None if law.constant is None else (np.zeros(6), law.constant)):
        if form is not None:
            _close(form[0] + (form[1] @ loads[..., None])[..., 0], law.twist(loads, rows), 1e-9, "affine form")
    q = {name: rows.position(name) for name in rows.joint_index}
    bound = law.compliance_bound({name: (float(at.min()), float(at.max())) for name, at in q.items()})
    if bound is not None:
        blocks = law.tangent(loads, rows).reshape(-1, 2, 3, 2, 3).swapaxes(2, 3)
        steepest = np.linalg.norm(blocks, ord=2, axis=(-2, -1)).max(axis=0)
        assert (steepest <= bound * (1.0 + 1e-9)).all(), f"a tangent, {steepest}, is steeper than the bound, {bound}"


def check_effect(law: EffectLaw, columns: Mapping[str, tuple[float, float]] | None = None) -> None:
    """Check an effect at up to three of its places in `heavy_six`.

    Its columns are the changes of what is read, a deflection is the same alone, prepared and in a batch, a column that
    it depends on is asked for by name, without its columns it is at no place, and a file has it as it was written.

    Args:
        law: What an entry point of `armflex.effects` names.
        columns: Lowest and highest value of the recorded columns that it depends on, beside `time`, `hold`,
            `temperature` and the directions from which joints come.

    Raises:
        AssertionError: One of these does not hold.
        PluginError: Its terms are not a list for each amplitude.
    """
    assert law.words.title and law.words.meaning, "it has words for people"
    heavy, ranges = _heavy(), {"temperature": (15.0, 30.0), "hold": (10.0, 600.0), **(columns or {})}
    rng = np.random.default_rng(7)
    drawn = {name: rng.uniform(low, high, ROWS) for name, (low, high) in ranges.items()}
    setup, campaign = Setup(heavy, Instrument()), _campaign(heavy, drawn, SESSIONS)
    view, context = look(setup, campaign), _context(heavy, campaign)
    locations = list(law.places(context.records))
    assert locations, "it has no place in a campaign with these columns"
    idle = set(range(len(law.amplitudes))).difference(*(location.terms for location in locations))
    names = [law.amplitudes[number].name for number in sorted(idle)]
    assert not idle, f"{', '.join(names)} acts at none of its places: `terms` of a Location says which amplitudes do"
    if columns:
        bare = _campaign(heavy, {name: values for name, values in drawn.items() if name not in columns}, SESSIONS)
        places = list(law.places(_context(heavy, bare).records))
        assert not places, f"it has a place, {places[0]}, where none of {list(columns)} is recorded"
    candidates, moved = list[Candidate](), list[Array]()
    for place in rng.permutation(len(locations)):
        if (inner := next(iter(grid(law, locations[place], context)), None)) is not None:
            candidates.append(Candidate(law, locations[place], inner))
            jacobian = view.jacobian(law, locations[place], inner, context)
            moved.append(np.sqrt((jacobian**2).sum(axis=1).mean(axis=0)))
    most = max((sizes.max(initial=0.0) for sizes in moved), default=0.0)
    checked = 0
    for candidate, sizes in zip(candidates, moved, strict=True):
        if not (sizes > 1e-3 * sizes.max()).all() or sizes.max() <= 1e-6 * most:
            continue  # a load that this arm does not have, but for rounding
        # By how much an effect moves the tip where its columns are compared with it [m]
        effect = candidate.effect(1e-5 / sizes)
        if (
            law.size(
                np.einsum("mkn,k->mn", law.features(candidate.location, candidate.inner, view, context), effect.acting),
                heavy,
            )
            > 1.0
        ):
            continue  # the tip hardly sees what is on this axis
        _check_effect_at(effect, setup, campaign, view, context)
        checked += 1
        if checked == 3:
            break
    assert checked, "no place of it moves what is read"


def check_reading(kind: type[Kind], example: str) -> None:
    """Check a kind of reading, as an [instrument.NAME] table declares it on `heavy_six`.

    What it says of its changes by links, frame, target, scale, gravity and its own numbers are those of its residual.

    Args:
        kind: What an entry point of `armflex.readings` names.
        example: The keys of the table with values, as TOML, without `kind`; links are link1 to link6 and tool.

    Raises:
        AssertionError: One of these does not hold.
        ArmFileError: The example cannot be read.
    """
    heavy, name = _heavy(), "example"
    sensors = _declared(kind, name, example, heavy)
    assert kind.columns(name)[0].startswith(name), f"its columns are called after the instrument: {kind.columns(name)}"
    assert len(kind.channels) == kind.dimension, "a channel for every number"
    pose = pin.SE3(pin.exp3(np.array([0.1, -0.2, 0.7])), np.array([1.0, -3.0, 0.5]))
    instrument = Instrument(pose, {}, np.array([0.1, 0.02, -0.05]), 1e-3, np.array([0.4, -1.2, 1.0]))
    unread = kind.unread(ROWS, name=name, about=sensors[name].about)
    setup = Setup(replace(heavy, sensors=sensors), instrument)
    at = look(setup, _campaign(heavy, {}), readings=Readings(ROWS, (unread,))).at
    readings = replace(unread, values=unread.predicted(at), sigma=np.ones(unread.values.shape))

    def slope(change: Callable[[Array], Postures], size: int) -> Array:
        """Return (N, d, size) central differences of what is predicted."""
        ends = [[-readings.residual(change(side * STEP * axis)) for side in (-1.0, 1.0)] for axis in np.eye(size)]
        each = [(after - before) / (2.0 * STEP) for before, after in ends]
        return np.stack(each, axis=2) if each else np.zeros((*readings.values.shape, 0))

    def by_instrument(change: Callable[[Array], dict[str, Any]]) -> Callable[[Array], Postures]:
        return lambda x: replace(at, instrument=replace(instrument, **change(x)))

    def own(x: Array) -> Postures:
        return replace(at, sensors={name: replace(at.sensors[name], found={"": x})})

    seen, mounted = readings.jacobian(at), pin.exp3(instrument.mounting)
    cases = {
        "by_frame": (readings.by_frame(at), by_instrument(lambda x: {"sessions": {"s": x}}), 6),
        "by_target": (readings.by_target(at), by_instrument(lambda x: {"target": instrument.target + x}), 3),
        "by_mounting": (
            readings.by_mounting(at),
            by_instrument(lambda x: {"mounting": pin.log3(pin.exp3(x) @ mounted)}),
            3,
        ),
        "by_scale": (readings.by_scale(at)[:, :, None], by_instrument(lambda x: {"scale": instrument.scale + x[0]}), 1),
        "by_gravity": (readings.by_gravity(at), lambda x: replace(at, gravity=at.gravity + x), 3),
        "by_own": (readings.by_own(at), own, len(sensors[name].declared)),
    }
    if kind.by_motion:
        none = np.zeros((*readings.values.shape, 6))
        links = {None, sensors[name].link, sensors[name].seen_from, *seen}
        cases |= {f"jacobian by {link or 'the tip'}": (seen.get(link, none), _by_link(at, link), 6) for link in links}
    rounding = max(1.0, 1e-2 * float(np.abs(readings.values).max()))
    for what, (stated, change, size) in cases.items():
        scale, quotient = np.abs(stated).max(initial=rounding), slope(change, size)
        message = f"{what} of the kind (first) is not the change of what it reads (second)"
        np.testing.assert_allclose(stated, quotient, rtol=0, atol=1e-7 * scale, err_msg=message)


def _by_link(at: Postures, link: str | None) -> Callable[[Array], Postures]:
    """Return where an arm is seen with a link moved by a twist about its own origin, in the base's axes."""

    def moved(x: Array) -> Postures:
        poses = at.pose(link).copy()
        poses[:, :3, 3] += x[:3]
        poses[:, :3, :3] = pin.exp3(x[3:]) @ poses[:, :3, :3]
        return replace(at, pose=lambda asked: poses if asked == link else at.pose(asked))

    return moved


def _declared(kind: type[Kind], name: str, example: str, arm: Arm) -> dict[str, Sensor]:
    word = next((word for word, declared in SENSOR_KINDS.items() if declared is kind), name)
    text = f'kind = "{word}"\n{example}'
    table = Declaration(tomllib.loads(text), ("instrument", name), Source(Path("example"), text))
    with SENSOR_KINDS.entered(word, kind):
        return read_sensors({name: table}, arm.robot)


def check_exporter(export: Callable[..., Exported], **options: Any) -> None:
    """Check an exporter with `heavy_six`: it writes the same text twice, and numbers that a JSON file can hold.

    Args:
        export: What an entry point of `armflex.exporters` names: (arm, **options) -> Exported.
        options: Given to it.

    Raises:
        AssertionError: One of these does not hold.
    """
    assert not (fault := exporter_fault(export)), fault
    arm = _heavy()
    exported = export(arm, **options)
    assert isinstance(exported, Exported) and exported.text, "it returns an Exported with a text"
    assert export(arm, **options).text == exported.text, "the same arm gives the same text"
    json.dumps(plain(dict(exported.numbers)), allow_nan=False)
    assert all("\n" not in note for note in exported.notes), "a note is one line"


def _heavy() -> Arm:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return load_arm(bundled_robot("heavy_six") / "arm.toml")


def _positions(arm: Arm, count: int, seed: int) -> Array:
    """Return (count, n) positions about the arm's middle one [rad], far enough apart for every sign of a load."""
    return np.random.default_rng(seed).uniform(-0.8, 0.8, (count, len(arm.joint_names)))


def _with_law(arm: Arm, joint: str, law: Law) -> Arm:
    flexures = [replace(flexure, law=law) if flexure.joint == joint else flexure for flexure in arm.flexures]
    return replace(arm, flexures=tuple(flexures))


def _campaign(arm: Arm, columns: Mapping[str, Array], sessions: Sequence[str] = ("s",)) -> Measurements:
    """Return rows under two payloads with columns, a time, and positions still to be read, half of them a session."""
    q, rng = _positions(arm, ROWS, 3), np.random.default_rng(11)
    approach = rng.choice([-1.0, 1.0], q.shape)
    payloads, columns = (PAYLOAD, "p100") * (ROWS // 2), {"time": 300.0 * np.arange(ROWS), **columns}
    rows = Rows.of(arm.joint_names, q, payloads, columns)
    session = tuple(sessions[len(sessions) * i // ROWS] for i in range(ROWS))
    rows = replace(rows, approach=approach, session=session)
    return Measurements.of(rows, Readings(ROWS, (Position.unread(ROWS, SIGMA),)))


def _context(arm: Arm, campaign: Measurements) -> Context:
    line = look(Setup(arm, Instrument()), campaign).line
    wrenches = {site: line.load_at(site) for site in line.sites}
    return survey(campaign, arm, known_rows(arm, campaign), wrenches, line.links[:, :, :3, 3])


def _predicted(setup: Setup, campaign: Measurements) -> Array:
    """Return (N, 3) what is read of the tip, one row after the other."""
    view = look(setup, campaign)
    return view.readings.kinds[0].predicted(view.at)


def _check_effect_at(effect: Effect, setup: Setup, campaign: Measurements, view: View, context: Context) -> None:
    where = effect.name
    moved = _predicted(setup.with_effect(effect), campaign) - _predicted(setup, campaign)
    expected = view.effect_jacobian(effect, context) @ effect.acting
    # What is left goes by the square: some um of a metre's lever per 10 um of motion.
    np.testing.assert_allclose(moved, expected, rtol=0, atol=0.03 * np.abs(expected).max(), err_msg=f"{where}: columns")
    smooth = tuple(
        i for i in Candidate(effect.law, effect.location, effect.inner).searched if effect.law.inner[i].smooth
    )
    block = EffectBlock(effect, smooth, context, 0, amplitude_prior(effect, smooth, view, context))
    by_values = block.jacobian(look(block.apply(setup, block.start), campaign))
    for place, start in enumerate(block.start):
        step = np.zeros(len(block.start))
        step[place] = 1e-3 * abs(start) if start else 1e-6
        ends = [_predicted(block.apply(setup, block.start + side * step), campaign) for side in (1.0, -1.0)]
        quotient = (ends[0] - ends[1]) / (2.0 * step[place])
        scale = np.abs(quotient).max() + 1e-12 / step[place]
        message = f"{where}: change by {block.labels[place]}"
        np.testing.assert_allclose(by_values[:, :, place], quotient, rtol=0, atol=2e-2 * scale, err_msg=message)
    arm = setup.with_effect(effect).arm
    columns = {name: float(np.asarray(values)[0]) for name, values in known_rows(arm, campaign).items()}
    if effect.law.act is Act.TWIST:
        _check_deflections(arm, columns)
        implied = {f"q_{joint}" for joint in arm.joint_names} | {"payload_mass", "hold", "time"}
        for name in set(effect.location.covariates) - implied:
            given = {other: value for other, value in columns.items() if other != name}
            try:
                arm.deflection(campaign.q[0], PAYLOAD, covariates=given)
            except MissingCovariateError as error:
                assert error.name == name, f"{where}: {error.name!r} is asked for where {name!r} is missing"
            else:
                raise AssertionError(f"{where} is answered without {name!r}")
    written = plain(effect_table(effect))
    with CATALOGUE.entered(effect.law.name, effect.law):
        read = read_effect(Declaration(written, ("effect", 0), Source(Path("effect"), "")), setup.arm)
    assert (read.law, read.location) == (effect.law, effect.location), f"{where}: a file has {read.location}"
    np.testing.assert_allclose(read.values, effect.values, rtol=1e-12, err_msg=f"{where}: a file's values")


def _check_law_derivatives(law: Law, loads: Array, rows: Row) -> None:
    size = np.abs(loads).max(axis=0)
    for i, load in enumerate(loads[:3]):
        row = rows.some(i)
        quotients = np.empty((6, 6))
        for axis, step in enumerate(1e-4 * size):
            ends = [law.twist(load + side * step * np.eye(6)[axis], row) for side in (1.0, -1.0)]
            quotients[:, axis] = (ends[0] - ends[1]) / (2.0 * step)
        _close(law.tangent(load, row) * size, quotients * size, 1e-5, "tangent")
        by_values = law.by_values(load, row)
        assert by_values.shape == (6, len(law.values)), f"by_values is {by_values.shape}"
        for place, value in enumerate(law.values):
            step = np.zeros(len(law.values))
            step[place] = 1e-4 * max(abs(value), law.parameters[place].prior, 1e-12)
            ends = [law.at(law.values + side * step).twist(load, row) for side in (1.0, -1.0)]
            change = 2.0 * step[place] * by_values[:, place]
            rounding = 1e-4 * np.abs(change).max() + 1e-14 * np.abs(ends).max()
            message = f"by_values of {law.parameters[place].name}"
            np.testing.assert_allclose(change, ends[0] - ends[1], rtol=1e-4, atol=rounding, err_msg=message)


def _check_deflections(arm: Arm, covariates: Mapping[str, float]) -> None:
    """Compare a deflection alone with that of a prepared arm and of a batch."""
    q = _positions(arm, 4, 4)
    prepared = arm.prepared(PAYLOAD)
    batch = arm.deflection(q, PAYLOAD, covariates=covariates)
    for i, position in enumerate(q):
        alone = arm.deflection(position, PAYLOAD, covariates=covariates).displacement
        np.testing.assert_allclose(prepared(position, **covariates), alone, rtol=0, atol=1e-10, err_msg="prepared")
        np.testing.assert_allclose(batch.displacement[i], alone, rtol=0, atol=1e-10, err_msg="batch")


def _close(actual: Array, expected: Array, relative: float, what: str) -> None:
    scale = np.abs(expected).max(initial=0.0)
    np.testing.assert_allclose(actual, expected, rtol=relative, atol=relative * scale, err_msg=what)
