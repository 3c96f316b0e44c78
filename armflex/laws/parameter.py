"""A parameter of a law: what it is called, in which unit, and how well it is known."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Transform(Enum):
    """How a parameter's value, which fits and draws move, stands for the number that is meant."""

    IDENTITY = "identity"
    """The value is the number."""
    LOG = "log"
    """The value is the logarithm of a number that stays positive, or of a factor on one."""


@dataclass(frozen=True)
class Parameter:
    """One number of a law. The object is its identity; text labels are made where files and reports begin.

    Attributes:
        name: Unique within its law, without blanks.
        unit: Of the value; "1" of a logarithm.
        prior: Standard deviation about the value that it has; 0 where it is taken as known.
        transform: What the value stands for.
        group: Parameters of one group are of one size beforehand.
        sized: Whether that size is for the data to tell (by evidence); `prior` is then where the search starts.
    """

    name: str
    unit: str
    prior: float
    transform: Transform = Transform.IDENTITY
    group: str = ""
    sized: bool = False
