"""Blocks of parameters that a fit may move: what [prior] frees of the instrument, the joints, the frames and the laws.

What was learned of laws, and an effect that was added, have blocks of their own; see `estimate.block`.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from armflex.arm import Prior, Setup
from armflex.conventions import RESOLUTION, TWIST_NAMES, Array
from armflex.errors import UnsupportedError
from armflex.estimate.block import Block, EffectBlock, LawBlock, factor_block, learned_laws, parameters_of
from armflex.estimate.view import View
from armflex.laws.effects.context import Context
from armflex.laws.law import anywhere
from armflex.measured.measurements import Measurements
from armflex.mechanics.loaded import Payload
from armflex.mechanics.pinocchio_model import LoadCase
from armflex.parameters import (
    CARRIED,
    FRAME,
    MOUNTED,
    TARGET,
    ArmParameter,
    ParameterKind,
    numbers_of,
    of_effect,
    of_masses,
    of_motions,
    of_offsets,
    of_sensor,
    of_springs,
    of_targets,
)
from armflex.readings import Kind, Orientation, Position, Sensor, Touch, TouchingSensor
from armflex.readings.end import skew
from armflex.readings.instrument import frame_of, motion_of, remounted, twist_per_value


@dataclass(frozen=True, eq=False)
class RigidBlock(Block):
    """Parameters of the instrument or of the kinematics.

    Attributes:
        parameters: What they are.
        prior: (k,) standard deviations about zero.
        changes: The (M, d, k) changes of a view's readings.
        moved: The setup with (k,) values added to it.
        logarithmic: Whether they are logarithms of factors.
    """

    parameters: tuple[ArmParameter, ...]
    prior: Array
    changes: Callable[[View], Array]
    moved: Callable[[Setup, Array], Setup]
    logarithmic: bool = False  # pyright: ignore[reportIncompatibleVariableOverride] - an attribute here

    def columns(self, view: View) -> Array:
        return self.changes(view)

    def apply(self, setup: Setup, values: Array) -> Setup:
        return self.moved(setup, values)


def frame_block(setup: Setup) -> Block:
    """Return the block of the instrument's pose about a first guess: shift and rotation vector in its axes, free.

    The gravity of an arm that is measured by a level instrument turns with that.
    """
    guess, level = setup.instrument.pose, setup.arm.measurement.gravity_in == "measurement"

    def changes(view: View) -> Array:
        jacobian = view.by_frame
        if level:  # base gravity R^T g when R becomes exp(w) R
            jacobian[:, :, 3:] += _by_fall(view) @ view.setup.instrument.pose.rotation.T
        return jacobian

    def moved(setup: Setup, values: Array) -> Setup:
        return setup.placed(frame_of(values) * guess)

    return RigidBlock(FRAME, np.full(6, np.inf), changes, moved)


def _by_fall(view: View) -> Array:
    """Return (M, d, 3) changes of the readings per rotation vector by which the base turns back under gravity."""
    return view.by_gravity @ skew(view.gravity(view.arm.robot.gravity[None])[:, 0])


def session_block(setup: Setup, sessions: tuple[str, ...], translation: float = 0.0, rotation: float = 0.0) -> Block:
    """Return the block of an instrument that was set up again: a shift and turn of it for every session.

    Sessions in which it stood elsewhere have a first guess, about which nothing is known; see `placed_rigidly`. So have
    campaigns, whose frames are among those of sessions: the gravity of a level instrument turns with them.
    """
    guess, level = setup.instrument.sessions, setup.arm.measurement.gravity_in == "measurement"
    names = (*setup.instrument.campaigns, *sessions)
    first = replace(setup.instrument, sessions={name: guess[name] for name in names if name in guess})

    def changes(view: View) -> Array:
        now, by_session = view.setup.instrument, view.by_session
        columns = np.zeros((*view.residual.shape, 6 * len(sessions)))
        for i, name in enumerate(sessions):
            twists = twist_per_value(motion_of(now.frame(name) * first.frame(name).inverse()))
            column = by_session
            if name in now.campaigns:  # what its sessions add comes after it
                after = {
                    session: np.eye(6) if session == name else now.frame(session).action
                    for session in set(view.sessions)
                }
                column = by_session @ np.array([after[session] for session in view.sessions])
                if level:
                    turned = (now.frame(name).rotation @ now.pose.rotation).T
                    column[:, :, 3:] += _by_fall(view) @ turned
            read = now.reads_in(name, view.sessions)
            columns[read, :, 6 * i : 6 * i + 6] = column[read] @ twists
        return columns

    def moved(setup: Setup, values: Array) -> Setup:
        instrument = replace(setup.instrument, sessions=first.sessions)
        for name, motion in zip(sessions, values.reshape(-1, 6), strict=True):
            instrument = instrument.with_session(name, motion)
        return replace(setup, instrument=instrument)

    about = np.repeat([translation, rotation], 3)
    std = np.concatenate([np.full(6, np.inf) if name in guess else about for name in sessions])
    return RigidBlock(of_motions(ParameterKind.SESSION, sessions), std, changes, moved)


def target_block(std: float = 0.0) -> Block:
    """Return the block of the measured point in the tip frame."""

    def moved(setup: Setup, values: Array) -> Setup:
        return replace(setup, instrument=replace(setup.instrument, target=setup.instrument.target + values))

    return RigidBlock(TARGET, np.full(3, std), lambda view: view.by_target, moved)


def remounted_block(setup: Setup, sessions: tuple[str, ...], std: float = 0.0, turned: bool = False) -> Block:
    """Return the block of a target that was mounted anew in every session: a shift of it, and a turn, in tip axes.

    How it is turned is free where orientations are read, about a first guess.
    """
    guess, size = setup.instrument.targets, 6 if turned else 3

    def changes(view: View) -> Array:
        parts = [view.by_target, *([view.by_mounting] if turned else [])]
        whole, instrument = np.concatenate(parts, axis=2), view.setup.instrument
        read = [instrument.reads_in(name, view.sessions) for name in sessions]
        return np.concatenate([whole * rows[:, None, None] for rows in read], axis=2)

    def moved(setup: Setup, values: Array) -> Setup:
        targets = dict(setup.instrument.targets)
        for name, step in zip(sessions, values.reshape(-1, size), strict=True):
            targets[name] = remounted(guess.get(name, np.zeros(6)), np.append(step, np.zeros(6 - size)))
        return replace(setup, instrument=replace(setup.instrument, targets=targets))

    about = np.repeat([std, np.inf], 3)[:size]
    return RigidBlock(of_targets(sessions, size), np.tile(about, len(sessions)), changes, moved)


def mounting_block(setup: Setup) -> Block:
    """Return the block of how the target is turned on the tool about a first guess, in tip axes.

    It is free where orientations are read: nobody mounts a target to a milliradian.
    """
    guess = pin.exp3(setup.instrument.mounting)

    def moved(setup: Setup, values: Array) -> Setup:
        return replace(setup, instrument=replace(setup.instrument, mounting=pin.log3(pin.exp3(values) @ guess)))

    return RigidBlock(MOUNTED, np.full(3, np.inf), lambda view: view.by_mounting, moved)


def sensor_block(setup: Setup, name: str, sessions: tuple[str, ...]) -> Block:
    """Return the block of what is open of a sensor itself, anew in every session; the one session '' is all of them.

    Of a touching instrument `sessions` are sockets, and '' the point that touches; see `sensor_keys`.
    """
    sensor = setup.arm.sensors[name]

    def changes(view: View) -> Array:
        return np.concatenate([view.by_sensor(name, key)[:, :, sensor.free_in(key)] for key in sessions], axis=2)

    def moved(setup: Setup, values: Array) -> Setup:
        after = setup.arm.sensors[name]
        for session in sessions:
            count = len(sensor.free_in(session))
            after, values = after.moved(session, values[:count]), values[count:]
        return replace(setup, arm=replace(setup.arm, sensors={**setup.arm.sensors, name: after}))

    # A session that is new begins as declared.
    std = np.concatenate([sensor.std_in(key)[sensor.free_in(key)] for key in sessions])
    return RigidBlock(of_sensor(sensor, sessions), std, changes, moved)


def sensor_keys(sensor: Sensor, sessions: Sequence[str], kinds: Sequence[Kind]) -> tuple[str, ...]:
    """Return what of a sensor a campaign has to find apart: its sessions, or the sockets that were touched."""
    texts = (text for kind in kinds if kind.name == sensor.name for text in kind.texts or ())
    return sensor.keys(sessions, list(texts))


def sensor_start(view: View) -> dict[ArmParameter, float]:
    """Return where a fit of what is open of the sensors may begin."""
    begun_at: dict[ArmParameter, float] = {}
    for kind in (kind for kind in view.readings.kinds if kind.name):
        sensor = view.arm.sensors[kind.name]
        for key in sensor_keys(sensor, view.sessions, view.readings.kinds):
            begun = kind.begun(view.at, key)
            if begun is not None:
                begun_at |= dict(zip(of_sensor(sensor, [key]), begun[sensor.free_in(key)].tolist(), strict=True))
    return begun_at


def offset_block(setup: Setup, std: float = 0.0) -> Block:
    """Return the block of a constant error of every joint's position; loads redistribute with it."""
    joints = setup.arm.joint_names

    def moved(setup: Setup, values: Array) -> Setup:
        return _corrected(setup, "joint_offset", dict(zip(joints, values.tolist(), strict=True)))

    std_of_each = np.full(len(joints), std)
    return RigidBlock(
        of_offsets(setup.arm.robot), std_of_each, lambda view: view.answer(lambda line: line.joints), moved
    )


def geometry_block(setup: Setup, std: float = 0.0) -> Block:
    """Return the block of a constant twist of every joint's origin frame, in its own axes, and of pins on links."""
    joints = setup.arm.robot.frames

    def changes(view: View) -> Array:
        return np.concatenate([view.answer(lambda line, at=f"link:{joint}": line.site(at)) for joint in joints], axis=2)

    def moved(setup: Setup, values: Array) -> Setup:
        return _corrected(setup, "geometry", dict(zip(joints, values.reshape(-1, 6), strict=True)))

    return RigidBlock(of_motions(ParameterKind.GEOMETRY, joints), np.full(6 * len(joints), std), changes, moved)


def _check_held(setup: Setup, q: Array) -> None:
    """Raise `UnsupportedError` where a loop is held in a way that nothing gives: a frame out of true would jam it."""
    loaded = setup.arm.loaded(None)
    if not setup.arm.robot.linkage:
        return
    idle = loaded.mechanics.idle(LoadCase(q), loaded.row(q, {}))
    if idle.shape[1]:
        name, _ = loaded.mechanics.tied.apart(int(np.abs(idle).max(axis=1).argmax()))
        text = f"loop {name!r} is held across its plane, where no flexure, pin or joint gives"
        jammed = "frames out of true by what [prior] geometry allows would jam it"
        remedy = f'give {name!r} a compliance or kind = "spherical", or its joints flexures that give about all axes'
        raise UnsupportedError(f"{text}: {jammed}; {remedy}")


def mass_block(names: tuple[str, ...], std: ArrayLike = 0.0) -> Block:
    """Return the block of logarithmic factors on masses and moments of inertia, with their standard deviations; see
    `Arm.masses`.
    """

    def changes(view: View) -> Array:
        """Return the columns of what weighs: a frequency's are difference quotients, as inertia counts there."""
        arm, columns = view.arm, []
        gravity, loads = arm.robot.gravity, np.array([view.driven.payload[row] for row in view.rows])
        for name in names:
            carried = name.startswith(CARRIED)
            body = arm.payloads[name.removeprefix(CARRIED)] if carried else arm.robot.urdf.links[name].inertial
            assert body is not None
            link, centre = (arm.robot.tip, body.com) if isinstance(body, Payload) else (name, body.origin)
            share = body.mass * (loads == name.removeprefix(CARRIED) if carried else np.ones(len(loads)))
            lever = view.pose_of(link)[:, :3, :3] @ centre
            weight = np.hstack([np.broadcast_to(gravity, lever.shape), np.cross(lever, gravity)])
            columns.append(view.to_load(link) @ (share[:, None] * weight)[:, :, None])
        return np.concatenate(columns, axis=2)

    def moved(setup: Setup, values: Array) -> Setup:
        return replace(setup, arm=setup.arm.with_masses(dict(zip(names, values.tolist(), strict=True))))

    return RigidBlock(of_masses(names), np.broadcast_to(std, len(names)), changes, moved, logarithmic=True)


def spring_block(setup: Setup, free: Sequence[ArmParameter], std: ArrayLike = 0.0) -> Block:
    """Return the block of what is free of springs, with their standard deviations; see `mechanics.spring`."""
    every = of_springs(setup.arm.springs)
    places = [every.index(parameter) for parameter in free]

    def changes(view: View) -> Array:
        columns = [
            view.to_tension(spring) * spring.law.by_found(view.length_of(spring)).T[:, None]
            for spring in view.arm.springs
        ]
        return np.concatenate(columns, axis=2)[:, :, places]

    def moved(setup: Setup, values: Array) -> Setup:
        steps, after = np.zeros(len(every)), []
        steps[places] = values
        for spring in setup.arm.springs:
            part, steps = np.split(steps, [len(spring.law.parameters)])
            after.append(spring.moved(part))
        return replace(setup, arm=replace(setup.arm, springs=tuple(after)))

    return RigidBlock(tuple(free), np.broadcast_to(std, len(places)), changes, moved)


def _corrected(setup: Setup, part: str, steps: dict[str, Any]) -> Setup:
    """Return the setup with steps by joint added to a part of the arm's corrections."""
    corrections = setup.arm.corrections
    before = getattr(corrections, part)
    after = {joint: before.get(joint, 0.0) + step for joint, step in steps.items()}
    return replace(setup, arm=replace(setup.arm, corrections=replace(corrections, **{part: after})))


def declared_blocks(setup: Setup, measurements: Measurements) -> tuple[Block, ...]:
    """Return the blocks that an arm's [prior] and [measurement] free; `setup` holds the first guess."""
    arm, prior = setup.arm, setup.arm.prior
    blocks: list[Block] = []
    tracked = any(kind.framed for kind in measurements.readings.kinds)
    if arm.measurement.frame == "unknown" and tracked:
        blocks.append(frame_block(setup))
    sessions, foreseen = tuple(dict.fromkeys(measurements.session)), prior.session_translation or prior.session_rotation
    campaigns = setup.instrument.campaigns
    seen = [np.any(np.isfinite(kind.sigma), axis=1) for kind in measurements.readings.kinds if kind.framed]
    later = [name for name in campaigns if any(read[measurements.pieces[name]].any() for read in seen)][1:]
    open_ = [name for name in sessions if name not in campaigns and (foreseen or name in setup.instrument.sessions)]
    open_ = (*(later if arm.measurement.frame == "unknown" else ()), *open_)
    if len(sessions) > 1 and tracked and open_:
        blocks.append(session_block(setup, open_, prior.session_translation, prior.session_rotation))
    blocks += _of_target(setup, measurements, sessions, later)
    for name in dict.fromkeys(kind.name for kind in measurements.readings.kinds if kind.name):
        if keys := sensor_keys(arm.sensors[name], sessions, measurements.readings.kinds):
            blocks.append(sensor_block(setup, name, keys))
    if prior.joint_offset:
        blocks.append(offset_block(setup, prior.joint_offset))
    if prior.geometry:
        _check_held(setup, measurements.q[0])
        blocks.append(geometry_block(setup, prior.geometry))
    carried = {CARRIED + name for name in measurements.payload}
    stds = {name: prior.payload_mass if name.startswith(CARRIED) else prior.mass for name in arm.weighing}
    stds = {name: std for name, std in stds.items() if std and (name in carried or not name.startswith(CARRIED))}
    if stds:
        blocks.append(mass_block(tuple(stds), np.array(list(stds.values()))))
    springs = {parameter: prior.of(parameter)[1] for parameter in of_springs(arm.springs)}
    if any(springs.values()):
        freed = [parameter for parameter, std in springs.items() if std]
        blocks.append(spring_block(setup, freed, np.array([springs[parameter] for parameter in freed])))
    if prior.compliance:
        row = anywhere(arm.robot)
        given = {flexure.name: flexure.law.freed(row) for flexure in arm.flexures if flexure.learn is None}
        if any(given.values()):
            blocks.append(factor_block(arm, {name: axes for name, axes in given.items() if axes}, prior.compliance))
    return tuple(_as_in_fleet(block, prior) if prior.each else block for block in blocks)


def _of_target(
    setup: Setup, measurements: Measurements, sessions: tuple[str, ...], later: Sequence[str]
) -> Iterator[Block]:
    """Yield the blocks of where a target is on the tool, in all sessions or in campaigns after the first."""
    prior, readings = setup.arm.prior, measurements.readings
    touching = [one for one in setup.arm.sensors.values() if isinstance(one, TouchingSensor)]
    pointed = any(not one.sockets.own_point for one in touching if readings.of(Touch, one.name))
    if prior.tool and (readings.of(Position) or pointed):
        yield target_block(prior.tool)
    turned = bool(readings.of(Orientation))
    if prior.session_target and readings.of(Position):
        yield remounted_block(setup, sessions, prior.session_target, turned)
        return
    if turned:
        yield mounting_block(setup)
    if later and readings.of(Position) and (prior.tool or turned):
        # Two mountings differ by more than one is off; where it is known of one, it is of all.
        yield remounted_block(setup, tuple(later), max(np.sqrt(2.0) * prior.tool, RESOLUTION), turned)


@dataclass(frozen=True, eq=False)
class FleetBlock(Block):
    """A block whose values are about what its parameters are in sister arms; see `Prior.each`.

    Attributes:
        block: What it is of the arm as declared.
        mean: (k,) values of the sisters.
        prior: (k,) standard deviations about these.
    """

    block: Block
    mean: Array
    prior: Array

    def __post_init__(self) -> None:
        for name in ("parameters", "logarithmic", "curved", "by_row"):
            object.__setattr__(self, name, getattr(self.block, name))

    def columns(self, view: View) -> Array:
        return self.block.columns(view)

    def apply(self, setup: Setup, values: Array) -> Setup:
        return self.block.apply(setup, values + self.mean)

    def stepped(self, setup: Setup, step: Array) -> Setup:
        return self.block.stepped(setup, step)


def _as_in_fleet(block: Block, prior: Prior) -> Block:
    """Return a block about what its parameters are in sister arms, as it is where they say nothing of them."""
    if not any(parameter.label in prior.each for parameter in block.parameters):
        return block
    pairs = [
        prior.each.get(parameter.label, (0.0, std))
        for parameter, std in zip(block.parameters, block.prior.tolist(), strict=True)
    ]
    mean, std = np.array(pairs).T
    return FleetBlock(block, mean, np.maximum(std, RESOLUTION))


def blocks_of(parameters: Sequence[ArmParameter], setup: Setup, context: Context | None = None) -> list[Block] | None:
    """Return the blocks that parameters are of, None where they are not those of this arm.

    `context` is of the rows that the blocks will be asked about; without it effects can only be applied. Their priors
    no longer matter.
    """
    blocks: list[Block] = []
    for kind, alike in groupby(parameters, key=lambda parameter: parameter.group.kind):
        blocks += _of_kind(kind, list(alike), setup, context)
    return blocks if parameters_of(blocks) == tuple(parameters) else None


def _of_kind(kind: ParameterKind, parameters: list[ArmParameter], setup: Setup, context: Context | None) -> list[Block]:
    """Return the blocks of one kind that come nearest to some parameters."""
    arm = setup.arm
    names = tuple(dict.fromkeys(str(parameter.group.of) for parameter in parameters))
    if kind is ParameterKind.LAW:
        laws = learned_laws(arm)
        return [LawBlock(tuple(laws), tuple(laws.values()))] if laws else []
    if kind is ParameterKind.COMPLIANCE:
        axes = {name: [parameter.name for parameter in parameters if parameter.group.of == name] for name in names}
        at_flexures = set(names) <= {flexure.name for flexure in arm.flexures}
        if not at_flexures or any(axis not in TWIST_NAMES for names_of in axes.values() for axis in names_of):
            return []
        return [factor_block(arm, {name: tuple(map(TWIST_NAMES.index, named)) for name, named in axes.items()})]
    if kind is ParameterKind.EFFECT:
        blocks: list[Block] = []
        for ordinal, (effect, number) in enumerate(zip(arm.effects, numbers_of(arm.effects), strict=True)):
            every = of_effect(effect, number)
            if every[0].group in {parameter.group for parameter in parameters}:
                free = tuple(
                    i for i, parameter in enumerate(every[len(effect.location.terms) :]) if parameter in parameters
                )
                blocks.append(EffectBlock(effect, free, context, ordinal, np.zeros(0), number))
        return blocks
    if kind is ParameterKind.SENSOR:
        return [
            sensor_block(setup, sensor.name, sessions)
            for sensor in arm.sensors.values()
            if (
                sessions := tuple(
                    key for key in (sensor.found or ("",)) if set(of_sensor(sensor, [key])) & set(parameters)
                )
            )
        ]
    rigid: dict[ParameterKind, Callable[[], Block]] = {
        ParameterKind.INSTRUMENT: lambda: frame_block(setup),
        ParameterKind.SESSION: lambda: session_block(setup, names),
        ParameterKind.TOOL: target_block,
        ParameterKind.TARGET: lambda: remounted_block(
            setup,
            tuple(dict.fromkeys(parameter.group.of or "" for parameter in parameters)),
            turned=any(parameter.unit == "rad" for parameter in parameters),
        ),
        ParameterKind.MOUNTING: lambda: mounting_block(setup),
        ParameterKind.OFFSET: lambda: offset_block(setup),
        ParameterKind.GEOMETRY: lambda: geometry_block(setup),
        ParameterKind.MASS: lambda: mass_block(tuple(name for name in names if name in arm.weighing)),
        ParameterKind.SPRING: lambda: spring_block(
            setup, [parameter for parameter in parameters if parameter in of_springs(arm.springs)]
        ),
    }
    return [rigid[kind]()]
