"""Instruments that could be put on an arm: where, and which of them inform most."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.errors import InputError, did_you_mean, listing
from armflex.laws.effects.location import BASE
from armflex.plan.design import Goal
from armflex.plan.design_model import DesignModel
from armflex.readings import SENSOR_KINDS, Acceleration, Distance, Encoder, Inclination, Kind, Position, SlideEncoder
from armflex.readings.encoder import Shaft
from armflex.readings.sensor import Sensor

TRACKER = "tracker"
"""The word for the instrument that looks at the tip."""

Usual = tuple[type[Kind], float, dict[str, float]]

USUAL: dict[str, Usual] = {
    "level": (Inclination, 2e-5, {"mounting": 5e-3, "bias": 1e-3}),
    "wire": (Distance, 1e-4, {"anchor": 0.01, "length_offset": 0.01}),
    "accelerometer": (Acceleration, 2e-3, {"mounting": 5e-3, "bias": 0.02, "scale": 2e-3}),
    "encoder": (Encoder, 1e-5, {"bias": 1e-3}),
    "target": (Position, 2e-4, {"point": 1e-3}),
}
"""By the word for each: what it reads, one standard deviation of that, and of what is open of it, as is usual."""

ANCHORS, AWAY, HEIGHTS, FEWER = 8, 0.8, (0.0, 0.6), 5
"""Directions about the base in which anchors are offered, how far and at which heights, in parts of the reach; every so
many-th of them for a wire to another link than the tip."""


LEVELS = (Inclination, Acceleration)
"""Kinds that read how a link stands to gravity."""


@dataclass(frozen=True)
class Mounted:
    """An instrument that was chosen among those offered.

    Attributes:
        sensor: It.
        reached: The goal's value, as shown, with rows at random read by all that were chosen up to it.
        without: The same without it.
        others: What other places of the same instrument would reach, best first.
    """

    sensor: Sensor
    reached: float
    without: float
    others: tuple[tuple[str, float], ...]


def offered(arm: Arm, words: Sequence[str]) -> dict[str, tuple[Sensor, ...]]:
    """Return the places where each wanted instrument could be; one that the arm file declares is where it says.

    Raises:
        InputError: No such instrument.
    """
    offered_words = [*arm.sensors, *USUAL, TRACKER]
    for word in words:
        if word not in offered_words:
            hint = did_you_mean(word, offered_words)
            raise InputError(f"no instrument {word!r}{hint} (known: {listing(offered_words)})")
    if len(set(words)) < len(words):
        raise InputError(f"instruments {listing(words)}: one is named twice")
    return {
        word: (arm.sensors[word],) if word in arm.sensors else usual(arm, word) for word in words if word != TRACKER
    }


def usual(arm: Arm, word: str) -> tuple[Sensor, ...]:
    """Return an instrument that nobody declared wherever it may be: on every link that moves, at every joint."""
    kind, sigma, std = USUAL[word]

    def sensor(name: str, link: str, values: dict[str, Array] | None = None, shaft: Shaft | None = None) -> Sensor:
        of_kind = SlideEncoder if shaft and shaft.straight else kind
        declared = [(values or {}).get(nuisance.name, np.zeros(len(nuisance.axes))) for nuisance in of_kind.nuisances]
        spread = [np.full(len(nuisance.axes), std.get(nuisance.name, 0.0)) for nuisance in of_kind.nuisances]
        return Sensor(
            f"{word}_{name}", of_kind, link, sigma, np.concatenate(declared), np.concatenate(spread), about=shaft
        )

    if word == "wire":
        angles = 2.0 * np.pi * np.arange(ANCHORS) / ANCHORS
        ends = [(AWAY * np.cos(angle), AWAY * np.sin(angle), height) for angle in angles for height in HEIGHTS]
        anchors = [{"anchor": np.round(arm.robot.reach * np.array(end), 2)} for end in ends]
        sensors = [sensor(f"{i + 1}", arm.robot.tip, anchor) for i, anchor in enumerate(anchors)]
        carried = [joint.child for joint in arm.robot.moving[1:] if joint.child != arm.robot.tip]
        fewer = list(enumerate(anchors))[::FEWER]
        return (*sensors, *(sensor(f"{link}_{i + 1}", link, anchor) for link in carried for i, anchor in fewer))
    if word == "encoder":
        sensors = []
        for joint in arm.robot.moving:
            origin = np.eye(4)
            origin[:3, :3], origin[:3, 3] = joint.rotation, joint.origin
            straight = joint.kind == "prismatic"
            shaft = Shaft(joint.name, joint.parent, straight, np.asarray(joint.axis), origin)
            sensors.append(sensor(joint.name, joint.child, shaft=shaft))
        return tuple(sensors)
    point = {"point": np.array([0.0, 0.0, 0.1])} if word == "target" else {}
    return tuple(sensor(joint.child, joint.child, point) for joint in arm.robot.moving)


def informing_levels(arm: Arm, read: Collection[str]) -> frozenset[str]:
    """Return the places (joints, 'base') whose rotation a level shows, and on whose link none of those read is yet.

    About an axis that stays parallel to gravity nothing tilts: that of a joint which is so at zero, while all joints
    inboard of it slide or are so, too.
    """
    up = arm.robot.gravity / max(float(np.linalg.norm(arm.robot.gravity)), 1e-300)
    turn, upright, informed = np.eye(3), True, {BASE} if up.any() else set[str]()
    for joint in arm.robot.chain:
        turn = turn @ joint.rotation
        if joint in arm.robot.moving and joint.kind != "prismatic" and up.any():
            # Angle to gravity [rad] up to which an axis counts as parallel: a level shows less than a tenth of a turn
            # about it
            upright = upright and float(np.linalg.norm(np.cross(turn @ joint.axis, up))) < 0.1
            informed |= set() if upright else {joint.name}
    on = _moved_by(arm)
    return frozenset(
        informed - {on.get(sensor.link) for sensor in _those(arm, read) if issubclass(sensor.kind, LEVELS)}
    )


def unlike(arm: Arm, word: str, read: Collection[str]) -> tuple[Sensor, ...]:
    """Return the places of `usual` where none of the sensors that are read, by their names, says the same already."""
    on, mounted = _moved_by(arm), _those(arm, read)

    def there(sensor: Sensor) -> bool:
        kinds = LEVELS if sensor.kind in LEVELS else sensor.kind
        return any(issubclass(other.kind, kinds) and on.get(other.link) == on[sensor.link] for other in mounted)

    return tuple(sensor for sensor in usual(arm, word) if sensor.kind is Distance or not there(sensor))


def _moved_by(arm: Arm) -> dict[str, str]:
    """Return by link of the chain the last joint that moves it, 'base' for none."""
    place, places = BASE, {arm.robot.base: BASE}
    for joint in arm.robot.chain:
        place = joint.name if joint in arm.robot.moving else place
        places[joint.child] = place
    return places


def _those(arm: Arm, names: Collection[str]) -> list[Sensor]:
    return [sensor for name, sensor in arm.sensors.items() if name in names]


def choose(
    wanted: dict[str, tuple[Sensor, ...]], places: dict[str, slice], goal: Goal, model: DesignModel, rows: Array
) -> tuple[Mounted, ...]:
    """Return the best place of each wanted instrument, one after the other, each beside those before it.

    Args:
        wanted: Where each could be, by its word.
        places: Where the numbers of each stand among the d of a row; '' is the instrument at the tip, if it is read.
        goal: What is to be made as large as can be.
        model: What is free, and known before.
        rows: (n, d, P) rows that would be read, in standard deviations of the readings.
    """
    taken = [np.arange(place.start, place.stop) for name, place in places.items() if not name]
    mounts = []
    for options in wanted.values():
        here = np.concatenate([np.zeros(0, dtype=int), *taken])
        without = goal.value(model.known.with_rows(rows[:, here]))
        values = []
        for sensor in options:
            numbers = np.arange(places[sensor.name].start, places[sensor.name].stop)
            values.append(goal.value(model.known.with_rows(rows[:, np.concatenate([here, numbers])])))
        order = np.argsort(-np.array(values))
        best = options[order[0]]
        taken.append(np.arange(places[best.name].start, places[best.name].stop))
        others = tuple((options[i].name, float(goal.shown(values[i]))) for i in order[1:])
        mounts.append(Mounted(best, float(goal.shown(values[order[0]])), float(goal.shown(without)), others))
    return tuple(mounts)


def declaration(sensor: Sensor) -> str:
    """Return [instrument.NAME] as it is written into an arm.toml."""
    kind = next(word for word, kind in SENSOR_KINDS.items() if issubclass(sensor.kind, kind))
    lines = [f"[instrument.{sensor.name}]", f'kind = "{kind}"']
    lines += [f'joint = "{sensor.about.joint}"'] if isinstance(sensor.about, Shaft) else [f'link = "{sensor.link}"']
    start = 0
    for nuisance in sensor.kind.nuisances:
        place = slice(start, start + len(nuisance.axes))
        start = place.stop
        values, std = sensor.declared[place], float(sensor.std[place.start])
        if values.any() or nuisance.name == "anchor":
            lines.append(f"{nuisance.name} = {values.tolist() if len(values) > 1 else float(values[0])}")
        lines += [f"{nuisance.name}_std = {std:g}"] if std else []
    return "\n".join([*lines, f"sigma = {sensor.sigma:g}"])
