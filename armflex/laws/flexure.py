"""A flexure: a place where the arm gives, and the law by which it does."""

from __future__ import annotations

from dataclasses import dataclass

from armflex.laws import Law
from armflex.laws.learned import LearnedLaw, Learning
from armflex.robot import Site


@dataclass(frozen=True)
class Flexure:
    """A place where the arm gives: outboard of `joint`'s motion, or at the base when `joint` is None.

    With `before` it is the end of the link that the joint ends, inboard of the joint's motion. `learn` says what of its
    law `calibrate` finds from measurements of the whole arm, None for nothing.
    """

    name: str
    joint: str | None
    law: Law
    before: bool = False
    learn: Learning | None = None

    @property
    def learned(self) -> LearnedLaw | None:
        """Its law, where that is one with parameters that a campaign taught or is to teach."""
        return self.law if isinstance(self.law, LearnedLaw) else None

    @property
    def site(self) -> Site:
        """The same place as a model of the arm names it."""
        return Site(self.name, self.joint, self.before)
