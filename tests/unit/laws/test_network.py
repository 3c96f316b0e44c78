"""Network laws: tangents, averages, flags, files, and the same as layers."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support.bench import LARGEST, some_law

from armflex.errors import LawError
from armflex.laws import LinearLaw, Row
from armflex.laws.joint.linear import LinearFit
from armflex.laws.joint.network import (
    NetworkLaw,
    from_tensors,
    hidden_values,
    layers,
    pack,
    to_tensors,
    unpack,
    weight_count,
    weight_jacobian,
)
from armflex.laws.joint.perceptron import Layer, PerceptronLaw

NOWHERE = Row(np.zeros(0), {})


def six(loads: np.ndarray) -> np.ndarray:
    return np.concatenate([loads, np.zeros((*loads.shape[:-1], 6 - loads.shape[-1]))], axis=-1)


def by_hand(law: NetworkLaw, wrench: np.ndarray) -> np.ndarray:
    x = (wrench[: law.size] - law.input_mean) / law.input_scale
    parts = zip(law.hidden, law.bias, law.output, law.offset, strict=True)
    answers = [output / (1.0 + np.exp(-(hidden @ x + bias))) @ np.eye(len(bias)) for hidden, bias, output, _ in parts]
    values = np.array([answer.sum(axis=1) for answer in answers]) + law.offset
    return six((law.output_mean + law.output_scale * values).mean(axis=0))


@pytest.mark.parametrize("size", [3, 6])
@pytest.mark.parametrize("draws", [1, 5])
def test_twist_is_the_average_of_the_networks_and_tangent_its_derivative(size: int, draws: int) -> None:
    law, rng = some_law(size, draws), np.random.default_rng(1)
    wrenches = LARGEST * rng.uniform(-1.0, 1.0, size=(2, 4, 6))
    twists, tangents = law.twist(wrenches, NOWHERE), law.tangent(wrenches, NOWHERE)
    assert twists.shape == (2, 4, 6) and tangents.shape == (2, 4, 6, 6) and law.trained
    for place in np.ndindex(2, 4):
        wrench = wrenches[place]
        np.testing.assert_allclose(twists[place], by_hand(law, wrench), rtol=1e-12, atol=1e-18)
        np.testing.assert_allclose(law.twist(wrench, NOWHERE), twists[place], rtol=1e-12, atol=1e-18)
        np.testing.assert_allclose(law.tangent(wrench, NOWHERE), tangents[place], rtol=1e-12, atol=1e-20)
        steps = np.diag(1e-4 * LARGEST)
        differences = law.twist(wrench + steps, NOWHERE) - law.twist(wrench - steps, NOWHERE)
        slopes = (differences / (2e-4 * LARGEST[:, None])).T
        np.testing.assert_allclose(tangents[place], slopes, atol=1e-7 * np.abs(slopes).max())


def test_many_loads_are_answered_in_parts_alike() -> None:
    law, rng = some_law(3, 50, neurons=20), np.random.default_rng(2)
    wrenches = LARGEST * rng.uniform(-1.0, 1.0, size=(3, 150, 6))
    for ask in (law.twist, law.tangent):
        single = np.stack([ask(wrench, NOWHERE) for wrench in wrenches[1]])
        np.testing.assert_allclose(ask(wrenches, NOWHERE)[1], single, rtol=1e-9, atol=1e-18)


def test_neurons_that_change_places_leave_the_average_of_predictions_but_not_that_of_weights() -> None:
    law, rng = some_law(3, 1), np.random.default_rng(3)
    order = rng.permutation(law.hidden.shape[1])
    turned = (law.hidden[:, order], law.bias[:, order], law.output[:, :, order], law.offset)
    names = ("hidden", "bias", "output", "offset")
    pairs = zip(names, turned, strict=True)
    twins = replace(law, **{name: np.concatenate([getattr(law, name), other]) for name, other in pairs})
    wrench = LARGEST * rng.uniform(-1.0, 1.0, size=(9, 6))
    np.testing.assert_allclose(twins.twist(wrench, NOWHERE), law.twist(wrench, NOWHERE), rtol=1e-12)
    averaged = replace(law, **{name: getattr(twins, name).mean(axis=0, keepdims=True) for name in names})
    assert np.abs(averaged.twist(wrench, NOWHERE) - law.twist(wrench, NOWHERE)).max() > 1e-4


@pytest.mark.parametrize("size", [3, 6])
def test_weights_stand_in_the_order_that_is_documented(size: int) -> None:
    law = some_law(size, 2)
    weights = pack(law)
    for name, part in unpack(weights, size).items():
        np.testing.assert_array_equal(part, getattr(law, name))
    hidden, output = layers(weights[1], size)
    np.testing.assert_array_equal(hidden[4], [*law.hidden[1, 4], law.bias[1, 4]])
    np.testing.assert_array_equal(output[2], [*law.output[1, 2], law.offset[1, 2]])
    np.testing.assert_array_equal(weights[1, : size + 1], hidden[0])


@pytest.mark.parametrize("size", [3, 6])
def test_weight_jacobian_is_the_derivative(size: int) -> None:
    law, x = some_law(size, 1), np.random.default_rng(4).normal(size=(5, size))
    weights = pack(law)[0]

    def answer(w: np.ndarray) -> np.ndarray:
        hidden, output = layers(w, size)
        return hidden_values(x, hidden) @ output[:, :-1].T + output[:, -1]

    steps = 1e-5 * np.eye(len(weights))
    slopes = np.stack([(answer(weights + s) - answer(weights - s)) / 2e-5 for s in steps], axis=-1)
    np.testing.assert_allclose(weight_jacobian(x, weights, size), slopes, atol=1e-9)


def test_covariance_by_hand() -> None:
    wrench = np.array([300.0, -200.0, 500.0, 0.0, 0.0, 0.0])
    many, gaussian, plain = some_law(3, 30), some_law(3, 1, laplace=True), some_law(3, 1)
    assert many.reach(wrench[:3]) < 1.0
    singles = [replace(many, **{n: getattr(many, n)[i : i + 1] for n in ("hidden", "bias", "output", "offset")})
               for i in range(30)]  # fmt: skip
    spread = np.cov([single.twist(wrench, NOWHERE)[:3] for single in singles], rowvar=False)
    np.testing.assert_allclose(many.covariance(wrench, NOWHERE)[:3, :3], spread + np.diag(many.noise**2), rtol=1e-9)
    np.testing.assert_array_equal(plain.covariance(wrench, NOWHERE), np.diag([*plain.noise**2, 0.0, 0.0, 0.0]))
    rng, root = np.random.default_rng(5), np.linalg.cholesky(gaussian.weight_covariance + 1e-15 * np.eye(52))
    weights = pack(gaussian) + 1e-3 * rng.normal(size=(20000, 52)) @ root.T  # so near that the network is straight
    sampled = replace(gaussian, **unpack(weights, 3), weight_covariance=None).draws(wrench[:3])
    found = gaussian.covariance(wrench, NOWHERE)[:3, :3] - np.diag(gaussian.noise**2)
    np.testing.assert_allclose(np.cov(sampled, rowvar=False) * 1e6, found, atol=0.05 * found.max())


def test_drawn_networks_scatter_as_the_stated_covariance_however_wide_that_is() -> None:
    """After ten readings most mixtures of weights are as wide as their prior: networks of such weights fit nothing."""
    law, rng = some_law(3, 1), np.random.default_rng(8)
    wrenches = six(0.8 * law.seen[1] * rng.uniform(-1.0, 1.0, (10, 3)))
    by_weights = law.by_values(wrenches, NOWHERE)[:, :3].reshape(30, -1) / (1e-3 * np.ptp(law.twist(wrenches, NOWHERE)))
    covariance = np.linalg.inv(by_weights.T @ by_weights + np.eye(len(law.values)))
    law = replace(law, weight_covariance=covariance, noise=np.zeros(3))
    step = np.linalg.cholesky(covariance) @ rng.normal(size=len(law.values))
    exact = law.twist(wrenches, NOWHERE) + law.by_values(wrenches, NOWHERE) @ step
    drawn = law.straight(step)
    np.testing.assert_allclose(drawn.twist(wrenches, NOWHERE), exact, rtol=0, atol=1e-7 * np.abs(exact).max())
    assert drawn.weight_covariance is None
    answers = np.array([law.draw(rng).twist(wrenches, NOWHERE)[:, :3] for _ in range(2000)])
    stated = [np.sqrt(np.diag(law.covariance(wrench, NOWHERE))[:3]) for wrench in wrenches]
    np.testing.assert_allclose(answers.std(axis=0), stated, rtol=0.08)
    assert np.abs(answers.mean(axis=0) - law.twist(wrenches, NOWHERE)[:, :3]).max() < 0.1 * np.max(stated)


@pytest.mark.parametrize("draws", [1, 4])
def test_beyond_the_loads_trained_on_it_says_so_and_widens(draws: int) -> None:
    law = some_law(3, draws, laplace=draws == 1)
    middle, edge = 0.5 * law.seen.sum(axis=0), law.seen[1]
    assert law.flags(six(middle), NOWHERE) == ()
    out = six(middle + np.array([3.0, 0.0, 0.0]) * (edge - middle))
    linear = LinearLaw(np.eye(6), fit=LinearFit(np.zeros((3, 3, 3)), np.zeros(3), law.seen))
    assert law.flags(out, NOWHERE) == linear.flags(out, NOWHERE)
    assert [flag.code for flag in law.flags(out, NOWHERE)] == ["extrapolating"]
    corner = six(edge)  # every component was seen, not all at their largest together
    assert linear.flags(corner, NOWHERE) == ()
    (flag,) = law.flags(corner, NOWHERE)
    times = law.distance(edge) / law.furthest
    assert flag.code == "extrapolating" and f"{times:.3g} times as far" in flag.text and times > 1.0
    for wrench in (corner, out):
        reach = float(law.reach(wrench[:3]))
        inside = replace(law, furthest=1e9, seen=1e9 * law.seen).covariance(wrench, NOWHERE)
        np.testing.assert_allclose(law.covariance(wrench, NOWHERE), reach**4 * inside, rtol=1e-12)


@pytest.mark.parametrize("size", [3, 6])
@pytest.mark.parametrize(("draws", "laplace"), [(1, False), (1, True), (4, False)])
def test_tensors_give_the_law_back(size: int, draws: int, laplace: bool) -> None:
    law = some_law(size, draws, laplace=laplace)
    tensors = to_tensors(law)
    assert all(tensor.dtype == np.float64 and tensor.flags.c_contiguous for tensor in tensors.values())
    again, wrench = from_tensors(tensors), 0.5 * LARGEST
    assert ("weight_covariance" in tensors) == laplace
    np.testing.assert_array_equal(again.twist(wrench, NOWHERE), law.twist(wrench, NOWHERE))
    np.testing.assert_array_equal(again.covariance(wrench, NOWHERE), law.covariance(wrench, NOWHERE))
    assert again.flags(9 * wrench, NOWHERE) == law.flags(9 * wrench, NOWHERE) != ()


@pytest.mark.parametrize("name", sorted(to_tensors(some_law(3, 1, laplace=True))))
def test_tampered_tensors_are_refused_by_name(name: str) -> None:
    tensors = to_tensors(some_law(3, 1, laplace=True))
    whole = tensors[name]
    for bad in (whole[:0], whole[None], whole.astype(np.float32), np.full_like(whole, np.nan)):
        with pytest.raises(LawError, match="'(hidden|bias|" + name + ")'"):  # other arrays are judged by `hidden`
            from_tensors(tensors | {name: bad})
    del tensors[name]
    if name != "weight_covariance":
        with pytest.raises(LawError, match=name):
            from_tensors(tensors)


@pytest.mark.parametrize(
    ("name", "change", "match"),
    [
        ("noise", lambda t: -t, r"'noise'\[0\] is .*, expected 0 or more"),
        ("input_scale", lambda t: 0.0 * t, r"'input_scale'\[0\] is 0"),
        ("furthest", lambda t: -t, r"'furthest'\[0\] is -"),
        ("seen", lambda t: t[::-1].copy(), "not below the largest"),
        ("load_precision", lambda t: -t, "'load_precision' is no covariance"),
        ("load_precision", lambda t: t + np.triu(t, 1) + 1e-3 * np.eye(3, k=1), "not symmetric"),
        ("hidden", lambda t: np.zeros((1, 7, 4)), r"k one of \(3, 6\)"),
        ("spare", lambda t: np.zeros(3), "'spare' is not expected"),
    ],
)
def test_impossible_tensors_are_refused(name: str, change: Callable, match: str) -> None:
    tensors = to_tensors(some_law(3, 1))
    with pytest.raises(LawError, match=match):
        from_tensors(tensors | {name: change(tensors.get(name))})


def test_only_a_single_network_has_a_laplace_covariance() -> None:
    tensors = to_tensors(some_law(3, 4)) | {"weight_covariance": np.eye(weight_count(3, 7))}
    with pytest.raises(LawError, match="single network"):
        from_tensors(tensors)


def test_as_layers_it_gives_the_same() -> None:
    """A perceptron of one hidden layer of sigmoids, but for what this one gives without a load."""
    law, rng = some_law(3, 1), np.random.default_rng(6)
    layers = Layer(law.hidden[0], law.bias[0], "Sigmoid"), Layer(law.output[0], law.offset[0], "Identity")
    own = PerceptronLaw(layers, law.input_mean, law.input_scale, law.output_scale, law.noise, law.seen)
    wrenches = LARGEST * rng.uniform(-1.0, 1.0, size=(2, 5, 6))
    for wrench in (wrenches, wrenches[0], wrenches[0, 0]):
        moved = law.twist(wrench, NOWHERE) - law.twist(np.zeros(6), NOWHERE)
        np.testing.assert_allclose(own.twist(wrench, NOWHERE), moved, rtol=1e-9, atol=1e-18)
        np.testing.assert_allclose(own.tangent(wrench, NOWHERE), law.tangent(wrench, NOWHERE), atol=1e-18)
    np.testing.assert_allclose(np.diag(own.covariance(wrenches[0, 0], NOWHERE))[:3], law.noise**2)


@pytest.mark.slow
def test_torch_is_not_imported_before_it_is_asked() -> None:
    modules = "armflex.laws.joint.network, armflex.laws.joint.perceptron, armflex.bench.fit_network"
    text = f"import sys, {modules}; sys.exit('torch' in sys.modules)"
    subprocess.run([sys.executable, "-c", text], check=True, timeout=600)
