"""Spoilt files of arrays, with and without a digest that agrees: refused by name, or what they say is possible."""

import os
from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from array_files import packed, spoilt, unpacked
from harness import FOLDER, PROFILE, cases, judge, limited, written
from hypothesis import given
from hypothesis import strategies as st
from support.bench import made, some_law, some_perceptron, trained
from support.small_arms import ROBOTS
from support.tracking import in_base

from armflex import Reading, Tracker, load_arm, load_law, map_workspace, save_law
from armflex.arm import Arm
from armflex.errors import FileError, ModelFileError
from armflex.files.calibration_table import LAYOUT as COVARIANCE
from armflex.laws.law import Row
from armflex.laws.law_file import TrainedLaw
from armflex.storage.array_file import read_arrays, write_arrays
from armflex.tasks.workspace import read_map, write_map

TARM = ROBOTS / "tarm_like" / "arm.toml"
NOWHERE = Row(np.zeros(1), {"A1": 0})
WRENCH = np.array([10.0, -20.0, 500.0, 3.0, 2.0, 1.0])


@cache
def tarm() -> Arm:
    return load_arm(TARM)


def law_files() -> dict[str, bytes]:
    folder = FOLDER / "laws"
    folder.mkdir(exist_ok=True)
    laws = {
        "linear": trained(3),
        "polynomial": TrainedLaw(made(3, "linear+radial"), "polynomial", {}),
        "neural": TrainedLaw(some_law(3, 1, laplace=True), "neural", {}),
        "bayesian": TrainedLaw(some_law(6, 3), "bayesian", {}),
        "torch": TrainedLaw(some_perceptron(3, "Tanh", "SiLU"), "torch", {}),
    }
    return {name: save_law(law, folder / name).read_bytes() for name, law in laws.items()}


LAWS = law_files()


@pytest.mark.parametrize("model", LAWS)
@cases(150)
@given(data=st.data())
def test_laws(model: str, data: st.DataObject) -> None:
    path = written("law.safetensors", data.draw(spoilt(LAWS[model])))

    def use(found: TrainedLaw) -> Mapping[str, Any]:
        with np.errstate(all="ignore"):
            return {
                "twist": found.law.twist(WRENCH, NOWHERE),
                "tangent": found.law.tangent(WRENCH, NOWHERE),
                "covariance": found.law.covariance(WRENCH, NOWHERE),
            }

    judge(lambda: load_law(path), path, use)


@cache
def map_file() -> bytes:
    return write_map(map_workspace(tarm(), ["none", "p600"], rows=4, draws=1), FOLDER / "a.safetensors").read_bytes()


@cases(300)
@given(data=st.data())
def test_maps(data: st.DataObject) -> None:
    path = written("map.safetensors", data.draw(spoilt(map_file())))

    def use(found: Any) -> Mapping[str, Any]:
        some = found.answered > 0
        worst = found.worst[found.worst_voxel] if some.any() else 0.0
        return {"centres": found.centres, "worst": worst, "mean": found.mean[some], "sigma": found.margin(0.1)}

    judge(lambda: read_map(path), path, use)


@pytest.fixture(scope="module")
def tracked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Arm, bytes, list[Reading]]:
    """An arm, the state of a tracker that is unsettled, and readings."""
    folder = tmp_path_factory.mktemp("tracked")
    arm = in_base(folder)
    tracker, rng = Tracker(arm, {"compliance": 1e-3}), np.random.default_rng(0)
    readings = []
    for i in range(6):
        q = np.clip(rng.uniform(-0.3, 0.3, len(arm.joint_names)), arm.robot.lower, arm.robot.upper)
        seen = arm.rigid_pose(q).translation + rng.normal(0.0, 2e-4, 3)
        readings.append(Reading(q, seen, 2e-4, time=float(i)))
    for reading in readings[:3]:
        tracker.update(reading)
    return arm, tracker.save(folder / "state").read_bytes(), readings[3:]


def test_states_of_a_tracker(tracked: tuple[Arm, bytes, list[Reading]]) -> None:
    arm, whole, readings = tracked
    path = FOLDER / "state.safetensors"

    def use(tracker: Tracker) -> Mapping[str, Any]:
        for reading in readings:
            tracker.update(reading)
        return {"values": tracker.values, "covariance": tracker.covariance, "sigma": tracker.std}

    @cases(300)
    @given(data=spoilt(whole))
    def spoil(data: bytes) -> None:
        path.write_bytes(data)
        with limited(seconds=5.0), np.errstate(all="ignore"):
            judge(lambda: Tracker.restore(path, arm), path, use)

    spoil()


LOAD = {"frame": "tool", "axes": "base", "force": [1.0, 0.0, 0.0], "moment": [0.0] * 3, "positions": None}

EDITS: dict[str, tuple[Callable[[dict, dict], object], str]] = {
    "ragged window": (lambda s, a: a.update({"window 1 columns": a["window 1 columns"][:, :-1].copy()}), "has shape"),
    "window not finite": (lambda s, a: a["window 0 residual"].__setitem__(0, np.nan), "window 0 residual.* is nan"),
    "window of five numbers": (
        lambda s, a: a.update({"window 0 residual": np.zeros(5)}),
        r"shape \(3, 52\), expected \(5, 52\)",
    ),
    "root not finite": (lambda s, a: a["now root"].__setitem__((0, 0), np.inf), "now root.* is inf"),
    "a negative count": (lambda s, a: s["plain"].update(count=-1), "its counts"),
    "a part of a count": (lambda s, a: s["plain"].update(count=1.5), "plain.count is 1.5, expected int"),
    "more outliers than readings": (lambda s, a: s["plain"].update(outliers=99), "its counts"),
    "time that goes back": (lambda s, a: s["readings"][0].update(time=99.0), "its times"),
    "drift of tomorrow": (lambda s, a: s["plain"].update(drifted=1e9), "its times"),
    "a weight above one": (lambda s, a: s["watch"]["weights"].__setitem__(0, 2.0), "its window"),
    "joints that are not the arm's": (lambda s, a: s["readings"][0].update(q=[0.0]), "of this arm: q"),
    "a payload that is none": (lambda s, a: s["readings"][0].update(payload="x"), "no payload named 'x'"),
    "a load at no link": (lambda s, a: s["readings"][0].update(wrenches=[LOAD | {"frame": "x"}]), "no link named 'x'"),
    "a load in no axes": (lambda s, a: s["readings"][0].update(wrenches=[LOAD | {"axes": "x"}]), "axes is 'x'"),
    "an instrument that is none": (lambda s, a: s["readings"][0].update(sensors={"w": [1.0]}), "its window|named 'w'"),
    "a rate for nothing": (lambda s, a: s["about"].update(rates={"x": 1.0}), "no parameter named 'x'"),
    "another version": (
        lambda s, a: s.update(format="armflex-tracker-2"),
        "made by another version.*begin a new tracker",
    ),
}


@pytest.mark.parametrize(("edit", "problem"), EDITS.values(), ids=EDITS)
def test_a_state_that_cannot_be(tracked: tuple, edit: Callable[[dict, dict], object], problem: str) -> None:
    said, arrays = unpacked(tracked[1])
    arrays = {name: values.copy() for name, values in arrays.items()}
    edit(said, arrays)
    path = written("state.safetensors", packed((said, arrays)))
    with limited(seconds=1.0), pytest.raises(ModelFileError, match=rf"state\.safetensors: .*{problem}"):
        Tracker.restore(path, tracked[0])


LABELS = ("compliance A4 ry", "joint_offset A1", "joint_offset A2")
MATRIX = np.array([[4e-2, 1e-4, 0.0], [1e-4, 1e-6, 2e-7], [0.0, 2e-7, 1e-6]])


@cases(300)
@given(data=st.data())
def test_covariances_beside_an_arm(data: st.DataObject) -> None:
    path = FOLDER / "arm.covariance.safetensors"
    write_arrays(path, COVARIANCE, {"covariance": MATRIX}, {"parameters": LABELS})
    path.write_bytes(data.draw(spoilt(path.read_bytes())))
    judge(lambda: read_arrays(path, COVARIANCE), path, lambda found: {"covariance": found.arrays["covariance"]})


def test_an_indefinite_covariance_is_refused() -> None:
    path = FOLDER / "covariance.safetensors"
    for matrix in (MATRIX - 2e-6 * np.eye(3), MATRIX + np.triu(MATRIX, 1), MATRIX + 0.1 * np.eye(3)[::-1]):
        with pytest.raises(FileError, match="is no covariance"):
            write_arrays(path, COVARIANCE, {"covariance": matrix}, {"parameters": LABELS})
        write_arrays(path, COVARIANCE, {"covariance": MATRIX}, {"parameters": LABELS})
        said, _ = unpacked(path.read_bytes())
        path.write_bytes(packed((said, {"covariance": matrix})))
        with pytest.raises(FileError, match=r"covariance\.safetensors: .* is no covariance.*; calibrate the arm anew"):
            read_arrays(path, COVARIANCE)


def readers() -> dict[str, tuple[bytes, Callable[[Path], object]]]:
    return {**{name: (data, load_law) for name, data in LAWS.items()}, "map": (map_file(), read_map)}


@pytest.mark.parametrize("name", ["linear", "map"])
def test_any_byte_changed_or_cut_is_refused_or_changes_nothing(name: str) -> None:
    whole, read = readers()[name]
    path = written("whole.safetensors", whole)
    before, refused = text_of(read(path)), 0
    step = 7 if PROFILE == "suite" else 1
    for place in range(0, len(whole), step):
        for flip in (0x01, 0x80):
            path.write_bytes(whole[:place] + bytes([whole[place] ^ flip]) + whole[place + 1 :])
            refused += not judge(lambda: _same(read(path), before), path)
        path.write_bytes(whole[:place])
        with pytest.raises(FileError, match=r"whole\.safetensors"):
            read(path)
    assert refused > 0.98 * 2 * len(range(0, len(whole), step))


def _same(found: object, before: str) -> None:
    assert text_of(found) == before, "a byte changed what was read"


def text_of(found: Any) -> str:
    """Return all that a law or a map says."""
    with np.printoptions(floatmode="unique", threshold=10**9):
        told = {field.name: getattr(found, field.name) for field in fields(found)}
        return repr({name: vars(value) if name == "law" else value for name, value in told.items()})


@pytest.mark.parametrize("name", ["linear", "map"])
def test_what_is_no_file_or_too_large_is_refused_at_once(name: str, tmp_path: Path) -> None:
    whole, read = readers()[name]
    os.mkfifo(tmp_path / "pipe.safetensors")
    (tmp_path / "folder.safetensors").mkdir()
    (tmp_path / "loop.safetensors").symlink_to("loop.safetensors")
    (tmp_path / "device.safetensors").symlink_to("/dev/zero")
    (tmp_path / "away.safetensors").symlink_to("nowhere")
    with (tmp_path / "huge.safetensors").open("wb") as file:
        file.write(whole)
        file.truncate(1 << 42)
    (tmp_path / "zip.safetensors").write_bytes(b"PK\x03\x04" + bytes(10_000))
    (tmp_path / "header.safetensors").write_bytes((1 << 62).to_bytes(8, "little") + bytes(1000))
    for path in tmp_path.iterdir():
        with limited(seconds=1.0, more_bytes=1 << 28), pytest.raises(FileError, match=path.name):
            read(path)
    (tmp_path / "whole.safetensors").write_bytes(whole)
    (tmp_path / "link.safetensors").symlink_to("whole.safetensors")
    assert text_of(read(tmp_path / "link.safetensors")) == text_of(read(tmp_path / "whole.safetensors"))


def test_a_large_file_with_a_wrong_digest_costs_no_memory(tmp_path: Path) -> None:
    """72 MB under a header that fits them: nothing is allocated for them before the digest was found wrong."""
    count = 3000
    entry = {"dtype": "F64", "shape": [count, count], "data_offsets": [0, 8 * count**2]}
    said = {"format": COVARIANCE.format, "parameters": [str(i) for i in range(count)]}
    data, path = packed((said, {}), {"covariance": entry}), tmp_path / "large.safetensors"
    path.write_bytes(data)
    with path.open("r+b") as file:
        file.truncate(len(data) + 8 * count**2)
    with limited(seconds=5.0, more_bytes=1 << 26), pytest.raises(FileError, match=r"large\.safetensors: its SHA-256"):
        read_arrays(path, COVARIANCE)
