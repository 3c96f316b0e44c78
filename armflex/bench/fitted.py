"""What learning a joint deformation model gives, whatever the model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from armflex.conventions import Array
from armflex.laws.law import Law
from armflex.sampling.diagnostics import Diagnostics


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
