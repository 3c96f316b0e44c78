"""The conventions in which an arm and its campaign may have been written.

A hypothesis has a name, a remedy, the arm that was then meant, and what turns the campaign as it was read into that
which was meant. It knows nothing of how well they fit each other; `misread` judges that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product
from typing import TYPE_CHECKING

import numpy as np

from armflex.arm import Arm, Prior
from armflex.conventions import RESOLUTION, STANDARD_GRAVITY, Array
from armflex.errors import listing
from armflex.files.dh_table import in_other_form
from armflex.laws.joint.carried import scaled
from armflex.laws.law import anywhere
from armflex.measured.measurements import Measurements
from armflex.readings import Encoder, Kind, Orientation, Position, TouchingSensor
from armflex.readings.acceleration import OPPOSITE, Acceleration
from armflex.readings.distance import ANYWHERE
from armflex.readings.instrument import Instrument
from armflex.readings.sensor import Sensor

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Rewriting = Callable[[Measurements], Measurements]

WRITTEN_IN = {
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "inches": 0.0254},
    "rad": {"rad": 1.0, "degrees": np.pi / 180.0, "mm/m": 1e-3},
    "m/s^2": {"m/s^2": 1.0, "g": STANDARD_GRAVITY, "mm/s^2": 1e-3, "mg": 1e-3 * STANDARD_GRAVITY},
}
"""Tolerance: SI unit -> unit that numbers may have been written in, or read as -> factor to SI."""

USUAL_PRIOR = Prior(joint_offset=2e-3, compliance=0.3, tool=0.01, geometry=1e-3)
"""Priors: what is usually open of an arm where nobody says."""


@dataclass(frozen=True, eq=False)
class Misreading:
    """A convention that the campaign or the arm file may have been written in.

    Attributes:
        name: What would be wrong, as the end of a sentence.
        remedy: How to write it right.
        rows: Turns the campaign as read into the one that was meant.
        arm: The arm as it was then meant; None as it is declared.
        mistakes: How many mistakes it takes, each of which is made in one campaign of a thousand.
        of: What readings it is about: the joints and lengths that move the tip ('points'), what bends the arm
            ('loads'), 'orientation', or the name of a sensor.
        some: Whether it may be true of one session alone, or of some of the rows.
        slip: How far something was moved [m, rad], where an arm that slips as far explains as much.
        whole: Whether it is named only where it explains most of what is left: it has numbers that readings gave.
        volume: Logarithm of the factor by which it stretches what is read, the mean over its numbers: numbers that
            shrink fit anything, and are no likelier for that.
        where: (M,) in which of the rows looked at it holds; None for all.
        of_rows: Whether some rows are rewritten as they are among all: it is not about the order of the rows.
    """

    name: str
    remedy: str
    rows: Rewriting = lambda rows: rows
    arm: Arm | None = None
    mistakes: int = 1
    of: str = "points"
    some: bool = False
    slip: float | None = None
    of_rows: bool = True
    whole: bool = False
    volume: float = 0.0
    where: np.ndarray | None = None


def misreadings(arm: Arm, measurements: Measurements, suspects: Sequence[str | None] = ()) -> Iterator[Misreading]:
    """Yield every convention that is thought of for a campaign as it was read.

    `suspects` are the names of the sensors whose readings are far off, None for the orientations of the tip's target.
    """
    # Joints that are taken to turn less bring any touches together.
    touching = all(kind.texts is not None for kind in measurements.readings.kinds)
    yield from (
        hypothesis for hypothesis in _of_joints(arm) if not (touching and hypothesis.name.endswith("in degrees"))
    )
    yield from _of_positions(arm, measurements)
    yield from _of_loads(arm, measurements)
    for kind in measurements.readings.kinds:
        if isinstance(kind, Orientation) and not kind.name:
            yield from _of_orientations() if None in suspects else ()
        elif kind.name and kind.name in suspects:
            yield from _of_sensor(kind, arm, measurements)


def _of_joints(arm: Arm) -> Iterator[Misreading]:
    joints, turning = arm.joint_names, [joint.kind != "prismatic" for joint in arm.robot.moving]
    at = np.eye(len(joints))
    for i, j in combinations(range(len(joints)), 2):
        if turning[i] == turning[j]:
            order = np.arange(len(at))
            order[[i, j]] = j, i
            name = f"the columns q_{joints[i]} and q_{joints[j]} are exchanged"
            yield Misreading(name, "exchange their headers", joints_as(at[order]), some=True)
    every = [i for i, turns in enumerate(turning) if turns]
    for i, joint in enumerate(joints):
        remedy = f"turn the signs of q_{joint}, or the joint's axis in the URDF"
        yield Misreading(f"the sign of q_{joint} is turned", remedy, joints_as(np.diag(1.0 - 2.0 * at[i])), some=True)
        for degrees in (90, -90, 180) if turning[i] else ():  # others are estimated
            name = f"the home position of {joint} is {degrees:+d} degrees from the URDF's"
            remedy = f"add {degrees:+d} degrees to q_{joint}, or turn the joint's origin in the URDF"
            yield Misreading(name, remedy, joints_as(at, np.radians(degrees) * at[i]), mistakes=2, some=True)
    signs = np.where(turning, -1.0, 1.0)
    remedy = "turn all their signs, or the axes in the URDF: the base, or the whole arm, is mirrored"
    yield Misreading("the signs of all turning joints are turned", remedy, joints_as(np.diag(signs)))
    columns = [(np.array([i]), f"q_{joints[i]} is", f"q_{joints[i]}_deg") for i in every]
    columns += [(np.array(every), "the turning joints are", "q_..._deg")] if len(every) > 1 else []
    for places, what, head in columns:
        for unit, factor, remedy in (
            ("degrees", np.pi / 180.0, f"write {head} into the header"),
            ("radians", 180.0 / np.pi, "take _deg from the header"),
        ):
            scale = joints_as(np.diag(np.where(at[places].any(axis=0), factor, 1.0)))
            yield Misreading(f"{what} in {unit}", remedy, scale, some=len(places) > 1)
    if arm.robot.urdf.dh:
        other = in_other_form(arm.robot)
        name, remedy = f"the rows of [robot.joint] are of the {other.urdf.dh} form", f'write dh = "{other.urdf.dh}"'
        yield Misreading(name, remedy, arm=replace(arm, robot=other))


def _of_positions(arm: Arm, measurements: Measurements) -> Iterator[Misreading]:
    for step, whose in ((1, "before"), (-1, "after")):
        if measurements.measured.sum() > abs(step):
            read = _columns_read(measurements) or "readings"
            remedy = f"move {read} by one row against the joints"
            yield Misreading(f"{read} are those of the row {whose}", remedy, _read_apart(step), of_rows=False)
    if (position := measurements.readings.of(Position)) is None:
        return
    axes_read = np.isfinite(position.sigma).any(axis=0)  # one that nobody read is in no unit
    fixed = axes_read & (np.ptp(position.values, axis=0) == 0.0)
    axes_read &= ~fixed
    if not (columns := _columns_read(measurements)):
        return
    are = "are" if "," in columns else "is"
    for unit, taken, factor in _factors("m"):
        remedy = f"write the unit into the header: {columns.replace(',', f'_{unit},')}_{unit}"
        if unit == "inches":
            remedy = f"convert to mm, and write {columns.replace(',', '_mm,')}_mm into the header"
        name = f"{columns} {are} in {unit}, read as {taken}"
        volume, every = float(np.log(factor)) * axes_read.mean(), np.eye(3) * factor
        yield Misreading(name, remedy, _positions(every), some=True, volume=volume)
        yield Misreading(f"{name}, and so is sigma", remedy, _positions(every, factor), volume=volume)
        for i in np.flatnonzero(axes_read) if axes_read.sum() > 1 else ():  # one column has no other unit than its own
            scale = np.diag(np.where(np.arange(3) == i, factor, 1.0))
            name, alone = f"{'xyz'[i]} alone is in {unit}, read as {taken}", f"write {'xyz'[i]}_{unit} into its header"
            alone = f"convert it to {taken}" if unit == "inches" else alone
            yield Misreading(name, alone, _positions(scale), mistakes=2, volume=float(np.log(factor)) / 3.0)
    if fixed.any() and axes_read.any():
        still = listing(np.array(list("xyz"))[fixed].tolist())
        name = f"{still} {'was' if fixed.sum() == 1 else 'were'} not read, as the same number is in every row"
        remedy = 'declare what was read as [instrument.NAME], such as kind = "height" in the column NAME'
        unread = _of_kind("", Position, lambda kind, _: replace(kind, sigma=np.where(fixed, np.inf, kind.sigma)))
        yield Misreading(name, remedy, unread)
    smaller = "write sigma_mm into the header"
    yield Misreading("sigma is in mm", smaller, lambda rows: replace(rows, sigma=1e-3 * rows.sigma), mistakes=2)
    yield from _of_axes(columns)
    if arm.measurement.frame == "base":
        remedy = 'write frame = "unknown" under [measurement]: the instrument stands elsewhere'
        elsewhere = replace(arm, measurement=replace(arm.measurement, frame="unknown"))
        yield Misreading(f"{columns} {are} not in the arm's base frame", remedy, arm=elsewhere)


def _of_axes(columns: str) -> Iterator[Misreading]:
    """Yield that two of the axes x, y and z that were read are exchanged, or some of them reversed."""
    are = "are" if "," in columns else "is"
    for axes, away, turned in _axes("xyz"):
        read = all(axis in columns for axis in (*away, *turned))
        if len(away) + len(turned) in (1, 2) and not (away and turned) and read:
            hand = f"{away[0]} and {away[1]} are exchanged" if away else f"{' and '.join(turned)} reversed"
            left = np.linalg.det(axes) < 0.0
            name = f"{columns} {are} a left-handed frame's, {hand}" if left else hand
            remedy = f"exchange {away[0]} and {away[1]}" if away else f"turn the sign of {' and '.join(turned)}"
            mistakes = max(len(turned), 1) if left else 3  # as a frame that stands elsewhere may be
            yield Misreading(name, remedy, _positions(axes), mistakes=mistakes, some=True)


def _axes(names: Sequence[str]) -> Iterator[tuple[Array, list[str], list[str]]]:
    """Yield each (n, n) exchange and reversal of some axes, the names of those elsewhere and of those reversed."""
    count = len(names)
    for order, signs in product(permutations(range(count)), product((1.0, -1.0), repeat=count)):
        away = [name for i, name in enumerate(names) if order[i] != i]
        turned = [name or "its sign" for name, sign in zip(names, signs, strict=True) if sign < 0.0]
        yield np.eye(count)[list(order)] * np.array(signs)[:, None], away, turned


def _columns_read(measurements: Measurements) -> str:
    """Return which of x, y and z were read in any row, '' where none was."""
    position = measurements.readings.of(Position)
    return "" if position is None else ", ".join(np.array(list("xyz"))[np.isfinite(position.sigma).any(axis=0)])


def _of_loads(arm: Arm, measurements: Measurements) -> Iterator[Misreading]:
    down = arm.robot.gravity
    for axis, sign in product(range(3), (-1.0, 1.0)) if arm.flexures or arm.sensors else ():
        other = np.linalg.norm(down) * sign * np.eye(3)[axis]
        if np.any(down) and not np.allclose(other, down):
            name = f"gravity points along {'-' if sign < 0.0 else '+'}{'xyz'[axis]} of the base"
            shown = ", ".join(f"{number:g}" for number in other)
            pulled = replace(arm, robot=replace(arm.robot, gravity=other))
            yield Misreading(name, f"write gravity = [{shown}] under [robot], or a mount", arm=pulled, of="loads")
    masses = {"none": 0.0} | {name: payload.mass for name, payload in arm.payloads.items()}
    given = {name: masses[name] for name in dict.fromkeys(measurements.payload)}
    for payload, other in combinations(sorted(given), 2):
        name = f"the payloads {payload!r} and {other!r} are exchanged"
        remedy = "exchange their names in the column payload"
        yield Misreading(name, remedy, _payloads({payload: other, other: payload}), of="loads")
    for empty, heavy in product((payload for payload in given if not given[payload]), arm.payloads):
        if arm.payloads[heavy].mass:
            name = f"rows whose payload is {empty!r} or not given carry {heavy!r}"
            yield Misreading(name, "name it in the column payload", _payloads({empty: heavy}), of="loads", some=True)
    if any(payload.mass for payload in arm.payloads.values()):
        for unit, factor in (("tonnes", 1e3), ("grams", 1e-3)):
            heavy = {name: replace(payload, mass=factor * payload.mass) for name, payload in arm.payloads.items()}
            meant = replace(arm, payloads=heavy)
            yield Misreading(f"payload masses are in {unit}", "write them in kg", arm=meant, of="loads")
    if giving := [flexure.name for flexure in arm.flexures if flexure.law.freed(anywhere(arm.robot))]:
        for factor, unit in ((1e3, "a thousand times too small"), (1e-3, "a thousand times too large")):
            remedy = "give it in rad/Nm and m/N, check mrad, kN, kNm and mm"
            times = np.full(6, np.sqrt(factor))
            softer = [
                replace(flexure, law=scaled(flexure.law, times)) if flexure.name in giving else flexure
                for flexure in arm.flexures
            ]
            meant = replace(arm, flexures=tuple(softer))
            yield Misreading(f"the compliance is {unit}", remedy, arm=meant, of="loads")


def _of_orientations() -> Iterator[Misreading]:
    """Yield what may have been written into rx, ry, rz instead of a rotation vector in the unit of the header."""
    from scipy.spatial.transform import Rotation  # not needed to import the package

    def euler(axes: str, columns: Sequence[int]) -> Callable[[Array], Rotation]:
        return lambda values: Rotation.from_euler(axes, values[:, columns])

    forms: dict[str, tuple[Callable[[Array], Rotation], str]] = {
        "": (Rotation.from_rotvec, ""),
        "a quaternion's x, y, z": (_from_quaternion, ""),
    }
    for order in (*permutations("xyz"), *((a, b, a) for a, b in permutations("xyz", 2))):
        for axes, about in (("".join(order), "fixed"), ("".join(order).upper(), "turning")):
            if len(set(order)) == 3 and axes.lower() != "xyz":  # rx is the angle about x, whenever it is turned
                columns = ["xyz".index(axis) for axis in order]
                forms[f"Euler angles about {about} axes in the order {axes}"] = euler(axes, columns), axes
            forms[f"Euler angles {axes}, in the order of turning about {about} axes"] = euler(axes, range(3)), axes
    for (form, (turned, axes)), back, (unit, factor) in product(
        forms.items(), (False, True), (("", 1.0), ("degrees", np.pi / 180.0), ("radians", 180.0 / np.pi))
    ):
        wrong = [form] * bool(form) + ["the other way about (of the instrument in the target)"] * back
        wrong += [f"in {unit}"] * bool(unit)
        if not wrong or (unit and form.startswith("a quaternion")):
            continue
        remedy = "take _deg from the header" if unit == "radians" else "write the unit into the header: rx_deg"
        if axes:
            remedy = f"write rotation vectors, say by scipy's Rotation.from_euler({axes!r}, ...).as_rotvec()"
        elif form or back:
            remedy = "write its rotation vector" + ", of the target in the instrument" * back

        def rewritten(kind: Kind, _: Measurements, turned=turned, back: bool = back, by: float = factor) -> Kind:
            turns = turned(by * kind.values)
            return replace(kind, values=(turns.inv() if back else turns).as_rotvec())

        change, name = _of_kind("", Orientation, rewritten), f"rx, ry, rz are {', '.join(wrong)}"
        yield Misreading(name, remedy, change, mistakes=len(wrong), of="orientation")


def _from_quaternion(vectors: Array) -> Rotation:
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    angle = 2.0 * np.arcsin(np.minimum(size, 1.0))
    from scipy.spatial.transform import Rotation  # not needed to import the package

    return Rotation.from_rotvec(vectors * angle / np.maximum(size, RESOLUTION))


def _of_sensor(kind: Kind, arm: Arm, measurements: Measurements) -> Iterator[Misreading]:
    """Yield what else may be meant by what a sensor read, or of where it is."""
    name, sensor = kind.name, arm.sensors[kind.name]
    if isinstance(sensor, TouchingSensor) or kind.apart:  # it reads no number, or numbers whose meaning is no question
        return
    for unit, taken, factor in _factors(kind.unit):
        remedy = "write the unit into the header"
        what = f"what {kind.title} read fits better in {unit}, not {taken}"
        change = _values(name, factor * np.eye(kind.dimension))
        yield Misreading(what, remedy, change, of=name, volume=float(np.log(factor)))
    if isinstance(kind, Acceleration):
        other = OPPOSITE[sensor.about or "gravity"]
        remedy, meant = f'write reads = "{other}"', _with(arm, replace(sensor, about=other))
        yield Misreading(f"{kind.title} reads the opposite", remedy, arm=meant, of=name)
    for axes, away, turned in _axes(kind.channels):
        if away or turned:
            words = [f"{' and '.join(away)} {'swapped' if len(away) == 2 else 'exchanged in turn'}"] if away else []
            words += [f"{' and '.join(turned)} reversed"] if turned else []
            what = f"what {kind.title} read fits better with {', '.join(words)}"
            mistakes = len(away) // 2 + len(turned)
            yield Misreading(what, "write its columns so", _values(name, axes), mistakes=mistakes, of=name)
    for other in measurements.readings.kinds:
        if other.name != name and type(other) is type(kind) and not isinstance(kind, Orientation):
            first, last = sorted([name, other.name])
            text = f"the columns of {first or 'the tip: x, y, z,'} and those of {last} are exchanged"
            yield Misreading(text, "exchange their headers", _exchanged(first, last), of=name)
    robot = arm.robot
    for link in dict.fromkeys([robot.base, *(joint.child for joint in robot.chain), robot.tip]):
        if not isinstance(kind, Encoder) and link not in (sensor.link, sensor.seen_from):
            text = f"{kind.title} is on {link!r}"
            meant = _with(arm, replace(sensor, link=link))
            yield Misreading(text, f'write link = "{link}"', arm=meant, mistakes=2, of=name)


def targets_apart(arm: Arm, column: str, groups: Sequence[str], steps: Mapping[str, Array]) -> Misreading:
    """Return the hypothesis that the target is at another place in some groups of rows than in the first.

    The (N,) groups are of a column; (3,) steps [m], tip axes, are how much farther the target is, of all but the first.
    """
    shifts = [f"{name!r} by ({', '.join(f'{1e3 * number:.3g}' for number in step)}) mm" for name, step in steps.items()]
    first = next(name for name in groups if name not in steps)
    text = f"the target is at another place with {column} {listing(shifts)} (tip axes) than with {first!r}"
    remedy = f"give the rows of each {column} a session of their own, and session_target under [prior]"
    size = max(float(np.abs(step).max()) for step in steps.values())
    prior = replace(arm.prior, session_target=max(arm.prior.session_target, size))

    def apart(rows: Measurements) -> Measurements:
        labels = rows.payload if column == "payload" else rows.covariates[column]
        return replace(rows, session=tuple(f"{a}, {b}" for a, b in zip(rows.session, labels, strict=True)))

    return Misreading(text, remedy, apart, arm=replace(arm, prior=prior), whole=True)


def elsewhere(arm: Arm, sensor: Sensor, text: str) -> Misreading:
    """Return the hypothesis that a sensor of an arm stands somewhere else than it is declared to, as a text says."""
    std = np.where(np.isin(np.arange(len(sensor.std)), sensor.movable), np.maximum(sensor.std, ANYWHERE), sensor.std)
    return Misreading(text, "declare it there", arm=_with(arm, replace(sensor, std=std)), of=sensor.name)


def moved(
    arm: Arm, name: str, title: str, start: str, rows: np.ndarray, step: Array, sessions: Sequence[str]
) -> Iterator[Misreading]:
    """Yield the hypotheses that an instrument or its target was moved in (N,) rows, as if no session had begun.

    The name is that of a sensor; '' is the tracker, 'target' the target that it looks at. `start` says where the first
    of the rows is, and (n,) step by how much their readings change [their unit], of the target in tip axes [m].
    """
    text = f"{title} was moved, unnoticed, from about {start} on"
    remedy = "give the rows from there on a session of their own"
    remedy += ", and session_target under [prior]" if name == "target" else ""
    more = {"of": name or "points", "slip": float(np.linalg.norm(step))}
    if name != "target":
        of, motion = Kind if name else Position, rows[:, None] * step
        back = _of_kind(name, of, lambda kind, _: replace(kind, values=kind.values - motion))
        yield Misreading(text, remedy, back, **more)
    if name in ("", "target"):
        late = " moved"
        renamed = tuple(f"{session}{late}" if there else session for session, there in zip(sessions, rows, strict=True))
        if name == "target":
            instrument = arm.instrument or Instrument()
            targets = {session: instrument.targets.get(session.removesuffix(late), np.zeros(6)) for session in renamed}
            step = np.append(step, np.zeros(3))
            targets = {session: at + step * session.endswith(late) for session, at in targets.items()}
            arm = replace(arm, instrument=replace(instrument, targets=targets))
        yield Misreading(text, remedy, lambda measurements: replace(measurements, session=renamed), arm, **more)


def _factors(unit: str) -> Iterator[tuple[str, str, float]]:
    """Yield (unit that numbers are in, unit that they were read in, factor), of each factor the usual pair."""
    seen = set[float]()
    for taken, written in sorted(permutations(WRITTEN_IN[unit], 2), key=lambda pair: pair[0] != unit):
        factor = WRITTEN_IN[unit][written] / WRITTEN_IN[unit][taken]
        if round(np.log(factor), 6) not in seen:
            seen.add(round(np.log(factor), 6))
            yield written, taken, factor


def _read(change: Callable[[Kind, Measurements], Kind]) -> Rewriting:
    """Return the rewriting of every kind of readings, given the campaign."""

    def rewritten(measurements: Measurements) -> Measurements:
        kinds = tuple(change(kind, measurements) for kind in measurements.readings.kinds)
        return replace(measurements, readings=replace(measurements.readings, kinds=kinds))

    return rewritten


def _of_kind(name: str, of: type[Kind], change: Callable[[Kind, Measurements], Kind]) -> Rewriting:
    """Return the rewriting of what one instrument read, of one kind; '' is that of the tip."""
    return _read(lambda kind, rows: change(kind, rows) if kind.name == name and isinstance(kind, of) else kind)


def _values(name: str, by: Array, of: type[Kind] = Kind, sigma: float = 1.0) -> Rewriting:
    """Return the change of what one instrument read to a (d, d) matrix times it, and the factor on its noise."""
    return _of_kind(name, of, lambda kind, _: replace(kind, values=kind.values @ by.T, sigma=sigma * kind.sigma))


def _positions(by: Array, sigma: float = 1.0) -> Rewriting:
    return _values("", by, Position, sigma)


def _exchanged(first: str, other: str) -> Rewriting:
    names = {first: other, other: first}

    def change(kind: Kind, measurements: Measurements) -> Kind:
        fellow = measurements.readings.of(type(kind), names[kind.name]) if kind.name in names else None
        return kind if fellow is None else replace(fellow, name=kind.name)

    return _read(change)


def _with(arm: Arm, sensor: Sensor) -> Arm:
    return replace(arm, sensors={**arm.sensors, sensor.name: sensor})


def joints_as(by: Array, shift: Array | float = 0.0) -> Rewriting:
    """Return the change of joint positions to q times a (nq, nq) matrix and a (nq,) shift."""
    return lambda measurements: replace(measurements, q=measurements.q @ by + shift)


def _payloads(names: Mapping[str, str]) -> Rewriting:
    return lambda rows: replace(rows, payload=tuple(names.get(name, name) for name in rows.payload))


def _read_apart(step: int) -> Rewriting:
    def change(kind: Kind, measurements: Measurements) -> Kind:
        if not (isinstance(kind, Position) or kind.name):  # an orientation has a row of its own, as ever
            return kind
        measured, after = np.flatnonzero(measurements.measured), np.arange(len(measurements))
        after[measured] = np.roll(measured, -step)
        return replace(kind, values=kind.values[after], sigma=kind.sigma[after] if kind.name else kind.sigma)

    return _read(change)
