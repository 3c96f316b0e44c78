"""Effects at work in an arm: twists join the law of a flexure, loads pull on links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import MissingCovariateError
from armflex.laws import Law, Row
from armflex.laws.effects.effect import Act, Effect, LoadLaw, TwistLaw, Values, full
from armflex.laws.effects.location import Here, link_of, resolve, same_site, site_of
from armflex.laws.flexure import Flexure
from armflex.laws.law import NOTHING, STEP, UNLOADED, Composed, Ranges, anywhere, by_wrench
from armflex.laws.parameter import Parameter, Transform
from armflex.robot import Robot

LOG = Transform.LOG
LEAST = 1e-2
"""Size that an inner parameter is taken to have at least where a numerical derivative needs a step."""

UNITS = np.eye(6)
UNITS.flags.writeable = False


@dataclass(frozen=True)
class BoundTwist(Law):
    """An effect's twist at its place on one arm.

    Its parameters are the amplitudes that act, then what of its inner ones it changes smoothly with. How well they are
    known goes by the calibration's covariance, so none has a prior here.
    """

    effect: Effect
    here: Here

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Amplitudes, then inner parameters; positive ones of these by their logarithm."""
        effect, units = self.effect, dict(zip(self.effect.named, self.effect.units, strict=True))
        amplitudes = [effect.law.amplitudes[i].name for i in effect.location.terms]
        inner = [effect.law.inner[i] for i in self._free]
        return (
            *(Parameter(name, units[name], 0.0) for name in amplitudes),
            *(
                Parameter(one.name, "1", 0.0, LOG) if one.positive else Parameter(one.name, units[one.name], 0.0)
                for one in inner
            ),
        )

    @cached_property
    def _free(self) -> tuple[int, ...]:
        """Inner parameters among the values: not those that are switched off, nor those that a memory goes by."""
        law, inner = self.effect.law, self.effect.inner
        free = []
        for i, (one, value) in enumerate(zip(law.inner, inner, strict=True)):
            other = (*inner[:i], 2.0 * value + 1.0, *inner[i + 1 :])
            told = law.memory is not None and law.memory.name(self.effect.location, other) != self.effect.state
            if one.smooth and not told and np.isfinite(value) and (value > 0.0 or not one.positive):
                free.append(i)
        return tuple(free)

    @cached_property
    def values(self) -> Array:
        """(k,) values of the parameters."""
        logs = [self.effect.law.inner[i].positive for i in self._free]
        inner = [
            float(np.log(self.effect.inner[i])) if log else self.effect.inner[i]
            for i, log in zip(self._free, logs, strict=True)
        ]
        return np.concatenate([self.effect.acting, inner])

    def at(self, values: Array) -> BoundTwist:
        """Return the same effect at other (k,) values."""
        location, law, inner = self.effect.location, self.effect.law, list(self.effect.inner)
        amplitudes, rest = np.split(np.asarray(values, dtype=float), [len(location.terms)])
        for i, value in zip(self._free, rest.tolist(), strict=True):
            inner[i] = float(np.exp(value)) if law.inner[i].positive else value
        moved = full(amplitudes, location, len(law.amplitudes)) + tuple(inner)
        return replace(self, effect=replace(self.effect, values=moved))

    def by_values(self, wrench: Array, row: Row) -> Array:
        """Return the (..., 6, k) derivative by the values: exact for amplitudes, else by central differences."""
        basis = self.law.basis(self.here, wrench, row, self.effect.inner)[..., list(self.effect.location.terms), :]
        columns = [np.broadcast_to(np.swapaxes(basis, -1, -2), (*wrench.shape, basis.shape[-2]))]
        for place in range(basis.shape[-2], len(self.values)):
            step = np.zeros(len(self.values))
            step[place] = STEP * (
                1.0 if self.parameters[place].transform is LOG else max(abs(self.values[place]), LEAST)
            )
            ends = [self.at(self.values + side * step).twist(wrench, row) for side in (1.0, -1.0)]
            columns.append(((ends[0] - ends[1]) / (2.0 * step[place]))[..., None])
        return np.concatenate(columns, axis=-1)

    @cached_property
    def law(self) -> TwistLaw:
        """What the effect does."""
        return cast(TwistLaw, self.effect.law)

    @cached_property
    def _amplitudes(self) -> Array:
        return np.array(self.effect.amplitudes)

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the (..., 6) twist; raise `MissingCovariateError` where the row lacks what the effect needs."""
        try:
            basis = self.law.basis(self.here, wrench, row, self.effect.inner)
        except MissingCovariateError as error:
            raise MissingCovariateError(error.name, error.given, self.effect.name) from None
        # The same; for a single load numpy's `dot` takes a third of the time.
        return self._amplitudes.dot(basis) if basis.ndim == 2 else self._amplitudes @ basis

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return the (..., 6, 6) derivative with respect to a (..., 6) wrench, by central differences in one call."""
        if not self.law.loaded:
            return np.zeros((6, 6))
        return by_wrench(self.twist, wrench, row)

    def affine(self, row: Row) -> tuple[Array, Array] | None:
        """Return the twist without load and the compliance, None where a loaded effect is not proportional."""
        law = self.law
        if (law.loaded and not law.linear) or self._base_curved:
            return None
        many = row.q.shape[:-1]
        if not law.loaded:
            return self.twist(np.zeros((*many, 6)) if many else NOTHING, row), UNLOADED
        if not many:
            return NOTHING, self.twist(UNITS, row).T
        units = np.broadcast_to(UNITS, (*many, 6, 6))
        return NOTHING, np.swapaxes(self.twist(units, row.widened()), -1, -2)

    def compliance_bound(self, ranges: Ranges) -> Array | None:
        """Return zero where the effect does not depend on the load."""
        return None if self.law.loaded or self._base_curved else np.zeros((2, 2))

    @cached_property
    def _base_curved(self) -> bool:
        """Whether the flexure's own law is curved, wherever its joints are."""
        own = self.here.base_law
        return own is not None and own.affine(anywhere(self.here.robot)) is None


@dataclass(frozen=True)
class WithEffects(Composed):
    """A flexure's law, if it has one, and what effects add to it.

    The effects' parameters go by the calibration's covariance.
    """

    law: Law | None
    effects: tuple[BoundTwist, ...]

    @cached_property
    def laws(self) -> tuple[Law, ...]:
        """The flexure's law, if it has one, and the effects."""
        return (*(() if self.law is None else (self.law,)), *self.effects)

    def with_laws(self, laws: Sequence[Law]) -> WithEffects:
        """Return the sum of others."""
        own, effects = laws[: len(laws) - len(self.effects)], laws[len(laws) - len(self.effects) :]
        return WithEffects(own[0] if own else None, tuple(effects))

    def shares(self, wrench: Array, row: Row) -> list[tuple[Array, Array]]:
        """Return that all have the same load, and their twists add up."""
        return [(UNITS, wrench)] * len(self.laws)

    @property
    def parts(self) -> tuple[Law, ...]:
        """The parts of the flexure's law, if it has one, and the effects."""
        return (*(() if self.law is None else self.law.parts), *self.effects)

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the sum of all twists."""
        total = np.zeros_like(wrench) if self.law is None else self.law.twist(wrench, row)
        for effect in self.effects:
            total = total + effect.twist(wrench, row)
        return total

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return the sum of all derivatives."""
        total = np.zeros((6, 6)) if self.law is None else self.law.tangent(wrench, row)
        for effect in self.effects:
            total = total + effect.tangent(wrench, row)
        return total


def with_twists(flexures: Sequence[Flexure], effects: Sequence[Effect], robot: Robot) -> tuple[Flexure, ...]:
    """Return the flexures as they are with effects: laws extended, and a flexure of its own where there was none."""
    modelled = list(flexures)
    bound: dict[str, list[BoundTwist]] = {}
    for effect in effects:
        if effect.law.act is Act.TWIST:
            here = resolve(effect.location, robot, flexures)
            bound.setdefault(effect.location.site, []).append(BoundTwist(effect, here))
    for site, parts in bound.items():
        place = site_of(site, robot)
        known = [i for i, flexure in enumerate(modelled) if same_site(flexure.site, place)]
        if known:
            old = modelled[known[-1]]
            modelled[known[-1]] = replace(old, law=WithEffects(old.law, tuple(parts)))
        else:
            modelled.append(Flexure(f"effects at {site}", place.joint, WithEffects(None, tuple(parts)), place.before))
    return tuple(modelled)


@dataclass(frozen=True)
class Pulling:
    """A load effect as an arm carries it."""

    frame: str
    law: LoadLaw
    here: Here
    amplitudes: Values
    inner: Values

    dead = False

    def at(self, pose: Array) -> Array:
        """Return the (..., 6) wrench at the link's origin, base axes, for (..., 4, 4) poses of it."""
        return np.array(self.amplitudes) @ self.law.pull(self.here, pose, self.inner)

    def change(self, pose: Array) -> Array:
        """Return the (..., 6, 6) change per motion of the link, by central differences."""
        ends = [self.at(_moved(pose, side * MOVE)) for side in (1.0, -1.0)]
        return np.swapaxes((ends[0] - ends[1]) / (2.0 * MOVE), -1, -2)


MOVE = 1e-6


def _moved(pose: Array, size: float) -> Array:
    """Return (..., 6, 4, 4) poses after a small step along each axis and about it, base axes."""
    moved = np.repeat(pose[..., None, :, :], 6, axis=-3)
    for axis, unit in enumerate(np.eye(3)):
        moved[..., axis, axis, 3] += size
        moved[..., 3 + axis, :3, :3] += size * pin.skew(unit) @ pose[..., :3, :3]
    return moved


def pulling(effects: Sequence[Effect], robot: Robot) -> tuple[Pulling, ...]:
    """Return the loads that effects put on links."""
    return tuple(
        Pulling(
            link_of(effect.location.site, robot),
            cast(LoadLaw, effect.law),
            resolve(effect.location, robot, ()),
            effect.amplitudes,
            effect.inner,
        )
        for effect in effects
        if effect.law.act is Act.LOAD and not effect.law.changes_model
    )
