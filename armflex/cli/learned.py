"""What `calibrate` says of the laws that it learned."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from armflex.cli.tables import console, number, print_table
from armflex.estimate import Calibration
from armflex.estimate.law_block import learned_laws
from armflex.estimate.learned import LearnedAxis, learned_axes
from armflex.estimate.sample import LawSamples
from armflex.parameters import Kind


def print_laws(found: Calibration, samples: LawSamples | None) -> None:
    """Print a line for every axis that the readings told something about, and name the others."""
    axes = _axes(found, samples)
    if not axes:
        return
    told = [axis for axis in axes if axis.told]
    columns = ["flexure", "axis", "declared", "learned", "bent", "± std", "unit", *(["sampled"] if samples else [])]
    print_table("Laws learned: RMS over the loads seen", columns, map(_cells, told))
    left = ", ".join(f"{axis.flexure} {axis.axis}" for axis in axes if not axis.told)
    if left:
        console().print(f"Hardly told by these readings, held by what was declared: {left}.")
    if samples is not None:
        said = samples.diagnostics
        console().print(f"Sampled: R-hat {said.rhat_max:.3f}, {said.ess_min:.0f} effective draws or more.")


def _cells(axis: LearnedAxis) -> list[str]:
    linear, unit = axis.axis.startswith("d"), "µm" if axis.axis.startswith("d") else "mrad"
    sizes = [axis.declared, axis.learned, axis.correction, axis.std]
    cells = [number(size * (1e6 if linear else 1e3), 3) for size in sizes]
    sampled = [] if axis.sampled is None else [number(axis.sampled * (1e6 if linear else 1e3), 3)]
    return [axis.flexure, axis.axis, *cells, unit, *sampled]


def laws_json(found: Calibration, samples: LawSamples | None) -> list[dict[str, Any]]:
    """Return the same for programs, in m and rad."""
    return [asdict(axis) | {"told": axis.told} for axis in _axes(found, samples)]


def _axes(found: Calibration, samples: LawSamples | None) -> tuple[LearnedAxis, ...]:
    settled = {name: law for name, law in learned_laws(found.arm).items() if law.spread is not None}
    return learned_axes(found.fit, settled, samples) if settled and not _kept(found) else ()


def _kept(found: Calibration) -> bool:
    """Return whether the laws stay as an earlier campaign taught them."""
    return not any(p.kind is Kind.LAW for p in found.parameters)
