"""The arm in arrays, which the compiled engine reads: a chain of elements, or a tree of them with ties."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.mechanics.engine.tables import FLEXURE, RIGID, ROTATED, SLIDES, TURNS, Tree
from armflex.mechanics.pinocchio_model import FlexModel

SIX = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
"""Where xx yy zz xy xz yz stand in an inertia."""


def chain_of(flex: FlexModel, flexure_joints: Sequence[int]) -> Tree:
    """Return a model without ties, with flexures at some of Pinocchio's joints; its other free-flyers do not move."""
    model, numbers = flex.model, {joint: i for i, joint in enumerate(flexure_joints)}
    joints = {int(place): i for i, place in enumerate([*flex.v_index, *flex.free_v])}
    elements, kinds = np.zeros((model.njoints + 1, 20)), np.full((3, model.njoints), -1, dtype=np.int64)
    inertias = np.array([body.inertia[SIX] for body in model.inertias.tolist()])
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
        elements[number, 19] = sum(body.mass for body in model.inertias.tolist()[k:])
    kinds[2, : len(numbers)] = np.argsort(np.asarray(flexure_joints, dtype=int))
    parents = np.array([list(supports)[-2:][0] for supports in model.supports], dtype=np.int64)
    ties, rows = (np.zeros((0, model.njoints)), np.zeros((0, 45)), np.zeros((0, 6), dtype=np.int64)), np.zeros((0, 6))
    flexures = np.array(flexure_joints, dtype=np.int64)
    driven, passive = len(flex.v_index), len(flex.free_v)
    return Tree(elements, kinds, parents, *ties, rows, rows, flexures, inertias, driven, passive)


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames that are fixed to elements of an arm.

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
