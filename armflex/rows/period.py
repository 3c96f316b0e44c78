"""When campaigns were: effects of time hold for the clock of theirs, and rows of another day have another one."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

from armflex.errors import InputError

TICK = 1e-3
"""Tolerance: to which dates and moments are compared [s]."""


@dataclass(frozen=True)
class Period:
    """When a campaign was.

    Attributes:
        campaign: Name of its file, '' where it is of none.
        sha256: Of the file, '' likewise.
        first, last: Its first and its last moment, as its column `time` has them [s].
        begins: The date at which that is 0, ISO 8601; '' where no date is known.
        later: By how much the clock of the arm that was fitted to it is ahead of its own [s]: campaigns that are fitted
            together go on one after the other.
    """

    campaign: str
    sha256: str
    first: float
    last: float
    begins: str = ""
    later: float = 0.0

    @property
    def date(self) -> datetime | None:
        """The date at which its time is 0."""
        return datetime.fromisoformat(self.begins) if self.begins else None

    def at(self, seconds: float) -> str:
        """Return a moment of its clock in words: its date where it has one."""
        date = self.date
        return f"{seconds:g} s" if date is None else (date + timedelta(seconds=seconds)).isoformat(" ", "seconds")

    def since(self, begins: str) -> float | None:
        """Return how long after its time 0 a date is [s], None where it has no date or `begins` is none.

        Raises:
            InputError: Only one of the two says how far it is from UTC.
        """
        date = self.date
        if date is None or not begins:
            return None
        other = datetime.fromisoformat(begins)
        if (date.tzinfo is None) != (other.tzinfo is None):
            aware, naive = ("the campaign's", "the rows'") if date.tzinfo else ("the rows'", "the campaign's")
            raise InputError(f"{aware} dates in column 'time' say how far they are from UTC, {naive} do not")
        return (other - date).total_seconds()

    def is_that_of(self, other: Period) -> bool:
        """Return whether another one is of the same file, whatever clock it was fitted on."""
        return bool(self.sha256) and self.sha256 == other.sha256
