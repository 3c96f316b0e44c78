"""Loads from outside at named links: known forces that pull at the arm, the same in all rows or one in each."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from operator import is_
from typing import ClassVar

import numpy as np

from armflex.arguments import checked_init
from armflex.conventions import Array, cached_property, finite_array, real_array
from armflex.errors import InputError, ShapeError


@checked_init
@dataclass(frozen=True)
class Wrench:
    """A load from outside, on the structure: the same in all rows, or one for each of N rows of a batch.

    Attributes:
        frame: Link at whose origin it acts.
        force: (3,) or (N, 3) [N].
        moment: (3,) or (N, 3) [N m]; none when not given.
        axes: "base" for fixed axes of the base (a dead load), "frame" for axes that turn with the link.

    Raises:
        ShapeError, ArrayTypeError, NotFiniteError: Force and moment are not both such finite numbers.
        InputError: There are no such axes.
    """

    frame: str
    force: Array
    moment: Array = field(default_factory=lambda: np.zeros(3))
    axes: str = "base"

    hangs: ClassVar[bool] = False
    """Whether it is the weight of something, which has a potential; see `Branch`."""

    def __post_init__(self) -> None:
        force, moment = real_array(self.force, "force"), real_array(self.moment, "moment")
        rows = len(force) if force.ndim == 2 else len(moment) if moment.ndim == 2 else None
        shape = (3,) if rows is None else (rows, 3)
        for name, values in (("force", force), ("moment", moment)):
            each = np.broadcast_to(values, shape) if rows is not None and values.shape == (3,) else values
            quickly = rows is None and values.shape == shape and all(map(math.isfinite, values.tolist()))
            numbers = (each if quickly else finite_array(each, name, shape)).copy()
            numbers.flags.writeable = False  # what is known of a load is kept; see `OneChain`
            object.__setattr__(self, name, numbers)
        if self.axes not in ("base", "frame"):
            raise InputError(f"wrench at {self.frame!r}: axes is {self.axes!r}, expected 'base' or 'frame'")

    @property
    def dead(self) -> bool:
        """Whether it does not turn with its link."""
        return self.axes == "base"

    @property
    def follows(self) -> bool:
        """Whether it is the same in the axes of its link."""
        return self.axes == "frame" and not self.hangs

    @property
    def rows(self) -> int | None:
        """How many rows it has one for, None where it is the same in all."""
        return None if self.force.ndim == 1 else len(self.force)

    @cached_property
    def sizes(self) -> tuple[float, float]:
        """Of force [N] and moment [N m], the greatest of all rows."""
        if self.rows is None:
            return math.hypot(*self.force.tolist()), math.hypot(*self.moment.tolist())
        with np.errstate(over="ignore"):
            squares = (np.einsum("ij,ij->i", part, part).max(initial=0.0) for part in (self.force, self.moment))
            force, moment = (math.sqrt(square) for square in squares)
        return force, moment

    def under(self, gravity: Array) -> Wrench:
        """Return it under a (3,) gravity in base axes [m/s^2]: the same, but for what hangs."""
        return self

    def each(self, of: Callable[[Array], Array]) -> Wrench:
        """Return it with what `of` makes of its (N, 3) forces [N] and moments [N m]; the same in all rows stays."""
        return self if self.rows is None else replace(self, force=of(self.force), moment=of(self.moment))

    def some(self, rows: int | slice | np.ndarray) -> Wrench:
        """Return it in one of its N rows, or in (M,) of them."""
        return replace(self, force=self.force[rows], moment=self.moment[rows])

    def by_gravity(self, pose: Array) -> Array:
        """Return the (..., 6, 3) change of the wrench per change of gravity in base axes [m/s^2]: none."""
        return np.zeros((*pose.shape[:-2], 6, 3))

    def links(self, pose: Array) -> dict[str, Array]:
        """Return the (4, 4) poses of links that stand elsewhere than the model has them, of one of its own link."""
        return {}

    @cached_property
    def _whole(self) -> Array:
        return np.concatenate([self.force, self.moment], axis=-1)

    def at(self, pose: Array) -> Array:
        """Return the (..., 6) wrench [N, Nm] at the link's origin in base axes, of (..., 4, 4) poses of the link.

        A wrench for each of N rows is asked with a pose for each, or one for all.
        """
        if self.dead:
            single = self._whole.ndim == 1 and pose.ndim > 2
            return np.broadcast_to(self._whole, (*pose.shape[:-2], 6)) if single else self._whole
        turned = [(pose[..., :3, :3] @ part[..., None])[..., 0] for part in (self.force, self.moment)]
        return np.concatenate(turned, axis=-1)

    def change(self, pose: Array) -> Array:
        """Return the (..., 6, 6) change per motion of the link [m, rad]: only a load that turns with it has one."""
        load = self.at(pose)[..., None, :]
        change = np.zeros((*load.shape[:-2], 6, 6))
        if not self.dead:
            change[..., :3, 3:] = np.cross(load[..., :3], np.eye(3))
            change[..., 3:, 3:] = np.cross(load[..., 3:], np.eye(3))
        return change


def wrenches_in(wrenches: Sequence[Wrench], rows: int | slice | np.ndarray) -> tuple[Wrench, ...]:
    """Return wrenches in one of N rows or in some of them, without those that are zero there."""
    chosen = (wrench if wrench.rows is None else wrench.some(rows) for wrench in wrenches)
    return tuple(wrench for wrench in chosen if any(wrench.sizes))


def same_objects(wrenches: Sequence[Wrench], others: Sequence[Wrench]) -> bool:
    """Return whether all are the very same: what is known of one need not be found again."""
    return len(wrenches) == len(others) and all(map(is_, wrenches, others))


def check_rows(wrenches: Sequence[Wrench], count: int | None) -> None:
    """Raise `ShapeError` where a wrench is for other rows than the `count` of a batch, None for a single query."""
    for wrench in wrenches:
        if wrench.rows not in (None, count):
            expected = "(3,)" if count is None else f"(3,) or ({count}, 3)"
            raise ShapeError(
                f"wrench at {wrench.frame!r}: expected force and moment {expected}, got {wrench.force.shape}"
            )
