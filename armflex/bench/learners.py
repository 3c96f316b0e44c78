"""The joint deformation models that can be learned, by name, each made with its options."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from numbers import Integral
from typing import Any

from armflex.bench.cross_validation import ModelCandidate
from armflex.bench.fit_linear import STRUCTURES, fit_compliance, fit_polynomial, fit_terms
from armflex.bench.fitted import Fitted, Learner
from armflex.conventions import Array
from armflex.errors import InputError, UnknownNameError
from armflex.laws.joint.structural import StructuralLaw

FOUND = "found"
"""Features that are found in the data; see `armflex.bench.fit_linear.fit_terms`."""

SAMPLERS = ("laplace", "nuts", "metropolis")


@dataclass(frozen=True)
class Options:
    """What a model is learned with; each model takes what concerns it.

    Attributes:
        structure: Of a linear model: "full", "symmetric" or "diagonal".
        features: Of a polynomial model; see `armflex.laws.joint.polynomial.features_of`. "found" looks for them. A text
            holds several joined by "+".
        neurons: Hidden neurons of a network.
        starts: Trainings from different weights, the best of which is kept; see `affordable_starts` for "auto".
        prior: "evidence" weighs a network's weights by a Gaussian prior, "none" is the paper's plain training.
        sampler: How a network's posterior is found: "laplace" when not given, "nuts" or "metropolis".
        seed: Of everything random.
        allow_unconverged: Take a chain that has not converged, and say so, rather than refuse it.
        assembly: The structure whose sub-joints a structural model fits.
        module: Makes the `torch.nn.Sequential` of a torch model when it is called: a class or a function.

    Raises:
        InputError: A number is not a whole one, or below the least that it may be.
    """

    structure: str = "full"
    features: tuple[str, ...] = ("radial", "magnitude")
    neurons: int = 20
    starts: int = 10
    prior: str = "evidence"
    sampler: str | None = None
    seed: int = 0
    allow_unconverged: bool = False
    assembly: StructuralLaw | None = None
    module: Callable[[], Any] | None = None

    def __post_init__(self) -> None:
        for name, least in (("neurons", 1), ("starts", 1), ("seed", 0)):
            value = getattr(self, name)
            if not isinstance(value, Integral) or value < least:
                raise InputError(f"{name} {value!r}: expected a whole number from {least}")
            object.__setattr__(self, name, int(value))
        if isinstance(self.features, str):
            object.__setattr__(self, "features", tuple(name.strip() for name in self.features.split("+")))


CONCERNS = {
    "structure": ("linear",),
    "features": ("polynomial",),
    "neurons": ("neural", "bayesian", "auto"),
    "starts": ("neural", "torch", "auto"),
    "prior": ("neural",),
    "sampler": ("bayesian",),
    "allow_unconverged": ("bayesian",),
    "assembly": ("structural",),
    "module": ("torch",),
}
"""Option -> the models that it concerns; one that is not here concerns all."""

NEEDS = (
    ("structural", "assembly", "nodes, sub-joints and beams, as in an arm.toml"),
    ("torch", "module", "a class that makes a torch.nn.Sequential"),
)
"""Models that need an option, which one, and what it is."""

MODELS = ("linear", "polynomial", "structural", "neural", "bayesian", "torch", "auto")


def learner(model: str, options: Options) -> Learner:
    """Return the function that learns a model from loads and deflections; raise for no such model or options.

    What needs SciPy or torch is imported here, where somebody asks for it.
    """
    for option, text in [need for of, *need in NEEDS if of == model and getattr(options, need[0]) is None]:
        raise InputError(f"a {model} model needs its {option}: {text}")
    match model:
        case "linear":
            return lambda loads, deflections, seed: _compliance(loads, deflections, options.structure)
        case "polynomial" if tuple(options.features) == (FOUND,):
            return fit_terms
        case "polynomial" if FOUND in options.features:
            given = ", ".join(options.features)
            raise InputError(f"features {given}: {FOUND!r} looks for all terms, give it alone")
        case "polynomial":
            return lambda loads, deflections, seed: _polynomial(loads, deflections, options.features)
        case "structural":
            from armflex.bench.fit_structural import fit_structural

            assembly: Any = options.assembly
            return lambda loads, deflections, seed: fit_structural(loads, deflections, assembly)
        case "neural":
            from armflex.bench.fit_network import fit_network

            _one_of(options.prior, ("evidence", "none"), model)
            prior = None if options.prior == "none" else options.prior
            return lambda loads, deflections, seed: fit_network(
                loads, deflections, options.neurons, options.starts, seed, prior
            )
        case "bayesian":
            from armflex.bench.fit_bayesian import fit_bayesian

            sampler = options.sampler or "laplace"
            return lambda loads, deflections, seed: fit_bayesian(
                loads, deflections, options.neurons, sampler, seed, allow_unconverged=options.allow_unconverged
            )
        case "torch":
            from armflex.bench.fit_torch import fit_torch

            make: Any = options.module
            return lambda loads, deflections, seed: fit_torch(loads, deflections, make, options.starts, seed)
    raise UnknownNameError("joint deformation model to train", model, MODELS)


def _compliance(loads: Array, deflections: Array, structure: str) -> Fitted:
    fit = fit_compliance(loads, deflections, structure)
    parameters = {"structure": structure, "compliance": fit.compliance.tolist(), "unit": "m/N, rad/Nm"}
    return Fitted(fit.law(loads), parameters)


def _polynomial(loads: Array, deflections: Array, features: tuple[str, ...]) -> Fitted:
    law = fit_polynomial(loads, deflections, features)
    coefficients = dict(zip(law.features, law.coefficients.tolist(), strict=True))
    units = "m, rad per N, Nm or their product"
    return Fitted(law, {"features": list(law.features), "coefficients": coefficients, "unit": units})


def _one_of(value: str | None, allowed: tuple[str, ...], model: str) -> None:
    if value not in allowed:
        raise UnknownNameError(f"option of a {model} model", str(value), allowed)


def candidates(options: Options) -> tuple[ModelCandidate, ...]:
    """Return what `auto` chooses among, the plainest first."""
    ladder = [
        *((f"linear, {each}", "linear", {"structure": each}) for each in reversed(STRUCTURES)),
        ("full + radial", "polynomial", {"features": ("radial",)}),
        ("full + radial + magnitude", "polynomial", {"features": ("radial", "magnitude")}),
        ("terms as found", "polynomial", {"features": (FOUND,)}),
        ("quadratic", "polynomial", {"features": ("quadratic",)}),
    ]
    plain = [
        ModelCandidate(name, model, learner(model, replace(options, **changed))) for name, model, changed in ladder
    ]

    def network(loads: Array, deflections: Array, seed: int) -> Fitted:
        starts = affordable_starts(options, deflections.size)
        return learner("neural", replace(options, prior="evidence", starts=starts))(loads, deflections, seed)

    return (*plain, ModelCandidate(f"network of {options.neurons}", "neural", network))


def affordable_starts(options: Options, numbers: int) -> int:
    """Return from how many starts `auto` trains a network on so many numbers: one for each that a neuron has.

    With fewer numbers than weights the prior decides, and maxima differ in little but the evidence's last digit.
    """
    return min(options.starts, max(1, numbers // options.neurons))
