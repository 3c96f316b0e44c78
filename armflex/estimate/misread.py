"""Whether a campaign says what its columns claim, or was written in another convention than the arm's.

Most first campaigns are wrong in a convention: two joints exchanged, a sign, a home position, degrees, readings that
belong to the row before. A fit then drives everything that is free to where it makes up for that. So before anything is
fitted, the readings are compared with what the arm and its priors can explain. With r the (n,) residuals of the
declared arm, J the Jacobian of everything that [prior] frees, P its prior covariance and s^2 a variance of one reading,

    r ~ N(0, s^2 1 + J P J'),        misfit = r' (s^2 1 + J P J')^-1 r / n,

which is about 1 or less for a campaign of this arm. s is the stated standard deviation, or a part of the reach if that
is larger: what an arm lacks is no business of this test, but only to be found by tracing. Where the misfit is
implausible the hypotheses are tried, each a transformation of the table or of the arm file, with a misfit of its own.
One is named only if it explains nearly all that the table as it stands does not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from armflex.arm import Arm, Setup
from armflex.conventions import STANDARD_GRAVITY, Array, in_mm
from armflex.errors import ArmflexError, ConventionError
from armflex.estimate.block import parameters_of
from armflex.estimate.blocks import declared_blocks, sensor_start
from armflex.estimate.placement import check_readings, placed_rigidly
from armflex.estimate.view import look
from armflex.files.dh_table import in_other_form
from armflex.laws.joint.carried import scaled
from armflex.laws.law import anywhere
from armflex.linear_gaussian import LinearGaussian
from armflex.measured.measurements import Measurements
from armflex.measured.repeats import repeats
from armflex.mechanics.history import known_rows
from armflex.parameters import FRAMES, ArmParameter, ParameterKind
from armflex.readings import Position
from armflex.readings.instrument import Instrument

COARSE, FINE = 1e-3, 3e-5
"""Parts of the reach that an arm may be off by, beyond its priors, before conventions are thought of: of kinematics,
which put readings off by parts of the reach, and of loads, which bend the arm a little more or less."""

IMPLAUSIBLE = 9.0
"""Misfit beyond which the campaign is not that of this arm as it is written: three standard deviations."""

DROP, DROP_OF_LOADS = 9.0, 3.0
"""Fall of the misfit at which a hypothesis is named: of kinematics many are tried, and what an arm lacks is a larger
part of what loads do."""

ALIKE = 3.0
"""Hypotheses whose misfits differ by less are named together."""

MOST_ROWS = 120
"""Rows looked at: no convention hides in more."""

GROSS = 0.05
"""Part of the reach that is left by no arm: a beam of steel that bends so far stays bent."""

ROUNDS = 4
"""Rounds of robust weights, after which a lost beam counts as little as it will."""

EXACT = 0.05
"""A standard deviation of a part `COARSE` of the reach is a mistaken one where so little of it is left."""

SCATTERED = 30.0
"""Scatter of repeats over the stated standard deviation that is a mistaken unit rather than a bad day."""

RADIANS = np.pi / 180.0

Told = tuple[Arm, Measurements]


@dataclass(frozen=True)
class Hypothesis:
    """A convention that the campaign or the arm file may have been written in.

    Attributes:
        name: What would be wrong, as the end of a sentence.
        remedy: How to write it right.
        told: The arm and the campaign as they were then meant.
        axes: Whether it is about the axes of x, y and z, of which `check_axes` says more.
        loads: Whether it is about what bends the arm, and how far.
        tracked: Whether it is about x, y and z alone.
    """

    name: str
    remedy: str
    told: Callable[[Arm, Measurements], Told]
    axes: bool = False
    loads: bool = False
    tracked: bool = False


def check_conventions(
    arm: Arm, measurements: Measurements, rows: np.ndarray, keep: bool = False, searched: bool = False
) -> None:
    """Raise where the readings are implausible for an arm, and plausible in another convention.

    Args:
        arm: The arm as declared.
        measurements: The campaign.
        rows: (M,) numbers of the rows used.
        keep: Whether nothing but frames is fitted, so that [prior] need not free anything.
        searched: Whether what the arm lacks is looked for, which may be all that it lacks.

    Raises:
        ConventionError: With the hypotheses that make the campaign plausible, the likeliest first, and how to write
            each of them right; or standard deviations that cannot be meant; or nothing that [prior] frees where
            readings are far off.
    """
    rows = rows[measurements.positioned[rows]]
    if not len(rows):
        return
    some = _spread(rows)
    found = _misfit(arm, measurements, some, keep, in_general=True)
    likely = [] if found is not None and found.ratio < IMPLAUSIBLE else _likely(arm, measurements, some, keep, found)
    if likely:
        if all(one.axes for _, one in likely):  # of which this says more, where nothing else is far off
            points = (arm.instrument or Instrument()).in_base(_tips(arm, measurements, rows))
            check_readings(arm, points, measurements, rows)
        raise ConventionError(_said(measurements, rows, found, likely), [one.name for _, one in likely])
    if found is not None and not likely:
        _check_sigma(measurements, rows, found)
        off = found.coarse if searched else found.ratio
        if off >= IMPLAUSIBLE and not keep and not found.free:
            text = f"readings are {in_mm(found.placed)} off the arm, and [prior] frees nothing: there is nothing to fit"
            more = "give it joint_offset, compliance, tool or geometry, one standard deviation each"
            raise ConventionError(f"{text} ({more})", ["[prior] frees nothing"])
        if found.left > GROSS * found.reach and not keep:
            text = f"readings are {in_mm(found.placed)} off the arm, {in_mm(found.left)} with all that [prior] frees"
            text += ": no defect of an arm is so large, and no convention that is tried explains it"
            more = "check that rows and readings are of the same poses, the URDF this arm's, the tip the target's link"
            raise ConventionError(f"{text}; {more}, and for two conventions at once", [])


def without_positions(arm: Arm, measurements: Measurements, rows: np.ndarray, keep: bool = False) -> tuple[str, ...]:
    """Return in words the conventions in which what sensors alone read becomes plausible, the likeliest first.

    Where they stand is found anew for each, so some do as much as another place of theirs would.

    Args:
        arm, measurements, rows, keep: As of `check_conventions`.
    """
    some = _spread(rows)
    found = _misfit(arm, measurements, some, keep, in_general=True)
    if found is not None and found.ratio < IMPLAUSIBLE:
        return ()
    return tuple(f"{one.name} ({one.remedy})" for _, one in _likely(arm, measurements, some, keep, found))


def _spread(rows: np.ndarray) -> np.ndarray:
    """Return at most `MOST_ROWS` of some rows."""
    return rows[np.unique(np.linspace(0, len(rows) - 1, MOST_ROWS).astype(int))] if len(rows) > MOST_ROWS else rows


def _likely(
    arm: Arm, measurements: Measurements, rows: np.ndarray, keep: bool, found: _Misfit | None
) -> list[tuple[_Misfit, Hypothesis]]:
    """Return the hypotheses that explain nearly all that the table as it stands does not, the likeliest first."""
    tried, placed = [], measurements.positioned[rows].all()
    as_it_stands = _placed_off(arm, measurements, rows) if placed else np.inf
    for hypothesis in hypotheses(arm, measurements):
        if hypothesis.tracked and not placed:
            continue
        said = hypothesis.told(arm, measurements)
        # Kinematics that do not bring the points nearer to their places cannot explain them: most need no fit.
        able = found is None or hypothesis.loads or found.coarse >= IMPLAUSIBLE
        quick = placed and found is not None and not hypothesis.loads
        if not able or (quick and _placed_off(*said, rows) > as_it_stands):
            continue
        other, least = _misfit(*said, rows, keep), DROP_OF_LOADS if hypothesis.loads else DROP
        if other is not None and (found is None or least * other.ratio < found.ratio):
            tried.append((other, hypothesis))
    tried.sort(key=lambda pair: pair[0].ratio)
    return [pair for pair in tried if pair[0].ratio < ALIKE * max(tried[0][0].ratio, 1.0)]


def hypotheses(arm: Arm, measurements: Measurements) -> Iterator[Hypothesis]:
    """Yield every convention that is thought of, for an arm and a campaign."""
    joints, turning = arm.joint_names, [joint.kind != "prismatic" for joint in arm.robot.moving]
    at = np.eye(len(joints))
    for i, j in combinations(range(len(joints)), 2):
        if turning[i] == turning[j]:
            name = f"the columns q_{joints[i]} and q_{joints[j]} are exchanged"
            order = np.arange(len(at))
            order[[i, j]] = j, i
            yield Hypothesis(name, "exchange their headers", _rewritten(at[order]))
    every = [i for i, turns in enumerate(turning) if turns]
    for i, joint in enumerate(joints):
        remedy = f"turn the signs of q_{joint}, or the joint's axis in the URDF"
        yield Hypothesis(f"the sign of q_{joint} is turned", remedy, _rewritten(np.diag(1.0 - 2.0 * at[i])))
        if turning[i]:
            for degrees in (90, -90, 180):
                name = f"the home position of {joint} is {degrees:+d} degrees from the URDF's"
                remedy = f"add {degrees:+d} degrees to q_{joint}, or turn the joint's origin in the URDF"
                yield Hypothesis(name, remedy, _rewritten(at, np.radians(degrees) * at[i]))
    for place, what in [([i], f"q_{joints[i]} is") for i in every] + [(every, "the turning joints are")]:
        name = what.removesuffix(" is").removesuffix(" are")
        if len(place) == 1 or len(every) > 1:
            head = f"{name}_deg" if len(place) == 1 else "q_..._deg"
            own = np.isin(np.arange(len(at)), place)
            in_degrees, in_radians = (_rewritten(np.diag(np.where(own, one, 1.0))) for one in (RADIANS, 1.0 / RADIANS))
            yield Hypothesis(f"{what} in degrees", f"write {head} into the header", in_degrees)
            yield Hypothesis(f"{what} in radians", "take _deg from the header", in_radians)
    if arm.robot.urdf.dh:
        other = in_other_form(arm.robot)
        name, remedy = f"the rows of [robot.joint] are of the {other.urdf.dh} form", f'write dh = "{other.urdf.dh}"'
        yield Hypothesis(name, remedy, lambda arm, measurements: (replace(arm, robot=other), measurements))
    for step, whose in ((1, "before"), (-1, "after")):
        if measurements.measured.sum() > abs(step):
            read = "x, y, z" if measurements.positioned.any() else "readings"
            remedy = f"move {read} by one row against the joints"
            yield Hypothesis(f"{read} are those of the row {whose}", remedy, _read_apart(step))
    remedy = "exchange two of the columns x, y, z"
    yield Hypothesis("x, y, z are a left-handed frame's", remedy, _mirrored, axes=True, tracked=True)
    if arm.measurement.frame == "base":
        remedy = 'write frame = "unknown" under [measurement]: the instrument stands elsewhere'
        yield Hypothesis("x, y, z are not in the arm's base frame", remedy, _placed_anywhere, tracked=True)
    named = sorted({name for name in measurements.payload if name in arm.payloads})
    for one, other in combinations(named, 2):
        name = f"the payloads {one!r} and {other!r} are exchanged"
        yield Hypothesis(
            name, "exchange their names in the column payload", _payloads_exchanged(one, other), loads=True
        )
    if any(payload.mass for payload in arm.payloads.values()):
        yield Hypothesis("payload masses are in tonnes", "write them in kg", _masses_times(1e3), loads=True)
        yield Hypothesis("payload masses are in grams", "write them in kg", _masses_times(1e-3), loads=True)
    if any(flexure.law.freed(anywhere(arm.robot)) for flexure in arm.flexures):
        for factor, unit in ((1e3, "a thousand times too small"), (1e-3, "a thousand times too large")):
            remedy = "give it in rad/Nm and m/N, check mrad, kN, kNm and mm"
            yield Hypothesis(f"the compliance is {unit}", remedy, _compliance_times(factor), loads=True)


@dataclass(frozen=True)
class _Misfit:
    """How badly readings fit an arm within its priors.

    Attributes:
        ratio, coarse: The misfit, see the head of this file, where an arm may be off by `FINE` and by `COARSE`.
        placed: What is left with the instrument placed and nothing else fitted, the median row's [m].
        left: What is left with everything fitted, the median row's [m].
        reach: Of the rows [m].
        free: Whether anything but frames is free or learned.
    """

    ratio: float
    coarse: float
    placed: float
    left: float
    reach: float
    free: bool


def _misfit(
    arm: Arm, measurements: Measurements, rows: np.ndarray, keep: bool, in_general: bool = False
) -> _Misfit | None:
    """Return how badly rows fit, None where the arm has no equilibrium there or does not know what they are."""
    tracked = bool(measurements.positioned[rows].all())
    try:
        view = look(Setup(arm, arm.instrument or Instrument()), measurements, rows)
        base = view.setup.instrument.in_base(view.line.tip, view.sessions)
        begun: dict[ArmParameter, float] = {}
        if not tracked:
            begun = sensor_start(view)
            sensors = [one for one in declared_blocks(view.setup, measurements) if one.kind is ParameterKind.SENSOR]
            placed = view.setup
            for block in sensors:
                placed = block.apply(placed, np.array([begun[one] for one in block.parameters]))
            view = look(placed, measurements, rows, line=view.line)
        elif arm.measurement.frame != "base":
            placed = placed_rigidly(view.setup, base, measurements, rows, view.line.tip[:, :3, :3])
            turned = not np.allclose(placed.arm.robot.gravity, arm.robot.gravity)
            view = look(placed, measurements, rows, line=None if turned else view.line)
        blocks = [one for one in declared_blocks(view.setup, measurements) if not keep or one.kind in FRAMES]
        where = view.foremost if tracked else slice(None)
        parts = [block.jacobian(view)[:, where] for block in blocks]
    except ArmflexError:
        return None
    residual = view.residual[:, where]
    jacobian = np.concatenate([np.zeros((*residual.shape, 0)), *parts], axis=2)
    precision = np.concatenate([np.zeros(0), *(block.prior**-2.0 for block in blocks)])
    if not (np.isfinite(residual).all() and np.isfinite(jacobian).all()):
        return None
    reach, stated = float(np.linalg.norm(base, axis=1).max()), view.sigma[:, where]
    sizes = {"m": reach, "rad": 1.0, "m/s^2": STANDARD_GRAVITY}
    size = np.concatenate([np.full(kind.dimension, sizes[kind.unit]) for kind in view.readings.kinds])[where]
    fine = np.maximum(np.minimum(stated, COARSE * size), FINE * size)
    coarse = np.maximum(stated, COARSE * size)
    fine[np.isinf(stated)] = np.inf
    start = np.array([begun.get(one, 0.0) for one in parameters_of(blocks)])
    ratio, rest, _ = explained(jacobian / fine[:, :, None], precision, residual / fine, start)
    wide = explained(jacobian / coarse[:, :, None], precision, residual / coarse, start)[0] if in_general else ratio
    left = float(np.median(np.linalg.norm(np.where(np.isinf(fine), 0.0, rest * fine), axis=1)))
    placed_off = float(np.sqrt(np.median((residual**2).sum(axis=1))))
    free = any(one.kind not in FRAMES for one in blocks) or any(one.learn is not None for one in arm.flexures)
    return _Misfit(ratio, wide, placed_off, left, reach, free)


def explained(jacobian: Array, precision: Array, residual: Array, start: Array) -> tuple[float, Array, Array]:
    """Return the misfit of (M, n) whitened residuals, what is left of them, and the (P,) values; lost beams count less.

    Args:
        jacobian: (M, n, P) whitened change of the readings per unit of a parameter.
        precision: (P,) prior precisions, 0 where nothing was known.
        residual: (M, n) whitened residuals.
        start: (P,) values at which they are.

    The priors are about values that are (P,) `start` less than those at which the residuals are.
    """
    weights, left = np.ones(len(residual)), residual
    values, flat = np.zeros(len(precision)), jacobian.reshape(residual.size, len(precision))
    for _ in range(ROUNDS):
        root = np.repeat(np.sqrt(weights), residual.shape[1])
        if len(precision):
            weighted = flat * root[:, None]
            score = weighted.T @ (residual.ravel() * root) - precision * start
            values = LinearGaussian.of(weighted, precision).solve(score)
        left = residual - jacobian @ values
        length = np.linalg.norm(left, axis=1)
        weights = np.minimum(1.0, 3.0 * max(float(np.median(length)), 1e-9) / np.maximum(length, 1e-300)) ** 2
    misfit = (weights[:, None] * left**2).sum() / (residual.shape[1] * weights.sum())
    return float(misfit + (precision * (values + start) ** 2).sum() / residual.size), left, values + start


def _tips(arm: Arm, measurements: Measurements, rows: np.ndarray) -> Array:
    """Return the (M, 4, 4) tip poses of rows, to first order in how the arm bends."""
    known, some = known_rows(arm, measurements), measurements.some(rows)
    given = {name: values[rows] for name, values in known.items()}
    how = {"method": "first_order", "enforce_limits": False, "allow_large": True}
    return arm.deflection(some.q, some.payload, covariates=given, wrenches=some.wrenches, **how).pose


def _placed_off(arm: Arm, measurements: Measurements, rows: np.ndarray) -> float:
    """Return how far the median point is off, only the instrument placed [m]; infinite where the arm has no answer."""
    instrument, some = arm.instrument or Instrument(), measurements.some(rows)
    try:
        tip = _tips(arm, measurements, rows)
    except ArmflexError:
        return np.inf
    if arm.measurement.frame != "base":
        instrument = placed_rigidly(
            Setup(arm, instrument), instrument.in_base(tip, some.session), measurements, rows
        ).instrument
    left = measurements.position[rows] - instrument.readings(tip, some.session)
    return float(np.sqrt(np.median((left**2).sum(axis=1))))


def _check_sigma(measurements: Measurements, rows: np.ndarray, found: _Misfit) -> None:
    """Raise where standard deviations are far above what is left, or far below the scatter of repeats."""
    stated = float(np.median(measurements.sigma[rows]))
    if stated > COARSE * found.reach and found.left < EXACT * stated:
        text = f"readings are stated to {in_mm(stated)}, and are {in_mm(found.left)} off the fitted arm"
        raise ConventionError(f"{text}: mm instead of m? (write sigma_mm into the header)", ["sigma is in mm"])
    again = repeats(measurements.some(rows)) if stated < FINE * found.reach else None
    if again is not None and again.same_session.freedom >= 3 and again.same_session.ratio.min() > SCATTERED:
        scatter = float(np.sqrt((again.same_session.sigma**2).mean()))
        text = f"readings of one pose scatter by {in_mm(scatter)}, and are stated to {in_mm(stated)}"
        raise ConventionError(f"{text}: give sigma the unit that its header says", ["sigma is too small"])


def _said(
    measurements: Measurements, rows: np.ndarray, found: _Misfit | None, likely: Sequence[tuple[_Misfit, Hypothesis]]
) -> str:
    """Return what is wrong, what it would be, and how it is written right."""
    where = f"{measurements.places[rows[0]].file}: " if measurements.places and measurements.places[rows[0]] else ""
    if found is None:
        begun = "the arm has no equilibrium at these rows as they are declared"
    else:
        begun = f"readings are {in_mm(found.placed)} off the arm, further than [prior] explains"
    told = [f"{one.name}? Then they are {in_mm(other.placed)} off: {one.remedy}" for other, one in likely]
    return f"{where}{begun}. " + "; or ".join([told[0][0].upper() + told[0][1:], *told[1:]])


def _rewritten(by: Array, shift: Array | float = 0.0) -> Callable[[Arm, Measurements], Told]:
    """Return the change of joint positions to q times a (nq, nq) matrix and a (nq,) shift."""
    return lambda arm, measurements: (arm, replace(measurements, q=measurements.q @ by + shift))


def _read_apart(step: int) -> Callable[[Arm, Measurements], Told]:
    def told(arm: Arm, measurements: Measurements) -> Told:
        measured, kinds = np.flatnonzero(measurements.measured), []
        for kind in measurements.readings.kinds:  # an orientation has a row of its own, as ever
            if isinstance(kind, Position) or kind.name:
                after = np.arange(len(measurements))
                after[measured] = np.roll(measured, -step)
                kind = replace(kind, values=kind.values[after], sigma=kind.sigma[after] if kind.name else kind.sigma)
            kinds.append(kind)
        return arm, Measurements.of(measurements, replace(measurements.readings, kinds=tuple(kinds)))

    return told


def _mirrored(arm: Arm, measurements: Measurements) -> Told:
    return arm, replace(measurements, position=measurements.position * [1.0, 1.0, -1.0])


def _placed_anywhere(arm: Arm, measurements: Measurements) -> Told:
    return replace(arm, measurement=replace(arm.measurement, frame="unknown")), measurements


def _payloads_exchanged(one: str, other: str) -> Callable[[Arm, Measurements], Told]:
    names = {one: other, other: one}

    def told(arm: Arm, measurements: Measurements) -> Told:
        return arm, replace(measurements, payload=tuple(names.get(name, name) for name in measurements.payload))

    return told


def _masses_times(factor: float) -> Callable[[Arm, Measurements], Told]:
    def told(arm: Arm, measurements: Measurements) -> Told:
        heavy = {name: replace(payload, mass=factor * payload.mass) for name, payload in arm.payloads.items()}
        return replace(arm, payloads=heavy), measurements

    return told


def _compliance_times(factor: float) -> Callable[[Arm, Measurements], Told]:
    def told(arm: Arm, measurements: Measurements) -> Told:
        row, factors = anywhere(arm.robot), np.full(6, np.sqrt(factor))
        flexures = tuple(
            replace(one, law=scaled(one.law, factors)) if one.law.freed(row) else one for one in arm.flexures
        )
        return replace(arm, flexures=flexures), measurements

    return told
