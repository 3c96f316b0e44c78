"""The public scoreboard: campaigns that were published, each calibrated, traced and predicted by parts it has not seen.

    python tests/public.py DIR [--parts 3] [--only NAME] [--cut among|rest] [--rows N] [--calibrated] [--json FILE]
    python tests/public.py DIR --halves 10 [--only NAME] [--rows N]
    python tests/public.py DIR --write OUT

Every campaign in DIR and below is found by its arm.toml, each `.csv` with joint positions beside it is one; published
repositories of other layouts are converted first, into a temporary folder, or into OUT to work on: on GitHub,
pauljac7700/serial_robots_datasets (759068d; the arms are described in `tests/public_arms`),
christianlandgraf/ipa-robot-accuracy (507fba6; with a `ur10*.urdf` anywhere in DIR) and
Hilti-Research/construction_robot_stationing_datasets (f26546d). Nothing that others measured is in this repository.
Tests and the notebook that trace a published campaign take the same DIR from the environment variable ARMFLEX_PUBLIC.

Errors are of readings that nothing was chosen by or fitted to: the poses are cut in parts, `trace` is run from the
start without each of them, and its declared arm (instrument placed), calibrated arm and traced arm predict the part as
`predict` would. *Among* cuts at random: what a new pose between those measured gets. *Apart* cuts by configuration,
parts of joint space grown about some poses: what a pose elsewhere gets. Poses drawn in a workspace are among those of
a dense grid of six joints, and apart from those of a sparse one of seven. Where test poses were published beside the
campaign, their error by the arm traced on all of it is listed as well. Rows that no arm comes near are lost beams.

*Coverage* is the share of the coordinates held out whose error is within 1.96 of its standard deviation, which is the
`sigma` of `predict` and the noise of the reading together; that is as stated, or as the readings scatter about the fit
where it is less. *chi2* is the mean square of that ratio. 95 % and 1 are what a true statement gives. `--calibrated`
leaves `trace` out, which takes seconds instead of minutes; `--rows N` takes N readings spread evenly over a longer
campaign, and with `--cut rest` predicts all others from these. `--halves N` traces the halves of N random splits and of
N by parts of joint space, and counts how often a name of one half is in the other: by the probability that is stated,
how many, the mean of it, what the other half gives, the share in its 95 % sets, and in how many numbers agree.
"""

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
from armflex.estimate.calibrate import Calibration
from armflex.estimate.held_out import apart_folds
from armflex.measured.measurements import Measurements, read_measurements
from armflex.tasks.predict import predict
from armflex.trace.findings import Trace
from armflex.trace.halves import counted

ARMS = Path(__file__).parent / "public_arms"
PUBLISHED = {
    "ur5_tsinghua": "0.155 mean of 20 (MDH + ASTGCN)",
    "wam_tsinghua": "2.92 mean of 20 (MDH + ASTGCN)",
    "ipa_ur10": "",
    "hilti_trailblazer": "",
}
LOST = 10.0
"""Times the median error that a row is off for every arm if its beam was lost."""
WITHIN = 1.959964
"""Standard deviations on either side that hold 95 % of a Gaussian."""


def write_campaign(path: Path, joints: list[str], rows: Iterator[list], unit: str = "") -> None:
    """Write rows of pose, session, time, joint positions, x, y, z and sigma; `unit` is the joints' and the points'."""
    angle, length = ("_deg", "_mm") if unit == "deg and mm" else ("", "")
    head = [*(f"q_{joint}{angle}" for joint in joints), *(f"{axis}{length}" for axis in "xyz"), f"sigma{length}"]
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([["pose", "session", "time", *head], *rows])


def from_tsinghua(source: Path, target: Path) -> None:
    """serial_robots_datasets (P. Jacobi, MIT): target + difference [mm], joints [deg]; the arms are ours."""
    for name, sigma in (("UR5", 0.1), ("WAM", 1.0)):
        for grid in source.rglob(f"3D_{name}_uncalibrated_grid_cleaned.csv"):
            folder = target / f"{name.lower()}_tsinghua"
            shutil.copytree(ARMS / folder.name, folder, dirs_exist_ok=True)
            for licence in (one / "LICENSE" for one in (grid.parent, grid.parent.parent)):
                if licence.is_file():
                    shutil.copy(licence, folder / "LICENSE")
                    break
            joints = re.findall(r'<joint name="(\w+)" type="revolute"', (folder / "robot.urdf").read_text())
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
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(urdf, folder / "ur10.urdf")
    arm = '[robot]\nurdf = "ur10.urdf"\ntip = "tool0"\ngravity = [0.0, 0.0, -9.81]\n'
    arm += '[measurement]\nframe = "unknown"\ngravity_in = "base"\n'
    (folder / "arm.toml").write_text(arm + "[prior]\njoint_offset = 5e-3\ntool = 0.3\ngeometry = 2e-3\n")
    joints = [f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")]

    def number(text: str) -> float:
        return float(text.replace(",", "."))

    tables = {file: list(csv.DictReader(file.open(encoding="utf-8-sig"), delimiter=";")) for file in files}
    # Others have goals, not joint positions.
    tables = {file: found for file, found in tables.items() if found and {*joints} <= found[0].keys()}
    for file, found in tables.items():
        series = file.parent.name.replace("Series", "series")
        if sum(other.parent == file.parent for other in tables) > 1:
            series += file.stem.removeprefix("measurements")
        rows = (
            [f"p{i}", file.parent.name, 10.0 * i, *(number(row[joint]) for joint in joints)]
            + [1e-3 * number(row[f"measurement_{axis}"]) for axis in "xyz"]
            + [5e-5]
            for i, row in enumerate(found)
        )
        write_campaign(folder / f"{series}.csv", joints, rows)


def from_hilti(source: Path, target: Path) -> None:
    """construction_robot_stationing_datasets (Hilti, CC BY-NC-SA): a lifting column and an arm by a total station."""
    for urdf in source.rglob("data/trailblazer.urdf"):
        import yaml

        folder = target / "hilti_trailblazer"
        folder.mkdir(parents=True, exist_ok=True)
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


def published(folder: Path, converted: Path) -> dict[str, tuple[Path, Path]]:
    """Return arm.toml and table of every campaign of a folder by name; those of other layouts go into `converted`."""
    for convert in (from_tsinghua, from_ipa, from_hilti):
        convert(folder, converted)
    return {name: (arm, table) for place in (folder, converted) for name, arm, table in campaigns(place)}


def campaigns(folder: Path) -> Iterator[tuple[str, Path, Path]]:
    """Yield name, arm.toml and table of every campaign in a folder and below."""
    for arm in sorted(folder.rglob("arm.toml")):
        tables = [one for one in sorted(arm.parent.glob("*.csv")) if one.name not in ("predict.csv", "test.csv")]
        tables = [one for one in tables if any(part.startswith("q_") for part in next(csv.reader(one.open()), []))]
        for table in tables:
            name = arm.parent.name + (f"/{table.stem}" if len(tables) > 1 else "")
            yield name, arm, table


def errors_of(found: Calibration | Trace, measurements: Measurements) -> tuple[np.ndarray, np.ndarray]:
    """Return the (k, N, 3) errors of the declared, the calibrated and the traced arm in every row [m], and their
    standard deviations: nan of the declared one, which states none.
    """
    calibration = found.calibration if isinstance(found, Trace) else found
    placed = replace(calibration.arm, corrections=calibration.placed.setup.arm.corrections)
    placed = replace(placed, flexures=calibration.placed.setup.arm.flexures, certainty=None)
    placed = replace(placed, robot=calibration.placed.setup.arm.robot, instrument=calibration.placed.setup.instrument)
    arms = (placed, calibration.arm, *([found.arm] if isinstance(found, Trace) else []))
    predictions = [predict(arm, measurements) for arm in arms]
    errors = np.array([one.position for one in predictions]) - measurements.position
    stds = [np.full_like(errors[0], np.nan) if one.sigma is None else one.sigma for one in predictions]
    stds[0] = np.full_like(errors[0], np.nan)
    noises = [1.0, calibration.scatter, *([found.noise] if isinstance(found, Trace) else [])]
    scale = np.minimum(np.array(noises), 1.0)[:, None, None]
    return errors, np.hypot(np.array(stds), scale * measurements.sigma)


def figures(errors: np.ndarray, stds: np.ndarray) -> dict:
    """Return what the scoreboard says of (k, N, 3) errors of k arms and their standard deviations [mm, 1]."""
    size = np.linalg.norm(errors, axis=2)
    believed = np.any(size < LOST * np.nanmedian(size[1]), axis=0)
    ratio, size = (errors / stds)[1:, believed], size[:, believed]
    return {
        "mean": (1e3 * size.mean(axis=1)).tolist(),
        "rms": (1e3 * np.sqrt((size**2).mean(axis=1))).tolist(),
        "lost": int((~believed).sum()),
        "coverage": (np.abs(ratio) < WITHIN).mean(axis=(1, 2)).tolist(),
        "chi2": (ratio**2).mean(axis=(1, 2)).tolist(),
    }


def score(arm_file: Path, table: Path, parts: int, cuts: tuple[str, ...], calibrated: bool, most: int) -> dict:
    """Return what the scoreboard says of a campaign [mm, s], of `most` of its rows, of the calibrated arm alone where
    `calibrated`.
    """
    arm = armflex.load_arm(arm_file)
    measurements = read_measurements(table, arm)
    every = np.flatnonzero(measurements.measured)
    rows = every[np.unique(np.linspace(0, len(every) - 1, min(most, len(every))).astype(int))]
    fitted = armflex.calibrate if calibrated else armflex.trace
    begun = time.process_time()
    whole = fitted(arm, measurements, rows)
    told: dict = {"rows": len(rows), "cpu_s": time.process_time() - begun}
    if isinstance(whole, Trace):
        told["causes"] = [one.effect.title for one in whole.found]
        told["stated_rms"] = [1e3 * whole.held_out_before, 1e3 * whole.held_out_after]
    poses = np.unique(measurements.pose_number[rows], return_inverse=True)[1]
    among = np.random.default_rng(0).permutation(poses.max() + 1)[poses] % parts
    for name, part in (("among", among), ("apart", apart_folds(measurements.q[rows], parts))):
        if name not in cuts:
            continue
        errors = np.full((2 if calibrated else 3, len(rows), 3), np.nan)
        stds = errors.copy()
        for number in range(parts):
            found, own = fitted(arm, measurements, rows[part != number], anyway=True), part == number
            errors[:, own], stds[:, own] = (one[:, rows[own]] for one in errors_of(found, measurements))
        told[name] = figures(errors, stds)
    if "rest" in cuts and len(rows) < len(every):
        told["rest"] = figures(*(one[:, np.setdiff1d(every, rows)] for one in errors_of(whole, measurements)))
    if (table.parent / "test.csv").exists():
        test = read_measurements(table.parent / "test.csv", arm)
        told["test"] = figures(*(one[:, test.measured] for one in errors_of(whole, test)))
    return told


def main() -> None:
    parser = argparse.ArgumentParser(description="The public scoreboard.")
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder of campaigns and published repositories")
    parser.add_argument("--write", type=Path, metavar="OUT", help="convert into this folder, and do nothing else")
    parser.add_argument("--parts", type=int, default=3, help="parts that the poses are cut in (3)")
    parser.add_argument("--only", default="", help="campaigns whose name holds this")
    parser.add_argument("--cut", choices=("among", "apart", "rest"), help="one way of cutting (among and apart)")
    parser.add_argument("--calibrated", action="store_true", help="without tracing")
    parser.add_argument("--halves", type=int, metavar="10", help="names of so many splits alone: do halves agree?")
    parser.add_argument("--rows", type=int, default=10**6, help="readings of a longer campaign that are used (all)")
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    given = parser.parse_args()
    warnings.simplefilter("ignore", ArmflexWarning)
    with tempfile.TemporaryDirectory() as temporary:
        there = published(given.folder, given.write or Path(temporary))
        if not there:
            parser.error(f"{given.folder}: no campaign beside an arm.toml, and no repository that is converted")
        if given.write:
            print("\n".join(f"{name}: {arm} {table}" for name, (arm, table) in there.items()))
            return
        if given.halves:
            print_halves({name: pair for name, pair in there.items() if given.only in name}, given.halves, given.rows)
            return
        found: dict[str, dict] = {}
        cuts = (given.cut,) if given.cut else ("among", "apart")
        arms = ("nominal", "calibrated", "traced")[: 2 if given.calibrated else 3]
        each = " ".join(f"{one:>13s}" for one in (*arms, *(one[:5] + " %/chi2" for one in arms[1:])))
        print(f"{'campaign':28s} {'rows':>5s} " + "".join(f" {cut + ':':7s}{each}" for cut in cuts) + "   CPU s")
        for name, (arm, table) in there.items():
            if given.only not in name:
                continue
            try:
                told = found[name] = score(arm, table, given.parts, cuts, given.calibrated, given.rows)
            except ArmflexError as error:
                print(f"{name:28s} {error}", flush=True)
                continue
            line = "".join(f"        {said(told[cut])}" for cut in cuts if cut in told)
            print(f"{name:28s} {told['rows']:5d} {line}  {told['cpu_s']:5.1f}", flush=True)
            if "causes" in told:
                causes = ", ".join(told["causes"]) or "none"
                print(f"    causes: {causes}; stated {told['stated_rms'][1]:.3f} RMS held out")
            if "test" in told:
                print(f"    published test poses: {said(told['test'])}")
            if about := PUBLISHED.get(name.split("/")[0]):
                print(f"    published: {about}", flush=True)
    if given.json:
        given.json.write_text(json.dumps(found, indent=1))


def print_halves(there: dict[str, tuple[Path, Path]], count: int, most: int) -> None:
    """Print for every campaign, and for all, how often a name of one half is what the other half gives."""
    names = []
    for name, (file, table) in there.items():
        arm = armflex.load_arm(file)
        whole = read_measurements(table, arm)
        rows = np.flatnonzero(whole.measured)
        rows = rows[np.linspace(0, len(rows) - 1, min(most, len(rows))).astype(int)]
        try:
            found = armflex.trace(arm, whole, rows, anyway=True, halves=count)
        except ArmflexError as error:
            print(f"{name:28s} {error}", flush=True)
            continue
        names += found.halves or ()
        for one in counted(found.halves or ()):
            print(f"{name:28s} " + " ".join(f"{cell:>14s}" for cell in one.cells), flush=True)
    for one in counted(names):
        print(f"{'all':28s} " + " ".join(f"{cell:>14s}" for cell in one.cells))


def said(told: dict) -> str:
    """Return the figures of one cut: mean and RMS of each arm [mm], coverage [%] and chi2 of those that state any."""
    errors = [f"{mean:6.3f}/{rms:6.3f}" for mean, rms in zip(told["mean"], told["rms"], strict=True)]
    stated = [f"{100 * share:6.1f}/{chi2:6.2f}" for share, chi2 in zip(told["coverage"], told["chi2"], strict=True)]
    return " ".join(errors + stated)


if __name__ == "__main__":
    sys.exit(main())
