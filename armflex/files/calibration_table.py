"""[calibration] in an arm.toml: what a fit found, applied to what was declared where it is read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from armflex.arm import Arm, Flexure
from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.errors import Flag, did_you_mean
from armflex.files.certainty_table import certainty_table, read_certainty
from armflex.files.law_table import law_table, read_learned
from armflex.laws.joint.scaled import scaled
from armflex.parameters import of_law
from armflex.readings.instrument import Instrument
from armflex.robot import Corrections

LARGEST_LOGARITHM = 200.0
"""Of the factor by which a compliance was found to be softer or stiffer; what nothing determines may wander far."""
UNFINISHED = "written while `armflex trace` was still searching: more effects may be missing, none was compared"


@dataclass(frozen=True)
class Campaign:
    """What an arm was fitted to, as its file says it.

    Attributes:
        sha256: Of the measurements.
        rows: How many of them its error is over.
        rms: RMS of the 3-D position error over those [m].
    """

    sha256: str
    rows: int
    rms: float


def calibration_table(arm: Arm, campaign: Campaign, unfinished: bool = False) -> dict[str, Any]:
    """Return the [calibration] table of a fitted arm: the declared parameters' values, and their covariance.

    Args:
        arm: With its instrument and its certainty. What effects change in it is in their own tables alone, so that
            nothing is applied twice.
        campaign: What it was fitted to.
        unfinished: Whether a search for what it lacks was still going on.
    """
    assert arm.instrument is not None and arm.certainty is not None
    instrument, corrections = arm.instrument, arm.corrections
    table = {"unfinished": True} if unfinished else {}
    table |= {
        "measurements_sha256": campaign.sha256,
        "rows": campaign.rows,
        "rms_m": campaign.rms,
        "instrument": [*instrument.pose.translation.tolist(), *pin.log3(instrument.pose.rotation).tolist()],
        "target": instrument.target.tolist(),
        "scale": instrument.scale,
        "mounting": instrument.mounting.tolist(),
        "joint_offset": dict(corrections.joint_offset),
        "geometry": {name: values.tolist() for name, values in corrections.geometry.items()},
        "compliance": {name: values.tolist() for name, values in arm.factors.items()},
        "sessions": {name: values.tolist() for name, values in instrument.sessions.items()},
    }
    laws = {one.name: law_table(one.learned) for one in arm.flexures if one.learned}
    return table | ({"law": laws} if laws else {}) | certainty_table(arm.certainty)


def read_calibration(table: Declaration, arm: Arm) -> Arm:
    """Return an arm with its [calibration] table applied, but for how well that is known; see `with_certainty`.

    Raises:
        ArmFileError: A value is of the wrong shape, or names a joint or flexure that the arm does not have.
    """
    offset, geometry, compliance = (table.sub(name) for name in ("joint_offset", "geometry", "compliance"))
    laws = table.sub("law") if table.has("law") else None
    if laws is not None:
        _check_names(laws, arm.flexure_names)
    for part, known in ((offset, arm.joint_names), (geometry, arm.joint_names), (compliance, arm.flexure_names)):
        _check_names(part, known)
    instrument = _read_instrument(table)
    corrections = Corrections(
        {name: offset.number(name) for name in offset.table},
        {name: geometry.numbers(name, (6,)) for name in geometry.table},
    )
    _check_campaign(table)
    unfinished = [Flag("unfinished", f"{table.place()}: {UNFINISHED}")] if table.flag("unfinished") else []
    factors = {name: _factors(compliance, name) for name in compliance.table}
    fitted = replace(
        arm,
        flexures=tuple(_learned(_scaled(flexure, factors), laws) for flexure in arm.flexures),
        corrections=corrections,
        factors=factors,
        instrument=instrument,
        flags=(*arm.flags, *unfinished),
    )
    return _level(fitted) if arm.measurement.gravity_in == "measurement" else fitted


def _read_instrument(table: Declaration) -> Instrument:
    pose, sessions = table.numbers("instrument", (6,)), table.sub("sessions")
    turn = float(np.linalg.norm(pose[3:]))
    if turn > 2.0 * np.pi:
        raise table.fail("instrument", f"a rotation vector of {turn:g} rad is more than a turn: degrees?")
    scale = table.number("scale", 0.0)
    if abs(scale) >= 1.0:
        raise table.fail("scale", f"a relative error of the instrument's lengths, got {scale:g}")
    return Instrument(
        pin.SE3(pin.exp3(pose[3:]), pose[:3]),
        {name: sessions.numbers(name, (6,)) for name in sessions.table},
        table.numbers("target", (3,)),
        scale,
        table.numbers("mounting", (3,)) if table.has("mounting") else np.zeros(3),
    )


def _factors(table: Declaration, key: str) -> Array:
    """Return the (6,) logarithms of a flexure's factors."""
    found = table.numbers(key, (6,))
    if np.abs(found).max() > LARGEST_LOGARITHM:
        text = f"logarithms of factors, none beyond {LARGEST_LOGARITHM:g}, got {found.tolist()}"
        raise table.fail(key, text)
    return found


def _check_campaign(table: Declaration) -> None:
    """Check what the table says of the campaign, of which nothing is computed."""
    if table.has("measurements_sha256") and not isinstance(table.raw("measurements_sha256"), str):
        raise table.fail("measurements_sha256", "expected a text")
    for key in ("rows", "rms_m"):
        if table.number(key, 0.0) < 0.0:
            raise table.fail(key, f"expected 0 or more, got {table.number(key):g}")


def _check_names(table: Declaration, known: tuple[str, ...]) -> None:
    for name in table.table:
        if name not in known:
            raise table.fail(name, f"the arm has no {name!r}{did_you_mean(name, known)}")


def _scaled(flexure: Flexure, factors: Mapping[str, Array]) -> Flexure:
    if flexure.name not in factors:
        return flexure
    return replace(flexure, law=scaled(flexure.law, np.exp(0.5 * factors[flexure.name])))


def _learned(flexure: Flexure, laws: Declaration | None) -> Flexure:
    if laws is None or flexure.name not in laws.table:
        return flexure
    return read_learned(flexure, laws.sub(flexure.name))


def with_certainty(table: Declaration, arm: Arm) -> Arm:
    """Return an arm, its effects in it, with how well its [calibration] table says that it is known.

    Raises:
        ArmFileError: No fit names parameters so, what is given is no covariance of them, or a key is unknown.
    """
    certainty = read_certainty(table, arm)
    table.finish()
    if certainty is None:
        return arm
    learned = {one.name: one.learned for one in arm.flexures if one.learned}
    laws = {name: replace(law, spread=certainty.among(of_law(name, law))) for name, law in learned.items()}
    changed = [replace(one, law=laws[one.name]) if one.name in laws else one for one in arm.flexures]
    return replace(arm, flexures=tuple(changed), certainty=certainty)


def _level(arm: Arm) -> Arm:
    """Return the arm with gravity, known in the level instrument's frame, turned into its base."""
    assert arm.instrument is not None
    down = arm.instrument.pose.rotation.T @ arm.robot.gravity
    return replace(arm, robot=replace(arm.robot, gravity=down))
