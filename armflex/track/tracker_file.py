"""Everything that a tracker has learnt from its readings: what a file must hold for it to go on."""

from __future__ import annotations

from dataclasses import dataclass, field

from armflex.conventions import Array
from armflex.track.estimate import Estimate
from armflex.track.watch import Anchor, Change, Watch


@dataclass
class State:
    """What changes from reading to reading.

    Attributes:
        estimate: Of all parameters, as steps from `point`; see `Model.at`.
        point: (P,) values at which the arm is linearised.
        watch: The last readings.
        count: How many readings were taken in.
        outliers: How many of them counted less than in full.
        session: The session that the last one was of.
        time: When that was [s].
        timed: Whether readings have times, None before the first.
        clock: Time that drift goes by, in seconds or readings.
        drifted: Clock up to which drift is in the estimate.
        waiting: Readings since then.
        patience: How long drift may wait.
        q: Joint positions of the last one, None before the first.
        approach: Direction that each joint last moved in: -1 or 1, 0 where it has not.
        changes: What was announced.
    """

    estimate: Estimate
    point: Array
    watch: Watch
    count: int = 0
    outliers: int = 0
    session: str | None = None
    time: float | None = None
    timed: bool | None = None
    clock: float = 0.0
    drifted: float = 0.0
    waiting: int = 0
    patience: float = 0.0
    q: list[float] | None = None
    approach: list[float] | None = None
    changes: list[Change] = field(default_factory=list)

    @property
    def now(self) -> Anchor:
        """The estimate as it is, to go back to."""
        return Anchor(self.estimate, self.count, self.drifted)


def begun(estimate: Estimate, point: Array) -> State:
    """Return the state before the first reading, with the arm linearised at (P,) values."""
    start = Anchor(estimate, 0, 0.0)
    return State(estimate, point, Watch(start, start))
