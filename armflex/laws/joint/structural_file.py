"""A fitted structural law as named arrays: sub-joints linear, nodes by number."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from armflex.conventions import Array
from armflex.errors import LawError
from armflex.laws.joint.beam import Beam, Section
from armflex.laws.joint.linear import LinearFit, LinearLaw, check_compliance
from armflex.laws.joint.structural import StructuralLaw, SubJoint
from armflex.laws.law import check_ordered
from armflex.storage.schema import Numbers

SECTION = ("E", "G", "A", "Iy", "Iz", "J")
MOST = 1000
"""Nodes, sub-joints and beams at most."""

ARRAYS = {
    "nodes": Numbers(("nodes", 3)),
    "tip": Numbers((2,), least=0.0),
    "noise": Numbers((6,), least=0.0),
    "at": Numbers(("subjoints",), least=0.0),
    "holds": Numbers(("subjoints", 6), least=0.0, most=1.0),
    "compliance": Numbers(("subjoints", 6, 6)),
    "row_covariance": Numbers(("subjoints", 6, 6, 6), covariance=True),
    "loads": Numbers(("subjoints", 2, 6)),
    "beams": Numbers(("beams", 11)),
}
SIZES = {"nodes": range(1, MOST + 1), "subjoints": range(MOST + 1), "beams": range(MOST + 1)}


def to_tensors(law: StructuralLaw) -> dict[str, Array]:
    """Return a fitted law's arrays."""
    number = {name: float(i) for i, name in enumerate(law.nodes)}
    linear: list[Any] = [sub.law for sub in law.subjoints]  # as they are where a structure was fitted
    holds = np.array([[float(axis in sub.holds) for axis in range(6)] for sub in law.subjoints])
    beams = [
        [number[beam.start], number[beam.end], *(getattr(beam.section, name) for name in SECTION), *beam.up]
        for beam in law.beams
    ]
    return {
        "nodes": np.array(list(law.nodes.values()), dtype=float),
        "tip": np.array([number[law.tip], float(law.components)]),
        "noise": np.zeros(6) if law.noise is None else law.noise,
        "at": np.array([number[sub.node] for sub in law.subjoints]),
        "holds": holds,
        "compliance": np.array([law.compliance for law in linear]),
        "row_covariance": np.array([law.fit.row_covariance for law in linear]),
        "loads": np.array([law.fit.loads for law in linear]),
        "beams": np.array(beams).reshape(-1, 11),
    }


def structural_from_tensors(tensors: Mapping[str, Array]) -> StructuralLaw:
    """Return the law of arrays as declared; raise `LawError` where their numbers are not those of one."""
    nodes, subjoints = len(tensors["nodes"]), len(tensors["at"])
    names = [str(i + 1) for i in range(nodes)]
    tip, components = (int(value) for value in tensors["tip"])
    if components not in (3, 6):
        raise LawError(f"{components} components, expected 3 or 6")
    return StructuralLaw(
        dict(zip(names, tensors["nodes"], strict=True)),
        _name(names, tip),
        tuple(_subjoint(names, tensors, i) for i in range(subjoints)),
        tuple(_beam(names, row) for row in tensors["beams"]),
        components,
        tensors["noise"],
    )


def _name(names: list[str], number: float) -> str:
    if not 0 <= number < len(names) or number != int(number):
        raise LawError(f"node {number:g} of {len(names)}")
    return names[int(number)]


def _subjoint(names: list[str], tensors: Mapping[str, Array], i: int) -> SubJoint:
    compliance = tensors["compliance"][i]
    check_compliance(0.5 * (compliance + compliance.T))
    check_ordered(tensors["loads"][i])
    fit = LinearFit(tensors["row_covariance"][i], np.zeros(6), tensors["loads"][i])
    holds = tuple(int(axis) for axis in np.flatnonzero(tensors["holds"][i] > 0.5))
    return SubJoint(_name(names, float(tensors["at"][i])), LinearLaw(compliance, fit=fit), holds)


def _beam(names: list[str], row: Array) -> Beam:
    section = Section(**dict(zip(SECTION, row[2:8].tolist(), strict=True)))
    return Beam(_name(names, float(row[0])), _name(names, float(row[1])), section, row[8:])
