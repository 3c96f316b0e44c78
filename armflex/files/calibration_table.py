"""[calibration] in an arm.toml: what a fit found, applied to what was declared where it is read, and how sure that is.

`parameters` names what the rows of `covariance` are of: block and parameter, 'compliance A4 ry'. An effect's are
'effect LAW SITE AXIS PARAMETER'; where the file has several [[effect]]s of one law, site and axis, those from the
second on have their number before the parameter, in the order of the file: 'effect gear_harmonic A2 rz #2 k'.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from armflex.arm import Arm, Setup
from armflex.conventions import TWIST_NAMES, Array, covariance_fault
from armflex.declaration import Declaration
from armflex.errors import FileError, Flag, did_you_mean, listing
from armflex.laws.declared import Flexure, soft
from armflex.laws.effects.location import site_names
from armflex.laws.joint.carried import scaled
from armflex.laws.law import anywhere
from armflex.laws.learned import LearnedLaw, Seen, learned_law
from armflex.laws.learned.correction import NEAREST
from armflex.parameters import (
    CARRIED,
    TARGET,
    ArmParameter,
    Certainty,
    ParameterGroup,
    ParameterKind,
    beyond_priors,
    of_compliance,
    of_law,
    of_masses,
    of_motions,
    of_offsets,
    of_springs,
)
from armflex.readings.instrument import Instrument, frame_of, motion_of
from armflex.robot import Corrections
from armflex.rows.period import Period
from armflex.storage.array_file import Layout, read_arrays, write_arrays
from armflex.storage.schema import Numbers

LARGEST_LOGARITHM = 200.0
"""Of the factor by which a compliance was found to be softer or stiffer; what nothing determines may wander far."""
UNFINISHED = "written when `armflex trace` was interrupted: more effects may be missing, none was compared"

REMARKS = {
    "joint_offset": "added to the controller's positions [rad or m]",
    "geometry": "shift [m] and rotation vector [rad] before the joint",
    "compliance": "natural logarithms of the factors on the declared compliances dx dy dz rx ry rz: 0 is as declared",
    "mass": "natural logarithms of the factors on the declared masses: 0 is as declared",
    "spring": "by which share the rate or pressure is higher, and how much longer the spring is [m]",
    "sessions": "shift [m] and rotation vector [rad] of the instrument's frame",
    "targets": "shift [m] and rotation vector [rad] of the target on the tool",
}
"""What the tables of a written [calibration] say of their numbers, in a comment."""

SHAPES = {"mean": (6,), "precision": (6, 6), "loads": (2, 6), "load_scale": (6,), "twist_scale": (6,)}
"""Names and shapes of a `Seen`'s arrays."""

ROUNDING = 1e-6
"""Of a matrix written and read, relative to its diagonal."""


@dataclass(frozen=True)
class Campaign:
    """What an arm was fitted to, as its file says it.

    Attributes:
        sha256: Of the measurements.
        rows: How many of them its error is over.
        rms: RMS of the 3-D position error over those [m].
        clock: When they were taken.
    """

    sha256: str
    rows: int
    rms: float
    clock: tuple[Period, ...] = ()


def calibration_table(arm: Arm, campaign: Campaign, unfinished: bool = False) -> dict[str, Any]:
    """Return the [calibration] table of a fitted arm: the declared parameters' values, and their covariance.

    Args:
        arm: With its instrument and its certainty. What effects change in it is in their own tables alone, so that
            nothing is applied twice.
        campaign: What it was fitted to.
        unfinished: Whether a search for what it lacks was ended at once.
    """
    assert arm.instrument is not None and arm.certainty is not None
    instrument, corrections = arm.instrument, arm.corrections
    table = {"unfinished": True} if unfinished else {}
    table |= {
        "measurements_sha256": campaign.sha256,
        "rows": campaign.rows,
        "rms_m": campaign.rms,
        "instrument": motion_of(instrument.pose).tolist(),
        "target": instrument.target.tolist(),
        "scale": instrument.scale,
        "mounting": instrument.mounting.tolist(),
        "joint_offset": dict(corrections.joint_offset),
        "geometry": {name: values.tolist() for name, values in corrections.geometry.items()},
        "compliance": {name: values.tolist() for name, values in arm.factors.items()},
        "sessions": {name: values.tolist() for name, values in instrument.sessions.items()},
    }
    if campaign.clock:
        table["clock"] = [
            {key: value for key, value in vars(period).items() if value or key in ("first", "last")}
            for period in campaign.clock
        ]
    if arm.masses:
        table["mass"] = dict(arm.masses)
    springs = {spring.name: list(spring.law.found) for spring in arm.springs if any(spring.law.found)}
    if springs:
        table["spring"] = springs
    if instrument.targets:
        table["targets"] = {name: values.tolist() for name, values in instrument.targets.items()}
    if instrument.campaigns:
        table["campaigns"] = list(instrument.campaigns)
    deviations = {name: sensor.found for name, sensor in arm.sensors.items() if sensor.found}
    if deviations:
        table["sensors"] = {
            name: {session: values.tolist() for session, values in by_session.items()}
            for name, by_session in deviations.items()
        }
    laws = {flexure.name: law_table(flexure.learned) for flexure in arm.flexures if flexure.learned}
    return table | ({"law": laws} if laws else {}) | certainty_table(arm.certainty)


def read_calibration(table: Declaration, arm: Arm) -> Arm:
    """Return an arm with its [calibration] table applied, but for how well that is known; see `with_certainty`.

    Values of a wrong shape, and joints or flexures that the arm does not have, are refused.
    """
    springs, sensors = {spring.name: spring for spring in arm.springs}, dict(arm.sensors)
    offset, geometry, compliance = (table.sub(name) for name in ("joint_offset", "geometry", "compliance"))
    laws, mass, spring, read = (table.part(name) for name in ("law", "mass", "spring", "sensors"))
    for part, what, names in (
        (laws, "", arm.flexure_names),
        (mass, "", arm.weighing),
        (offset, "", arm.joint_names),
        (geometry, "", arm.robot.frames),
        (compliance, "", arm.flexure_names),
        (read, "instrument ", sensors),
        (spring, "spring ", springs),
    ):
        part.among(names, f"the arm has no {what}{{!r}}")
    instrument = _read_instrument(table)
    for name in read.table:
        sensors[name] = replace(sensors[name], found=read.sub(name).by_name(len(sensors[name].declared)))
    corrections = Corrections({name: offset.number(name) for name in offset.table}, geometry.by_name(6))
    if table.has("measurements_sha256") and not isinstance(table.raw("measurements_sha256"), str):
        raise table.fail("measurements_sha256", "expected a text")
    for key in ("rows", "rms_m"):  # of which, as of the digest, nothing is computed
        if table.number(key, 0.0) < 0.0:
            raise table.fail(key, f"expected 0 or more, got {table.number(key):g}")
    clock = tuple(_read_period(period) for period in (table.array_of("clock") if table.has("clock") else ()))
    flags = (Flag("unfinished", f"{table.place()}: {UNFINISHED}"),) if table.flag("unfinished") else ()
    factors = _logarithms(compliance, 6)
    masses = {name: float(value) for name, value in _logarithms(mass).items()}
    for name in spring.table:
        springs[name] = springs[name].moved(spring.numbers(name, (len(springs[name].law.parameters),)))
    arm = replace(arm, springs=tuple(springs.values()))
    arm, flexures = arm.with_masses(masses) if masses else arm, []
    for flexure in arm.flexures:
        if flexure.name in factors:
            flexure = replace(flexure, law=scaled(flexure.law, np.exp(0.5 * factors[flexure.name])))
        flexures.append(read_learned(flexure, laws.sub(flexure.name)) if flexure.name in laws.table else flexure)
    return replace(
        Setup(arm, Instrument()).placed(instrument.pose).arm,
        flexures=tuple(flexures),
        corrections=corrections,
        factors=factors,
        instrument=instrument,
        clock=clock,
        sensors=sensors,
        flags=(*arm.flags, *flags),
    )


def _logarithms(part: Declaration, *shape: int) -> dict[str, Array]:
    """Return the logarithms of factors under every key of a table."""
    for name, values in (by_name := part.by_name(*shape)).items():
        if np.abs(values).max() > LARGEST_LOGARITHM:
            text = f"logarithms of factors, none beyond {LARGEST_LOGARITHM:g}, got {values.tolist()}"
            raise part.fail(name, text)
    return by_name


def _read_period(table: Declaration) -> Period:
    names = [table.text(name, "") for name in ("campaign", "sha256", "begins")]
    first, last, later = table.number("first"), table.number("last"), table.number("later", 0.0)
    if last < first:
        raise table.fail("last", f"expected the {first:g} s of 'first' or later, got {last:g} s")
    if names[2]:
        try:
            datetime.fromisoformat(names[2])
        except ValueError:
            raise table.fail("begins", f"expected a date (ISO 8601), got {names[2]!r}") from None
    table.finish()
    return Period(names[0], names[1], first, last, names[2], later)


def _read_instrument(table: Declaration) -> Instrument:
    pose, sessions = table.numbers("instrument", (6,)), table.sub("sessions")
    turn = float(np.linalg.norm(pose[3:]))
    if turn > 2.0 * np.pi:
        raise table.fail("instrument", f"a rotation vector of {turn:g} rad is more than a turn: degrees?")
    scale = table.number("scale", 0.0)
    if abs(scale) >= 1.0:
        raise table.fail("scale", f"a relative error of the instrument's lengths, got {scale:g}")
    campaigns = table.texts("campaigns") if table.has("campaigns") else ()
    for name in campaigns:
        if name not in sessions.table:
            raise table.fail("campaigns", f"[calibration.sessions] has no {name!r}{did_you_mean(name, sessions.table)}")
    return Instrument(
        frame_of(pose),
        sessions.by_name(6),
        table.numbers("target", (3,)),
        scale,
        table.numbers("mounting", (3,)) if table.has("mounting") else np.zeros(3),
        table.part("targets").by_name(6),
        campaigns,
    )


def with_certainty(table: Declaration, arm: Arm) -> Arm:
    """Return an arm, its effects in it, with how well its [calibration] table says that it is known.

    Refused are parameters that no fit names so, what is no covariance of them, and keys that are not known.
    """
    certainty = read_certainty(table, arm)
    table.finish()
    if certainty is None:
        return arm
    learned = {flexure.name: flexure.learned for flexure in arm.flexures if flexure.learned}
    laws = {name: replace(law, posterior=certainty.among(of_law(name, law))) for name, law in learned.items()}
    changed = [
        replace(flexure, law=laws[flexure.name]) if flexure.name in laws else flexure for flexure in arm.flexures
    ]
    return replace(arm, flexures=tuple(changed), certainty=certainty)


def doubts(table: Declaration, arm: Arm) -> Iterator[Flag]:
    """Yield flags about what [calibration] made of an arm that no campaign is likely to have shown."""
    corrections, tool = arm.corrections, np.zeros(3) if arm.instrument is None else arm.instrument.target
    offsets = of_offsets(arm.robot)
    zeros = [corrections.joint_offset.get(str(offset.group.of), 0.0) for offset in offsets]
    deviating = [(offsets, zeros, arm.prior.joint_offset)]
    for name, values in corrections.geometry.items():
        deviating.append((of_motions(ParameterKind.GEOMETRY, [name]), values.tolist(), arm.prior.geometry))
    deviating += [(of_compliance(name), values.tolist(), arm.prior.compliance) for name, values in arm.factors.items()]
    for name, value in arm.masses.items():
        deviating.append(
            (of_masses([name]), [value], getattr(arm.prior, "payload_mass" if name.startswith(CARRIED) else "mass"))
        )
    for parameter in of_springs(arm.springs):
        deviating.append(((parameter,), [arm.found(parameter)], arm.prior.of(parameter)[1]))
    deviating.append((TARGET, tool.tolist(), arm.prior.tool))
    sizes = [
        (parameter.label, abs(value) / std)
        for parameters, values, std in deviating
        if std
        for parameter, value in zip(parameters, values, strict=True)
    ]
    unknown = () if arm.certainty is None else arm.certainty.undetermined  # their values say nothing
    yield from beyond_priors({label: size for label, size in sizes if label not in unknown})
    yield from soft(
        (flexure for flexure in arm.flexures if flexure.name in arm.factors), anywhere(arm.robot), arm.flags
    )
    if arm.certainty is not None and (moved := _displaced(arm.certainty.parameters, offsets)):
        text = f"{moved.label!r} is not where a fit writes it: are names of parameters exchanged?"
        yield Flag("parameters_exchanged", f"{table.place('parameters')}: {text}", moved.label)


def _displaced(parameters: Sequence[ArmParameter], offsets: Sequence[ArmParameter]) -> ArmParameter | None:
    """Return the first parameter that is apart from its group, or before others that a fit has before it."""
    met: set[ParameterGroup] = set()
    for before, parameter in pairwise(parameters):
        met.add(before.group)
        for order in (offsets, of_motions(parameter.group.kind, [parameter.group.of])):
            if before in order and parameter in order and order.index(parameter) < order.index(before):
                return parameter
        if parameter.group != before.group and parameter.group in met:
            return parameter
    return None


def law_table(law: LearnedLaw) -> dict[str, Any]:
    """Return the table of a learned law."""
    content = {"values": law.values.tolist(), "scales": list(law.scales)}
    content |= {name: getattr(law.seen, name).tolist() for name in SHAPES}
    if law.reach is None:
        return content
    content |= {"reach": law.reach.tolist(), "faded": law.seen.faded}
    return content | ({} if law.seen.energy is None else {"energy": law.seen.energy.tolist()})


def read_learned(flexure: Flexure, table: Declaration) -> Flexure:
    """Return a flexure, `learn = true`, with what [calibration.law.NAME] says was learned of its law, but for how well.

    Refused are one that is not learned any more, one other than that which was, and numbers that learning cannot leave.
    """
    if flexure.learn is None:
        raise table.fail("values", f"flexure {flexure.name!r} has no learn = true: not what was calibrated")
    arrays = {name: table.numbers(name, shape) for name, shape in SHAPES.items()}
    seen: dict[str, Any] = arrays
    _positive(table, "load_scale", arrays["load_scale"])
    _not_below_zero(table, "twist_scale", arrays["twist_scale"])
    _definite(table, "precision", arrays["precision"])
    law = learned_law(flexure.law, flexure.learn, Seen(**seen))
    values, scales = table.numbers("values", law.values.shape), table.numbers("scales", (len(law.scales),))
    _positive(table, "scales", scales)
    free = () if law.free is None else law.free.parameters
    for parameter, value in zip(free, values[: len(free)], strict=True):
        if parameter.unit == "1" and abs(value) > LARGEST_LOGARITHM:
            text = f"{parameter.name} is the logarithm of a factor, or of a coupling: expected at most"
            raise table.fail("values", f"{text} {LARGEST_LOGARITHM:.3g} either way, got {value:g}")
    law = replace(law, values=values, scales=tuple(scales.tolist()))
    if table.has("reach"):  # how its correction ends
        reach, faded = table.numbers("reach", (6,)), table.number("faded")
        _not_below_zero(table, "reach", reach)
        if faded < NEAREST:
            raise table.fail("faded", f"expected {NEAREST:g} or more, got {faded:g}")
        energy = table.numbers("energy", (6, 6)) if table.has("energy") else None
        if energy is not None:
            _definite(table, "energy", energy)
        law = replace(law, reach=reach, seen=replace(law.seen, faded=faded, energy=energy))
    table.finish()
    return replace(flexure, law=law)


def _positive(table: Declaration, key: str, numbers: Array) -> None:
    if not (numbers > 0.0).all():
        raise table.fail(key, f"expected numbers above 0, got {numbers.min():g}")


def _not_below_zero(table: Declaration, key: str, numbers: Array) -> None:
    if (numbers < 0.0).any():
        raise table.fail(key, f"expected no number below 0, got {numbers.min():g}")


def _definite(table: Declaration, key: str, matrix: Array) -> None:
    """Raise where a (6, 6) matrix of forces and moments, in units of its own diagonal, is none of a distance."""
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    unit = np.where(size > 0.0, size, 1.0)
    scaled = matrix / np.outer(unit, unit)
    if np.abs(scaled - scaled.T).max() > ROUNDING or np.linalg.eigvalsh(scaled)[0] < -ROUNDING:
        raise table.fail(key, "expected a symmetric matrix without negative eigenvalues")


BLOCKS = tuple(kind.value for kind in ParameterKind if kind is not ParameterKind.UNEXPLAINED)
"""What the name of every fitted parameter begins with."""

LAYOUT = Layout(
    "the covariance of a calibrated arm",
    "armflex-covariance-1",
    {"covariance": Numbers(("parameters", "parameters"), covariance=True)},
    {"parameters": tuple[str, ...]},
    lambda about: {"parameters": (len(about["parameters"]),)},
    anew="calibrate the arm anew",
    most_bytes=130_000_000,
)
"""Of 4000 parameters at most, so that it is proven positive within seconds."""


def certainty_table(certainty: Certainty) -> dict[str, Any]:
    """Return what of [calibration] says how well the parameters are known, the covariance as an array."""
    table: dict[str, Any] = {}
    if certainty.misfit:
        table["misfit_m"] = certainty.misfit
    if certainty.design_effect > 1.0:
        table["design_effect"] = certainty.design_effect
    if certainty.unexplained:
        every = [dict(zip(("site", "axis", "std"), term, strict=True)) for term in certainty.unexplained]
        table["unexplained"] = every if len(every) > 1 else every[0]
    if certainty.payloads:
        table["payloads"] = list(certainty.payloads)
    table["parameters"] = list(certainty.labels)
    if certainty.directions is not None:
        table["undetermined"] = certainty.directions.tolist()
    return table | {"covariance": certainty.covariance}


def with_covariance(table: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return [calibration] as the file at `path` is to have it: its covariance as rows of the lower triangle.

    A large one is written to a file beside it.
    """
    covariance = table["covariance"]
    # Parameters from which on their covariance stands in a file of its own: as text it would take seconds to read
    if len(covariance) <= 150:
        return table | {"covariance": [row[: i + 1].tolist() for i, row in enumerate(covariance)]}
    beside = path.with_suffix(".covariance.safetensors")
    written = write_arrays(beside, LAYOUT, {"covariance": covariance}, {"parameters": table["parameters"]})
    others = {key: value for key, value in table.items() if key != "covariance"}
    return others | {"covariance_file": beside.name, "covariance_sha256": written}


def read_certainty(table: Declaration, arm: Arm) -> Certainty | None:
    """Return the covariance of the fitted parameters; None where it is not given.

    Args:
        table: [calibration].
        arm: With everything that its file declares, effects and learned laws, too: parameters are looked up in it. One
            that it has no more (another preset) is kept as what it is called.
    """
    misfit, effect = table.std("misfit_m", 0.0), table.number("design_effect", 1.0)
    payloads = table.texts("payloads") if table.has("payloads") else ()
    if effect < 1.0:
        raise table.fail("design_effect", f"expected 1 or more, got {effect:g}")
    if not all([table.has("parameters"), table.has("covariance") or table.has("covariance_file")]):
        return None
    labels = table.texts("parameters")
    if len(set(labels)) < len(labels):
        raise table.fail("parameters", "a parameter is named twice")
    for label in [label for label in labels if label.partition(" ")[0] not in BLOCKS or not label.partition(" ")[2]]:
        hint = did_you_mean(label.partition(" ")[0], BLOCKS)
        raise table.fail("parameters", f"{label!r} is no parameter of a fit{hint} (they begin: {listing(BLOCKS)})")
    key = "covariance_file" if table.has("covariance_file") else "covariance"
    if key == "covariance_file":
        covariance = _from_file(table, labels)
    else:  # the rows of its lower triangle
        expected = f"{len(labels)} rows of 1, 2, ... finite numbers, one for each of the parameters"
        covariance, below = np.zeros((len(labels), len(labels))), np.tril_indices(len(labels))
        covariance[below] = np.concatenate([np.zeros(0), *table.ragged(key, range(1, len(labels) + 1), expected)])
        covariance.T[below] = covariance[below]
        if fault := covariance_fault(covariance):
            raise table.fail(key, fault)
    directions = None
    if table.has("undetermined"):  # directions that nothing determined
        given = table.raw("undetermined")
        lengths = [len(labels)] * len(given) if isinstance(given, list) else []
        expected = f"rows of {len(labels)} finite numbers, one for each of the parameters"
        directions = np.array(table.ragged("undetermined", lengths, expected))
        directions = directions if len(directions) else None
    determined = np.ones(len(labels), dtype=bool) if directions is None else ~directions.any(axis=0)
    if (determined & (np.diag(covariance) == 0.0)).any():
        label = labels[int((determined & (np.diag(covariance) == 0.0)).argmax())]
        raise table.fail(key, f"the variance of {label!r} is zero, which no campaign leaves")
    unexplained = []
    several = isinstance(table.table.get("unexplained"), list)
    single = [table.sub("unexplained")] if table.has("unexplained") and not several else []
    for part in table.array_of("unexplained") if several else single:
        site, axis = part.choice("site", site_names(arm.robot)), part.choice("axis", TWIST_NAMES)
        unexplained.append((site, axis, part.std("std")))
        part.finish()
    return Certainty(arm.named(labels), covariance, tuple(unexplained), directions, misfit, effect, payloads)


def _from_file(table: Declaration, labels: tuple[str, ...]) -> Array:
    """Return a covariance from the safetensors file beside the arm.toml, whose layout says that it must be one."""
    path = table.path.parent / table.text("covariance_file")
    digest = table.text("covariance_sha256")
    try:
        content = read_arrays(path, LAYOUT)
    except FileError as error:
        raise table.fail("covariance_file", f"{path.name} {error.problem}") from None
    if content.digest != digest or content.about["parameters"] != labels:
        problem = f"{path.name} is not the file that was written with this table: {LAYOUT.anew}"
        raise table.fail("covariance_file", problem)
    return content.arrays["covariance"]
