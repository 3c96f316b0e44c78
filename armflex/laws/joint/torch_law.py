"""A user's own `torch.nn.Module` as a law. torch is imported only when the law is asked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from armflex.conventions import Array
from armflex.errors import LawError
from armflex.laws.law import Row, WithoutParameters, embed

if TYPE_CHECKING:
    import torch


@dataclass(frozen=True)
class TorchLaw(WithoutParameters):
    """A module that takes (N, k) scaled loads to (N, k) scaled twists, each row by itself.

    The module is put into evaluation mode, so that dropout and batch statistics stay out of the answers. Torch laws
    have no file of armflex: save the module's own weights.

    Attributes:
        module: Of any floating type; the law computes in that of its first parameter, or in 64 bits.
        size: Number of components k, 3 or 6.
        load_scale: What the module's loads are multiples of [N, Nm]: a number or (k,).
        twist_scale: What its twists are multiples of [m, rad]: a number or (k,).
        noise: (k,) standard deviation of a measured deflection [m, rad], or None.
        seen: (2, k) smallest and largest load in training [N, Nm], or None.

    Raises:
        LawError: The module does not take or give k components.
    """

    module: torch.nn.Module
    size: int = 3
    load_scale: float | Array = 1.0
    twist_scale: float | Array = 1.0
    noise: Array | None = None
    seen: Array | None = None

    def __post_init__(self) -> None:
        if self.size not in (3, 6):
            raise LawError(f"a law has 3 or 6 components, not {self.size}")
        self.module.eval()
        try:
            shape = self._answers(np.zeros((2, self.size))).shape
        except (RuntimeError, ValueError) as error:
            raise LawError(f"the module does not take loads of shape {(2, self.size)}: {error}") from None
        if shape != (2, self.size):
            raise LawError(f"the module gives {shape} for loads of shape {(2, self.size)}")

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the (..., 6) twist, zero in components that the module does not have."""
        load = np.asarray(wrench)[..., : self.size]
        twist = np.zeros((*load.shape[:-1], 6))
        twist[..., : self.size] = self._answers(load.reshape(-1, self.size)).reshape(load.shape)
        return twist

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return the (..., 6, 6) derivative of `twist`, by automatic differentiation."""
        load, k = np.asarray(wrench)[..., : self.size], self.size
        tangent = np.zeros((*load.shape[:-1], 6, 6))
        tangent[..., :k, :k] = self._slopes(load.reshape(-1, k)).reshape(*load.shape, k)
        return tangent

    def scatter(self, wrench: Array, row: Row) -> Array | None:
        """Return the noise, None where it was not given."""
        return None if self.noise is None else embed(np.diag(np.square(self.noise)))

    @property
    def trained_on(self) -> Array | None:
        """The loads of its training, where they were given."""
        return self.seen

    def digested(self) -> object:
        """Return what the law says, for `digest`: classes, settings and weights of the module, and the scales."""
        import torch

        plain = vars(torch.nn.Module()).keys()
        parts = [
            (name, type(part), {key: value for key, value in vars(part).items() if key not in plain})
            for name, part in self.module.named_modules()
        ]
        weights = {
            name: (str(value.dtype), np.array(value.detach().cpu().tolist()))
            for name, value in self.module.state_dict().items()
        }
        return parts, weights, self.size, self.load_scale, self.twist_scale, self.noise, self.seen

    def _answers(self, loads: Array) -> Array:
        """Return the (N, k) twists under (N, k) loads."""
        import torch

        with torch.no_grad():
            return self._asked(self.module, loads) * self.twist_scale

    def _slopes(self, loads: Array) -> Array:
        """Return the (N, k, k) derivatives of the twists."""
        from torch.func import jacrev, vmap

        def single(load: torch.Tensor) -> torch.Tensor:
            return self.module(load[None])[0]

        slopes = self._asked(vmap(jacrev(single)), loads)
        return slopes * np.broadcast_to(self.twist_scale, self.size)[:, None] / self.load_scale

    def _asked(self, function: Callable[[Any], Any], loads: Array) -> Array:
        import torch

        parameter = next(self.module.parameters(), None)
        kind = torch.float64 if parameter is None else parameter.dtype
        place = None if parameter is None else parameter.device
        scaled = torch.as_tensor(loads / self.load_scale, dtype=kind, device=place)
        return function(scaled).detach().cpu().numpy().astype(np.float64)
