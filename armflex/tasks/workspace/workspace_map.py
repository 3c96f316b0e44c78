"""`map_workspace`: how far the tip of a loaded arm moves, wherever it can be; the map as a file."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, fields
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from armflex.arguments import checked_kinds
from armflex.arm import Arm, warn
from armflex.configurations import MOST_ROWS, Configurations, drawn_range, furthest
from armflex.conventions import Array, number
from armflex.errors import NO_ANSWER, FileError, Flag, InputError, Place, UnknownNameError
from armflex.estimate.draw import draw_arms
from armflex.estimate.posterior import without_declared_uncertainty
from armflex.laws.effects.in_arm import about_time, settled_covariates
from armflex.measured.table import write_table
from armflex.mechanics.equilibrium import METHODS
from armflex.parallel import in_order, in_pieces
from armflex.progress import Progress
from armflex.result import Result, record
from armflex.rows.rows import TIME
from armflex.rows.wrench import Wrench
from armflex.storage.array_file import Layout, read_arrays, write_arrays
from armflex.storage.schema import Numbers
from armflex.tasks.check import COVERAGE, doubtful_tolerance
from armflex.tasks.workspace.cells import (
    SIDE,
    Answer,
    MapQuestion,
    Tally,
    answers,
    cell_indices,
    frequencies,
    joined,
    sigmas,
)

CHUNK = 8192
"""Configurations that are asked and counted together, a power of two."""

MOST_DRAWS = 1000
"""Arms that are drawn; each has its own models, of some hundred kilobytes."""

MOST_VOXELS = 5_000_000
"""Voxels that a map may have, which is about a gigabyte."""

OfVoxels = TypeVar("OfVoxels")

VERDICTS = ("ok", "uncertain", "fail")


@dataclass(frozen=True, repr=False, eq=False)
class WorkspaceMap(Result):
    """The displacement of the tip by where the rigid arm has it: V voxels of a grid along the base's axes.

    An answer is that of one configuration under one payload by the arm as it is; those of arms that were drawn from
    what is known of it are in `worst_of_draws` alone.

    Attributes:
        voxel: Edge of a voxel [m].
        index: (V, 3) which voxel; 0 0 0 has the base's origin as its lowest corner.
        configurations: (V,) how many had their rigid tip there.
        answered: (V,) answers.
        refused: (V, r) configurations and payloads without an answer, for each of `reasons`.
        reasons: "unstable", "too_large" (a flexure turns too far for its law), "no_equilibrium", "beyond_training".
        mean: (V,) mean displacement [m], NaN where everything was refused.
        worst: (V,) largest displacement [m], likewise.
        sigma: (V,) its standard uncertainty [m], likewise and where it is not known; None where nobody states one.
        worst_of_draws: (V,) largest displacement of any drawn arm [m], inf where one has no answer to a configuration
            there; None where none were drawn.
        frequency: (V,) first natural frequency [Hz] where the displacement is largest, drives holding; NaN where
            there is none; None where it was not asked for.
        worst_q: (V, nq) configuration of the largest [rad or m].
        worst_payload: (V,) its payload, as a place in `payloads`.
        payloads: Names of what was carried in turn.
        joints, base, tip: Order of q, and the frames.
        rows, seed: How many configurations were drawn, and how.
        draws: How many arms were drawn.
        flags: Flags about the arm as it is; each came up somewhere.
    """

    voxel: float
    index: np.ndarray
    configurations: np.ndarray
    answered: np.ndarray
    refused: np.ndarray
    reasons: tuple[str, ...]
    mean: Array
    worst: Array
    sigma: Array | None
    worst_of_draws: Array | None
    frequency: Array | None
    worst_q: Array
    worst_payload: np.ndarray
    payloads: tuple[str, ...]
    joints: tuple[str, ...]
    base: str
    tip: str
    rows: int
    seed: int
    draws: int
    flags: tuple[Flag, ...]

    ROWS = "table"

    def content(self) -> dict[str, Any]:
        """Return what was asked, and the largest displacement of all; `to_frame` has every voxel."""
        said = record(self, "payloads rows seed draws base tip flags", joint_names="joints", voxel_m="voxel")
        said |= {"voxels": len(self), "answered": self.answered.sum()}
        said["refused"] = dict(zip(self.reasons, self.refused.sum(axis=0), strict=True))
        said |= dict.fromkeys(("mean_m", "worst", "worst_of_draws_m"))
        if self.answered.any():
            here = self.worst_voxel
            sizes = {"displacement_m": self.worst, "sigma_m": self.sigma, "worst_of_draws_m": self.worst_of_draws}
            said["mean_m"] = np.nansum(self.mean * self.answered) / self.answered.sum()
            said["worst"] = {name: None if values is None else values[here] for name, values in sizes.items()} | {
                "centre": self.centres[here],
                "q": self.worst_q[here],
                "payload": self.payloads[self.worst_payload[here]],
            }
        if self.worst_of_draws is not None:
            said["worst_of_draws_m"] = self.worst_of_draws.max()
        if self.frequency is not None:
            said["lowest_frequency_hz"] = np.nanmin(self.frequency, initial=np.inf)
        return said

    @property
    def table(self) -> dict[str, Any]:
        """Every voxel by column, SI: centre, configurations, displacements, payload and joints of the worst."""
        columns: dict[str, Any] = {axis: self.centres[:, i] for i, axis in enumerate("xyz")}
        columns |= {"configurations": self.configurations, "answered": self.answered}
        columns |= {f"refused_{name}": self.refused[:, i] for i, name in enumerate(self.reasons)}
        sizes = {name: getattr(self, name) for name in ("mean", "worst", "sigma", "worst_of_draws", "frequency")}
        columns |= {name: np.full(len(self), np.nan) if given is None else given for name, given in sizes.items()}
        columns["payload"] = [self.payloads[i] for i in self.worst_payload]
        return columns | {f"q_{joint}": self.worst_q[:, i] for i, joint in enumerate(self.joints)}

    def __repr__(self) -> str:
        """One line: how much was asked, and the largest displacement."""
        most = f"up to {number(self.worst[self.worst_voxel] * 1e3)} mm" if self.answered.any() else "nowhere"
        size = f"{self.rows} configurations, {len(self.payloads)} payloads, {len(self)} voxels of {self.voxel:g} m"
        return f"<WorkspaceMap: {size}, {self.tip} moves {most}>"

    def __len__(self) -> int:
        return len(self.index)

    @cached_property
    def centres(self) -> Array:
        """(V, 3) centres of the voxels in the base frame [m]."""
        return (self.index + 0.5) * self.voxel

    @property
    def worst_voxel(self) -> int:
        """Which voxel holds the largest displacement of all."""
        return int(np.nanargmax(self.worst)) if self.answered.any() else 0

    @checked_kinds
    def margin(self, tolerance: float) -> Array:
        """Return (V,) tolerance minus the largest displacement [m], -inf where a configuration was refused.

        Raises:
            InputError: The tolerance is no positive length [m].
        """
        if not 0.0 < tolerance < np.inf:
            raise InputError(f"tolerance must be positive, got {tolerance} m")
        reach = float(np.linalg.norm(np.abs(self.centres) + 0.5 * self.voxel, axis=1).max(initial=0.0))
        warn(doubtful_tolerance(tolerance, reach))
        return np.where(self.refused.any(axis=1), -np.inf, tolerance - self.worst)

    @checked_kinds
    def verdicts(self, tolerance: float) -> np.ndarray:
        """Return (V,) "ok", "uncertain" or "fail", as `check` would say of the worst in every voxel.

        What would be ok is uncertain where a drawn arm is beyond the tolerance, or has no answer.
        """
        margin = self.margin(tolerance)
        half_width = np.zeros(len(self)) if self.sigma is None else COVERAGE * np.nan_to_num(self.sigma, nan=np.inf)
        uncertain = np.isfinite(margin) & (np.abs(margin) < half_width)
        if self.worst_of_draws is not None:
            uncertain |= (margin >= 0.0) & (self.worst_of_draws > tolerance)
        return np.where(uncertain, "uncertain", np.where(margin >= 0.0, "ok", "fail"))


@checked_kinds
def map_workspace(
    arm: Arm,
    payloads: str | Sequence[str] = "none",
    *,
    rows: int = 1 << 16,
    voxel: float | None = None,
    seed: int = 0,
    covariates: Mapping[str, float] | None = None,
    wrenches: Sequence[Wrench] = (),
    method: str = "exact",
    strict: bool = False,
    uncertainty: bool = True,
    frequency: bool = False,
    draws: int = 0,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> WorkspaceMap:
    """Ask an arm how far its tip moves at configurations spread evenly over its joint limits, under every payload.

    Memory is bounded by the voxels reached, however many configurations there are. The map does not depend on the
    number of processes; `joblib.parallel_config(backend="dask")` around the call puts it on a cluster.

    Args:
        arm: The arm.
        payloads: Name or names; "none" for nothing carried.
        rows: Number of configurations; a power of two covers the joint limits most evenly.
        voxel: Edge of a voxel [m]; a round one when not given.
        seed: Of the configurations, see `Configurations`.
        covariates: What the arm's effects depend on, the same everywhere.
        wrenches: Loads from outside at named links, the same everywhere.
        method: See `Arm.deflection`.
        strict: Refuse, and count, loads beyond those that a trained law has seen.
        uncertainty: False leaves out the standard uncertainty of the largest displacement in every voxel.
        frequency: Find the first natural frequency, too, where the displacement is largest in every voxel.
        draws: Ask so many arms drawn from what is known of this one as well, see `draw_arms`; `seed` is theirs, too.
            All else in the map is as without them.
        jobs: Processes, -1 for all cores; None for what joblib is set to, else one.
        progress: Called with (done, in all): configurations, and as many steps again for the uncertainty, and for the
            frequency, of all voxels. How many there are in all is the same from first to last.

    Raises:
        UnknownNameError: No such payload or method.
        InputError: A number is out of its range, no effect depends on a covariate, or the voxels would be too many.
        MissingCovariateError: An effect depends on something that was not given.
    """
    rows, seed, draws = _counts(rows, seed, draws)
    lower, upper, flags = drawn_range(arm)
    names = _names(arm, payloads)
    if method not in METHODS:
        raise UnknownNameError("method", method, METHODS)
    edge = _edge(voxel, furthest(arm, lower, upper), rows)
    settled = settled_covariates(arm, covariates or {})
    arm.loaded(None).flags_under(wrenches, moves=False)  # raises where a link is not the arm's
    options = {"covariates": settled, "method": method, "strict": strict, "wrenches": tuple(wrenches)}
    arms = (without_declared_uncertainty(arm), *(draw_arms(arm, draws, seed) if draws else ()))
    question = MapQuestion(arms, names, edge, options, rows * len(names))
    drawn = Configurations(lower, upper, rows, seed, CHUNK)

    def tick(stage: int, share: float) -> None:
        if progress:
            progress(round(rows * (stage + share)), rows * (1 + uncertainty + frequency))

    with closing(in_order((partial(answers, question, q) for q in drawn.chunks()), jobs)) as chunks:
        tally, met = _gathered(drawn, chunks, partial(tick, 0))
    answered, sigma, swing = tally.answered > 0, np.full(len(tally), np.nan), np.full(len(tally), np.nan)
    if uncertainty:
        for voxels, (values, raised) in _of_worst(sigmas, question, tally, jobs, partial(tick, 1)):
            sigma[voxels] = values
            met |= {flag.kind: flag for flag in raised}
    if frequency:
        for voxels, values in _of_worst(frequencies, question, tally, jobs, partial(tick, 1 + uncertainty)):
            swing[voxels] = values
    return WorkspaceMap(
        voxel=edge,
        index=cell_indices(tally.cell),
        configurations=tally.configurations,
        answered=tally.answered,
        refused=tally.refused,
        reasons=tuple(NO_ANSWER),
        mean=np.where(answered, tally.total / np.maximum(tally.answered, 1), np.nan),
        worst=np.where(answered, tally.worst, np.nan),
        sigma=sigma if np.isfinite(sigma).any() or (uncertainty and ("undetermined", "") in met) else None,
        worst_of_draws=tally.worst_of_draws if draws else None,
        frequency=swing if frequency else None,
        worst_q=tally.q,
        worst_payload=tally.payload,
        payloads=names,
        joints=arm.joint_names,
        base=arm.robot.base,
        tip=arm.robot.tip,
        rows=rows,
        seed=seed,
        draws=draws,
        flags=(*flags, *about_time(arm, {TIME, *settled}), *met.values()),
    )


def _names(arm: Arm, payloads: str | Sequence[str]) -> tuple[str, ...]:
    """Return the payloads that are asked for, each once, all of them the arm's."""
    names = (payloads,) if isinstance(payloads, str) else tuple(payloads)
    if not names or not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
        raise InputError(f"payloads {names!r}: expected one name or several different ones")
    for name in names:
        arm.payload(name)
    return names


def _counts(rows: int, seed: int, draws: int) -> tuple[int, int, int]:
    try:
        rows, seed, draws = (operator.index(value) for value in (rows, seed, draws))
    except TypeError:
        text = f"rows {rows!r}, seed {seed!r}, draws {draws!r}"
        raise InputError(f"{text}: expected whole numbers") from None
    if not 0 <= draws <= MOST_DRAWS:
        raise InputError(f"draws is {draws}, expected 0 to {MOST_DRAWS}")
    if not 1 <= rows <= MOST_ROWS:
        raise InputError(f"{rows} configurations: expected 1 to {MOST_ROWS}")
    if seed < 0:
        raise InputError(f"seed is {seed}, expected 0 or more")
    return rows, seed, draws


def _edge(voxel: float | None, reach: float, rows: int) -> float:
    """Return the edge of a voxel [m] for a tip that is never beyond `reach` [m] of the base.

    Where none is asked for it is 1, 2 or 5 times a power of ten that divides the reach into 25 to 63.
    """
    if reach == 0.0 and voxel is None:
        raise InputError("the tip stands on the axes of all joints and never leaves the base's origin: no map of that")
    wanted = reach / 25.0
    power = 10.0 ** np.floor(np.log10(wanted))
    edge = max(step * power for step in (1.0, 2.0, 5.0) if step * power <= wanted) if voxel is None else float(voxel)
    if not 0.0 < edge < np.inf:
        raise InputError(f"voxel must be positive, got {voxel} m")
    along = 2.0 * np.ceil(reach / edge)
    if along > 2 * SIDE or min(float(rows), along**3) > MOST_VOXELS:
        text = f"voxels of {edge:g} m within {reach:.3g} m of the base may be more than {MOST_VOXELS}"
        raise InputError(f"{text}: ask for larger ones or for fewer configurations")
    return edge


def _gathered(
    drawn: Configurations, chunks: Iterable[Answer], tick: Callable[[float], None]
) -> tuple[Tally, dict[tuple[str, str], Flag]]:
    """Return all chunks as one tally, joined in their order, and the flags met; `tick` gets the share done."""
    flags: dict[tuple[str, str], Flag] = {}
    waiting: list[Tally] = []
    done = 0
    for size, answer in zip(drawn.sizes, chunks, strict=True):
        waiting.append(answer.tally)
        if len(waiting) > 16:  # chunks whose tallies wait to be joined with the rest, as all cells are sorted each time
            waiting = [joined(waiting)]
        for flag in answer.flags:
            flags.setdefault(flag.kind, flag)
        done += size
        tick(done / drawn.rows)
    return joined(waiting), flags


def _of_worst(
    work: Callable[[MapQuestion, Array, np.ndarray], OfVoxels],
    question: MapQuestion,
    tally: Tally,
    jobs: int | None,
    tick: Callable[[float], None],
) -> Iterator[tuple[np.ndarray, OfVoxels]]:
    """Yield numbers of voxels, and what work makes of their largest displacements, of which alone it is asked."""
    answered = np.flatnonzero(tally.answered)
    pieces = in_pieces(answered, 256)  # largest displacements whose uncertainty is found together
    tasks = (partial(work, question, tally.q[voxels], tally.payload[voxels]) for voxels in pieces)
    done = 0
    for voxels, of_voxels in zip(pieces, in_order(tasks, jobs), strict=True):
        yield voxels, of_voxels
        done += len(voxels)
        tick(done / len(answered))


SUFFIXES = (".safetensors", ".csv")
INF, NAN = float("inf"), float("nan")

ARRAYS = {
    "index": Numbers(("voxels", 3), "i8", least=-SIDE, most=SIDE - 1),
    "configurations": Numbers(("voxels",), "i8", least=0),
    "answered": Numbers(("voxels",), "i8", least=0),
    "refused": Numbers(("voxels", "reasons"), "i8", least=0),
    "worst_payload": Numbers(("voxels",), "i8", least=0),
    "mean": Numbers(("voxels",), least=0.0, beside=(NAN,)),
    "worst": Numbers(("voxels",), least=0.0, beside=(NAN,)),
    "sigma": Numbers(("voxels",), least=0.0, beside=(NAN,), optional=True),
    "worst_of_draws": Numbers(("voxels",), least=0.0, beside=(INF,), optional=True),
    "frequency": Numbers(("voxels",), least=0.0, beside=(NAN,), optional=True),
    "worst_q": Numbers(("voxels", "joints")),
}
OPTIONAL = tuple(name for name, numbers in ARRAYS.items() if numbers.optional)
LISTS = ("reasons", "payloads", "joints")

LAYOUT = Layout(
    "a workspace map",
    "armflex-map-4",
    ARRAYS,
    {
        "voxel": float,
        **dict.fromkeys(LISTS, tuple[str, ...]),
        **dict.fromkeys(("base", "tip"), str),
        **dict.fromkeys(("rows", "seed", "draws"), int),
        "flags": tuple[Flag, ...],
    },
    lambda about: {"voxels": range(1, about["rows"] + 1), **{name: (len(about[name]),) for name in LISTS}},
    anew="make the map anew",
    most_bytes=1 << 30,
)


@checked_kinds
def write_map(workspace: WorkspaceMap, path: str | Path, tolerance: float | None = None) -> Path:
    """Write a map, whole or not at all; return the path.

    Args:
        workspace: The map.
        path: Ends in .safetensors or .csv. `read_map` reads the first; a .csv is for other programs: SI, cells without
            a value are blank, also where a drawn arm has no answer.
        tolerance: Adds the columns `margin` and `verdict` to a .csv [m].

    Raises:
        InputError: The path ends otherwise, or the tolerance is no positive length.
        FileError: It cannot be written.
    """
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: expected a name that ends in {' or '.join(SUFFIXES)}")
    if path.suffix == ".csv":
        columns = {name: np.asarray(values).tolist() for name, values in workspace.table.items()}
        if tolerance is not None:
            asked = {"margin": workspace.margin(tolerance).tolist(), "verdict": workspace.verdicts(tolerance).tolist()}
            place = list(columns).index("payload")
            columns = {**dict([*columns.items()][:place]), **asked, **dict([*columns.items()][place:])}
        for name in {"mean", "worst", *OPTIONAL, "margin"} & columns.keys():
            columns[name] = [x if np.isfinite(x) else "" for x in columns[name]]
        return write_table(path, columns)
    arrays = {name: getattr(workspace, name) for name in ARRAYS if getattr(workspace, name) is not None}
    about = {field.name: getattr(workspace, field.name) for field in fields(workspace) if field.name not in ARRAYS}
    write_arrays(path, LAYOUT, arrays, about | {"flags": [asdict(flag) for flag in workspace.flags]})
    return path


@checked_kinds
def read_map(path: str | Path) -> WorkspaceMap:
    """Read a map that `write_map` wrote as .safetensors.

    Raises:
        FileError: The file cannot be read, is damaged, was made by another version, or is no map.
    """
    about, arrays, _ = read_arrays(path := Path(path), LAYOUT)
    workspace = WorkspaceMap(**{**dict.fromkeys(OPTIONAL), **arrays}, **about)
    try:
        _check(workspace)
    except ValueError as error:
        raise FileError(Place(path), f"does not hold {LAYOUT.what}: {error}; {LAYOUT.anew}") from None
    return workspace


def _check(workspace: WorkspaceMap) -> None:
    """Raise `ValueError` where what a map says does not go together."""
    answered, asked = workspace.answered > 0, workspace.rows * len(workspace.payloads)
    if not (workspace.voxel > 0.0 and workspace.seed >= 0 and workspace.draws >= 0):
        given = f"voxel {workspace.voxel:g}, seed {workspace.seed}, draws {workspace.draws}"
        raise ValueError(f"{given}: expected no negative numbers")
    for name in LISTS:
        if len(set(getattr(workspace, name))) < len(getattr(workspace, name)):
            raise ValueError(f"one of the {name} is there twice")
    steps = np.diff(workspace.index, axis=0)
    first = np.take_along_axis(steps, (steps != 0).argmax(axis=1)[:, None], axis=1)
    if not ((first > 0).all() and (workspace.worst_payload < len(workspace.payloads)).all()):
        raise ValueError("its voxels are not in order, or a payload is not among those asked for")
    if workspace.configurations.sum() != workspace.rows or workspace.answered.sum() + workspace.refused.sum() != asked:
        raise ValueError(f"{asked} questions are not as many as were answered and refused")
    if (np.isfinite(workspace.worst) != answered).any() or (np.isfinite(workspace.mean) != answered).any():
        raise ValueError("a displacement is there without an answer, or an answer without one")
    if (workspace.mean[answered] > workspace.worst[answered] * (1.0 + 1e-9)).any():
        raise ValueError("a mean is above the largest")
    if workspace.sigma is not None and np.isfinite(workspace.sigma[~answered]).any():
        raise ValueError("an uncertainty is there without an answer")
    if (workspace.worst_of_draws is None) != (workspace.draws == 0):
        raise ValueError(f"{workspace.draws} draws, expected 'worst_of_draws' where there are any, and only there")
