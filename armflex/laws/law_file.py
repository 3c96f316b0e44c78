"""A trained law in a file, see `storage.array_file`.

Arrays are SI; the units of the data they came from are kept in the metadata. Only a law of the model "torch" needs
torch to load: its file names a Python file of the user's own, which is run where it is trusted; see `storage.trust`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, NamedTuple

from armflex.arguments import checked_kinds
from armflex.conventions import Array
from armflex.errors import InputError, LawError, ModelFileError, Place, UnknownNameError, UntrustedError
from armflex.laws.joint import linear, network, polynomial, structural, torch_law
from armflex.laws.law import Law
from armflex.storage.array_file import Layout, read_arrays, write_arrays
from armflex.storage.schema import Numbers
from armflex.storage.trust import trusting


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
    form, path = FORMS[trained.model], Path(path)
    metadata = {**trained.metadata, **form.said(trained.law, path.parent)}
    write_arrays(path, LAYOUT, form.to_tensors(trained.law), {"model": trained.model, "metadata": metadata})
    return path


@checked_kinds
def load_law(path: str | Path, *, trust: Sequence[str | Path] | str | Path = ()) -> TrainedLaw:
    """Read a trained law.

    Args:
        path: The file. A law of the model "torch" names a Python file, which is run.
        trust: Files that may run, or their digests, beside those that `armflex trust` keeps and those whose class this
            process has trained.

    Raises:
        ModelFileError: Missing, too large, damaged, not a law of armflex, or of a model this version does not know; or
            the code of its module is missing, has changed since, or fails, or torch is not installed.
        UntrustedError: The code of its module may not run.
    """
    path = Path(path)
    about, arrays, _ = read_arrays(path, LAYOUT)
    form, metadata = FORMS[about["model"]], about["metadata"]
    try:
        with trusting(trust):
            law = form.from_tensors(arrays, metadata, path.parent) if form.runs_code else form.from_tensors(arrays)
        return TrainedLaw(law, about["model"], metadata)
    except UntrustedError:
        raise
    except LawError as error:
        problem = f"does not hold {LAYOUT.what}: {error}; {LAYOUT.anew}"
        raise ModelFileError(Place(path), problem) from None
    except InputError as error:  # of the code that it runs
        raise ModelFileError(Place(path), str(error)) from None


class Form(NamedTuple):
    """How the arrays of a model are written and read, and what they are declared to be.

    Where `runs_code`, the arrays depend on the file's metadata, `said` of a law and the file's folder adds to these,
    and a law is read from arrays, metadata and folder.
    """

    to_tensors: Callable[[Any], dict[str, Array]]
    from_tensors: Callable[..., Law]
    arrays: Mapping[str, Numbers] | Callable[[Mapping[str, Any]], Mapping[str, Numbers]]
    sizes: Mapping[str, Collection[int]]
    said: Callable[[Any, Path], dict[str, Any]] = lambda law, folder: {}
    runs_code: bool = False


def _form(module: ModuleType) -> Form:
    """Return the form of a law that stands in a module of its own."""
    return Form(module.to_tensors, module.from_tensors, module.ARRAYS, module.SIZES)


FORMS = {
    "linear": _form(linear),
    "polynomial": _form(polynomial),
    "structural": _form(structural),
    "neural": _form(network),
    "bayesian": _form(network),
    "torch": Form(
        torch_law.to_tensors,
        torch_law.from_tensors,
        torch_law.arrays_of,
        torch_law.SIZES,
        torch_law.said_of,
        runs_code=True,
    ),
}
"""Model name -> its file form."""


def _arrays(about: Mapping[str, Any]) -> Mapping[str, Numbers]:
    declared = FORMS[about["model"]].arrays
    return declared(about["metadata"]) if callable(declared) else declared


LAYOUT = Layout(
    "a law of armflex",
    "armflex-law-1",
    arrays=_arrays,
    about={"model": Literal[tuple(FORMS)], "metadata": dict[str, Any]},
    sizes=lambda about: FORMS[about["model"]].sizes,
    anew="train it anew",
    error=ModelFileError,
)
