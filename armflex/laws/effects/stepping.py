"""Recursions over the rows in the order driven, compiled by numba when they are first needed."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from armflex.conventions import Array


@cache
def stepper(recursion: Callable[..., Array]) -> Callable[..., Array]:
    """Return a recursion compiled; as it is where numba finds no place to keep its code."""
    import numba  # half a second that not every command needs

    try:
        return numba.njit(cache=True)(recursion)
    except RuntimeError:
        return recursion


def lag_behind(values: Array, ahead: Array, decay: Array) -> Array:
    """Return (N,) what lags behind (N,) values in the order of time, in equilibrium at the first.

    Args:
        values: (N,) values, straight between rows.
        ahead: (N - 1,) their rise within the lag, from each row to the next.
        decay: (N - 1,) what is left over that time of being off; NaN where no time passes.
    """
    state = np.empty(len(values))
    if len(values):
        state[0] = values[0]
    for i in range(1, len(values)):
        left = decay[i - 1]
        if np.isnan(left):
            state[i] = state[i - 1]
        else:
            state[i] = values[i] - ahead[i - 1] + (state[i - 1] - values[i - 1] + ahead[i - 1]) * left
    return state


def play_in(load: Array, radius: float) -> Array:
    """Return the (N,) play operator of a (N,) load: what it drags along once it is a radius away."""
    found, state = np.empty(len(load)), 0.0
    for i in range(len(load)):
        if load[i] - radius > state:
            state = load[i] - radius
        if load[i] + radius < state:
            state = load[i] + radius
        found[i] = state
    return found
