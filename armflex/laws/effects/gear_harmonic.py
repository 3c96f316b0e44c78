"""Transmission error of a gear: A sin kq + B cos kq, k of 2 or more to be found."""

from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import Amplitude, Effect, Inner, Manipulator, Plausible, TwistLaw, Words
from armflex.laws.effects.location import Location, with_terms
from armflex.laws.effects.shapes import at_drives, free_of_aliases, on_drive, own_column, twists
from armflex.laws.terms import waves


def _orders(location: Location, context: Context) -> Iterable[float]:
    """Return wave numbers a third of a period over the driven range apart, from two per turn (or per range) on."""
    return _numbers(context.row.position(location.place).tobytes(), str(location.axis).startswith("r"))


@lru_cache(64)
def _numbers(column: bytes, turns: bool) -> list[float]:
    """Return those that (N,) positions distinguish from their aliases; it is asked for in every linear problem."""
    position = np.frombuffer(column)
    span = float(np.ptp(position)) or 1.0
    least = 2.0 if turns else np.pi / span
    # Periods over a joint's driven range beyond which a campaign of some hundred poses determines none.
    numbers = np.arange(least, max(least, 2.0 * np.pi * 24.0 / span), 2.0 * np.pi / span / 3.0)
    return [number for number in numbers.tolist() if free_of_aliases(position, number)]


def _determined(effect: Effect, context: Context, arm: Manipulator) -> bool:
    return free_of_aliases(context.row.position(effect.location.place), effect.inner[0])


GEAR_HARMONIC = TwistLaw(
    name="gear_harmonic",
    words=Words("gear harmonic", "the error goes k times round with the joint", "A sin kq + B cos kq"),
    instead="measure through one turn of the joint's motor in twenty steps",
    plausible=Plausible(0.0005, 0.002, "gears are made to 0.3 to 5 arcmin, racks and screws to tenths of a mm"),
    places=lambda records: with_terms(at_drives(records, "q_{joint}"), (0, 1)),
    amplitudes=(Amplitude("A", "{m}"), Amplitude("B", "{m}")),
    terms=lambda here, inner: twists(here.drive, *([wave] for wave in waves(own_column(here), inner[0]))),
    direction=on_drive,
    inner=(Inner("k", "1", _orders),),
    possible=_determined,
)
