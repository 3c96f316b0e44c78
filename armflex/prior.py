"""What an arm.toml says about measuring and calibrating the arm."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Measurement:
    """The instrument: `frame` is "base" or "unknown", `gravity_in` is "base" or "measurement"."""

    frame: str = "unknown"
    gravity_in: str = "base"


@dataclass(frozen=True)
class Prior:
    """One standard deviation of what calibration may move; 0 keeps it fixed.

    Attributes:
        joint_offset: Every joint [rad or m].
        compliance: Every declared linear compliance, relative.
        tool: The target's place in the tip frame [m].
        geometry: Every fixed transform of the chain [m and rad].
        session_target: The target's place in the tip frame between sessions, in each of which it was mounted anew [m].
        session_translation: Instrument frame between sessions [m].
        session_rotation: Instrument frame between sessions [rad].
    """

    joint_offset: float = 0.0
    compliance: float = 0.0
    tool: float = 0.0
    geometry: float = 0.0
    session_target: float = 0.0
    session_translation: float = 0.0
    session_rotation: float = 0.0
