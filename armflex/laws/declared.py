"""Laws as an arm.toml declares them: by numbers, by a trained file, or composed of sub-joints and beams."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from armflex.conventions import TWIST_NAMES
from armflex.declaration import Declaration
from armflex.errors import LawError, ModelFileError, UnknownNameError
from armflex.laws.at_node import AtNode
from armflex.laws.beam import Beam, Section
from armflex.laws.law import Law
from armflex.laws.law_file import load_law
from armflex.laws.linear import read_linear
from armflex.laws.position_dependent import read_position_dependent
from armflex.laws.structural import StructuralLaw, SubJoint


def read_law(table: Declaration, joint: str) -> Law:
    """Return the law of a [flexure.NAME] or sub-joint table; `node` carries it to where it was measured.

    Args:
        table: The declaration; its `model` (and `file`) choose the law.
        joint: The joint that the flexure belongs to.

    Raises:
        ArmFileError: The declaration is incomplete or its numbers are not physical.
    """
    model = table.choice("model", tuple(LAWS), "linear")
    law = _read_file(table, model) if table.has("file") else LAWS[model](table, joint)
    if table.has("node"):
        return AtNode(law, table.numbers("node", (3,)))
    return law


def _read_file(table: Declaration, model: str) -> Law:
    path = table.path.parent / table.text("file")
    try:
        trained = load_law(path)
    except ModelFileError as error:
        raise table.fail("file", str(error)) from None
    if trained.model != model:
        raise table.fail("file", f"{path.name} holds a {trained.model} law, but model = {model!r}")
    return trained.law


def read_structural(table: Declaration, joint: str) -> StructuralLaw:
    """Return the composed joint of `nodes`, `tip`, [[subjoint]] and [[beam]] tables."""
    nodes_table = table.sub("nodes")
    nodes = {name: nodes_table.numbers(name, (3,)) for name in nodes_table.table}
    subjoints = tuple(_read_subjoint(sub, joint) for sub in table.array_of("subjoint"))
    beams = tuple(_read_beam(beam) for beam in table.array_of("beam"))
    components = int(table.number("components", 6.0))
    if components not in (3, 6):
        raise table.fail("components", f"expected 3 or 6, got {components}")
    try:
        return StructuralLaw(nodes, table.text("tip"), subjoints, beams, components)
    except (LawError, UnknownNameError) as error:
        raise table.fail("model", str(error)) from None


def _read_subjoint(table: Declaration, joint: str) -> SubJoint:
    law = read_law(table, joint)
    holds = table.raw("holds") if table.has("holds") else list(TWIST_NAMES)
    if not isinstance(holds, list) or not holds or not set(holds) <= set(TWIST_NAMES):
        raise table.fail("holds", f"expected some of {', '.join(TWIST_NAMES)}, got {holds!r}")
    node = table.text("at")
    table.finish()
    return SubJoint(node, law, tuple(sorted(TWIST_NAMES.index(name) for name in holds)))


def _read_beam(table: Declaration) -> Beam:
    ends = table.raw("between")
    if not isinstance(ends, list) or len(ends) != 2:
        raise table.fail("between", f"expected two node names, got {ends!r}")
    try:
        section = Section(**{name: table.number(name) for name in ("E", "G", "A", "Iy", "Iz", "J")})
    except LawError as error:
        raise table.fail("between", str(error)) from None
    up = table.numbers("up", (3,)) if table.has("up") else np.array([0.0, 0.0, 1.0])
    table.finish()
    return Beam(ends[0], ends[1], section, up)


LAWS: dict[str, Callable[[Declaration, str], Law]] = {
    "linear": read_linear,
    "position_dependent": read_position_dependent,
    "structural": read_structural,
}
"""`model` in arm.toml -> how its law is read."""
