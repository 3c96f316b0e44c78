"""Files as people have them, spoilt: logs, exports, workbooks, bags, motion captures, traces."""

import functools
import io
import tempfile
from pathlib import Path

import numpy as np
from harness import FOLDER, cases, judge, mutated_bytes
from hypothesis import given
from hypothesis import strategies as st
from support import recordings
from support.exports import EXPORTS, LOGS

from armflex.intake import intake
from armflex.intake.campaign import Intake


def workbook(text: str) -> bytes:
    """Return a table of text as a workbook."""
    from openpyxl import Workbook

    book, file = Workbook(), io.BytesIO()
    assert book.active is not None
    for line in text.splitlines():
        book.active.append([float(cell) if cell.replace(".", "").lstrip("-").isdigit() else cell
                            for cell in line.split("\t")])  # fmt: skip
    book.save(file)
    return file.getvalue()


def rtde() -> str:
    """Return a log of samples as UR's RTDE client writes it."""
    head = " ".join(["timestamp", *(f"{kind}_q_{i}" for kind in ("target", "actual") for i in range(3))])
    rows = np.column_stack([recordings.T, recordings.Q, recordings.Q])[::5]
    return "\n".join([head, *(" ".join(f"{one:.6f}" for one in row) for row in rows)])


@functools.cache
def files() -> dict[str, dict[str, bytes]]:
    """Return sets of files by what they are of; the first of each is spoilt."""
    leica, log = EXPORTS["leica"], LOGS["degrees"].encode()
    comma, kuka = EXPORTS["polyworks"], LOGS["kuka"]
    found = {f"{name} export": {"export.txt": text.encode(), "log.txt": log} for name, text in EXPORTS.items()}
    found |= {f"{name} log": {"log.txt": text.encode(), "export.txt": leica.encode()} for name, text in LOGS.items()}
    found |= {
        "UTF-16": {"export.txt": comma.encode("utf-16"), "log.txt": log},
        "Windows-1252": {"export.txt": f"Größe\n{comma}".encode("cp1252"), "log.txt": kuka.encode("cp1252")},
        "workbook": {"export.xlsx": workbook(leica), "log.txt": log},
        "log in a workbook": {"log.xlsx": workbook(LOGS["bare"]), "export.txt": leica.encode()},
        "RTDE": {"rtde.csv": rtde().encode(), "export.txt": EXPORTS["polyworks"].encode()},
    }
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        joints = recordings.log(folder).read_bytes()
        found["MCAP"] = {"one.mcap": recordings.mcap_json(folder).read_bytes()}
        found["KUKA's trace"] = {one.name: one.read_bytes() for one in (recordings.trace(folder),)}
        found["KUKA's trace"] |= {"job_KRCIpo.r64": (folder / "job_KRCIpo.r64").read_bytes()}
        found["KUKA's numbers"] = dict(reversed(found["KUKA's trace"].items()))
        for kind, path in (("Motive", recordings.motive(folder)), ("C3D", recordings.c3d(folder))):
            found[kind] = {path.name: path.read_bytes(), "joints.csv": joints}
        for plugin in ("SQLITE3", "MCAP"):
            bag = recordings.bag(folder, plugin)
            data = next(one for one in bag.iterdir() if one.suffix != ".yaml")
            both = {f"bag/{one.name}": one.read_bytes() for one in (data, bag / "metadata.yaml")}
            found |= {f"rosbag2 {plugin}": both, f"rosbag2 {plugin}, its metadata": dict(reversed(both.items()))}
    return found


class Spoilt(bytes):
    """What is not printed where a case fails: a recording is long."""

    def __repr__(self) -> str:
        return f"<{len(self)} bytes>"


@st.composite
def spoilt(draw: st.DrawFn) -> tuple[str, bytes]:
    """Return which files, and the first of them spoilt: its bytes, or the first of other files in its place."""
    names = sorted(files())
    which = draw(st.sampled_from(names))
    other = next(iter(files()[draw(st.sampled_from(names)) if draw(st.integers(0, 9)) == 0 else which].values()))
    return which, Spoilt(draw(mutated_bytes(other)))


def numbers(found: Intake) -> dict[str, np.ndarray]:
    """Return what was read as numbers, all columns equally long."""
    assert len({len(column) for column in found.columns.values()}) == 1
    return {name: np.array(column) for name, column in found.columns.items() if name.startswith("q_")}


@cases(250)
@given(spoilt())
def test_files_as_they_are(case: tuple[str, bytes]) -> None:
    which, data = case
    folder = Path(tempfile.mkdtemp(dir=FOLDER))
    every = files()[which]
    for number, (name, whole) in enumerate(every.items()):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(whole if number else data)
    paths = sorted({folder / name.split("/")[0] for name in every if not name.endswith(".r64")})
    judge(lambda: intake(paths, 5e-5), paths[0], numbers, [one.name for one in folder.rglob("*")])
