"""What several calibrations say together: of sister arms, or of one machine over time.

*Sisters* have in common mean and spread of every parameter, which are the prior of the next one. Sister i has
parameters t_i ~ N(m, diag(s^2)). Its campaign says a Gaussian of them, with information L_i and pull h_i:
what its posterior has beyond the prior it was fitted with. Only parameters that all campaigns together determine are
looked at. A joint's zero and the turn of its frame about the same axis are one: the other stays as declared. What no
campaign shows, such as a turn of the whole arm before an instrument that may stand anywhere, keeps its declared prior.

With five or six sisters the spread itself is uncertain, and a prior that takes the estimated spread as true is too
narrow. So m and s are drawn from their posterior by Gibbs sampling: t_i and m are Gaussian given the others, and s has
a log-uniform prior on a grid, with which the next one of n perfectly known sisters is Student's t of n - 1 degrees of
freedom about their mean (Gelman et al., Bayesian Data Analysis, 3.2 and 11.6). The prior that is passed on is
Gaussian, with the mean and the variance of that prediction, E[s^2] + var(m).

*One machine* over several calibrations: what changed, when, and whether at once or little by little. Each parameter has
a value and an uncertainty at every date. It stays, drifts (a straight line over the dates) or jumps once (one value
before, another after). A change counts where it lowers the sum of squares by more than chance does in one of a
thousand histories, counting all parameters and all moments at which one may jump (Bonferroni). Where drift and jump are
as likely but for `DOUBT`, both are named.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from armflex.arm import Arm
from armflex.conventions import RESOLUTION, Array
from armflex.errors import InputError, listing
from armflex.estimate.identify import UNDETERMINED
from armflex.estimate.robust import BY_CHANCE, chi_squared, outlier_limit
from armflex.parameters import DOUBT, ArmParameter, ParameterKind

SHARED = (
    ParameterKind.OFFSET,
    ParameterKind.GEOMETRY,
    ParameterKind.MASS,
    ParameterKind.SPRING,
    ParameterKind.COMPLIANCE,
)
"""Kinds of parameters that sisters have in common."""

FEWEST_SISTERS = 3
"""Tolerance: sisters from which a spread can be estimated."""

SPREADS = np.geomspace(0.02, 3.0, 60)
"""Prior: spreads that are considered, in units of the declared prior."""


@dataclass(frozen=True, eq=False)
class Sister:
    """What a campaign said of one arm.

    Attributes:
        name: Of its file.
        information: (P, P) of the parameters, in units of their declared priors.
        pull: (P,) information times the most likely values.
        value: (P,) as fitted, in the same units.
    """

    name: str
    information: Array
    pull: Array
    value: Array


@dataclass(frozen=True, eq=False)
class Fleet:
    """What sisters have in common.

    Attributes:
        parameters: Those that their campaigns determine.
        mean, spread: (P,) of the sisters, in the parameters' units.
        std: (P,) one standard deviation of the next one about the mean.
        held: Parameters that stay as declared, because others do the same to every reading.
        sisters: Names of those that count.
        strangers: Names of those that do not, with the logarithm of the odds against them.
    """

    parameters: tuple[ArmParameter, ...]
    mean: Array
    spread: Array
    std: Array
    held: tuple[ArmParameter, ...]
    sisters: tuple[str, ...]
    strangers: Mapping[str, float]

    @property
    def each(self) -> dict[str, tuple[float, float]]:
        """Mean and standard deviation of every parameter by its label, as [prior.each] has them; 0, 0 where held."""
        priors = {
            parameter.label: (float(mean), float(std))
            for parameter, mean, std in zip(self.parameters, self.mean, self.std, strict=True)
        }
        return priors | {parameter.label: (0.0, 0.0) for parameter in self.held}


def common(arms: Mapping[str, Arm], seed: int = 0, draws: int = 2000) -> Fleet:
    """Return what calibrated arms of one make have in common.

    An arm whose parameters the declared prior explains far better than the others do is left out.

    Args:
        arms: Calibrated arms by name, of the same declared arm.
        seed: Of the sampler.
        draws: How many, after as many in which it finds its way.

    Raises:
        InputError: Too few arms; one is not calibrated, declared otherwise, or another prior frees its parameters.
    """
    if len(arms) < FEWEST_SISTERS:
        raise InputError(f"{len(arms)} arms say nothing of a spread: expected {FEWEST_SISTERS} or more")
    parameters, scale, sisters, held = said(arms)
    ones = np.ones(len(scale))
    strangers: dict[str, float] = {}
    while len(sisters) > FEWEST_SISTERS:
        odds = []
        for i, sister in enumerate(sisters):
            mean, _, std = _predicted([other for j, other in enumerate(sisters) if j != i], seed, draws)
            odds.append(_evidence(sister, 0.0 * ones, ones) - _evidence(sister, mean, std))
        worst = int(np.argmax(odds))
        if odds[worst] < -np.log(BY_CHANCE):  # for the declared prior against that of the others
            break
        strangers[sisters.pop(worst).name] = float(odds[worst])
    mean, spread, std = _predicted(sisters, seed, draws)
    return Fleet(
        parameters,
        mean * scale,
        spread * scale,
        std * scale,
        held,
        tuple(sister.name for sister in sisters),
        strangers,
    )


def said(
    arms: Mapping[str, Arm],
) -> tuple[tuple[ArmParameter, ...], Array, list[Sister], tuple[ArmParameter, ...]]:
    """Return the parameters that the campaigns of arms determine, their priors, what each said, and what is held.

    Raises:
        InputError: An arm is not calibrated, declared otherwise, or another prior frees its parameters.
    """
    names = list(arms)
    first = arms[names[0]]
    for name, arm in arms.items():
        if arm.certainty is None:
            raise InputError(f"{name} is not calibrated: its file has no [calibration]")
        if not _alike(first, arm):
            raise InputError(f"{name} is not declared like {names[0]}: what is compared are corrections of one arm")
    parameters_by_arm = [
        tuple(parameter for parameter in _certain(arm) if parameter.group.kind in SHARED) for arm in arms.values()
    ]
    for name, shared in zip(names, parameters_by_arm, strict=True):
        if shared != parameters_by_arm[0]:
            odd = [parameter.label for parameter in set(shared) ^ set(parameters_by_arm[0])]
            raise InputError(f"[prior] frees other parameters of {name} than of {names[0]}: {listing(sorted(odd), 5)}")
    parameters = parameters_by_arm[0]
    if not parameters:
        raise InputError(f"{names[0]}: nothing was fitted that is compared (offsets, geometry, masses, compliance)")
    scale = np.array([first.prior.of(parameter)[1] for parameter in parameters])
    sisters = [_sister(name, arm, parameters, scale) for name, arm in arms.items()]
    whole = sum((sister.information for sister in sisters), np.zeros((len(scale),) * 2))
    chosen = _visible(whole)
    if not len(chosen):
        raise InputError("the campaigns of all arms together determine no parameter better than its prior")
    # What is seen, but not beside the chosen ones, is the same as some of these; what is not seen stays as uncertain.
    held = tuple(parameter for i, parameter in enumerate(parameters) if i not in chosen and _shown(whole[i, i]))
    kept = [
        Sister(sister.name, sister.information[np.ix_(chosen, chosen)], sister.pull[chosen], sister.value[chosen])
        for sister in sisters
    ]
    return tuple(parameters[i] for i in chosen), scale[chosen], kept, held


def _certain(arm: Arm) -> tuple[ArmParameter, ...]:
    return () if arm.certainty is None else arm.certainty.parameters


def _alike(arm: Arm, other: Arm) -> bool:
    """Return whether two arms are declared alike: joints, their frames, and where they give."""
    if arm.joint_names != other.joint_names or arm.flexure_names != other.flexure_names or arm.prior != other.prior:
        return False
    frames = [[np.append(joint.rotation, joint.origin) for joint in each.robot.chain] for each in (arm, other)]
    return len(frames[0]) == len(frames[1]) and np.allclose(*frames, rtol=0.0, atol=RESOLUTION)


def _sister(name: str, arm: Arm, parameters: Sequence[ArmParameter], scale: Array) -> Sister:
    """Return what the campaign of an arm said beyond the prior it was fitted with, in units of the priors."""
    assert arm.certainty is not None
    covariance = arm.certainty.among(parameters)
    assert covariance is not None
    precision = np.linalg.inv(covariance / np.outer(scale, scale))
    mean = np.array([arm.prior.of(parameter)[0] for parameter in parameters]) / scale
    value = np.array([arm.found(parameter) for parameter in parameters]) / scale
    values, axes = np.linalg.eigh(0.5 * (precision + precision.T) - np.eye(len(scale)))
    information = (axes * np.maximum(values, 0.0)) @ axes.T  # a rounded matrix, or readings that scatter, go below
    # The posterior's mean x has (information + 1) (x - mean) = information (likely - mean).
    return Sister(name, information, information @ mean + (information + np.eye(len(scale))) @ (value - mean), value)


def _visible(information: Array) -> np.ndarray:
    """Return the places of parameters that are determined beside each other, by a pivoted Cholesky decomposition."""
    left, chosen = information.copy(), list[int]()
    while True:
        diagonal = np.diag(left).copy()
        diagonal[chosen] = 0.0
        best = int(diagonal.argmax())
        if not _shown(diagonal[best]):
            return np.array(sorted(chosen), dtype=int)
        chosen.append(best)
        left = left - np.outer(left[:, best], left[best]) / left[best, best]


def _shown(information: float) -> bool:
    """Return whether information on a parameter, in units of its prior, determines it; see `UNDETERMINED`."""
    return bool((1.0 + information) * UNDETERMINED**2 > 1.0)


def _predicted(sisters: Sequence[Sister], seed: int, draws: int) -> tuple[Array, Array, Array]:
    """Return (P,) mean and spread of sisters, and the standard deviation of the next one, in units of the priors."""
    rng, count, size = np.random.default_rng(seed), len(sisters), len(sisters[0].pull)
    information, pulls = (np.array([getattr(sister, name) for sister in sisters]) for name in ("information", "pull"))
    mean, spread = np.mean([sister.value for sister in sisters], axis=0), np.ones(size)
    means, squares, sizes = [], [], []
    for sweep in range(2 * draws):
        roots = np.linalg.cholesky(information + np.diag(spread**-2.0))
        halves = np.linalg.solve(roots, (pulls + mean * spread**-2.0)[:, :, None])
        values = np.linalg.solve(roots.swapaxes(1, 2), halves + rng.normal(size=halves.shape))[:, :, 0]
        precision = count * spread**-2.0 + 1.0
        mean = (values.sum(axis=0) * spread**-2.0) / precision + rng.normal(size=size) / np.sqrt(precision)
        sums = ((values - mean) ** 2).sum(axis=0)
        logs = -count * np.log(SPREADS) - 0.5 * sums[:, None] / SPREADS**2
        shares = np.exp(logs - logs.max(axis=1, keepdims=True)).cumsum(axis=1)
        spread = SPREADS[(shares < rng.uniform(size=(size, 1)) * shares[:, -1:]).sum(axis=1)]
        if sweep >= draws:
            means.append(mean)
            squares.append(spread**2)
            sizes.append(np.log(spread))
    variance = np.mean(squares, axis=0) + np.var(means, axis=0)
    return np.mean(means, axis=0), np.exp(np.mean(sizes, axis=0)), np.minimum(np.sqrt(variance), SPREADS[-1])


def _evidence(sister: Sister, mean: Array, std: Array) -> float:
    """Return the logarithm of how probable a campaign is under a prior, but for what all priors have in common."""
    scaled = np.eye(len(std)) + std[:, None] * sister.information * std
    pull = std * (sister.pull - sister.information @ mean)  # about the prior's mean
    fit = 0.5 * float(pull @ np.linalg.solve(scaled, pull))
    about = float(sister.pull @ mean - 0.5 * mean @ sister.information @ mean)
    return fit + about - 0.5 * float(np.linalg.slogdet(scaled)[1])


@dataclass(frozen=True, eq=False)
class Course:
    """One parameter over the dates.

    Attributes:
        parameter: Which it is.
        value, std: (N,) at each date, in its unit.
        change: "", "jump", "drift", or "jump or drift".
        since: Number of the first date after a jump; 0 where there is none.
        size: Height of the jump, or drift from the first date to the last, in its unit.
        size_std: Its standard uncertainty.
    """

    parameter: ArmParameter
    value: Array
    std: Array
    change: str = ""
    since: int = 0
    size: float = 0.0
    size_std: float = 0.0


@dataclass(frozen=True, eq=False)
class History:
    """A machine over several calibrations.

    Attributes:
        names: Of the calibrations, in order of their dates.
        dates: (N,) in any unit.
        courses: Every parameter that the campaigns determine, those that changed first.
    """

    names: tuple[str, ...]
    dates: Array
    courses: tuple[Course, ...]

    @property
    def changed(self) -> tuple[Course, ...]:
        """Parameters that changed."""
        return tuple(course for course in self.courses if course.change)

    def between(self, i: int, j: int) -> list[tuple[Course, float, float]]:
        """Return what differs between two dates by more than chance makes of one: by how much, and its std."""
        steps = [
            (course, course.value[j] - course.value[i], float(np.hypot(course.std[i], course.std[j])))
            for course in self.courses
        ]
        return [(course, float(step), std) for course, step, std in steps if abs(step) > outlier_limit(1) * std]


def history(arms: Mapping[str, Arm], dates: Sequence[float]) -> History:
    """Return how the parameters of one machine went over its calibrations.

    Args:
        arms: The calibrated arms by name, declared alike, each fitted to a campaign of its own.
        dates: Of each, ascending.

    Raises:
        InputError: Fewer than two arms; dates that do not ascend; as `said`.
    """
    time = np.array(dates, dtype=float)
    if len(arms) < 2:
        raise InputError(f"expected two calibrations or more to compare, got {len(arms)}")
    if len(time) != len(arms) or not (np.diff(time) > 0.0).all():
        raise InputError(f"expected dates that ascend, one for each of {len(arms)} calibrations, got {list(dates)}")
    parameters, scale, sisters, _ = said(arms)
    covariances = [np.linalg.inv(sister.information + np.eye(len(scale))) for sister in sisters]
    values = (
        np.array([covariance @ sister.pull for covariance, sister in zip(covariances, sisters, strict=True)]) * scale
    )
    stds = np.sqrt([np.diag(covariance) for covariance in covariances]) * scale
    tried = len(parameters) * len(time)
    courses = [_course(parameter, values[:, i], stds[:, i], time, tried) for i, parameter in enumerate(parameters)]
    courses.sort(key=lambda course: -abs(course.size) / course.size_std if course.change else 0.0)
    return History(tuple(arms), time, tuple(courses))


def _course(parameter: ArmParameter, value: Array, std: Array, time: Array, tried: int) -> Course:
    count = len(time)
    stays, _, _ = _fit(np.ones((count, 1)), value, std)
    later = [np.column_stack([np.ones(count), (np.arange(count) >= at).astype(np.float64)]) for at in range(1, count)]
    jumps = [_fit(columns, value, std) for columns in later]
    best = int(np.argmin([jump[0] for jump in jumps]))
    over = (time - time[0]) / (time[-1] - time[0])
    drift = _fit(np.column_stack([np.ones(count), over]), value, std)
    limit = chi_squared(1, BY_CHANCE / tried)
    if stays - min(jumps[best][0], drift[0]) < limit:
        return Course(parameter, value, std)
    kind, best_fit = ("jump", jumps[best]) if jumps[best][0] <= drift[0] else ("drift", drift)
    if count > 2 and abs(jumps[best][0] - drift[0]) < -2.0 * np.log(DOUBT):
        kind = "jump or drift"
    since = 0 if kind == "drift" else best + 1
    return Course(parameter, value, std, kind, since, float(best_fit[1][1]), float(best_fit[2][1]))


def _fit(columns: Array, value: Array, std: Array) -> tuple[float, Array, Array]:
    """Return the weighted sum of squares that is left, the coefficients and their standard uncertainties."""
    scaled, whitened = columns / std[:, None], value / std
    covariance = np.linalg.inv(scaled.T @ scaled)
    solution = covariance @ (scaled.T @ whitened)
    return float(((whitened - scaled @ solution) ** 2).sum()), solution, np.sqrt(np.diag(covariance))
