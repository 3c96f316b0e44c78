"""The joint deformation models that can be learned, by name, each made with its options."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from numbers import Integral

from armflex.bench.fit_linear import fit_compliance
from armflex.bench.fitted import Fitted, Learner
from armflex.bench.model_choice import Rival
from armflex.conventions import Array
from armflex.errors import InputError, UnknownNameError
from armflex.laws.joint.module_source import module_source
from armflex.laws.joint.structural import StructuralLaw

FOUND = "found"
"""Features that are found in the data; see `armflex.bench.fit_terms`."""

SAMPLERS = ("closed-form", "laplace", "nuts", "metropolis")


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
        sampler: How a posterior is found: "metropolis" for linear and bayesian, "laplace" or "nuts" for bayesian.
        seed: Of everything random.
        allow_unconverged: Take a chain that has not converged, and say so, rather than refuse it.
        assembly: The structure whose sub-joints a structural model fits.
        module: "FILE.py:CLASS" or "package.module:CLASS", whose class, called without arguments, makes the module of a
            torch model. Its code is run.

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
    module: str | None = None

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
    "sampler": ("linear", "bayesian"),
    "allow_unconverged": ("linear", "bayesian"),
    "assembly": ("structural",),
    "module": ("torch",),
}
"""Option -> the models that it concerns; one that is not here concerns all."""


def learner(model: str, options: Options) -> Learner:
    """Return the function that learns a model from loads and deflections.

    Raises:
        UnknownNameError: No such model.
        InputError: The options do not go with it.
    """
    if model not in LEARNERS:
        raise UnknownNameError("joint deformation model to train", model, (*LEARNERS, "auto"))
    return LEARNERS[model](options)


def _linear(options: Options) -> Learner:
    if options.sampler in (None, "closed-form"):
        return lambda loads, deflections, seed: _in_closed_form(loads, deflections, options.structure)
    _one_of(options.sampler, ("closed-form", "metropolis"), "linear")

    def learn(loads: Array, deflections: Array, seed: int) -> Fitted:
        from armflex.bench.paper.linear_chain import fit_linear_chain

        return fit_linear_chain(
            loads, deflections, options.structure, seed=seed, allow_unconverged=options.allow_unconverged
        )

    return learn


def _in_closed_form(loads: Array, deflections: Array, structure: str) -> Fitted:
    found = fit_compliance(loads, deflections, structure)
    parameters = {"structure": structure, "compliance": found.compliance.tolist(), "unit": "m/N, rad/Nm"}
    return Fitted(found.law(loads), parameters)


def _polynomial(options: Options) -> Learner:
    if FOUND in options.features:
        if tuple(options.features) != (FOUND,):
            raise InputError(f"features {', '.join(options.features)}: {FOUND!r} looks for all terms, give it alone")
        from armflex.bench.fit_terms import fit_terms

        return fit_terms
    from armflex.bench.fit_polynomial import learner as polynomial

    return polynomial(options.features)


def _structural(options: Options) -> Learner:
    from armflex.bench.fit_structural import fit_structural

    assembly = options.assembly
    if assembly is None:
        raise InputError("a structural model needs its assembly: nodes, sub-joints and beams, as in an arm.toml")
    return lambda loads, deflections, seed: fit_structural(loads, deflections, assembly)


def _neural(options: Options) -> Learner:
    from armflex.bench.fit_network import fit_network

    _one_of(options.prior, ("evidence", "none"), "neural")
    prior = None if options.prior == "none" else options.prior
    return lambda loads, deflections, seed: fit_network(
        loads, deflections, options.neurons, starts=options.starts, seed=seed, prior=prior
    )


def _bayesian(options: Options) -> Learner:
    from armflex.bench.fit_bayesian import fit_bayesian

    return lambda loads, deflections, seed: fit_bayesian(
        loads,
        deflections,
        options.neurons,
        sampler=options.sampler or "laplace",
        seed=seed,
        allow_unconverged=options.allow_unconverged,
    )


def _torch(options: Options) -> Learner:
    from armflex.bench.fit_torch import fit_torch

    if options.module is None:
        raise InputError("a torch model needs its module: FILE.py:CLASS, or package.module:CLASS")
    source = module_source(options.module)
    return lambda loads, deflections, seed: fit_torch(loads, deflections, source, options.starts, seed)


def _one_of(value: str, known: tuple[str, ...], model: str) -> None:
    if value not in known:
        raise UnknownNameError(f"option of a {model} model", value, known)


LEARNERS: dict[str, Callable[[Options], Learner]] = {
    "linear": _linear,
    "polynomial": _polynomial,
    "structural": _structural,
    "neural": _neural,
    "bayesian": _bayesian,
    "torch": _torch,
}
"""Model name -> its learner, given options."""

MODELS = (*LEARNERS, "auto")


def rivals(options: Options) -> tuple[Rival, ...]:
    """Return what `auto` chooses among, the plainest first."""
    ladder = [
        ("linear, diagonal", "linear", replace(options, structure="diagonal", sampler=None)),
        ("linear, symmetric", "linear", replace(options, structure="symmetric", sampler=None)),
        ("linear, full", "linear", replace(options, structure="full", sampler=None)),
        ("full + radial", "polynomial", replace(options, features=("radial",))),
        ("full + radial + magnitude", "polynomial", replace(options, features=("radial", "magnitude"))),
        ("terms as found", "polynomial", replace(options, features=(FOUND,))),
        ("quadratic", "polynomial", replace(options, features=("quadratic",))),
    ]
    plain = [Rival(name, model, learner(model, chosen)) for name, model, chosen in ladder]
    name, neurons = f"network of {options.neurons}", replace(options, prior="evidence")

    def network(loads: Array, deflections: Array, seed: int) -> Fitted:
        starts = affordable_starts(neurons, deflections.size)
        return learner("neural", replace(neurons, starts=starts))(loads, deflections, seed)

    return (*plain, Rival(name, "neural", network))


def affordable_starts(options: Options, numbers: int) -> int:
    """Return from how many starts `auto` trains a network on so many numbers: one for each that a neuron has.

    With fewer numbers than weights the prior decides, and maxima differ in little but the evidence's last digit.
    """
    return min(options.starts, max(1, numbers // options.neurons))
