"""The arm as C: its answers are Python's, its refusals have codes, and what has no form in C is refused by name."""

import dataclasses
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.arms import bundled, corrected, crooked, networks, positions
from support.bench import some_law
from support.command_line import Run, fine
from support.compiled_arm import COMPILER, CompiledArm, compiled
from support.effect_arms import KNOWN, LAWS, arm_with, millimetre, plain
from support.learned_laws import DECLARED, LOADS, compliance, moved
from support.small_arms import LIMIT, ROBOTS, arm_of, joint, link, one_joint, random_compliance, standing, three_joints
from support.structures import nonlinear

from armflex import Arm, Payload, Trajectory, compensate, load_arm
from armflex.conventions import TWIST_NAMES
from armflex.errors import InputError, SmallDisplacementError, UnstableEquilibriumError, UnsupportedError
from armflex.export.c_code import export
from armflex.export.c_text import KEYWORDS
from armflex.laws import AtNode, Law, LinearLaw, PositionDependentLaw
from armflex.laws.effects import Effect, Location
from armflex.laws.effects.candidate import Candidate
from armflex.laws.effects.catalogue import EVERY
from armflex.laws.joint.carried import ScaledLaw
from armflex.laws.joint.hardening import HardeningLaw
from armflex.laws.joint.polynomial import FEATURES, PolynomialLaw, feature_values

pytestmark = [pytest.mark.slow, pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")]

FINE, NOT_FINITE, OUTSIDE_LIMITS, NO_PAYLOAD, NO_EQUILIBRIUM, TOO_LARGE, UNREACHED = range(7)
CLOSE = 1e-9
STATES = KNOWN | {"play_J2_dx_100": 500.0, "play_J2_ry_100": 500.0, "temperature_lagged_5s": 24.0}


def traced(folder: Path) -> Arm:
    """heavy_six as a trace leaves it: joints and links elsewhere than declared, compliances scaled, effects."""
    tables = (
        'name = "backlash"\nsite = "J2"\naxis = "ry"\nparameters = { gap = 3.6e-4 }',
        'name = "gear_harmonic"\nsite = "J3"\nparameters = { A = 3e-4, B = -2e-4, k = 9.0 }',
        'name = "deadband"\nsite = "J2"\naxis = "ry"\nparameters = { g = 3e-4, tau0 = 200.0 }',
        'name = "thermal_bending"\nsite = "J3"\naxis = "ry"\nparameters = { beta = 2e-5, lag = 5.0 }',
        'name = "umbilical"\nsite = "J4"\n'
        "parameters = { k = 300.0, anchor_x = 0.0, anchor_y = 1.0, anchor_z = 3.0, rest = 0.5 }",
    )
    return corrected(arm_with(folder, *tables))


ARMS: dict[str, Callable[[Path], Arm]] = {
    "tarm": lambda folder: bundled("tarm_like"),
    "heavy": lambda folder: bundled("heavy_six"),
    "traced": traced,
    "networks": networks,
}


@pytest.fixture(scope="module", params=ARMS)
def both(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Arm, CompiledArm]:
    folder = tmp_path_factory.mktemp(request.param)
    arm = ARMS[request.param](folder)
    code = compiled(arm, folder)
    code.know(STATES)
    return arm, code


def rows(arm: Arm, code: CompiledArm, count: int) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Return (N, nq) positions, (N,) payloads by number and by name."""
    number = np.random.default_rng(4).integers(0, len(code.payloads), count)
    return positions(arm, count), number, tuple(code.payloads[i] for i in number)


def assert_tips_alike(arm: Arm, code: CompiledArm, count: int, within: float = CLOSE) -> None:
    q, number, names = rows(arm, code, count)
    known = {name: STATES[name] for name in code.covariates}
    found = np.asarray(arm.deflection(q, names, covariates=known).pose)[:, :3]
    codes, poses = code.tips(q, number)
    assert not codes.any()
    np.testing.assert_allclose(poses, found, rtol=0, atol=within)


def test_the_tip_is_where_python_has_it(both: tuple[Arm, CompiledArm]) -> None:
    assert_tips_alike(*both, 1000, within=1e-12)


def test_what_it_says_of_itself(both: tuple[Arm, CompiledArm]) -> None:
    arm, code = both
    assert code.joints == list(arm.joint_names)
    assert code.payloads == ["none", *arm.payloads]


def test_compensation_is_pythons(both: tuple[Arm, CompiledArm]) -> None:
    """Where the tip can be held; among the joint positions that hold it the nearest, as far as Python shows them."""
    arm, code = both
    q, number, names = rows(arm, code, 1000 if arm.payloads and not arm.effects else 200)
    known = {name: STATES[name] for name in code.covariates}
    path = Trajectory(arm.joint_names, 100.0 * np.arange(len(q)), q, names, ("",) * len(q))
    path = dataclasses.replace(path, covariates={name: np.full(len(q), value) for name, value in known.items()})
    wanted = compensate(arm, path, best_effort=True)
    codes, found = code.compensated(q, number)
    assert set(codes) <= {FINE, UNREACHED}
    reached = np.array([row.reached for row in wanted.rows])
    assert (reached & (codes != FINE)).sum() <= 0.001 * len(q)
    held = codes == FINE
    assert held.sum() > 0.8 * len(q)  # three joints near singular positions cannot hold all
    again, poses = code.tips(found[held], number[held])
    assert not again.any()
    goal = np.array([arm.rigid_pose(row).translation for row in q[held]])
    np.testing.assert_allclose(poses[:, :, 3], goal, rtol=0, atol=CLOSE)
    apart = np.abs(found - wanted.trajectory.q)[held & reached].max(axis=1)
    assert (apart < 1e-7).mean() > 0.99


def test_every_effect_at_once(tmp_path: Path) -> None:
    """Each moves the tip by tens of micrometres, so that none could be missing or wrong unseen."""
    effects = [millimetre(name).effects[0] for name in LAWS]
    small = [(*(0.1 * value for value in one.amplitudes), *one.inner) for one in effects]
    effects = [dataclasses.replace(one, values=values) for one, values in zip(effects, small, strict=True)]
    arm = dataclasses.replace(plain(), effects=tuple(effects))
    code = compiled(arm, tmp_path)
    code.know(STATES)
    assert_tips_alike(arm, code, 50)
    q, _, names = rows(arm, code, 3)
    there = arm.deflection(q, names, covariates=STATES).displacement
    for effect in effects:
        without = dataclasses.replace(arm, effects=tuple(one for one in effects if one is not effect))
        off = np.abs(without.deflection(q, names, covariates=STATES).displacement - there)
        assert off.max() > 100.0 * CLOSE, effect.name


@pytest.mark.parametrize(("name", "joints"), [("tarm_like", ("A1", "A2")), ("palletizer", ("lower", "upper"))])
def test_what_flexures_remember_is_carried(name: str, joints: tuple[str, str], tmp_path: Path) -> None:
    """Loads are put on from nothing by a call alone, and dragged along from call to call; what is set is taken."""
    plain_arm = bundled(name)
    sites = [(joints[0], "ry", 60.0, 4e-7), (joints[1], "rx", 30.0, 3e-7)]
    effects = [
        Candidate(EVERY["hysteresis"], Location(site, axis), (radius,)).effect(np.array([gain]))
        for site, axis, radius, gain in sites
    ]
    arm = dataclasses.replace(plain_arm, effects=tuple(effects))
    code = compiled(arm, tmp_path)
    assert set(code.covariates) == {effect.state for effect in effects}
    q, number, names = rows(arm, code, 40)
    code.know({})
    codes, poses = code.tips(q, number)
    alone = np.asarray(arm.deflection(q, names).pose)[:, :3]
    assert not codes.any()
    np.testing.assert_allclose(poses, alone, rtol=0, atol=1e-12)
    loads, states = plain_arm.deflection(q, names).wrenches, {}
    for effect, (site, axis, radius, _) in zip(effects, sites, strict=True):
        load, state = loads[:, plain_arm.flexure_names.index(site), TWIST_NAMES.index(axis)], 0.0
        states[str(effect.state)] = np.array([state := min(max(state, x - radius), x + radius) for x in load])
    along = np.asarray(arm.deflection(q, names, covariates=states).pose)[:, :3]
    codes, poses = code.followed(q, number)
    assert not codes.any() and np.abs(along - alone).max() > 1e-6
    np.testing.assert_allclose(poses, along, rtol=0, atol=1e-12)
    code.know({name: values[7] for name, values in states.items()})
    np.testing.assert_allclose(code.tips(q[7:8], number[7:8])[1][0], along[7], rtol=0, atol=1e-12)
    code.know({})
    codes, held = code.compensated(q, number)
    goal = np.array([arm.rigid_pose(row).translation for row in q])
    at = np.asarray(arm.deflection(held[codes == FINE], list(np.array(names)[codes == FINE])).pose)[:, :3, 3]
    assert (codes == FINE).mean() > 0.5
    np.testing.assert_allclose(at, goal[codes == FINE], rtol=0, atol=CLOSE)


def test_effects_of_two_columns_and_of_other_laws_than_straight_ones(tmp_path: Path) -> None:
    """Softening of a position-dependent law, and of one with a network; a pull of the dress pack at the former."""
    depending = PositionDependentLaw("yaw", np.array([3.0 * random_compliance(4), 0.1 * random_compliance(5)]))
    arm = three_joints(tmp_path, [depending, some_law(6, 1, 2), LinearLaw(random_compliance(3))])
    warm = {"beta": 0.02, "reference": 20.0}
    effects = [
        _effect("thermal_softening", Location("yaw", "rz", ("temperature",)), **warm),
        _effect("thermal_softening", Location("pitch", None, ("temperature",)), **warm),
        _effect("dress_pack", Location("yaw", "rz", ("q_yaw",)), k=50.0),
    ]
    arm = dataclasses.replace(arm, effects=tuple(effects))
    code = compiled(arm, tmp_path)
    code.know(STATES)
    assert_tips_alike(arm, code, 100)


def _effect(name: str, location: Location, **values: float) -> Effect:
    law = EVERY[name]
    return Effect(law, location, tuple(values.get(part.name, 0.0) for part in (*law.amplitudes, *law.inner)))


TRAVEL = 'lower="-1.3" upper="1.7" effort="1e6" velocity="1"'
"""Of the joint on whose position laws of `DECLARED` depend."""


def every_law() -> list[Law]:
    """Every law that is no plain compliance, scaled along its axes, and at a node beside its joint."""
    rng = np.random.default_rng(3)
    typical = np.abs(feature_values(LOADS)).mean(axis=0)
    coefficients = rng.normal(size=(len(FEATURES), 6)) * np.repeat([5e-6, 1e-5], 3) / typical[:, None]
    size, seen = len(FEATURES), np.array([LOADS.min(axis=0), LOADS.max(axis=0)])
    polynomial = PolynomialLaw(FEATURES, coefficients, np.zeros((6, size, size)), np.zeros(6), seen)
    learned = [moved(name) for name in DECLARED]
    ends = [{"faded": 3.0, "energy": energy} for energy in (None, compliance(rigid=2) / 5.0)]
    learned = [dataclasses.replace(law, seen=dataclasses.replace(law.seen, **end)) for law in learned for end in ends]
    laws = [*learned, HardeningLaw(0.1 * compliance(), 0.5), polynomial, some_law(6, 1, 2), some_law(3, 2, 2)]
    scaled = [ScaledLaw(law, np.log(0.01) + 0.1 * rng.normal(size=6)) for law in laws]
    return [*scaled, *(AtNode(law, np.array([0.02, 0.1, -0.05])) for law in scaled)]


def test_every_law_at_once(tmp_path: Path) -> None:
    laws, rng = every_law(), np.random.default_rng(6)
    parts = [
        link("base"),
        joint("A", "base", "l0", (0, 0, 0.3), (0.1, 0, 0), (0, 0, 1)),
        link("l0", 10.0, (0.1, 0.0, 0.1)),
        joint("B", "l0", "m2", (0.1, 0, 0.2), (0, 0.2, 0.1)).replace(LIMIT, TRAVEL),
        link("m2", 5.0, (0.1, 0.02, 0)),
    ]
    for i in range(3, len(laws) + 1):
        turn = 0.3 * rng.normal(size=3)
        parts += [joint(f"f{i}", f"m{i - 1}", f"m{i}", (0.05, 0.01, 0.02), turn, kind="fixed"), link(f"m{i}", 3.0)]
    names = ["A", "B", *(f"f{i}" for i in range(3, len(laws) + 1))]
    arm = arm_of(tmp_path, parts, f"m{len(laws)}", dict(zip(names, laws, strict=True)))
    code = compiled(arm, tmp_path)
    assert_tips_alike(arm, code, 30)


def test_oblique_and_sliding_joints_and_flexures_at_the_base_and_before_a_joint(tmp_path: Path) -> None:
    laws = [LinearLaw(random_compliance(seed)) for seed in range(4)]
    where = {"base": (None, laws[0]), "slide": ("slide", laws[1]), "seam": ("seam", laws[2])}
    arm = crooked(tmp_path, where | {"before": ("roll", laws[3], True)})
    arm = dataclasses.replace(arm, payloads={"p": Payload(20.0, np.array([0.1, -0.2, 0.05]))})
    for one in (arm, corrected(arm), dataclasses.replace(arm, flexures=())):
        assert_tips_alike(one, compiled(one, tmp_path), 100, within=1e-12)


@pytest.fixture(scope="module")
def heavy(tmp_path_factory: pytest.TempPathFactory) -> CompiledArm:
    return compiled(bundled("heavy_six"), tmp_path_factory.mktemp("heavy"))


@settings(max_examples=80)
@given(st.data())
def test_whatever_is_asked_has_an_answer_or_a_code(heavy: CompiledArm, data: st.DataObject) -> None:
    arm = bundled("heavy_six")
    number = st.one_of(st.floats(allow_nan=True, allow_infinity=True), st.floats(-4.0, 4.0))
    q = np.array([data.draw(st.lists(number, min_size=6, max_size=6))])
    payload = np.array([data.draw(st.integers(-(2**31), 2**31 - 1) | st.integers(-2, 5))])
    with np.errstate(invalid="ignore"):
        absurd = not (np.abs(q) <= 1e3).all()
    expected = FINE if arm.within_limits(q[0].tolist()) else NOT_FINITE if absurd else OUTSIDE_LIMITS
    expected = expected if 0 <= payload[0] < len(heavy.payloads) else NO_PAYLOAD
    codes, poses = heavy.tips(q, payload)
    assert codes == [expected]
    assert np.isfinite(poses).all() if expected == FINE else np.isnan(poses).all()
    codes, found = heavy.compensated(q, payload)
    assert codes == [expected] if expected != FINE else codes[0] in (FINE, UNREACHED)
    assert np.isfinite(found).all() if codes == [FINE] else np.isnan(found).all()


def test_a_covariate_that_was_not_set_has_a_code(tmp_path: Path) -> None:
    code = compiled(traced(tmp_path), tmp_path)
    codes, poses = code.tips(np.zeros((1, 6)), np.zeros(1, dtype=int))
    assert codes == [NOT_FINITE] and np.isnan(poses).all()


def test_soft_arms_that_only_newton_settles(tmp_path: Path) -> None:
    """Hanging under 300 kg: they swing from step to step of the fixed point, but stay; also when they compensate."""
    arm = three_joints(tmp_path, [LinearLaw(random_compliance(i, 20.0)) for i in range(3)])
    arm = dataclasses.replace(arm, payloads={"heavy": Payload(300.0, [0.1, 0.0, 0.0])})
    code, rng = compiled(arm, tmp_path), np.random.default_rng(0)
    q = np.array([0.0, 1.55, 0.0]) + rng.uniform([-3.0, -0.05, -0.05], [3.0, 0.05, 0.05], (1000, 3))
    number = np.full(len(q), code.payloads.index("heavy"))
    codes, poses = code.tips(q, number)
    by_newton = 0
    for row, pose, found in zip(q, poses, codes, strict=True):
        try:
            one = arm.deflection(row, "heavy")
        except SmallDisplacementError:
            assert found == TOO_LARGE
            continue
        by_newton += one.method == "newton"
        assert found == FINE
        np.testing.assert_allclose(pose, one.pose.homogeneous[:3], rtol=0, atol=CLOSE)
    assert by_newton > 700
    codes, moved = code.compensated(q[:200], number[:200])
    held = codes == FINE
    assert set(codes) <= {FINE, TOO_LARGE, UNREACHED} and held.sum() > 10
    tips = [arm.deflection(row, "heavy", enforce_limits=False).pose.translation for row in moved[held]]
    np.testing.assert_allclose(tips, [arm.rigid_pose(row).translation for row in q[:200][held]], rtol=0, atol=CLOSE)


@pytest.mark.parametrize(
    ("softness", "expected"), [(0.02, FINE), (0.0509, FINE), (0.0511, NO_EQUILIBRIUM), (0.2, NO_EQUILIBRIUM)]
)
@pytest.mark.filterwarnings("ignore:near_buckling:armflex.ArmflexWarning")
def test_an_arm_that_would_buckle_has_no_equilibrium(tmp_path: Path, softness: float, expected: int) -> None:
    """2 kg straight above a joint 1 m below: it balances exactly, and falls once its compliance is 1 / (2 g)."""
    arm = standing(tmp_path, softness, 1.0)
    codes, poses = compiled(arm, tmp_path).tips(np.zeros((1, 1)), np.zeros(1, dtype=int))
    assert codes == [expected]
    if expected == NO_EQUILIBRIUM:
        with pytest.raises(UnstableEquilibriumError):
            arm.deflection([0.0])
    else:
        np.testing.assert_allclose(poses[0], arm.deflection([0.0]).pose.homogeneous[:3], rtol=0, atol=CLOSE)


def test_a_flexure_that_turns_far_has_a_code(tmp_path: Path) -> None:
    arm = one_joint(tmp_path, LinearLaw(np.diag([1e-8] * 3 + [1e-6, 1e-2, 1e-6])), (1.0, 0.0, 0.0))
    codes, poses = compiled(arm, tmp_path).tips(np.zeros((1, 1)), np.zeros(1, dtype=int))
    assert codes == [TOO_LARGE] and np.isnan(poses).all()


def test_nothing_in_it_changes_but_the_covariates(tmp_path: Path) -> None:
    """Any number of threads may ask at once."""
    nm = shutil.which("nm")
    if nm is None:
        pytest.skip("there is no nm")
    source, made = tmp_path / "arm.c", tmp_path / "arm.o"
    source.write_text(export(traced(tmp_path), "six").text)
    subprocess.run([COMPILER, "-std=c99", "-O2", "-fno-pie", "-c", "-o", made, source], check=True, timeout=600)
    listed = subprocess.run([nm, made], capture_output=True, text=True, check=True, timeout=600).stdout.splitlines()
    symbols = [line.split()[-2:] for line in listed]
    assert {name for kind, name in symbols if kind in "bBdDC"} == {"six_covariates"}
    wanted = {name for kind, name in symbols if kind == "U"} - {"_GLOBAL_OFFSET_TABLE_", "__stack_chk_fail"}
    mathematics = "sin cos tanh sqrt exp log1p pow floor rint fmin fmax"
    assert wanted <= {*mathematics.split(), "memcpy", "memset"}


@pytest.mark.parametrize("name", ["tarm", "traced", "networks"])
def test_it_takes_no_more_stack_than_it_says(tmp_path: Path, name: str) -> None:
    """Nothing calls itself, so that no function's stack can count twice."""
    if "gcc" not in subprocess.run([COMPILER, "--version"], capture_output=True, text=True, timeout=600).stdout.lower():
        pytest.skip("the compiler does not tell")
    found = export(ARMS[name](tmp_path))
    (tmp_path / "arm.c").write_text(found.text)
    subprocess.run([COMPILER, "-std=c99", "-O2", "-fstack-usage", "-c", "arm.c"], cwd=tmp_path, check=True, timeout=600)
    lines = [line.split("\t") for line in (tmp_path / "arm.su").read_text().splitlines()]
    assert {kind for *_, kind in lines} <= {"static", "dynamic,bounded"}  # of both the size is the most
    taken: dict[str, int] = {}
    for place, size, _ in lines:  # a compiler may part a function in two
        function = place.rpartition(":")[2].partition(".")[0]
        taken[function] = taken.get(function, 0) + int(size)
    asked = {"tip": "arm_tip", "compensate": "arm_compensate", "follow": "arm_follow"}
    below = sum(size for function, size in taken.items() if function not in asked.values())
    for short, function in asked.items():
        assert taken[function] + below <= found.numbers["stack_bytes"][short]


def test_what_has_no_form_in_c_is_refused_with_what_it_amounts_to(tmp_path: Path) -> None:
    laws = [LinearLaw(random_compliance(1)), nonlinear(), LinearLaw(random_compliance(3))]
    with pytest.raises(UnsupportedError, match=r"flexure 'pitch' is a StructuralLaw.*moves the tip by up to \d.* mm"):
        export(three_joints(tmp_path, laws))
    softening = _effect("thermal_softening", Location("pitch", None, ("temperature",)), beta=0.02, reference=20.0)
    with pytest.raises(UnsupportedError, match=r"flexure 'pitch'.*effect 'thermal_softening pitch' .*covariates at 0"):
        export(dataclasses.replace(three_joints(tmp_path, laws), effects=(softening,)))


def test_names_that_would_end_a_comment_or_a_text_do_not(tmp_path: Path) -> None:
    odd = 'a*/ "b" \\ ??/ é'
    parts = [link("base"), joint(odd.replace('"', "&quot;"), "base", "body"), link("body", 3.0)]
    arm = arm_of(tmp_path, parts, "body", {odd: LinearLaw(random_compliance(1))})
    arm = dataclasses.replace(arm, payloads={odd: Payload(1.0, np.zeros(3))})
    code = compiled(arm, tmp_path)
    assert code.joints == [odd] and code.payloads == ["none", odd]


@pytest.mark.parametrize("name", ["3d", "", "a-b", "int", "a b", "é", *KEYWORDS.split()[:2]])
def test_a_name_that_c_does_not_have_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="is no name in C"):
        export(bundled("heavy_six"), name)


ARM = Path(__file__).parents[3] / "robots" / "heavy_six" / "arm.toml"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("--to", "d", "-o", "a.c"), "'d' is not known"),
        (("-o", "a.c"), "missing option '--to'"),
        (("--to", "c"), "--to c needs -o"),
        (("--to", "c", "-o", "a.c", "--name", "2"), "'2' is no name in C"),
        (("--to", "c", "-o", "nowhere/a.c"), "folder nowhere of 'a.c' does not exist"),
        (("--to", "c", "-o", ARM), "is an input of this command"),
    ],
)
def test_bad_input_on_the_command_line(armflex: Run, tmp_path: Path, arguments: tuple, text: str) -> None:
    before = ARM.read_bytes()
    result = armflex("export", ARM, *arguments)
    assert result.returncode == 2 and text in result.stderr and "Traceback" not in result.stderr
    assert not (tmp_path / "a.c").exists() and ARM.read_bytes() == before


def test_the_command_writes_the_file_and_says_what_it_needs(armflex: Run, tmp_path: Path) -> None:
    traced(tmp_path)
    said = fine(armflex("export", tmp_path / "arm.toml", "--to", "c", "-o", tmp_path / "six.c", "--name", "six"))
    assert "set six_covariates before you ask: approach_J2, temperature_lagged_5s" in said.stdout
    assert said.stdout.startswith("heavy_six as C, payloads ")
    assert "int six_tip(const double *q, int payload, double *pose);" in (tmp_path / "six.c").read_text()


@pytest.mark.parametrize(
    "robot", ["tool = { xyz = [0.1, 0.0, 0.2], rpy = [0.3, 0.0, 0.1] }", "mount = { rpy = [3.14159, 0.1, 0.0] }"]
)
def test_a_tool_and_a_mount_are_in_it(robot: str, tmp_path: Path) -> None:
    """The tip is the tool's, and weight pulls as it does on a base that hangs from a ceiling."""
    shutil.copytree(ROBOTS / "heavy_six", tmp_path / "six")
    file = tmp_path / "six" / "arm.toml"
    text = file.read_text().replace('tip = "tool"', f'tip = "tool"\n{robot}', 1)
    file.write_text(re.sub("gravity = .*", "", text) if "mount" in robot else text)
    arm, plain = load_arm(file), load_arm(ROBOTS / "heavy_six" / "arm.toml")
    q = np.random.default_rng(5).uniform(-0.8, 0.8, (20, 6))
    made = compiled(arm, tmp_path)
    codes, poses = made.tips(q, np.full(20, made.payloads.index("p100")))
    expected = arm.deflection(q, "p100").pose[:, :3]
    assert not codes.any() and np.abs(poses - expected).max() < 1e-9
    assert np.abs(poses - plain.deflection(q, "p100").pose[:, :3]).max() > 1e-3
