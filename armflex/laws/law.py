"""What a joint deformation model is: a load in, a small twist out, at one place of the arm."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np

from armflex.conventions import WRENCH_NAMES, Array, root_of_covariance
from armflex.declaration import Declaration
from armflex.errors import Flag, LawError, UnsupportedError, did_you_mean
from armflex.laws.row import NOWHERE as NOWHERE
from armflex.laws.row import Row as Row
from armflex.laws.terms import NOTHING, UNITS, Factor, Terms, affine_of, straight, tangent_of, twist_of, weight_of
from armflex.robot import Robot

STEP = 1e-4
"""Relative step of numerical derivatives."""

LEAST = 0.1
"""What a step leaves at least of a factor."""

ROUNDING = 1e-9
"""Part of a load [Nm per N] below which a moment is none."""

ONE_NUMBER = 1e-4
"""Tolerance: relative error of the entries of a compliance of rank one, as people write them."""

Ranges = Mapping[str, tuple[float, float]]
"""Driven joints of a chain: lowest and highest position [rad or m]."""


class Travel(dict[str, tuple[float, float]]):
    """The `Ranges` of an arm, with how its joints move.

    Attributes:
        followers: Joints that a gear, a belt or a <mimic> ties to another: its name, factor and offset [rad, m].
        slides: (3,) unit axis of every sliding joint, in the frame that it moves.
    """

    def __init__(
        self, ranges: Ranges, followers: Mapping[str, tuple[str, float, float]], slides: Mapping[str, Array]
    ) -> None:
        super().__init__(ranges)
        self.followers, self.slides = followers, slides


def driver_of(table: Declaration, joint: str, ranges: Ranges) -> tuple[str, float, float]:
    """Return the driven joint that moves what a law `depends_on`, the flexure's own joint where absent.

    Returns:
        Its name, and factor and offset by which the position of the joint depended on follows from its own [rad, m].

    Raises:
        ArmFileError: No driven joint moves it.
    """
    owner = table.text("depends_on", joint)
    driver, factor, offset = driven_by(owner, ranges)
    if driver in ranges:
        return driver, factor, offset
    follows = f" follows {driver!r}, which" if driver != owner else ""
    hint = did_you_mean(driver, ranges)
    raise table.fail("depends_on", f"{owner!r}{follows} is no driven joint of the chain{hint}")


def driven_by(joint: str, ranges: Ranges) -> tuple[str, float, float]:
    """Return the joint that a joint follows, or itself, and the factor and offset by which it does [rad, m]."""
    driver, factor, offset = joint, 1.0, 0.0
    followers = ranges.followers if isinstance(ranges, Travel) else {}
    while driver in followers:
        driver, times, more = followers[driver]
        factor, offset = factor * times, factor * more + offset
    return driver, factor, offset


class Transform(Enum):
    """How a parameter's value, which fits and draws move, stands for the number that is meant."""

    IDENTITY = "identity"
    """The value is the number."""
    LOG = "log"
    """The value is the logarithm of a number that stays positive, or of a factor on one."""


@dataclass(frozen=True)
class Parameter:
    """One number of a law. The object is its identity; text labels are made where files and reports begin.

    Attributes:
        name: Unique within its law, without blanks.
        unit: Of the value; "1" of a logarithm.
        prior: Standard deviation about the value that it has; 0 where it is taken as known.
        transform: What the value stands for.
        group: Parameters of one group are of one size beforehand.
        sized: Whether that size is estimated from the data (by evidence); `prior` is then where the search starts.
    """

    name: str
    unit: str
    prior: float
    transform: Transform = Transform.IDENTITY
    group: str = ""
    sized: bool = False


class Law(ABC):
    """A joint deformation model. Wrench [N, Nm] is the load on the structure and twist [m, rad] the motion it gives,
    both linear first and in the flexure's own axes.

    A law is an immutable object that *has* its values: it is asked millions of times at the same ones, and what it can
    prepare for them (a factor, a stacked matrix, numbers for compiled code) belongs to the object. What a law must say
    is abstract, and its `terms`, or its `twist` where it is no sum of terms. Everything that follows from those is
    written here once and is right for every law; a law overrides it where it knows something exactly or quickly
    (`tangent`, `by_values`, `affine`, `compliance_bound`).
    """

    values: Array
    """(k,) values of the parameters in their units: a field or a property of every law."""

    relative_std: float = 0.0
    """Declared relative standard uncertainty of what the law gives, 0 for none."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """What the law's values are; see `Parameter`."""

    @abstractmethod
    def at(self, values: Array) -> Law:
        """Return the law at other (k,) values, in its parameters' units."""

    def terms(self) -> Terms:
        """Return the law as terms, in which the engine and exported C know it; see `laws.terms`.

        Raises:
            UnsupportedError: It is no sum of terms; the text says why, as what follows the law's name.
        """
        if self.constant is None:
            raise UnsupportedError(f"is a {type(self).__name__}, which has no form in C")
        return (straight(self.constant),)

    def weight(self, factors: Sequence[Factor], row: Row) -> Array | float:
        """Return the (...,) product of the factors of one of the terms in a row, dimensionless."""
        return weight_of(factors, row)

    @cached_property
    def known_terms(self) -> Terms | None:
        """The law's terms, None where it has none that count under every load."""
        try:
            terms = tuple(self.terms())
        except UnsupportedError:
            return None
        return terms if all(term.window is None for term in terms) else None

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the (..., 6) twist [m, rad] under a (..., 6) wrench [N, Nm]; here that of the terms."""
        return twist_of(self.terms() if self.known_terms is None else self.known_terms, wrench, row, self.weight)

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return the (..., 6, 6) derivative of the twist by the wrench [m/N, rad/Nm].

        Here that of the terms; by central differences where there are none.
        """
        if self.known_terms is None:
            return by_wrench(self.twist, wrench, row)
        return tangent_of(self.known_terms, wrench, row, self.weight)

    def by_values(self, wrench: Array, row: Row) -> Array:
        """Return the (..., 6, k) derivative of the twist [m, rad] by the values; here by central differences."""
        columns = np.zeros((*wrench.shape, len(self.values)))
        for i, (value, parameter) in enumerate(zip(self.values, self.parameters, strict=True)):
            step = np.zeros(len(self.values))
            step[i] = STEP * max(abs(float(value)), 1.0 if parameter.transform is Transform.LOG else 1e-300)
            ends = [self.at(self.values + side * step).twist(wrench, row) for side in (1.0, -1.0)]
            columns[..., i] = (ends[0] - ends[1]) / (2.0 * step[i])
        return columns

    @property
    def values_covariance(self) -> Array | None:
        """(k, k) covariance of the values in their units, None where they are known; here that of the priors."""
        prior = np.array([parameter.prior for parameter in self.parameters])
        return np.diag(prior**2) if prior.any() else None

    @cached_property
    def _root(self) -> Array | None:
        """(k, k) root of `values_covariance`."""
        covariance = self.values_covariance
        return None if covariance is None else root_of_covariance(covariance)

    def scatter(self, wrench: Array, row: Row) -> Array | None:
        """Return the (..., 6, 6) covariance of a single reading [m, rad] about the law, None where none is known."""
        return None

    def widening(self, wrench: Array, row: Row) -> Array | float:
        """Return the (...,) dimensionless factor by which deviations exceed what values and scatter make them."""
        return 1.0

    def covariance(self, wrench: Array, row: Row) -> Array | None:
        """Return the (..., 6, 6) covariance of the twist [m, rad], of values and scatter; None where none is known."""
        covariance = self.scatter(wrench, row)
        if self._root is not None:
            by = self.by_values(wrench, row) @ self._root
            by = by @ np.swapaxes(by, -1, -2)
            covariance = by if covariance is None else by + covariance
        if covariance is None:
            return None
        widened = np.square(self.widening(wrench, row))
        return np.broadcast_to(covariance, (*wrench.shape, 6)) * widened[..., None, None]

    def draw(self, rng: np.random.Generator) -> Law:
        """Return a law drawn from what is known of this one: its values, not the scatter of single readings."""
        if self._root is None:
            return self
        return self.moved(self._root @ rng.normal(size=self._root.shape[1])).certain()

    def certain(self) -> Law:
        """Return the law with its values taken as known; single readings scatter as before."""
        if self.values_covariance is None:
            return self
        as_dataclass: Any = self  # every law that may be uncertain is one
        return replace(as_dataclass, relative_std=0.0)

    def moved(self, step: Array) -> Law:
        """Return the law a (k,) step of its values away, in their units.

        A step of a logarithm is taken as one of the factor: what several factors do against each other cancels in a
        straight line alone, and that is what a covariance says.
        """
        logs = np.array([parameter.transform is Transform.LOG for parameter in self.parameters], dtype=bool)
        return self.at(self.values + np.where(logs, np.log(np.maximum(1.0 + step, LEAST)), step))

    @property
    def parts(self) -> tuple[Law, ...]:
        """Laws whose twists add up to this one's."""
        return (self,)

    @property
    def leaves(self) -> tuple[Law, ...]:
        """The laws that are made of no others, in whose axes something was declared or trained."""
        return (self,)

    @property
    def constant(self) -> Array | None:
        """(6, 6) compliance [m/N, rad/Nm] where the twist is proportional to the load everywhere alike, else None."""
        return None

    def affine(self, row: Row) -> tuple[Array, Array] | None:
        """Return the (..., 6) twist without load [m, rad] and the (..., 6, 6) compliance, None of a curved law."""
        if self.constant is not None:
            return NOTHING, self.constant
        return None if self.known_terms is None else affine_of(self.known_terms, row, self.weight)

    def compliance_bound(self, ranges: Ranges) -> Array | None:
        """Return (2, 2) bounds of the tangent's 3 x 3 blocks [m/N, rad/Nm], by their 2-norm, None where none is known.

        They hold under every load, and wherever the joints are within their ranges.
        """
        return None if self.constant is None else block_norms(self.constant)

    def gives(self, row: Row) -> tuple[int, ...]:
        """Return the axes (0 to 5) that give under a small load of their own."""
        return tuple(np.flatnonzero(np.diagonal(self.tangent(np.zeros(6), row)) > 0.0).tolist())

    def freed(self, row: Row) -> tuple[int, ...]:
        """Return the axes whose compliance [prior] frees: of a law as declared, where it gives, of a trained one none.

        `row` is anywhere within the joints' travel.
        """
        return () if self.trained else tuple(axis for axis in self.gives(row) if axis in self.projections)

    @cached_property
    def sole_axis(self) -> int | None:
        """Axis that names the one number of a constant compliance, None where it has several; see `sole_axis`."""
        return sole_axis(self.constant)

    @cached_property
    def projections(self) -> Mapping[int, Array]:
        """(6, 6) projections, dimensionless, of a load on what one number bears, by its axis; their sum is 1.

        Every axis has a number of its own, but of a hinge that is drawn obliquely, which bends about several by one.
        """
        axis = self.sole_axis
        return {i: np.diag(unit) for i, unit in enumerate(UNITS)} if axis is None else {axis: UNITS}

    def scaling(self, factor: Array) -> Array:
        """Return the (6, 6) S of (6,) factors, dimensionless, each on what the number named after its axis bears."""
        return np.tensordot(factor[list(self.projections)], list(self.projections.values()), axes=1)

    def by_factors(self, axes: Sequence[int], wrench: Array, twist: Array, tangent: Array) -> Array:
        """Return the (..., 6, k) derivative [m, rad] of S f(S w) by logarithms of the squares of axes' factors.

        It is half of P t + T P w, (..., 6) t [m, rad] and (..., 6, 6) T [m/N, rad/Nm] being that twist and its tangent
        under the (..., 6) load w [N, Nm], and P the projection.
        """
        parts = np.array([self.projections[axis] for axis in axes]).reshape(-1, 6, 6)
        by_axis = parts @ twist[..., None, :, None] + tangent[..., None, :, :] @ (parts @ wrench[..., None, :, None])
        return 0.5 * np.swapaxes(by_axis[..., 0], -1, -2)

    def scaled(self, factor: Array) -> Law | None:
        """Return S f(S w), S of (6,) dimensionless factors as in `scaling`, where that is a law of its kind."""
        return None

    def learned(self, travel: Ranges) -> Law | None:
        """Return the law with the parameters that `learn = true` frees, as uncertain as they are before a campaign.

        None where there are none: what was trained elsewhere is kept as it is, and a correction may be learned about
        it. `travel` is that of the joints.
        """
        return None if self.trained or self.values_covariance is None else self

    @property
    def trained_on(self) -> Array | None:
        """(2, k) smallest and largest load [N, Nm] of each component that it was trained on, None where nobody says."""
        return None

    @property
    def trained(self) -> bool:
        """Whether the law knows the loads that it was trained on, so that `flags` is worth asking."""
        return self.trained_on is not None

    @property
    def uncertain(self) -> bool:
        """Whether anything of the law is known to be not known."""
        return self.values_covariance is not None and bool(self.values_covariance.any())

    def flags(self, wrench: Array, row: Row) -> tuple[Flag, ...]:
        """Return what is doubtful about the answer to a (6,) wrench [N, Nm]: loads beyond those trained on."""
        return () if self.trained_on is None else beyond(self.trained_on, wrench)


def sole_axis(compliance: Array | None) -> int | None:
    """Return the axis (0 to 5) that names the one number of a (6, 6) compliance of rank one, None of any other.

    Such is a hinge or a slide however its link's frame is turned: it gives along one direction of motion alone. The
    axis is the first of the most compliant ones, of turning ones where any turns.
    """
    if compliance is None:
        return None
    diagonal = np.diag(compliance)
    turning = diagonal[3:].any()
    sizes = np.where(np.arange(6) >= 3, diagonal, 0.0) if turning else diagonal
    if sizes.max() <= 0.0:
        return None
    axis = int(np.argmax(sizes >= (1.0 - ONE_NUMBER) * sizes.max()))
    rest = compliance - np.outer(compliance[:, axis], compliance[axis]) / compliance[axis, axis]
    scale = np.sqrt(np.outer(diagonal, diagonal).clip(0.0))
    return axis if (np.abs(rest) <= ONE_NUMBER * scale).all() else None


class Compliance(Law):
    """For laws whose twist is proportional to the load: C w, C the same everywhere or of the row."""

    @abstractmethod
    def compliance(self, row: Row) -> Array:
        """Return the (..., 6, 6) compliance C in a row."""

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return C w."""
        return (self.compliance(row) @ wrench[..., None])[..., 0]

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return C, of every load and every row."""
        compliance = self.compliance(row)
        return np.broadcast_to(compliance, np.broadcast_shapes(compliance.shape, (*wrench.shape, 6)))

    def affine(self, row: Row) -> tuple[Array, Array]:
        """Return no twist and C."""
        return NOTHING, self.compliance(row) if self.constant is None else self.constant


class WithoutParameters(Law):
    """For laws that have nothing to free, draw or be unsure of but their scatter: they say so by inheriting this."""

    values = np.zeros(0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return ()

    def at(self, values: Array) -> Law:
        return self

    def freed(self, row: Row) -> tuple[int, ...]:
        return ()


@dataclass(frozen=True, eq=False)
class SteppedLaw(WithoutParameters):
    """A law as if it were straight in its values, a (k,) step of them away. Draws are such steps where a law is not."""

    law: Law
    step: Array

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the twist, and what the step makes of it."""
        return self.law.twist(wrench, row) + self._change(wrench, row)

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return its derivative by the wrench, that of the step by central differences."""
        return self.law.tangent(wrench, row) + by_wrench(self._change, wrench, row)

    def scatter(self, wrench: Array, row: Row) -> Array | None:
        return self.law.scatter(wrench, row)

    def _change(self, wrench: Array, row: Row) -> Array:
        return self.law.by_values(wrench, row) @ self.step


class Composed(Law):
    """A law made of others: its parameters are theirs, and its uncertainty, draws and flags follow from theirs."""

    laws: tuple[Law, ...]
    """What it is made of: a field or a property."""

    @abstractmethod
    def with_laws(self, laws: Sequence[Law]) -> Law:
        """Return the same made of others."""

    @abstractmethod
    def shares(self, wrench: Array, row: Row) -> list[tuple[Array, Array]]:
        """Return for each law the (..., 6, 6) twist of the whole per twist it gives more, and its (..., 6) load."""

    @property
    def leaves(self) -> tuple[Law, ...]:
        return tuple(leaf for law in self.laws for leaf in law.leaves)

    def own_scatter(self, wrench: Array, row: Row) -> Array | None:
        """Return the (..., 6, 6) covariance of a single reading beside that of the laws."""
        return None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of all laws; a law of several distinguishes theirs."""
        return tuple(parameter for law in self.laws for parameter in law.parameters)

    @property
    def values(self) -> Array:
        return np.concatenate([np.zeros(0), *(law.values for law in self.laws)])

    def at(self, values: Array) -> Law:
        return self.with_laws([law.at(part) for law, part in zip(self.laws, split(self.laws, values), strict=True)])

    def by_values(self, wrench: Array, row: Row) -> Array:
        shares = zip(self.laws, self.shares(wrench, row), strict=True)
        parts = [gain @ law.by_values(load, row) for law, (gain, load) in shares]
        return np.concatenate([np.zeros((*wrench.shape, 0)), *parts], axis=-1)

    @property
    def values_covariance(self) -> Array | None:
        covariances = [law.values_covariance for law in self.laws]
        if all(covariance is None for covariance in covariances):
            return None
        pairs = zip(covariances, self.laws, strict=True)
        return block_diagonal(
            *(np.zeros((len(law.values),) * 2) if covariance is None else covariance for covariance, law in pairs)
        )

    def scatter(self, wrench: Array, row: Row) -> Array | None:
        return self._summed([law.scatter for law in self.laws], wrench, row)

    def covariance(self, wrench: Array, row: Row) -> Array | None:
        return self._summed([law.covariance for law in self.laws], wrench, row)

    def _summed(self, asked: Sequence[Callable[[Array, Row], Array | None]], wrench: Array, row: Row) -> Array | None:
        """Return the (..., 6, 6) sum of what is asked of every law under its load, carried to the whole."""
        total = self.own_scatter(wrench, row)
        for ask, (gain, load) in zip(asked, self.shares(wrench, row), strict=True):
            part = ask(load, row)
            if part is not None:
                carried = gain @ part @ np.swapaxes(gain, -1, -2)
                total = carried if total is None else total + carried
        return total

    def draw(self, rng: np.random.Generator) -> Law:
        return self.with_laws([law.draw(rng) for law in self.laws])

    def certain(self) -> Law:
        return self.with_laws([law.certain() for law in self.laws])

    @cached_property
    def trained(self) -> bool:
        return any(law.trained for law in self.laws)

    @property
    def uncertain(self) -> bool:
        return any(law.uncertain for law in self.laws)

    def freed(self, row: Row) -> tuple[int, ...]:
        """Return none: [prior] says nothing of laws within a law; `learn = true` frees those."""
        return ()

    def flags(self, wrench: Array, row: Row) -> tuple[Flag, ...]:
        if not self.trained:
            return ()
        asked = zip(self.laws, self.shares(wrench, row), strict=True)
        return tuple(flag for law, (_, load) in asked for flag in law.flags(load, row))


def split(laws: Sequence[Law], values: np.ndarray) -> list[np.ndarray]:
    """Return every law's part of the (k,) values, or numbers of them, of several laws."""
    return np.split(values, np.cumsum([len(law.values) for law in laws])[:-1])


def anywhere(robot: Robot) -> Row:
    """Return a row in the middle of every joint's travel, for what is the same of a law wherever it is asked."""
    limited = np.isfinite(robot.lower) & np.isfinite(robot.upper)
    lower, upper = np.where(limited, robot.lower, 0.0), np.where(limited, robot.upper, 0.0)
    return Row(0.5 * (lower + upper), {name: i for i, name in enumerate(robot.joint_names)})


def by_wrench(twist: Callable[[Array, Row], Array], wrench: Array, row: Row) -> Array:
    """Return the (..., 6, 6) derivative of twists by a (..., 6) wrench, by central differences in one call."""
    largest = np.abs(wrench).max(axis=-1, keepdims=True)
    size = STEP * np.maximum(np.abs(wrench), 1e-3 * np.maximum(largest, 1.0))
    steps, here = size[..., None] * np.eye(6), wrench[..., None, :]
    ends = twist(np.concatenate([here + steps, here - steps], axis=-2), row.widened())
    return np.swapaxes((ends[..., :6, :] - ends[..., 6:, :]) / (2.0 * size[..., None]), -1, -2)


def beyond(seen: Array, wrench: Array) -> tuple[Flag, ...]:
    """Return a flag for every component of a (6,) wrench outside the (2, k) smallest and largest observed loads.

    A law of forces alone does not turn: a moment on it is one flag more.
    """
    flags, slack = [], 1e-9 * float(np.abs(seen).max(initial=0.0))
    for name, low, high, load in zip(WRENCH_NAMES, *seen, wrench, strict=False):  # a fit may be of forces only
        if not low - slack <= load <= high + slack:
            unit = "N" if name[0] == "f" else "Nm"
            here, start, end = _distinct(load, low, high)
            text = f"load {name} = {here} {unit} is outside the {start} to {end} {unit} it was trained on"
            size = max(low - load, load - high) / max(high - low, slack, 1e-300)
            flags.append(Flag("extrapolating", text, size=float(size)))
    return (*flags, *unturned(len(seen[0]), wrench))


def _distinct(load: float, low: float, high: float) -> tuple[str, str, str]:
    """Return a load and the ends of its observed range, in three digits or as many as distinguish it from them."""
    here, start, end = load, low, high
    for digits in range(3, 16):
        here, start, end = (float(f"{value:.{digits}g}") for value in (load, low, high))
        if here < start if load < low else here > end:
            break
    return f"{here:.15g}", f"{start:.15g}", f"{end:.15g}"  # 15300, not 1.53e+04


def unturned(size: int, wrench: Array) -> tuple[Flag, ...]:
    """Return a flag where a law of `size` components has no answer to the moment in a (6,) wrench."""
    moment = float(np.linalg.norm(wrench[size:]))
    if moment <= ROUNDING * float(np.linalg.norm(wrench)):
        return ()
    text = "carries a moment, but was trained on forces alone: it does not turn under any load"
    return (Flag("does_not_turn", text),)


def check_ordered(loads: Array) -> None:
    """Raise `LawError` where the first of two rows, the smallest observed loads, is not below the second."""
    if (loads[0] > loads[1]).any():
        raise LawError("the smallest loads are not below the largest")


HALVES = np.repeat(np.eye(2), 3, axis=1)
"""(2, 6) linear and angular coordinates."""


def block_norms(tangent: Array) -> Array:
    """Return the (..., 2, 2) Frobenius norms of the 3 x 3 blocks of (..., 6, 6) matrices: bounds of their 2-norms."""
    squares = tangent * tangent
    # For a single matrix numpy's `dot` takes a third of the time.
    summed = HALVES.dot(squares).dot(HALVES.T) if squares.ndim == 2 else HALVES @ squares @ HALVES.T
    return np.sqrt(summed)


def embed(block: Array, axes: int = 2) -> Array:
    """Return what has 3 or 6 components, along the last axis or the last two, with 6, zero where it had none."""
    if block.shape[-1] == 6:
        return block
    whole = np.zeros((*block.shape[:-axes], *(6,) * axes))
    whole[(..., *(slice(3),) * axes)] = block
    return whole


def block_diagonal(*blocks: Array) -> Array:
    """Return square blocks as one matrix, zeros beside them."""
    ends = np.cumsum([len(block) for block in blocks])
    total = np.zeros((ends[-1] if len(ends) else 0,) * 2)
    for block, end in zip(blocks, ends, strict=True):
        total[end - len(block) : end, end - len(block) : end] = block
    return total
