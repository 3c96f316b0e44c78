"""Laws and effects as sums of terms: the data form in which a controller's C reaches them.

    twist = sum of along * factor(column) * factor(column) * number(load)

A number is what `term_at` of `arm.c` makes of a load w: of its part u . w, or of a form w' Q w. What is scaled, or
carried to another place, stays of this form.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from armflex.conventions import TWIST_NAMES, Array
from armflex.errors import UnsupportedError
from armflex.laws.effects.in_arm import BoundTwist
from armflex.laws.effects.location import Here
from armflex.laws.effects.shapes import PAIRS, lagged_name
from armflex.laws.effects.telescope import WAYS, beam, lengths
from armflex.laws.effects.tool_shift import ALWAYS
from armflex.laws.effects.unnamed import KNOTS
from armflex.laws.joint.carried import AtNode, Carried, ScaledLaw
from armflex.laws.joint.hardening import HardeningLaw
from armflex.laws.joint.log_compliance import LogCompliance
from armflex.laws.joint.polynomial import FEATURES, PolynomialLaw
from armflex.laws.joint.position_dependent import PositionDependentLaw
from armflex.laws.law import Law, Row
from armflex.laws.learned.correction import Correction, NetworkCorrection, PolynomialCorrection
from armflex.laws.learned.learned_law import LearnedLaw
from armflex.laws.learned.seen import Seen

UNITS = np.eye(6)

CLOSE = 1e-13
"""Relative error of a compliance as a polynomial in a joint's position; more degrees than these are not tried."""
DEGREES = (8, 16, 32, 64)


@dataclass(frozen=True)
class Factor:
    """A function of a column; `kind` and numbers are those of `factor_at` in `arm.c`."""

    kind: str
    column: str
    numbers: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Term:
    """A part of a law; see the head of this module.

    Attributes:
        along: (6,) twist [m, rad], the flexure's axes.
        kind: Of the number, as of `term_at` in `arm.c`.
        u: (6,) part of the load.
        form: (6, 6) form of it, None where none counts.
        bias: Of a neuron.
        factors: Two at most.
        window: Loads under which a learned correction counts, None where all do.
    """

    along: Array
    kind: str = "UNLOADED"
    u: Array = field(default_factory=lambda: np.zeros(6))
    form: Array | None = None
    bias: float = 0.0
    factors: tuple[Factor, ...] = ()
    window: Seen | None = None

    @property
    def straight(self) -> bool:
        """Whether it is linear in the load."""
        return self.kind in ("UNLOADED", "ALONG") and self.window is None

    def times(self, number: float | Array, *factors: Factor) -> Term:
        """Return the term with its twist multiplied, and further factors; more than two cannot be said."""
        if len(self.factors) + len(factors) > 2:
            raise UnsupportedError("depends on more than two columns at once")
        return replace(self, along=self.along * number, factors=self.factors + factors)

    def carried(self, action: Array) -> Term:
        """Return the term of the law `action @ law(action.T @ w)`."""
        form, window = self.form, self.window
        if form is not None:
            form = action @ form @ action.T
        if window is not None:
            energy = None if window.energy is None else action @ window.energy @ action.T
            mean, precision = np.linalg.solve(action.T, window.mean), action @ window.precision @ action.T
            window = replace(window, mean=mean, precision=precision, energy=energy)
        return replace(self, along=action @ self.along, u=action @ self.u, form=form, window=window)


Terms = list[Term]


def terms_of(law: Law) -> Terms:
    """Return the terms of a law, or of an effect at its place.

    Raises:
        UnsupportedError: It has none; the text says why, as what follows its name.
    """
    if law.constant is not None:
        return straight(law.constant)
    found = LAWS.get(type(law))
    if found is not None:
        return found(law)
    network = law.neurons()
    if network is None:
        raise UnsupportedError(f"is a {type(law).__name__}, which has no form in C")
    units, bias, gains, constant = network
    return _network(np.pad(units.T, [(0, 0), (0, 6 - len(constant))]), bias, gains, constant)


def straight(compliance: Array, *factors: Factor) -> Terms:
    """Return the terms of a (6, 6) compliance."""
    columns = zip(compliance.T, UNITS, strict=True)
    return [Term(column, "ALONG", unit, factors=factors) for column, unit in columns if column.any()]


def _network(units: Array, bias: Array, gains: Array, constant: Array) -> Terms:
    """Return `gains.T @ tanh(units @ w + bias) + constant`: (H, 6), (H,), (H, k), (k,)."""
    rest = ((0, 6 - gains.shape[1]),)
    neurons = zip(np.pad(gains, ((0, 0), *rest)), units, bias.tolist(), strict=True)
    return [*(Term(gain, "NEURON", unit, bias=own) for gain, unit, own in neurons), Term(np.pad(constant, rest))]


def _features(names: Sequence[str], coefficients: Array, scale: Array) -> Terms:
    """Return features of `scale * w` times (P, 6) coefficients; see `polynomial.FEATURES`."""
    unit = {name: scale[i] * UNITS[i] for i, name in enumerate(FEATURES[:6])}
    lengths = {"radial_force": 2, "radial_moment": 2, "magnitude_force": 3, "magnitude_moment": 3}
    found = []
    for name, along in zip(names, coefficients, strict=True):
        if name in unit:
            found.append(Term(along, "ALONG", unit[name]))
        elif name in lengths:
            first = 3 * name.endswith("moment")
            counts = (np.arange(6) >= first) & (np.arange(6) < first + lengths[name])
            found.append(Term(along, "LENGTH", form=np.diag(counts * scale**2)))
        elif "*" in name:
            one, other = name.split("*")
            both = np.outer(unit[one], unit[other])
            found.append(Term(along, "QUADRATIC", form=0.5 * (both + both.T)))
        else:
            kind = "SIZE" if name[0] == "|" else "CUBE" if name.endswith("^3") else "SIGNED_SQUARE"
            found.append(Term(along, kind, unit[name.strip("|").split("|")[0].removesuffix("^3")]))
    return found


def _polynomial(law: PolynomialLaw) -> Terms:
    size = law.coefficients.shape[1]
    return _features(law.features, np.pad(law.coefficients, [(0, 0), (0, 6 - size)]), np.ones(6))


def _polynomial_correction(law: PolynomialCorrection) -> Terms:
    terms = law._map
    return _features([FEATURES[i] for i in terms.places], terms.coefficients, law._inverse)


def _network_correction(law: NetworkCorrection) -> Terms:
    hidden, bias, output = law._weights
    units, gains = np.zeros((len(bias), 6)), law.to_twist @ output
    units[:, law.axes] = hidden / law.typical
    return _network(units, bias, gains.T, -gains @ np.tanh(bias))


def _position_dependent(law: PositionDependentLaw) -> Terms:
    powers = enumerate(law.coefficients)
    return [term for power, part in powers for term in straight(part, *_powers(f"q_{law.joint}", power))]


def _hardening(law: HardeningLaw) -> Terms:
    form = law.compliance / (2.0 * law.energy)
    return [replace(term, kind="HARDENED", form=form) for term in straight(law.compliance)]


def _log_compliance(law: LogCompliance) -> Terms:
    """Return the compliance as a polynomial in the joint's position over its travel, to rounding."""
    joint = law.joint
    assert joint is not None  # otherwise it is constant
    for degree in DEGREES:
        places = np.cos(np.pi * (np.arange(2 * degree) + 0.5) / (2 * degree))
        row = Row((law.middle + law.reach * places)[:, None], {joint: 0})
        wanted = law.compliance(row).reshape(len(places), 36)
        values = np.polynomial.chebyshev.chebvander(places, degree)
        coefficients = np.asarray(np.linalg.lstsq(values, wanted, rcond=None)[0], float)
        if np.abs(values @ coefficients - wanted).max() <= CLOSE * np.abs(wanted).max():
            parts = enumerate(coefficients.reshape(-1, 6, 6))
            numbers = (law.middle, law.reach)
            each = [straight(part, Factor("CHEBYSHEV", f"q_{joint}", (*numbers, float(n)))) for n, part in parts]
            return [term for part in each for term in part]
    raise UnsupportedError(f"bends too much with {joint} for a polynomial of degree {DEGREES[-1]}")


def _carried(law: Carried) -> Terms:
    return [term.carried(law.action) for term in terms_of(law.law)]


def _effect(law: BoundTwist) -> Terms:
    """Return the basis of an effect by its amplitudes."""
    name, here, inner = law.effect.law.name, law.here, law.effect.inner
    known = SHAPES.get(name)
    if known is None:
        raise UnsupportedError(f"is a {name}, which has no form in C")
    pairs = [(value, basis) for value, basis in zip(law.effect.amplitudes, known(law, here, inner), strict=True)]
    return [term.times(value) for value, basis in pairs if value for term in basis]


LAWS: Mapping[type, Callable[..., Terms]] = {
    PolynomialLaw: _polynomial,
    PositionDependentLaw: _position_dependent,
    HardeningLaw: _hardening,
    LogCompliance: _log_compliance,
    ScaledLaw: _carried,
    AtNode: _carried,
    LearnedLaw: lambda law: [term for part in law.parts for term in terms_of(part)],
    Correction: lambda law: [replace(term, window=law.seen) for term in terms_of(law.law)],
    PolynomialCorrection: _polynomial_correction,
    NetworkCorrection: _network_correction,
    BoundTwist: _effect,
}
"""How a law that is neither constant nor a network is said."""


# Effects: for each amplitude the terms that it multiplies.


def _powers(column: str, power: float, above: float = 0.0) -> tuple[Factor, ...]:
    return (Factor("POWER", column, (above, 1.0, float(power))),) if power else ()


def _waves(column: str, number: float) -> tuple[Factor, Factor]:
    return Factor("SINE", column, (number,)), Factor("COSINE", column, (number,))


def _warmth(here: Here, reference: float, lag: float) -> tuple[Factor, ...]:
    name = lagged_name(here.location, (lag,)) if lag > 0.0 else here.location.covariates[0]
    return _powers(name, 1, reference)


def _tents(column: str, low: float, high: float) -> list[Factor]:
    apart = (high - low if high > low else 1.0) / KNOTS
    return [Factor("TENT", column, (low, high, apart, float(i))) for i in range(KNOTS + 1)]


def _way(law: BoundTwist) -> Array:
    """Return the (6,) twist along which an effect acts."""
    way = law.effect.law.direction(law.here, law.effect.inner)
    assert way is not None
    return way


def _constant(law: BoundTwist, *each: Sequence[Factor]) -> list[Terms]:
    """Return one term without load for the factors of every amplitude."""
    return [[Term(_way(law), factors=tuple(factors))] for factors in each]


def _own(here: Here) -> str:
    return f"q_{here.location.place}"


def _backlash(law: BoundTwist, here: Here, inner: Sequence[float]) -> list[Terms]:
    return [[Term(0.5 * here.drive, factors=_powers(f"approach_{here.location.place}", 1))]]


def _friction(law: BoundTwist, here: Here, inner: Sequence[float]) -> list[Terms]:
    side = _powers(f"approach_{here.location.place}", 1)
    return [[Term(here.drive, factors=side)], [Term(here.drive, "SIZE", here.drive, factors=side)]]


def _coupling(law: BoundTwist, here: Here, inner: Sequence[float]) -> list[Terms]:
    one, other = here.direction, UNITS[TWIST_NAMES.index(here.location.partner)]
    return [[Term(one, "ALONG", other), Term(other, "ALONG", one)]]


def _even(law: BoundTwist, here: Here, inner: Sequence[float]) -> list[Terms]:
    way, across = here.direction, 1.0 - here.direction
    forms = (np.diag(across * (np.arange(6) < 3)), np.diag(across * (np.arange(6) >= 3)))
    return [*([Term(way, "LENGTH", form=form)] for form in forms), [Term(way, "QUADRATIC", form=np.outer(way, way))]]


def _deadband(law: BoundTwist, here: Here, inner: Sequence[float]) -> list[Terms]:
    return [[Term(way, "CLIPPED", way / inner[0])] for way in (here.direction, *UNITS[3:])]


def _softening(law: BoundTwist, here: Here, inner: Sequence[float]) -> list[Terms]:
    along = np.abs(here.direction) if here.location.axis else 1.0
    base = [] if here.base_law is None else terms_of(here.base_law)
    return [[term.times(along, *_warmth(here, *inner)) for term in base]]


def _dress_pack(law: BoundTwist, here: Here, inner: Sequence[float]) -> list[Terms]:
    base = [] if here.base_law is None else terms_of(here.base_law)
    if not all(term.straight for term in base):
        raise UnsupportedError("depends on the tangent of a law that is not linear in the load")
    pulled = [replace(term, kind="UNLOADED").times(float(term.u @ here.drive)) for term in base if term.kind == "ALONG"]
    return [[term.times(1.0, *_powers(_own(here), 1)) for term in pulled]]


def _tool_shift(law: BoundTwist, here: Here, inner: Sequence[float]) -> list[Terms]:
    since = () if inner[0] == ALWAYS else (Factor("STEP", "time", (inner[0],)),)
    return [[Term(unit, factors=since)] for unit in UNITS[:3]]


def _product(law: BoundTwist, here: Here, inner: Sequence[float]) -> list[Terms]:
    first, second = here.location.covariates
    tents, other = _tents(first, inner[0], inner[1]), _powers(second, 1, inner[2])
    return _constant(law, *((tent,) for tent in tents[:-1]), *((tent, *other) for tent in tents))


def _wave_product(law: BoundTwist, here: Here, inner: Sequence[float]) -> list[Terms]:
    first, second = here.location.covariates
    waves, other = _waves(first, inner[0]), _powers(second, 1, inner[1])
    return _constant(law, *((wave,) for wave in waves), *((wave, *other) for wave in waves))


def _guide(law: BoundTwist, here: Here, inner: Sequence[float]) -> list[Terms]:
    way, overlap = here.direction, (Factor("OVERLAP", here.location.covariates[0], (inner[1], inner[2])),)
    return [[Term(way, "CLIPPED", way / inner[0], factors=overlap)], [Term(way, "ALONG", way, factors=overlap)]]


def _telescope(law: BoundTwist, here: Here, inner: Sequence[float]) -> list[Terms]:
    """Return the beam's compliance as a polynomial in the joint's position, less what it is where declared."""
    bends, twists = beam(here)
    length = np.polynomial.Polynomial((inner[0], WAYS[here.location.partner]))
    declared = lengths(here, 0.0, tuple(inner))[1]
    parts = np.zeros((4, 4))  # by the power of L, and of q
    for k in range(4):
        parts[k, : k + 1] = (length**k - declared**k).coef

    def of_position(coefficients: Array) -> Terms:
        return [term for n, part in enumerate(coefficients) for term in straight(part, *_powers(_own(here), n))]

    return [of_position(np.einsum("kn,kij->nij", parts, bends)), of_position(np.einsum("n,ij->nij", parts[1], twists))]


def _along(way: Array, *each: Sequence[Factor]) -> list[Terms]:
    """Return a compliance along one axis for the factors of every amplitude."""
    return [[Term(way, "ALONG", way, factors=tuple(factors))] for factors in each]


def _of_units(units: Array) -> list[Terms]:
    return [[Term(unit, "ALONG", unit)] for unit in units]


def _crossed() -> list[Terms]:
    """Return what couples two turning axes, as `shapes.crossed` has it."""
    turns = UNITS[3:]
    return [[Term(turns[i], "ALONG", turns[j]), Term(turns[j], "ALONG", turns[i])] for i, j in PAIRS]


Shape = Callable[[BoundTwist, Here, Sequence[float]], list[Terms]]

SHAPES: Mapping[str, Shape] = {
    "encoder_offset": lambda law, here, inner: _constant(law, ()),
    "encoder_scale": lambda law, here, inner: _constant(law, _powers(_own(here), 1)),
    "encoder_eccentricity": lambda law, here, inner: _constant(law, *((wave,) for wave in _waves(_own(here), 1.0))),
    "gear_harmonic": lambda law, here, inner: _constant(law, *((wave,) for wave in _waves(_own(here), inner[0]))),
    "backlash": _backlash,
    "friction_windup": _friction,
    "hysteresis": lambda law, here, inner: _constant(law, _powers(law.effect.state or "", 1)),
    "compliance": lambda law, here, inner: [*_along(here.direction, ()), *_of_units(UNITS)],
    "cross_coupling": _coupling,
    "stiffening": lambda law, here, inner: [
        [Term(here.direction, kind, here.direction)] for kind in ("SIGNED_SQUARE", "CUBE")
    ],
    "deadband": _deadband,
    "even_in_load": _even,
    "position_dependent_compliance": lambda law, here, inner: _along(
        here.direction, *(_powers(_own(here), power) for power in (1, 2))
    ),
    "thermal_softening": _softening,
    "creep": lambda law, here, inner: _along(here.direction, (Factor("CREEP", "hold", (inner[0],)),)),
    "slip_step": lambda law, here, inner: _constant(law, (Factor("STEP", "time", (inner[0],)),)),
    "dress_pack": _dress_pack,
    "base_compliance": lambda law, here, inner: [
        [term for part in _of_units(UNITS[3:]) for term in part],
        *_of_units(UNITS[3:]),
        *_crossed(),
    ],
    "base_thermal": lambda law, here, inner: [[Term(unit, factors=_warmth(here, *inner))] for unit in UNITS],
    "base_drift": lambda law, here, inner: [[Term(unit, factors=_powers("time", 1))] for unit in UNITS],
    "tool_shift": _tool_shift,
    "thermal_growth": lambda law, here, inner: _constant(law, _warmth(here, *inner)),
    "thermal_bending": lambda law, here, inner: _constant(law, _warmth(here, *inner[1:])),
    "link_flexure": lambda law, here, inner: [*_of_units(UNITS), *_crossed()],
    "link_geometry": lambda law, here, inner: [[Term(unit)] for unit in UNITS],
    "unnamed_guide": _guide,
    "unnamed_telescope": _telescope,
    "unnamed_level": lambda law, here, inner: _constant(law, _powers(here.location.covariates[0], 1)),
    "unnamed_line": lambda law, here, inner: _constant(
        law, *(_powers(here.location.covariates[0], power, inner[0]) for power in (1, 2))
    ),
    "unnamed_wave": lambda law, here, inner: _constant(
        law, *((wave,) for wave in _waves(here.location.covariates[0], inner[0]))
    ),
    "unnamed_bump": lambda law, here, inner: _constant(
        law, (Factor("BUMP", here.location.covariates[0], tuple(inner)),)
    ),
    "unnamed_shape": lambda law, here, inner: _constant(
        law, *((tent,) for tent in _tents(here.location.covariates[0], *inner)[:-1])
    ),
    "unnamed_compliance": lambda law, here, inner: _along(
        here.direction, *((tent,) for tent in _tents(here.location.covariates[0], *inner)[:-1])
    ),
    "unnamed_product": _product,
    "unnamed_wave_product": _wave_product,
}
"""Effects that are twists, by the name of their law."""
