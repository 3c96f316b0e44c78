"""A chunk of a map as a file, so that an interrupted map goes on from where it was."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from armflex.errors import NO_ANSWER, Flag
from armflex.storage.array_file import Layout
from armflex.storage.kept import Form
from armflex.storage.schema import Numbers
from armflex.tasks.workspace.map_cells import Answer
from armflex.tasks.workspace.tally import BITS, Tally

INF = float("inf")

ARRAYS = {
    "cell": Numbers(("cells",), "i8", least=0, most=(1 << 3 * BITS) - 1),
    "configurations": Numbers(("cells",), "i8", least=0),
    "answered": Numbers(("cells",), "i8", least=0),
    "refused": Numbers(("cells", len(NO_ANSWER)), "i8", least=0),
    "total": Numbers(("cells",), least=0.0),
    "worst": Numbers(("cells",), least=0.0, beside=(-INF,)),
    "payload": Numbers(("cells",), "i8", least=0),
    "q": Numbers(("cells", "joints")),
    "worst_of_draws": Numbers(("cells",), least=0.0, beside=(INF, -INF)),
}


def form_of(joints: int, payloads: int) -> Form[Answer]:
    """Return how the chunks of an arm of so many joints, carrying so many payloads in turn, become files."""
    layout = Layout(
        "a chunk of a workspace map", "armflex-map-chunk-4", ARRAYS, {"flags": list[Flag]}, {"joints": (joints,)}
    )

    def made(about: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Answer:
        tally = Tally(**arrays)
        _check(tally, int(about["piece"].rpartition("-")[2]), payloads)
        return Answer(tally, tuple(about["flags"]))

    return Form(layout, _told, made)


def _told(answer: Answer) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    arrays = {field.name: getattr(answer.tally, field.name) for field in fields(Tally)}
    return {"flags": [asdict(flag) for flag in answer.flags]}, arrays


def _check(tally: Tally, rows: int, payloads: int) -> None:
    """Raise `ValueError` where the columns of a tally of so many rows and payloads do not go together."""
    asked, some = rows * payloads, tally.answered > 0
    if not (len(tally) and (np.diff(tally.cell) > 0).all() and (tally.payload < payloads).all()):
        raise ValueError("its cells are not in order, or a payload is not among those asked for")
    answered = tally.answered.sum() + tally.refused.sum()
    if tally.configurations.sum() != rows or answered != asked or (np.isfinite(tally.worst) != some).any():
        raise ValueError(f"{asked} questions are not as many as were answered and refused")
    if (tally.total > tally.answered * np.where(some, tally.worst, 0.0) * (1.0 + 1e-9)).any():
        raise ValueError("a mean is above the largest")
