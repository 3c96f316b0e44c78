"""The arm as a chain of elements from base to tip, in arrays: what the compiled engine reads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.mechanics.pinocchio_model import FlexModel

FLEXURE, TURNS, SLIDES, RIGID, ROTATED = 0, 1, 2, 3, 4
"""Kinds of elements; `ROTATED` is added where one is rotated against the one before."""


@dataclass(frozen=True, eq=False)
class Chain:
    """An arm with a payload; side branches hang on the elements that carry them.

    Element k is Pinocchio's joint k: a joint, a flexure, or nothing that moves. Element 0 is the root, which stands.

    Attributes:
        elements: (m + 1, 20) of each element: rotation (9) row by row and origin (3) [m] in the one before, axis (3),
            mass [kg] and centre (3) [m] of what is fixed to it. The last row is the tip's frame, with gravity [m/s^2]
            for an axis and, for a mass, the number of the element that it is fixed to. Column 19 is of flexures by
            number: the mass outboard [kg].
        kinds: (4, m) kind; number of the joint in q or of the flexure; numbers of the flexures from base to tip;
            element of each flexure by number. The last two are filled up with -1.
        flexures: How many there are.
    """

    elements: Array
    kinds: np.ndarray
    flexures: int

    @property
    def numbers(self) -> tuple[Array, np.ndarray]:
        """Elements and kinds."""
        return self.elements, self.kinds

    @property
    def order(self) -> np.ndarray:
        """(n,) numbers of the flexures from base to tip."""
        return self.kinds[2, : self.flexures]

    def ending_with(self, frames: Frames, name: str) -> Chain:
        """Return the same arm whose motion is asked at another of its frames; where it rests is asked of `self`."""
        elements, place = self.elements.copy(), frames.names.index(name)
        elements[-1, :12], elements[-1, 15] = frames.numbers[place], frames.places[0, place]
        return replace(self, elements=elements)

    def flexures_inboard(self, element: int) -> int:
        """Return how many flexures move an element."""
        return int((self.kinds[3, : self.flexures] <= element).sum())


def chain_of(flex: FlexModel, flexure_joints: Sequence[int]) -> Chain:
    """Return the chain of a model with flexures at some of Pinocchio's joints; its other free-flyers do not move."""
    model, numbers = flex.model, {joint: i for i, joint in enumerate(flexure_joints)}
    joints = {int(place): i for i, place in enumerate([*flex.v_index, *flex.free_v])}
    elements, kinds = np.zeros((model.njoints + 1, 20)), np.full((4, model.njoints), -1, dtype=np.int64)
    for k in range(model.njoints):
        placement, body, kind, place, axis = model.jointPlacements[k], model.inertias[k], RIGID, -1, np.zeros(3)
        if k in numbers:
            kind, place = FLEXURE, numbers[k]
        elif k and model.joints[k].nv == 1:
            motion = np.asarray(model.joints[k].createData().S).reshape(6)
            kind, place = (TURNS, SLIDES)[not motion[3:].any()], joints[model.joints[k].idx_v]
            axis = motion[3:] if kind == TURNS else motion[:3]
        rotated = 0 if np.array_equal(placement.rotation, np.eye(3)) else ROTATED
        kinds[:2, k] = kind + rotated, place
        elements[k, :19] = *placement.rotation.ravel(), *placement.translation, *axis, body.mass, *body.lever
    tip = model.frames[flex.tip].placement
    elements[-1, :15] = *tip.rotation.ravel(), *tip.translation, *model.gravity.linear
    elements[-1, 15] = model.frames[flex.tip].parentJoint
    for number, k in enumerate(flexure_joints):
        kinds[3, number], elements[number, 19] = k, sum(body.mass for body in model.inertias.tolist()[k:])
    kinds[2, : len(numbers)] = np.argsort(np.asarray(flexure_joints, dtype=int))
    return Chain(elements, kinds, len(numbers))


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames that are fixed to elements of a chain.

    Attributes:
        names: Of the frames.
        places: (2, f) the element that each is fixed to, and the first that moves where a twist is inserted at it.
        numbers: (f, 12) rotation (9) row by row and origin (3) [m] in its element.
    """

    names: tuple[str, ...]
    places: np.ndarray
    numbers: Array

    def some(self, index: Sequence[int]) -> Frames:
        """Return some of the frames."""
        places = np.ascontiguousarray(self.places[:, index])  # the engine is compiled for one order
        return Frames(tuple(self.names[i] for i in index), places, self.numbers[index])


def frames_of(frames: Sequence[tuple[str, int, int, pin.SE3]]) -> Frames:
    """Return frames by name, element, first element moved, and pose in their element."""
    poses = [np.concatenate([pose.rotation.ravel(), pose.translation]) for *_, pose in frames]
    places = np.array([(element, first) for _, element, first, _ in frames], dtype=np.int64).reshape(-1, 2).T
    return Frames(tuple(name for name, *_ in frames), places.copy(), np.array(poses).reshape(-1, 12))


def link_frame(model: pin.Model, frame: int) -> tuple[str, int, int, pin.SE3]:
    """Return a frame of a model, whose Pinocchio joints a chain's elements are."""
    known = model.frames[frame]
    return known.name, int(known.parentJoint), int(known.parentJoint), known.placement
