"""The arm as a chain, from base to tip, with its numbers in arrays: for many configurations at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.robot import FlexModel


@dataclass(frozen=True, eq=False)
class Link:
    """A joint that moves, or a flexure, and how it stands in the one before.

    Attributes:
        rotation: (3, 3) of its frame in the frame before, None for none.
        origin: (3,) of the same [m].
        axis: (3,) of its motion, None for a flexure.
        turns: Whether the motion is a turn.
        place: Number of the joint in q, or of the flexure.
        mass: Of the body behind it [kg].
        lever: (3,) centre of that body in its frame [m].
    """

    rotation: Array | None
    origin: Array
    axis: Array | None
    turns: bool
    place: int
    mass: float
    lever: Array


@dataclass(frozen=True, eq=False)
class Chain:
    """An arm with a payload from base to tip; side branches hang on their links.

    Attributes:
        links: In order.
        flexures: How many of them are flexures.
        tip_rotation, tip_origin: (3, 3) and (3,) tip frame in that of the last link [m].
        gravity: (3,) [m/s^2].
    """

    links: tuple[Link, ...]
    flexures: int
    tip_rotation: Array
    tip_origin: Array
    gravity: Array

    @cached_property
    def outboard(self) -> Array:
        """(n,) mass outboard of every flexure [kg]."""
        found, mass = np.zeros(self.flexures), 0.0
        for one in reversed(self.links):
            mass += one.mass
            if one.axis is None:
                found[one.place] = mass
        return found

    @cached_property
    def numbers(self) -> tuple[Array, ...]:
        """The same as plain arrays, for compiled code.

        links: (m, 19) rotation row by row, origin, axis, mass and lever of each.
        kinds: (m, 2) what it is, and its place. 0 is a flexure, 1 turns, 2 slides; 4 more where there is a rotation.
        order: (n,) see `order`.
        outboard: (n,) see `outboard`.
        ends: (2, 3) gravity and the tip's origin.
        """
        kinds = [((0 if one.axis is None else 2 - one.turns) + 4 * (one.rotation is not None)) for one in self.links]
        places = [one.place for one in self.links]
        return (
            np.array([_row(one) for one in self.links]).reshape(-1, 19),
            np.array([kinds, places], dtype=np.int64).T.copy(),
            np.array(self.order, dtype=np.int64),
            self.outboard,
            np.array([self.gravity, self.tip_origin]),
        )

    @cached_property
    def order(self) -> tuple[int, ...]:
        """Numbers of the flexures from base to tip."""
        return tuple(one.place for one in self.links if one.axis is None)


def _row(one: Link) -> Array:
    rotation = np.eye(3) if one.rotation is None else one.rotation
    return np.concatenate(
        [rotation.ravel(), one.origin, np.zeros(3) if one.axis is None else one.axis, [one.mass], one.lever]
    )


def chain_of(flex: FlexModel, flexure_joints: Sequence[int]) -> Chain:
    """Return the chain of a model whose flexures are at some of Pinocchio's joints."""
    model, flexures = flex.model, {joint: i for i, joint in enumerate(flexure_joints)}
    joints = {int(place): i for i, place in enumerate(flex.v_index)}
    links = []
    for i in range(1, model.njoints):
        placement, body, joint = model.jointPlacements[i], model.inertias[i], model.joints[i]
        own = i in flexures
        axis, turns = (None, False) if own else _motion(joint)
        place = flexures[i] if own else joints[joint.idx_v]
        rotation = None if np.array_equal(placement.rotation, np.eye(3)) else placement.rotation.copy()
        links.append(Link(rotation, placement.translation.copy(), axis, turns, place, body.mass, body.lever.copy()))
    tip = model.frames[flex.tip].placement
    gravity = model.gravity.linear.copy()
    return Chain(tuple(links), len(flexures), tip.rotation.copy(), tip.translation.copy(), gravity)


def _motion(joint: pin.JointModel) -> tuple[Array, bool]:
    """Return the axis of a joint with one freedom, and whether it turns about it."""
    subspace = joint.createData().S
    linear, angular = np.asarray(subspace).reshape(6)[:3], np.asarray(subspace).reshape(6)[3:]
    return (angular.copy(), True) if angular.any() else (linear.copy(), False)


@dataclass(frozen=True, eq=False)
class Straight:
    """The rigid arm at N configurations, in base axes.

    Attributes:
        turn: (n, 3, 3, N) orientation of every flexure; the second index is the axis of the base.
        origin: (n, 3, N) where it is [m].
        moment: (n, 3, N) first moment about the base of what is between it and the next flexure [kg m].
        tip: (3, N) [m].
        tip_turn: (3, 3, N) orientation of the tip.
    """

    turn: Array
    origin: Array
    moment: Array
    tip: Array
    tip_turn: Array
