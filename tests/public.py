"""The public scoreboard: campaigns that were published, each calibrated, traced and predicted by parts it has not seen.

    python tests/public.py DIR [--parts 3] [--only NAME] [--json FILE]

Every campaign in DIR and below is found by its arm.toml, each `.csv` with joint positions beside it is one; published
repositories of other layouts are converted first, into a temporary folder: serial_robots_datasets, ipa-robot-accuracy
(with a `ur10*.urdf` anywhere in DIR) and construction_robot_stationing_datasets. The two campaigns that travel with
this file are always there.

Errors are of readings that nothing was chosen by or fitted to: the poses are cut in parts, `trace` is run from the
start without each of them, and its declared arm (instrument placed), calibrated arm and traced arm predict the part as
`predict` would. *Among* cuts at random: what a new pose between those measured gets. *Apart* cuts by configuration,
parts of joint space grown about some poses: what a pose elsewhere gets. Poses drawn in a workspace are among those of
a dense grid of six joints, and apart from those of a sparse one of seven. Where test poses were published beside the
campaign, their error by the arm traced on all of it is told as well. Rows that no arm comes near are lost beams.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import armflex
from armflex.errors import ArmflexError, ArmflexWarning
from armflex.measured.measurements import Measurements, read_measurements
from armflex.tasks.predict import predict
from armflex.trace.findings import Trace

OURS = Path(__file__).parent / "measured"
PUBLISHED = {
    "ur5_tsinghua": "0.155 mean of 20 (MDH + ASTGCN)",
    "wam_tsinghua": "2.92 mean of 20 (MDH + ASTGCN)",
    "ipa_ur10": "",
    "hilti_trailblazer": "",
}
LOST = 10.0
"""Times the median error that a row is off for every arm if its beam was lost."""


def write_campaign(path: Path, joints: list[str], rows: Iterator[list], unit: str = "") -> None:
    """Write rows of pose, session, time, joint positions, x, y, z and sigma; `unit` is the joints' and the points'."""
    angle, length = ("_deg", "_mm") if unit == "deg and mm" else ("", "")
    head = [*(f"q_{joint}{angle}" for joint in joints), *(f"{axis}{length}" for axis in "xyz"), f"sigma{length}"]
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([["pose", "session", "time", *head], *rows])


def from_tsinghua(source: Path, target: Path) -> None:
    """serial_robots_datasets (P. Jacobi, MIT): target + difference [mm], joints [deg]; the arms travel with us."""
    for name, sigma in (("UR5", 0.1), ("WAM", 1.0)):
        for grid in source.rglob(f"3D_{name}_uncalibrated_grid_cleaned.csv"):
            folder = target / f"{name.lower()}_tsinghua"
            ours = OURS / folder.name
            shutil.copytree(ours, folder, ignore=shutil.ignore_patterns("*.csv"), dirs_exist_ok=True)
            joints = next(csv.reader((ours / "campaign.csv").open()))
            joints = [one[2:-4] for one in joints if one.startswith("q_")]
            for file, what in ((grid, "campaign"), (Path(str(grid).replace("_grid_", "_random_")), "test")):
                if file.exists():
                    found = list(csv.DictReader(file.open(encoding="utf-8-sig"), skipinitialspace=True))
                    rows = (
                        [f"{what}{i}", "s0", 10.0 * i, *(row[f"joint_{k + 1}"] for k in range(len(joints)))]
                        + [float(row[f"{axis}_t"]) + float(row[f"{axis}_dif"]) for axis in "xyz"]
                        + [sigma]
                        for i, row in enumerate(found)
                    )
                    write_campaign(folder / f"{what}.csv", joints, rows, "deg and mm")


def from_ipa(source: Path, target: Path) -> None:
    """ipa-robot-accuracy (C. Landgraf, MIT): a UR10 by a laser tracker, points [mm], decimal commas."""
    files = sorted(source.rglob("Series_*/measurements_*.csv"))
    urdf = next((one for one in source.rglob("ur10*.urdf")), None)
    if not files or urdf is None:
        return
    folder = target / "ipa_ur10"
    folder.mkdir(parents=True)
    shutil.copy(urdf, folder / "ur10.urdf")
    arm = '[robot]\nurdf = "ur10.urdf"\ntip = "tool0"\ngravity = [0.0, 0.0, -9.81]\n'
    arm += '[measurement]\nframe = "unknown"\ngravity_in = "base"\n'
    (folder / "arm.toml").write_text(arm + "[prior]\njoint_offset = 5e-3\ntool = 0.3\ngeometry = 2e-3\n")
    joints = [f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")]

    def number(text: str) -> float:
        return float(text.replace(",", "."))

    for file in files:
        found = list(csv.DictReader(file.open(encoding="utf-8-sig"), delimiter=";"))
        if not found or any(joint not in found[0] for joint in joints):
            continue  # goals, not joint positions
        rows = (
            [f"p{i}", file.parent.name, 10.0 * i, *(number(row[joint]) for joint in joints)]
            + [1e-3 * number(row[f"measurement_{axis}"]) for axis in "xyz"]
            + [5e-5]
            for i, row in enumerate(found)
        )
        write_campaign(folder / f"{file.parent.name.lower()}.csv", joints, rows)


def from_hilti(source: Path, target: Path) -> None:
    """construction_robot_stationing_datasets (Hilti, CC BY-NC-SA): a lifting column and an arm by a total station."""
    for urdf in source.rglob("data/trailblazer.urdf"):
        import yaml

        folder = target / "hilti_trailblazer"
        folder.mkdir(parents=True)
        text = re.sub(r"<mimic[^>]*/>", "", urdf.read_text())  # the column's tubes are given as two joints
        text = re.sub(r"<(visual|collision)\b.*?</\1>", "", text, flags=re.DOTALL)
        (folder / "trailblazer.urdf").write_text(text)
        arm = '[robot]\nurdf = "trailblazer.urdf"\nbase = "base_link"\ntip = "prism"\ngravity = [0.0, 0.0, -9.81]\n'
        arm += '[measurement]\nframe = "unknown"\ngravity_in = "measurement"\n'
        (folder / "arm.toml").write_text(arm + "[prior]\njoint_offset = 5e-3\ntool = 0.01\ngeometry = 2e-3\n")
        for file in sorted((urdf.parent / "datasets").glob("*.yaml")):
            data, rows = yaml.safe_load(file.read_text()), []
            for height in data["column_heights"].values():
                for solution in height["solution_spaces"].values():
                    rows += [*solution["stationing_measurements"], *solution["evaluation_measurements"]]
            rows.sort(key=lambda row: row["time"])
            first = rows[0]["time"]
            write_campaign(
                folder / f"{file.stem}.csv",
                data["joint_names"],
                (
                    [f"p{i}", file.stem, row["time"] - first, *row["joint_states"], *row["prism_position"], 7.5e-4]
                    for i, row in enumerate(rows)
                ),
            )


def campaigns(folder: Path) -> Iterator[tuple[str, Path, Path]]:
    """Yield name, arm.toml and table of every campaign in a folder and below."""
    for arm in sorted(folder.rglob("arm.toml")):
        tables = [one for one in sorted(arm.parent.glob("*.csv")) if one.name not in ("predict.csv", "test.csv")]
        tables = [one for one in tables if any(part.startswith("q_") for part in next(csv.reader(one.open()), []))]
        for table in tables:
            name = arm.parent.name + (f"/{table.stem}" if len(tables) > 1 else "")
            yield name, arm, table


def parts_apart(q: np.ndarray, count: int) -> np.ndarray:
    """Return (M,) parts of joint space: rows by the nearest of some poses, each chosen farthest from those before."""
    q, chosen = q / np.maximum(np.ptp(q, axis=0), 1e-9), [0]
    for _ in range(4 * count - 1):
        near = np.linalg.norm(q[:, None] - q[chosen], axis=2).min(axis=1)
        chosen.append(int(near.argmax()))
    cells = np.linalg.norm(q[:, None] - q[chosen], axis=2).argmin(axis=1)
    part, size = np.zeros(len(q), dtype=int), np.zeros(count, dtype=int)
    for cell in np.argsort(-np.bincount(cells, minlength=4 * count)):  # the largest first, each to the smallest part
        part[cells == cell] = size.argmin()
        size[size.argmin()] += (cells == cell).sum()
    return part


def errors_of(found: Trace, measurements: Measurements) -> np.ndarray:
    """Return the (3, N) errors of the declared, calibrated and traced arm in every row [m]."""
    calibration = found.calibration
    placed = replace(calibration.arm, corrections=calibration.placed.setup.arm.corrections)
    placed = replace(placed, flexures=calibration.placed.setup.arm.flexures, certainty=None)
    placed = replace(placed, robot=calibration.placed.setup.arm.robot, instrument=calibration.placed.setup.instrument)
    arms = (placed, calibration.arm, found.arm)
    points = [predict(replace(arm, certainty=None), measurements).position for arm in arms]
    return np.linalg.norm(np.array(points) - measurements.position, axis=2)


def score(arm_file: Path, table: Path, parts: int) -> dict:
    """Return what the scoreboard says of a campaign [mm, s]."""
    arm = armflex.load_arm(arm_file)
    measurements = read_measurements(table, arm)
    rows = np.flatnonzero(measurements.measured)
    begun = time.process_time()
    whole = armflex.trace(arm, measurements)
    told = {"rows": len(rows), "cpu_s": time.process_time() - begun}
    told["causes"] = [one.effect.title for one in whole.found]
    told["stated_rms"] = [1e3 * whole.held_out_before, 1e3 * whole.held_out_after]
    poses = np.unique(measurements.pose_number[rows], return_inverse=True)[1]
    among = np.random.default_rng(0).permutation(poses.max() + 1)[poses] % parts
    for name, part in (("among", among), ("apart", parts_apart(measurements.q[rows], parts))):
        errors = np.full((3, len(rows)), np.nan)
        for number in range(parts):
            found = armflex.trace(arm, measurements, rows[part != number], anyway=True)
            errors[:, part == number] = errors_of(found, measurements)[:, rows[part == number]]
        believed = np.any(errors < LOST * np.nanmedian(errors[1]), axis=0)
        told[name] = {"mean": (1e3 * errors[:, believed].mean(axis=1)).tolist(), "lost": int((~believed).sum())}
        told[name]["rms"] = (1e3 * np.sqrt((errors[:, believed] ** 2).mean(axis=1))).tolist()
    if (table.parent / "test.csv").exists():
        test = read_measurements(table.parent / "test.csv", arm)
        told["test_mean"] = (1e3 * errors_of(whole, test)[:, test.measured].mean(axis=1)).tolist()
    return told


def main() -> None:
    parser = argparse.ArgumentParser(description="The public scoreboard.")
    parser.add_argument("folder", type=Path, nargs="?", help="folder of campaigns and published repositories")
    parser.add_argument("--parts", type=int, default=3, help="parts that the poses are cut in (3)")
    parser.add_argument("--only", default="", help="campaigns whose name holds this")
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    given = parser.parse_args()
    warnings.simplefilter("ignore", ArmflexWarning)
    found: dict[str, dict] = {}
    print(f"{'campaign':28s} {'rows':>5s}  {'among: nominal calibrated traced':>36s}  {'apart: the same':>36s}   CPU s")
    with tempfile.TemporaryDirectory() as converted:
        if given.folder:
            for convert in (from_tsinghua, from_ipa, from_hilti):
                convert(given.folder, Path(converted))
        seen = [one for place in (Path(converted), given.folder, OURS) if place for one in campaigns(place)]
        for name, arm, table in {one[0]: one for one in reversed(seen)}.values():
            if given.only not in name:
                continue
            try:
                told = found[name] = score(arm, table, given.parts)
            except ArmflexError as error:
                print(f"{name:28s} {error}", flush=True)
                continue
            figures = [
                " ".join(
                    f"{mean:6.3f}/{rms:6.3f}" for mean, rms in zip(told[cut]["mean"], told[cut]["rms"], strict=True)
                )
                for cut in ("among", "apart")
            ]
            print(f"{name:28s} {told['rows']:5d}  {figures[0]}  {figures[1]}  {told['cpu_s']:5.1f}", flush=True)
            print(f"    causes: {', '.join(told['causes']) or 'none'}; stated {told['stated_rms'][1]:.3f} RMS held out")
            if "test_mean" in told:
                print(f"    published test poses: {' '.join(f'{mean:.3f}' for mean in told['test_mean'])} mean")
            if said := PUBLISHED.get(name.split("/")[0]):
                print(f"    published: {said}", flush=True)
    if given.json:
        given.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    sys.exit(main())
