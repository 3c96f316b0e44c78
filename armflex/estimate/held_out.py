"""Errors on rows held out from a fit, in the linear problem about it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, cast

import numpy as np

from armflex.conventions import RESOLUTION, Array
from armflex.estimate.fit import Fit
from armflex.estimate.outliers import DOUBTED
from armflex.estimate.robust import EVEN, huber_weights, outlier_limit, robust_limit
from armflex.estimate.view import View, foremost_rms
from armflex.linear_gaussian import LinearGaussian, depend_on, most_probable, squared
from armflex.parameters import OF_SESSION, ParameterGroup, ParameterKind
from armflex.readings import Position
from armflex.result import record
from armflex.rows.rows import STILL, numbered

POSE_FOLDS = 5
"""Tolerance: parts into which poses are divided that predict each other."""

PARTS = 4
"""Tolerance: parts of joint space that predict each other, where it is asked how far a fit is off elsewhere."""

FIRST = (ParameterKind.INSTRUMENT, ParameterKind.MOUNTING, ParameterKind.TOOL)
"""What is of the first of several campaigns, and of those after it but for what is their own."""


def near(*views: View) -> np.ndarray:
    """Return (M, d) readings that one or more of several views of the same rows come near, by the limit of the closest.

    A reading that only an effect explains speaks for it, one that it alone spoils against it, and a beam that every
    view misses about none of them. Nor is an error that of a coordinate that nobody read.
    """
    read = np.isfinite(views[0].sigma)
    for kind, place in views[0].readings.placed:
        read[:, place] &= kind.read if isinstance(kind, Position) else True
    limit = np.min([robust_limit(view) for view in views], axis=0)
    close = np.any([huber_weights(view, limit) > DOUBTED for view in views], axis=0)
    return close & read


def judged_by(*fits: Fit) -> np.ndarray:
    """Return (M, d) readings over which the errors of several fits to the same rows are said; see `near`."""
    return near(*(fit.view for fit in fits))


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Errors on rows held out from a fit.

    Attributes:
        squares: (M,) squared error of every row [m^2, rad^2]; see `Readings.row_squares`.
        believed: (M,) False for rows that say nothing about a model, or that have no foremost reading.
        errors: (M, n) of the foremost numbers [m]; zero where not read.
    """

    squares: Array
    believed: np.ndarray
    errors: Array

    @property
    def rms(self) -> float:
        """RMS of the 3-D error over rows that count [m]."""
        return self.rms_of(self.believed)

    def rms_of(self, rows: np.ndarray) -> float:
        """Return the RMS of the 3-D error over those that count among (M,) rows [m]."""
        return float(np.sqrt(self.squares[self.believed & rows].mean()))


def held_out(
    fit: Fit, folds: np.ndarray, refitted: Sequence[np.ndarray] | None = None, judged: np.ndarray | None = None
) -> HeldOut:
    """Return the errors of every row predicted from the other folds, in the linear problem about the fit.

    Args:
        fit: The fit; its columns and robust weights are used as they are.
        folds: (M,) fold of every row.
        refitted: For every fold, parameters that may follow the fold's own rows (a session's frame), if any.
        judged: (M, d) readings that count, see `judged_by`; when not given all, in the rows that this fit believes.
    """
    data, rows = fit.residual + fit.regressors @ fit.values, _readings_of(fit, folds)
    left, scores = np.empty(len(data)), _of_others([fit.regressors[place].T @ data[place] for place in rows])
    for number, (places, posterior, score) in enumerate(zip(rows, known_of_others(fit, folds), scores, strict=True)):
        regressors = fit.regressors[places]
        error = data[places] - regressors @ posterior.solve(score)
        if refitted is not None and len(refitted[number]):
            kept = refitted[number]
            follow = regressors[:, kept]
            error = error - follow @ most_probable(follow, fit.precision[kept], error)
        left[places] = error
    readings = fit.view.readings if judged is None else fit.view.readings.where(judged)
    rows_judged = (readings.foremost_count > 0) & (True if judged is not None else near(fit.view).any(axis=1))
    errors = errors_of(fit, left)
    return HeldOut(readings.row_squares(errors), rows_judged, errors)


def frames_of(fit: Fit, name: str) -> np.ndarray:
    """Return the places of what is of one session alone, or of a campaign: frame and target, and those of its sessions.

    Of the first of several campaigns that is how the instrument stands and the target is mounted at all.
    """
    campaigns = fit.setup.instrument.campaigns

    def own(group: ParameterGroup) -> bool:
        of = group.of or ""
        if group.kind in OF_SESSION:
            return of == name or (name in campaigns and of.startswith(f"{name}/"))
        if group.kind is ParameterKind.SENSOR:
            return name in campaigns and of.partition(" ")[2].partition("/")[0] == name
        return name in campaigns[:1] and group.kind in FIRST

    return np.array([i for i, parameter in enumerate(fit.parameters) if own(parameter.group)], dtype=int)


def folds_of(fit: Fit, names: Sequence[str]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return (M,) the session or campaign of every row as a number, and for each of them what `frames_of` it."""
    return numbered(names), [frames_of(fit, name) for name in dict.fromkeys(names)]


@dataclass(frozen=True)
class OfCampaign:
    """RMS of the 3-D error in one of several campaigns that were fitted together.

    Attributes:
        name: Of the campaign.
        rows: How many of its rows were fitted.
        before, after: Before the fit, and after it [m].
        from_others: Of the arm that the other campaigns make, only the instrument's frame and the target found here
            [m]; None where nothing of it counts.
    """

    name: str
    rows: int
    before: float
    after: float
    from_others: float | None


def by_campaign(before: View, fit: Fit, judged: np.ndarray, residual: Array | None = None) -> tuple[OfCampaign, ...]:
    """Return the errors in each of several campaigns, also without its part in the fit; none of one alone.

    Args:
        before: The rows before the fit.
        fit: The fit to them.
        judged: (M, d) readings that count; see `judged_by`.
        residual: (M, d) of the fit, where it is not all that its view leaves.
    """
    residual = fit.view.residual if residual is None else residual
    campaigns = [fit.view.driven.campaign[row] for row in fit.view.rows] if fit.view.driven.campaign else []
    names, (folds, frames), judged_campaigns = list(dict.fromkeys(campaigns)), folds_of(fit, campaigns), []
    if len(names) < 2:
        return ()
    alone = held_out(fit, folds, frames, judged)
    for number, name in enumerate(names):
        inside = np.flatnonzero(folds == number)
        readings = fit.view.readings.where(judged).some(inside)
        first, then = (foremost_rms(readings, left[inside]) for left in (before.residual, residual))
        left = alone.rms_of(folds == number) if alone.believed[inside].any() else None
        judged_campaigns.append(OfCampaign(name, len(inside), first, then, left))
    return tuple(judged_campaigns)


def errors_of(fit: Fit, whitened: Array) -> Array:
    """Return (M, n) errors of the foremost numbers [m] from (M d,) whitened and weighted ones; zero where not read."""
    where = fit.view.foremost
    sigma = fit.view.sigma[:, where]
    errors = whitened.reshape(fit.weights.shape)[:, where] / np.sqrt(fit.weights[:, where])
    return errors * np.where(np.isfinite(sigma), sigma, 0.0)


def known_of_others(fit: Fit, folds: np.ndarray, noise: float = 1.0) -> Iterator[LinearGaussian]:
    """Yield the information of all other folds' rows on a fit's values, for every fold, from (M,) folds.

    `noise` is the variance of a whitened reading.
    """
    squares = [squared(fit.regressors[rows]) / noise for rows in _readings_of(fit, folds)]
    for information in _of_others(squares):  # one after the other: a random twist has as many values as there are poses
        yield LinearGaussian(information).with_precision(fit.precision)


def _readings_of(fit: Fit, folds: np.ndarray) -> list[np.ndarray]:
    """Return the places of every fold's readings among all, from the (M,) fold of every row."""
    every = np.repeat(folds, fit.view.residual.shape[1])
    return [np.flatnonzero(every == number) for number in range(int(folds.max()) + 1)]


def _of_others(parts: Sequence[Array]) -> Iterator[Array]:
    """Yield for each part the sum of all others; taken off the sum of all it would leave its rounding there."""
    after = list(accumulate(parts[:0:-1], initial=np.zeros_like(parts[0])))
    for before in accumulate(parts[:-1], initial=np.zeros_like(parts[0])):
        yield before + after.pop()


def design_effect(fit: Fit, others: Array, covariance: Array, least: float = 1.0) -> float:
    """Return how many readings inform on a fit's parameters as much as one that is independent of the others would.

    What an arm lacks is alike at neighbouring poses, so that many readings repeat one another: parameters are off by
    more than readings with independent noise would leave. The design effect (Kish 1965, "Survey Sampling") divides the
    readings' information. It is the most probable one for the errors e in each part of joint space, predicted from the
    other parts: with the information N_k of those readings over k, and of the priors,

        e ~ N(0, s^2 + J N_k^-1 J'),    s the scatter about the fit.

    Rows that the fit excludes, and readings that depend on what the other parts leave open, do not count. From
    fewer poses than `POSE_FOLDS` nothing is concluded.

    Args:
        fit: The fit.
        others: (M d, K) whitened and weighted columns of what was not fitted and is uncertain nevertheless.
        covariance: (K, K) of that.
        least: Standard deviation of the readings over the stated one that they have at least.
    """
    from scipy.optimize import minimize_scalar  # not needed to import the package

    view = fit.view
    if len(np.unique(view.driven.pose_number[view.rows])) < POSE_FOLDS or not len(fit.values):
        return 1.0
    folds = apart_folds(view.driven.q[view.rows], PARTS)
    data, counted, parts = fit.residual + fit.regressors @ fit.values, near(view), []
    counted[:, view.foremost.stop :] = False
    scale = 1.0 / (np.maximum(fit.scatter_by_number, RESOLUTION) * np.sqrt(fit.weights)).ravel()
    prior = np.where(fit.precision > 0.0, fit.prior, 0.0)
    rows = _readings_of(fit, folds)
    scores = _of_others([fit.regressors[place].T @ np.column_stack([data[place], others[place]]) for place in rows])
    for posterior, place, score in zip(known_of_others(fit, folds), rows, scores, strict=True):
        place = place[counted.ravel()[place]]
        place = place[~depend_on(fit.regressors[place][:, None], posterior.null_space)[:, 0]]
        error = scale[place] * (data[place] - fit.regressors[place] @ posterior.solve(score[:, 0]))
        columns, more = (scale[place, None] * each[place] for each in (fit.regressors, others))
        # Of what other parts say nothing of, such as random twists of these poses, only the prior is known.
        shown = np.diag(posterior.information) > fit.precision
        held = 1.0 + columns[:, ~shown] ** 2 @ prior[~shown] ** 2
        information = posterior.information[np.ix_(shown, shown)] - np.diag(fit.precision[shown])
        parts.append((information, fit.precision[shown], score[shown, 1:], columns[:, shown], held, more, error))
    noise = max(fit.noise, least) ** 2

    def cost(logarithm: float) -> float:
        """Return -2 log likelihood but for a constant."""
        total, share = 0.0, np.exp(-logarithm) / noise
        for information, precision, crossed, columns, held, more, error in parts:
            posterior = LinearGaussian(information * share).with_precision(precision)
            more = more - columns @ posterior.solve(crossed) * share
            variance = held + posterior.variance(columns) + ((more @ covariance) * more).sum(axis=1)
            total += float((np.log(variance) + error**2 / variance).sum())
        return total

    most = np.log(max(sum(len(error) for *_, error in parts), 2))
    best = cast(Any, minimize_scalar(cost, bounds=(0.0, most), method="bounded", options={"xatol": EVEN}))
    return float(np.exp(best.x)) if best.fun < cost(0.0) else 1.0


def excess(fit: Fit, folds: np.ndarray, errors: Array, judged: np.ndarray, effect: float) -> float:
    """Return by how much rows held out are off beyond their noise and what is known of a fit's values [m].

    What was chosen by looking at a campaign, such as which effects it shows, is not among the values whose covariance
    a fit knows; rows that were held out from the choice know what is wrong with it. It is the most probable standard
    deviation m of a shift for the errors e of the foremost numbers in each fold, predicted from the others,

        e ~ N(0, s^2 + J N_k^-1 J' + (S m)^2),

    with s the noise as stated, or as it scatters about the fit where that is less, N_k the information of the other
    folds and the priors, and S the change of a reading with a shift. 0 where chance would give as much.

    Args:
        fit: The fit, with what was chosen from all rows.
        folds: (M,) fold of every row.
        errors: (M, n) errors of the foremost numbers where all is chosen and fitted without a row's fold [m].
        judged: (M, d) readings that count.
        effect: How many readings count as one; see `design_effect`.
    """
    from scipy.optimize import minimize_scalar  # not needed to import the package

    spread = np.empty(fit.view.residual.size)
    for posterior, place in zip(
        known_of_others(fit, folds, effect * fit.noise**2), _readings_of(fit, folds), strict=True
    ):
        spread[place] = posterior.variance(fit.regressors[place])
    where, view = fit.view.foremost, fit.view
    counted = judged[:, where]
    read = np.where(np.isfinite(view.sigma), view.sigma, 0.0)
    weighed = spread.reshape(fit.weights.shape) / fit.weights * read**2
    scatter = np.minimum(fit.stated, view.sigma * fit.scatter_by_number)
    without, shift = (scatter**2 + weighed)[:, where][counted], view.by_shift[:, where][counted] ** 2
    squares = errors[counted] ** 2

    def cost(logarithm: float) -> float:
        """Return -2 log likelihood but for a constant."""
        variance = without + np.exp(2.0 * logarithm) * shift
        return float((np.log(variance) + squares / variance).sum())

    least = float((np.log(without) + squares / without).sum())
    # No reading is off by more, nor would so many show less.
    around = 0.5 * np.log(np.array([without.mean() / len(without), max(without.max(), squares.max())]) / shift.mean())
    best = cast(Any, minimize_scalar(cost, bounds=around, method="bounded", options={"xatol": EVEN})).x
    return float(np.exp(best)) if least - cost(best) > outlier_limit(1) ** 2 else 0.0


def apart_folds(q: Array, count: int) -> np.ndarray:
    """Return (M,) parts of joint space: rows by the nearest of some poses, each chosen farthest from those before.

    Args:
        q: (M, nq) joint positions [rad or m]; each counts by its range.
        count: How many parts.
    """
    q, chosen = q / np.maximum(np.ptp(q, axis=0), STILL), [0]
    for _ in range(4 * count - 1):
        nearest = np.linalg.norm(q[:, None] - q[chosen], axis=2).min(axis=1)
        chosen.append(int(nearest.argmax()))
    cells = np.linalg.norm(q[:, None] - q[chosen], axis=2).argmin(axis=1)
    part, size = np.zeros(len(q), dtype=int), np.zeros(count, dtype=int)
    for cell in np.argsort(-np.bincount(cells, minlength=4 * count)):  # the largest first, each to the smallest part
        part[cells == cell] = size.argmin()
        size[size.argmin()] += (cells == cell).sum()
    return part


def pose_folds(groups: np.ndarray) -> np.ndarray:
    """Return (M,) folds that keep the rows of a pose together."""
    poses = np.unique(groups)
    order = np.random.default_rng(0).permutation(len(poses))
    fold = dict(zip(poses[order].tolist(), (np.arange(len(poses)) % min(POSE_FOLDS, len(poses))).tolist(), strict=True))
    return np.array([fold[group] for group in groups.tolist()])


def campaigns_json(campaigns: Sequence[OfCampaign], stages: tuple[str, str]) -> dict[str, Any]:
    """Return the errors of each of several campaigns for programs, in mm, or thousandths of the unit that was read."""
    records = [
        record(campaign, "name rows")
        | {"rms_mm": {stages[0]: campaign.before * 1e3, stages[1]: campaign.after * 1e3}}
        | {"from_others_rms_mm": None if campaign.from_others is None else campaign.from_others * 1e3}
        for campaign in campaigns
    ]
    return {"campaigns": records} if records else {}
