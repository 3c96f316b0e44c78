"""An arm with loops, springs or cylinders as C: the engine's own text, the arm's tables, and `controller.c`."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.errors import UnsupportedError
from armflex.export import Exported
from armflex.export.c_text import SMALLEST_CHANGE, c_head, c_limits, c_names, c_number
from armflex.export.rigid import measured_points, said_points
from armflex.laws.effects.context import MASS
from armflex.laws.effects.effect import Act
from armflex.laws.effects.in_arm import about_time
from armflex.mechanics.engine import build
from armflex.mechanics.engine.binding import Engine
from armflex.mechanics.engine.tables import Factors, Tree
from armflex.mechanics.loop_rows import closings, trees
from armflex.rows.rows import HOLD, TIME

CONTROLLER = Path(__file__).with_name("controller.c")

BESIDE = 16384
"""Bytes that functions of the engine hold beside what `mechanism` has; the tests compare them with the compiler's."""


def export_mechanism(arm: Arm, name: str) -> Exported:
    """Return an arm with loops, springs or cylinders as C; see `c_code.export`."""
    payloads = ("none", *(one for one in arm.payloads if one != "none"))
    loaded = [arm.loaded(one) for one in payloads]
    for one in loaded:
        _ = one.flags  # raises where a payload is impossible
    factors = _factors(arm)
    each, numbers = [trees(one)[:2] for one in loaded], arm.stack.numbers
    true, nominal = each[0]
    start, home, settled = closings(loaded[0])[0].beginning() if arm.robot.linkage else _of_chain(arm)
    room = _room(true, numbers.compliance[0], factors.varies) + 1
    counts = {
        "JOINTS": (true.driven, "drives, cylinders among them"),
        "PASSIVE": (true.passive, "joints without a drive"),
        "ELEMENTS": (len(true.parents), "elements: joints, flexures, and what stands"),
        "FLEXURES": (len(true.flexures), "flexures"),
        "TIES": (len(true.joins), "loops, cylinders, followers and springs"),
        "ROWS": (len(true.rows), "rows that they close"),
        "PAYLOADS": (len(payloads), "payloads"),
        "COVARIATES": (len(factors.names), "covariates"),
        "FACTORS": (len(factors.factor), "functions of a column, the first is 1"),
        "CHANGING": (len(factors.change), "parts of laws that depend on a column"),
        "HOME": (int(settled is not None), "whether the loops close at home"),
        "STRAIGHT": (
            int(not arm.robot.linkage or settled is None or closings(loaded[0])[0].given),
            "whether q0 is given",
        ),
        "STATE": (1 + true.driven + true.passive if true.passive else 0, "numbers that are carried from call to call"),
        "ROOM": (room, "numbers that are worked with"),
    }
    sized = {key: value for key, (value, _) in counts.items()}
    p, m, n = true.passive, len(true.rows), len(true.flexures)
    stack = 8 * (room + 58 * n + 3 * p + 2 * m * m + m + 3 * true.driven + len(factors.names) + 70) + BESIDE
    joints = arm.robot.linkage.free if arm.robot.linkage else ()
    tables = [
        "enum {\n" + "\n".join(f"    {key} = {value}, /* {what} */" for key, (value, what) in counts.items()) + "\n};",
        f"const int {name}_nq = JOINTS;",
        f"const int {name}_nstate = STATE;",
        c_names(f"{name}_joints", arm.joint_names),
        c_names(f"{name}_passive", joints),
        c_names(f"{name}_payloads", payloads),
        c_names(f"{name}_covariate_names", factors.names),
        f"double {name}_covariates[{max(1, len(factors.names))}] = "
        f"{{{', '.join(['NAN'] * len(factors.names)) or '0.0'}}};",
        c_limits(arm, "drive"),
        _real("masses", "of the payloads [kg]", np.array([one.payload.mass for one in loaded])),
        _real("home", "drives at home [rad or m]", home),
        _real("home_passive", "joints without a drive there", start if settled is None else settled),
        _real("start_passive", "their q0", start),
        *_tree("", true, [one.elements for one, _ in each]),
        _real("constant_compliance", "of the flexures [m/N, rad/Nm and mixed]", numbers.compliance),
        _real("constant_offset", "twists without load [m, rad]", numbers.offset),
        _rows("factors", "kind, column, numbers; see factor_at", factors.factor),
        _real("knots", "values of tables", factors.knots),
        _rows("changing", "flexure, two factors, offset, compliance", factors.change),
    ]
    known = ""
    if nominal is not None:
        others = [one.elements for _, one in each if one is not None]
        tables += _tree("nominal_", nominal, others)
        known = KNOWN.format(count=len(nominal.parents))
    text = CONTROLLER.read_text(encoding="utf-8")
    for mark, part in (
        ("/*@head*/", _head(arm, stack, name)),
        ("/*@engine*/\n", _engine()),
        ("/*@constants*/", "\n".join(tables)),
        ("/*@known*/\n", known),
        ("/*@nominal*/\n", "    use_known(&m, payload);\n" if known else ""),
        ("/*@smallest_change*/\n", SMALLEST_CHANGE.read_text(encoding="utf-8")),
    ):
        text = text.replace(mark, part)
    text = re.sub(r"\bNAME_(?=[a-z])", f"{name}_", text)
    notes = [f"{arm.robot.urdf.name} as C, payloads {', '.join(payloads)}"]
    notes += [f"{name}_follow carries {sized['STATE']} numbers from call to call"] if sized["STATE"] else []
    notes += [f"set {name}_covariates before you ask: {', '.join(factors.names)}"] if factors.names else []
    outside = [effect.name for effect in arm.effects if effect.law.act in (Act.FRAME, Act.SCALE, Act.SIGHT)]
    notes += [f"of the instrument, and so not in it: {', '.join(outside)}"] if outside else []
    notes += said_points(measured_points(arm), carried=False)
    said = {
        "name": name,
        "joint_names": list(arm.joint_names),
        "payloads": list(payloads),
        "covariates": list(factors.names),
        "stack_bytes": {"tip": stack, "follow": stack, "compensate": stack + 8 * (26 * true.driven + 60)},
    }
    return Exported(text, tuple(notes), said, about_time(arm, (TIME, HOLD)))


KNOWN = """/* Fill the tables of the rigid arm as the controller knows it. */
static void use_known(mechanism *m, int payload)
{{
    arm *a = &m->table;
    a->count = {count};
    a->flexures = 0;
    a->elements = nominal_elements[payload];
    a->kinds = nominal_kinds;
    a->parents = nominal_parents;
    a->carried = nominal_carried;
    a->tie = nominal_ties;
    a->joins = nominal_joins;
    a->row = nominal_rows;
    a->way = nominal_ways;
}}

"""


def _of_chain(arm: Arm) -> tuple[Array, Array, Array | None]:
    """Return what `Closing.beginning` does of an arm that has springs alone."""
    return np.zeros(0), arm.robot.home.copy(), np.zeros(0)


def _factors(arm: Arm) -> Factors:
    """Return what changes with columns; refuse laws and loads that C with loops does not know, all at once."""
    refused = [f"the law of flexure {arm.flexure_names[i]!r} is curved in the load" for i, _, _ in arm.stack.bent]
    refused += [
        f"the law of flexure {arm.flexure_names[i]!r} is curved in the load, or no sum of terms"
        for i, law in arm.stack.asked
        if law.known_terms is None
    ]
    curved = np.diff(arm.stack.numbers.starts) > 0
    refused += [f"flexure {arm.flexure_names[i]!r} has a network" for i in np.flatnonzero(curved)]
    refused += [f"{one.law.name} pulls at {one.frame!r}" for one in arm.pulls]
    compliance = arm.stack.numbers.compliance[0]
    if not np.allclose(
        compliance, np.swapaxes(compliance, 1, 2), rtol=0, atol=1e-12 * np.abs(compliance).max(initial=0)
    ):
        refused.append("a law is not symmetric")
    columns = {f"q_{joint}": place for joint, place in arm.joint_index.items()}
    found = arm.stack.factors(columns | {MASS: len(columns)})
    if refused or found is None:
        reasons = "; ".join(dict.fromkeys(refused))
        raise UnsupportedError(
            f"this arm cannot be written as C: with loops or springs it knows no such thing ({reasons})"
        )
    return found


def _room(tree: Tree, compliance: Array, varies: np.ndarray) -> int:
    """Return how many numbers the engine works with; laws that change may have any coordinates."""
    ranks = [
        6 if changes else int(np.count_nonzero(np.abs(one).max(axis=1)))
        for one, changes in zip(compliance, varies, strict=True)
    ]
    return Engine(tree).room(sum(ranks))


def _engine() -> str:
    """Return the engine's text without what a package asks of it alone."""
    header, text = (
        (build.FOLDER / one).read_text(encoding="utf-8").replace("\r\n", "\n") for one in ("engine.h", "engine.c")
    )
    text = re.sub(r"#if !defined\(CONTROLLER\)\n.*?#endif /\* CONTROLLER \*/\n", "", text, flags=re.S)
    return header + "\n" + text.replace('#include "engine.h"\n', "")


def _head(arm: Arm, stack: int, name: str) -> str:
    beside = 8 * (26 * len(arm.joint_names) + 60)
    bounds = (
        f"Every loop is bounded: {name}_follow closes the loops MOST_PARTS MOST times and weighs the arm STEPS times",
        f"at most, some 3 and 5 times usually; {name}_compensate MOST_JUMPS + 1 times as often, some 4 times usually.",
        f"Stack: {name}_tip and {name}_follow take up to {stack} bytes, {name}_compensate up to {stack + beside}.",
    )
    functions = f"{name}_tip, {name}_follow and {name}_compensate"
    return c_head(arm, functions, ", each with a state of its own", bounds)


def _tree(prefix: str, tree: Tree, elements: list[Array]) -> list[str]:
    """Return the tables of a tree, whose elements are others with every payload."""
    return [
        _rows(f"{prefix}elements", "for each payload; see engine.h", np.array([one.ravel() for one in elements])),
        _whole(f"{prefix}kinds", "kind, number, order", tree.kinds),
        _whole(f"{prefix}parents", "", tree.parents),
        _real(f"{prefix}carried", "", tree.carried),
        _real(f"{prefix}ties", "", tree.ties),
        _whole(f"{prefix}joins", "", tree.joins),
        _real(f"{prefix}rows", "", tree.rows),
        _real(f"{prefix}ways", "", tree.ways),
        *([_whole("flexures", "element of each, or -1 - its closure", tree.flexures)] if not prefix else []),
    ]


def _real(name: str, what: str, values: Array) -> str:
    """Return an array of numbers behind one another; C has none without length."""
    flat = values.ravel() if values.size else np.zeros(1)
    return _array(f"double {name}[{len(flat)}]", what, [c_number(value) for value in flat])


def _whole(name: str, what: str, values: np.ndarray) -> str:
    flat = values.ravel().tolist() or [0]
    return _array(f"whole {name}[{len(flat)}]", what, [str(value) for value in flat])


def _rows(name: str, what: str, values: Array) -> str:
    """Return a table of rows; C has none without length."""
    rows = values if len(values) else np.zeros((1, values.shape[1]))
    shown = ["{" + ", ".join(c_number(value) for value in row) + "}" for row in rows]
    return _array(f"double {name}[{len(rows)}][{rows.shape[1]}]", what, shown)


def _array(declared: str, what: str, parts: list[str]) -> str:
    lines, line = [], "   "
    for part in parts:
        if len(line) + len(part) > 110 and line.strip():
            lines.append(line)
            line = "   "
        line += f" {part},"
    comment = f" /* {what} */" if what else ""
    return "\n".join([f"static const {declared} = {{{comment}", *lines, line, "};"])
