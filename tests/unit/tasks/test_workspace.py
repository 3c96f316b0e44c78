"""Workspace maps: against a plain loop and a closed form; questions without sense."""

import csv
import json
import os
import signal
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from safetensors import safe_open
from safetensors.numpy import load_file, save_file
from scipy.optimize import brentq
from scipy.stats import qmc
from support.command_line import wait_for
from support.small_arms import ROBOTS, arm_of, central_difference, joint, link, one_joint, robot, three_joints

from armflex import Arm, load_arm, map_workspace
from armflex.conventions import TWIST_NAMES
from armflex.errors import (
    ConvergenceError,
    ExtrapolationError,
    FileError,
    InputError,
    SmallDisplacementError,
    UnknownNameError,
    UnstableEquilibriumError,
)
from armflex.estimate.draw import draw_arms
from armflex.laws import LinearLaw, Row
from armflex.laws.law import WithoutParameters
from armflex.mechanics.mechanism import Closing
from armflex.parallel import WAVE, in_order
from armflex.parameters import Certainty
from armflex.show.view.map_page import map_page
from armflex.tasks.workspace import WorkspaceMap, draw_map, read_map, write_map
from armflex.tasks.workspace.cells import Tally, cell_indices, cell_numbers, joined

pytestmark = pytest.mark.slow

Run = Callable[..., subprocess.CompletedProcess]
TARM = ROBOTS / "tarm_like" / "arm.toml"
PAYLOADS = ("none", "p600")


def test_a_mechanism_is_followed_from_row_to_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows as they are drawn are a third of the range of 0.6 m apart, and each would be closed in many steps.

    Where the column's joint stands has nothing to do with what the cylinder closes.
    """
    parts = [link("ground"), link("base", 1.0), link("boom", 4.0, (0.5, 0.0, 0.0), 0.2), link("tool")]
    parts += [joint("turn", "ground", "base", axis=(0.0, 0.0, 1.0))]
    parts += [joint("j", "base", "boom", (0.0, 0.0, 0.3), axis=(0.0, 1.0, 0.0))]
    (tmp_path / "r.urdf").write_text(robot(*parts, joint("end", "boom", "tool", (1.0, 0.2, 0.1), kind="fixed")))
    ends = 'link = "base"\nat = [0.0, 0.0, -0.3]\nto = "boom"\nat_to = [0.6, 0.0, 0.0]\nlower = 0.5\nupper = 1.1\n'
    text = f'[robot]\nurdf = "r.urdf"\ntip = "tool"\n[joint.j]\npassive = true\n[cylinder.c]\n{ends}'
    (tmp_path / "arm.toml").write_text(text)
    arm, closed = load_arm(tmp_path / "arm.toml"), Closing.closed
    asked = list[float]()

    def followed(self: Closing, q: np.ndarray) -> np.ndarray:
        asked.append(float(q[1]))
        return closed(self, q)

    monkeypatch.setattr(Closing, "closed", followed)
    found = map_workspace(arm, rows=256)
    assert found.configurations.sum() == found.answered.sum() == 256
    assert 0 < len(asked) < 32  # the engine closes all others from where it closed those before


def configurations(arm: Arm, rows: int, seed: int) -> np.ndarray:
    """Return what a map draws, drawn another way: all at once, a power of two of them."""
    drawn = qmc.Sobol(len(arm.joint_names), seed=np.random.default_rng(seed)).random(1 << (rows - 1).bit_length())
    return qmc.scale(drawn, arm.robot.lower, arm.robot.upper)[:rows]


def same(one: WorkspaceMap, other: WorkspaceMap) -> bool:
    """Return whether two maps agree to the last bit."""
    pairs = ((getattr(one, field.name), getattr(other, field.name)) for field in fields(WorkspaceMap))
    return all(np.array_equal(a, b, equal_nan=True) if isinstance(a, np.ndarray) else a == b for a, b in pairs)


def near(one: WorkspaceMap, other: WorkspaceMap) -> bool:
    """Return whether two maps agree to rounding."""
    pairs = ((getattr(one, field.name), getattr(other, field.name)) for field in fields(WorkspaceMap))
    close = [
        np.allclose(a, b, rtol=1e-12, atol=1e-14, equal_nan=True)
        if isinstance(a, np.ndarray) and a.dtype.kind == "f"
        else np.array_equal(a, b)
        if isinstance(a, np.ndarray)
        else a == b
        for a, b in pairs
    ]
    return all(close)


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ask so few configurations at once that a small map is joined of several tallies."""
    monkeypatch.setattr("armflex.tasks.workspace.workspace_map.CHUNK", 64)


def test_a_plain_loop_finds_the_same(tarm: Arm) -> None:
    """Every configuration by itself, its voxel by its rigid tip, and the worst of each."""
    found = map_workspace(tarm, PAYLOADS, rows=150, voxel=2.0, seed=3)
    met = defaultdict(list)
    for q in configurations(tarm, 150, 3):
        place = tuple(np.floor(tarm.rigid_pose(q).translation / 2.0).astype(int))
        met[place] += [(tarm.deflection(q, name), name) for name in PAYLOADS]
    assert sorted(met) == [tuple(place) for place in found.index.tolist()]
    for i, place in enumerate(found.index.tolist()):
        here = met[tuple(place)]
        lengths = [np.linalg.norm(one.displacement[:3]) for one, _ in here]
        worst, name = here[int(np.argmax(lengths))]
        assert (found.configurations[i], found.answered[i]) == (len(here) / 2, len(here))
        np.testing.assert_allclose(found.mean[i], np.mean(lengths), rtol=1e-9)
        np.testing.assert_allclose(found.worst[i], max(lengths), rtol=1e-9)
        np.testing.assert_allclose(found.sigma[i], worst.sigma(), rtol=1e-7)
        np.testing.assert_allclose(found.worst_q[i], worst.q, atol=1e-12)
        assert found.payloads[found.worst_payload[i]] == name
    assert not found.refused.any() and "up to" in repr(found)


@pytest.mark.filterwarnings("ignore:tolerance:armflex.ArmflexWarning")
def test_a_pendulum_in_closed_form(tmp_path: Path) -> None:
    """A rod turns by f at its hinge, f = k cos(q + f): its tip moves by a chord, and beyond 0.1 rad it is refused."""
    k = 0.12
    law = LinearLaw(np.diag([0, 0, 0, 0, k / (2.0 * 9.81 * 0.5), 0]))
    arm = one_joint(tmp_path, law, (0.5, 0, 0))
    found = map_workspace(arm, rows=512, voxel=0.05, seed=1)
    turns = np.array([brentq(lambda f, q=q: f - k * np.cos(q + f), -1, 1) for (q,) in configurations(arm, 512, 1)])
    assert found.refused.sum(axis=0).tolist() == [0, int((np.abs(turns) > 0.1).sum()), 0, 0]
    assert found.answered.sum() == (np.abs(turns) <= 0.1).sum() > 100
    some = found.answered > 0
    expected = [2.0 * abs(np.sin(0.5 * brentq(lambda f, q=q: f - k * np.cos(q + f), -1, 1))) for (q,) in found.worst_q]
    np.testing.assert_allclose(found.worst[some], np.array(expected)[some], atol=1e-10)
    assert found.sigma is None
    assert np.isnan(found.worst[~some]).all() and (~some).any()
    refused = found.refused.any(axis=1)
    assert (found.verdicts(1.0) == np.where(refused, "fail", "ok")).all()
    assert (found.margin(1.0)[refused] == -np.inf).all()


def test_what_a_fit_left_uncertain_is_propagated(heavy: Arm) -> None:
    """By central differences through arms whose compliances and offsets were moved; the instrument has no part."""
    names = heavy.joint_names
    labels = [f"instrument {axis}" for axis in TWIST_NAMES] + [f"joint_offset {name}" for name in names]
    labels += ["compliance J1 rx", "compliance J3 ry"]
    mix = np.random.default_rng(5).normal(size=(len(labels),) * 2)
    size = np.diag([1.0] * 6 + [3e-4] * len(names) + [0.2, 0.2])
    known = size @ (mix @ mix.T / len(labels)) @ size
    arm = replace(heavy, certainty=Certainty(heavy.named(labels), known))
    found = map_workspace(arm, rows=12, voxel=0.001)
    assert "no_certainty" not in [flag.code for flag in found.flags]

    def shift(values: np.ndarray, q: np.ndarray) -> np.ndarray:
        moved = softer(heavy, {"J1": (3, values[-2]), "J3": (4, values[-1])})
        tip = moved.deflection(q + values[6:-2], enforce_limits=False).pose.translation
        return tip - heavy.rigid_pose(q).translation

    for sigma, q in zip(found.sigma, found.worst_q, strict=True):
        columns = central_difference(lambda values, q=q: shift(values, q), np.zeros(len(labels)), 1e-4)
        laws = softer(heavy, {}, certain=("J1", "J3")).deflection(q).covariance[:3, :3]
        along = shift(np.zeros(len(labels)), q)
        along /= np.linalg.norm(along)
        np.testing.assert_allclose(sigma**2, along @ (columns @ known @ columns.T + laws) @ along, rtol=1e-4)
    assert map_workspace(arm, rows=12, uncertainty=False).sigma is None
    other = replace(arm, certainty=Certainty(arm.named(("compliance J9 rx",)), np.eye(1)))
    assert [flag.code for flag in map_workspace(other, rows=12).flags] == ["no_certainty"]


def test_draws_are_asked_as_well(tarm: Arm) -> None:
    """The map is what it is without draws; beside it, the worst of a voxel among all arms drawn, each asked alone."""
    asked = {"rows": 200, "voxel": 2.0, "seed": 3}
    found, plain = map_workspace(tarm, PAYLOADS, **asked, draws=3), map_workspace(tarm, PAYLOADS, **asked)
    assert (found.draws, plain.worst_of_draws) == (3, None) and plain.sigma is not None
    assert same(replace(found, draws=0, worst_of_draws=None), plain)
    q = configurations(tarm, 200, 3)
    lengths = np.zeros(len(q))
    for drawn in draw_arms(tarm, 3, seed=3):
        for name in PAYLOADS:
            lengths = np.maximum(lengths, [np.linalg.norm(drawn.deflection(one, name).displacement[:3]) for one in q])
    places = np.array([np.floor(tarm.rigid_pose(one).translation / 2.0).astype(int) for one in q])
    expected = [lengths[(places == place).all(axis=1)].max() for place in found.index]
    np.testing.assert_allclose(found.worst_of_draws, expected, rtol=1e-9)
    with pytest.raises(InputError, match="draws"):
        map_workspace(tarm, rows=1, draws=-1)


def test_what_is_ok_is_so_for_all_that_are_drawn(tarm: Arm) -> None:
    """A voxel that would be ok is uncertain where an arm drawn is not; no other verdict depends on draws."""
    found = map_workspace(tarm, "p600", rows=256, voxel=0.001, draws=3, uncertainty=False)  # one configuration in each
    limit = float(np.median(found.worst))
    beyond = np.where(found.worst_of_draws > limit, "uncertain", "ok")
    expected = np.where(found.worst > limit, "fail", beyond)
    assert (found.verdicts(limit) == expected).all() and set(expected) == {"ok", "uncertain", "fail"}


@pytest.mark.filterwarnings("ignore:tolerance:armflex.ArmflexWarning")
def test_a_drawn_arm_without_an_answer(tmp_path: Path) -> None:
    """A hinge whose drawn compliance turns too far: the arm's own answers stay, and none of them is ok."""
    law = LinearLaw(np.diag([0, 0, 0, 0, 0.09 / (2.0 * 9.81 * 0.5), 0]), relative_std=0.5)
    arm = one_joint(tmp_path, law, (0.5, 0, 0))
    found = map_workspace(arm, rows=256, voxel=0.05, draws=8)
    lost = np.isposinf(found.worst_of_draws)
    assert 0 < lost.sum() < len(found) and not found.refused.any()
    assert (found.verdicts(10.0) == np.where(lost, "uncertain", "ok")).all()
    assert same(read_map(write_map(found, tmp_path / "map.safetensors")), found)
    with write_map(found, tmp_path / "map.csv").open() as file:
        told = [row["worst_of_draws"] for row in csv.DictReader(file)]
    assert told == ["" if np.isinf(x) else str(x) for x in found.worst_of_draws]


def softer(arm: Arm, factors: dict[str, tuple[int, float]], certain: Sequence[str] = ()) -> Arm:
    """Return an arm with entries of compliances times exp(value), and some laws without a flag of their own."""
    flexures = []
    for flexure in arm.flexures:
        law = flexure.law
        if flexure.name in factors:
            axis, value = factors[flexure.name]
            scale = np.ones(6)
            scale[axis] = np.exp(0.5 * value)
            law = replace(law, compliance=law.compliance * np.outer(scale, scale))
        flexures.append(replace(flexure, law=replace(law, relative_std=0.0) if flexure.name in certain else law))
    return replace(arm, flexures=tuple(flexures))


@dataclass(frozen=True)
class Refusing(WithoutParameters):
    """Gives nothing, and refuses for a reason that depends on where its joint is."""

    limits: tuple[tuple[float, Exception], ...]

    def twist(self, wrench: np.ndarray, row: Row) -> np.ndarray:
        for low, error in self.limits:
            if (np.asarray(row.position("j")) > low).any():
                raise error
        return np.zeros_like(wrench)

    def tangent(self, wrench: np.ndarray, row: Row) -> np.ndarray:
        return np.zeros((*wrench.shape, 6))


REFUSALS = (
    (1.0, UnstableEquilibriumError("buckles", -1.0)),
    (0.8, SmallDisplacementError("turns", [])),
    (0.5, ConvergenceError("wanders", ())),
    (0.2, ExtrapolationError("never seen")),
)


def test_refusals_are_counted_by_reason_and_the_others_answered(tmp_path: Path) -> None:
    arm = one_joint(tmp_path, Refusing(REFUSALS), (0.5, 0, 0))
    found = map_workspace(arm, rows=200)
    (q,) = configurations(arm, 200, 0).T
    counts = dict(zip(found.reasons, found.refused.sum(axis=0).tolist(), strict=True))
    assert counts == {
        "unstable": (q > 1.0).sum(),
        "too_large": ((q > 0.8) & (q <= 1.0)).sum(),
        "no_equilibrium": ((q > 0.5) & (q <= 0.8)).sum(),
        "beyond_training": ((q > 0.2) & (q <= 0.5)).sum(),
    }
    assert min(counts.values()) > 0
    assert found.answered.sum() == (q <= 0.2).sum() and found.configurations.sum() == 200


def test_another_error_is_not_a_refusal(tmp_path: Path) -> None:
    arm = one_joint(tmp_path, Refusing(((0.0, InputError("nonsense")),)), (0.5, 0, 0))
    with pytest.raises(InputError, match="nonsense"):
        map_workspace(arm, rows=8)


def test_verdicts_are_those_of_check(tarm: Arm) -> None:
    """ok: twice the uncertainty fits in the margin; fail: it does not reach it; uncertain between."""
    found = map_workspace(tarm, "p600", rows=128, voxel=0.001)  # one configuration in each
    assert len(found) == 128 and (found.configurations == 1).all()
    margin = found.margin(0.1)
    flagged = np.abs(margin) < 2.0 * found.sigma
    expected = np.where(flagged, "uncertain", np.where(margin >= 0.0, "ok", "fail"))
    assert (found.verdicts(0.1) == expected).all() and set(expected) == {"ok", "uncertain", "fail"}


@st.composite
def tallies(draw: st.DrawFn) -> Tally:
    count = draw(st.integers(0, 12))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    sizes = rng.integers(0, 4, count).astype(float)
    whole = rng.integers(0, 5, (count, 6))
    return Tally(
        rng.integers(0, 4, count), *whole[:, :2].T, whole[:, 2:], sizes, sizes, rng.integers(0, 3, count),
        rng.random((count, 2)), rng.choice([-np.inf, 1.0, np.inf], count),
    )  # fmt: skip


@given(st.lists(tallies(), min_size=1, max_size=5), st.integers(0, 5))
def test_parts_may_be_joined_first(parts: list[Tally], split: int) -> None:
    def joined_at(cut: int) -> Tally:
        groups = [group for group in (parts[:cut], parts[cut:]) if group]
        return joined([joined(group) for group in groups])

    one, other = joined(parts), joined_at(split)
    assert (np.diff(one.cell) > 0).all()
    for field in fields(Tally):
        assert np.array_equal(getattr(one, field.name), getattr(other, field.name))
    assert one.refused.sum() == sum(part.refused.sum() for part in parts)
    drawn = [(cell, most) for part in parts for cell, most in zip(part.cell, part.worst_of_draws, strict=True)]
    assert one.worst_of_draws.tolist() == [max(most for cell, most in drawn if cell == own) for own in one.cell]


@given(st.lists(st.tuples(*[st.integers(-(1 << 20), (1 << 20) - 1)] * 3), min_size=1, max_size=20))
def test_cells_have_numbers_of_their_own(indices: list[tuple[int, int, int]]) -> None:
    numbers = cell_numbers((np.array(indices) + 0.5) * 0.25, 0.25)
    assert np.array_equal(cell_indices(numbers), indices)


def test_work_is_not_begun_far_ahead_of_what_is_taken() -> None:
    begun = []
    results = in_order((lambda i=i: begun.append(i) or i) for i in range(1000))
    assert [next(results) for _ in range(3)] == [0, 1, 2] and len(begun) <= WAVE
    assert list(results) == list(range(3, 1000)) and list(in_order([])) == []


def test_a_continuous_joint_makes_one_turn(tmp_path: Path) -> None:
    parts = [link("base"), joint("j", "base", "body", kind="continuous"), link("body", 2.0, (0.5, 0, 0))]
    parts += [joint("flange", "body", "tool", (1, 0, 0), kind="fixed"), link("tool")]
    arm = arm_of(tmp_path, parts, "tool", {"j": np.diag([1e-6, 1e-6, 1e-6, 0, 1e-5, 0])})
    found = map_workspace(arm, rows=256, voxel=0.01)
    assert [str(flag) for flag in found.flags] == ["full_turn: j: without limits, so drawn over one turn about zero"]
    assert -np.pi <= found.worst_q.min() < -3.1 and 3.1 < found.worst_q.max() <= np.pi


@pytest.mark.parametrize(
    ("wrong", "error", "text"),
    [
        ({"payloads": "p60"}, UnknownNameError, "did you mean 'p600'"),
        ({"payloads": ("p600", "p600")}, InputError, "different"),
        ({"payloads": ()}, InputError, "expected one name"),
        ({"payloads": (None,)}, InputError, "expected one name"),
        ({"rows": -5}, InputError, "-5 configurations: expected 1 to"),
        ({"rows": 2**31}, InputError, "expected 1 to 1073741824"),
        ({"rows": 1e3}, InputError, "whole numbers"),
        ({"seed": -1}, InputError, "seed is -1"),
        ({"voxel": 0.0}, InputError, "voxel must be positive"),
        ({"voxel": float("nan")}, InputError, "voxel must be positive"),
        ({"voxel": 1e-3, "rows": 10**7}, InputError, "more than 5000000"),
        ({"voxel": 1e-6}, InputError, "larger ones"),
        ({"method": "newtom"}, UnknownNameError, "did you mean 'newton'"),
    ],
)
def test_a_question_without_sense_is_refused(
    tarm: Arm, wrong: dict[str, object], error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=text):
        map_workspace(tarm, **{"rows": 8, **wrong})


@pytest.mark.parametrize("tolerance", [0.0, -1.0, float("nan"), float("inf")])
def test_a_tolerance_is_a_positive_length(tarm: Arm, tolerance: float) -> None:
    with pytest.raises(InputError, match="tolerance must be positive"):
        map_workspace(tarm, rows=8).verdicts(tolerance)


def test_files_hold_the_map(tarm: Arm, tmp_path: Path) -> None:
    found = map_workspace(tarm, PAYLOADS, rows=64)
    assert same(read_map(write_map(found, tmp_path / "map.safetensors")), found)
    with write_map(found, tmp_path / "map.csv", 0.1).open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(found) and [row["verdict"] for row in rows] == found.verdicts(0.1).tolist()
    i = found.worst_voxel
    assert float(rows[i]["worst"]) == found.worst.max() and float(rows[i]["margin"]) == 0.1 - found.worst.max()
    assert [float(rows[i][f"q_{name}"]) for name in tarm.joint_names] == found.worst_q[i].tolist()
    with pytest.raises(InputError, match=r"ends in \.safetensors or \.csv"):
        write_map(found, tmp_path / "map.txt")


def said(path: Path) -> dict[str, str]:
    with safe_open(path, framework="numpy") as file:
        return file.metadata()


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path.write_bytes(path.read_bytes()[:500]),
        lambda path: path.write_text("x,y\n1,2\n"),
        lambda path: save_file({"index": np.zeros((2, 3))}, path),
        lambda path: save_file({"index": np.zeros((2, 3))}, path, {"armflex": '{"format": "armflex-map-3"}'}),
        lambda path: save_file({**load_file(path), "worst": np.zeros(3)}, path, said(path)),
        lambda path: save_file(load_file(path) | {"mean": np.zeros_like(load_file(path)["mean"])}, path, said(path)),
        lambda path: path.unlink(),
    ],
)
def test_a_damaged_map_is_refused(tarm: Arm, tmp_path: Path, spoil: Callable[[Path], object]) -> None:
    path = write_map(map_workspace(tarm, rows=8), tmp_path / "map.safetensors")
    spoil(path)
    with pytest.raises(FileError, match=r"map\.safetensors: .*; make the map anew"):
        read_map(path)


@pytest.mark.filterwarnings("ignore:tolerance:armflex.ArmflexWarning")
def test_pictures(tarm: Arm, tmp_path: Path) -> None:
    found = map_workspace(tarm, PAYLOADS, rows=64)
    for name, tolerance in (("a.png", None), ("b.svg", 0.1), ("c.png", 5.0)):
        assert draw_map(tarm, found, tmp_path / name, tolerance).stat().st_size > 10_000
    with pytest.raises(InputError, match=r"ends in \.png"):
        draw_map(tarm, found, tmp_path / "a.gif")
    page = map_page(tarm, found, tmp_path / "page.html", 0.1).read_text()
    verdicts = found.verdicts(0.1)
    assert all(f"{name} at 100 mm" in page for name in set(verdicts)) and "tarm_like" in page
    assert "mm</td>" in map_page(tarm, found, tmp_path / "page.html").read_text()


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.filterwarnings("ignore:tolerance:armflex.ArmflexWarning")
def test_pictures_of_an_arm_that_never_stands(tmp_path: Path) -> None:
    arm = three_joints(tmp_path, [np.diag([0.0, 0, 0, 1, 1, 1])] * 3)
    found = map_workspace(arm, rows=16)
    assert not found.answered.any() and (found.verdicts(1.0) == "fail").all() and "nowhere" in repr(found)
    assert draw_map(arm, found, tmp_path / "a.png", 0.1).stat().st_size > 10_000
    with pytest.raises(InputError, match="no displacement to show"):
        map_page(arm, found, tmp_path / "a.html")


# The command


def fine(result: subprocess.CompletedProcess, code: int = 0) -> subprocess.CompletedProcess:
    assert result.returncode == code, result.stderr
    assert "Traceback" not in result.stderr + result.stdout
    return result


def test_frequencies_are_those_of_the_worst_configurations(tarm: Arm, tmp_path: Path) -> None:
    said: list[tuple[int, int]] = []
    found = map_workspace(tarm, PAYLOADS, rows=64, frequency=True, progress=lambda *at: said.append(at))
    assert said == sorted(said) and said[-1] == (192, 192) and {total for _, total in said} == {192}
    assert found.frequency is not None and map_workspace(tarm, rows=8).frequency is None
    for i in (0, found.worst_voxel, len(found) - 1):
        modes = tarm.modes(found.worst_q[i], PAYLOADS[found.worst_payload[i]], count=1)
        assert found.frequency[i] == pytest.approx(modes.frequencies[0], rel=1e-12)
    assert same(read_map(write_map(found, tmp_path / "map.safetensors")), found)
    assert draw_map(tarm, found, tmp_path / "map.png").stat().st_size > 10_000


@pytest.mark.slow
def test_the_command(armflex: Run, tmp_path: Path, tarm: Arm) -> None:
    asked = ("map", TARM, "--rows", 64, "--payload", "none,p600", "--seed", 5)
    found = map_workspace(tarm, PAYLOADS, rows=64, seed=5)
    said = fine(armflex(*asked, "-o", "a.safetensors", "--jobs", 2)).stdout
    # The command may be answered by another engine than this process: to rounding, not to the last bit.
    assert near(read_map(tmp_path / "a.safetensors"), found) and "Largest displacement of the tip" in said
    fine(armflex(*asked, "-o", "b.csv", "--tolerance", "100mm", "--json", "b.json", "--picture", "b.png"), 1)
    told = json.loads((tmp_path / "b.json").read_text())
    assert told["verdicts"] == {name: int((found.verdicts(0.1) == name).sum()) for name in ("ok", "uncertain", "fail")}
    assert told["worst"]["displacement_m"] == found.worst.max() and told["refused"]["unstable"] == 0
    assert (tmp_path / "b.png").stat().st_size > 10_000
    fine(armflex(*asked, "-o", "c.safetensors", "--tolerance", "1m", "--page", "c.html"))
    assert (tmp_path / "c.html").stat().st_size > 500_000
    said = fine(armflex(*asked, "-o", "d.safetensors", "--draws", 2, "--json", "d.json")).stdout
    told, drawn = json.loads((tmp_path / "d.json").read_text()), read_map(tmp_path / "d.safetensors").worst_of_draws
    assert (told["worst_of_draws_m"], told["worst"]["worst_of_draws_m"]) == (drawn.max(), drawn[i := found.worst_voxel])
    assert f"the worst of 2 draws there: {drawn[i] * 1e3:.4g} mm" in said


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--payload", "p60"), "did you mean 'p600'"),
        (("--rows", "-1"), "expected 1 to"),
        (("--tolerance", "5"), "expected a length with its unit"),
        (("--tolerance", "5mrad"), "no unit of length"),
        (("--tolerance", "0mm"), "tolerance must be positive"),
        (("--tolerance", "-3mm"), "tolerance must be positive"),
        (("--voxel", "200"), "expected a length with its unit"),
        (("--jobs", "0"), "--jobs is 0"),
        (("--picture", "map.gif"), "ends in .png"),
        (("-o", "map.xlsx"), "ends in .safetensors or .csv"),
        (("-o", "no/map.safetensors"), "folder no"),
        (("-o", TARM), "is an input of this command"),
        (("--page", TARM), "is an input of this command"),
    ],
)
def test_the_command_refuses(armflex: Run, tmp_path: Path, options: tuple[str, ...], text: str) -> None:
    result = fine(armflex("map", TARM, "-o", "map.safetensors", "--rows", 8, *options), 2)
    assert text in result.stderr and not list(tmp_path.glob("map.*"))


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="sends a signal to a group of processes")
def test_interrupted(tmp_path: Path) -> None:
    """Ctrl-C goes to every process of the terminal; nothing is written."""
    asked = ["map", TARM, "-o", "map.safetensors", "--rows", 1 << 24, "--jobs", 2]
    # Where these tests run in the background Ctrl-C is ignored, and so it would be by their children.
    heard = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    code = f"{heard}; from armflex.cli.main import main; main()"
    with (tmp_path / "said").open("w") as said:
        running = subprocess.Popen(
            [sys.executable, "-c", code, *map(str, asked)],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROBOTS.parent)},
            stdout=subprocess.DEVNULL,
            stderr=said,
            start_new_session=True,
        )
        wait_for(lambda: "mapping" in (tmp_path / "said").read_text())
        os.killpg(running.pid, signal.SIGINT)
        assert running.wait(timeout=600) == 130
    told = (tmp_path / "said").read_text()
    assert "error: interrupted" in told and "Traceback" not in told and not (tmp_path / "map.safetensors").exists()


def test_interrupted_while_a_map_is_written(armflex: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is raised in tidying up after Ctrl-C in the middle of a file is no failure of its own."""

    def save(*args: object, **named: object) -> None:
        try:
            raise KeyboardInterrupt
        finally:
            raise ValueError("an open writing handle")

    monkeypatch.setattr("armflex.storage.array_file.save", save)
    ended = fine(armflex("map", TARM, "-o", "map.safetensors", "--rows", 8), 130)
    assert "error: interrupted" in ended.stderr and not (tmp_path / "map.safetensors").exists()
