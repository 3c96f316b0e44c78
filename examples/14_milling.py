"""A slot milled by an arm whose joints are a fifth off from its data sheet: measured, and then made up for.

The machine is MuJoCo's: the same URDF, with drives that give about their axes. Forty pushes with a known force tell
armflex how much; the path is then compensated for weight and cut together, and driven by the machine.
"""

import csv
import sys
import tempfile
from pathlib import Path

import mujoco
import numpy as np

import armflex

STIFFNESS = np.array([2.5e6, 3.3e6, 2.2e6, 5.5e5, 5.0e5, 3.3e5])  # Nm/rad, the data sheet's
WRONG = np.array([0.8, 0.8, 0.8, 1.2, 0.8, 1.2])  # times as stiff the machine is
SPINDLE, COM = 140.0, np.array([0.15, 0.0, 0.05])  # kg, m in the tool's frame
GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s^2
PUSH, NOISE = 1500.0, 2e-5  # N, m: a hoist and a laser tracker
CUT = np.array([480.0, -900.0, 250.0])  # N, on the tool: across, against the feed along y, and up
ROWS = 41


class Machine:
    """The true arm: a pose is told as joint positions, and the tool goes where the loaded drives let it."""

    def __init__(self, urdf: Path, joints: tuple[str, ...], tip: str) -> None:
        keep = '<mujoco><compiler fusestatic="false"/></mujoco></robot>'
        text = urdf.read_text(encoding="utf-8").replace("</robot>", keep)
        self.model = mujoco.MjModel.from_xml_string(text)
        self.data, self.tip = mujoco.MjData(self.model), self.model.body(tip).id
        self.places = [self.model.joint(name).qposadr[0] for name in joints]

    def tool(self, q: np.ndarray, force: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
        """Return where the tool is [m]: every drive gives by its load over its stiffness."""
        given, cut, weight = np.zeros(len(q)), *np.zeros((2, 3, self.model.nv))
        for _ in range(30):
            self.data.qpos[self.places] = q + given
            mujoco.mj_fwdPosition(self.model, self.data)
            mujoco.mj_rne(self.model, self.data, 0, self.data.qfrc_bias)
            centre = self.data.xpos[self.tip] + self.data.xmat[self.tip].reshape(3, 3) @ COM
            mujoco.mj_jac(self.model, self.data, cut, None, self.data.xpos[self.tip], self.tip)
            mujoco.mj_jac(self.model, self.data, weight, None, centre, self.tip)
            load = cut.T @ force + weight.T @ (SPINDLE * GRAVITY) - self.data.qfrc_bias
            given = load[self.places] / stiffness
        return self.data.xpos[self.tip].copy()


def declared(folder: Path, urdf: Path) -> Path:
    """Write the arm as its data sheet has it; calibration may move each stiffness by a third."""
    drives = "".join(f'[flexure.J{i}]\njoint = "J{i}"\njoint_stiffness = {k}\n' for i, k in enumerate(STIFFNESS, 1))
    robot = f'[robot]\nurdf = "{urdf}"\ntip = "tool"\nbase = "base"\ngravity = {GRAVITY.tolist()}\n'
    payload = f"[payload.spindle]\nmass = {SPINDLE}\ncom = {COM.tolist()}\n"
    path = folder / "arm.toml"
    path.write_text(robot + payload + drives + '[measurement]\nframe = "base"\n[prior]\ncompliance = 0.3\n')
    return path


def pushes(path: Path, machine: Machine, count: int = 40) -> Path:
    """Push the machine's tool in random poses and directions, and write what the tracker reads."""
    rng = np.random.default_rng(1)
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        joints, loads = [f"q_J{i}" for i in range(1, 7)], [f"force_f{axis}" for axis in "xyz"]
        table.writerow([*joints, *"xyz", "sigma", *loads, "payload"])
        for _ in range(count):
            q, force = rng.uniform(-1.0, 1.0, 6), rng.normal(size=3)
            force *= PUSH / np.linalg.norm(force)
            seen = machine.tool(q, force, WRONG * STIFFNESS) + rng.normal(0.0, NOISE, 3)
            table.writerow([*q.tolist(), *seen.tolist(), NOISE, *force.tolist(), "spindle"])
    return path


def slot(arm: armflex.Arm) -> armflex.Trajectory:
    """Return a straight slot of 600 mm along y, cut from the first row to the last; the drawing says where it is."""
    rigid = armflex.Arm(arm.robot)  # without flexures: its compensation is inverse kinematics
    start = rigid.position(J1=-0.25, J2=0.35, J3=0.25, J5=0.9)
    here = rigid.rigid_pose(start).homogeneous
    places = np.tile(here, (ROWS, 1, 1))
    places[:, 1, 3] += np.linspace(0.0, 0.6, ROWS)
    q, loads = start[None], armflex.Wrench("tool", np.tile(CUT, (ROWS, 1)), np.zeros((ROWS, 3)))
    for place in places[1:]:
        row = armflex.Trajectory(arm.joint_names, np.zeros(1), q[-1:], ("none",), ("",))
        q = np.vstack([q, armflex.compensate(rigid, row, "pose", targets=[place]).trajectory.q])
    names = ("spindle",) * ROWS, ("in", *[""] * (ROWS - 2), "out")
    return armflex.Trajectory(arm.joint_names, np.linspace(0.0, 30.0, ROWS), q, *names, wrenches=(loads,))


def main(folder: str = "") -> tuple[float, float, float]:
    """Return the slot's largest error [m] as drawn, compensated by the data sheet, and after forty pushes."""
    place = Path(folder or tempfile.mkdtemp())
    urdf = armflex.bundled_robot("heavy_six") / "robot.urdf"
    arm = armflex.load_arm(declared(place, urdf))
    machine = Machine(urdf, arm.joint_names, "tool")
    path = slot(arm)
    drawn = np.array([arm.rigid_pose(q).translation for q in path.q])

    def error(driven: armflex.Trajectory) -> float:
        cut = np.array([machine.tool(q, CUT, WRONG * STIFFNESS) for q in driven.q])
        return float(np.linalg.norm(cut - drawn, axis=1).max())

    campaign = armflex.read_measurements(pushes(place / "pushes.csv", machine), arm)
    fitted = armflex.calibrate(arm, campaign).arm
    fixed = [armflex.compensate(one, path).trajectory for one in (arm, fitted)]
    errors = (error(path), *map(error, fixed))
    print(f"as drawn {errors[0] * 1e3:.2f} mm, by the data sheet {errors[1] * 1e3:.2f} mm,", end=" ")
    print(f"after forty pushes {errors[2] * 1e3:.3f} mm")
    report = armflex.check(fitted, fixed[1], tolerance=1e-4, against=path)
    worst = report.path_worst
    print(f"`check --against` the drawing says {worst.displacement_m * 1e3:.3f} ± {worst.sigma_m * 1e3:.3f} mm")
    return errors


if __name__ == "__main__":
    main(*sys.argv[1:])
