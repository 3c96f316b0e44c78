"""Arms that are as likely as one: their laws, and what was fitted to a campaign, drawn from what is known of them."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike

from armflex.arguments import checked_kinds
from armflex.arm import Arm, Setup
from armflex.conventions import Array, covariate_array, real_array, root_of_covariance
from armflex.errors import InputError, ShapeError, UnsupportedError, naming, shown
from armflex.estimate.blocks import blocks_of
from armflex.estimate.posterior import without_declared_uncertainty
from armflex.mechanics.deflection import check_positions
from armflex.mechanics.loaded import Payload
from armflex.mechanics.many_rows import drawn_displacements
from armflex.readings.instrument import Instrument
from armflex.rows.wrench import Wrench


@checked_kinds
def draw_arms(arm: Arm, draws: int, seed: int = 0) -> tuple[Arm, ...]:
    """Return arms drawn from what is known of one.

    On an arm that was calibrated or traced the fitted parameters are drawn together, effects included, by the
    covariance that the fit left; declared uncertainties of fitted laws are contained in it. All other laws are drawn by
    `Law.draw`. Where the instrument stands is no part of the arm. What nothing determines stays as it is, as does what
    remained without a cause, and that by which an effect remembers: the state that is given to it follows from it.

    Args:
        arm: The arm.
        draws: How many.
        seed: Of the random numbers.

    Raises:
        InputError: `draws` or `seed` is no whole number, or below 0.
        UnsupportedError: The arm no longer has every parameter that was fitted.
    """
    draws, seed = check_draws(draws, seed)
    rng = np.random.default_rng(seed)
    setup = Setup(without_declared_uncertainty(arm), Instrument())
    blocks, root = [], np.zeros((0, 0))
    if arm.certainty is not None:
        blocks, root = blocks_of(arm.certainty.parameters, setup), root_of_covariance(arm.certainty.covariance)
        if blocks is None:
            raise UnsupportedError("the arm no longer has every fitted parameter (another preset?): it cannot be drawn")
    ends = np.cumsum([len(block.parameters) for block in blocks])[:-1]
    drawn = []
    for _ in range(draws):
        step, moved = root @ rng.normal(size=root.shape[1]), setup
        for block, part in zip(blocks, np.split(step, ends), strict=False):
            if block.moves:
                moved = block.stepped(moved, part)
        # What carries an uncertainty of its own is drawn, too, and none is left.
        flexures = tuple(replace(flexure, law=flexure.law.draw(rng)) for flexure in moved.arm.flexures)
        drawn.append(replace(moved.arm, flexures=flexures, certainty=None))
    return tuple(drawn)


def check_draws(draws: int, seed: int) -> tuple[int, int]:
    """Return both as whole numbers; raise `InputError` where they are none, negative, or more than can be counted."""
    for name, value in (("draws", draws), ("seed", seed)):
        if not isinstance(value, Integral) or not 0 <= value <= sys.maxsize:
            raise InputError(f"{name} is {shown(value, 60)}, expected a whole number, 0 or more")
    return int(draws), int(seed)


@checked_kinds
def ensemble(
    arm: Arm,
    q: ArrayLike,
    payload: str | Payload | None = None,
    *,
    draws: int = 100,
    seed: int = 0,
    covariates: Mapping[str, ArrayLike] | None = None,
) -> Array:
    """Return the (draws, 6) or (draws, N, 6) displacements of the tip, each draw with one set of laws in all rows.

    Laws are drawn by `Law.draw`: compliances by their relative uncertainty or their fit's covariance, networks from
    their posterior. On an arm that was calibrated or traced what was fitted is drawn
    as well, see `draw_arms`; each draw is then an arm of its own, and takes as long, also where an effect pulls at a
    link.

    Args:
        arm: The arm.
        q: (nq,) or (N, nq) joint positions [rad or m], within their limits.
        payload: Name or object.
        draws: How many.
        seed: Of the random numbers; the same laws are drawn for any q.
        covariates: What the arm's effects depend on: a number, or one per row.

    Raises:
        InputError: As `Arm.deflection`; also where a draw has no equilibrium.
        UnsupportedError: A draw has no equilibrium that is proven stable, or see `draw_arms`.
    """
    draws, seed = check_draws(draws, seed)
    arm.loaded(payload)  # what is wrong with it is no draw's fault
    positions = real_array(q, "q")
    if positions.ndim not in (1, 2):
        raise ShapeError(f"q: expected shape (nq,) or (N, nq), got {positions.shape}")
    rows = check_positions(arm, np.atleast_2d(positions), enforce_limits=True)
    count = len(rows) if positions.ndim == 2 else 0
    columns = {name: covariate_array(values, name, count) for name, values in (covariates or {}).items()}
    if arm.certainty is None and not (arm.pulls or arm.loaded(None).tied):
        displacements = drawn_displacements(arm, rows, payload, columns, draws, seed)
    else:  # one after the other
        displacements = np.empty((draws, len(rows), 6))
        for number, drawn in enumerate(draw_arms(arm, draws, seed)):
            with naming(f"draw {number}"):
                displacements[number] = drawn.deflection(rows, payload, covariates=columns).displacement
    return displacements if positions.ndim == 2 else displacements[:, 0]


@checked_kinds
def drawn_frequencies(
    arm: Arm,
    q: ArrayLike,
    payload: str | Payload | None = None,
    *,
    draws: int = 64,
    seed: int = 0,
    covariates: Mapping[str, ArrayLike] | None = None,
    wrenches: Sequence[Wrench] = (),
    count: int = 6,
) -> Array | None:
    """Return the (draws, m) natural frequencies [Hz] of arms as likely as one; None where nothing of it is uncertain.

    Frequencies of a draw are in ascending order: where two modes are closer than they are known, they change places.

    Args:
        arm: The arm.
        q: (nq,) joint positions [rad or m].
        payload, covariates, wrenches, count: As of `Arm.modes`.
        draws: How many arms.
        seed: Of the random numbers.

    Raises:
        InputError: As `Arm.modes` and `draw_arms`.
    """
    if arm.certainty is None and not any(flexure.law.uncertain for flexure in arm.flexures):
        return None
    frequencies, at = list[Array](), real_array(q, "q")
    for number, drawn in enumerate(draw_arms(arm, draws, seed)):
        with naming(f"draw {number}"):
            frequencies.append(
                drawn.modes(at, payload, covariates=covariates, wrenches=wrenches, count=count).frequencies
            )
    fewest = min(map(len, frequencies), default=0)
    return np.array([drawn[:fewest] for drawn in frequencies]).reshape(len(frequencies), fewest)
