"""Flexures and their laws as an arm.toml declares them: by numbers, a trained file, or sub-joints and beams."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path

import numpy as np
import pinocchio as pin

from armflex.conventions import TWIST_NAMES, Array
from armflex.declaration import Declaration, read_toml
from armflex.errors import Flag, LawError, ModelFileError, UnknownNameError, listing
from armflex.fem.part import Drawing, Part, read_part
from armflex.laws.joint.beam import Beam, MeshedBeam, Section, stiffness
from armflex.laws.joint.carried import AtNode
from armflex.laws.joint.linear import read_linear, softness
from armflex.laws.joint.meshed import MeshedLaw
from armflex.laws.joint.structural import StructuralLaw, SubJoint
from armflex.laws.law import Law, Ranges, Row
from armflex.laws.law_file import FORMS, load_law
from armflex.laws.learned import LearnedLaw, Learning
from armflex.laws.learned.learned_law import TRAINED_ALONE
from armflex.plugins import Registry
from armflex.robot import Site

NEAR = 0.1
"""Share of a part's length by which its loaded interface may be from where it belongs."""

MOST_PARTS = 200
"""Nodes, sub-joints or beams of a structure: its equations are dense, six or more to each of them."""


@dataclass(frozen=True)
class Flexure:
    """A place where the arm gives: outboard of `joint`'s motion, or at the base when `joint` is None.

    Attributes:
        name, joint, law: What it is called, the joint that it belongs to, and how it gives.
        before: Whether it is the end of the link that the joint ends, inboard of the joint's motion.
        learn: What of its law `calibrate` finds from measurements of the whole arm, None for nothing.
        inertia: (12, 12) what a link that bends there adds to the mass matrix [kg, kg m, kg m^2], by the motion of its
            root and by its own, beside its two bodies; None for nothing.
    """

    name: str
    joint: str | None
    law: Law
    before: bool = False
    learn: Learning | None = None
    inertia: Array | None = None

    @property
    def learned(self) -> LearnedLaw | None:
        """Its law, where that is one with parameters that a campaign taught or is to teach."""
        return self.law if isinstance(self.law, LearnedLaw) else None

    @property
    def meshed(self) -> MeshedLaw | None:
        """Its law, at its node, where that is a condensed part."""
        law = self.law.law if isinstance(self.law, AtNode) else self.law
        return law if isinstance(law, MeshedLaw) else None

    @cached_property
    def site(self) -> Site:
        """The same place as a model of the arm names it."""
        return Site(self.name, self.joint, self.before)


def read_law(table: Declaration, joint: str, ranges: Ranges) -> Law:
    """Return the law of a [flexure.NAME] or sub-joint table; `node` carries it to where it was measured.

    Args:
        table: The declaration; its `model` (and `file`) choose the law.
        joint: The joint that the flexure belongs to.
        ranges: The joints that a law may depend on.

    Raises:
        ArmFileError: The declaration is incomplete or its numbers are not physical.
    """
    model = law_name(table)
    if table.has("file") and (path := table.path.parent / table.text("file")).suffix == ".toml":
        if model != "linear":
            raise table.fail("model", "a condensed part is a linear law")
        part, turn = read_meshed(table)
        node = table.numbers("node", (3,)) if table.has("node") else np.zeros(3)
        drawing = Drawing(path, part, pin.SE3(turn, node))
        law = MeshedLaw(part.seen_from(pin.SE3(turn, np.zeros(3))), part.young_std, drawing)
    elif table.has("file"):
        try:
            trained = load_law(path)
        except ModelFileError as error:
            raise table.fail("file", str(error)) from None
        if trained.model != model:
            raise table.fail("file", f"{path.name} holds a {trained.model} law, but model = {model!r}")
        law = trained.law
    elif model in LAWS:
        law = LAWS[model].read(table, joint, ranges)
        if beyond := columns_beyond_joints(law, ranges):
            text = f"a {model} law depends on the column {beyond[0]!r}, and a joint law may depend on the load and on"
            raise table.fail("model", f"{text} joint positions alone: what depends on a recorded column is an effect")
    elif table.flag("learn") and model not in TRAINED_ALONE:
        law = read_linear(table, joint, ranges)  # what the correction is learned about
    else:
        other = "" if model in TRAINED_ALONE else ", or learn = true and a compliance"
        raise table.fail("model", f"a {model} law is learned: give the 'file' that `armflex train` wrote{other}")
    if table.has("node"):
        return AtNode(law, table.numbers("node", (3,)))
    return law


def columns_beyond_joints(law: Law, ranges: Ranges) -> list[str]:
    """Return the columns that a law's terms depend on beside the positions of joints; it must have none."""
    columns = (factor.column for term in law.known_terms or () for factor in term.factors)
    return [column for column in dict.fromkeys(columns) if column.removeprefix("q_") not in ranges]


def read_meshed(table: Declaration) -> tuple[Part, Array]:
    """Return the part of one loaded interface that `file` names, and the (3, 3) turn of its mesh by `rpy`."""
    part = read_part(table.path.parent / table.text("file"))
    if len(part.loaded) > 1:
        text = f"has {len(part.loaded)} loaded interfaces ({listing(part.loaded)}), expected one: condense it onto that"
        raise table.fail("file", f"{text}; where one of them is a pin, split the link and its mesh in two there")
    named = f"{table.text('file')} of [{table.header}]"
    table.source.flags += [Flag(flag.code, f"{named}: {flag.text}") for flag in part.flags]
    return part, pin.rpy.rpyToMatrix(table.numbers("rpy", (3,)) if table.has("rpy") else np.zeros(3))


def law_name(table: Declaration) -> str:
    """Return the name of the law that a table declares."""
    return table.choice("model", tuple(dict.fromkeys((*LAWS, *FORMS))), "linear")


def read_structural(table: Declaration, joint: str, ranges: Ranges) -> StructuralLaw:
    """Return the composed joint of `nodes`, `tip`, [[subjoint]] and [[beam]] tables."""
    nodes_table = table.sub("nodes")
    if len(nodes_table.table) > MOST_PARTS:
        raise table.fail("nodes", f"has {len(nodes_table.table)}, more than the {MOST_PARTS} allowed")
    nodes = {name: nodes_table.numbers(name, (3,)) for name in nodes_table.table}
    subjoints = tuple(_read_subjoint(sub, joint, ranges, nodes) for sub in table.array_of("subjoint"))
    beams = tuple(_read_beam(beam, nodes) for beam in table.array_of("beam"))
    for key, parts in (("subjoint", subjoints), ("beam", beams)):
        if len(parts) > MOST_PARTS:
            raise table.fail(key, f"there are {len(parts)}, more than the {MOST_PARTS} allowed")
    components = table.number("components", 6.0)
    if components not in (3.0, 6.0):
        raise table.fail("components", f"expected 3 or 6, got {components:g}")
    tip = _known(table, "tip", table.text("tip"), nodes)
    try:
        law = StructuralLaw(nodes, tip, subjoints, beams, int(components))
        if law.constant is not None and not np.isfinite(law.constant).all():
            raise LawError("the structure's compliance is not finite")
        return law
    except LawError as error:
        raise table.fail("model", str(error)) from None


def read_assembly(path: Path) -> StructuralLaw:
    """Return the structure of a TOML file that holds what a structural [flexure.NAME] does: nodes, sub-joints, beams.

    Raises:
        ArmFileError: It is incomplete or its numbers are not physical.
    """
    root = read_toml(path)
    for table in root.array_of("beam"):
        if table.has("file"):
            raise table.fail("file", "what is fitted has beams by numbers alone")
    if root.has("model"):
        root.choice("model", ("structural",), "structural")
    law = read_structural(root, "", {})
    root.finish()
    return law


def _read_subjoint(table: Declaration, joint: str, ranges: Ranges, nodes: Mapping[str, Array]) -> SubJoint:
    law = read_law(table, joint, ranges)
    holds = table.texts("holds") if table.has("holds") else TWIST_NAMES
    if not holds or not set(holds) <= set(TWIST_NAMES):
        raise table.fail("holds", f"expected some of {', '.join(TWIST_NAMES)}, got {list(holds)}")
    node = _known(table, "at", table.text("at"), nodes)
    table.finish()
    return SubJoint(node, law, tuple(sorted({TWIST_NAMES.index(name) for name in holds})))


def _read_beam(table: Declaration, nodes: Mapping[str, Array]) -> Beam | MeshedBeam:
    ends = table.texts("between")
    if len(ends) != 2:
        raise table.fail("between", f"expected two node names, got {list(ends)}")
    start, end = (_known(table, "between", name, nodes) for name in ends)
    if table.has("file"):
        part, turn = read_meshed(table)
        table.finish()
        way = turn @ (part.origin - part.fixed_origin)
        offset = nodes[end] - nodes[start] - way
        if np.linalg.norm(offset) > NEAR * np.linalg.norm(way):
            text = f"is {np.round(way, 4).tolist()} from its held interface to the loaded one"
            text += f", the nodes {np.round(nodes[end] - nodes[start], 4).tolist()}: turn it by rpy"
            raise table.fail("file", text)
        return MeshedBeam(start, end, part.seen_from(pin.SE3(turn, -offset)))
    values = {name: table.number(name) for name in ("E", "G", "A", "Iy", "Iz", "J")}
    for name, value in values.items():
        if value <= 0.0:
            raise table.fail(name, f"expected more than 0, got {value:g}")
    up = table.numbers("up", (3,)) if table.has("up") else np.array([0.0, 0.0, 1.0])
    table.finish()
    beam = Beam(start, end, Section(**values), up)
    try:
        stiffness(beam, nodes[start], nodes[end], 6)
    except LawError as error:
        raise table.fail("up" if "'up'" in str(error) else "between", str(error)) from None
    return beam


def _known(table: Declaration, key: str, name: str, nodes: Mapping[str, Array]) -> str:
    """Return a node's name; raise where there is no such node."""
    if name not in nodes:
        raise table.fail(key, str(UnknownNameError("node", name, nodes)))
    return name


DECLARED = ("linear", "position_dependent", "telescope", "hardening")
"""Laws by numbers: a file of `joint/` each, with a function `read_NAME` and an `EXAMPLE` of what it reads; a new law is
one more file and a line here."""


@dataclass(frozen=True)
class LawModel:
    """A joint law that an arm.toml declares.

    Attributes:
        read: (table, joint, ranges) -> the law of a [flexure.NAME] table at a joint, which may depend on the joints of
            `ranges`; raises ArmFileError. The caller looks for keys that nobody asked for.
        example: The table's keys with values, as TOML.
    """

    read: Callable[[Declaration, str, Ranges], Law]
    example: str


def _bundled(name: str, read: Callable[[Declaration, str, Ranges], Law] | None = None) -> LawModel:
    module = import_module(f"armflex.laws.joint.{name}")
    return LawModel(read or getattr(module, f"read_{name}"), module.EXAMPLE)


def _fault(name: str, model: object) -> str:
    return "" if isinstance(model, LawModel) else "expected a LawModel of armflex.laws"


LAWS: Registry[LawModel] = Registry(
    "armflex.laws",
    {**{name: _bundled(name) for name in DECLARED}, "structural": _bundled("structural", read_structural)},
    _fault,
)
"""`model` in arm.toml -> its law."""


def soft(flexures: Iterable[Flexure], row: Row, raised: Iterable[Flag] = ()) -> Iterator[Flag]:
    """Yield flags about flexures that are softer than any steel joint, and that no known flag is about."""
    flagged = {flag.about for flag in raised if flag.code == "soft"}
    for flexure in flexures:
        for law in () if flexure.name in flagged else flexure.law.leaves:
            for flag in softness(law.tangent(np.zeros(6), row)):
                yield Flag(flag.code, f"flexure {flexure.name!r}: {flag.text}", flexure.name)
