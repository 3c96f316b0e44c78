"""What a campaign taught about the law of each flexure that it was to learn, in numbers that people ask for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from armflex.conventions import TWIST_NAMES
from armflex.estimate.fit import Fit
from armflex.estimate.sample import LawSamples
from armflex.laws.learned import LearnedLaw

TOLD = 0.5
"""Part of the declared law's uncertainty that must be gone for an axis to count as told by the readings."""


@dataclass(frozen=True, eq=False)
class LearnedAxis:
    """One axis of a learned law over the loads of the campaign; RMS over its rows [m or rad].

    Attributes:
        flexure, axis: Which.
        declared: Twist of the law as declared.
        learned: Twist of the law as learned.
        change: What was learned, learned minus declared.
        correction: The part of it that no compliance can express.
        std: Standard uncertainty of the learned twist.
        before: The same of the law as declared, by what was expected of its parameters before the campaign.
        sampled: Standard deviation of the twist among sampled laws, None where none were.
    """

    flexure: str
    axis: str
    declared: float
    learned: float
    change: float
    correction: float
    std: float
    before: float
    sampled: float | None = None

    @property
    def told(self) -> bool:
        """Whether the readings say anything about it; else its prior holds it."""
        return self.std < TOLD * self.before


def learned_axes(fit: Fit, laws: Mapping[str, LearnedLaw], samples: LawSamples | None) -> tuple[LearnedAxis, ...]:
    """Return every axis of every learned law that gives at all.

    Args:
        fit: The fit.
        laws: The laws with the covariance of their values, by flexure.
        samples: Sampled laws, None where none were drawn.
    """
    line, names, found = fit.view.line, fit.setup.arm.flexure_names, []
    for name, law in laws.items():
        loads, row, start = line.flexure_wrenches[:, names.index(name)], line.row, law.at(law.start)
        declared, learned = start.twist(loads, row), law.twist(loads, row)
        correction = np.zeros_like(loads) if law.correction is None else law.correction.twist(loads, row)
        assert law.posterior is not None
        expected = np.diag([one.prior**2 for one in law.expected])
        std, before = law.std(law.posterior, loads, row), start.std(expected, loads, row)
        drawn = [] if samples is None else [samples.twists(name, loads, row).std(axis=0)]
        columns = (declared, learned, learned - declared, correction, std, before, *drawn)
        rms = np.sqrt([(values**2).mean(axis=0) for values in columns])
        for i, axis in enumerate(TWIST_NAMES):
            if rms[0, i] > 0.0:
                found.append(LearnedAxis(name, axis, *rms[:, i].tolist()))
    return tuple(found)
