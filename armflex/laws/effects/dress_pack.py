"""A dress pack that pulls at a joint: the declared compliance times k (q - q0); q0 is an encoder offset."""

import numpy as np

from armflex.conventions import Array
from armflex.errors import UnsupportedError
from armflex.laws import Row
from armflex.laws.effects.effect import Amplitude, Plausible, TwistLaw, Values, Words
from armflex.laws.effects.location import Here
from armflex.laws.effects.shapes import at_drives, own_column
from armflex.laws.terms import Term, powers


def _basis(here: Here, wrench: Array, row: Row, inner: Values) -> Array:
    if here.base_law is None:
        return np.zeros((*wrench.shape[:-1], 1, 6))
    given = here.base_law.tangent(wrench, row) @ here.drive
    return (row.position(here.location.place)[..., None] * given)[..., None, :]


def _terms(here: Here, inner: Values) -> list[list[Term]]:
    base = () if here.base_law is None else here.base_law.terms()
    if not all(isinstance(term, Term) and term.linear for term in base):
        raise UnsupportedError("depends on the tangent of a law that is not linear in the load")
    turned = [
        (term.matrix @ here.drive, term.factors) for term in base if isinstance(term, Term) and term.matrix is not None
    ]
    return [[Term(way, factors=factors).times(1.0, *powers(own_column(here), 1)) for way, factors in turned]]


DRESS_PACK = TwistLaw(
    name="dress_pack",
    words=Words("dress pack pull", "cables turn the joint as it moves", "C · k (q − q₀)"),
    instead="repeat a few poses with the dress pack untied",
    plausible=Plausible(0.002, 0.005, "hoses pull with 10 to 200 Nm over the range of a joint"),
    places=lambda records: at_drives(records, "q_{joint}"),
    amplitudes=(Amplitude("k", "{w}/{m}", usual=200.0),),
    terms=_terms,
    basis=_basis,
)
