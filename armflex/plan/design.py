"""Optimal design: information on parameters, what one more row adds to each of three goals, and the best rows.

Everything is linear in the parameters about what is known now, and Gaussian. A row of the campaign is X (d, P), its
readings' change per parameter in standard deviations; rows add X'X to the information N, whose inverse is the
covariance (`armflex.linear_gaussian`). With S = 1 + X N^-1 X' one row

    makes a block of parameters' covariance smaller by the factor  |S - X K X'| / |S|        (Fedorov 1972)
    makes the trace of W N^-1 smaller by                           tr(S^-1 X N^-1 W N^-1 X')
    adds to the chi-square between an effect and its best imitation  e' S^-1 e, e its departure from it here
                                                              (Atkinson and Fedorov 1975; Hunter and Reiner 1965)

Rows are chosen one after the other, then exchanged until none is better (Fedorov 1972).
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.effect import Effect, EffectLaw, Watching
from armflex.linear_gaussian import LinearGaussian


class Goal(Protocol):
    """What a plan is to make as large as it can."""

    @property
    def title(self) -> str:
        """What is shown of it, with its unit."""
        ...

    def shown(self, value: Array | float) -> Array | float:
        """Return what people look at."""
        ...

    def value(self, gram: LinearGaussian) -> float:
        """Return what is reached with what is known of P parameters."""
        ...

    def gains(self, gram: LinearGaussian, rows: Array) -> Array:
        """Return (N,) rises of the value by each of (N, d, P) rows; see the top of this module."""
        ...


@dataclass(frozen=True, eq=False)
class DsOptimal:
    """D_s-optimality: minus the mean logarithm of the standard deviations of the parameters at `places`.

    Of a covariance that is not diagonal the determinant is meant: the volume of what is left possible. Shown is the
    geometric mean of the standard deviations, in the units of the parameters.
    """

    places: np.ndarray
    title: str = "standard deviation over the prior one, geometric mean"

    def shown(self, value: Array | float) -> Array | float:
        return np.exp(-np.asarray(value))

    def value(self, gram: LinearGaussian) -> float:
        block = gram.covariance[np.ix_(self.places, self.places)]
        return -0.5 * float(np.linalg.slogdet(block)[1]) / len(self.places)

    def gains(self, gram: LinearGaussian, rows: Array) -> Array:
        covariance = gram.covariance
        seen = rows @ covariance
        whole = _spread(seen, rows)
        seen_here = seen[:, :, self.places]
        explained = (
            seen_here @ np.linalg.inv(covariance[np.ix_(self.places, self.places)]) @ np.swapaxes(seen_here, -1, -2)
        )
        fall = np.linalg.slogdet(whole)[1] - np.linalg.slogdet(whole - explained)[1]
        return 0.5 * fall / len(self.places)


@dataclass(frozen=True, eq=False)
class IOptimal:
    """I-optimality: minus the mean variance of predictions, whose (P, P) mean of squares `weight` is.

    Shown is the RMS of the standard deviations in 3-D [mm].
    """

    weight: Array
    title: str = "standard deviation of predicted readings in mm, RMS in 3-D"

    def shown(self, value: Array | float) -> Array | float:
        return 1e3 * np.sqrt(np.maximum(-np.asarray(value), 0.0))

    def value(self, gram: LinearGaussian) -> float:
        return -float((self.weight * gram.covariance).sum())

    def gains(self, gram: LinearGaussian, rows: Array) -> Array:
        seen = rows @ gram.covariance
        less = np.linalg.solve(_spread(seen, rows), seen @ self.weight @ np.swapaxes(seen, -1, -2))
        return np.trace(less, axis1=1, axis2=2)


@dataclass(frozen=True, eq=False)
class Truth:
    """One effect taken as true, to be distinguished from everything that could imitate it.

    Attributes:
        own: (P,) its amplitudes, zero elsewhere.
        others: Places of what is refitted in its stead.
        held: What a prior of its own puts into the information: no evidence.
    """

    own: Array
    others: np.ndarray
    held: float = 0.0

    def apart(self, gram: LinearGaussian, rows: Array) -> tuple[float, Array]:
        """Return the chi-square between the effect and its best imitation so far, and what (N, d, P) rows add each."""
        there, departure = rows[:, :, self.others], self.departure(gram)
        left = rows @ departure
        seen = there @ gram.conditional(self.others).covariance
        more = np.linalg.solve(_spread(seen, there), left[:, :, None])[:, :, 0]
        return self.chi_square(gram, departure), (left * more).sum(axis=1)

    def chi_square(self, gram: LinearGaussian, departure: Array) -> float:
        """Return the chi-square between the effect and its best imitation, from the (P,) `departure` between them."""
        return max(float(departure @ gram.information @ self.own) - self.held, 0.0)

    def departure(self, gram: LinearGaussian) -> Array:
        """Return the (P,) values of the effect less those of its best imitation."""
        departure = self.own.copy()
        departure[self.others] = -gram.conditional(self.others).solve(gram.information[self.others] @ self.own)
        return departure


@dataclass(frozen=True, eq=False)
class TOptimal:
    """T-optimality: the smallest of the expected chi-squares, as any of the effects may be the true one.

    The value is the chi-square by which the wrong effect fits worse; shown is its root, standard deviations apart.
    """

    truths: tuple[Truth, ...]
    title: str = "standard deviations between the effects"

    def shown(self, value: Array | float) -> Array | float:
        return np.sqrt(np.maximum(value, 0.0))

    def value(self, gram: LinearGaussian) -> float:
        return min(truth.chi_square(gram, truth.departure(gram)) for truth in self.truths)

    def gains(self, gram: LinearGaussian, rows: Array) -> Array:
        both = [truth.apart(gram, rows) for truth in self.truths]
        return np.min([now + more for now, more in both], axis=0) - min(now for now, _ in both)


@dataclass(frozen=True, eq=False)
class Named:
    """Minus the most that the probability of a wrong name can be: Bhattacharyya's bound (Kailath 1967).

    Of two causes of probabilities p and q that further readings put a chi-square apart, the wrong one is the more
    probable afterwards with a probability of sqrt(p q) exp(-chi-square / 8) at most.

    Attributes:
        truths: Of every pair one cause, to be distinguished from the other.
        chances: (K,) sqrt(p q) of every pair; 0 where no reading distinguishes it.
        now: (K,) the chi-squares that the probabilities are from.
    """

    truths: tuple[Truth, ...]
    chances: Array
    now: Array
    title: str = "probability of a wrong name, at most"

    def shown(self, value: Array | float) -> Array | float:
        return -np.asarray(value)

    def apart(self, gram: LinearGaussian) -> Array:
        """Return the (K,) chi-squares by which further readings put the pairs apart."""
        return np.array([truth.chi_square(gram, truth.departure(gram)) for truth in self.truths]) - self.now

    def value(self, gram: LinearGaussian) -> float:
        return -float(self.chances @ np.exp(-self.apart(gram) / 8.0))

    def gains(self, gram: LinearGaussian, rows: Array) -> Array:
        gains = np.zeros(len(rows))
        for truth, chance, now in zip(self.truths, self.chances, self.now, strict=True):
            if chance > 0.0:
                reached, more = truth.apart(gram, rows)
                gains += chance * np.exp(-(reached - now) / 8.0) * -np.expm1(-more / 8.0)
        return gains


def _spread(seen: Array, rows: Array) -> Array:
    """Return (N, d, d) covariance of readings in standard deviations: their noise, and what is not known."""
    return np.eye(rows.shape[1]) + seen @ np.swapaxes(rows, -1, -2)


def greedy(goal: Goal, gram: LinearGaussian, rows: Array, count: int) -> list[int]:
    """Return the numbers of `count` of (N, d, P) rows, each the best after those before it; none twice."""
    chosen: list[int] = []
    for _ in range(min(count, len(rows))):
        chosen.append(int(_gains_beside(goal, gram, rows, chosen).argmax()))
    return chosen


def exchanged(goal: Goal, gram: LinearGaussian, rows: Array, chosen: Sequence[int], rounds: int) -> list[int]:
    """Return the choice after each row was given up for the best there is in its place, at most `rounds` times each."""
    chosen = list(chosen)
    for _ in range(rounds):
        before = list(chosen)
        for place, row in enumerate(before):
            gains = _gains_beside(goal, gram, rows, chosen[:place] + chosen[place + 1 :])
            best = int(gains.argmax())
            # Share of what is reached by which an exchange must raise it: less is rounding.
            if gains[best] > gains[row] + 1e-6 * abs(gains[row]):
                chosen[place] = best
        if chosen == before:
            break
    return chosen


def _gains_beside(goal: Goal, gram: LinearGaussian, rows: Array, taken: list[int]) -> Array:
    """Return (N,) what each row adds beside those that are taken, which can be taken no more."""
    gains = goal.gains(gram.with_rows(rows[taken]), rows)
    gains[taken] = -np.inf
    return gains


def path(goal: Goal, gram: LinearGaussian, rows: Array) -> Array:
    """Return (n + 1,) what is reached after none, one, two ... of (n, d, P) rows in their order."""
    reached = [goal.value(gram)]
    for row in rows:
        gram = gram.with_rows(row)
        reached.append(goal.value(gram))
    return np.array(reached)


def shows(law: EffectLaw, place: str, levels: Collection[str]) -> str:
    """Return what shows a law at a place of the arm otherwise, '' where nothing is known.

    `levels` are the places at which a level informs, see `armflex.plan.instruments.informing_levels`.
    """
    return law.level if law.level and place in levels else law.instead


def instead(effect: Effect, hypothesis: Effect, levels: Collection[str] = ()) -> str:
    """Return what distinguishes two effects that move the tip alike.

    Two causes of one motion, at one place about one axis, are not distinguished by watching it. `levels` are as for
    `shows`.
    """
    both, places = (hypothesis, effect), (hypothesis.location, effect.location)
    ends = {(place.place, place.axis) for place in places}  # a link bends where the joint at its end begins
    one_motion = len(ends) == 1 and places[0].axis is not None
    determined = dict.fromkeys(
        shows(effect.law, effect.location.place, levels)
        for effect in both
        if not (one_motion and isinstance(effect.law.instead, Watching))
    )
    determined.pop("", None)
    if determined or not one_motion:
        return ", or ".join(determined) or "measure a second target between the places in question"
    if effect.law.loaded != hypothesis.law.loaded:
        return "carry other payloads in the same poses"
    return "correct either of them, because they move the arm alike"
