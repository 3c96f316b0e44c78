"""A trained law in a file, see `storage.array_file`.

Arrays are SI; the units of the data they came from are kept in the metadata. A file is data: nothing in it is run.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, NamedTuple

import numpy as np

from armflex.arguments import checked_kinds
from armflex.conventions import Array
from armflex.errors import LawError, ModelFileError, Place, UnknownNameError
from armflex.laws.joint import linear, network, perceptron, polynomial, structural
from armflex.laws.law import Law
from armflex.storage.array_file import Layout, read_arrays, write_arrays
from armflex.storage.schema import Numbers


@dataclass(frozen=True)
class TrainedLaw:
    """A law and where it came from.

    Attributes:
        law: The law itself.
        model: Its name, a key of `FORMS`.
        metadata: Provenance: data hash, units, rows, versions, held-out error.
    """

    law: Law
    model: str
    metadata: Mapping[str, Any]


@checked_kinds
def save_law(trained: TrainedLaw, path: str | Path) -> Path:
    """Write a trained law whole or not at all, the same bytes for the same law; return the path.

    Raises:
        UnknownNameError: The model has no file form.
    """
    if trained.model not in FORMS:
        raise UnknownNameError("model with a file form", trained.model, FORMS)
    path, arrays = Path(path), FORMS[trained.model].to_tensors(trained.law)
    write_arrays(path, LAYOUT, arrays, {"model": trained.model, "metadata": dict(trained.metadata)})
    return path


@checked_kinds
def load_law(path: str | Path) -> TrainedLaw:
    """Read a trained law.

    Raises:
        ModelFileError: Missing, too large, damaged, not a law of armflex, or of a model this version does not know.
    """
    path = Path(path)
    about, arrays, _ = read_arrays(path, LAYOUT)
    try:
        return TrainedLaw(FORMS[about["model"]].from_tensors(arrays), about["model"], about["metadata"])
    except LawError as error:
        problem = f"does not hold {LAYOUT.what}: {error}; {LAYOUT.anew}"
        raise ModelFileError(Place(path), problem) from None


class Form(NamedTuple):
    """How the arrays of a model are written and read, and what they are declared to be."""

    to_tensors: Callable[[Any], Mapping[str, np.ndarray]]
    from_tensors: Callable[[Mapping[str, Array]], Law]
    arrays: Mapping[str, Numbers]
    sizes: Mapping[str, Collection[int]]


def _form(module: ModuleType) -> Form:
    """Return the form of a law that stands in a module of its own."""
    return Form(module.to_tensors, module.from_tensors, module.ARRAYS, module.SIZES)


FORMS = {
    "linear": _form(linear),
    "polynomial": _form(polynomial),
    "structural": _form(structural),
    "neural": _form(network),
    "bayesian": _form(network),
    "torch": _form(perceptron),
}
"""Model name -> its file form."""


def _arrays(about: Mapping[str, Any]) -> Mapping[str, Numbers]:
    """Return what a file must hold; raise `ValueError` where it names code, as files of modules did."""
    if isinstance(code := about["metadata"].get("module"), Mapping):
        source = f"{code.get('file')}:{code.get('class')}"
        text = f"its class stands in Python code, {source}, and no file runs code any more"
        raise ValueError(f"{text}: a torch.nn.Sequential is kept as layers and weights; {perceptron.IN_PYTHON}")
    return FORMS[about["model"]].arrays


LAYOUT = Layout(
    "a law of armflex",
    "armflex-law-1",
    arrays=_arrays,
    about={"model": Literal[tuple(FORMS)], "metadata": dict[str, Any]},
    sizes=lambda about: FORMS[about["model"]].sizes,
    anew="train it anew",
    error=ModelFileError,
)
