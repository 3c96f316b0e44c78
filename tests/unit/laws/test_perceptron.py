"""Layers of the user's own: trained by torch, kept as layers and weights, and in an arm like any other law."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.bench import bench, write
from support.command_line import Run, fine, strict_json

from armflex import ArmflexError, InputError, Measurements, calibrate, load_arm, load_law, save_law, train
from armflex.bench import fit_torch
from armflex.bench.fitted import NOWHERE
from armflex.bench.learners import Options
from armflex.errors import LawError, ModelFileError, NotFiniteError, UnsupportedError
from armflex.laws.joint.carried import scaled
from armflex.laws.joint.perceptron import ACTIVATIONS, Layer, PerceptronLaw, from_tensors, perceptron_of, to_tensors
from armflex.laws.law_file import TrainedLaw
from armflex.laws.terms import twist_of
from armflex.readings import Position, Readings
from armflex.rows import Rows
from armflex.storage.array_file import Layout, write_arrays
from armflex.storage.digest import digest
from armflex.storage.schema import Numbers

DATA, COMPLIANCE = bench(3, 26, 3, noise=0.02)
WRENCH = np.array([900.0, -700.0, 1500.0, 0.0, 0.0, 0.0])

OWN = """\
import torch


class Own(torch.nn.Sequential):
    def __init__(self):
        inner = torch.nn.Sequential(torch.nn.Linear(3, 5), torch.nn.Tanh(), torch.nn.Dropout(0.5))
        super().__init__(inner, torch.nn.Linear(5, 4), torch.nn.SiLU(), torch.nn.Linear(4, 3))
"""
ARM = """\
[robot]
urdf = "robot.urdf"
tip = "tip"

[payload.p]
mass = 40.0
com = [0.1, 0.0, 0.0]

[flexure.J]
joint = "J"
model = "torch"
file = "law.safetensors"
"""


def some_layers(seed: int = 0, activations: tuple[str, ...] = ("Tanh", "SiLU", "Identity")) -> tuple[Layer, ...]:
    rng = np.random.default_rng(seed)
    widths = [3, *range(4, 3 + len(activations)), 3]
    return tuple(
        Layer(0.7 * rng.normal(size=(out, into)), 0.3 * rng.normal(size=out), name)
        for into, out, name in zip(widths, widths[1:], activations, strict=False)
    )


def some_law(activations: tuple[str, ...] = ("Tanh", "SiLU", "Identity")) -> PerceptronLaw:
    scales = np.array([50.0, -20.0, 100.0]), np.array([800.0, 900.0, 1200.0]), np.array([1e-4, 2e-4, 1e-4])
    return PerceptronLaw(
        some_layers(0, activations), *scales, np.full(3, 1e-6), 2.0 * np.outer([-1, 1], WRENCH[:3] ** 2)
    )


def in_an_arm(folder: Path) -> Path:
    from support.small_arms import joint, link, robot

    parts = link("base"), link("arm", 20.0, (0.5, 0, 0)), link("tip")
    parts += joint("J", "base", "arm"), joint("T", "arm", "tip", (1.0, 0, 0), kind="fixed")
    (folder / "robot.urdf").write_text(robot(*parts))
    (folder / "arm.toml").write_text(ARM)
    return folder / "arm.toml"


@pytest.fixture
def arm_file(tmp_path: Path) -> Path:
    """Return an arm with a network of two hidden layers about its joint."""
    odd = [Layer(np.eye(3) + 0.05, np.zeros(3), name) for name in ("Tanh", "Tanh", "Identity")]
    law = replace(some_law(), layers=tuple(odd), seen=np.array([[-2e3] * 3, [2e3] * 3]))
    save_law(TrainedLaw(law, "torch", {"rows": 3}), tmp_path / "law.safetensors")
    return in_an_arm(tmp_path)


def test_a_file_runs_no_code(tmp_path: Path) -> None:
    """The old attack: a law's file that names Python, in an arm that somebody sent, is refused by line, and not run."""
    code, ran = tmp_path / "own.py", tmp_path / "ran"
    code.write_text(f"open({str(ran)!r}, 'w').write('.')\n{OWN}")
    weights = {"inner.weight": {"shape": [1], "whole": False}}
    said = {"file": "own.py", "class": "Own", "sha256": 64 * "0", "weights": weights}
    layout = Layout(
        "a law", "armflex-law-1", {"module.inner.weight": Numbers((1,))}, {"model": str, "metadata": dict[str, Any]}
    )
    write_arrays(
        tmp_path / "law.safetensors",
        layout,
        {"module.inner.weight": np.ones(1)},
        {"model": "torch", "metadata": {"module": said}},
    )
    before = {*sys.modules}
    text = r"law\.safetensors: .*class stands in Python code, own\.py:Own, and no file runs code any more: .*train it "
    with pytest.raises(ModelFileError, match=text):
        load_law(tmp_path / "law.safetensors")
    with pytest.raises(ArmflexError, match=rf"arm\.toml:12: .*{text}"):
        load_arm(in_an_arm(tmp_path))
    assert not ran.exists() and not {name for name in {*sys.modules} - before if "own" in name or "torch" in name}


def test_arms_and_laws_take_no_code_in_their_arguments() -> None:
    for load in (load_arm, load_law):
        with pytest.raises(TypeError, match="trust"):
            load("nowhere.toml", trust=["own.py"])  # pyright: ignore[reportCallIssue]


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_derivatives_and_bounds_are_those_of_differences(name: str) -> None:
    law = some_law((name, name, "Identity"))
    assert not law.twist(np.zeros(6), NOWHERE).any()
    many = WRENCH * np.random.default_rng(0).uniform(-1.0, 1.0, (2, 4, 6))
    steps = 1e-2 * np.eye(6)
    numeric = (law.twist(many[..., None, :] + steps, NOWHERE) - law.twist(many[..., None, :] - steps, NOWHERE)) / 2e-2
    tangent = law.tangent(many, NOWHERE)
    np.testing.assert_allclose(tangent, numeric.swapaxes(-1, -2), rtol=1e-6, atol=1e-14)
    assert not tangent[..., 3:, :].any() and not tangent[..., 3:].any()
    assert np.linalg.norm(tangent, 2, axis=(-2, -1)).max() <= law.compliance_bound({})[0, 0]
    x = np.linspace(-30.0, 30.0, 60_001)
    steepest = np.abs(ACTIVATIONS[name].slope(x)).max()
    assert 0.999 * ACTIVATIONS[name].steepest <= steepest <= ACTIVATIONS[name].steepest
    for i, j in np.ndindex(2, 4):
        np.testing.assert_allclose(law.twist(many[i, j], NOWHERE), law.twist(many, NOWHERE)[i, j], rtol=1e-12)


@pytest.mark.parametrize("activations", [("Tanh", "Identity"), ("Sigmoid", "Identity"), ("Identity",)])
def test_one_hidden_layer_is_terms(activations: tuple[str, ...]) -> None:
    """So that the engine and exported C know it; the terms' sum is the network's own answer."""
    law = some_law(activations)
    load = WRENCH * np.random.default_rng(1).uniform(-1.0, 1.0, (5, 6))
    np.testing.assert_allclose(twist_of(law.terms(), load, NOWHERE), law.twist(load, NOWHERE), rtol=1e-9, atol=1e-18)
    assert law.known_terms is not None


def test_a_deeper_one_is_none() -> None:
    with pytest.raises(UnsupportedError, match="network of Tanh, SiLU: only one hidden layer of Tanh or Sigmoid"):
        some_law().terms()
    assert some_law().known_terms is None


def test_a_file_holds_layers_and_weights(tmp_path: Path) -> None:
    """Written again they are the same bytes."""
    law = some_law()
    path = save_law(TrainedLaw(law, "torch", {"rows": 3}), tmp_path / "a.safetensors")
    read = load_law(path)
    np.testing.assert_array_equal(read.law.twist(WRENCH, NOWHERE), law.twist(WRENCH, NOWHERE))
    assert digest(read.law) == digest(law) and read.metadata == {"rows": 3}
    assert save_law(read, tmp_path / "b.safetensors").read_bytes() == path.read_bytes()


def test_only_what_was_trained_has_a_file(tmp_path: Path) -> None:
    with pytest.raises(LawError, match="not trained by armflex"):
        save_law(TrainedLaw(replace(some_law(), noise=None), "torch", {}), tmp_path / "own.safetensors")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "change", "match"),
    [
        ("widths", lambda widths: widths[:-1], "'widths' are 3 of 3 layers, expected one more"),
        ("widths", lambda widths: widths + 1, "'weights' are 59, expected the"),
        ("activations", lambda found: found + 7, "'activations'"),
        ("weights", lambda weights: weights[:-1], "'weights' are 58, expected the 59"),
        ("weights", lambda weights: weights * np.nan, "'weights'"),
        ("seen", lambda seen: seen[::-1], "smallest loads are not below"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(name, change, match) -> None:
    tensors = to_tensors(some_law())
    with pytest.raises(LawError, match=match):
        from_tensors(tensors | {name: change(tensors[name])})


def test_layers_that_do_not_follow_each_other_are_refused() -> None:
    first, second, third = some_layers()
    scales = np.zeros(3), np.ones(3), np.ones(3)
    with pytest.raises(LawError, match="does not follow one of"):
        PerceptronLaw((first, third), *scales)
    with pytest.raises(LawError, match="from 3 numbers to 5, expected 3 to 3"):
        PerceptronLaw((first, second), *scales)


def test_it_says_where_it_was_not_trained() -> None:
    law = replace(some_law(), seen=np.array([-np.abs(WRENCH[:3]), np.abs(WRENCH[:3])]))
    assert law.trained and not law.flags(0.3 * WRENCH, NOWHERE)
    assert law.flags(9.0 * WRENCH, NOWHERE)[0].code == "extrapolating"
    stds = [np.sqrt(law.covariance(times * WRENCH, NOWHERE)[0, 0]) for times in (0.5, 5.0, 10.0)]
    assert stds[1] == pytest.approx(25.0 * stds[0]) and stds[2] == pytest.approx(4.0 * stds[1])


def test_a_number_that_is_none_is_not_passed_on() -> None:
    into, *others = some_law(("ReLU", "Identity")).layers
    law = replace(some_law(), layers=(replace(into, weight=1e306 * into.weight), *others))
    with pytest.raises(NotFiniteError, match="the network gives no number under a load of"):
        law.twist(1e6 * WRENCH, NOWHERE)


@pytest.mark.filterwarnings("ignore:gravity:armflex.ArmflexWarning")
def test_in_an_arm_one_row_many_rows_and_a_control_loop_say_the_same(arm_file: Path) -> None:
    arm = load_arm(arm_file)
    rows = np.linspace(-1.0, 1.0, 5)[:, None]
    many = arm.deflection(rows, payload="p")
    asked = arm.prepared("p")
    for i, q in enumerate(rows):
        single = arm.deflection(q, payload="p")
        np.testing.assert_allclose(many.displacement[i], single.displacement, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(asked(q), single.displacement, rtol=1e-9, atol=1e-15)
        load = single.wrenches[0]
        np.testing.assert_allclose(single.twists[0], arm.flexures[0].law.twist(load, NOWHERE), rtol=1e-9)
    assert np.linalg.norm(many.displacement[2, :3]) > 1e-6 and single.covariance is not None


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ('"torch"', '"neural"', r"arm.toml:12: .*holds a torch law, but model = 'neural'"),
        ('"law.', '"gone.', r"arm.toml:12: .*cannot be read"),
        ('file = "law.safetensors"', "learn = true", r"arm.toml:11: .* give the 'file' that `armflex tr"),
    ],
)
def test_an_arm_that_names_it_wrongly(arm_file: Path, old: str, new: str, match: str) -> None:
    arm_file.write_text(arm_file.read_text().replace(old, new))
    with pytest.raises(ArmflexError, match=match):
        load_arm(arm_file)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:gravity:armflex.ArmflexWarning")
def test_a_campaign_learns_a_correction_about_it(arm_file: Path) -> None:
    """The network stays as it was trained; what the arm shows beside it is learned, written, and read again."""
    text = arm_file.read_text().replace('model = "torch"', 'model = "torch"\nlearn = true')
    arm_file.write_text(text.replace("[flexure.J]", '[measurement]\nframe = "base"\n\n[flexure.J]'))
    arm = load_arm(arm_file)
    law = arm.flexures[0].law
    truth = replace(arm, flexures=(replace(arm.flexures[0], law=scaled(law, np.full(6, 1.2)), learn=None),))
    q = np.linspace(-1.2, 1.2, 12)[:, None]
    tips = np.array([truth.deflection(row, "p").pose.translation for row in q])
    rows = Rows.of(arm.joint_names, q, ["p"] * len(q), {}, derived=("time",))
    read = Readings(len(q), (Position(tips, np.full(tips.shape, 1e-6)),))
    fit = calibrate(arm, Measurements.of(rows, read))
    pairs = list(zip(q, tips, strict=True))
    before, after = (
        max(np.linalg.norm(which.deflection(row, "p").pose.translation - tip) for row, tip in pairs)
        for which in (arm, fit.arm)
    )
    assert after < 0.1 * before
    again = load_arm(fit.write(arm_file.parent / "found.toml"))
    displacement = fit.arm.deflection(q[0], "p").displacement
    np.testing.assert_allclose(again.deflection(q[0], "p").displacement, displacement, rtol=1e-6)


class TestTorch:
    """What torch trains: everything here needs it, and a second to import it."""

    pytestmark = pytest.mark.slow

    @pytest.fixture(autouse=True)
    def short(self) -> Iterator[None]:
        """Train for a few steps: what is asked here is not how good a network becomes."""
        pytest.importorskip("torch")
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(fit_torch, "ROUNDS", 3)
            yield

    @pytest.mark.parametrize("name", ACTIVATIONS)
    def test_layers_answer_as_torch_does(self, name: str) -> None:
        import torch

        torch.manual_seed(1)
        linear = torch.nn.Linear
        activation = getattr(torch.nn, name)
        module = torch.nn.Sequential(
            linear(3, 4), activation(), torch.nn.Sequential(linear(4, 6), linear(6, 5, bias=False)), activation()
        )
        module.append(torch.nn.Dropout(0.9)).append(linear(5, 3)).append(torch.nn.Identity())
        state = {key: value.clone() for key, value in module.state_dict().items()}
        law = PerceptronLaw(perceptron_of(module, 3), np.zeros(3), np.ones(3), np.ones(3))
        assert module.training and all((value == state[key]).all() for key, value in module.state_dict().items())
        module = module.double().eval()
        loads = np.random.default_rng(2).normal(size=(7, 6)) * [3, 3, 3, 0, 0, 0]
        with torch.no_grad():
            given = (module(torch.tensor(loads[:, :3])) - module(torch.zeros(1, 3).double())).numpy()
        np.testing.assert_allclose(law.twist(loads, NOWHERE)[:, :3], given, rtol=1e-8, atol=1e-8)
        slope = torch.func.jacrev(module)(torch.tensor(loads[0, :3])).detach().numpy()
        np.testing.assert_allclose(law.tangent(loads[0], NOWHERE)[:3, :3], slope, rtol=1e-7, atol=1e-8)

    def test_what_is_no_layers_is_refused(self) -> None:
        import torch

        class Forward(torch.nn.Sequential):
            def forward(self, loads):
                return 2.0 * super().forward(loads)

        linear, square = torch.nn.Linear, torch.nn.Linear(3, 3)
        hooked = torch.nn.Sequential(linear(3, 3))
        hooked[0].register_forward_hook(lambda *given: given[-1] + 1.0)
        for module, match in (
            (3, "expected a torch.nn.Sequential of linear layers and activations, got int"),
            (torch.nn.Sequential(square, torch.nn.LayerNorm(3)), "has a LayerNorm, which .*Python object"),
            (Forward(square), "has a Forward, which is no linear layer"),
            (torch.nn.Sequential(square, torch.nn.LeakyReLU(0.3)), "a setting of its own"),
            (hooked, "has it hooks"),
            (torch.nn.Sequential(linear(3, 2)), r"shape \(16, 2\) for loads of shape \(16, 3\)"),
            (torch.nn.Sequential(linear(4, 3)), r"does not take loads of shape \(16, 3\)"),
        ):
            with pytest.raises(LawError, match=match):
                perceptron_of(module, 3)

    def test_it_is_trained_and_held_out_as_a_network_is(self, tmp_path: Path) -> None:
        import torch

        make = lambda: torch.nn.Sequential(torch.nn.Linear(3, 5), torch.nn.Tanh(), torch.nn.Linear(5, 3))  # noqa: E731
        result = train(DATA, "torch", options=Options(starts=1, module=make))
        neural = train(DATA, "neural", options=Options(starts=1, neurons=2))
        assert result.held_out == neural.held_out == "10-fold"
        assert [name for name, _ in result.compared] == [name for name, _ in neural.compared]
        for (_, own), (_, other) in zip(result.compared, neural.compared, strict=True):
            np.testing.assert_array_equal(own, other)
        assert {flag.code for flag in result.flags} == {flag.code for flag in neural.flags}
        law = result.trained.law
        np.testing.assert_allclose(law.noise, result.held_out_rms)  # the uncertainty that it states
        exact = COMPLIANCE @ WRENCH[:3]
        np.testing.assert_allclose(law.twist(WRENCH, NOWHERE)[:3], exact, atol=0.15 * np.abs(exact).max())
        assert result.parameters["layers"] == [3, 5, 3] and result.parameters["weights"] == 20 + 18
        read = load_law(save_law(result.trained, tmp_path / "own.safetensors")).law
        np.testing.assert_array_equal(read.twist(WRENCH, NOWHERE), law.twist(WRENCH, NOWHERE))

    def test_the_same_seed_gives_the_same_law(self) -> None:
        import torch

        make = lambda: torch.nn.Sequential(torch.nn.Linear(3, 4), torch.nn.ReLU(), torch.nn.Linear(4, 3))  # noqa: E731
        state = torch.random.get_rng_state()
        first, again, other = (
            fit_torch.fit_torch(DATA.loads, DATA.deflections, make, 1, seed).law for seed in (0, 0, 1)
        )
        assert torch.equal(torch.random.get_rng_state(), state)  # the user's own draws go on as they would have
        assert digest(first) == digest(again) != digest(other)

    def test_there_must_be_something_to_train(self) -> None:
        import torch

        with pytest.raises(LawError, match="no weights: there is nothing to train"):
            train(DATA, "torch", options=Options(module=lambda: torch.nn.Sequential(torch.nn.Tanh())))
        with pytest.raises(InputError, match="needs its module: a class that makes a torch"):
            train(DATA, "torch")

    def test_on_the_command_line_a_class_is_named(self, tmp_path: Path, armflex: Run) -> None:
        """Its code is run there, and nowhere else: the law is loaded without it."""
        (tmp_path / "own.py").write_text(OWN)
        table = write(tmp_path, "fx_N,fy_N,fz_N,dx_m,dy_m,dz_m", np.hstack([DATA.loads, DATA.deflections]))
        given = "--module", f"{tmp_path / 'own.py'}:Own", "-o", tmp_path / "law.safetensors"
        refused = fine(armflex("train", table, "--model", "linear", *given), code=2)
        assert "--module does not concern --model linear (it does: torch)" in refused.stderr
        fine(armflex("train", table, "--model", "torch", "--starts", "1", *given, "--json", tmp_path / "said.json"))
        assert strict_json(tmp_path / "said.json")["parameters"]["activations"] == ["Tanh", "SiLU", "Identity"]
        (tmp_path / "own.py").unlink()
        arm = in_an_arm(tmp_path)
        assert load_law(tmp_path / "law.safetensors").law.twist(WRENCH, NOWHERE).any()
        assert load_arm(arm).deflection(np.zeros(1), payload="p").displacement.any()


@pytest.mark.parametrize(
    ("text", "name", "match"),
    [
        ("", ":", r"--module '.*': expected FILE\.py:CLASS"),
        ("def Own():\n    return 3\n", ":Owm", r"no class in .*own\.py named 'Owm', did you mean 'Own'\?"),
        ("x = (", ":Own", r"own\.py:1: "),
        ("import sys\n\nimport nowhere_at_all\n", ":Own", r"own\.py:3: ModuleNotFoundError"),
        ("raise SystemExit(3)\n", ":Own", r"own\.py:1: SystemExit: 3"),
    ],
)
def test_code_that_fails_is_named(tmp_path: Path, text: str, name: str, match: str) -> None:
    from armflex.cli.train_command import module_of

    (tmp_path / "own.py").write_text(text)
    with pytest.raises(InputError, match=match):
        module_of(f"{tmp_path / 'own.py'}{name}")
    with pytest.raises(InputError, match=r"gone\.py: cannot be read"):
        module_of(f"{tmp_path / 'gone.py'}:Own")
