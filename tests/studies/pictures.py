"""What a camera and a printed board calibrate: hobby servos with a degree of play, 60 pictures, and OpenCV beside it.

    python tests/studies/pictures.py projected 6      # corners by OpenCV's projection, 0.3 px of noise
    python tests/studies/pictures.py calibrated 6     # the same without the trace that finds the play
    python tests/studies/pictures.py rendered 2       # pictures by MuJoCo (MUJOCO_GL=egl), corners found in them

Rendered pictures and a log of joints in degrees go through `armflex intake` with the URDF and the board in one option.
Arms are drawn with zeros off by 2.5 degrees, links by a millimetre, drives that give by torque, and one degree of play
at every servo. Everything is the command line's: trace, and predictions of 30 pictures that it never had.
"""

import csv
import subprocess
import sys
import tempfile
import time
from itertools import product
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from support import servo_arm as servo  # noqa: E402

from armflex import calibrate, load_arm, predict, read_measurements, trace  # noqa: E402
from armflex.readings import Pixels  # noqa: E402

FITTED, HELD_OUT = 60, 30


def by_hand_eye(arm: servo.ServoArm, q: np.ndarray, corners: np.ndarray, lens: tuple) -> np.ndarray:
    """Return (N, 3) tips before the board [m] as OpenCV's best hand-eye calibration of the first pictures has them.

    Poses of the board are by the true lens (camera matrix, distortion), or by one that OpenCV calibrates itself.
    """
    seen = [i for i in range(FITTED) if np.isfinite(corners[i]).all(axis=1).sum() >= 12]
    shown = [np.isfinite(corners[i]).all(axis=1) for i in seen]
    points = [servo.board_points()[own].astype(np.float32) for own in shown]
    places = [corners[i][own].astype(np.float32) for i, own in zip(seen, shown, strict=True)]
    poses = [cv2.solvePnP(one, other, *lens)[1:] for one, other in zip(points, places, strict=True)]
    every_pose = [poses, list(zip(*cv2.calibrateCamera(points, places, servo.IMAGE, None, None)[3:5], strict=True))]
    links = servo.ServoArm.nominal().links(q)[:, -1]
    tips = links[:, :3, :3] @ servo.TIP + links[:, :3, 3]
    truth, best = arm.tips(q[FITTED:], CAME[FITTED:]), (np.inf, tips)
    for number, method in product(range(2), ("TSAI", "PARK", "HORAUD", "ANDREFF", "DANIILIDIS")):
        boards = [servo.pose(cv2.Rodrigues(vector)[0], np.ravel(shift)) for vector, shift in every_pose[number]]
        try:
            eye = servo.pose(*(np.squeeze(one) for one in cv2.calibrateHandEye(
                links[seen, :3, :3], links[seen, :3, 3], [one[:3, :3] for one in boards],
                [one[:3, 3] for one in boards], method=getattr(cv2, f"CALIB_HAND_EYE_{method}"))))  # fmt: skip
        except cv2.error:
            continue
        every = np.array([links[i] @ eye @ one for i, one in zip(seen, boards, strict=True)])
        left, _, right = np.linalg.svd(np.median(every[:, :3, :3], axis=0))
        board = np.linalg.inv(servo.pose(left @ right, np.median(every[:, :3, 3], axis=0)))
        found = tips @ board[:3, :3].T + board[:3, 3]
        error = rms(found[FITTED:] - truth)
        best = min(best, (error, found), key=lambda one: one[0])  # the best of ten, by the truth
    return best[1]


def rms(errors: np.ndarray) -> float:
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def measured(arm: servo.ServoArm, loaded, rows: Path) -> tuple[np.ndarray, float]:
    """Return (N, 3) predicted tips before the board [m], and the share of numbers read within their 95 %."""
    asked = read_measurements(rows, loaded)
    found, sensor = predict(loaded, asked), loaded.sensors["cam"]
    at, vector = (sensor.of(name, ("",))[0] for name in ("board_at", "board_turn"))
    kind, std = found.sensors[0]
    read = asked.readings.of(Pixels, "cam")
    there = np.isfinite(read.sigma)
    whitened = ((read.values - kind.values) / np.hypot(read.sigma, std))[there]
    return (found.position - at) @ servo.turn(vector), float((np.abs(whitened) < 1.96).mean())


def one(seed: int, folder: Path, what: str, play: float) -> tuple[float, ...]:
    global CAME
    arm = servo.ServoArm.draw(seed, play)
    q, CAME = arm.poses(FITTED + HELD_OUT, seed + 100)
    file = servo.declared(folder)
    if what == "rendered":
        corners, lens = drawn(arm, q, folder, file)
        file, rows, more = taken_in(q, folder)
    else:
        corners, lens = arm.pictures(q, CAME, seed=seed), (servo.LENS, servo.DISTORTION)
        rows = servo.written(folder, q[:FITTED], corners[:FITTED], CAME[:FITTED])
        more = servo.written(folder, q[FITTED:], corners[FITTED:], CAME[FITTED:], "more.csv")
    began, declared = time.process_time(), load_arm(file)
    before, truth = by_hand_eye(arm, q, corners, lens), arm.tips(q[FITTED:], CAME[FITTED:])
    traced = play and what != "calibrated"
    loaded = trace(declared, rows, anyway=True).arm if traced else calibrate(declared, rows, anyway=True).arm
    found, covered = measured(arm, loaded, more)
    return rms(before[FITTED:] - truth), rms(found - truth), covered, time.process_time() - began


def drawn(arm: servo.ServoArm, q: np.ndarray, folder: Path, file: Path) -> tuple[np.ndarray, tuple]:
    """Return (N, C, 2) corners that armflex finds in pictures by MuJoCo [px], and the lens."""
    from support.rendered import FOCAL, pictures

    from armflex.measured.pictures import find_corners

    board, (wide, high) = load_arm(file).sensors["cam"].about.board, servo.IMAGE
    matrix = np.array([[FOCAL, 0.0, 0.5 * (wide - 1)], [0.0, FOCAL, 0.5 * (high - 1)], [0.0, 0.0, 1.0]])
    paths = pictures(arm, q, CAME, folder)
    found = np.array([find_corners(path, board).reshape(-1, 2) for path in paths])
    (folder / "shots").mkdir()
    for i, path in enumerate(paths[:FITTED]):
        Path(path).rename(folder / "shots" / f"shot_{i + 1:03d}.png")
    for i, path in enumerate(paths[FITTED:]):
        Path(path).rename(folder / f"more_{i}.png")
    return found, (matrix, np.zeros(5))


def taken_in(q: np.ndarray, folder: Path) -> tuple[Path, Path, Path]:
    """Return arm file and campaign that `armflex intake` makes of URDF, log and pictures, and rows of what is kept."""
    with open(folder / "log.csv", "w") as file:
        file.write("shot;" + ";".join(f"J{i} [deg]" for i in range(1, 6)) + "\n")
        for i, row in enumerate(np.degrees(q[:FITTED])):
            file.write(f"{i + 1};" + ";".join(f"{one:.4f}" for one in row) + "\n")
    board = f"charuco,{servo.COLUMNS}x{servo.ROWS},{1e3 * servo.SQUARE:g}mm,{1e3 * servo.MARKER:g}mm"
    asked = ["intake", "servo.urdf", "log.csv", "shots", "--board", board, "-o", "campaign.csv", "--arm", "taken.toml"]
    subprocess.run([sys.executable, "-m", "armflex", *asked], cwd=folder, check=True, capture_output=True, timeout=300)
    with open(folder / "more.csv", "w", newline="") as file:
        writer = csv.writer(file)
        names = [f"{head}_{joint}" for head in ("q", "approach") for joint in servo.JOINTS]
        writer.writerow([*names, "cam"])
        for i, (row, came) in enumerate(zip(q[FITTED:], CAME[FITTED:], strict=True)):
            writer.writerow([*row.tolist(), *came.astype(int).tolist(), f"more_{i}.png"])
    return folder / "taken.toml", folder / "campaign.csv", folder / "more.csv"


def main(what: str, count: str) -> None:
    print("play [deg], seed: best of OpenCV's hand-eye [mm], armflex [mm], times better, covered at 95 %, CPU [s]")
    for degrees in (1.0, 0.0) if what == "projected" else (1.0,):
        lines = []
        for seed in range(1, int(count) + 1):
            with tempfile.TemporaryDirectory() as folder:
                before, after, covered, spent = one(seed, Path(folder), what, np.radians(degrees))
            lines.append((before, after, covered))
            print(f"{degrees:g}, {seed}: {1e3 * before:.2f}, {1e3 * after:.2f}, {before / after:.1f}, "
                  f"{covered:.1%}, {spent:.0f}", flush=True)  # fmt: skip
        before, after, covered = np.array(lines).T
        print(f"{degrees:g}, all: {1e3 * np.median(before):.2f}, {1e3 * np.median(after):.2f} (most "
              f"{1e3 * after.max():.2f}), {np.median(before / after):.1f} (least {(before / after).min():.1f}), "
              f"{covered.mean():.1%}")  # fmt: skip


if __name__ == "__main__":
    main(*sys.argv[1:3])
