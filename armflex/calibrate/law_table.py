"""[calibration.law.NAME] in an arm.toml: what was learned of a flexure's law, and under which loads."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from armflex.arm import Arm
from armflex.calibrate.law_block import learned_laws
from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.flexure import Flexure
from armflex.laws.learned import LearnedLaw, Seen, learned_law

SHAPES = {"mean": (6,), "precision": (6, 6), "loads": (2, 6), "load_scale": (6,), "twist_scale": (6,)}
"""Names and shapes of a `Seen`'s arrays."""


def law_tables(arm: Arm) -> dict[str, dict[str, Any]]:
    """Return a table for every learned law of an arm."""
    return {name: _table(law) for name, law in learned_laws(arm).items()}


def _table(law: LearnedLaw) -> dict[str, Any]:
    seen = {name: getattr(law.seen, name).tolist() for name in SHAPES}
    found = {"values": law.values.tolist(), "scales": list(law.scales)}
    return found | seen | ({} if law.reach is None else {"reach": law.reach.tolist(), "faded": law.faded})


def read_learned(flexure: Flexure, table: Declaration, covariance: Array | None) -> Flexure:
    """Return a flexure with what was learned of its law.

    Args:
        flexure: As declared, with `learn = true`.
        table: Its [calibration.law.NAME].
        covariance: (k, k) of the values, None where it is not known.

    Raises:
        ArmFileError: The flexure is not learned any more, or is another than the one that was.
    """
    if flexure.learn is None:
        raise table.fail("values", f"flexure {flexure.name!r} has no learn = true: not what was calibrated")
    law = learned_law(flexure.law, flexure.learn, Seen(**{n: table.numbers(n, shape) for n, shape in SHAPES.items()}))
    values, scales = table.numbers("values", law.values.shape), table.numbers("scales", (len(law.scales),))
    reach = table.numbers("reach", (6,)) if table.has("reach") else None
    faded = table.number("faded") if reach is not None else law.faded
    table.finish()
    found = {"scales": tuple(scales.tolist()), "spread": covariance, "reach": reach, "faded": faded}
    return replace(flexure, law=replace(law, values=values, **found))
