"""How uncertain predictions are because of what was fitted: C S C' at the asked rows, S the fit's covariance."""

from dataclasses import replace

import numpy as np

from armflex.arm import Arm, Setup
from armflex.conventions import Array
from armflex.errors import Flag, listing
from armflex.estimate.block import parameters_of
from armflex.estimate.blocks import blocks_of
from armflex.estimate.fit import Fit
from armflex.estimate.held_out import design_effect
from armflex.estimate.pose_block import PoseBlock, Walk
from armflex.estimate.view import View, look, unclear_shifts
from armflex.laws.effects.effect import Afterwards
from armflex.laws.effects.in_arm import excess
from armflex.linear_gaussian import LinearGaussian
from armflex.parameters import FRAMES, Certainty, ParameterKind, fitted_group
from armflex.readings import Orientation, Position, Readings, unread
from armflex.readings.instrument import Instrument
from armflex.rows import Rows

OTHER_PARAMETERS = Flag(
    "no_certainty", "the arm no longer has every fitted parameter (another preset?): sigma leaves all of them out"
)


STANDS = (ParameterKind.INSTRUMENT, ParameterKind.TOOL, ParameterKind.MOUNTING)
"""What says where base and target of a campaign stand."""


def certainty_of(fit: Fit, least: float = 1.0) -> Certainty:
    """Return what a fit leaves behind; a random twist per pose is kept by its size, not by its values.

    Readings count as `design_effect` finds them independent. Where the declared arm was fitted before, what is known of
    it stays as it was and only frames are new: it is considered, not estimated (Schmidt 1966, "Application of
    State-Space Methods to Navigation Problems"). What is fitted makes up for its errors x by -G x, so that with the
    fit's own covariance P, and the covariance S of x, all together have

        [S, -S G'; -G S, P + G S G'],    G = P J'X for the whitened columns J of what is fitted and X of x.

    `least` is the standard deviation of the readings over the stated one that they have at least: 1 where no poses were
    held out that would show that they scatter less.
    """
    kept = fit.declared.arm.certainty or Certainty((), np.zeros((0, 0)))
    kept = kept.part([i for i, parameter in enumerate(kept.parameters) if parameter.group.kind not in FRAMES])
    columns = _jacobian(kept, fit.view) if kept.parameters else None
    columns = np.zeros((*fit.view.residual.shape, len(kept.parameters))) if columns is None else columns
    columns = (columns * (np.sqrt(fit.weights) / fit.view.sigma)[:, :, None]).reshape(fit.view.residual.size, -1)
    random = tuple((block.site, block.axis, float(block.std)) for block in fit.blocks if isinstance(block, PoseBlock))
    walks = tuple((block.site, block.axis, block.size) for block in fit.blocks if isinstance(block, Walk))
    # Twists at every joint are what readings of a pose, and neighbouring poses, share.
    effect = design_effect(fit, columns, kept.covariance, least) if len(random) < 2 else 1.0
    noise = effect * max(fit.noise, least) ** 2
    posterior = LinearGaussian(fit.information / noise).with_precision(fit.precision)
    follows = np.vstack([np.eye(len(kept.parameters)), -posterior.covariance @ (fit.regressors.T @ columns) / noise])
    covariance = follows @ kept.covariance @ follows.T
    covariance[len(kept.parameters) :, len(kept.parameters) :] += posterior.covariance
    directions = np.pad(posterior.null_space, ((0, 0), (len(kept.parameters), 0)))
    directions = directions if kept.directions is None else np.vstack([kept.directions @ follows.T, directions])
    every = (*kept.parameters, *parameters_of(fit.blocks))
    unknown = bool(kept.parameters) and not kept.payloads  # of a file from before they were written
    here = () if unknown else (fit.view.driven.payload[row] for row in fit.view.rows)
    carried = tuple(dict.fromkeys((*kept.payloads, *here)))
    whole = Certainty(every, covariance, (random or kept.unexplained) + walks, directions, fit.misfit, effect, carried)
    places = [i for i, parameter in enumerate(every) if parameter.group.kind is not ParameterKind.UNEXPLAINED]
    return whole.part(sorted(places, key=lambda i: every[i].group.kind is ParameterKind.EFFECT))


def fitted_variance(arm: Arm, rows: Rows, readings: Readings) -> tuple[Array | None, tuple[Flag, ...]]:
    """Return the (N, d) variance of predicted readings that is due to fitted parameters, and flags about it.

    Rows of a session that was not calibrated have the variance of a session's frame added. None where nothing was
    fitted, or where the arm no longer has what was.

    Args:
        arm: The arm; see `Arm.certainty`.
        rows: What is to be predicted.
        readings: Of which kinds, the tip's position first.
    """
    if arm.certainty is None:
        missing = Flag("no_certainty", "the file holds no covariance of the fitted parameters: sigma leaves them out")
        return None, (missing,) if arm.instrument is not None else ()
    setup = Setup(arm, arm.instrument or Instrument())
    view = look(setup, rows, readings=readings)
    jacobian = _jacobian(arm.certainty, view)
    if jacobian is None:
        return None, (OTHER_PARAMETERS,)
    variance = np.einsum("ndp,pq,ndq->nd", jacobian, arm.certainty.covariance, jacobian, optimize=True)
    left = arm.certainty.leaves_open(jacobian)
    variance = np.where(left, np.inf, np.maximum(variance, 0.0)) + _unforeseen(arm, view)
    variance += (_extrapolated(view) ** 2).sum(axis=0) + (view.wandered() ** 2).sum(axis=0)
    flags = (_open(arm.certainty),) if left.any() else ()
    return variance, (*flags, *_lacking(arm.certainty))


def displacement_covariance(arm: Arm, rows: Rows, relative: bool = False) -> tuple[Array | None, tuple[Flag, ...]]:
    """Return the (N, 6, 6) covariance of the tip's motion, base axes [m, rad], due to fitted parameters, and flags.

    Where the instrument stands and what it looks at has no part in it, nor has what a tilted instrument would say of
    gravity. None where nothing was fitted, or where the arm no longer has what was. Variances are infinite where the
    tip depends on what neither a campaign nor a prior determined.

    Args:
        arm: The arm; see `Arm.certainty`.
        rows: Where its joints are.
        relative: Whether the motion is that of the campaign's target in the frame of its instrument instead. What only
            says where the base stands, such as the zero of a vertical first joint, or where the target is on the tool,
            such as the length of the flange and the zero of the last joint, then cancels.
    """
    if arm.certainty is None:
        return None, ()
    tip, stands = unread(len(rows), Position, Orientation), Instrument()
    if relative and arm.instrument is not None:
        stands = Instrument(arm.instrument.pose, target=arm.instrument.target)
    view = look(Setup(arm, stands), rows, readings=tip)
    jacobian = _jacobian(arm.certainty, view)
    if jacobian is None:
        return None, (OTHER_PARAMETERS,)
    groups = [parameter.group for parameter in arm.certainty.parameters]
    counted = [group.moves or (relative and group.kind in STANDS) for group in groups]
    turn = np.kron(np.eye(2), stands.pose.rotation.T)  # to base axes
    jacobian = np.einsum("de,nep->ndp", turn, np.where(counted, jacobian, 0.0))
    covariance = np.einsum("ndp,pq,neq->nde", jacobian, arm.certainty.covariance, jacobian, optimize=True)
    covariance[:, view.foremost, view.foremost] += arm.certainty.misfit**2 * np.eye(3)
    unknown = [unclear_shifts(view.setup, rows, tip), _extrapolated(view), view.wandered()]
    unknown.append(view.at_random(arm.certainty.unexplained))
    shifts = np.concatenate(unknown) @ turn.T
    covariance += np.einsum("knd,kne->nde", shifts, shifts)
    left = arm.certainty.leaves_open(jacobian)
    diagonal = np.arange(6)
    covariance[:, diagonal, diagonal] = np.where(left, np.inf, covariance[:, diagonal, diagonal])
    flags = (_open(arm.certainty),) if left.any() else ()
    return covariance, (*flags, *_lacking(arm.certainty))


def placing_variance(arm: Arm, rows: Rows, chosen: np.ndarray, along: Array) -> float:
    """Return the variance of the mean of displacements [m^2] that is due to where base and target stand.

    A displacement is from where a rigid arm has the target to where it was read. The frame of an instrument that was
    fitted has the errors of all that turns or shifts the whole arm in it, as the zero of a vertical first joint: they
    are exchangeable. Infinite where nothing determines where they stand.

    Args:
        arm: The arm; uncalibrated, its [prior] says how well its target is known.
        rows: All rows in the order driven.
        chosen: (M,) numbers of those that the mean is over.
        along: (M, 3) direction that displacements are counted along, in axes of the instrument, per length read.
    """
    view = look(Setup(arm, arm.instrument or Instrument()), rows, chosen)
    certainty, variance = arm.certainty, 0.0

    def mean(columns: Array) -> Array:
        """Return the (k,) change of the mean per unit of (M, d, k) columns."""
        return np.einsum("nd,ndk->k", along, columns[:, view.foremost]) / len(chosen)

    if certainty is None:
        return float(((mean(view.by_target) * arm.prior.tool) ** 2).sum())
    jacobian = _jacobian(certainty, view)
    if jacobian is not None:
        seen = np.array([not parameter.group.moves for parameter in certainty.parameters])
        by = mean(np.where(seen, jacobian, 0.0))
        if certainty.leaves_open(by[None]).any():
            return np.inf
        variance = float(by @ certainty.covariance @ by)
    sessions, prior = view.setup.instrument.sessions, arm.prior
    new = np.array([bool(sessions) and name not in sessions for name in view.sessions])
    std = np.repeat([prior.session_translation, prior.session_rotation], 3)
    return variance + float(((mean(view.by_session * new[:, None, None]) * std) ** 2).sum())


def _open(certainty: Certainty) -> Flag:
    """Return the flag about parameters that nothing determines."""
    names = listing(certainty.undetermined)
    text = f"neither a campaign nor a prior determines {names}: sigma is infinite where they matter"
    return Flag("undetermined", text)


def _lacking(certainty: Certainty) -> tuple[Flag, ...]:
    """Return the flag about an arm whose readings scattered more than they stated."""
    if not certainty.misfit:
        return ()
    size = f"{np.sqrt(3.0) * certainty.misfit * 1e3:.3g} mm"
    if any(group.kind is ParameterKind.EFFECT for group in certainty.groups):
        text = f"poses held out from the trace were off by {size} (RMS) beyond noise and fit: sigma has that in it"
        return (Flag("lacking", text),)
    text = f"the arm lacks something that moved the tip by {size} (RMS) when it was calibrated: sigma has that in it"
    return (Flag("lacking", f"{text}, `trace` looks for it"),)


def without_declared_uncertainty(arm: Arm) -> Arm:
    """Return the arm whose fitted compliances carry no declared uncertainty: the fit's covariance stands in for it."""
    groups = arm.certainty.groups if arm.certainty else ()
    fitted = [fitted_group(flexure) in groups for flexure in arm.flexures]
    if not any(fitted):
        return arm
    pairs = zip(arm.flexures, fitted, strict=True)
    return replace(arm, flexures=tuple(replace(f, law=f.law.certain()) if is_fitted else f for f, is_fitted in pairs))


def _unforeseen(arm: Arm, view: View) -> Array:
    """Return the (N, d) variance of what no fit can know: frames of new sessions, a twist without a cause."""
    prior, sessions = arm.prior, view.setup.instrument.sessions
    new = np.array([bool(sessions) and session not in sessions for session in view.sessions])
    std = np.repeat([prior.session_translation, prior.session_rotation], 3)
    if len(sessions) > 1:  # one in so many was off by what was found
        frames = [np.array(effect.values) for effect in arm.effects if effect.law.afterwards is Afterwards.OVER]
        std = np.sqrt(std**2 + sum((frame**2 for frame in frames), np.zeros(6)) / len(sessions))
    assert arm.certainty is not None
    variance = ((view.by_session * std) ** 2).sum(axis=2) * new[:, None]
    anew = np.array([session not in view.setup.instrument.targets for session in view.sessions])
    variance += ((view.by_target * prior.session_target) ** 2).sum(axis=2) * anew[:, None]
    for kind, place in view.readings.placed if arm.certainty.misfit else ():
        if kind.apart or place.stop <= view.foremost.stop:
            variance[:, place] += (arm.certainty.misfit * kind.by_shift(view.at)) ** 2
    for kind, place in view.readings.placed:
        if kind.name:
            # What was found of a sensor in other sessions is not known in a new one.
            sensor = arm.sensors[kind.name]
            unknown = np.array(
                [bool(sensor.found) and not {"", session} & set(sensor.found) for session in view.sessions]
            )
            variance[:, place] += ((kind.by_own(view.at) * sensor.std) ** 2).sum(axis=2) * unknown[:, None]
    return variance + (view.at_random(arm.certainty.unexplained) ** 2).sum(axis=0)


def _extrapolated(view: View) -> Array:
    """Return (K, N, d) what effects that are no law do to readings beyond the range that they were found in [m, rad].

    A law goes on beyond the rows that showed it, a free shape may not. How much of it is doubtful grows with the
    distance, to all of it where that is as long as the range.
    """
    extra, row = [np.zeros((0, *view.residual.shape))], view.line.row
    for effect in view.arm.effects:
        beyond = [
            np.clip(excess(row, *seen_range), 0.0, 1.0) for seen_range in effect.ranges if not effect.law.physical
        ]
        if beyond and np.any(beyond):
            motion = view.effect_jacobian(effect, view.context) @ effect.acting
            extra.append((np.max(beyond, axis=0)[:, None] * motion)[None])
    return np.concatenate(extra)


def _jacobian(certainty: Certainty, view: View) -> Array | None:
    """Return (N, d, P) changes of what is read per fitted parameter, None where this arm has not all of them."""
    moved = any(group.kind is ParameterKind.EFFECT for group in certainty.groups)
    blocks = blocks_of(certainty.parameters, view.setup, view.context if moved else None)
    if blocks is None:
        return None
    return np.concatenate([np.zeros((*view.residual.shape, 0)), *(block.jacobian(view) for block in blocks)], axis=2)
