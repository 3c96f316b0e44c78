"""Joint data of a test bench that never was, and the laws that are trained on such."""

from pathlib import Path

import numpy as np

from armflex import train
from armflex.bench.fit_network import network_law
from armflex.bench.network_problem import scaled_problem
from armflex.laws.joint.network import NetworkLaw, weight_count
from armflex.laws.joint.perceptron import Layer, PerceptronLaw
from armflex.laws.joint.polynomial import PolynomialLaw, features_of
from armflex.laws.law_file import TrainedLaw
from armflex.measured.joint_data import JointData
from support.small_arms import random_compliance

SIX = "fx_N,fy_N,fz_N,mx_Nm,my_Nm,mz_Nm,dx_m,dy_m,dz_m,rx_rad,ry_rad,rz_rad"


def bench(size: int, rows: int, seed: int, noise: float = 0.0, structure: str = "full") -> tuple[JointData, np.ndarray]:
    """Return simulated joint data and the compliance behind it; `noise` is relative to each column's own size."""
    rng = np.random.default_rng(seed)
    compliance = random_compliance(seed)[:size, :size]
    if structure == "full":
        compliance = compliance + 0.1 * np.abs(compliance).max() * rng.normal(size=(size, size))
    if structure == "diagonal":
        compliance = np.diag(np.diag(compliance))
    loads = rng.normal(size=(rows, size)) * np.array([2e3] * 3 + [5e2] * 3)[:size]
    exact = loads @ compliance.T
    deflections = exact + noise * exact.std(axis=0) * rng.normal(size=exact.shape)
    units = ("m", "m", "m", "rad", "rad", "rad")[:size]
    return JointData(loads, deflections, units, np.ones(size), "0" * 64, Path("made.csv")), compliance


def write(folder: Path, header: str, rows: np.ndarray) -> Path:
    path = folder / "joint.csv"
    path.write_text("\n".join([header, *(",".join(map(repr, row)) for row in np.asarray(rows).tolist())]) + "\n")
    return path


LARGEST = np.array([2e3, 1e3, 2.5e3, 5e2, 5e2, 3e2])


def some_law(size: int, draws: int, seed: int = 0, neurons: int = 7, laplace: bool = False) -> NetworkLaw:
    rng = np.random.default_rng(seed)
    count = weight_count(size, neurons)
    loads = rng.uniform(-1.0, 1.0, size=(40, size)) * LARGEST[:size] + 0.1 * LARGEST[:size]
    _, scaling = scaled_problem(loads, 1e-3 * rng.normal(size=loads.shape), neurons)
    root = 0.01 * rng.normal(size=(count, count))
    noise = np.full(size, 0.01)
    return network_law(rng.normal(size=(draws, count)), noise, scaling, loads, root @ root.T if laplace else None)


def some_perceptron(size: int, *activations: str) -> PerceptronLaw:
    """Return a network of layers of five neurons with these activations."""
    rng, widths = np.random.default_rng(4), [size, *(5 for _ in activations), size]
    layers = [
        Layer(0.5 * rng.normal(size=(out, into)), 0.3 * rng.normal(size=out), name)
        for into, out, name in zip(widths, widths[1:], (*activations, "Identity"), strict=False)
    ]
    loads, scale = LARGEST[:size], np.repeat([1e-5, 1e-3], 3)[:size]
    return PerceptronLaw(tuple(layers), 0.1 * loads, loads, scale, 0.01 * scale, np.array([-loads, loads]))


def trained(size: int) -> TrainedLaw:
    """Return a law of awkward numbers."""
    rng = np.random.default_rng(size)
    loads = rng.normal(size=(30, size))
    deflections = loads @ random_compliance(4)[:size, :size] * (1.0 + 0.01 * rng.normal(size=(30, size)))
    units = ("mm", "mm", "mm", "deg", "deg", "deg")[:size]
    return train(JointData(loads, deflections, units, np.ones(size), "ab" * 32, Path("bänch.csv"))).trained


def made(size: int, features: str, seed: int = 0) -> PolynomialLaw:
    """Return a law with random coefficients."""
    rng = np.random.default_rng(seed)
    names = features_of(features, size)
    root = rng.normal(size=(size, len(names), len(names)))
    seen = np.array([-np.ones(size), np.ones(size)])
    return PolynomialLaw(names, rng.normal(size=(len(names), size)), root @ root.swapaxes(1, 2), rng.random(size), seen)
