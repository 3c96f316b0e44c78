"""The arm as one file of C99 for a controller: `arm.c` beside this file, with the arm's numbers in its tables.

The algorithm is that of the engine, for one configuration. Laws reach it as terms; see `laws.terms`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from armflex.arm import Arm, Flexure
from armflex.conventions import Array
from armflex.errors import ArmflexError, UnsupportedError
from armflex.export import Exported
from armflex.export.c_text import SMALLEST_CHANGE, c_head, c_limits, c_names, c_number, c_table, check_name
from armflex.export.mechanism_c import export_mechanism
from armflex.export.quoting import c_comment
from armflex.export.rigid import measured_points, said_points
from armflex.laws import Law, LinearLaw
from armflex.laws.effects.context import MASS
from armflex.laws.effects.effect import Act
from armflex.laws.effects.in_arm import BoundTwist, Pulling, about_time, depended_on
from armflex.laws.effects.shapes import middle_of
from armflex.laws.effects.umbilical import hook_of
from armflex.laws.learned.seen import Seen
from armflex.laws.terms import Factor, Of, Term
from armflex.mechanics.chain import link_frame
from armflex.mechanics.engine.tables import FLEXURE, RIGID, ROTATED, SLIDES, TURNS, Tree
from armflex.rows.rows import HOLD, TIME

TEMPLATE = Path(__file__).with_name("arm.c")

ELEMENTS = {FLEXURE: "FLEXES", TURNS: "TURNS", SLIDES: "SLIDES", RIGID: "RIGID"}

TRAVEL = 1e-6
"""By how much of its travel a joint may go beyond that of a polynomial in its position."""

TRIED = 16
"""Configurations over which what cannot be said in C is measured."""


def export(arm: Arm, name: str = "arm") -> Exported:
    """Return the arm as C; see FORMATS for what it declares.

    Args:
        arm: The arm.
        name: What every name with external linkage begins with.

    Raises:
        InputError: The name is no identifier of C.
        UnsupportedError: Laws or effects of the arm have no form in C; they are named with what they amount to.
        PayloadError: A payload's centre of mass is beyond the arm's reach.
    """
    check_name(name)
    if not arm.chain:
        return export_mechanism(arm, name)
    tables = _tables(arm)
    text = re.sub(r"\bNAME_(?=[a-z])", f"{name}_", TEMPLATE.read_text(encoding="utf-8"))
    text = text.replace("/*@smallest_change*/\n", SMALLEST_CHANGE.read_text(encoding="utf-8"))
    arm, counts = tables.arm, {count: value for count, (value, _) in tables.counts.items()}
    text = _chosen(text, counts)
    flexures, joints = counts["FLEXURES"], counts["JOINTS"]
    state = 8 * (joints + 12 + 79 * flexures + counts["FACTORS"] + 3 * counts["PULLS"])
    matrix = 8 * (36 * flexures + 216) * flexures if counts["UNPROVEN"] else 0
    # What functions hold beside states: changes of the twists per joint, some sets of twists, and tangents.
    stack = {
        "tip": matrix + state + 48 * 6 * flexures + 1024,
        "compensate": matrix + 2 * state + 48 * (joints + 6) * flexures + 336 * counts["STRAIGHTENED"] + 2048,
    }
    text = text.replace("/*@head*/", _head(arm, tables, stack, name))
    text = text.replace("/*@constants*/", _constants(arm, tables, name))
    notes = [f"{arm.robot.urdf.name} as C, payloads {', '.join(tables.payloads)}"]
    if tables.covariates:
        notes.append(f"set {name}_covariates before you ask: {', '.join(tables.covariates)}")
    for payload in tables.unproven:
        notes.append(f"payload {payload!r}: no bound proves that the arm cannot buckle; every answer is probed")
    outside = [effect.name for effect in arm.effects if effect.law.act in (Act.FRAME, Act.SCALE, Act.SIGHT)]
    if outside:
        notes.append(f"of the instrument, and so not in it: {', '.join(outside)}")
    notes += said_points(measured_points(arm), carried=False)
    numbers = {
        "name": name,
        "joint_names": list(arm.joint_names),
        "payloads": list(tables.payloads),
        "covariates": list(tables.covariates),
        "stack_bytes": stack,
    }
    return Exported(text, tuple(notes), numbers, about_time(arm, (TIME, HOLD)))


@dataclass
class _Tables:
    """What becomes the tables of the file; rows of text are finished C with a comment.

    `steady` is whether what is nonlinear in the load depends on no joint's position.
    """

    arm: Arm
    payloads: tuple[str, ...]
    proven: tuple[bool, ...]
    covariates: tuple[str, ...] = ()
    chain: list[str] = field(default_factory=list)
    nominal: list[str] = field(default_factory=list)
    pulls: list[str] = field(default_factory=list)
    factors: list[Factor] = field(default_factory=list)
    changing: list[str] = field(default_factory=list)
    features: list[str] = field(default_factory=list)
    terms: list[str] = field(default_factory=list)
    curved: list[str] = field(default_factory=list)
    forms: list[Array] = field(default_factory=list)
    windows: list[Seen] = field(default_factory=list)
    offset: Array = field(default_factory=lambda: np.zeros((0, 6)))
    compliance: Array = field(default_factory=lambda: np.zeros((0, 6, 6)))
    outboard: Array = field(default_factory=lambda: np.zeros(0))
    gravity: Array = field(default_factory=lambda: np.zeros(3))
    columns: tuple[str, ...] = ()
    steady: bool = True

    @property
    def unproven(self) -> list[str]:
        """Payloads with which the arm may be too soft, for all that is known beforehand."""
        return [name for name, proven in zip(self.payloads, self.proven, strict=True) if not proven]

    @property
    def counts(self) -> dict[str, tuple[int, str]]:
        """How many of each there are, and what they are."""
        return {
            "JOINTS": (sum(one.startswith("q_") for one in self.columns), "moving joints"),
            "ELEMENTS": (len(self.chain), "elements of the chain, the tip last"),
            "PAYLOADS": (len(self.payloads), "payloads"),
            "FLEXURES": (len(self.offset), "flexures, from base to tip"),
            "PULLS": (len(self.pulls), "forces from outside"),
            "COVARIATES": (len(self.covariates), "covariates"),
            "FACTORS": (len(self.factors), "functions of a column"),
            "KNOTS": (sum(len(one.numbers) - 3 for one in self.factors if one.kind is Of.TABLE), "values of tables"),
            "CHANGING": (len(self.changing), "parts of laws that depend on a column"),
            "FEATURES": (len(self.features), "numbers that those make of the load"),
            "TERMS": (len(self.terms), "parts of laws that are not linear in the load"),
            "CURVED": (len(self.curved), "laws that have such parts"),
            "STRAIGHTENED": (len(self.curved) * self.steady, "the same, where none depends on a joint's position"),
            "LOADED": (len(self.curved) * self.steady + len(self.unproven), ""),
            "UNPROVEN": (len(self.unproven), "payloads with which no bound proves that the arm cannot buckle"),
            "FORMS": (len(self.forms), "matrices that those multiply the load with"),
            "WINDOWS": (len(self.windows), "learned corrections"),
            "NOMINAL": (len(self.nominal), "elements of the chain as the controller knows it, where that is another"),
        }


def _tables(arm: Arm) -> _Tables:
    """Return everything about an arm that its C has; raise what `export` does."""
    if not arm.modelled:  # in C, which has no arrays without length, a rigid arm has a flexure that does not give
        arm = replace(arm, flexures=(Flexure("rigid", arm.joint_names[0], _stiff),))
    bare = arm.loaded(None)
    payloads = ("none", *(name for name in arm.payloads if name != "none"))
    bounds = [arm.loaded(name).stability_bound for name in payloads]
    for name in payloads:
        _ = arm.loaded(name).flags  # raises where a payload is impossible
    tables = _Tables(arm, payloads, tuple(bound is not None and bound.proven for bound in bounds))
    chain, order = bare.chain, bare.chain.order.tolist()
    tables.chain = _elements(arm, chain, {number: place for place, number in enumerate(order)})
    if bare.nominal is not None:
        tables.nominal = _elements(arm, bare.nominal, {})
    tables.outboard, tables.gravity = chain.elements[order, 19], chain.elements[-1, 12:15]
    said = _said(arm)
    used = dict.fromkeys(factor.column for own in said for _, part in own for term in part for factor in term.factors)
    known = [*(f"q_{joint}" for joint in arm.joint_names), MASS]
    tables.covariates = tuple(column for column in used if column not in known)
    tables.columns = (*known, *tables.covariates)
    bent = [term for own in said for _, part in own for term in part if not term.linear]
    tables.steady = not any(factor.column.startswith("q_") for term in bent for factor in term.factors)
    tables.offset, tables.compliance = np.zeros((len(order), 6)), np.zeros((len(order), 6, 6))
    for place, number in enumerate(order):
        for label, terms in said[number]:
            _add(tables, place, f"{arm.flexure_names[number]}: {label}", terms)
    tables.pulls = [row for pulling in arm.pulls for row in _pull(arm, pulling)]
    return tables


def _said(arm: Arm) -> list[list[tuple[str, list[Term]]]]:
    """Return for every flexure what its laws are called, with their terms; refuse all that have none at once."""
    said: list[list[tuple[str, list[Term]]]] = [[] for _ in arm.flexure_names]
    refused = []
    for number, law in arm.stack.parts:
        try:
            terms = [one for term in law.terms() for one in term.single()]
            for factor in {factor for term in terms for factor in term.factors if factor.kind is Of.CHEBYSHEV}:
                joint, (middle, reach, _) = arm.joint_index[factor.column.removeprefix("q_")], factor.numbers
                if max(arm.robot.upper[joint] - middle, middle - arm.robot.lower[joint]) > (1.0 + TRAVEL) * reach:
                    raise UnsupportedError(f"was learned over less than the travel of {arm.joint_names[joint]}")
            said[number].append((_called(law), terms))
        except UnsupportedError as error:
            if isinstance(law, BoundTwist):
                other = replace(arm, effects=tuple(one for one in arm.effects if one is not law.effect))
                refused.append((f"effect {law.effect.name!r}", str(error), other))
            else:
                name = arm.flexure_names[number]
                rigid = [replace(one, law=_stiff) if one.name == name else one for one in arm.flexures]
                refused.append((f"the law of flexure {name!r}", str(error), replace(arm, flexures=tuple(rigid))))
    pulling_effects = [one for one in arm.effects if one.law.act is Act.LOAD and not one.law.changes_model]
    for pulling, effect in zip(arm.pulls, pulling_effects, strict=True):
        if pulling.law.name not in PULLS:
            other = replace(arm, effects=tuple(one for one in arm.effects if one is not effect))
            refused.append((f"effect {effect.name!r}", f"is a {pulling.law.name}, which has no form in C", other))
    if refused:
        parts = [f"{name} {reason} ({_amount(arm, other)})" for name, reason, other in refused]
        raise UnsupportedError(f"this arm cannot be written as C: {'; '.join(parts)}")
    return said


_stiff = LinearLaw(np.zeros((6, 6)))


def _called(law: Law) -> str:
    if isinstance(law, BoundTwist):
        return law.effect.title
    return re.sub(r"(?<!^)(?=[A-Z])", " ", type(law).__name__.removesuffix("Law")).lower()


def _amount(arm: Arm, other: Arm) -> str:
    """Return in words how far the tip of two arms is apart at most, over their limits and payloads."""
    lower, upper = np.array(arm.bounds)
    q = np.random.default_rng(0).uniform(np.maximum(lower, -np.pi), np.minimum(upper, np.pi), (TRIED, len(lower)))
    covariates, most = dict.fromkeys(depended_on(arm), 0.0), 0.0
    try:
        for payload in ("none", *arm.payloads):
            tips = [one.deflection(q, payload, covariates=covariates).displacement for one in (arm, other)]
            most = max(most, float(np.linalg.norm((tips[0] - tips[1])[:, :3], axis=1).max()))
    except ArmflexError:
        return "its effect on the tip is not known"
    return f"it moves the tip by up to {most * 1e3:.3g} mm{', covariates at 0' if covariates else ''}"


def _elements(arm: Arm, chain: Tree, places: dict[int, int]) -> list[str]:
    """Return the elements of a chain beyond its root, and the tip, as rows of C."""
    rows = []
    for k in range(1, len(chain.elements)):
        numbers, tip = chain.elements[k], k == chain.kinds.shape[1]
        kind, own = (RIGID, -1) if tip else chain.kinds[:2, k].tolist()
        rotated = int(kind >= ROTATED or (tip and not np.array_equal(numbers[:9], np.eye(3).ravel())))
        kind = ELEMENTS[kind % ROTATED]
        label = "the tip" if tip else "fixed"
        if kind == "FLEXES":
            label, own = f"flexure {arm.flexure_names[own]}", places[own]
        elif kind != "RIGID":
            label = f"joint {arm.joint_names[own]}"
        axis, body = (np.zeros(3), np.zeros(4)) if tip else (numbers[12:15], numbers[15:19])
        parts = [
            c_number(rotated * numbers[:9].reshape(3, 3)),
            c_number(numbers[9:12]),
            c_number(axis),
            c_number(body[0]),
            c_number(body[1:]),
        ]
        rows.append(f"{{{kind}, {own}, {rotated}, {', '.join(parts)}}}, /* {c_comment(label)} */")
    return rows


def _add(tables: _Tables, place: int, label: str, terms: Sequence[Term]) -> None:
    """Add the terms of one law of a flexure to the tables."""
    parts: dict[tuple[Factor, ...], tuple[Array, Array]] = {}
    for term in terms:
        if term.linear:
            offset, compliance = parts.setdefault(term.factors, (np.zeros(6), np.zeros((6, 6))))
            offset += term.along
            compliance += 0.0 if term.matrix is None else term.matrix
    for factors, (offset, compliance) in parts.items():
        if not factors:
            tables.offset[place] += offset
            tables.compliance[place] += compliance
        else:
            numbers = f"{c_number(offset)}, {c_number(compliance)}"
            tables.changing.append(f"{{{place}, {_two(tables, factors)}, {numbers}}}, /* {c_comment(label)} */")
    # Terms under one window stand together, so that a load is drawn in once.
    groups: dict[bytes, list[Term]] = {}
    for term in terms:
        if not term.linear:
            seen = b"" if term.window is None else term.window.mean.tobytes() + term.window.precision.tobytes()
            groups.setdefault(seen, []).append(term)
    for own in groups.values():
        first, number = len(tables.terms), -1
        if isinstance(own[0].window, Seen):
            number = len(tables.windows)
            tables.windows.append(own[0].window)
        for term in own:
            begin = len(tables.features)
            for one in term.features:
                form, values = _form(tables, one.matrix if one.form else None), (one.u, one.bias, one.exponent)
                tables.features.append(f"{{{one.kind.name}, {form}, {', '.join(map(c_number, values))}}},")
            span, matrix = f"{begin}, {len(tables.features)}", _form(tables, term.matrix)
            numbers = f"{_two(tables, term.factors)}, {span}, {matrix}, {c_number(term.along)}"
            tables.terms.append(f"{{{numbers}}}," + (f" /* {c_comment(label)} */" if term is own[0] else ""))
        tables.curved.append(f"{{{place}, {number}, {first}, {len(tables.terms)}}}, /* {c_comment(label)} */")


def _form(tables: _Tables, form: Array | None) -> int:
    """Return the number of a (6, 6) matrix in its table, -1 of none."""
    if form is None:
        return -1
    known = [i for i, one in enumerate(tables.forms) if np.array_equal(one, form)]
    tables.forms += [] if known else [form]
    return known[0] if known else len(tables.forms) - 1


def _two(tables: _Tables, factors: Sequence[Factor]) -> str:
    """Return the numbers of two factors; the first of all is one."""
    if not tables.factors:
        tables.factors.append(Factor(Of.ONE, tables.columns[0], ()))
    for factor in factors:
        if factor not in tables.factors:
            tables.factors.append(factor)
    return ", ".join(str(number) for number in [*(tables.factors.index(one) for one in factors), 0, 0][:2])


def _pull(arm: Arm, pulling: Pulling) -> list[str]:
    """Return a load effect as a row of C, none where it acts on what stands."""
    bare = arm.loaded(None)
    _, element, _, placement = link_frame(bare.flex.model, bare.flex.frame(pulling.frame))
    flexures = bare.chain.flexures_inboard(element)
    if not flexures:
        return []
    kind, hook, anchor, size, reach = PULLS[pulling.law.name](pulling)
    point = placement.act(hook)
    numbers = f"{c_number(point)}, {c_number(anchor)}, {c_number(size)}, {c_number(reach)}"
    label = c_comment(f"{pulling.law.name} at {pulling.frame}")
    return [f"{{{kind}, {element - 1}, {flexures}, {numbers}}}, /* {label} */"]


Pull = tuple[str, Array, Sequence[float], float, float]

PULLS: dict[str, Callable[[Pulling], Pull]] = {
    "tip_force": lambda one: ("CONSTANT", np.zeros(3), one.amplitudes, 1.0, 0.0),
    "umbilical": lambda one: (
        "SPRING",
        hook_of(one.here, one.inner),
        one.inner[:3],
        one.amplitudes[0],
        one.inner[3],
    ),
    "magnetic_pull": lambda one: ("MAGNET", middle_of(one.here), one.inner[:3], one.amplitudes[0], one.inner[3]),
}
"""Kind, hook in its link's frame, anchor in base axes, size and reach of effects that are loads."""


# The text.


def _chosen(text: str, counts: dict[str, int]) -> str:
    """Return the template without what an arm does not need: between `#if COUNT`, `#else` and `#endif`."""
    lines, shown = [], [True]
    for line in text.splitlines():
        word, _, count = line.partition(" ")
        if word == "#if":
            shown.append(shown[-1] and counts[count] > 0)
        elif word == "#else":
            shown[-1] = shown[-2] and not shown[-1]
        elif word == "#endif":
            shown.pop()
        elif shown[-1]:
            lines.append(line)
    return "\n".join(lines) + "\n"


def _head(arm: Arm, tables: _Tables, stack: dict[str, int], name: str) -> str:
    newton = (
        "Where no bound proves that the arm cannot buckle, Newton's method may take the place of MOST_STEPS:",
        "it weighs MOST_NEWTON (6 FLEXURES + MOST_HALVINGS + 2) times at most, 4 (6 FLEXURES + 3) usually.",
    )
    bounds = (
        f"Every loop is bounded: {name}_tip weighs the arm MOST_STEPS + PROBES times at most, and {name}_compensate",
        "(MOST_JUMPS + 1) (JOINTS + 1) MOST_STEPS + PROBES times; some 5 and some 100 times are usual.",
        *(newton if tables.unproven else ()),
        f"Stack: {name}_tip takes up to {stack['tip']} bytes, {name}_compensate up to {stack['compensate']}.",
    )
    return c_head(arm, f"{name}_tip and {name}_compensate", "", bounds)


def _constants(arm: Arm, tables: _Tables, name: str) -> str:
    counts = [f"    {name} = {count}, /* {what} */" for name, (count, what) in tables.counts.items() if what]
    bodies = [arm.payload(name) for name in tables.payloads]
    unset = ", ".join(["NAN"] * len(tables.covariates)) or "0.0"
    text = [
        "enum {\n" + "\n".join(counts) + "\n};",
        f"const int {name}_nq = {len(arm.joint_names)};",
        c_names(f"{name}_joints", arm.joint_names),
        c_names(f"{name}_payloads", tables.payloads),
        c_names(f"{name}_covariate_names", tables.covariates),
        f"double {name}_covariates[{max(1, len(tables.covariates))}] = {{{unset}}};",
        c_limits(arm, "joint"),
        c_table("payload_body payloads[PAYLOADS]", "",
               [f"{{{c_number(body.mass)}, {c_number(body.com)}, {int(proven)}}}, /* {c_comment(name)} */"
                for name, body, proven in zip(tables.payloads, bodies, tables.proven, strict=True)]),
        c_table("element chain[ELEMENTS]", "from base to tip, the arm as it is", tables.chain),
    ]  # fmt: skip
    names = [f" /* {c_comment(arm.flexure_names[i])} */" for i in arm.loaded(None).chain.order]
    if tables.nominal:
        what = "the rigid arm as the controller knows it"
        text.append(c_table("element nominal_chain[NOMINAL]", what, tables.nominal))
    if names:
        text.append(f"static const double gravity[3] = {c_number(tables.gravity)}; /* m/s^2, base axes */")
    per_flexure = (
        ("double outboard[FLEXURES]", "mass beyond every flexure, without payload [kg]", tables.outboard),
        ("double constant_offset[FLEXURES][6]", "twist without load [m, rad], own axes", tables.offset),
        ("double constant_compliance[FLEXURES][6][6]", "compliance [m/N, rad/Nm and mixed]", tables.compliance),
    )
    for declared, what, values in per_flexure:
        rows = [f"{c_number(value)},{name}" for value, name in zip(values, names, strict=True)]
        text.append(c_table(declared, what, rows) if rows else "")
    columns = {column: i for i, column in enumerate(tables.columns)}
    factors, knots = [], []
    for one in tables.factors:
        values = ", ".join(map(c_number, one.in_c(knots)))
        factors.append(f"{{{one.kind.name}, {columns[one.column]}, {values}}}, /* {c_comment(one.column)} */")
    windows = []
    for one in tables.windows:
        energy = one.precision if one.energy is None else one.energy
        faded = one.faded if np.isfinite(one.faded) else 0.0
        windows.append(f"{{{c_number(one.mean)}, {c_number(one.precision)}, {c_number(energy)}, {c_number(faded)}}},")
    optional = (
        ("pull pulls[PULLS]", "", tables.pulls),
        ("double knots[KNOTS]", "values of tables", [f"{c_number(value)}," for value in knots]),
        ("factor factors[FACTORS]", "", factors),
        ("change changing[CHANGING]", "", tables.changing),
        ("double forms[FORMS][6][6]", "of the load, own axes", [f"{c_number(form)}," for form in tables.forms]),
        ("window windows[WINDOWS]", "", windows),
        ("feature features[FEATURES]", "", tables.features),
        ("term terms[TERMS]", "", tables.terms),
        ("group curved[CURVED]", "", tables.curved),
    )
    text += [c_table(declared, what, rows) for declared, what, rows in optional if rows]
    return "\n".join(part for part in text if part)
