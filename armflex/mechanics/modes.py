"""How a loaded arm swings about its equilibrium while its drives hold: natural frequencies and mode shapes.

With m the flexures' exponential coordinates, J the body motion per change of them, G the geometric stiffness and M the
mass matrix of the deflected arm, C the laws' tangent at their loads, the equilibrium m = law(load) moves by

    dm = -C (G J dm + M J dm''),        (1 + C G J) phi = w^2 C M J phi    for  dm = phi exp(i w t).

Motions are within the range of C = R R', dm = R y (a direction without compliance does not move), so

    K y = w^2 B y,      K = 1 + R'G J R,      B = R'M J R.

In a mechanism J has what the joints without a drive do, and y lies where they close the loops; forces in these do no
work.

Where flexures turn, K and B are symmetric but for a small part: exp6 of a finite twist does not commute. The symmetric
problem (Bathe, Finite Element Procedures, 2nd ed. 2014, ch. 10) is solved, and the small part is added by perturbation
to second order in frequencies and to first order in shapes, or exactly where it is not small.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import Flag, InputError, UnstableEquilibriumError
from armflex.mechanics.equilibrium import Equilibrium
from armflex.mechanics.loaded import Names
from armflex.mechanics.pinocchio_model import frame_jacobian
from armflex.result import Result

DAMPING = 0.01
"""Damping ratio of every mode where an arm.toml does not state one: welded and bolted steel has 0.005 to 0.02."""

NEGLIGIBLE = 1e-13
"""Tolerance: share of the largest compliance, or of the largest 1 / w^2, that is rounding."""

WIDE = 0.3
"""Prior: radius of gyration [m] of a payload of which none is stated."""

FORBIDDEN = 1e-9
"""Tolerance: share of what flexures open of the loops that is rounding, where joints without a drive follow."""

SMALL = 1e-2
"""Tolerance: share of a neighbouring mode in a mode's shape up to which a perturbation is exact to 1e-6."""


@dataclass(frozen=True, repr=False, eq=False)
class Modes(Result):
    """Modes of vibration, the slowest first.

    Attributes:
        frequencies: (m,) natural frequencies [Hz].
        damping_ratios: (m,) damping over critical damping, dimensionless.
        shapes: (m, 6) motion of the tip's origin in base axes [m, rad], of length 1 m along its shift, or 1 rad where
            it only turns.
        twists: (m, n, 6) motion of the flexures with it, local axes [m, rad].
        masses: (m,) modal mass for these shapes [kg, or kg m^2 where the tip only turns].
        sensitivities: (m, n) relative change of a frequency per relative change of a flexure's stiffness, its loads as
            they are. Without gravity those of a mode add up to one half.
        momenta: (m, 6 n) size of a mode per motion of the flexures [1/m, 1/rad]; None where it was not asked for.
        drives: (m, nq) change of a mode's speed per change of a joint's speed [1/m, 1/rad], while the flexures follow
            as loads redistribute; None likewise.
        names: Of joints and flexures, base and tip.
        flags: What is missing of the inertias, and where the damping comes from.
    """

    FIELDS = ("frequencies", "damping_ratios", "shapes", "masses", "sensitivities", "flags")
    ROWS = "table"

    frequencies: Array
    damping_ratios: Array
    shapes: Array
    twists: Array
    masses: Array
    sensitivities: Array
    names: Names
    flags: tuple[Flag, ...] = ()
    momenta: Array | None = None
    drives: Array | None = None

    @property
    def decays(self) -> Array:
        """(m,) time in which the swing falls to 37 % [s]."""
        return 1.0 / (2.0 * np.pi * self.damping_ratios * self.frequencies)

    @property
    def table(self) -> dict[str, Array]:
        """A row for every mode, SI."""
        tip = {f"tip_{axis}": self.shapes[:, i] for i, axis in enumerate(("x", "y", "z", "rx", "ry", "rz"))}
        return {"frequency": self.frequencies, "damping_ratio": self.damping_ratios, "mass": self.masses, **tip}


def modes_of(found: Equilibrium, count: int, damping: float | None, driven: bool = False) -> Modes:
    """Return the slowest modes about an equilibrium.

    Args:
        found: The equilibrium.
        count: How many modes at most.
        damping: Damping ratio; `DAMPING` where None, with a flag.
        driven: Whether to say what motions of the drives do to them: `momenta` and `drives`.

    Raises:
        InputError: The arm has no flexure or no mass that moves, or `count` is below 1.
        UrdfError: Moments of inertia are such as no body has.
        UnstableEquilibriumError: The arm would not stay at the equilibrium.
    """
    loaded, mechanics = found.loaded, found.loaded.mechanics
    arm, places = loaded.arm, mechanics.flex.flexure_v
    if count < 1:
        raise InputError(f"count is {count}, expected 1 mode or more")
    if not len(places):
        raise InputError("the arm declares no flexure: it is rigid, and does not swing")
    arm.robot.check_motion()
    configuration, torque, row = found.placed.configuration, found.placed.torque, found.row
    compliance = arm.stack.tangent(-torque[places], row)
    whole = pin.crba(mechanics.model, mechanics.data, configuration)
    for number, more in loaded.arm.distributed.items():  # links that bend along their length
        own = places[6 * number : 6 * number + 6]
        joint = next(joint.id for joint in mechanics.model.joints if joint.nv == 6 and joint.idx_v == own[0])
        both = np.vstack([pin.computeJointJacobian(mechanics.model, mechanics.data, configuration, joint)] * 2)
        both[:6, own], both[6:] = 0.0, np.eye(both.shape[1])[own]
        whole += both.T @ more @ both
    root, owner = _root(compliance)
    turned, right, left, (free, bent), softened, by_drive = _allowed(found, root)
    stiffness, mass = left.T @ softened @ right, left.T @ whole @ right
    inverse, ways = _slowest(bent.T @ free + stiffness, mass, count)
    ways = free @ ways
    motion = (root @ ways).T  # (m, 6 n)
    tip = motion @ turned.T @ mechanics.tip_jacobian(configuration).T
    shift, turn = np.linalg.norm(tip[:, :3], axis=1), np.linalg.norm(tip[:, 3:], axis=1)
    still = shift <= NEGLIGIBLE * turn  # the tip only turns
    unit = np.where(still, turn, shift)
    unit = np.where(unit > 0.0, unit, 1.0)[:, None]
    tip, motion, ways = tip / unit, motion / unit, ways.T / unit
    body = motion @ turned.T
    masses = ((body @ whole) * body).sum(axis=1)
    frequencies = 1.0 / (2.0 * np.pi * np.sqrt(inverse))
    energies = ways**2 @ (owner[:, None] == np.arange(len(places) // 6))  # of the flexures, as dm'C^-1 dm = y'y
    shares = energies / (masses / inverse)[:, None]
    text = f"[robot] states no damping_ratio: {DAMPING:g} is assumed for every mode"
    flags = () if damping is not None else (Flag("damping_assumed", text),)
    flags += (*_pointlike(found, configuration, body, masses), *arm.new_payload(loaded.payload))
    ratios = np.full(len(masses), DAMPING if damping is None else damping)
    twists, momenta, drives = motion.reshape(len(masses), -1, 6), None, None
    if driven:
        momenta = body @ whole @ turned / masses[:, None]
        drives = -(body @ whole @ by_drive(arm.stack.change_with_position(-torque[places], row))) / masses[:, None]
    names = loaded.arm.names
    return Modes(frequencies, ratios, tip, twists, masses, 0.5 * shares, names, flags, momenta, drives)


Allowed = tuple[Array, Array, Array, tuple[Array, Array], Array, Callable[[Array], Array]]
"""(nv, 6 n) body motion of everything per twist of the flexures; (nv, k) of it per coordinate of laws that nothing
forbids, by twists and by body motions of the flexures; bases of those coordinates; (nv, nv) geometric
stiffness; and from (6 n, nq) changes of laws with the drives to the (nv, nq) motion of everything with them."""


def _allowed(found: Equilibrium, root: Array) -> Allowed:
    """Return what loops allow: joints without a drive follow, and what they cannot follow is forbidden."""
    mechanics = found.loaded.mechanics
    flex, nv, idle = mechanics.flex, mechanics.model.nv, mechanics.idle(found.case, found.row)
    linear = mechanics.linear(found.placed, idle)
    tree, count = flex.flexure_v < nv, len(flex.flexure_v)
    ways = linear.ways - idle @ (idle.T @ linear.ways)
    answers = np.linalg.pinv(ways[:, flex.free_v])
    maps, bases = [], []
    for bodily in (linear.bodily, np.eye(len(linear.bodily))):
        moved, opened = np.zeros((nv, count)), np.zeros((len(ways), count))
        moved[np.ix_(flex.flexure_v[tree], tree)] = bodily
        opened[:, ~tree] = -linear.rows[:, flex.flexure_v[~tree] - nv]
        opened += ways @ moved
        left = (opened - ways[:, flex.free_v] @ (answers @ opened)) @ root
        moved[flex.free_v] -= answers @ opened
        _, sizes, rows = np.linalg.svd(left)
        sizes = np.append(sizes, np.zeros(len(rows) - len(sizes)))
        maps.append(moved)
        bases.append(rows[sizes <= FORBIDDEN * np.linalg.norm(opened @ root)].T)
    bases[1] = bases[1] @ (bases[1].T @ bases[0])  # nearly the same: near each other, too

    def by_drive(change: Array) -> Array:
        drives = np.concatenate([linear.by_motion[:, flex.v_index], linear.by_gap[:, linear.lengths]], axis=1)
        return drives + linear.by_law @ change

    right, left = (moved @ root @ base for moved, base in zip(maps, bases, strict=True))
    return maps[0], right, left, (bases[0], bases[1]), linear.turned, by_drive


def _root(compliance: Array) -> tuple[Array, np.ndarray]:
    """Return (6 n, r) R with R R' = C of a (6 n, 6 n) block-diagonal compliance, and the flexure of every column.

    Raises:
        InputError: No flexure bends.
    """
    blocks = np.einsum("kikj->kij", compliance.reshape(len(compliance) // 6, 6, -1, 6))
    sizes, axes = np.linalg.eigh(0.5 * (blocks + blocks.swapaxes(1, 2)))
    bends = np.nonzero(sizes > NEGLIGIBLE * sizes.max())
    if not len(bends[0]):
        raise InputError("no flexure bends under these loads: the arm is rigid, and does not swing")
    columns = np.arange(len(bends[0]))
    roots = np.zeros((len(blocks), 6, len(columns)))
    roots[bends[0], :, columns] = (axes[bends[0], :, bends[1]].T * np.sqrt(sizes[bends])).T
    return roots.reshape(len(compliance), -1), bends[0]


def _slowest(stiffness: Array, mass: Array, count: int) -> tuple[Array, Array]:
    """Return the (m,) largest 1 / w^2 [s^2] of (r, r) matrices K and B, and the (r, m) vectors y.

    Raises:
        InputError: Nothing that moves has a mass.
        UnstableEquilibriumError: K is not positive.
    """
    from scipy.linalg.lapack import dsygvd  # pyright: ignore[reportAttributeAccessIssue] - not in its stubs

    even, inert = 0.5 * (stiffness + stiffness.T), 0.5 * (mass + mass.T)
    found, ways, failed = dsygvd(inert.T, even.T)  # the same, in the order of columns that LAPACK has
    if failed:
        least = float(np.linalg.eigvalsh(even)[0])
        text = "the arm would not stay where its loads balance: there is nothing to swing about"
        raise UnstableEquilibriumError(text, least)
    some = np.flatnonzero(found > NEGLIGIBLE * max(found[-1], 0.0))[::-1][:count]
    if not len(some):
        raise InputError("nothing that moves has a mass: there is no frequency")
    own = found[some]
    chosen = ways[:, some]
    off = ways.T @ ((mass - inert) @ chosen - own * ((stiffness - even) @ chosen))
    gaps = own - found[:, None]
    gaps[some, np.arange(len(some))] = np.inf
    mixed = off / np.where(gaps == 0.0, 1e-300, gaps)
    if np.abs(mixed).max(initial=0.0) > SMALL:
        eigenvalues, exact = np.linalg.eig(np.linalg.solve(stiffness, mass))
        every, growing = np.real(eigenvalues), np.imag(eigenvalues)
        some = np.argsort(-every)[: len(some)]
        if np.abs(growing[some]).max() > SMALL**2 * every[some[0]]:
            text = "loads that follow the arm feed its swing: two modes grow together, and there is no frequency"
            raise UnstableEquilibriumError(text, float(every[some].min()))
        return every[some], np.real(exact[:, some])
    return own - (off * mixed).sum(axis=0), chosen + ways @ mixed


def _pointlike(found: Equilibrium, configuration: Array, body: Array, masses: Array) -> Iterator[Flag]:
    """Yield the flag about links that are declared as points: how much their moments of inertia would matter.

    Each is taken as a slender rod along its longest way, m l^2 / 12.
    """
    mechanics, robot = found.loaded.mechanics, found.loaded.arm.robot
    model, data, motion = mechanics.model, mechanics.data, body[0]
    lost: dict[str, float] = {}
    for link in robot.pointlike:
        inertial = robot.urdf.links[link].inertial
        if inertial is None or link not in mechanics.flex.links:
            continue
        ways = [*(joint.origin for joint in robot.urdf.children[link]), 2.0 * inertial.origin]
        way = max(ways, key=lambda one: float(np.linalg.norm(one)))
        frame = mechanics.flex.frame(link)
        turn = (frame_jacobian(model, data, configuration, frame, pin.LOCAL) @ motion)[3:]
        across = np.cross(turn, way)  # of a rod only what turns it end over end counts
        lost[link] = 0.5 * inertial.mass * float(across @ across) / 12.0 / float(masses[0])
    carried = found.loaded.payload
    if carried.mass and carried.inertia is None:
        tip = mechanics.flex.frame(robot.tip)
        turn = (frame_jacobian(model, data, configuration, tip, pin.LOCAL) @ motion)[3:]
        share = 0.5 * carried.mass * WIDE**2 * float(turn @ turn) / float(masses[0])
        text = f"the payload has a mass but no moments of inertia: with a radius of gyration of {WIDE:g} m it would"
        yield Flag("no_inertia", f"{text} lower the first frequency by {share:.2%}", size=share)
    if lost:
        most = sorted(lost.items(), key=lambda pair: -pair[1])[:3]
        text = ", ".join(f"{link} (as a rod it would lower the first frequency by {share:.2%})" for link, share in most)
        yield Flag("no_inertia", f"{len(lost)} links have a mass but no moments of inertia: {text}", size=most[0][1])
