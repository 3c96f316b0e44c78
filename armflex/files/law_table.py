"""[calibration.law.NAME] in an arm.toml: what was learned of a flexure's law, and under which loads."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.laws.flexure import Flexure
from armflex.laws.learned import LearnedLaw, Seen, learned_law
from armflex.laws.learned.correction import NEAREST

SHAPES = {"mean": (6,), "precision": (6, 6), "loads": (2, 6), "load_scale": (6,), "twist_scale": (6,)}
"""Names and shapes of a `Seen`'s arrays."""

ROUNDING = 1e-6
"""Of a matrix written and read, relative to its diagonal."""


def law_table(law: LearnedLaw) -> dict[str, Any]:
    """Return the table of a learned law."""
    found = {"values": law.values.tolist(), "scales": list(law.scales)}
    found |= {name: getattr(law.seen, name).tolist() for name in SHAPES}
    if law.reach is None:
        return found
    found |= {"reach": law.reach.tolist(), "faded": law.seen.faded}
    return found | ({} if law.seen.energy is None else {"energy": law.seen.energy.tolist()})


def read_learned(flexure: Flexure, table: Declaration) -> Flexure:
    """Return a flexure with what was learned of its law, but for how well that is known.

    Args:
        flexure: As declared, with `learn = true`.
        table: Its [calibration.law.NAME].

    Raises:
        ArmFileError: The flexure is not learned any more, or is another than the one that was, or a number is none that
            learning leaves.
    """
    if flexure.learn is None:
        raise table.fail("values", f"flexure {flexure.name!r} has no learn = true: not what was calibrated")
    law = learned_law(flexure.law, flexure.learn, _seen(table))
    values, scales = table.numbers("values", law.values.shape), _positive(table, "scales", (len(law.scales),))
    law = replace(law, values=values, scales=tuple(scales.tolist()))
    if table.has("reach"):
        law = _ended(table, law)
    table.finish()
    return replace(flexure, law=law)


def _seen(table: Declaration) -> Seen:
    found = {name: table.numbers(name, shape) for name, shape in SHAPES.items()}
    _positive(table, "load_scale", (6,))
    _not_below_zero(table, "twist_scale", found["twist_scale"])
    _definite(table, "precision", found["precision"])
    return Seen(**found)


def _ended(table: Declaration, law: LearnedLaw) -> LearnedLaw:
    """Return the law with how its correction ends; files before `energy` was part of that have none."""
    reach, faded = table.numbers("reach", (6,)), table.number("faded")
    _not_below_zero(table, "reach", reach)
    if faded < NEAREST:
        raise table.fail("faded", f"expected {NEAREST:g} or more, got {faded:g}")
    energy = table.numbers("energy", (6, 6)) if table.has("energy") else None
    if energy is not None:
        _definite(table, "energy", energy)
    return replace(law, reach=reach, seen=replace(law.seen, faded=faded, energy=energy))


def _positive(table: Declaration, key: str, shape: tuple[int, ...]) -> Array:
    found = table.numbers(key, shape)
    if not (found > 0.0).all():
        raise table.fail(key, f"expected numbers above 0, got {found.min():g}")
    return found


def _not_below_zero(table: Declaration, key: str, found: Array) -> None:
    if (found < 0.0).any():
        raise table.fail(key, f"expected no number below 0, got {found.min():g}")


def _definite(table: Declaration, key: str, found: Array) -> None:
    """Raise where a (6, 6) matrix of forces and moments, in units of its own diagonal, is none of a distance."""
    size = np.sqrt(np.maximum(np.diag(found), 0.0))
    unit = np.where(size > 0.0, size, 1.0)
    scaled = found / np.outer(unit, unit)
    if np.abs(scaled - scaled.T).max() > ROUNDING or np.linalg.eigvalsh(scaled)[0] < -ROUNDING:
        raise table.fail(key, "expected a symmetric matrix without negative eigenvalues")
