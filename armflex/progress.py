"""What long work says while it goes on: how much is done; or which stage it is at, how far in it, and what it has."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from armflex.conventions import said_of

Progress = Callable[[int, int], None]
"""Called with how many pieces of work are done, and of how many."""


@dataclass(frozen=True)
class Doing:
    """What a search is at, and what it has.

    Attributes:
        stage: In words.
        trying: What is tried within it, '' where nothing is said.
        done, total: How many were tried, and of how many; 0 where that is unknown.
        effects: Those accepted so far, in words.
        rms: RMS of the 3-D error of the fitted rows with them [m], None before the first fit.
        unit: In which it is, where it is not m.
    """

    stage: str = ""
    trying: str = ""
    done: int = 0
    total: int = 0
    effects: tuple[str, ...] = ()
    rms: float | None = None
    unit: str = "m"

    def __str__(self) -> str:
        count = f"{self.done} of {self.total}" if self.total else ""
        within = ", ".join(part for part in (self.trying, count) if part)
        text = ": ".join(part for part in (self.stage, within) if part)
        if self.rms is None:
            return text
        effects = f"{len(self.effects)} effect{'' if len(self.effects) == 1 else 's'}"
        return f"{text} [{effects}; RMS {said_of(self.rms, self.unit)}]"


MOST_MINUTES = 10.0
"""Tolerance: CPU time of a search [min]: three campaigns of 24 effects traced together take half of it."""


EVERY = 0.1
"""Tolerance: seconds within which the CPU clock is read once; some systems take a millisecond to read it."""


class OutOfTimeError(KeyboardInterrupt):
    """The CPU time has passed that a search may take: it ends wherever it is, as after Ctrl-C."""


class Reporter:
    """Hands on what a search is at; it costs a call, so that the innermost loops may say it.

    Attributes:
        report: Called with what is being done, in words, once for every stage.
        progress: Called with all of it, often.
        until: CPU time of this process [s] after which whatever is said next ends with `OutOfTimeError`.
    """

    def __init__(
        self, report: Callable[[str], None] | None = None, progress: Callable[[Doing], None] | None = None
    ) -> None:
        self.report, self.progress, self.doing, self.until = report, progress, Doing(), float("inf")
        self._look = 0.0

    def limit(self, seconds: float) -> None:
        """Let what goes on take so many seconds of CPU time from now on."""
        self.until, self._look = time.process_time() + seconds, 0.0

    def stage(self, text: str) -> None:
        """Say that a stage begins."""
        if self.report:
            self.report(text)
        self.say(stage=text, trying="", done=0, total=0)

    def step(self, trying: str, done: int, total: int) -> None:
        """Say within a stage what is tried, how many were, and of how many."""
        self.say(trying=trying, done=done, total=total)

    def steps(self, done: int, most: int) -> None:
        """Say how many steps a fit has taken, which ends long before it has taken as many as it may."""
        self.step(f"step {done}", 0, 0)

    def say(self, **changed: Any) -> None:
        """Say what has changed of what it is at, or of what there is so far."""
        if (now := time.monotonic()) >= self._look:
            if (left := self.until - time.process_time()) < 0.0:
                raise OutOfTimeError
            self._look = now + min(left, EVERY)
        if self.progress:
            self.doing = replace(self.doing, **changed)
            self.progress(self.doing)


SILENT = Reporter()
"""Nobody listens."""
