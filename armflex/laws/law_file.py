"""A trained law in a file: safetensors for the arrays, strict JSON metadata for the rest. Nothing is unpickled.

Needs no torch to load. Arrays are SI; the units of the data they came from are kept in the metadata.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from armflex.conventions import Array
from armflex.errors import LawError, ModelFileError, Place, UnknownNameError, did_you_mean
from armflex.laws import network, polynomial, structural_file
from armflex.laws.law import Law, check_shapes, embed
from armflex.laws.linear import LinearFit, LinearLaw
from armflex.whole_file import write_whole

KEY = "armflex"
FORMAT = "armflex-law-1"
MAX_BYTES = 256_000_000


@dataclass(frozen=True)
class TrainedLaw:
    """A law and where it came from.

    Attributes:
        law: The law itself.
        model: Its name, a key of `READERS`.
        metadata: Provenance: data hash, units, rows, versions, held-out error.
    """

    law: Law
    model: str
    metadata: Mapping[str, Any]


def save_law(trained: TrainedLaw, path: str | Path) -> Path:
    """Write a trained law whole or not at all, the same bytes for the same law; return the path.

    Raises:
        UnknownNameError: The model has no file form.
    """
    if trained.model not in WRITERS:
        raise UnknownNameError("model with a file form", trained.model, WRITERS)
    tensors = WRITERS[trained.model](trained.law)
    content = {"format": FORMAT, "model": trained.model, "metadata": trained.metadata}
    text = json.dumps(content | {"digest": _digest(tensors, content)}, allow_nan=False, sort_keys=True)
    return write_whole(Path(path), save(tensors, metadata={KEY: text}))  # several keys would come in any order


def load_law(path: str | Path) -> TrainedLaw:
    """Read a trained law.

    Raises:
        ModelFileError: Missing, too large, damaged, not a law of armflex, or of a model this version does not know.
    """
    path = Path(path)
    _check_size(path)
    try:
        with safe_open(path, framework="numpy") as file:
            content = _read_content(path, (file.metadata() or {}).get(KEY))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dict
    except (SafetensorError, OSError, TypeError, AttributeError) as error:  # the last two: a dtype numpy has not
        raise ModelFileError(Place(path), f"is not a readable safetensors file: {error}") from None
    try:
        _check_digest(tensors, content)
        return TrainedLaw(READERS[content["model"]](_floats(tensors)), content["model"], content["metadata"])
    except (KeyError, ValueError) as error:
        raise ModelFileError(Place(path), f"does not hold a {content['model']} law: {error}") from None


def _digest(tensors: Mapping[str, np.ndarray], content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of every array and of what is said about them."""
    whole = hashlib.sha256(json.dumps(content, sort_keys=True).encode())
    for name in sorted(tensors):
        tensor = tensors[name]
        whole.update(f"{name} {tensor.dtype.str} {tensor.shape} ".encode() + tensor.tobytes())
    return whole.hexdigest()


def _check_digest(tensors: Mapping[str, np.ndarray], content: Mapping[str, Any]) -> None:
    said = {name: value for name, value in content.items() if name != "digest"}
    if content.get("digest") != _digest(tensors, said):
        raise LawError("its SHA-256 is not that of its content: the file is damaged")


def _check_size(path: Path) -> None:
    try:
        size = path.stat().st_size
    except OSError as error:
        raise ModelFileError(Place(path), f"cannot be read: {error.strerror}") from None
    if size > MAX_BYTES:
        raise ModelFileError(Place(path), f"is {size} bytes, more than the {MAX_BYTES} allowed")


def _read_content(path: Path, text: str | None) -> dict[str, Any]:
    if text is None:
        raise ModelFileError(Place(path), f"is no law of armflex: no {KEY!r} in its header")
    try:
        content = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_once_each)
    except (ValueError, RecursionError) as error:
        raise ModelFileError(Place(path), f"header {KEY!r} is not strict JSON: {error}") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ModelFileError(Place(path), f"is no law of armflex: expected format {FORMAT!r}")
    model = content.get("model")
    if not isinstance(model, str) or model not in READERS:
        hint = did_you_mean(str(model), READERS)
        raise ModelFileError(Place(path), f"holds a {model!r} law, which is not known{hint}")
    if not isinstance(content.get("metadata"), dict):
        raise ModelFileError(Place(path), "has no metadata")
    return content


def _floats(tensors: Mapping[str, np.ndarray]) -> dict[str, Array]:
    for name, tensor in tensors.items():
        if tensor.dtype != np.float64 or not np.isfinite(tensor).all():
            raise LawError(f"{name!r} is not finite 64-bit floats")
    return dict(tensors)


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} in the metadata")


def _once_each(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a key is there twice")
    return found


def _write_linear(law: LinearLaw) -> dict[str, Array]:
    assert law.fit is not None
    size = len(law.fit.residual_std)
    arrays = {"compliance": law.compliance[:size, :size], **vars(law.fit)}
    return {name: np.ascontiguousarray(value) for name, value in arrays.items()}


def _read_linear(tensors: Mapping[str, Array]) -> LinearLaw:
    size = tensors["residual_std"].size
    shapes = {"compliance": (size, size), "row_covariance": (size,) * 3, "residual_std": (size,), "loads": (2, size)}
    if size not in (3, 6):
        raise LawError(f"'residual_std' has {size} numbers, expected 3 or 6")
    check_shapes(tensors, shapes)
    fit = LinearFit(tensors["row_covariance"], tensors["residual_std"], tensors["loads"])
    return LinearLaw(embed(tensors["compliance"]), fit=fit)


WRITERS: dict[str, Callable[[Any], dict[str, Array]]] = {
    "linear": _write_linear,
    "polynomial": polynomial.to_tensors,
    "structural": structural_file.to_tensors,
    "neural": network.to_tensors,
    "bayesian": network.to_tensors,
}
READERS: dict[str, Callable[[Mapping[str, Array]], Law]] = {
    "linear": _read_linear,
    "polynomial": polynomial.polynomial_from_tensors,
    "structural": structural_file.structural_from_tensors,
    "neural": network.network_from_tensors,
    "bayesian": network.network_from_tensors,
}
"""Model name -> how its arrays are written and read."""
