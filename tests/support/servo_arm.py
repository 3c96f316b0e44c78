"""An arm of hobby servos with play, as people print them, and what a camera sees of it: numpy and OpenCV, no armflex.

Of the size of an SO-101: pan, shoulder, elbow, wrist, roll. Each servo reports where its encoder is; zeros are off by
degrees, links by millimetres, the drive gives by torque, and each output has play that falls to the loaded side, or
stays where the joint came from where the load is less than friction.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

JOINTS = ("pan", "shoulder", "elbow", "wrist", "roll")
AXES = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], [0, 1, 0], [1, 0, 0]], dtype=float)
ORIGINS = np.array([[0.0, 0, 0.055], [0.03, 0, 0.055], [0.02, 0, 0.115], [0.13, 0, 0.0], [0.06, 0, 0.0]])
TIP = np.array([0.1, 0.0, 0.0])
MASSES = (0.10, 0.12, 0.10, 0.08, 0.15)
CENTRES = np.array([[0.0, 0, 0.03], [0.01, 0, 0.06], [0.07, 0, 0], [0.03, 0, 0], [0.04, 0, 0]])
LIMITS = ((-1.6, 1.6), (-1.7, 1.7), (-1.6, 1.6), (-1.6, 1.6), (-1.57, 1.57))
GRAVITY = 9.81

IMAGE, LENS = (1280, 720), np.array([[905.0, 0.0, 651.0], [0.0, 902.0, 353.0], [0.0, 0.0, 1.0]])
DISTORTION = np.array([0.06, -0.12, 0.001, -0.0008, 0.0])
COLUMNS, ROWS, SQUARE, MARKER = 8, 6, 0.03, 0.022


def turn(vector: np.ndarray) -> np.ndarray:
    """Return Rodrigues' rotation by a rotation vector."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def pose(axes: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return the 4 x 4 pose of axes and a place."""
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = axes, place
    return found


def looking(eye: np.ndarray, at: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Return the pose of a camera at `eye` that looks at a point, y down."""
    z = (at - eye) / np.linalg.norm(at - eye)
    x = np.cross(z, up) / np.linalg.norm(np.cross(z, up))
    return pose(np.column_stack([x, np.cross(z, x), z]), eye)


def board_points() -> np.ndarray:
    """Return the corners of the ChArUco board, in OpenCV's order [m]."""
    i, j = np.meshgrid(np.arange(1, COLUMNS), np.arange(1, ROWS))
    return SQUARE * np.column_stack([i.ravel(), j.ravel(), np.zeros(i.size)]).astype(float)


@dataclass
class ServoArm:
    """One that was printed: how it differs from the drawing, and its camera.

    Attributes:
        offset: (5,) of the servos' zeros [rad].
        shift, twist: (5, 3) of each joint's origin [m], [rad].
        give: (5,) compliance of each drive [rad/Nm].
        play: (5,) whole play of each output [rad].
        friction: Load below which an output stays where it is [Nm].
        on_arm: Whether the camera is on the last link, and the board on the table; else the other way about.
        camera, board: Poses of both, in what they are on [m].
    """

    offset: np.ndarray
    shift: np.ndarray
    twist: np.ndarray
    give: np.ndarray
    play: np.ndarray
    friction: float = 0.01
    on_arm: bool = True
    camera: np.ndarray = field(default_factory=lambda: np.eye(4))
    board: np.ndarray = field(default_factory=lambda: np.eye(4))

    @classmethod
    def draw(cls, seed: int, play: float = np.radians(1.0), on_arm: bool = True, off: float = 1.0) -> ServoArm:
        rng = np.random.default_rng(seed)
        arm = cls(
            off * rng.normal(0.0, np.radians(2.5), 5), off * rng.normal(0.0, 1e-3, (5, 3)),
            off * rng.normal(0.0, 5e-3, (5, 3)), 0.012 * np.exp(rng.normal(0.0, 0.3, 5)), np.full(5, play),
            on_arm=on_arm,
        )  # fmt: skip
        middle = board_points().mean(axis=0)
        table = pose(np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1.0]]).T @ turn(rng.normal(0, 0.05, 3)), np.zeros(3))
        if on_arm:
            arm.board = table.copy()
            arm.board[:3, 3] = np.array([0.30, 0.0, 0.0]) - table[:3, :3] @ middle + rng.normal(0, 0.01, 3)
            tilted = turn(np.array([0.0, 0.3, 0.0])) @ np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
            arm.camera = pose(
                tilted @ turn(rng.normal(0, 0.05, 3)), np.array([0.02, 0.01, 0.05]) + rng.normal(0, 5e-3, 3)
            )
        else:
            arm.board = pose(
                turn(rng.normal(0, 0.1, 3)) @ np.array([[0.0, 0, -1], [-1, 0, 0], [0, 1, 0]]).T, np.zeros(3)
            )
            arm.board[:3, 3] = np.array([0.06, 0, 0]) - arm.board[:3, :3] @ middle
            arm.camera = looking(np.array([0.75, 0.1, 0.35]), np.array([0.15, 0, 0.15]), np.array([0.0, 0, 1]))
        return arm

    @classmethod
    def nominal(cls) -> ServoArm:
        """Return it as drawn."""
        none = np.zeros((5, 3))
        return cls(np.zeros(5), none, none, np.zeros(5), np.zeros(5))

    def _links(self, angles: np.ndarray) -> list[np.ndarray]:
        here, found = np.eye(4), []
        for i, angle in enumerate(angles):
            here = (
                here @ pose(turn(self.twist[i]), ORIGINS[i] + self.shift[i]) @ pose(turn(AXES[i] * angle), np.zeros(3))
            )
            found.append(here)
        return found

    def rest(self, q: np.ndarray, came: np.ndarray | None = None) -> np.ndarray:
        """Return (N, 5) angles at rest, for (N, 5) reports and directions -1, 0, 1 that the joints came in."""
        found = []
        for row, reported in enumerate(q):
            side, angles = np.zeros(5) if came is None else came[row], reported + self.offset
            for _ in range(6 if (self.give + self.play).any() else 0):  # loads change little as it sags
                frames, torque = self._links(angles), np.zeros(5)
                for i, (mass, centre) in enumerate(zip(MASSES, CENTRES, strict=True)):
                    place = frames[i][:3, :3] @ centre + frames[i][:3, 3]
                    for k in range(i + 1):
                        about = frames[k][:3, :3] @ AXES[k]
                        torque[k] += about @ np.cross(place - frames[k][:3, 3], [0.0, 0.0, -mass * GRAVITY])
                loaded = np.clip(torque / self.friction, -1.0, 1.0)
                rest = loaded + (1.0 - np.abs(loaded)) * -side
                angles = reported + self.offset + self.give * torque + 0.5 * self.play * rest
            found.append(angles)
        return np.array(found)

    def links(self, q: np.ndarray, came: np.ndarray | None = None) -> np.ndarray:
        """Return (N, 5, 4, 4) poses of the links in the base at rest."""
        return np.array([self._links(angles) for angles in self.rest(q, came)])

    def tips(self, q: np.ndarray, came: np.ndarray | None = None) -> np.ndarray:
        """Return (N, 3) the tip before the board, if that is on the table, else before the camera [m]."""
        last = self.links(q, came)[:, -1]
        points = last[:, :3, :3] @ TIP + last[:, :3, 3]
        stands = np.linalg.inv(self.board if self.on_arm else self.camera)
        return points @ stands[:3, :3].T + stands[:3, 3]

    def sees(self, q: np.ndarray, came: np.ndarray | None = None) -> np.ndarray:
        """Return (N, 4, 4) pose of the board before the camera [m]."""
        last = self.links(q, came)[:, -1]
        if self.on_arm:
            return np.linalg.inv(last @ self.camera) @ self.board
        return np.linalg.inv(self.camera) @ last @ self.board

    def pictures(self, q: np.ndarray, came: np.ndarray | None = None, noise: float = 0.3, seed: int = 0) -> np.ndarray:
        """Return (N, C, 2) corners [px] by OpenCV, not a number where they are outside the picture."""
        import cv2

        rng, found = np.random.default_rng(seed), []
        for one in self.sees(q, came):
            ahead = board_points() @ one[:3, :3].T + one[:3, 3]
            own = cv2.projectPoints(board_points(), cv2.Rodrigues(one[:3, :3])[0], one[:3, 3], LENS, DISTORTION)[0]
            own = own.reshape(-1, 2) + rng.normal(0.0, noise, (len(ahead), 2))
            inside = (ahead[:, 2] > 0.03) & ((own > 4) & (own < np.array(IMAGE) - 4)).all(axis=1)
            facing = one[:3, 2] @ one[:3, 3] > 0.0  # the print's back shows nothing
            found.append(np.where((inside & facing & (inside.sum() > 11))[:, None], own, np.nan))
        return np.array(found)

    def poses(self, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Return (N, 5) reports from which most of the board shows, and the direction that each joint came in."""
        rng, drawn = np.random.default_rng(seed), ServoArm(**{**ServoArm.nominal().__dict__, "on_arm": self.on_arm,
                                                             "camera": self.camera, "board": self.board})  # fmt: skip
        kept: list[np.ndarray] = []
        while len(kept) < count:
            q = rng.uniform(*np.array(LIMITS).T, (100, 5))
            if self.on_arm:  # the wrist such that the camera looks about where the board is
                q[:, 0] *= 0.6
                q[:, 3] = 0.9 - q[:, 1] - q[:, 2] + rng.normal(0.0, 0.4, len(q))
                q = q[(np.abs(q) < np.array(LIMITS)[:, 1]).all(axis=1)]
            seen = np.isfinite(drawn.pictures(q, noise=0.0)).all(axis=2).sum(axis=1)
            kept += list(q[seen >= 18])
        q = np.array(kept[:count])
        return q, np.sign(np.diff(q, axis=0, prepend=rng.uniform(*np.array(LIMITS).T, (1, 5))))


def urdf() -> str:
    """Return the arm as drawn."""
    links = ['<link name="base"/>']
    for i, (name, axis, origin) in enumerate(zip(JOINTS, AXES, ORIGINS, strict=True)):
        parent = "base" if i == 0 else f"link_{JOINTS[i - 1]}"
        mass, centre = MASSES[i], CENTRES[i]
        low, high = LIMITS[i]
        inertia = '<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/>'
        where = " ".join(map(str, centre))
        body = f'<inertial><origin xyz="{where}"/><mass value="{mass}"/>{inertia}</inertial>'
        links.append(
            f'<link name="link_{name}">{body}</link>'
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="link_{name}"/>'
            f'<origin xyz="{" ".join(map(str, origin))}"/><axis xyz="{" ".join(map(str, axis))}"/>'
            f'<limit lower="{low}" upper="{high}" effort="3" velocity="3"/></joint>'
        )
    tip = '<link name="tip"/><joint name="tip_mount" type="fixed"><parent link="link_roll"/><child link="tip"/>'
    tip += f'<origin xyz="{" ".join(map(str, TIP))}"/></joint>'
    return f'<robot name="servo_arm">{"".join(links)}{tip}</robot>'


CAMERA = f"""
[instrument.cam]
kind = "pixels"
camera_link = "link_roll"
board = {{ kind = "charuco", columns = {COLUMNS}, rows = {ROWS}, square = {SQUARE}, marker = {MARKER} }}
corners = "corners.csv"
image = [{IMAGE[0]}, {IMAGE[1]}]
distortion_std = 0.2
sigma = 0.3
"""

PRIOR = "joint_offset = 0.05\ngeometry = 2e-3\ncompliance = 0.5\n"


def declared(folder: Path, camera: str = CAMERA, prior: str = PRIOR, give: float = 0.012) -> Path:
    """Write the arm as drawn, with a camera and what may be off."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "servo.urdf").write_text(urdf())
    text = f'[robot]\nurdf = "servo.urdf"\ntip = "tip"\nbase = "base"\ngravity = [0.0, 0.0, -{GRAVITY}]\n'
    text += "".join(f'[flexure.{name}]\njoint = "{name}"\njoint_stiffness = {1.0 / give:.6g}\n' for name in JOINTS)
    file = folder / "arm.toml"
    file.write_text(f"{text}{camera}\n[prior]\n{prior}")
    return file


def written(
    folder: Path, q: np.ndarray, corners: np.ndarray, came: np.ndarray | None = None, name: str = "rows.csv",
    more: Mapping[str, object] | None = None,
) -> Path:  # fmt: skip
    """Write a campaign of pictures by number, and the table of their corners."""
    pictures = [f"{name}_{i}" for i in range(len(q))]
    with open(folder / name, "w", newline="") as out:
        writer = csv.writer(out)
        came_names = [] if came is None else [f"approach_{joint}" for joint in JOINTS]
        writer.writerow([*(f"q_{joint}" for joint in JOINTS), *came_names, "cam"])
        for i, row in enumerate(q):
            writer.writerow([*row.tolist(), *([] if came is None else came[i].astype(int).tolist()), pictures[i]])
    known = (folder / "corners.csv").read_text() if (folder / "corners.csv").exists() else "picture,corner,u,v\n"
    for picture, own in zip(pictures, corners, strict=True):
        for number in np.flatnonzero(np.isfinite(own).all(axis=1)):
            known += f"{picture},{number},{own[number, 0]:.4f},{own[number, 1]:.4f}\n"
    (folder / "corners.csv").write_text(known)
    return folder / name
