"""Units, frames, signs and orders: the one place where they are written down.

1. SI inside: m, rad, s, kg, N, N·m; temperature in °C. Other units exist only in file headers and on the
   command line and are converted once, when read.
2. Six-vectors are linear first: wrench (fx fy fz mx my mz), twist (dx dy dz rx ry rz). Pinocchio's order.
3. `T_a_b` maps coordinates of b to coordinates of a. Poses are `pin.SE3` or 4 x 4 arrays.
4. A wrench is the load **on** the structure: a hanging weight gives a force along gravity. Pinocchio's
   generalized gravity and `data.f` are what the parent exerts on the child, so the load is their negative.
5. A twist is the exponential coordinate of a flexure's pose: `T = exp6(twist)`, local axes of the flexure.
6. The tip's displacement is (flexed minus rigid) the shift of the tip frame's origin in base axes [m] and the
   rotation vector of `R_flexed R_rigid^T` in base axes [rad].
7. `q` is what the controller reports. The arm gives after it: a flexure sits just outboard of its joint's motion.
8. The order of joints is that of `arm.joint_names`, the order of flexures that of `arm.flexure_names`.
9. A covariance is symmetric and positive semidefinite, as far as its digits go; what has no variance is exact.
"""

import re
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from armflex.errors import ArrayTypeError, NotFiniteError, PoseError, ShapeError, UnitError, did_you_mean, shown

if TYPE_CHECKING:
    cached_property = property  # which meets a protocol; type checkers take the other for something that can be set
else:
    from functools import cached_property as cached_property

Array = NDArray[np.float64]

WRENCH_NAMES = ("fx", "fy", "fz", "mx", "my", "mz")
TWIST_NAMES = ("dx", "dy", "dz", "rx", "ry", "rz")
STANDARD_GRAVITY = 9.81
LARGEST = 1e30
"""No quantity of an arm or a campaign is beyond this in SI units; its tenth power does not overflow."""

SMALLEST_STD = 1e-15
"""No standard deviation is below this in SI units: a proton is wider [m]. The inverse of its square is within reach."""

RESOLUTION = 1e-12
"""Metres and radians below this are rounding: an arm's are of the order of one, represented to 2e-16 of it, and a
solution is some hundreds of operations away from them."""

MILLI = 1e3 * RESOLUTION
"""The same in mm and mrad."""

LARGEST_POSITION = 1e3
"""Joint positions beyond this [rad or m] count as a mistake (1e300 would give finite nonsense)."""

UNITS: dict[str, dict[str, float]] = {
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "cm": 1e-2},
    "angle": {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": np.pi / 180.0},
    "force": {"N": 1.0, "kN": 1e3, "MN": 1e6, "kgf": 9.80665},
    "moment": {"Nm": 1.0, "kNm": 1e3, "Nmm": 1e-3},
    "acceleration": {"m/s^2": 1.0, "m/s2": 1.0, "mm/s^2": 1e-3, "g": 9.80665, "mg": 9.80665e-3},
    "frequency": {"Hz": 1.0, "mHz": 1e-3, "kHz": 1e3},
    "count": {},
    "pixel": {"px": 1.0},
    "time": {"s": 1.0, "ms": 1e-3, "min": 60.0},
}
"""Kind of quantity -> unit -> factor to SI."""

SHOWN = {"m": ("mm", 1e3), "rad": ("mrad", 1e3), "m/s^2": ("mm/s^2", 1e3), "1": ("1", 1.0)} | {
    unit: (unit, 1.0) for unit in ("N", "Nm", "Hz", "px")
}
"""SI unit -> the unit in which people are shown an error, and its factor."""


Shown = tuple[str, float]
"""A unit in which people are shown an error, and its factor from SI."""


def shown_in(unit: str | Shown) -> Shown:
    """Return the unit in which people are shown an error in an SI unit; one that is such already as it is."""
    return SHOWN[unit] if isinstance(unit, str) else unit


def said_of(error: float, unit: str | Shown) -> str:
    """Return an error in an SI unit as people read it: '0.12 mm'."""
    name, factor = shown_in(unit)
    return f"{factor * error:.3g} {name}"


UNITS["inclination"] = UNITS["angle"] | {"mm/m": 1e-3, "arcmin": np.pi / 10800.0, "arcsec": np.pi / 648000.0}

UNITS["direction"] = UNITS["inclination"] | {"dms": np.pi / 180.0, "hms": np.pi / 12.0}

LOGGED_ANGLES = {
    "radians": 1.0,
    "degrees": np.pi / 180.0,
    "decidegrees (tenths of a degree)": np.pi / 1.8e3,
    "centidegrees (hundredths of a degree)": np.pi / 1.8e4,
    "millidegrees (thousandths of a degree)": np.pi / 1.8e5,
    "tenths of a millidegree": np.pi / 1.8e6,
    "arcminutes": np.pi / 10800.0,
    "arcseconds": np.pi / 648000.0,
    "gradians (400 a turn)": np.pi / 200.0,
    "turns": 2.0 * np.pi,
    "multiples of pi (half turns)": np.pi,
    "mrad": 1e-3,
}
"""Units that joint positions are logged in, each in rad. What is none of them counts so many steps a turn."""

ROUND = 0.01
"""Part by which a number that readings gave may be off the one that people use, and a zero [rad]: an arm has errors."""

LOGGED_LENGTHS = {
    "m": 1.0,
    "mm": 1e-3,
    "cm": 1e-2,
    "um": 1e-6,
    "inches": 0.0254,
    "feet": 0.3048,
    "tenths of a mm": 1e-4,
}
"""The same of slides and rails, each in m."""

NUMBER = re.compile(r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
"""A plain decimal number; `float()` would also take '1_000', 'nan' and full-width digits.

Its digits can be read in one way only: a long cell that is no number costs no more than one that is.
"""

_QUANTITY = re.compile(r"\s*([-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?)\s*([A-Za-zµ]*)\s*")


def no_unit(name: str, kind: str) -> str:
    """Return what is said of a name that is no unit of a kind of quantity: `mn` is rather mm than m."""
    letters, units = name.strip("0123456789. "), UNITS[kind]
    alike = [unit for unit in units if len(unit) == len(letters) and unit[0].lower() == letters[0].lower()]
    hint = did_you_mean(letters, alike) or did_you_mean(letters, units)
    return f"{name!r} is no unit of {kind}{hint} ({', '.join(units)})"


def parse_quantity(text: str, kind: str) -> float:
    """Return a quantity such as '5mm' in SI; raise `UnitError` where the unit is missing or of another kind."""
    match = _QUANTITY.fullmatch(text)
    units = UNITS[kind]
    if match is None or not match[2]:
        unit = next(iter(units))
        example = f"5{SHOWN.get(unit, (unit,))[0]}"
        article = "an" if kind[0] in "aeiou" else "a"
        raise UnitError(f"{text!r}: expected {article} {kind} with its unit, such as {example} ({', '.join(units)})")
    if match[2] not in units:
        raise UnitError(f"{text!r}: {no_unit(match[2], kind)}")
    if not np.isfinite(value := float(match[1])):
        raise UnitError(f"{text!r} is not a finite {kind}")
    return value * units[match[2]]


def real_array(values: ArrayLike, name: str) -> Array:
    """Return `values` as floats; raise `ArrayTypeError` for complex, text or objects, `ShapeError` if ragged."""
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise ShapeError(f"{name}: rows of different length") from error
    if array.dtype.kind not in "fiu":
        raise ArrayTypeError(f"{name}: expected real numbers, got {array.dtype}")
    return array.astype(float, copy=False)


def row_numbers(rows: ArrayLike, count: int) -> np.ndarray:
    """Return (M,) numbers of rows of a table of `count`; raise `InputError` where they are none."""
    numbers = real_array(rows, "rows")
    if numbers.ndim != 1 or (numbers != np.round(numbers)).any() or not ((numbers > -1) & (numbers < count)).all():
        raise ShapeError(f"rows: expected whole numbers of rows from 0 to {count - 1}, got {shown(rows, 60)}")
    return numbers.astype(int)


def finite_array(values: ArrayLike, name: str, shape: tuple[int, ...]) -> Array:
    """Return `values` as a finite float array of exactly `shape`, else raise a typed error naming `name`."""
    array = real_array(values, name)
    if array.shape != shape:
        raise ShapeError(f"{name}: expected shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise NotFiniteError(f"{name}: element {int(np.argmin(np.isfinite(array.ravel())))} is not finite")
    return array


def as_pose(pose: Any, name: str = "pose") -> pin.SE3:
    """Return a pose given as `pin.SE3`, 4 x 4 matrix or (7,) position and quaternion xyzw.

    Raises:
        ShapeError, ArrayTypeError, NotFiniteError: It is none of these.
        PoseError: The rotation is reflected or not orthonormal, or the quaternion's norm is off by over 1e-6.
    """
    array = real_array(pose.homogeneous if isinstance(pose, pin.SE3) else pose, name)
    if array.shape == (7,):
        norm = float(np.linalg.norm(finite_array(array, name, (7,))[3:]))
        if abs(norm - 1.0) > 1e-6:
            raise PoseError(f"{name}: quaternion has norm {norm:.9g}, expected 1 (order x y z w)")
        return pin.XYZQUATToSE3(array)
    matrix = finite_array(array, name, (4, 4))
    rotation = matrix[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6:
        raise PoseError(f"{name}: rotation part is not orthonormal")
    if np.linalg.det(rotation) < 0.0:
        raise PoseError(f"{name}: rotation part is a reflection (determinant -1): left-handed axes?")
    if np.abs(matrix[3] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-9:
        raise PoseError(f"{name}: last row is {matrix[3]}, expected 0 0 0 1")
    return pin.SE3(rotation, matrix[:3, 3])


def covariance_fault(covariance: Array, rounding: float = 1e-7) -> str:
    """Return what a (P, P) matrix has that no covariance has, '' where it may be one.

    `rounding`, in units of its own diagonal, is how far its halves may differ and an eigenvalue may lie below zero.
    """
    variance = np.diag(covariance)
    if not np.isfinite(covariance).all():
        return "is not finite"
    if (variance < 0.0).any():
        place = int(variance.argmin())
        return f"has a negative variance, {variance[place]:g} in row {place + 1}"
    sure = variance == 0.0
    if covariance[sure].any() or covariance[:, sure].any():
        return f"has numbers beside the zero variance in row {int(sure.argmax()) + 1}"
    unit = np.sqrt(np.where(sure, 1.0, variance))
    with np.errstate(over="ignore", invalid="ignore"):  # beside a tiny variance: refused below
        scaled = covariance / unit[:, None] / unit
        skew = np.abs(scaled - scaled.T)
    if not (skew <= rounding).all():
        row, column = np.unravel_index(int(skew.argmax()), scaled.shape)
        return f"is not symmetric: rows {row + 1} and {column + 1}"
    try:
        np.linalg.cholesky(scaled + rounding * np.eye(len(scaled)))
    except np.linalg.LinAlgError:
        return "is not positive semidefinite: some combination of the parameters would have a negative variance"
    return ""


def root_of_covariance(covariance: Array) -> Array:
    """Return R with R R' a (P, P) covariance, which may be singular; units may differ by orders of magnitude."""
    scale = np.sqrt(np.diag(covariance))
    unit = np.where(scale > 0.0, scale, 1.0)
    size, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    return scale[:, None] * vectors * np.sqrt(np.maximum(size, 0.0))  # what is sure stays so: rounding has no unit


def covariate_array(values: ArrayLike, name: str, count: int) -> Array:
    """Return a covariate as a number or one per row of a batch of `count` (0 for a single query)."""
    if type(values) is float and isfinite(values):  # in a control loop the checks below would take longest
        return np.float64(values)
    array = real_array(values, f"covariate {name!r}")
    if array.shape not in ((), (count,)) or (array.ndim and not count):
        raise ShapeError(f"covariate {name!r}: expected a number{f' or {count}' if count else ''}, got {array.shape}")
    if not np.isfinite(array).all():
        raise NotFiniteError(f"covariate {name!r} is not finite")
    return array


def number(value: float, digits: int = 4, resolution: float = MILLI) -> str:
    """Return a number to so many significant digits, what is below the resolution as 0.

    Args:
        value: In mm or mrad, where no other resolution is given.
        digits: Significant ones.
        resolution: In the unit of the value; 0 where every size has a meaning, as a compliance's has.
    """
    return "0" if abs(value) < resolution or value == 0.0 else f"{value:.{digits}g}"


def in_mm(length: float) -> str:
    """Return a length [m] as a message says it: three digits, mm."""
    return f"{length * 1e3:.3g} mm"


_BREAKS = "\t\n\r"
_UNPRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff\ufffe\uffff]")
"""Control characters (C0, C1, delete), line and paragraph separators, what turns the order of letters about
(Unicode's embeddings, overrides and isolates), halves of letters (a file name that is no UTF-8), and no letters."""


def printable(text: str, keep: str = "") -> str:
    """Return a text with its unprintable characters shown as Python writes them, `\\x1b`, but for those in `keep`.

    A terminal would obey them: colours, a moved cursor, a title of the window, lines that nobody wrote.
    """
    return _UNPRINTABLE.sub(lambda match: match[0] if match[0] in keep else _shown(match[0]), text)


def unprintable(text: str) -> tuple[int, str] | None:
    """Return where the first character is for which no file's text has a use, and what is wrong with it.

    Tabs and line breaks have a use: in a remark.
    """
    match = next((match for match in _UNPRINTABLE.finditer(text) if match[0] not in _BREAKS), None)
    if match is None:
        return None
    return match.start(), f"holds the character {_shown(match[0])}, which cannot be shown: expected letters"


def _shown(letter: str) -> str:
    return letter.encode("unicode_escape").decode()
