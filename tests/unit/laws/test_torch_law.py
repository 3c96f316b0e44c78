"""A user's own torch module: trained, kept as weights beside its Python file, and in an arm like any other law."""

from __future__ import annotations

import hashlib
import pickle
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.bench import bench, write
from support.command_line import Run, fine, strict_json

from armflex import ArmflexError, InputError, Measurements, calibrate, load_arm, load_law, save_law, train
from armflex.bench import fit_torch
from armflex.bench.fitted import NOWHERE
from armflex.bench.learners import Options
from armflex.errors import FileError, LawError, ModelFileError, NotFiniteError, UntrustedError
from armflex.laws.joint.carried import scaled
from armflex.laws.law_file import TrainedLaw
from armflex.readings import Position, Readings
from armflex.rows import Rows
from armflex.storage.digest import digest

torch = pytest.importorskip("torch")
TorchLaw = pytest.importorskip("armflex.laws.joint.torch_law").TorchLaw
pytestmark = pytest.mark.slow  # to import torch takes a second

OWN = """\
import torch


class Own(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.straight = torch.nn.Linear(3, 3)
        self.inner = torch.nn.Linear(3, 4)
        self.dropout = torch.nn.Dropout(0.5)
        self.outer = torch.nn.Linear(4, 3)
        self.register_buffer("asked", torch.tensor(7))

    def forward(self, loads):
        return self.straight(loads) + self.outer(self.dropout(torch.tanh(self.inner(loads))))
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
file = "laws/own.safetensors"
"""


@pytest.fixture(scope="module", autouse=True)
def short() -> Iterator[None]:
    """Train for a few steps: what is asked here is not how good a module becomes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fit_torch, "ROUNDS", 3)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with code/own.py, and laws/own.safetensors trained from it."""
    found = tmp_path_factory.mktemp("torch")
    for name in ("code", "laws"):
        (found / name).mkdir()
    (found / "code" / "own.py").write_text(OWN)
    result = train(DATA, "torch", options=Options(starts=2, module=f"{found / 'code' / 'own.py'}:Own"))
    save_law(result.trained, found / "laws" / "own.safetensors")
    (found / "rms.txt").write_text(repr(result.held_out_rms.tolist()))
    return found


DATA, COMPLIANCE = bench(3, 26, 3, noise=0.02)
WRENCH = np.array([900.0, -700.0, 1500.0, 0.0, 0.0, 0.0])


@pytest.fixture
def copied(folder: Path, tmp_path: Path) -> Path:
    """Return a copy of the folder, to be spoilt."""
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    return tmp_path


def source(folder: Path, text: str, name: str = "Own") -> Options:
    (folder / "own.py").write_text(text)
    return Options(starts=1, module=f"{folder / 'own.py'}:{name}")


@pytest.mark.slow
def test_it_is_trained_and_held_out_as_a_network_is(folder: Path) -> None:
    result = train(DATA, "torch", options=Options(starts=1, module=f"{folder / 'code' / 'own.py'}:Own"))
    neural = train(DATA, "neural", options=Options(starts=1, neurons=2))
    assert result.held_out == neural.held_out == "10-fold"
    assert [name for name, _ in result.compared] == [name for name, _ in neural.compared]
    for (_, own), (_, other) in zip(result.compared, neural.compared, strict=True):
        np.testing.assert_array_equal(own, other)
    assert {flag.code for flag in result.flags} - {"runs_code"} == {flag.code for flag in neural.flags}
    law = result.trained.law
    np.testing.assert_allclose(law.noise, result.held_out_rms)  # the uncertainty that it states
    np.testing.assert_allclose(np.diag(law.covariance(0.5 * WRENCH, NOWHERE))[:3], result.held_out_rms**2)
    exact = COMPLIANCE @ WRENCH[:3]
    np.testing.assert_allclose(law.twist(WRENCH, NOWHERE)[:3], exact, atol=0.15 * np.abs(exact).max())
    assert result.parameters["module"] == "own.py:Own" and result.parameters["weights"] == 12 + 16 + 15
    assert any(flag.code == "runs_code" and "own.py" in flag.text for flag in result.flags)


def test_the_same_seed_gives_the_same_law(folder: Path) -> None:
    options = [Options(starts=1, seed=seed, module=f"{folder / 'code' / 'own.py'}:Own") for seed in (0, 0, 1)]
    state = torch.random.get_rng_state()
    first, again, other = (train(DATA, "torch", options=each).trained.law for each in options)
    assert torch.equal(torch.random.get_rng_state(), state)  # the user's own draws go on as they would have
    assert digest(first) == digest(again) != digest(other)


def test_nothing_moves_without_a_load_and_derivatives_are_exact(folder: Path) -> None:
    law = load_law(folder / "laws" / "own.safetensors").law
    assert not law.twist(np.zeros(6), NOWHERE).any()
    many = WRENCH * np.random.default_rng(0).uniform(-1.0, 1.0, (2, 4, 6))
    steps = 1e-2 * np.eye(6)
    numeric = (law.twist(many[..., None, :] + steps, NOWHERE) - law.twist(many[..., None, :] - steps, NOWHERE)) / 2e-2
    tangent = law.tangent(many, NOWHERE)
    np.testing.assert_allclose(tangent, numeric.swapaxes(-1, -2), rtol=1e-6, atol=1e-15)
    assert tangent.dtype == np.float64 and not tangent[..., 3:, :].any() and not tangent[..., 3:].any()
    for i, j in np.ndindex(2, 4):
        np.testing.assert_allclose(law.twist(many[i, j], NOWHERE), law.twist(many, NOWHERE)[i, j], rtol=1e-12)


def test_it_says_where_it_was_not_trained(folder: Path) -> None:
    law = load_law(folder / "laws" / "own.safetensors").law
    assert law.trained and not law.flags(0.3 * WRENCH, NOWHERE)
    assert law.flags(9.0 * WRENCH, NOWHERE)[0].code == "extrapolating"
    stds = [np.sqrt(law.covariance(times * WRENCH, NOWHERE)[0, 0]) for times in (0.5, 5.0, 10.0)]
    assert stds[1] > 3.0 * stds[0] and stds[2] == pytest.approx(4.0 * stds[1], rel=0.3)


def test_a_file_holds_weights_and_no_code(folder: Path, tmp_path: Path) -> None:
    """Weights stand there by their own names; written again, from memory or from a file, they are the same bytes."""
    path = folder / "laws" / "own.safetensors"
    content = path.read_bytes()
    assert b"module.inner.weight" in content and b'"../code/own.py' in content.replace(b"\\", b"")
    assert b"torch.tanh" not in content and b"pickle" not in content
    law = load_law(path)
    save_law(law, folder / "laws" / "again.safetensors")
    assert (folder / "laws" / "again.safetensors").read_bytes() == content
    sent = pickle.loads(pickle.dumps(law.law))  # to another process: the class is made anew there
    np.testing.assert_array_equal(sent.twist(WRENCH, NOWHERE), law.law.twist(WRENCH, NOWHERE))
    assert digest(sent) == digest(law.law)
    save_law(law, tmp_path / "own.safetensors")  # elsewhere: the path is relative to the file, wherever that is
    np.testing.assert_array_equal(
        load_law(tmp_path / "own.safetensors").law.twist(WRENCH, NOWHERE), law.law.twist(WRENCH, NOWHERE)
    )


def test_law_and_code_can_go_elsewhere_together(copied: Path, folder: Path) -> None:
    found, there = (load_law(root / "laws" / "own.safetensors").law for root in (copied, folder))
    np.testing.assert_array_equal(found.twist(WRENCH, NOWHERE), there.twist(WRENCH, NOWHERE))
    assert digest(found) == digest(there)


@pytest.fixture
def stranger(copied: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder as somebody else sent it: its code, which says when it is run, was trained elsewhere."""
    code, path = copied / "code" / "own.py", copied / "laws" / "own.safetensors"
    code.write_text(f"open({str(copied / 'ran')!r}, 'a').write('.')\n{OWN}")
    save_law(train(DATA, "torch", options=Options(starts=1, module=f"{code}:Own")).trained, path)
    in_an_arm(copied)
    (copied / "ran").unlink()
    monkeypatch.setattr("armflex.storage.trust._own", set())
    monkeypatch.setattr(sys, "modules", {key: one for key, one in sys.modules.items() if "armflex_module_" not in key})
    monkeypatch.setenv("XDG_CONFIG_HOME", str(copied / "config"))
    return copied


@pytest.mark.filterwarnings("ignore:gravity:armflex.ArmflexWarning")
def test_the_code_of_a_stranger_is_not_run(stranger: Path) -> None:
    """Neither on the way to a law nor on that to an arm, until the user says so for what the file holds."""
    code, law, arm = stranger / "code" / "own.py", stranger / "laws" / "own.safetensors", stranger / "arm.toml"
    digest = hashlib.sha256(code.read_bytes()).hexdigest()
    for load in (lambda **trust: load_law(law, **trust), lambda **trust: load_arm(arm, **trust)):
        with pytest.raises(UntrustedError, match=rf"own\.py: is Python code .* armflex trust .*{digest}") as error:
            load()
        assert error.value.digest == digest
        with pytest.raises(UntrustedError):
            load(trust=["0" * 64])
        assert not (stranger / "ran").exists()
        for trust in ([code], [str(code)], digest, code):
            load(trust=trust)
        assert (stranger / "ran").read_text() == "."  # once in this process
        del sys.modules[f"armflex_module_{digest}"]
        (stranger / "ran").unlink()
    with pytest.raises(UntrustedError):
        load_arm(arm)
    with pytest.raises(FileError, match="none: cannot be read"):
        load_arm(arm, trust=[stranger / "none"])


def test_on_the_command_line_it_is_trusted_by_name_until_it_changes(stranger: Path, armflex: Run) -> None:
    code, arm = stranger / "code" / "own.py", stranger / "arm.toml"
    digest = hashlib.sha256(code.read_bytes()).hexdigest()
    assert digest in fine(armflex("deflect", arm), 2).stderr and not (stranger / "ran").exists()
    fine(armflex("trust", code))
    fine(armflex("deflect", arm))
    listed = fine(armflex("trust", "--list", "--json", stranger / "t.json")).stdout
    assert digest in listed and strict_json(stranger / "t.json")["files"] == [{"file": str(code), "sha256": digest}]
    text = code.read_text()
    code.write_text(f"{text}# more\n")
    assert "has changed since the law was trained" in fine(armflex("deflect", arm), 2).stderr
    fine(armflex("trust", "--forget", code))
    assert "there is nothing to forget" in fine(armflex("trust", "--forget", code), 2).stderr
    code.write_text(text)
    assert "you have not trusted it" in fine(armflex("deflect", arm), 2).stderr
    assert "trust which file?" in fine(armflex("trust"), 2).stderr
    (stranger / "config" / "armflex" / "trusted.sha256").write_text("everything\n")
    assert "trusted.sha256:1: expected a SHA-256" in fine(armflex("deflect", arm), 2).stderr


SPOILT: list[tuple[str, Callable[[Path], object], str]] = [
    (
        "changed",
        lambda code: code.write_text(OWN + "# one more line\n"),
        "has changed .* put it back as it was, or train",
    ),
    ("gone", lambda code: code.unlink(), r"own.py: cannot be read: No such file"),
]


@pytest.mark.parametrize(("what", "spoil", "match"), SPOILT, ids=[one[0] for one in SPOILT])
def test_code_that_is_not_what_was_trained_is_not_run(
    copied: Path, what: str, spoil: Callable[[Path], object], match: str
) -> None:
    spoil(copied / "code" / "own.py")
    with pytest.raises(ModelFileError, match=match) as error:
        load_law(copied / "laws" / "own.safetensors")
    assert error.value.place.file.name == "own.safetensors"


def test_weights_that_do_not_fit_are_refused(copied: Path) -> None:
    """The same code may make another module: here by a number that it reads when it is run."""
    law = load_law(copied / "laws" / "own.safetensors")
    text = "import pathlib\n" + OWN.replace("3, 4", "3, SIZE").replace("4, 3", "SIZE, 3").replace(
        "\n\nclass", "\nSIZE = int((pathlib.Path(__file__).parent / 'size.txt').read_text())\n\nclass"
    )
    (copied / "size.txt").write_text("4")
    result = train(DATA, "torch", options=source(copied, text))
    path = save_law(TrainedLaw(result.trained.law, "torch", law.metadata), copied / "sized.safetensors")
    (copied / "size.txt").write_text("5")
    code = f"import armflex; armflex.load_law({str(path)!r}, trust={str(copied / 'own.py')!r})"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    assert "weights do not fit own.py:Own: 'inner.weight' is of shape (4, 3) in the file, (5, 3)" in ended.stderr


@pytest.mark.parametrize(
    ("text", "name", "match"),
    [
        (OWN, "Owm", r"no class in .*own.py named 'Owm', did you mean 'Own'\?"),
        (OWN.replace("super()", "super("), "Own", r"own.py:6: "),
        ("import torch\n\nimport nowhere_at_all\n", "Own", r"own.py:3: ModuleNotFoundError"),
        (OWN.replace("(self):", "(self, size):"), "Own", r"Own\(\) fails; expected a class or function without arg"),
        ("raise SystemExit(3)\n", "Own", "own.py:1: SystemExit: 3"),
        ("def Own():\n    return 3\n", "Own", "expected a torch.nn.Module, got int"),
        ("import torch\nOwn = torch.nn.Identity\n", "Own", "without weights: there is nothing to train"),
    ],
)
def test_code_that_fails_is_named(tmp_path: Path, text: str, name: str, match: str) -> None:
    with pytest.raises(InputError, match=match):
        train(DATA, "torch", options=source(tmp_path, text, name))


def module_of(forward: str) -> str:
    return OWN.replace("return self.straight(loads) +", "found = self.straight(loads) +") + f"{forward}\n"


@pytest.mark.parametrize(
    ("forward", "match"),
    [
        (
            "        return found[:, :2]",
            r"gives torch.float64 of shape \(4, 2\) .* expected .* \(4, 3\)",
        ),
        ("        return found.sum(dim=0)", r"of shape \(3,\)"),
        ("        return found / 0.0", "not finite at loads of order one"),
        ("        return found.round().long()", "gives torch.int64"),
        ("        return found.float()", "gives torch.float32"),
        ("        return found.numpy()", "gives ndarray"),
        ("        return found, loads", "gives tuple"),
        ("        return found + torch.randn(3)", "other numbers when called again"),
        ("        return found - found.mean(dim=0)", "each row by itself"),
        ("        return found.detach()", "cannot be differentiated twice"),
        (
            "        return found + (100 * loads).detach() / 100",
            "first derivatives by autograd that its",
        ),
        (
            "        return found + loads.abs().sqrt()",
            "derivatives that are not finite",
        ),
        ("        return Once.apply(loads)", "second derivatives by autograd that its numbers do not"),
        ("        return found + torch.zeros(3, device='cuda')", "does not take loads .* torch.float64 on the CPU"),
        ("        return found + torch.ones(3, 3, dtype=torch.float32) @ loads.T", "does not take loads"),
        ("        return found + self.nothing", "does not take loads .* has no attribute 'nothing'"),
    ],
)
def test_a_module_that_is_no_law_is_refused(tmp_path: Path, forward: str, match: str) -> None:
    text = module_of(forward)
    if "Once" in forward:
        text += """

class Once(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x):
        ctx.save_for_backward(x)
        return x**3

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, gradient):
        return 3 * gradient * ctx.saved_tensors[0] ** 2
"""
    with pytest.raises(LawError, match=match):
        train(DATA, "torch", options=source(tmp_path, text))


def test_a_number_that_is_none_is_not_passed_on() -> None:
    class Far(torch.nn.Module):
        def forward(self, loads: torch.Tensor) -> torch.Tensor:
            return loads + torch.where(loads.abs() > 50.0, torch.full_like(loads, torch.inf), 0.0)

    law = TorchLaw(Far())
    assert law.twist(WRENCH / 1e3, NOWHERE).any()
    with pytest.raises(NotFiniteError, match="the module Far gives no number under a load of"):
        law.twist(WRENCH, NOWHERE)


def test_only_what_was_trained_from_a_file_has_a_file(tmp_path: Path) -> None:
    law = TrainedLaw(TorchLaw(torch.nn.Linear(3, 3)), "torch", {})
    with pytest.raises(LawError, match=r"train it by --module FILE\.py:CLASS"):
        save_law(law, tmp_path / "own.safetensors")
    assert not list(tmp_path.iterdir())


def test_the_module_that_was_given_stays_as_it_was() -> None:
    module = torch.nn.Linear(3, 3)
    law = TorchLaw(module)
    before = law.twist(WRENCH, NOWHERE)
    assert module.training and module.weight.dtype == torch.float32 and module.weight.requires_grad
    with torch.no_grad():
        module.weight.zero_()
    np.testing.assert_array_equal(law.twist(WRENCH, NOWHERE), before)


def test_without_torch_it_says_so_and_all_else_goes_on(folder: Path) -> None:
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "import armflex\n"
        "arm = armflex.load_arm(armflex.bundled_robot('heavy_six') / 'arm.toml')\n"
        "arm.deflection(arm.position(J2=0.3))\n"
        f"armflex.load_law({str(folder / 'laws' / 'own.safetensors')!r}, trust={str(folder / 'code' / 'own.py')!r})\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    last = ended.stderr.splitlines()[-1]
    assert "ModelFileError" in last and "own.safetensors: a module as a law needs torch: pip install" in last


def test_on_the_command_line_it_says_what_it_runs(folder: Path, tmp_path: Path, armflex: Run) -> None:
    table = write(tmp_path, "fx_N,fy_N,fz_N,dx_m,dy_m,dz_m", np.hstack([DATA.loads, DATA.deflections]))
    given = "--module", f"{folder / 'code' / 'own.py'}:Own", "-o", tmp_path / "own.safetensors"
    refused = fine(armflex("train", table, "--model", "linear", *given), code=2)
    assert "--module does not concern --model linear (it does: torch)" in refused.stderr
    said = fine(armflex("train", table, "--model", "torch", "--starts", "1", *given, "--json", tmp_path / "said.json"))
    assert "runs the Python code of own.py:Own" in " ".join(said.stderr.split())
    assert strict_json(tmp_path / "said.json")["parameters"]["module"] == "own.py:Own"
    law = load_law(tmp_path / "own.safetensors")
    assert law.model == "torch" and law.law.twist(WRENCH, NOWHERE).any()


@pytest.mark.parametrize(
    ("module", "match"),
    [
        (None, "needs its module: FILE.py:CLASS"),
        ("own.py", "expected FILE.py:CLASS"),
        ("own.py:", "expected FILE.py:CLASS"),
        ("nowhere/own.py:Own", "own.py: cannot be read"),
        ("nowhere_at_all.own:Own", "expected FILE.py:CLASS"),
    ],
)
def test_a_module_that_is_not_there(module: str | None, match: str) -> None:
    with pytest.raises(InputError, match=match):
        train(DATA, "torch", options=Options(module=module))


def in_an_arm(folder: Path) -> Path:
    from support.small_arms import joint, link, robot, write

    parts = link("base"), link("arm", 20.0, (0.5, 0, 0)), link("tip")
    parts += joint("J", "base", "arm"), joint("T", "arm", "tip", (1.0, 0, 0), kind="fixed")
    write(folder, robot(*parts))
    return write(folder, ARM, "arm.toml")


@pytest.mark.filterwarnings("ignore:gravity:armflex.ArmflexWarning")
def test_in_an_arm_one_row_many_rows_and_a_control_loop_say_the_same(copied: Path) -> None:
    arm = load_arm(in_an_arm(copied))
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
        ("laws/own", "laws/gone", r"arm.toml:12: .*cannot be read"),
        (
            'file = "laws/own.safetensors"',
            "learn = true",
            r"arm.toml:11: .* give the 'file' that `armflex tr",
        ),
    ],
)
def test_an_arm_that_names_it_wrongly(copied: Path, old: str, new: str, match: str) -> None:
    path = in_an_arm(copied)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(ArmflexError, match=match):
        load_arm(path)


def test_an_arm_names_the_line_of_a_law_whose_code_has_changed(copied: Path) -> None:
    path = in_an_arm(copied)
    (copied / "code" / "own.py").write_text(OWN.replace("tanh", "sin"))
    with pytest.raises(ArmflexError, match=r"arm.toml:12: .*own.safetensors: .*own.py has changed since"):
        load_arm(path)


@pytest.mark.filterwarnings("ignore:gravity:armflex.ArmflexWarning")
def test_a_campaign_learns_a_correction_about_it(copied: Path) -> None:
    """The module stays as it was trained; what the arm shows beside it is learned, written, and read again."""
    path = in_an_arm(copied)
    text = path.read_text().replace('model = "torch"', 'model = "torch"\nlearn = true')
    path.write_text(text.replace("[flexure.J]", '[measurement]\nframe = "base"\n\n[flexure.J]'))
    arm = load_arm(path)
    law = arm.flexures[0].law
    truth = replace(arm, flexures=(replace(arm.flexures[0], law=scaled(law, np.full(6, 1.2)), learn=None),))
    q = np.linspace(-1.2, 1.2, 12)[:, None]
    tips = np.array([truth.deflection(one, "p").pose.translation for one in q])
    rows = Rows.of(arm.joint_names, q, ["p"] * len(q), {}, derived=("time",))
    read = Readings(len(q), (Position(tips, np.full(tips.shape, 1e-6)),))
    found = calibrate(arm, Measurements.of(rows, read))
    pairs = list(zip(q, tips, strict=True))
    before, after = (
        max(np.linalg.norm(one.deflection(here, "p").pose.translation - tip) for here, tip in pairs)
        for one in (arm, found.arm)
    )
    assert after < 0.1 * before
    again = load_arm(found.write(copied / "found.toml"))
    displacement = found.arm.deflection(q[0], "p").displacement
    np.testing.assert_allclose(again.deflection(q[0], "p").displacement, displacement, rtol=1e-6)
