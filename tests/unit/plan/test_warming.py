"""Lengths that change with time are those of an arm that warms up: a temperature is asked for."""

from dataclasses import dataclass

from armflex.laws.effects.location import Location
from armflex.plan.next_measurement import warming


@dataclass(frozen=True)
class Named:
    location: Location


def test_links_that_grow_with_time_ask_for_a_temperature() -> None:
    growing = [Named(Location("J2", "dz", ("time",))), Named(Location("J4", "dx", ("time",)))]
    (said,) = warming(growing, ("E1",))  # pyright: ignore[reportArgumentType] - what it needs of an effect
    assert "J2, J4" in said and "temperature" in said
    assert warming(growing, ("temp_J2",)) == ()  # pyright: ignore[reportArgumentType] - likewise
    assert warming(growing[:1], ()) == ()  # pyright: ignore[reportArgumentType] - likewise
    assert warming([Named(Location("J2", "rz", ("time",)))] * 2, ()) == ()  # pyright: ignore[reportArgumentType]
