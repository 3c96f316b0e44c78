"""The arm in arrays, which the engine reads: a chain of elements, or a tree of them with ties."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.mechanics.engine.tables import COIL, FLEXURE, GAS, GEAR, RIGID, ROD, ROTATED, SLIDES, TURNS, Frames, Tree
from armflex.mechanics.pinocchio_model import FlexModel
from armflex.mechanics.spring import CoilSpring
from armflex.mechanics.ties import Pin, Ties

SIX = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
"""Where xx yy zz xy xz yz stand in an inertia."""


def _untied(flex: FlexModel, flexure_joints: Sequence[int]) -> Tree:
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


def tree_of(flex: FlexModel, ties: Ties | None = None, offsets: Array | Sequence[float] = ()) -> Tree:
    """Return an arm in arrays.

    Args:
        flex: Its model. Flexures at closures have no element; free-flyers that are no flexures do not move.
        ties: What closes its loops, and its springs; None of a chain.
        offsets: Of its cylinders, by which they are longer than their positions [m].
    """
    model = flex.model
    carriers = {joint.idx_v: joint.id for joint in list(model.joints)[1:] if joint.nv == 6}
    starts = flex.flexure_v[::6].tolist()
    flexures = np.array([carriers.get(at, -1 - (at - model.nv) // 6) for at in starts], dtype=np.int64)
    chain, in_tree = _untied(flex, flexures[flexures >= 0].tolist()), np.flatnonzero(flexures >= 0)
    if ties is None:
        return chain
    kinds, driven = chain.kinds.copy(), len(flex.q_index)
    kinds[1, flexures[in_tree]] = in_tree
    # Cylinders are drives, too, and stand before passive joints among the positions.
    kinds[1, (kinds[0] & 3 != FLEXURE) & (kinds[1] >= driven)] += len(ties.cylinders)
    closed, count = len(ties.names), len(ties.names) + len(ties.springs)
    numbers, joins = np.zeros((count, 45)), np.zeros((count, 6), dtype=np.int64)
    carried, slots = np.zeros((count, model.njoints)), ties.rows.reshape(len(ties.rows), closed, 6)
    rows, sizes = slots.sum(axis=1), slots.any(axis=2).sum(axis=0)
    ways = rows.copy()
    joins[:closed, 4], joins[closed:, 4] = np.cumsum(sizes), len(rows) + np.arange(len(ties.springs))
    joins[:, 3] = joins[:, 4]
    joins[:closed, 3] -= sizes
    for t, one in [*enumerate(ties.joined), *enumerate(ties.sprung_rods, closed)]:
        for side, end in enumerate(one.ends):
            numbers[t, 3 * side : 3 * side + 3] = end.point
            numbers[t, 27 + 9 * side : 36 + 9 * side] = end.axes.ravel()
            carried[t, list(model.supports[end.joint])] += 2 * side - 1
            joins[t, 1 + side] = end.joint
            if isinstance(one, Pin):
                joins[t, 0], some = one.held[side].shape[1], slice(*joins[t, 3:5])
                numbers[t, 6 + 9 * side : 6 + 9 * side + one.held[side].size] = one.held[side].T.ravel()
                ways[some] = rows[some] @ np.kron(np.eye(2), one.ends[0].axes.T)
    for t, offset in enumerate(offsets, len(ties.loops)):
        joins[t, 0], joins[t, 5], numbers[t, 24] = ROD, driven + t - len(ties.loops), offset
    carrier = {joint.idx_q: joint.id for joint in list(model.joints)[1:]}
    for t, (own, master, factor, offset) in enumerate(ties.gears, len(ties.joined)):
        joins[t, :3], numbers[t, 24:26] = (GEAR, carrier[own], carrier[master]), (factor, offset)
    for t, spring in enumerate(ties.springs, closed):
        joins[t, 0] = COIL if isinstance(spring.law, CoilSpring) else GAS
        numbers[t, 24:27] = spring.law.numbers
    counts = driven + len(ties.cylinders), len(flex.free_v)
    return Tree(
        chain.elements, kinds, chain.parents, carried, numbers, joins, rows, ways, flexures, chain.inertias, *counts
    )


def frames_of(frames: Sequence[tuple[str, int, int, pin.SE3]]) -> Frames:
    """Return frames by name, element, first element moved, and pose in their element."""
    poses = [np.concatenate([pose.rotation.ravel(), pose.translation]) for *_, pose in frames]
    places = np.array([(element, first) for _, element, first, _ in frames], dtype=np.int64).reshape(-1, 2).T
    return Frames(tuple(name for name, *_ in frames), places.copy(), np.array(poses).reshape(-1, 12))


def link_frame(model: pin.Model, frame: int) -> tuple[str, int, int, pin.SE3]:
    """Return a frame of a model, whose Pinocchio joints a chain's elements are."""
    known = model.frames[frame]
    return known.name, int(known.parentJoint), int(known.parentJoint), known.placement
