"""How uncertain predictions are because of what was fitted: C S C' at the asked rows, S the fit's covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby, takewhile

import numpy as np

from armflex.arm import Arm
from armflex.certainty import Certainty
from armflex.conventions import TWIST_NAMES, Array
from armflex.errors import Flag, listing
from armflex.estimate.arm_blocks import ComplianceBlock, GeometryBlock, OffsetBlock
from armflex.estimate.blocks import Block, joint_units
from armflex.estimate.effect_block import EffectBlock, numbers_of
from armflex.estimate.fit import Fit
from armflex.estimate.instrument_blocks import FrameBlock, MountingBlock, SessionBlock, TargetBlock
from armflex.estimate.law_block import LawBlock, learned_laws
from armflex.estimate.view import View, look, untold_shifts
from armflex.laws.effects.scene import Scene, survey
from armflex.mechanics.history import known_rows
from armflex.parameters import COMPLIANCE, EFFECT, FRAMES, INSTRUMENT, LAW, MOUNTING, SESSIONS, law_labels
from armflex.readings import Orientation, Position, unread
from armflex.readings.instrument import Instrument
from armflex.readings.position import rigid_motion
from armflex.rows import Rows
from armflex.setup import Setup

RANDOM = "unexplained"

OF_THE_INSTRUMENT = (*FRAMES, "tool", f"{EFFECT} tracker_scale", f"{EFFECT} {SESSIONS}")
"""How blocks begin that change what is read, not where the tip is."""

OTHER_PARAMETERS = Flag(
    "no_certainty", "the arm no longer has every fitted parameter (another preset?): sigma leaves all of them out"
)


def certainty_of(fit: Fit) -> Certainty:
    """Return what a fit leaves behind; a random twist per pose is kept by its size, not by its values.

    Where the declared arm was fitted before, what is known of it stays known; only frames are of one campaign.
    """
    random = [block for block in fit.blocks if block.name.startswith(f"{RANDOM} ")]
    own = np.concatenate([np.zeros(0, dtype=int), *(fit.places(block) for block in random)])
    kept = np.setdiff1d(np.arange(len(fit.values)), own)
    labels = tuple(f"{block} {label}" for block, label in (fit.labels[i] for i in kept))
    unexplained = (random[0].site, random[0].axis, float(random[0].std)) if random else None
    known = fit.posterior
    directions = known.null_space[:, kept] if len(known.null_space) else None
    found = Certainty(labels, known.covariance[np.ix_(kept, kept)], unexplained, directions, fit.misfit)
    earlier = fit.declared.arm.certainty
    return found if earlier is None else _joined(earlier, found)


def _joined(earlier: Certainty, found: Certainty) -> Certainty:
    """Return both, as independent, but for the earlier campaign's frames: declared parameters first, then effects."""
    kept = [i for i, label in enumerate(earlier.labels) if label.split(" ", 1)[0] not in FRAMES]
    labels = (*(earlier.labels[i] for i in kept), *found.labels)
    covariance = np.zeros((len(labels),) * 2)
    covariance[: len(kept), : len(kept)] = earlier.covariance[np.ix_(kept, kept)]
    covariance[len(kept) :, len(kept) :] = found.covariance
    order = sorted(range(len(labels)), key=lambda i: labels[i].startswith(f"{EFFECT} "))
    unexplained = found.unexplained or earlier.unexplained
    directions = _stacked(earlier.directions, kept, found.directions, len(found.labels))
    directions = None if directions is None else directions[:, order]
    told = covariance[np.ix_(order, order)]
    return Certainty(tuple(labels[i] for i in order), told, unexplained, directions, found.misfit)


def _stacked(earlier: Array | None, kept: Sequence[int], found: Array | None, count: int) -> Array | None:
    """Return the undetermined directions of both, the kept parameters of the one before `count` of the other."""
    if earlier is None and found is None:
        return None
    before = np.zeros((0, len(kept))) if earlier is None else earlier[:, kept][earlier[:, kept].any(axis=1)]
    after = np.zeros((0, count)) if found is None else found
    return np.vstack([np.pad(before, ((0, 0), (0, count))), np.pad(after, ((0, 0), (len(kept), 0)))])


def fitted_variance(arm: Arm, rows: Rows) -> tuple[Array | None, tuple[Flag, ...]]:
    """Return the (N, 3) variance of predicted readings that is due to fitted parameters, and doubts about it.

    Rows of a session that was not calibrated have the variance of a session's frame added. None where nothing was
    fitted, or where the arm no longer has what was.

    Args:
        arm: The arm; see `Arm.certainty`.
        rows: What is to be predicted.
    """
    if arm.certainty is None:
        missing = Flag("no_certainty", "the file holds no covariance of the fitted parameters: sigma leaves them out")
        return None, (missing,) if arm.instrument is not None else ()
    setup = Setup(arm, arm.instrument or Instrument())
    view = look(setup, rows, np.arange(len(rows)), readings=unread(len(rows), Position))
    blocks = rebuilt_blocks(arm.certainty, view, rows)
    if blocks is None:
        return None, (OTHER_PARAMETERS,)
    columns = _columns(blocks, view)
    variance = np.einsum("ndp,pq,ndq->nd", columns, arm.certainty.covariance, columns, optimize=True)
    left = arm.certainty.leaves_open(columns)
    variance = np.where(left, np.inf, np.maximum(variance, 0.0)) + _unforeseen(arm, view, rows)
    doubts = (_open(arm.certainty, "is infinite where they matter"),) if left.any() else ()
    return variance, (*doubts, *_lacking(arm.certainty))


def displacement_covariance(arm: Arm, rows: Rows) -> tuple[Array | None, tuple[Flag, ...]]:
    """Return the (N, 6, 6) covariance of the tip's motion, base axes [m, rad], due to fitted parameters, and doubts.

    Where the instrument stands and what it looks at has no part in it, nor has what a tilted instrument would say of
    gravity. None where nothing was fitted, or where the arm no longer has what was.
    """
    if arm.certainty is None:
        return None, ()
    tip = unread(len(rows), Position, Orientation)
    view = look(Setup(arm, Instrument()), rows, np.arange(len(rows)), readings=tip)
    blocks = rebuilt_blocks(arm.certainty, view, rows)
    if blocks is None:
        return None, (OTHER_PARAMETERS,)
    moving = np.repeat(
        [not block.name.startswith(OF_THE_INSTRUMENT) for block in blocks], [len(b.labels) for b in blocks]
    )
    columns = np.where(moving, _columns(blocks, view), 0.0)
    covariance = np.einsum("ndp,pq,neq->nde", columns, arm.certainty.covariance, columns, optimize=True)
    if arm.certainty.unexplained is not None:
        site, axis, size = arm.certainty.unexplained
        along = size * view.to_twist(site)[:, :, TWIST_NAMES.index(axis)]
        covariance += along[:, :, None] * along[:, None]
    covariance[:, view.positions, view.positions] += arm.certainty.misfit**2 * np.eye(3)
    shifts = untold_shifts(view.setup, rows, tip)
    covariance += np.einsum("knd,kne->nde", shifts, shifts)
    doubts = (_open(arm.certainty, "leaves them out"),) if arm.certainty.leaves_open(columns).any() else ()
    return covariance, (*doubts, *_lacking(arm.certainty))


def _open(certainty: Certainty, sigma: str) -> Flag:
    """Return the doubt about parameters that nothing determines, and what sigma makes of them."""
    names = listing(certainty.undetermined)
    return Flag("undetermined", f"neither a campaign nor a prior determines {names}: sigma {sigma}")


def _lacking(certainty: Certainty) -> tuple[Flag, ...]:
    """Return the doubt about an arm whose readings scattered more than they stated."""
    if not certainty.misfit:
        return ()
    size = f"{np.sqrt(3.0) * certainty.misfit * 1e3:.3g} mm"
    text = f"the arm lacks something that moved the tip by {size} (RMS) when it was calibrated: sigma has that in it"
    return (Flag("lacking", f"{text}, `trace` looks for it"),)


def _columns(blocks: Sequence[Block], view: View) -> Array:
    """Return (N, d, P) changes of what is read."""
    return np.concatenate([np.zeros((*view.residual.shape, 0)), *(block.columns(view) for block in blocks)], axis=2)


def without_declared_doubt(arm: Arm) -> Arm:
    """Return the arm whose fitted compliances carry no declared uncertainty: the fit's covariance stands in for it."""
    known = set(_labels(arm))
    fitted = [not known.isdisjoint(law_labels(flexure)) for flexure in arm.flexures]
    if not any(fitted):
        return arm
    pairs = zip(arm.flexures, fitted, strict=True)
    return replace(arm, flexures=tuple(replace(f, law=f.law.certain()) if own else f for f, own in pairs))


def _labels(arm: Arm) -> tuple[str, ...]:
    return arm.certainty.labels if arm.certainty else ()


def _unforeseen(arm: Arm, view: View, rows: Rows) -> Array:
    """Return the (N, 3) variance of what no fit can know: frames of new sessions, a twist without a cause."""
    prior, sessions = arm.prior, view.setup.instrument.sessions
    new = np.array([bool(sessions) and session not in sessions for session in rows.session])
    std = np.repeat([prior.session_translation, prior.session_rotation], 3)
    assert arm.certainty is not None
    variance = ((rigid_motion(view.points) * std) ** 2).sum(axis=2) * new[:, None] + arm.certainty.misfit**2
    if arm.certainty.unexplained is not None:
        site, axis, size = arm.certainty.unexplained
        variance += (size * view.to_twist(site)[:, :, TWIST_NAMES.index(axis)]) ** 2
    return variance


def rebuilt_blocks(certainty: Certainty, view: View, rows: Rows) -> list[Block] | None:
    """Return the blocks that a fit's labels name, None where they are not those of this arm."""
    moved = any(label.startswith(f"{EFFECT} ") for label in certainty.labels)
    return _named_blocks(certainty, view.setup, rows.session, scene_of(view, rows) if moved else None)


def applied_blocks(certainty: Certainty, setup: Setup) -> list[Block] | None:
    """Return the same blocks to be applied only: no row is known that they could be asked about."""
    return _named_blocks(certainty, setup, (), None)


def _named_blocks(
    certainty: Certainty, setup: Setup, sessions: tuple[str, ...], scene: Scene | None
) -> list[Block] | None:
    effects = [label for label in certainty.labels if label.startswith(f"{EFFECT} ")]
    others = [label for label in certainty.labels if not label.startswith(f"{EFFECT} ")]
    blocks = blocks_of(others, setup, sessions)
    if blocks is None:
        return None
    blocks += _effect_blocks(effects, setup.arm, scene)
    return blocks if labels_of(blocks) == certainty.labels else None


def blocks_of(labels: Sequence[str], setup: Setup, sessions: tuple[str, ...]) -> list[Block] | None:
    """Return the blocks, but for effects, that labels name; None where they are not those of this arm.

    `sessions` are those of the rows that the blocks will be asked about.
    """
    blocks: list[Block] = []
    for name, group in groupby((label.split(" ", 1) for label in labels), key=lambda pair: pair[0]):
        block = _declared(name, [label for _, label in group], setup, sessions)
        if block is None:
            return None
        blocks.append(block)
    return blocks


def labels_of(blocks: Sequence[Block]) -> tuple[str, ...]:
    """Return block and parameter of each."""
    return tuple(f"{block.name} {label}" for block in blocks for label in block.labels)


def _declared(name: str, labels: list[str], setup: Setup, sessions: tuple[str, ...]) -> Block | None:
    """Return a declared block from its labels; its prior no longer matters."""
    arm, pairs = setup.arm, [label.rpartition(" ")[::2] for label in labels]
    parts = tuple(dict.fromkeys(part for part, _ in pairs))
    if name == INSTRUMENT:
        return FrameBlock(setup.instrument.pose, arm.measurement.gravity_in == "measurement")
    if name == SESSIONS:
        return SessionBlock(parts, sessions, 0.0, 0.0)
    if name == "tool":
        return TargetBlock(0.0)
    if name == MOUNTING:
        return MountingBlock(setup.instrument.mounting)
    if name == "joint_offset" and tuple(labels) == arm.joint_names:
        return OffsetBlock(arm.joint_names, 0.0, joint_units(arm))
    if name == "geometry" and parts == arm.joint_names:
        return GeometryBlock(parts, 0.0)
    laws = learned_laws(arm)
    if name == LAW and laws:
        return LawBlock(tuple(laws), tuple(laws.values()))
    own = {part for part, _ in pairs} <= {flexure.name for flexure in arm.flexures}
    if name == COMPLIANCE and own and {axis for _, axis in pairs} <= set(TWIST_NAMES):
        return ComplianceBlock(parts, tuple(_axes(pairs, part) for part in parts), 0.0)
    return None


def _axes(pairs: Sequence[tuple[str, str]], part: str) -> tuple[int, ...]:
    return tuple(TWIST_NAMES.index(axis) for name, axis in pairs if name == part)


def scene_of(view: View, rows: Rows) -> Scene:
    """Return rows as the catalogue sees them, from a view of all of them."""
    wrenches = {site: view.line.load_at(site) for site in view.line.sites}
    known = known_rows(view.setup.arm, rows)
    return survey(rows, view.setup.arm, known, wrenches, view.line.links[:, :, :3, 3])


def _effect_blocks(labels: list[str], arm: Arm, scene: Scene | None) -> list[Block]:
    """Return the blocks of the effects whose parameters the labels name, in order.

    Files from before effects of one name were numbered name the second as if it were the first: by other amplitudes.
    """
    blocks: list[Block] = []
    for ordinal, (effect, number) in enumerate(zip(arm.effects, numbers_of(arm.effects), strict=True)):
        for name in dict.fromkeys((number, 1)):
            block = EffectBlock(effect, (), scene, ordinal, np.zeros(0), number=name)
            acting = [f"{block.name} {label}" for label in block.labels]
            if labels[: len(acting)] != acting:
                continue
            labels = labels[len(acting) :]
            names = [f"{block.name} {inner.name}" for inner in effect.law.inner]
            free = list(takewhile(names.__contains__, labels))
            blocks.append(replace(block, free=tuple(names.index(name) for name in free)))
            labels = labels[len(free) :]
            break
    return blocks
