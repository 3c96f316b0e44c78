"""A fitted structural law as named arrays: sub-joints linear, nodes by number."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from armflex.conventions import Array
from armflex.errors import LawError
from armflex.laws.joint.beam import Beam, Section
from armflex.laws.joint.linear import LinearFit, LinearLaw, check_compliance
from armflex.laws.joint.structural import StructuralLaw, SubJoint
from armflex.laws.law import check_ordered
from armflex.storage.schema import Numbers

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
    number, subjoints = {name: float(i) for i, name in enumerate(law.nodes)}, law.subjoints
    beams = [(number[one.start], number[one.end], *vars(one.section).values(), *one.up) for one in law.beams]
    return {
        "nodes": np.array(list(law.nodes.values()), dtype=float),
        "tip": np.array([number[law.tip], float(law.components)]),
        "noise": np.zeros(6) if law.noise is None else law.noise,
        "at": np.array([number[sub.node] for sub in subjoints]),
        "holds": np.array([[float(axis in sub.holds) for axis in range(6)] for sub in subjoints]),
        "compliance": np.array([sub.law.compliance for sub in subjoints]),
        "row_covariance": np.array([sub.law.fit.row_covariance for sub in subjoints]),
        "loads": np.array([sub.law.fit.loads for sub in subjoints]),
        "beams": np.array(beams).reshape(-1, 11),
    }


def from_tensors(tensors: Mapping[str, Array]) -> StructuralLaw:
    """Return the law of arrays as declared; raise `LawError` where their numbers are not those of one."""
    tip, components = (int(value) for value in tensors["tip"])
    if components not in (3, 6):
        raise LawError(f"{components} components, expected 3 or 6")
    nodes = {str(i): place for i, place in enumerate(tensors["nodes"], 1)}

    def name(number: float) -> str:
        if not 0 <= number < len(nodes) or number != int(number):
            raise LawError(f"node {number:g} of {len(nodes)}")
        return str(int(number) + 1)

    tip_name, subjoints = name(tip), []
    of_each = (tensors[key] for key in ("at", "holds", "compliance", "row_covariance", "loads"))
    for at, holds, compliance, known, loads in zip(*of_each, strict=True):
        check_compliance(0.5 * (compliance + compliance.T))
        check_ordered(loads)
        law = LinearLaw(compliance, fit=LinearFit(known, np.zeros(6), loads))
        subjoints.append(SubJoint(name(float(at)), law, tuple(np.flatnonzero(holds > 0.5).tolist())))
    beams = tuple(Beam(name(row[0]), name(row[1]), Section(*row[2:8].tolist()), row[8:]) for row in tensors["beams"])
    return StructuralLaw(nodes, tip_name, tuple(subjoints), beams, components, tensors["noise"])
