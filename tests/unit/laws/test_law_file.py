"""Trained laws in files: bit for bit there and back without torch; damaged or foreign files are refused, not run."""

import hashlib
import json
import pickle
import struct
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy
from safetensors import safe_open
from support.bench import trained
from support.small_arms import ROBOTS

from armflex import load_law, read_joint_data, save_law, train
from armflex.errors import ModelFileError, UnknownNameError
from armflex.laws import law_file
from armflex.laws.law_file import TrainedLaw

TENSORS = ("row_covariance", "residual_std", "loads")


def same(one: TrainedLaw, other: TrainedLaw) -> bool:
    arrays = [(law.law.compliance, *(getattr(law.law.fit, name) for name in TENSORS)) for law in (one, other)]
    equal = all(a.tobytes() == b.tobytes() and a.shape == b.shape for a, b in zip(*arrays, strict=True))
    return equal and one.model == other.model and dict(one.metadata) == dict(other.metadata)


def crafted(path: Path, text: object, tensors: dict[str, np.ndarray] | None = None, key: str = "armflex") -> Path:
    """Write a safetensors file with this text (or JSON of it) under a key of its header."""
    said = text if isinstance(text, str) else json.dumps(text)
    path.write_bytes(safetensors.numpy.save(tensors or {"compliance": np.eye(3)}, metadata={key: said}))
    return path


def content_of(path: Path) -> tuple[dict, dict[str, np.ndarray]]:
    with safe_open(path, framework="numpy") as file:
        return json.loads(file.metadata()["armflex"]), {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118


def digest_of(said: dict, tensors: dict[str, np.ndarray]) -> str:
    """Return the SHA-256 as the format has it."""
    whole = hashlib.sha256(json.dumps({k: v for k, v in said.items() if k != "digest"}, sort_keys=True).encode())
    for name, values in sorted(tensors.items()):
        whole.update(f"{name} {values.dtype.str} {values.shape} ".encode() + values.tobytes())
    return whole.hexdigest()


@pytest.mark.parametrize("size", [3, 6])
def test_there_and_back_bit_for_bit(tmp_path: Path, size: int) -> None:
    made = trained(size)
    assert same(load_law(save_law(made, tmp_path / "a.safetensors")), made)


def test_same_law_gives_same_bytes(tmp_path: Path) -> None:
    contents = {save_law(trained(3), tmp_path / f"{i}.safetensors").read_bytes() for i in range(8)}
    assert len(contents) == 1


def test_fresh_process_reads_it_without_torch(tmp_path: Path) -> None:
    made = trained(6)
    path = save_law(made, tmp_path / "a.safetensors")
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "from armflex.laws.law_file import load_law\n"
        f"law = load_law({str(path)!r}).law\n"
        "print(law.compliance.tobytes().hex()); print(law.fit.row_covariance.tobytes().hex())"
    )
    out = subprocess.run(
        [sys.executable, "-c", code], cwd=ROBOTS.parent, capture_output=True, text=True, check=True, timeout=600
    )
    expected = [array.tobytes().hex() for array in (made.law.compliance, made.law.fit.row_covariance)]
    assert out.stdout.split() == expected


def test_package_does_not_import_torch() -> None:
    code = "import sys, armflex, armflex.cli.main; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROBOTS.parent, check=False, timeout=600).returncode == 0


@pytest.mark.slow
@pytest.mark.parametrize("flip", [0x01, 0x20, 0x80, 0xFF])
def test_any_byte_changed_is_noticed_or_changes_nothing(tmp_path: Path, flip: int) -> None:
    made = trained(3)
    whole = save_law(made, tmp_path / "a.safetensors").read_bytes()
    path, refused = tmp_path / "b.safetensors", 0
    for place in range(len(whole)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ flip]) + whole[place + 1 :])
        try:
            assert same(load_law(path), made), f"byte {place} changed the law unnoticed"
        except ModelFileError as error:
            assert str(path) in str(error)
            refused += 1
    assert refused > 0.98 * len(whole)


def test_any_cut_is_refused(tmp_path: Path) -> None:
    whole = save_law(trained(3), tmp_path / "a.safetensors").read_bytes()
    path = tmp_path / "b.safetensors"
    for length in [*range(0, len(whole), 7), len(whole) - 1]:
        path.write_bytes(whole[:length])
        with pytest.raises(ModelFileError):
            load_law(path)
    path.write_bytes(whole + b"\0")
    with pytest.raises(ModelFileError):
        load_law(path)


class Canary:
    """Creates a file when unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple:
        return (Path.touch, (self.path,))


def test_pickles_are_not_run(tmp_path: Path) -> None:
    canary = tmp_path / "canary"
    path = tmp_path / "a.safetensors"
    path.write_bytes(pickle.dumps(Canary(canary)))
    with pytest.raises(ModelFileError):
        load_law(path)
    with path.open("wb") as file:
        np.save(file, np.array([Canary(canary)], dtype=object), allow_pickle=True)
    with pytest.raises(ModelFileError):
        load_law(path)
    assert not canary.exists()
    pickle.loads(pickle.dumps(Canary(canary)))
    assert canary.exists()  # the canary sings where something is unpickled


def raw(header: object, body: bytes = b"") -> bytes:
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + body


HUGE = {"compliance": {"dtype": "F64", "shape": [2**30, 2**10], "data_offsets": [0, 2**43]}}
FOREIGN = {
    "empty": b"",
    "text": b"compliance = 1",
    "zip": b"PK\x03\x04" + bytes(100),
    "header of 2^60 bytes": struct.pack("<Q", 2**60) + b"{}",
    "array of 8 TB": raw({"__metadata__": {"armflex": "{}"}, **HUGE}),
    "shape that overflows": raw({"a": {"dtype": "F64", "shape": [2**62, 2**62], "data_offsets": [0, 8]}}, bytes(8)),
    "negative shape": raw({"a": {"dtype": "F64", "shape": [-1], "data_offsets": [0, 8]}}, bytes(8)),
    "header a list": raw([1, 2]),
    "deep header": struct.pack("<Q", 200_000) + b"[" * 200_000,
}


@pytest.mark.parametrize("content", FOREIGN.values(), ids=FOREIGN)
def test_foreign_files(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.safetensors").write_bytes(content)
    with pytest.raises(ModelFileError, match=r"a\.safetensors"):
        load_law(tmp_path / "a.safetensors")


def test_missing_file_folder_and_array_file(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.eye(3))
    for name in ("none.safetensors", ".", "a.npy"):
        with pytest.raises(ModelFileError):
            load_law(tmp_path / name)


@pytest.mark.parametrize("dtype", ["BF16", "F8_E4M3", "F8_E5M2", "F4", "F16", "F32", "I64", "BOOL", "C64"])
def test_arrays_that_are_not_64_bit_floats(tmp_path: Path, dtype: str) -> None:
    said = {"__metadata__": {"armflex": json.dumps({"format": "armflex-law-1", "model": "linear", "metadata": {}})}}
    (tmp_path / "a.safetensors").write_bytes(
        raw(said | {"compliance": {"dtype": dtype, "shape": [8], "data_offsets": [0, 8]}}, bytes(8))
    )
    with pytest.raises(ModelFileError):
        load_law(tmp_path / "a.safetensors")


GOOD = {"format": "armflex-law-1", "model": "linear", "metadata": {}, "digest": ""}
HEADERS = {
    "somebody else's": ("pt", "format", "no 'armflex' in its header"),
    "not JSON": ("{", "armflex", "not strict JSON"),
    "a list": ([GOOD], "armflex", "expected format 'armflex-law-1'"),
    "another format": (GOOD | {"format": "armflex-map-1"}, "armflex", "expected format"),
    "another version": (GOOD | {"format": "armflex-law-9"}, "armflex", "made by another version.*train it anew"),
    "another model": (GOOD | {"model": "liner"}, "armflex", "model is 'liner'.*did you mean 'linear'"),
    "no text for a model": (GOOD | {"model": ["linear"]}, "armflex", "which is not known"),
    "no metadata": (GOOD | {"metadata": None}, "armflex", "metadata is None, expected dict"),
    "no digest": ({name: GOOD[name] for name in ("format", "model", "metadata")}, "armflex", "has no SHA-256"),
    "NaN": (json.dumps(GOOD | {"metadata": {"rms": float("nan")}}), "armflex", "NaN in it is no number"),
    "infinite": (json.dumps(GOOD | {"metadata": {"rms": float("-inf")}}), "armflex", "-Infinity in it is no number"),
    "deep": ("[" * 100_000, "armflex", "not strict JSON"),
    "a key twice": (json.dumps(GOOD).replace("{", '{"model": "neural", ', 1), "armflex", "a key is there twice"),
}


@pytest.mark.parametrize(("text", "key", "complaint"), HEADERS.values(), ids=HEADERS)
def test_foreign_headers(tmp_path: Path, text: object, key: str, complaint: str) -> None:
    with pytest.raises(ModelFileError, match=complaint):
        load_law(crafted(tmp_path / "a.safetensors", text, key=key))


ARRAYS = {
    "missing": ("loads", None),
    "not finite": ("compliance", np.full((3, 3), np.nan)),
    "wrong shape": ("compliance", np.eye(4)),
    "wrong shape of the rest": ("loads", np.zeros((3, 3))),
    "four components": ("residual_std", np.zeros(4)),
    "a number": ("residual_std", np.zeros(())),
    "32-bit": ("compliance", np.eye(3, dtype=np.float32)),
}


@pytest.mark.parametrize(("name", "array"), ARRAYS.values(), ids=ARRAYS)
def test_a_file_of_the_right_kind_with_wrong_arrays(tmp_path: Path, name: str, array: np.ndarray | None) -> None:
    """The digest agrees, so that what is tested is the look at the arrays themselves."""
    said, tensors = content_of(save_law(trained(3), tmp_path / "a.safetensors"))
    tensors.pop(name)
    tensors |= {} if array is None else {name: array}
    said["digest"] = digest_of(said, tensors)
    with pytest.raises(ModelFileError, match=f"does not hold a law of armflex: '{name}|64-bit"):
        load_law(crafted(tmp_path / "b.safetensors", said, tensors))
    said, tensors = content_of(tmp_path / "a.safetensors")
    said["digest"] = digest_of(said, tensors)
    assert same(load_law(crafted(tmp_path / "b.safetensors", said, tensors)), trained(3))


def test_too_large_a_file_is_not_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = save_law(trained(3), tmp_path / "a.safetensors")
    monkeypatch.setattr("armflex.laws.law_file.LAYOUT", replace(law_file.LAYOUT, most_bytes=1000))
    with pytest.raises(ModelFileError, match="more than the 1000 allowed"):
        load_law(path)


def test_what_has_no_file_form(tmp_path: Path) -> None:
    made = trained(3)
    with pytest.raises(UnknownNameError, match="no model with a file form named 'spline'"):
        save_law(TrainedLaw(made.law, "spline", {}), tmp_path / "a.safetensors")
    with pytest.raises(ModelFileError, match="not written: Out of range float"):
        save_law(TrainedLaw(made.law, "linear", {"rms": float("nan")}), tmp_path / "a.safetensors")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_metadata_tells_where_it_came_from(tmp_path: Path) -> None:
    table = ROBOTS / "tarm_like" / "a4_table_1.csv"
    found = load_law(save_law(train(read_joint_data(table)).trained, tmp_path / "a.safetensors")).metadata
    assert (found["data"], found["rows"], found["units"]) == ("a4_table_1.csv", 20, ["mm"] * 3)
    assert found["held_out"] == "leave-one-out" and len(found["held_out_rms"]) == 3 and len(found["sha256"]) == 64
