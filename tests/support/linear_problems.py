"""Linear problems of a few columns, as hypotheses that compete."""

import numpy as np

from armflex.laws.effects.backlash import BACKLASH
from armflex.laws.effects.base_compliance import BASE_COMPLIANCE
from armflex.laws.effects.candidate import Candidate
from armflex.laws.effects.location import Location
from armflex.trace.hypotheses import Hypothesis
from armflex.trace.projection import Projection
from armflex.trace.screen import Dense
from armflex.trace.selection import Group, prior_of


def problem(
    columns: np.ndarray, readings: np.ndarray, priors: np.ndarray | None = None, signed: int = -1, size: int = 1
) -> Dense:
    """Return columns as hypotheses of `size` amplitudes; `signed` is the number of one that must be positive."""
    groups = []
    for i in range(columns.shape[1] // size):
        law, term = (BASE_COMPLIANCE, 0) if i == signed else (BACKLASH, 0)
        candidate = Candidate(law, Location(f"J{i}", "rz", (), (term,)), ())
        prior = np.log(0.1) if priors is None else float(priors[i])
        groups.append(Group(Hypothesis(candidate, prior), size * i, np.ones(size)))
    return Dense(groups, columns, of_readings(readings), prior_of(groups))


def of_readings(readings: np.ndarray) -> Projection:
    """Return readings to which nothing else is fitted."""
    return Projection(np.empty((len(readings), 0)), np.empty(0), readings, len(readings))
