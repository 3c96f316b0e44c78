"""The arm as one file of C99 for a controller: the engine's own text, the arm's tables, and the calls on them.

A chain comes to rest as `chain.c` beside this file says, an arm with loops, springs or cylinders as `loops.c` does.
Laws reach a chain as terms; see `laws.terms`.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from armflex.arm import Arm, Flexure
from armflex.conventions import Array
from armflex.errors import ArmflexError, UnsupportedError
from armflex.export import Exported
from armflex.export.c_text import c_arms, c_head, c_limits, c_names, c_number, c_real, c_table, c_whole, check_name
from armflex.export.rigid import measured_points, said_points
from armflex.laws import Law, LinearLaw
from armflex.laws.effects.effect import Act
from armflex.laws.effects.in_arm import BoundTwist, Pulling, about_time, depended_on
from armflex.laws.effects.location import resolve
from armflex.laws.effects.shapes import middle_of
from armflex.laws.effects.umbilical import hook_of
from armflex.laws.row import MASS
from armflex.laws.terms import Neurons, Of, Term
from armflex.mechanics.engine import build
from armflex.mechanics.engine.binding import Engine
from armflex.mechanics.engine.tables import NO_CHANGES, Factors, Laws, Tables, Tree
from armflex.mechanics.laws import LawStack
from armflex.mechanics.tree import link_frame
from armflex.rows.rows import HOLD, TIME

HERE = Path(__file__).parent

BESIDE = {"loops": 16384, "chain": 4096}
"""Bytes that functions hold beside what they are counted for; the tests compare them with the compiler's."""

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
    tied, linkage = arm.loaded(None).tied, arm.robot.linkage
    if not (tied or arm.modelled):  # C has no arrays without length: a rigid arm has a flexure that does not give
        arm = replace(arm, flexures=(Flexure("rigid", arm.joint_names[0], _stiff),))
    payloads = ("none", *(one for one in arm.payloads if one != "none"))
    loaded = [arm.loaded(one) for one in payloads]
    for one in loaded:
        _ = one.flags  # raises where a payload is impossible
    laws, factors, windowed, windows = _laws(arm)
    pulls = [row for pulling in arm.pulls for row in _pull(arm, pulling)]
    if tied:
        _refuse_curved(arm, laws)
    described = [_described(one.tree, laws, factors, pulls, windowed, windows) for one in loaded]
    tree, nominal, nq = loaded[0].tree, loaded[0].nominal, len(arm.joint_names)
    n, p, m, known = len(tree.flexures), tree.passive, len(tree.rows), len(factors.names)
    bounds = [one.stability_bound for one in loaded]
    proven = [bound is not None and bound.proven for bound in bounds]
    unproven = [] if tied else [one for one, sure in zip(payloads, proven, strict=True) if not sure]
    closed, plays = 1 + tree.driven + p if p else 0, _plays(arm, factors.names)
    state, remembering = closed + len(plays), 2 * known + 2 * len(plays)
    if tied:
        room = _room(tree, laws.compliance[0], factors.varies) + 1
        stack = 8 * (room + 58 * n + 3 * p + 2 * m * m + m + tree.driven + remembering + 86) + BESIDE["loops"]
        compensate = stack + 8 * (30 * tree.driven + 60)
    else:
        room = 91 * n + len(laws.bent) + len(factors.factor) + 9 * len(pulls) + 2
        stack = 8 * (room + nq + remembering + 12 * n + 120) + BESIDE["chain"]
        stack += 8 * (36 * n * n + 450 * n + 120) if unproven else 0
        compensate = stack + 8 * ((6 * nq + 12) * n + 20 * nq + 60)
    counts = {
        "JOINTS": (nq, "drives, cylinders among them"),
        "PAYLOADS": (len(payloads), "payloads"),
        "COVARIATES": (known, "covariates"),
        "FACTORS": (len(factors.factor), "functions of a column, the first is 1"),
        "PASSIVE": (p, "joints without a drive"),
        "FLEXURES": (n, "flexures"),
        "ROWS": (m, "rows that ties close"),
        "STANDING": (closed, "numbers that say where loops closed"),
        "PLAYS": (len(plays), "flexures that remember a load"),
        "STATE": (state, "numbers that are carried from call to call"),
        "ROOM": (room, "numbers that are worked with"),
    }
    if tied:
        closing = loaded[0].mechanics.true
        start, home, settled = closing.beginning() if linkage else (np.zeros(0), arm.robot.home.copy(), np.zeros(0))
        straight = not linkage or settled is None or closing.given
        counts |= {"HOME": (int(settled is not None), "whether the loops close at home")}
        counts |= {"STRAIGHT": (int(straight), "whether q0 is given")}
        constants = [
            c_real("home", "drives at home [rad or m]", home),
            c_real("home_passive", "joints without a drive there", start if settled is None else settled),
            c_real("start_passive", "their q0", start),
        ]
    else:
        what = "whether a payload's weight is proven to be unable to make the arm buckle"
        constants = [c_whole("proven", what, np.array(proven))]
    tables = [
        "enum {\n" + "\n".join(f"    {key} = {value}, /* {what} */" for key, (value, what) in counts.items()) + "\n};",
        f"const int {name}_nq = JOINTS;",
        f"const int {name}_nstate = STATE;",
        c_names(f"{name}_joints", arm.joint_names),
        c_names(f"{name}_passive", linkage.free if linkage else ()),
        c_names(f"{name}_payloads", payloads),
        c_names(f"{name}_covariate_names", factors.names),
        f"double {name}_covariates[{max(1, known)}] = {{{', '.join(['NAN'] * known) or '0.0'}}};",
        c_limits(arm, "drive"),
        c_table(
            "whole remembered[PLAYS + 1][2]",
            "covariate that each remembered load is, and flexure",
            [f"{{{covariate}, {flexure}}}," for covariate, flexure, _ in plays] or ["{0, 0},"],
        ),
        c_table(
            "double plays_of[PLAYS + 1][7]",
            "along what, and the radius [N or Nm]",
            [f"{c_number(play)}," for *_, play in plays] or ["{0.0},"],
        ),
        c_real("masses", "of the payloads [kg]", np.array([arm.payload(one).mass for one in payloads])),
        *constants,
        *c_arms("arms", described),
        *(c_arms("nominal", [Tables(nominal)]) if nominal else ()),
    ]
    beside = f"Stack: {name}_tip and {name}_follow take up to {stack} bytes, {name}_compensate up to {compensate}."
    lines = [line.replace("NAME", name) for line in BOUNDS["loops" if tied else "chain"]] + [beside]
    lines[-1:-1] = (*(NEWTON if unproven else ()), *((REMEMBERING,) if plays else ()))
    functions = f"{name}_tip, {name}_follow and {name}_compensate"
    own = ("LOOPS",) if tied else ("CHAIN",) if unproven else ("CHAIN", "PROVEN")
    texts = ("controller", "loops" if tied else "chain")  # renamed before the arm's names come in, which may be any
    text, mechanics = (
        re.sub(r"\bNAME_(?=[a-z])", f"{name}_", (HERE / f"{stem}.c").read_text(encoding="utf-8")) for stem in texts
    )
    for mark, part in (
        ("/*@mechanics*/", _without(mechanics, own)),
        ("/*@head*/", c_head(arm, functions, ", each with a state of its own" if state else "", lines)),
        ("/*@engine*/\n", _engine(own)),
        ("/*@constants*/", "\n".join(tables)),
        ("/*@nominal*/\n", "    m.table = nominal[0];\n" if nominal else ""),
    ):
        text = text.replace(mark, part)
    notes = [f"{arm.robot.urdf.name} as C, payloads {', '.join(payloads)}"]
    notes += [f"{name}_follow carries {state} numbers from call to call"] if state else []
    carried = [factors.names[covariate] for covariate, *_ in plays]
    outer = [column for column in factors.names if column not in carried]
    notes += [f"set {name}_covariates before you ask: {', '.join(outer)}"] if outer else []
    notes += [f"{name}_follow carries what flexures remember, unless you set it: {', '.join(carried)}"] if plays else []
    notes += [
        f"payload {one!r}: no bound proves that the arm cannot buckle; every answer is probed" for one in unproven
    ]
    outside = [effect.name for effect in arm.effects if effect.law.act in (Act.FRAME, Act.SCALE, Act.SIGHT)]
    notes += [f"of the instrument, and so not in it: {', '.join(outside)}"] if outside else []
    notes += said_points(measured_points(arm), carried=False)
    said = {
        "name": name,
        "joint_names": list(arm.joint_names),
        "payloads": list(payloads),
        "covariates": list(factors.names),
        "stack_bytes": {"tip": stack, "follow": stack, "compensate": compensate},
    }
    new = [flag for one in loaded for flag in arm.new_payload(one.payload)]
    return Exported(text, tuple(notes), said, (*about_time(arm, (TIME, HOLD)), *new))


BOUNDS = {
    "loops": (
        "Every loop is bounded: NAME_follow closes the loops MOST_PARTS MOST times and weighs the arm STEPS times",
        "at most, some 3 and 5 times usually; NAME_compensate MOST_JUMPS + 1 times as often, some 4 times usually.",
    ),
    "chain": (
        "Every loop is bounded: NAME_tip weighs the arm MOST_STEPS + PROBES times at most, and NAME_compensate",
        "(MOST_JUMPS + 1) (JOINTS + 1) MOST_STEPS + PROBES times; some 5 and some 100 times are usual.",
    ),
}
"""How long calls take, for the head of the file."""

NEWTON = (
    "Where no bound proves that the arm cannot buckle, Newton's method may take the place of MOST_STEPS:",
    "it weighs MOST_NEWTON (6 FLEXURES + MOST_HALVINGS + 2) times at most, 4 (6 FLEXURES + 3) usually.",
)

REMEMBERING = "Flexures remember their loads: the arm comes to rest twice in a call."


def _described(
    tree: Tree,
    laws: Laws,
    factors: Factors,
    pulls: Sequence[tuple[list[int], Array, Array]],
    windowed: np.ndarray,
    windows: Array,
) -> Tables:
    """Return an arm as the engine is given it."""
    tables = Tables(tree)
    tables.set_laws(laws, 1)
    links, wrenches, pulling = (np.array([one[part] for one in pulls]) for part in range(3))
    tables.set_loads(links.astype(np.int64).reshape(-1, 3), wrenches.reshape(1, -1, 9), NO_CHANGES, 1)
    tables.set_factors(factors, np.zeros(1 + len(factors.names)))
    tables.set_pulls(pulling.reshape(-1, 6))
    tables.set_windows(windowed, windows.reshape(-1, 79))
    return tables


def _plays(arm: Arm, names: Sequence[str]) -> list[tuple[int, int, Array]]:
    """Return of every effect that remembers a load its covariate and flexure by number, and direction and radius."""
    number = {law.effect: i for i, law in arm.stack.parts if isinstance(law, BoundTwist)}
    remembering = (one for one in arm.effects if one.law.remembers_load(one.location) and one.state in names)
    return [
        (
            names.index(one.state),
            number[one],
            np.append(resolve(one.location, arm.robot, arm.flexures).direction, one.inner),
        )
        for one in remembering
    ]


def _refuse_curved(arm: Arm, laws: Laws) -> None:
    """Refuse laws and loads that C with loops does not know, all at once."""
    curved = np.flatnonzero((np.diff(laws.starts) > 0) | (np.diff(laws.spans) > 0))
    refused = [f"the law of flexure {arm.flexure_names[i]!r} is curved in the load" for i in curved]
    refused += [f"{one.law.name} pulls at {one.frame!r}" for one in arm.pulls]
    if refused:
        text = "this arm cannot be written as C: with loops or springs it knows no such thing"
        raise UnsupportedError(f"{text} ({'; '.join(refused)})")


def _room(tree: Tree, compliance: Array, varies: np.ndarray) -> int:
    """Return how many numbers the engine works with; laws that change may have any coordinates."""
    rank = np.where(varies, 6, np.count_nonzero(np.abs(compliance).max(axis=2), axis=1)).sum()
    return Engine(tree).room(int(rank))


class _InTerms(Law):
    """What C knows of the laws of a flexure: their terms, windows among them."""

    values = np.zeros(0)
    parameters = property(lambda _: ())

    def __init__(self, terms: Sequence[Term | Neurons]) -> None:
        self.known_terms = terms  # pyright: ignore[reportAttributeAccessIssue] - here all of them count

    def at(self, values: Array) -> Law:
        """Return itself: there are no values."""
        return self


def _laws(arm: Arm) -> tuple[Laws, Factors, np.ndarray, Array]:
    """Return the laws of a chain in numbers: what changes with columns, the window of each term, and the windows."""
    said = _said(arm)
    stack = LawStack(arm.flexure_names, tuple(map(_InTerms, said)))
    known = [*(f"q_{joint}" for joint in arm.joint_names), MASS]
    used = dict.fromkeys(factor.column for own in said for term in own for factor in term.factors)
    names = tuple(column for column in used if column not in known)
    laws, found = stack.numbers, stack.factors({column: place for place, column in enumerate([*known, *names])})
    assert found is not None
    same = ~found.change[:, 1:3].any(axis=1)  # no part of what changes, but of what is the same everywhere
    for row in found.change[same]:
        laws.offset[0, int(row[0])] += row[3:9]
        laws.compliance[0, int(row[0])] += row[9:].reshape(6, 6)
    change, varies = found.change[~same], np.zeros(len(said), dtype=np.int64)
    varies[change[:, 0].astype(int)] = 1
    windows: dict[bytes, tuple[int, Array]] = {}
    windowed = np.full(len(laws.bent), -1, dtype=np.int64)
    for t, (_, _, term) in enumerate(stack.bent):
        if (seen := term.window) is not None:
            energy = seen.precision if seen.energy is None else seen.energy
            faded = seen.faded if np.isfinite(seen.faded) else 0.0
            row = np.concatenate([seen.mean, seen.precision.ravel(), energy.ravel(), [faded]])
            windowed[t] = windows.setdefault(row.tobytes(), (len(windows), row))[0]
    found = replace(found, change=change, varies=varies, names=names)
    return laws, found, windowed, np.array([row for _, row in windows.values()])


def _said(arm: Arm) -> list[list[Term | Neurons]]:
    """Return the terms of every flexure's laws; refuse all that have none at once."""
    said: list[list[Term | Neurons]] = [[] for _ in arm.flexure_names]
    refused = []
    for number, law in arm.stack.parts:
        try:
            terms = law.terms()
            for factor in {factor for term in terms for factor in term.factors if factor.kind is Of.CHEBYSHEV}:
                joint, (middle, reach, _) = arm.joint_index[factor.column.removeprefix("q_")], factor.numbers
                if max(arm.robot.upper[joint] - middle, middle - arm.robot.lower[joint]) > (1.0 + TRAVEL) * reach:
                    raise UnsupportedError(f"was learned over less than the travel of {arm.joint_names[joint]}")
            said[number].extend(terms)
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


def _pull(arm: Arm, pulling: Pulling) -> list[tuple[list[int], Array, Array]]:
    """Return a load effect as link, wrench and pull for the engine, nothing where it acts on what stands."""
    bare = arm.loaded(None)
    _, element, _, placement = link_frame(bare.with_tool.model, bare.with_tool.frame(pulling.frame))
    flexures = bare.tree.flexures_inboard(element)
    if not flexures:
        return []
    kind, hook, anchor, size, reach = PULLS[pulling.law.name](pulling)
    force = anchor if kind == WRENCH else np.zeros(3)
    wrench = np.concatenate([placement.act(hook), force, np.zeros(3)])
    return [([element, flexures, 0], wrench, np.array([kind, *anchor, size, reach]))]


WRENCH, SPRING, MAGNET = range(3)

Pull = tuple[int, Array, Sequence[float], float, float]

PULLS: dict[str, Callable[[Pulling], Pull]] = {
    "tip_force": lambda one: (WRENCH, np.zeros(3), one.amplitudes, 1.0, 0.0),
    "umbilical": lambda one: (SPRING, hook_of(one.here, one.inner), one.inner[:3], one.amplitudes[0], one.inner[3]),
    "magnetic_pull": lambda one: (MAGNET, middle_of(one.here), one.inner[:3], one.amplitudes[0], one.inner[3]),
}
"""Kind, hook in its link's frame, anchor in base axes, size and reach of effects that are loads."""


# The text.


def _engine(own: Sequence[str]) -> str:
    """Return the engine's text without what a package asks of it alone, and what arms of a kind do without."""
    header, text, rest = (
        _without((build.FOLDER / one).read_text(encoding="utf-8").replace("\r\n", "\n"), ("CONTROLLER", *own))
        for one in ("engine.h", "engine.c", "rest.h")
    )
    text = text.replace('#include "engine.h"\n', "").replace('#include "rest.h"\n', rest)
    return "".join(f"#define {name} 1\n" for name in own) + f"{header}\n{text}"


def _without(text: str, names: Sequence[str]) -> str:
    """Return C without the parts for those of whom names are not defined."""
    for name in names:
        text = re.sub(rf"#if !defined\({name}\)\n.*?#endif /\* {name} \*/\n", "", text, flags=re.S)
    return text
