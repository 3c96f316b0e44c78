"""A user's own `torch.nn.Module` as a law. torch is imported only when a law is made.

The module f takes scaled loads to scaled twists, and what it gives without a load is taken off, for a joint does not
move where nothing pulls at it:

    twist(w) = s (f((w - m) / l) - f(-m / l)),    m, l mean and scale of the loads, s scale of the twists.

Everything is computed in 64 bits on the CPU, by a copy of the module in evaluation mode: dropout and batch statistics
stay out of the answers. Derivatives are those of automatic differentiation.

No law of safetensors holds code: a file has the weights, and says where the class stands; see `module_source`.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from armflex.conventions import Array
from armflex.errors import LawError, NotFiniteError, UnsupportedError
from armflex.laws.joint.module_source import ModuleSource
from armflex.laws.law import Row, WithoutParameters, check_ordered, embed
from armflex.storage.schema import LARGEST, Numbers, check_arrays, typed

if TYPE_CHECKING:
    import torch

WEIGHT = "module."
"""What the names of a module's weights begin with in a file."""

CHECKED = 4
"""Scaled loads under which a module is looked at before it is a law."""

STEP = 1e-5
"""Of scaled loads, in differences."""

FAILURES = (RuntimeError, ValueError, TypeError, IndexError, KeyError, AttributeError, AssertionError)
FAILURES += (NotImplementedError, ArithmeticError)
"""What a module's code raises where it cannot answer."""


@dataclass(frozen=True)
class TorchLaw(WithoutParameters):
    """A module that takes (N, k) scaled loads to (N, k) scaled twists, each row by itself; see the head of this module.

    Attributes:
        module: Copied, and converted to 64 bits.
        size: Number of components k, 3 or 6.
        load_scale: What the module's loads are multiples of [N, Nm]: a number or (k,).
        twist_scale: What its twists are multiples of [m, rad]: a number or (k,).
        noise: (k,) standard deviation of a measured deflection [m, rad], as held-out rows had it; None if not known.
        seen: (2, k) smallest and largest load in training [N, Nm], or None.
        load_mean: Load that the module sees as zero [N, Nm]: a number or (k,).
        source: Where its class stands; None where the module was given, which has no file then.

    Raises:
        LawError: The module does not take or give k components in 64 bits, gives something that is not finite, not
            twice the same, or depends on the other rows, or cannot be differentiated twice.
        UnsupportedError: torch is not installed.
    """

    module: torch.nn.Module
    size: int = 3
    load_scale: float | Array = 1.0
    twist_scale: float | Array = 1.0
    noise: Array | None = None
    seen: Array | None = None
    load_mean: float | Array = 0.0
    source: ModuleSource | None = None

    def __post_init__(self) -> None:
        if self.size not in (3, 6):
            raise LawError(f"a law has 3 or 6 components, not {self.size}")
        object.__setattr__(self, "module", as_answering(self.module).requires_grad_(False))
        check_module(self.module, self.size)

    def __reduce__(self) -> str | tuple[Any, ...]:
        """Send a law with a source to another process as its file would be kept: the class is made anew there."""
        if self.source is None:
            return super().__reduce__()
        return _again, (self.source, to_tensors(self))

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the (..., 6) twist, zero in components that the module does not have.

        Raises:
            NotFiniteError: The module gives no number.
        """
        import torch

        load = np.asarray(wrench)[..., : self.size]
        with torch.no_grad():
            found = self.module(self._scaled(load)).numpy()
        return embed(self._finite(self.twist_scale * (found - self._unloaded).reshape(load.shape), load), axes=1)

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return the (..., 6, 6) derivative of `twist`, by automatic differentiation."""
        load, k = np.asarray(wrench)[..., : self.size], self.size
        slopes = jacobian(self.module, self._scaled(load)).numpy().reshape(*load.shape, k)
        slopes = slopes * np.broadcast_to(self.twist_scale, k)[:, None] / self.load_scale
        return embed(self._finite(slopes, load))

    def scatter(self, wrench: Array, row: Row) -> Array | None:
        return None if self.noise is None else embed(np.diag(np.square(self.noise)))

    def widening(self, wrench: Array, row: Row) -> Array | float:
        """Return the square of how far out the load is beyond those trained on: a module says nothing there."""
        if self.seen is None:
            return 1.0
        low, high = self.seen
        out = np.abs(2.0 * wrench[..., : self.size] - low - high) / np.maximum(high - low, 1.0 / LARGEST)
        return np.maximum(1.0, out.max(axis=-1)) ** 2

    @property
    def trained_on(self) -> Array | None:
        return self.seen

    def digested(self) -> object:
        """Return what the law says, for `digest`: classes, settings and weights of the module, and the scales."""
        import torch

        plain = vars(torch.nn.Module()).keys()
        parts = [
            (name, type(part), {key: value for key, value in vars(part).items() if key not in plain})
            for name, part in self.module.named_modules()
        ]
        weights = {name: (str(value.dtype), value.numpy()) for name, value in self.module.state_dict().items()}
        numbers = self.size, self.load_scale, self.twist_scale, self.noise, self.seen, self.load_mean
        return parts, weights, *numbers, self.source and (self.source.name, self.source.sha256)

    @cached_property
    def _unloaded(self) -> Array:
        """(k,) what the module gives without a load."""
        import torch

        with torch.no_grad():
            return self.module(self._scaled(np.zeros((1, self.size)))).numpy()[0]

    def _scaled(self, load: Array) -> torch.Tensor:
        """Return (..., k) loads as the (N, k) tensor that the module takes."""
        import torch

        scaled = (load.reshape(-1, self.size) - self.load_mean) / self.load_scale
        return torch.from_numpy(np.ascontiguousarray(scaled, dtype=np.float64))

    def _finite(self, block: Array, load: Array) -> Array:
        """Return what the module gives under a load; raise `NotFiniteError` where that is no number."""
        if not np.isfinite(block).all():
            raise NotFiniteError(f"{_called(self)} gives no number under a load of {load} N, Nm")
        return block


def _called(law: TorchLaw) -> str:
    return str(law.source) if law.source else f"the module {type(law.module).__name__}"


def the_torch() -> Any:
    """Return torch; raise `UnsupportedError` where it is not installed."""
    try:
        import torch
    except ImportError:
        raise UnsupportedError("a module as a law needs torch: pip install 'armflex[torch]'") from None
    return torch


def as_answering(module: Any) -> torch.nn.Module:
    """Return a copy of a module as a law asks it: in evaluation mode, in 64 bits, on the CPU.

    Raises:
        LawError: It is no module, or cannot be copied.
        UnsupportedError: torch is not installed.
    """
    torch = the_torch()
    if not isinstance(module, torch.nn.Module):
        raise LawError(f"expected a torch.nn.Module, got {type(module).__name__}")
    try:
        return copy.deepcopy(module).to("cpu").double().eval()
    except FAILURES as error:
        raise LawError(f"the module {type(module).__name__} cannot be copied to the CPU: {error}") from None


def check_module(module: torch.nn.Module, size: int) -> None:
    """Raise `LawError` where a module is not a function of (N, k) loads that can be differentiated twice."""
    import torch

    name = f"the module {type(module).__name__}"
    loads = torch.from_numpy(np.vstack([np.zeros(size), np.random.default_rng(0).normal(size=(CHECKED - 1, size))]))
    expected = f"expected torch.float64 of shape {tuple(loads.shape)}"
    try:
        with torch.no_grad():
            found, again, single = module(loads), module(loads), module(loads[1:2])
    except FAILURES as error:
        problem = str(error).partition("\n")[0]
        text = f"{name} does not take loads of shape {tuple(loads.shape)} in torch.float64 on the CPU: {problem}"
        raise LawError(text) from None
    if not isinstance(found, torch.Tensor):
        raise LawError(f"{name} gives {type(found).__name__}, {expected}")
    if tuple(found.shape) != tuple(loads.shape) or found.dtype != torch.float64 or found.device.type != "cpu":
        raise LawError(f"{name} gives {found.dtype} of shape {tuple(found.shape)} on {found.device}, {expected} on cpu")
    if not torch.isfinite(found).all():
        raise LawError(f"{name} gives numbers that are not finite at loads of order one, expected finite ones")
    if not torch.equal(found, again):
        raise LawError(f"{name} gives other numbers when called again, expected the same in evaluation mode")
    if not torch.allclose(found[1:2], single, rtol=1e-9, atol=1e-12):
        raise LawError(f"{name} gives a row other numbers beside other rows, expected each row by itself")

    # Automatic differentiation must give what differences of neighbouring loads say, and of neighbouring derivatives.
    here, steps = loads.clone().requires_grad_(True), STEP * torch.eye(loads.shape[1], dtype=loads.dtype)
    ends = [loads[1] + steps, loads[1] - steps]
    try:
        slopes = jacobian(module, here, twice=True)
        curved = torch.autograd.grad(slopes.sum(), here, allow_unused=True)[0] if slopes.requires_grad else None
        further = [jacobian(module, end).sum(dim=(1, 2)) for end in ends]
        with torch.no_grad():
            given = [module(end).T for end in ends]
    except FAILURES as error:
        problem = str(error).partition("\n")[0]
        raise LawError(f"{name} cannot be differentiated twice by its loads, expected so: {problem}") from None
    if not torch.isfinite(slopes).all():
        raise LawError(f"{name} has derivatives that are not finite at loads of order one, expected finite ones")
    twice = torch.zeros_like(loads) if curved is None else curved
    pairs = ("first", slopes[1].detach(), given), ("second", twice[1], further)
    for which, exact, (above, below) in pairs:
        numeric = (above - below) / (2.0 * STEP)
        if not torch.allclose(exact, numeric, rtol=1e-3, atol=1e-3 * max(float(numeric.abs().max()), 1e-6)):
            text = f"{which} derivatives by autograd that its numbers do not have, expected the same"
            raise LawError(f"{name} has {text}: is it cut off somewhere, as by detach, numpy or round?")


def jacobian(module: torch.nn.Module, loads: torch.Tensor, twice: bool = False) -> torch.Tensor:
    """Return the (N, k, k) derivative of what a module gives for (N, k) loads, each row by itself.

    Args:
        module: As `as_answering` returns it.
        loads: Scaled.
        twice: Whether the derivative is to be differentiated again.
    """
    import torch

    with torch.enable_grad():
        here = loads if loads.requires_grad else loads.detach().requires_grad_(True)
        given = module(here)
        if not given.requires_grad:
            raise RuntimeError("what it gives does not depend on them for autograd")
        rows = [
            torch.autograd.grad(column.sum(), here, retain_graph=True, create_graph=twice, allow_unused=True)[0]
            for column in given.unbind(dim=1)
        ]
    return torch.stack([torch.zeros_like(loads) if row is None else row for row in rows], dim=1)


SCALES = {
    "load_mean": Numbers(("k",)),
    "load_scale": Numbers(("k",), least=1.0 / LARGEST),
    "twist_scale": Numbers(("k",), least=1.0 / LARGEST),
    "noise": Numbers(("k",), least=0.0),
    "seen": Numbers((2, "k")),
}
SIZES = {"k": (3, 6)}


@dataclass(frozen=True)
class Weight:
    """A tensor of a module, as a file says it: its `shape`, and whether its numbers are whole."""

    shape: list[int]
    whole: bool


def arrays_of(metadata: Mapping[str, Any]) -> dict[str, Numbers]:
    """Return what a torch law's file holds; raise `ValueError` where it does not say what its module's weights are."""
    weights = typed(dict[str, Weight], (metadata.get("module") or {}).get("weights"), "metadata.module.weights")
    kinds = {True: {"kind": "i8", "least": -(2**63), "most": 2**63 - 1}, False: {}}
    return SCALES | {WEIGHT + name: Numbers(tuple(one.shape), **kinds[one.whole]) for name, one in weights.items()}


def said_of(law: TorchLaw, folder: Path) -> dict[str, Any]:
    """Return what a file in a folder says of a law's module: where its class stands, and what its weights are.

    Raises:
        LawError: The module was not made by a class that can be found again, or has weights of another kind.
    """
    if law.source is None:
        text = "no class is known that makes it: train it by --module FILE.py:CLASS"
        raise LawError(f"the module {type(law.module).__name__} cannot be written: {text}")
    weights = {}
    for name, value in law.module.state_dict().items():
        if value.is_complex():
            raise LawError(f"{law.source}: weight {name!r} is complex, expected real numbers")
        weights[name] = {"shape": list(value.shape), "whole": not value.is_floating_point()}
    return {"module": {**law.source.said(folder), "weights": weights}}


def to_tensors(law: TorchLaw) -> dict[str, Array]:
    """Return a law's scales and its module's weights as named arrays, for a file."""
    size = law.size
    numbers = {name: np.broadcast_to(getattr(law, name), size) for name in ("load_mean", "load_scale", "twist_scale")}
    arrays = {**numbers, "noise": law.noise, "seen": law.seen}
    if law.noise is None or law.seen is None:
        raise LawError(f"{_called(law)} was not trained by armflex: its noise and the observed loads are not known")
    for name, value in law.module.state_dict().items():
        kind = np.float64 if value.is_floating_point() else np.int64
        arrays[WEIGHT + name] = value.numpy().astype(kind)
    return {name: np.ascontiguousarray(value).reshape(np.shape(value)) for name, value in arrays.items()}


def from_tensors(tensors: Mapping[str, Array], metadata: Mapping[str, Any], folder: Path) -> TorchLaw:
    """Return the law that a file in a folder holds; runs the Python code that the file names.

    Raises:
        InputError: The code is not there, has changed, is not trusted, or fails; or weights do not fit what it makes.
    """
    said = metadata["module"]
    try:
        typed({"file": str, "class": str, "sha256": str, "weights": Any}, said, "metadata.module")
        check_arrays(tensors, arrays_of(metadata), SIZES)
    except ValueError as error:
        raise LawError(str(error)) from None
    source = ModuleSource((folder / said["file"]).resolve(), said["class"], said["sha256"])
    source.check()
    return _again(source, tensors)


def _again(source: ModuleSource, tensors: Mapping[str, Array]) -> TorchLaw:
    """Return the law of a class and of named arrays; runs the class's code.

    Raises:
        LawError: The class makes no module, or one with weights of other names or shapes.
    """
    check_ordered(tensors["seen"])
    torch, module = the_torch(), as_answering(source.made())
    weights = {name.removeprefix(WEIGHT): value for name, value in tensors.items() if name not in SCALES}
    own = module.state_dict()
    for name in sorted(own.keys() ^ weights.keys()):
        problem = "is not in the file" if name in own else f"is in the file, but {source} has none of that name"
        raise LawError(f"weights do not fit {source}: {name!r} {problem}")
    for name, value in own.items():
        if tuple(value.shape) != weights[name].shape:
            found = f"{weights[name].shape} in the file, {tuple(value.shape)} in {source}"
            raise LawError(f"weights do not fit {source}: {name!r} is of shape {found}")
    module.load_state_dict({name: torch.from_numpy(np.array(value)) for name, value in weights.items()})
    return TorchLaw(module, len(tensors["noise"]), source=source, **{name: tensors[name] for name in SCALES})
