"""Every exception and warning of armflex, in one place.

Errors are part of the interface: each names the file and line, joint or row it is about, what was expected
and, for a name, the nearest valid one. All derive from `ArmflexError`; those that blame the input also derive
from `InputError`, which the command line turns into exit code 2.
"""

import difflib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path


class ArmflexError(Exception):
    """Base of every error that armflex raises on purpose; each survives being sent between processes."""

    def __reduce__(self) -> tuple:
        """Return the error whole: a class with arguments of its own is not made again from its message."""
        return _again, (type(self), self.args, self.__dict__)


def _again(kind: type[ArmflexError], args: tuple, state: dict) -> ArmflexError:
    error = kind.__new__(kind)
    error.args = args
    error.__dict__.update(state)
    return error


class InputError(ArmflexError, ValueError):
    """Something the user gave cannot be used."""


@dataclass(frozen=True, eq=False)
class Frame:
    """A data frame as the source of rows; `index` names them, and what it holds is known by `sha256`."""

    index: tuple[object, ...]
    sha256: str
    name: str = "data frame"

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class Place:
    """Where in a user's file something stands; `line` counts from 1, 0 when the whole file is meant.

    Rows of a data frame count from 2, as if it were a file with a header, and are named by its index.
    """

    file: Path | Frame
    line: int = 0

    def __str__(self) -> str:
        return self.within(str(self.file))

    @property
    def short(self) -> str:
        """The same without the folder."""
        return self.within(self.file.name)

    def within(self, file: str) -> str:
        """Return the place, the file called so."""
        if isinstance(self.file, Frame):
            return f"{file}, row {shown(self.file.index[self.line - 2], 60)}" if self.line > 1 else file
        return f"{file}:{self.line}" if self.line else file


class FileError(InputError):
    """A file cannot be used; `place` is its name and line."""

    def __init__(self, place: Place, problem: str) -> None:
        super().__init__(f"{place}: {problem}")
        self.place = place
        self.problem = problem


class UrdfError(FileError):
    """A URDF is not a robot that can be computed with."""


class ArmFileError(FileError):
    """An arm.toml does not say what FORMATS asks of it."""


class TableError(FileError):
    """A CSV table (trajectory, joint data, measurements) cannot be read as one."""


class MeshError(FileError):
    """A mesh, or what was condensed from one, cannot be computed with."""


class ModelFileError(FileError):
    """A trained model's file is damaged, foreign, or made for something else."""


class PluginError(InputError):
    """An installed distribution offers armflex something that it cannot take."""


class ManyErrors(InputError):
    """Files that are read as they are have `problems`: everything that is wrong or open in them, each with a remedy."""

    def __init__(self, problems: Sequence[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = tuple(problems)


class UnitError(InputError):
    """A quantity has no unit, or one of the wrong kind."""


class ShapeError(InputError):
    """An array has the wrong shape."""


class ArrayTypeError(InputError, TypeError):
    """An array holds something other than real numbers."""


class DigestError(InputError, TypeError):
    """It is unknown whether two objects of a class say the same."""


class NotFiniteError(InputError):
    """A number is NaN, infinite, or too large to mean anything."""


class PoseError(InputError):
    """A pose is not a rigid transform."""


class JointLimitError(InputError):
    """A joint position lies outside its limits."""


class PayloadError(InputError):
    """A payload cannot be carried: negative, not finite, or of impossible inertia."""


class LawError(InputError):
    """A joint deformation model's numbers are not physical."""


class UnsupportedError(InputError):
    """The input is valid but asks for something this version does not do."""


class ConventionError(InputError):
    """A campaign is implausible for its arm, and plausible in another convention: `names`, the likeliest first.

    Whoever means it as it is written asks for it to be taken as it is: `anyway`.
    """

    def __init__(self, problem: str, names: Sequence[str]) -> None:
        super().__init__(f"{problem}. To take it as it is all the same: --anyway (in Python anyway=True)")
        self.problem = problem
        self.names = tuple(names)


class IdentifiabilityError(InputError):
    """Measurements do not determine what a fit needs; `rank`, `condition` and the `names` of what they leave free."""

    def __init__(self, problem: str, rank: int, condition: float, names: Sequence[str]) -> None:
        super().__init__(f"{problem} (rank {rank}, condition {condition:.1e}; left free: {listing(names)})")
        self.rank = rank
        self.condition = condition
        self.names = tuple(names)


class UnknownNameError(InputError, KeyError):
    """A joint, frame, payload or flexure of this name does not exist."""

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        known = list(known)
        super().__init__(f"no {kind} named {name!r}{did_you_mean(name, known)} (known: {listing(known)})")
        self.name = name
        self.known = known

    def __str__(self) -> str:  # KeyError would show the repr
        return str(self.args[0])


class MissingCovariateError(InputError):
    """An effect depends on something that was not given: `name`; `given` lists what was, `remedy` says what to do."""

    def __init__(self, name: str, given: Iterable[str], asker: str = "", remedy: str = "") -> None:
        self.name, self.given = name, tuple(given)
        who = f"effect {asker!r}" if asker else "the arm"
        alike = [column for column in self.given if ("=" in column) == ("=" in name)]  # a column or a level
        hint = did_you_mean(name, alike)
        text = f"{who} needs the covariate {name!r}, which is not given{hint} (given: {listing(self.given)})"
        remedy = remedy or f": a column of the rows, --covariates {name}=VALUE or covariates= in Python gives it"
        super().__init__(text + remedy)


class ConvergenceError(ArmflexError):
    """An iteration did not converge; `history` holds its residual norms, first to last."""

    def __init__(self, problem: str, history: Sequence[float]) -> None:
        shown = ", ".join(f"{value:.1e}" for value in history[-5:])
        super().__init__(f"{problem} (last residuals: {shown})" if shown else problem)
        self.history = tuple(history)


class ClosureError(ConvergenceError):
    """A loop cannot be closed at a pose, or not in one way only.

    `loop` is its name; `gap` by how much it gaps where it is nearest to closed [m, or rad where it gaps by an angle].
    """

    def __init__(self, problem: str, loop: str, gap: float) -> None:
        super().__init__(problem, ())
        self.loop, self.gap = loop, gap


class ExtrapolationError(ArmflexError):
    """A trained law was asked beyond the loads that it was trained on."""


class UnstableEquilibriumError(ArmflexError):
    """An equilibrium exists but the arm would not stay in it; `eigenvalue` of the tangent is not positive."""

    def __init__(self, problem: str, eigenvalue: float) -> None:
        super().__init__(f"{problem} (smallest eigenvalue of the tangent: {eigenvalue:.3g})")
        self.eigenvalue = eigenvalue


class SmallDisplacementError(ArmflexError):
    """A flexure turned further than a compliance can describe; `twists` is (n_flexures, 6)."""

    def __init__(self, problem: str, twists: object) -> None:
        super().__init__(problem)
        self.twists = twists


class OutOfMemoryError(ArmflexError):
    """The memory that this process may use does not hold what was asked for."""


class UnreachableError(ArmflexError):
    """A tip pose cannot be held; `report` says for each row what remained and why."""

    def __init__(self, problem: str, report: object) -> None:
        super().__init__(problem)
        self.report = report


class ArmflexWarning(UserWarning):
    """Something usable but doubtful; the same text is found in the `flags` of the result."""


@dataclass(frozen=True)
class Flag:
    """A flag that travels with a result: `code` for programs, `text` for people.

    `about` names what one flag is about in many rows, and `size` says which of them is the worst.
    """

    code: str
    text: str
    about: str = field(default="", compare=False)
    size: float = field(default=0.0, compare=False)

    @property
    def kind(self) -> tuple[str, str]:
        """The code, and what it is about: flags of one kind say the same of several rows."""
        return self.code, self.about

    def __str__(self) -> str:
        return f"{self.code}: {self.text}"


EQUALLY = 1e-9
"""Share of a flag's size by which another of its kind must be larger to be the worse of them."""


def worst_of(flags: Iterable[Flag]) -> dict[tuple[str, str], Flag]:
    """Return the worst flag of every kind, in the order in which kinds come; the first of those that are as bad."""
    worst: dict[tuple[str, str], Flag] = {}
    for flag in flags:
        if flag.size > worst.setdefault(flag.kind, flag).size * (1.0 + EQUALLY):
            worst[flag.kind] = flag
    return worst


def further(flags: Sequence[Flag], others: Iterable[Flag]) -> tuple[Flag, ...]:
    """Return flags, and the others that are of none of their kinds."""
    kinds = {flag.kind for flag in flags}
    return (*flags, *(flag for flag in others if flag.kind not in kinds))


@contextmanager
def naming(where: object) -> Iterator[None]:
    """Raise the errors met inside again, saying first which row they are about."""
    try:
        yield
    except ArmflexError as error:
        error.args = (f"{where}: {error.args[0]}", *error.args[1:])
        raise


@contextmanager
def enough_memory(what: str) -> Iterator[None]:
    """Raise `OutOfMemoryError` naming what was being worked on where memory runs out inside."""
    try:
        yield
    except MemoryError:
        raise OutOfMemoryError(f"{what}: there is not enough memory for them") from None


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return ', did you mean ...?' with the nearest known name, or an empty string."""
    lowered = {candidate.lower(): candidate for candidate in known}
    close = difflib.get_close_matches(name.lower(), lowered, n=1, cutoff=0.5)
    return f", did you mean {lowered[close[0]]!r}?" if close else ""


def shown(value: object, most: int = 200) -> str:
    """Return a value as it is written in Python, cut after `most` characters."""
    try:
        text = repr(value)
    except Exception:  # what cannot be written: a whole number of thousands of digits, another's own class
        text = f"<{type(value).__name__}>"
    return text if len(text) <= most else f"{text[:most]} ..."


FEW = 3
"""Names of many that a message has room for, the worst first."""


def listing(names: Iterable[str], most: int = 20) -> str:
    """Return names joined by commas, cut after `most` of them."""
    names = list(names)
    more = f", ... {len(names) - most} more" if len(names) > most else ""
    return (", ".join(names[:most]) or "none") + more


NO_ANSWER: dict[str, type[ArmflexError]] = {
    "unstable": UnstableEquilibriumError,
    "too_large": SmallDisplacementError,
    "no_equilibrium": ConvergenceError,
    "beyond_training": ExtrapolationError,
}
"""Why a configuration may have no answer. Whatever else goes wrong is wrong with the question."""


def no_answer(error: ArmflexError) -> str:
    """Return which of `NO_ANSWER` an error is."""
    return next(name for name, kind in NO_ANSWER.items() if isinstance(error, kind))
