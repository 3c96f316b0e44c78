"""Polynomial law: twist linear in coefficients over named features of the load, among them some even in the load.

A bearing or a contact gives the same way whichever way it is pushed; a compliance cannot, a term in |F| can.
No feature is constant: no load, no deflection.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import TWIST_NAMES, WRENCH_NAMES, Array
from armflex.errors import LawError, UnknownNameError, did_you_mean, listing
from armflex.laws.law import Law, Parameter, Row, block_diagonal, check_ordered, embed
from armflex.laws.terms import UNITS, Curve, Term, Terms, part, power
from armflex.storage.schema import Numbers, check_arrays, check_shapes

_NORMS = {
    **{f"|{name}|": (i,) for i, name in enumerate(WRENCH_NAMES)},
    "radial_force": (0, 1),
    "radial_moment": (3, 4),
    "magnitude_force": (0, 1, 2),
    "magnitude_moment": (3, 4, 5),
}
"""Feature -> the components whose root of squares it is."""

_PAIRS = [(i, j) for i in range(6) for j in range(i, 6)]

FEATURES = (
    *(*WRENCH_NAMES, *_NORMS, *(f"{WRENCH_NAMES[i]}*{WRENCH_NAMES[j]}" for i, j in _PAIRS)),
    *(*(f"{name}|{name}|" for name in WRENCH_NAMES), *(f"{name}^3" for name in WRENCH_NAMES)),
)
"""Every feature: components, roots of squares, products, and two odd powers of each component.

Files hold places in this tuple: append, never reorder.
"""

_MEMBERS = (*((i,) for i in range(6)), *_NORMS.values(), *_PAIRS, *((i,) for i in range(6)), *((i,) for i in range(6)))

ARRAYS = {
    "features": Numbers(("features",), least=0.0, most=len(FEATURES) - 1.0),
    "coefficients": Numbers(("features", "k")),
    "row_covariance": Numbers(("k", "features", "features"), covariance=True),
    "residual_std": Numbers(("k",), least=0.0),
    "loads": Numbers((2, "k")),
}
SIZES = {"k": (3, 6), "features": range(1, len(FEATURES) + 1)}

_MASKS = np.array([[float(i in members) for i in range(6)] for members in _NORMS.values()])
_FIRST, _SECOND = np.array(_PAIRS).T
_PRODUCT = np.eye(6)[_FIRST][:, :, None] * np.eye(6)[_SECOND][:, None, :]
_PRODUCT = _PRODUCT + _PRODUCT.swapaxes(1, 2)
"""(21, 6, 6) second derivatives of the products."""


@dataclass(frozen=True)
class PolynomialLaw(Law):
    """twist_k = sum_p coefficients_pk feature_p(wrench).

    Attributes:
        features: P names of `FEATURES`.
        coefficients: (P, k) [m or rad per unit of the feature], k = 3 or 6.
        row_covariance: (k, P, P) covariance of the coefficients of each component of the twist.
        residual_std: (k,) scatter about the fit [m, rad].
        loads: (2, k) smallest and largest load of each component that was seen [N, Nm].

    Raises:
        LawError: Shapes do not fit, a feature is unknown or twice there, or one is of a component that is not there.
    """

    features: tuple[str, ...]
    coefficients: Array
    row_covariance: Array
    residual_std: Array
    loads: Array

    def __post_init__(self) -> None:
        shapes = {name: ("f8", np.shape(getattr(self, name))) for name in ARRAYS}
        try:
            check_shapes(shapes, ARRAYS, SIZES)
        except ValueError as error:
            raise LawError(str(error)) from None
        check_ordered(self.loads)
        if (self.residual_std < 0.0).any():
            raise LawError("a scatter is negative")
        features = _known(self.residual_std.size)
        for name in self.features:
            if name not in features:
                size, hint = self.residual_std.size, did_you_mean(name, features)
                raise LawError(f"{name!r} is no feature of a load of {size} components{hint}")
        if len(set(self.features)) < len(self.features):
            raise LawError(f"a feature is there twice: {listing(self.features)}")

    def twist(self, wrench: Array, row: Row) -> Array:
        return self._map.values(wrench)

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return the (..., 6, 6) derivative; that of a root of squares is taken as zero where the root is zero."""
        return self._map.slopes(wrench)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """A coefficient each, those of one axis together."""
        stds = np.sqrt(self.row_covariance.diagonal(axis1=1, axis2=2))
        units = ["m" if axis < 3 else "rad" for axis in range(len(stds))]
        return tuple(
            Parameter(f"{TWIST_NAMES[axis]}:{name}", f"{units[axis]}/{_unit(name)}", float(std))
            for axis, axis_stds in enumerate(stds)
            for name, std in zip(self.features, axis_stds, strict=True)
        )

    @property
    def values(self) -> Array:
        """Coefficients, those of one axis together."""
        return self.coefficients.T.ravel()

    def at(self, values: Array) -> PolynomialLaw:
        return replace(self, coefficients=np.ascontiguousarray(np.reshape(values, self.coefficients.T.shape).T))

    @property
    def values_covariance(self) -> Array:
        """That of every axis by itself."""
        return block_diagonal(*self.row_covariance)

    def certain(self) -> PolynomialLaw:
        return replace(self, row_covariance=np.zeros_like(self.row_covariance))

    def by_values(self, wrench: Array, row: Row) -> Array:
        """Return the features, at the axis that each moves."""
        values, size = feature_values(wrench)[..., self._map.places], self.residual_std.size
        by_coefficient = np.zeros((*wrench.shape, size, len(self.features)))
        by_coefficient[..., range(size), range(size), :] = values[..., None, :]
        return by_coefficient.reshape(*wrench.shape, -1)

    def scatter(self, wrench: Array, row: Row) -> Array:
        return embed(np.diag(self.residual_std**2))

    def terms(self) -> Terms:
        """Return a term of every feature."""
        return self._map.terms(np.ones(6))

    @property
    def trained_on(self) -> Array:
        return self.loads

    @cached_property
    def _map(self) -> FeatureMap:
        padded = np.pad(self.coefficients, [(0, 0), (0, 6 - self.residual_std.size)])
        return FeatureMap.of(self.features, padded)


@dataclass(frozen=True, eq=False)
class FeatureMap:
    """A sum of features with vectors of coefficients.

    Attributes:
        places: (P,) of the features in `FEATURES`.
        coefficients: (P, 6).
    """

    places: np.ndarray
    coefficients: Array

    @classmethod
    def of(cls, features: Sequence[str], coefficients: Array) -> FeatureMap:
        """Return the sum of features by name."""
        return cls(np.array([FEATURES.index(name) for name in features], dtype=int), coefficients)

    def values(self, load: Array) -> Array:
        """Return the (..., 6) sum at (..., 6) loads."""
        return feature_values(load)[..., self.places] @ self.coefficients

    def slopes(self, load: Array) -> Array:
        """Return its (..., 6, 6) derivative."""
        linear, masks, roots, curvature, odd = self._parts
        length = np.sqrt((load * load) @ masks.T)
        share = roots.T / np.where(length > 0.0, length, 1.0)[..., None, :]
        total = linear + share @ (masks * load[..., None, :]) + (curvature @ load[..., None, :, None])[..., 0]
        if odd is not None:
            total = total + (odd[0] * np.abs(load)[..., None, :] + odd[1] * np.square(load)[..., None, :])
        return total

    def terms(self, scale: Array) -> list[Term]:
        """Return the sum at loads multiplied by (6,) numbers, as terms."""
        terms = []
        for place, along in zip(self.places.tolist(), self.coefficients, strict=True):
            members, name = list(_MEMBERS[place]), FEATURES[place]
            ways = [part(scale[i] * UNITS[i]) for i in members]
            if name in _NORMS and len(members) == 1:
                features = (replace(ways[0], kind=Curve.SIZE),)
            elif name in _NORMS:
                counts = np.zeros(6)
                counts[members] = 1.0
                features = (power(np.diag(counts * scale**2), 0.5),)
            elif name.endswith("^3"):
                features = (*ways, *ways, *ways)
            elif name.endswith("|"):
                features = (*ways, replace(ways[0], kind=Curve.SIZE))
            else:
                features = tuple(ways)
            if len(features) == 1 and features[0].kind is Curve.PART:
                terms.append(Term(np.zeros(6), np.outer(along, features[0].u)))
            else:
                terms.append(Term(along, features=features))
        return terms

    @cached_property
    def _parts(self) -> tuple[Array, Array, Array, Array, Array | None]:
        """What slopes are made of.

        (6, 6) slope of the components, (r, 6) masks and (r, 6) coefficients of roots, (6, 6, 6) of products, (2, 6, 6)
        of odd powers, None for none.
        """
        whole = np.zeros((len(FEATURES), 6))
        whole[self.places] = self.coefficients
        linear, roots, products, odd = np.split(whole, [6, 6 + len(_NORMS), 6 + len(_NORMS) + len(_PAIRS)])
        used = roots.any(axis=1)
        powers = np.array([2.0, 3.0])[:, None, None] * odd.reshape(2, 6, 6).swapaxes(1, 2)
        curvature = np.tensordot(products, _PRODUCT, axes=(0, 0))
        return linear.T, _MASKS[used], roots[used], curvature, powers if odd.any() else None


def feature_values(wrench: Array) -> Array:
    """Return all (..., 49) features of a (..., 6) wrench, in the order of `FEATURES`."""
    squares = wrench * wrench
    odd = (wrench * np.abs(wrench), wrench * squares)
    return np.concatenate([wrench, np.sqrt(squares @ _MASKS.T), wrench[..., _FIRST] * wrench[..., _SECOND], *odd], -1)


def features_of(names: str | Sequence[str], size: int) -> tuple[str, ...]:
    """Return the components of a load and the further features that are meant, each once.

    Args:
        names: Features and groups of them ("radial", "magnitude", "absolute", "squares", "quadratic", "odd"); a text
            holds several joined by "+", such as "linear+radial".
        size: 3 for forces only, 6 with moments; a group is of the forces and, where there are moments, of those.

    Raises:
        UnknownNameError: No such feature or group.
    """
    names = [name.strip() for name in names.split("+")] if isinstance(names, str) else names
    groups, features = _groups(size), _known(size)
    chosen = list(groups["linear"])
    for name in names:
        if name not in groups and name not in features:
            raise UnknownNameError("feature of a load", name, (*groups, *features))
        chosen += groups.get(name, (name,))
    return tuple(dict.fromkeys(chosen))


def to_tensors(law: PolynomialLaw) -> dict[str, Array]:
    """Return the law as arrays; `features` holds places in `FEATURES`."""
    arrays = {name: getattr(law, name) for name in ARRAYS if name != "features"}
    arrays["features"] = np.array([FEATURES.index(name) for name in law.features], dtype=float)
    return {name: np.ascontiguousarray(array, dtype=float) for name, array in arrays.items()}


def from_tensors(tensors: Mapping[str, Array]) -> PolynomialLaw:
    """Return the law that `to_tensors` wrote.

    Raises:
        LawError: An array is missing, strange, or of the wrong shape; a place is none of `FEATURES`.
    """
    try:
        check_arrays(tensors, ARRAYS, SIZES)
    except ValueError as error:
        raise LawError(str(error)) from None
    places = tensors["features"]
    if not np.isin(places, np.arange(len(FEATURES))).all():
        raise LawError(f"'features' holds {places.tolist()}, expected whole numbers from 0 to {len(FEATURES) - 1}")
    names = tuple(FEATURES[int(place)] for place in places)
    return PolynomialLaw(names, *(tensors[name] for name in ARRAYS if name != "features"))


def _unit(feature: str) -> str:
    """Return the unit of a feature of a load."""
    units = ["N" if member < 3 else "Nm" for member in _MEMBERS[FEATURES.index(feature)]]
    if "*" in feature:
        return "*".join(units)
    return units[0] + ("^3" if feature.endswith("^3") else "^2" if feature[0] != "|" and feature.endswith("|") else "")


def _known(size: int) -> tuple[str, ...]:
    return tuple(name for name, members in zip(FEATURES, _MEMBERS, strict=True) if max(members) < size)


def _groups(size: int) -> dict[str, tuple[str, ...]]:
    features = _known(size)
    products = tuple(name for name in features if "*" in name)
    return {
        "linear": WRENCH_NAMES[:size],
        "radial": tuple(name for name in features if name.startswith("radial")),
        "magnitude": tuple(name for name in features if name.startswith("magnitude")),
        "absolute": tuple(name for name in features if name.startswith("|")),
        "squares": tuple(name for name in products if name[:2] == name[3:]),
        "quadratic": products,
        "odd": tuple(name for name in features if name[0] != "|" and name[-1] in "|3"),
    }
