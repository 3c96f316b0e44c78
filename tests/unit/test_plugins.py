"""What other distributions add: the template installed and at work, and what is wrong with others named."""

import os
import subprocess
import sys
import tomllib
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from support.small_arms import ROBOTS

from armflex.declaration import Declaration, Source
from armflex.errors import ArmFileError, PluginError
from armflex.export import Exported
from armflex.laws import LAWS
from armflex.laws.declared import LawModel, read_law
from armflex.laws.effects import CATALOGUE, EffectLaw
from armflex.laws.effects.catalogue import GROUP, _fault
from armflex.laws.effects.effect import Amplitude, TwistLaw
from armflex.laws.joint.linear import LinearLaw, read_linear
from armflex.laws.law import Law, Ranges
from armflex.laws.terms import Terms, powers
from armflex.plugins import Registry, missing
from armflex.readings import SENSOR_KINDS
from armflex.testing import check_effect, check_exporter, check_law, check_reading

TEMPLATE = Path(__file__).parents[2] / "examples" / "plugin"

LAGGING = """
import sys
from dataclasses import replace

import numpy as np
import armflex
from armflex.laws.effects import CATALOGUE, Effect, Location

arm, rng, count = armflex.load_arm(sys.argv[1]), np.random.default_rng(1), 90
q = rng.uniform(-0.8, 0.8, (count, 6))
speed = rng.uniform(-0.5, 0.5, (count, 6))
law = CATALOGUE["following_error"]
lag = Effect(law, Location("J3", "ry", ("speed_J3",)), (1e-3,))
lagging = replace(arm, effects=(lag,))
points = [lagging.deflection(q[i], "p100", covariates={"speed_J3": speed[i, 2]}).pose.translation for i in range(count)]
points += rng.normal(0.0, 2e-5, (count, 3))
names = [f"q_J{i}" for i in range(1, 7)] + [f"speed_J{i}" for i in range(1, 7)]
with open("campaign.csv", "w") as file:
    print("pose,payload,sigma", *names, "x,y,z", sep=",", file=file)
    for i in range(count):
        print(f"p{i},p100,2e-5", *q[i], *speed[i], *points[i], sep=",", file=file)
"""


def run(folder: Path, packages: Path | None, *command: str | Path) -> subprocess.CompletedProcess[str]:
    """Run Python in a folder, with a folder of installed packages or without."""
    paths = [str(path) for path in (packages, Path(__file__).parents[2]) if path]
    given = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "COLUMNS": "160"}
    return subprocess.run(
        [sys.executable, *map(str, command)], cwd=folder, env=given, capture_output=True, text=True, timeout=600
    )


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The template as pip installs it, without a network."""
    pytest.importorskip("hatchling", reason="the build backend is not installed")
    folder = tmp_path_factory.mktemp("packages")
    options = ("--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--disable-pip-version-check", "--target")
    ran = run(folder, None, "-m", "pip", "install", *options, folder, TEMPLATE)
    assert ran.returncode == 0, ran.stderr
    return folder


@pytest.mark.slow
def test_the_template_keeps_its_own_tests(installed: Path, tmp_path: Path) -> None:
    ran = run(tmp_path, installed, "-m", "pytest", "-q", "-p", "no:cacheprovider", TEMPLATE / "test_extras.py")
    assert ran.returncode == 0, ran.stdout


@pytest.mark.slow
def test_an_effect_of_a_plugin_is_traced_written_and_missed(installed: Path, tmp_path: Path) -> None:
    text = (ROBOTS / "heavy_six" / "arm.toml").read_text().replace('"robot.urdf"', f'"{ROBOTS}/heavy_six/robot.urdf"')
    (tmp_path / "arm.toml").write_text(text)
    assert (ran := run(tmp_path, installed, "-c", LAGGING, "arm.toml")).returncode == 0, ran.stderr
    ran = run(tmp_path, installed, "-m", "armflex", "trace", "arm.toml", "campaign.csv", "-o", "traced.toml")
    assert ran.returncode == 0, ran.stderr
    traced = (tmp_path / "traced.toml").read_text()
    assert 'name = "following_error"' in traced and 'armflex-extras = ">=0.1"' in traced
    assert run(tmp_path, installed, "-m", "armflex", "deflect", "traced.toml", "--covariates", "speed_J3=0.1").stdout
    alone = run(tmp_path, None, "-m", "armflex", "deflect", "traced.toml", "--covariates", "speed_J3=0.1")
    line = traced[: traced.index("armflex-extras")].count("\n") + 1
    assert alone.returncode == 2 and f"traced.toml:{line}" in alone.stderr
    needs = "needs armflex-extras >=0.1, which is not installed: install it from where armflex-extras is kept"
    assert needs in " ".join(alone.stderr.split())


@pytest.mark.slow
def test_a_law_and_an_exporter_of_a_plugin_are_used_by_name(installed: Path, tmp_path: Path) -> None:
    text = (ROBOTS / "heavy_six" / "arm.toml").read_text().replace('"robot.urdf"', f'"{ROBOTS}/heavy_six/robot.urdf"')
    start = text.index("[flexure.J1]")
    law = '[flexure.J1]\njoint = "J1"\nmodel = "contact"\ncompliance = [0, 0, 0, 0, 0, 4e-7]\nenergy = 2.0\n'
    (tmp_path / "arm.toml").write_text(text[:start] + law)
    ran = run(tmp_path, installed, "-m", "armflex", "export", "arm.toml", "--to", "stiffness_csv", "-o", "k.csv")
    assert ran.returncode == 0, ran.stderr
    assert (tmp_path / "k.csv").read_text() == "joint,stiffness\nJ1,2.5e+06\n"
    ran = run(tmp_path, installed, "-m", "armflex", "export", "arm.toml", "--to", "stiffness_csv", "--name", "k")
    assert ran.returncode == 2 and "--name has no meaning for --to stiffness_csv" in ran.stderr
    alone = run(tmp_path, None, "-m", "armflex", "export", "arm.toml", "--to", "stiffness_csv", "-o", "k.csv")
    assert alone.returncode == 2 and "'stiffness_csv' is not known" in alone.stderr


@pytest.mark.slow
def test_an_exporter_that_fails_is_named(tmp_path: Path) -> None:
    module = "def export(arm, traj):\n    return traj.via\n"
    offer(tmp_path, "stray", "[armflex.exporters]\nbroken = stray:export\n", module)
    (tmp_path / "path.csv").write_text("q_J1\n0\n")
    arm = ROBOTS / "heavy_six" / "arm.toml"
    ran = run(tmp_path, tmp_path, "-m", "armflex", "export", arm, "--to", "broken", "--traj", "path.csv", "-o", "k.txt")
    said = " ".join(ran.stderr.split())
    assert ran.returncode == 2 and "stray.py:2: stray failed: AttributeError" in said
    assert not (tmp_path / "k.txt").exists()


def warm(table: Declaration, joint: str, ranges: Ranges) -> Law:
    """Read a law that gives more where a recorded column is larger, which is an effect and no law."""
    law = read_linear(table, joint, ranges)

    class Warm(type(law)):
        def terms(self) -> Terms:
            return [replace(term, factors=powers("temp", 1)) for term in super().terms()]

    return Warm(**{field.name: getattr(law, field.name) for field in fields(law)})


def test_a_law_over_a_recorded_column_is_refused() -> None:
    model = LawModel(warm, 'model = "warm"\ncompliance = [0, 0, 0, 0, 0, 4e-7]\n')
    with pytest.raises(AssertionError, match="on the column 'temp': what depends on a recorded column is an effect"):
        check_law(model)
    table = Declaration(tomllib.loads(model.example), ("flexure", "J1"), Source(Path("arm.toml"), model.example))
    with LAWS.entered("warm", model), pytest.raises(ArmFileError, match=r"model: .*on the column 'temp'"):
        read_law(table, "J1", {"J1": (-1.0, 1.0)})


def offer(folder: Path, name: str, points: str, module: str = "") -> None:
    """Write an installed distribution with entry points and a module of its name."""
    information = folder / f"{name}-1.2.dist-info"
    information.mkdir()
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n")
    (information / "entry_points.txt").write_text(points)
    (folder / f"{name}.py").write_text(module)


@pytest.mark.parametrize(
    ("points", "complaint"),
    [
        ("backlash = stray:LAW", "both armflex and stray have 'backlash': uninstall one of them"),
        (
            "wobble = stray:LAW",
            "'stray:LAW' of stray is called 'wobble': expected an EffectLaw of armflex.laws.effects",
        ),
        ("wobble = stray:NONE", "'stray:NONE' of stray cannot be imported: AttributeError"),
    ],
)
def test_a_plugin_that_cannot_be_taken_is_named(
    points: str, complaint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    offer(tmp_path, "stray", f"[{GROUP}]\n{points}\n", "LAW = 3\n")
    monkeypatch.syspath_prepend(tmp_path)
    registry: Registry[EffectLaw] = Registry(GROUP, {"backlash": CATALOGUE["backlash"]}, _fault)
    with pytest.raises(PluginError, match=complaint):
        registry[points.partition(" ")[0]]
    if not points.startswith("backlash"):
        assert registry["backlash"] is CATALOGUE["backlash"], "a fault of another name is no fault of this one"


@pytest.mark.parametrize(
    ("wanted", "problem"),
    [
        (">=1.2", ""),
        ("1.2.0", ""),
        (">=1.10", "needs other >=1.10, but 1.2 is installed: install that from where other is kept"),
        ("1.1", "needs other 1.1, but 1.2 is installed: install that from where other is kept"),
    ],
)
def test_versions_are_compared_by_their_numbers(
    wanted: str, problem: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    offer(tmp_path, "other", "")
    monkeypatch.syspath_prepend(tmp_path)
    assert missing("other", wanted) == problem
    with pytest.raises(ValueError, match=r"expected a version such as '>=0\.1', got 'new'"):
        missing("other", "new")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["linear", "position_dependent", "hardening"])
def test_own_joint_laws_conform(name: str) -> None:
    """What all of them must be is asked in `laws/test_law_conformance.py`; here it is that this suite takes them."""
    check_law(LAWS[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["backlash", "gear_harmonic", "thermal_growth", "creep", "umbilical", "gravity_tilt"])
def test_own_effects_conform(name: str) -> None:
    check_effect(CATALOGUE[name])


WIRE = 'link = "tool"\npoint = [0.0, 0.0, 0.1]\nanchor = [1.6, -1.2, 0.3]\nanchor_std = 0.01\nsigma = 5e-5'


def test_a_kind_of_reading_conforms_and_one_with_a_wrong_sign_does_not() -> None:
    distance = SENSOR_KINDS["distance"]
    check_reading(distance, WIRE)

    class Backwards(distance):  # type: ignore[misc, valid-type]
        def ends(self, at):
            return {key: (end, -change) for key, (end, change) in super().ends(at).items()}

    with pytest.raises(AssertionError, match=r"by_own|jacobian"):
        check_reading(Backwards, WIRE)


def test_a_law_whose_tangent_is_another_does_not_conform() -> None:
    linear = LAWS["linear"]

    def read(table, joint, ranges):
        law = linear.read(table, joint, ranges)

        class Bent(type(law)):
            def tangent(self, wrench, row):
                return 1.01 * super().tangent(wrench, row)

        return Bent(law.compliance, law.relative_std)

    with pytest.raises(AssertionError, match="tangent"):
        check_law(replace(linear, read=read))


def parameters(arm: object, digits: int) -> Exported:
    return Exported(str(digits))


def options(arm: object, **given: object) -> Exported:
    return Exported("text")


@pytest.mark.parametrize(
    ("export", "complaint"),
    [(parameters, "'digits' is no option of `armflex export`"), (options, r"expected a function export\(arm, OPTION")],
)
def test_an_exporter_with_other_parameters_than_options_does_not_conform(export: object, complaint: str) -> None:
    with pytest.raises(AssertionError, match=complaint):
        check_exporter(cast(Any, export))


@dataclass(frozen=True)
class Spoilt(LinearLaw):
    """A linear law of which one method does not do what it says."""

    def scaled(self, factor: np.ndarray) -> LinearLaw:
        return self


@dataclass(frozen=True)
class Deaf(LinearLaw):
    def at(self, values: np.ndarray) -> LinearLaw:
        return self


@pytest.mark.parametrize(("law", "complaint"), [(Spoilt, "it gives more"), (Deaf, "values of `at`")])
def test_laws_whose_methods_do_nothing_do_not_conform(law: type[Law], complaint: str) -> None:
    def read(table: Declaration, joint: str, ranges: Ranges) -> Law:
        linear = read_linear(table, joint, ranges)
        return law(**{field.name: getattr(linear, field.name) for field in fields(linear)})

    with pytest.raises(AssertionError, match=complaint):
        check_law(LawModel(read, 'model = "spoilt"\ncompliance = [0, 0, 0, 0, 0, 4e-7]\n'))


def test_an_effect_with_too_few_terms_does_not_conform() -> None:
    backlash = cast(TwistLaw, CATALOGUE["backlash"])
    short = replace(backlash, terms=lambda here, inner: [])
    with pytest.raises(PluginError, match="the effect 'backlash': `terms` gives 0 lists for 1 amplitudes"):
        check_effect(short)


def test_an_effect_whose_second_amplitude_acts_nowhere_does_not_conform() -> None:
    backlash = cast(TwistLaw, CATALOGUE["backlash"])
    idle = replace(backlash, amplitudes=(*backlash.amplitudes, Amplitude("idle", "m")))
    with pytest.raises(AssertionError, match="idle acts at none of its places"):
        check_effect(idle)
