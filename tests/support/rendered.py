"""Pictures of a printed board by MuJoCo, as the servo arm's camera takes them; its lens has no distortion."""

from pathlib import Path

import cv2
import numpy as np

from support import servo_arm as servo

FOCAL, SCALE = 900.0, 6000.0
"""Focal length [px], and pixels of the print per metre."""


def _said(frame: np.ndarray) -> str:
    """Return a pose as MJCF has it."""
    axes = frame[:3, :3]
    return f'pos="{" ".join(map(str, frame[:3, 3]))}" xyaxes="{" ".join(map(str, [*axes[:, 0], *axes[:, 1]]))}"'


def _print(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Write the board as a texture; return half its sides [m], and its middle in its frame [m]."""
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    made = cv2.aruco.CharucoBoard((servo.COLUMNS, servo.ROWS), servo.SQUARE, servo.MARKER, markers)
    sides = np.array([servo.COLUMNS, servo.ROWS]) * servo.SQUARE
    drawn = made.generateImage(tuple(np.round(sides * SCALE).astype(int).tolist()), marginSize=0)
    margin = round(servo.SQUARE * SCALE)
    drawn = cv2.copyMakeBorder(drawn, *[margin] * 4, cv2.BORDER_CONSTANT, value=255)
    cv2.imwrite(str(folder / "board.png"), drawn)
    return 0.5 * sides + servo.SQUARE, np.append(0.5 * sides, 0.0)


def scene(arm: servo.ServoArm, folder: Path) -> str:
    """Return the arm as it was printed, its camera and the board as an MJCF text."""
    half, middle = _print(folder)
    up = np.diag([1.0, -1.0, -1.0, 1.0])  # a plane shows the side that its z leaves; MuJoCo's camera looks along -z
    sheet = arm.board @ servo.pose(np.eye(3), middle) @ up
    bodies, ends = "", ""
    for i, (axis, origin) in enumerate(zip(servo.AXES, servo.ORIGINS, strict=True)):
        frame = servo.pose(servo.turn(arm.twist[i]), origin + arm.shift[i])
        bodies += f'<body {_said(frame)}><joint axis="{" ".join(map(str, axis))}"/><geom type="sphere" size="0.012"/>'
        ends += "</body>"
    fovy = np.degrees(2.0 * np.arctan(0.5 * servo.IMAGE[1] / FOCAL))
    eye = f'<camera name="eye" fovy="{fovy}" {_said(arm.camera @ up)}/>'
    return f"""<mujoco><compiler angle="radian" texturedir="{folder.as_posix()}"/>
    <visual><global offwidth="{servo.IMAGE[0]}" offheight="{servo.IMAGE[1]}"/><map znear="0.01"/>
    <quality offsamples="8"/><headlight ambient="0.6 0.6 0.6" diffuse="0.3 0.3 0.3" specular="0 0 0"/></visual>
    <asset><texture name="print" type="2d" file="board.png"/><material name="print" texture="print"/></asset>
    <worldbody><geom type="plane" size="{half[0]} {half[1]} 0.01" {_said(sheet)} material="print"/>
    {bodies}{eye}{ends}</worldbody></mujoco>"""


def pictures(arm: servo.ServoArm, q: np.ndarray, came: np.ndarray, folder: Path) -> list[Path]:
    """Write a picture of each row; return the files."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(scene(arm, folder))
    data, found = mujoco.MjData(model), []
    with mujoco.Renderer(model, servo.IMAGE[1], servo.IMAGE[0]) as renderer:
        for row, angles in enumerate(arm.rest(q, came)):
            data.qpos[:] = angles
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, "eye")
            found.append(folder / f"{row:03d}.png")
            cv2.imwrite(str(found[-1]), renderer.render()[:, :, ::-1])
    return found
