"""A network of any depth as a law: linear layers with an activation after each, as a `torch.nn.Sequential` has them.

The network f takes scaled loads to scaled twists, and what it gives without a load is taken off, for a joint does not
move where nothing pulls at it:

    twist(w) = s (f((w - m) / l) - f(-m / l)),    m, l mean and scale of the loads, s scale of the twists.

A file holds layers and weights and no code. torch is needed to train such a network, and by nothing here but
`perceptron_of`, which is given a module.
"""

import copy
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from armflex.conventions import Array
from armflex.errors import LawError, NotFiniteError, UnsupportedError, listing
from armflex.laws.law import Ranges, Row, WithoutParameters, block_norms, check_ordered, embed
from armflex.laws.terms import Neurons, Term, Terms, straight
from armflex.storage.schema import LARGEST, Numbers, check_arrays


class Activation(NamedTuple):
    """A function of every neuron's net value.

    Attributes:
        value, slope: The function and its derivative.
        steepest: The largest size of the derivative.
    """

    value: Callable[[Array], Array]
    slope: Callable[[Array], Array]
    steepest: float


def _sigmoid(x: Array) -> Array:
    return 0.5 + 0.5 * np.tanh(0.5 * x)


def _silu_slope(x: Array) -> Array:
    return _sigmoid(x) * (1.0 + x * (1.0 - _sigmoid(x)))


def _normal(x: Array) -> Array:
    """Return the standard normal distribution function."""
    from scipy.special import ndtr

    return ndtr(x)


def _gelu_slope(x: Array) -> Array:
    return _normal(x) + x * np.exp(-0.5 * np.square(np.clip(x, -40.0, 40.0))) / np.sqrt(2.0 * np.pi)


LEAK = 0.01

ACTIVATIONS = {
    "Identity": Activation(lambda x: x, np.ones_like, 1.0),
    "Tanh": Activation(np.tanh, lambda x: 1.0 - np.tanh(x) ** 2, 1.0),
    "Sigmoid": Activation(_sigmoid, lambda x: _sigmoid(x) * (1.0 - _sigmoid(x)), 0.25),
    "ReLU": Activation(lambda x: np.maximum(x, 0.0), lambda x: (x > 0.0).astype(float), 1.0),
    "LeakyReLU": Activation(lambda x: np.where(x > 0.0, x, LEAK * x), lambda x: np.where(x > 0.0, 1.0, LEAK), 1.0),
    "ELU": Activation(
        lambda x: np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0))), lambda x: np.exp(np.minimum(x, 0.0)), 1.0
    ),
    "Softplus": Activation(lambda x: np.logaddexp(0.0, x), _sigmoid, 1.0),
    "SiLU": Activation(lambda x: x * _sigmoid(x), _silu_slope, 1.0999),
    "GELU": Activation(lambda x: x * _normal(x), _gelu_slope, 1.1290),
}
"""torch's name -> activation. Files have the place in this order: a new one stands last."""

NAMES = tuple(ACTIVATIONS)

IDLE = ("Dropout", "Identity")
"""Modules that do nothing when a law is asked."""

ARRAYS = {
    "widths": Numbers(("ends",), kind="i8", least=1, most=10_000),
    "activations": Numbers(("layers",), kind="i8", least=0, most=len(NAMES) - 1),
    "weights": Numbers(("weights",)),
    "load_mean": Numbers(("k",)),
    "load_scale": Numbers(("k",), least=1.0 / LARGEST),
    "twist_scale": Numbers(("k",), least=1.0 / LARGEST),
    "noise": Numbers(("k",), least=0.0),
    "seen": Numbers((2, "k")),
}
SIZES = {"k": (3, 6), "layers": range(1, 100), "weights": range(1, 10_000_000)}
"""Arrays of a law's file. `weights` has those of each layer behind one another, every output's own and its bias last;
a layer leads from one of `widths` to the next."""


@dataclass(frozen=True)
class Layer:
    """A linear layer and what follows it.

    Attributes:
        weight: (n, m).
        bias: (n,).
        activation: A key of `ACTIVATIONS`.
    """

    weight: Array
    bias: Array
    activation: str


@dataclass(frozen=True)
class PerceptronLaw(WithoutParameters):
    """A network that takes (k,) scaled loads to (k,) scaled twists; see the head of this module.

    Attributes:
        layers: The first takes k numbers, the last gives k.
        load_mean: (k,) load that the network sees as zero [N, Nm].
        load_scale: (k,) what its loads are multiples of [N, Nm].
        twist_scale: (k,) what its twists are multiples of [m, rad].
        noise: (k,) standard deviation of a measured deflection [m, rad], as held-out rows had it; None if not known.
        seen: (2, k) smallest and largest load in training [N, Nm], or None.

    Raises:
        LawError: Layers do not follow each other, or lead from and to other than the same 3 or 6 components.
    """

    layers: tuple[Layer, ...]
    load_mean: Array
    load_scale: Array
    twist_scale: Array
    noise: Array | None = None
    seen: Array | None = None

    def __post_init__(self) -> None:
        widths = [self.layers[0].weight.shape[1], *(len(layer.bias) for layer in self.layers)]
        for layer, shape in zip(self.layers, zip(widths[1:], widths, strict=False), strict=True):
            if layer.weight.shape != shape:
                raise LawError(f"a layer of shape {layer.weight.shape} does not follow one of {shape[1]} outputs")
        if widths[0] not in (3, 6) or widths[-1] != widths[0]:
            raise LawError(f"the network leads from {widths[0]} numbers to {widths[-1]}, expected 3 to 3 or 6 to 6")

    @property
    def size(self) -> int:
        """Number of components k, 3 or 6."""
        return len(self.layers[-1].bias)

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the (..., 6) twist, zero in components that the network does not have.

        Raises:
            NotFiniteError: The network gives no number.
        """
        load = np.asarray(wrench)[..., : self.size]
        twist = self.twist_scale * (self._given(load) - self._unloaded)
        if not np.isfinite(twist).all():
            raise NotFiniteError(f"the network gives no number under a load of {load} N, Nm")
        return embed(twist, axes=1)

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return the (..., 6, 6) analytic derivative of `twist`."""
        value = (np.asarray(wrench)[..., : self.size] - self.load_mean) / self.load_scale
        slope = np.diag(1.0 / self.load_scale)
        for layer in self.layers:
            net, activation = value @ layer.weight.T + layer.bias, ACTIVATIONS[layer.activation]
            slope = activation.slope(net)[..., None] * (layer.weight @ slope)
            value = activation.value(net)
        return embed(self.twist_scale[:, None] * slope)

    def compliance_bound(self, ranges: Ranges) -> Array:
        """Return the product of the layers' sizes, each neuron where it is steepest."""
        bound = np.diag(1.0 / self.load_scale)
        for layer in self.layers:
            bound = ACTIVATIONS[layer.activation].steepest * np.abs(layer.weight) @ bound
        return block_norms(embed(self.twist_scale[:, None] * bound))

    def terms(self) -> Terms:
        """Return the neurons of one hidden layer of tanh or sigmoids, or the compliance of no hidden layer.

        Raises:
            UnsupportedError: The network is deeper, or bends otherwise.
        """
        activations = [layer.activation for layer in self.layers]
        into, *others = self.layers
        units, bias = into.weight / self.load_scale, into.bias - into.weight @ (self.load_mean / self.load_scale)
        if activations == ["Identity"]:
            return (straight(embed(self.twist_scale[:, None] * units)),)
        if len(others) != 1 or activations[0] not in ("Tanh", "Sigmoid") or activations[1] != "Identity":
            said = listing([name for name in activations if name != "Identity"])
            raise UnsupportedError(f"is a network of {said}: only one hidden layer of Tanh or Sigmoid has a form in C")
        half = 1.0 if activations[0] == "Tanh" else 0.5  # a sigmoid is half a tanh of half of x, and 0.5
        gains = half * (self.twist_scale[:, None] * others[0].weight).T
        neurons = Neurons(embed(half * units, axes=1), half * bias, embed(gains, axes=1))
        return neurons, Term(-neurons.twist(np.zeros(6)))

    def scatter(self, wrench: Array, row: Row) -> Array | None:
        return None if self.noise is None else embed(np.diag(np.square(self.noise)))

    def widening(self, wrench: Array, row: Row) -> Array | float:
        """Return the square of how far out the load is beyond those trained on: a network says nothing there."""
        if self.seen is None:
            return 1.0
        low, high = self.seen
        out = np.abs(2.0 * wrench[..., : self.size] - low - high) / np.maximum(high - low, 1.0 / LARGEST)
        return np.maximum(1.0, out.max(axis=-1)) ** 2

    @property
    def trained_on(self) -> Array | None:
        return self.seen

    @cached_property
    def _unloaded(self) -> Array:
        """(k,) what the network gives without a load."""
        return self._given(np.zeros(self.size))

    def _given(self, load: Array) -> Array:
        """Return the (..., k) scaled twists under (..., k) loads."""
        return passed(self.layers, (load - self.load_mean) / self.load_scale)


def passed(layers: tuple[Layer, ...], value: Array) -> Array:
    """Return the (..., n) numbers that layers give for (..., m) numbers."""
    with np.errstate(over="ignore", invalid="ignore"):
        for layer in layers:
            value = ACTIVATIONS[layer.activation].value(value @ layer.weight.T + layer.bias)
    return value


def to_tensors(law: PerceptronLaw) -> dict[str, np.ndarray]:
    """Return the law as named arrays, for a file.

    Raises:
        LawError: Nobody says how well it was trained, and under which loads.
    """
    if law.noise is None or law.seen is None:
        raise LawError("the network was not trained by armflex: its noise and the observed loads are not known")
    scales = {name: getattr(law, name) for name in ("load_mean", "load_scale", "twist_scale", "noise", "seen")}
    weights = [np.column_stack([layer.weight, layer.bias]).ravel() for layer in law.layers]
    return {
        "widths": np.array([law.size, *(len(layer.bias) for layer in law.layers)], dtype=np.int64),
        "activations": np.array([NAMES.index(layer.activation) for layer in law.layers], dtype=np.int64),
        "weights": np.concatenate(weights),
        **{name: np.ascontiguousarray(value, dtype=np.float64) for name, value in scales.items()},
    }


def from_tensors(tensors: Mapping[str, Array]) -> PerceptronLaw:
    """Return the law that `to_tensors` wrote.

    Raises:
        LawError: An array is missing, unknown, of a wrong shape or kind, not finite, or not as long as `widths` say.
    """
    try:
        check_arrays(tensors, ARRAYS, SIZES)
    except ValueError as error:
        raise LawError(str(error)) from None
    check_ordered(tensors["seen"])
    widths, names = tensors["widths"].tolist(), [NAMES[i] for i in tensors["activations"]]
    if len(widths) != len(names) + 1:
        raise LawError(f"'widths' are {len(widths)} of {len(names)} layers, expected one more than layers")
    sizes = [out * (into + 1) for into, out in pairwise(widths)]
    if sum(sizes) != len(tensors["weights"]):
        raise LawError(f"'weights' are {len(tensors['weights'])}, expected the {sum(sizes)} of layers {widths}")
    blocks = np.split(tensors["weights"], np.cumsum(sizes)[:-1])
    tables = [block.reshape(out, -1) for block, out in zip(blocks, widths[1:], strict=True)]
    layers = [Layer(table[:, :-1], table[:, -1], name) for table, name in zip(tables, names, strict=True)]
    scales = {name: tensors[name] for name in ("load_mean", "load_scale", "twist_scale", "noise", "seen")}
    if widths[0] != len(scales["noise"]):
        raise LawError(f"'widths' begin with {widths[0]}, expected the {len(scales['noise'])} components of 'noise'")
    return PerceptronLaw(tuple(layers), **scales)


def perceptron_of(module: Any, size: int) -> tuple[Layer, ...]:
    """Return the layers of a `torch.nn.Sequential` of `Linear` layers and activations, in evaluation mode.

    Args:
        module: Such a module; those within it may be of the same form.
        size: Number of components k, 3 or 6, that it takes.

    Raises:
        LawError: It is something else, has settings of its own, or gives other numbers than its layers do.
    """
    import torch

    if not isinstance(module, torch.nn.Module):
        raise LawError(f"expected a torch.nn.Sequential of linear layers and activations, got {type(module).__name__}")
    module, layers = copy.deepcopy(module).to("cpu").double().eval(), list[Layer]()
    for part in _flat(module):
        kind = type(part).__name__
        if isinstance(part, torch.nn.Linear):
            weight = part.weight.detach().numpy().copy()
            bias = np.zeros(len(weight)) if part.bias is None else part.bias.detach().numpy().copy()
            if layers and layers[-1].activation == "Identity":
                before = layers.pop()
                weight, bias = weight @ before.weight, weight @ before.bias + bias
            layers.append(Layer(weight, bias, "Identity"))
        elif type(part) is getattr(torch.nn, kind, None) and kind in ACTIVATIONS:
            if not layers or layers[-1].activation != "Identity":
                width = len(layers[-1].bias) if layers else size
                layers.append(Layer(np.eye(width), np.zeros(width), "Identity"))
            layers[-1] = Layer(layers[-1].weight, layers[-1].bias, kind)
        else:
            modules = ["Linear", "Sequential", *NAMES, *IDLE]
            text = f"the module has a {kind}, which is no linear layer or activation"
            raise LawError(f"{text} (known: {', '.join(dict.fromkeys(modules))}); {IN_PYTHON}")
    _check_same(module, tuple(layers), size)
    return tuple(layers)


IN_PYTHON = "a law of another form is a Python object: a class derived from armflex.laws.Law, in a Flexure"


def _flat(module: Any) -> Iterator[Any]:
    """Yield what a module runs one after another, without what does nothing."""
    import torch

    if isinstance(module, torch.nn.Sequential) and type(module).forward is torch.nn.Sequential.forward:
        for part in module:
            yield from _flat(part)
    elif type(module).__name__ not in IDLE:
        yield module


def _check_same(module: Any, layers: tuple[Layer, ...], size: int) -> None:
    """Raise `LawError` where a module gives something else than its layers, as with hooks, or no (N, k) numbers."""
    import torch

    # Scaled loads of order one under which a module and its layers must give the same.
    loads = np.vstack([np.zeros(size), np.random.default_rng(0).normal(size=(15, size))])
    try:
        with torch.no_grad():
            given = module(torch.from_numpy(loads)).numpy()
    except RuntimeError as error:
        problem = str(error).partition("\n")[0]
        raise LawError(f"the module does not take loads of shape {loads.shape}: {problem}") from None
    if given.shape != loads.shape:
        raise LawError(f"the module gives numbers of shape {given.shape} for loads of shape {loads.shape}")
    if not np.isfinite(given).all():
        raise LawError("the module gives numbers that are not finite at loads of order one")
    # What they may differ by of the largest number given, since torch cuts softplus off where it is 2e-9
    if np.abs(passed(layers, loads) - given).max() > 1e-8 * max(np.abs(given).max(), 1.0):
        text = "the module gives other numbers than its linear layers and activations with their usual settings"
        raise LawError(f"{text}: has it hooks, or an activation with a setting of its own?")
