"""What learning a joint deformation model gives, whatever the model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from armflex.conventions import Array
from armflex.laws.law import Law


@dataclass(frozen=True)
class Diagnostics:
    """How far a sampler can be trusted, judged on predictions and the noise; None where nothing was sampled.

    Attributes:
        rhat_max: Largest split R-hat.
        ess_min: Smallest bulk effective sample size.
        divergences: Transitions that a Hamiltonian sampler lost.
        acceptance: Share of proposals accepted.
        seconds: Time spent on sampling.
    """

    rhat_max: float | None = None
    ess_min: float | None = None
    divergences: int | None = None
    acceptance: float | None = None
    seconds: float | None = None


@dataclass(frozen=True)
class Fitted:
    """A learned law.

    Attributes:
        law: Answers loads in SI with twists in SI; knows the loads it was trained on.
        parameters: What was found, by name, for people and JSON.
        diagnostics: Of the sampler, if one ran.
    """

    law: Law
    parameters: Mapping[str, Any]
    diagnostics: Diagnostics = field(default_factory=Diagnostics)


Learner = Callable[[Array, Array, int], Fitted]
"""(N, k) loads [N, Nm], (N, k) deflections [m, rad], seed -> what was learned; k = 3 or 6. Raises InputError."""
