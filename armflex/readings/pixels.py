"""The corners of a printed board in a picture, by a camera on the arm or beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.readings.board import Board, read_board
from armflex.readings.end import End, rigid_motion
from armflex.readings.kind import Ends, Kind, link_in
from armflex.readings.lens import by_lens, projected
from armflex.readings.postures import Postures
from armflex.readings.sensor import AXES, TURNS, Nuisance
from armflex.readings.sighting import Sighting, sighted
from armflex.robot import Robot

NEAR = {"m": 0.05, "rad": 0.05, "px": 50.0}
"""Standard deviation of a place, a turn or a lens up to which a fit finds it from where it is declared."""

SHOWN = 0.5
"""Share of a board's corners in a picture that is worth being planned."""

NEAREST = 1e-6
"""Depth before the camera [m] to which a point is brought that is beside it."""

LENS = (
    Nuisance("focal", ("x", "y"), "px", anywhere=True),
    Nuisance("centre", ("x", "y"), "px", anywhere=True),
    Nuisance("distortion", ("k1", "k2", "p1", "p2", "k3"), "1", spare=1),
)
CAMERA = (Nuisance("anchor", AXES, "m", "eye", anywhere=True), Nuisance("mounting", TURNS, "rad", "eye", anywhere=True))
BOARD = (
    Nuisance("board_at", AXES, "m", "end", anywhere=True),
    Nuisance("board_turn", TURNS, "rad", "end", anywhere=True),
)
SIZE = Nuisance("scale", ("",), "1")
"""Share by which the board is larger than declared."""


@dataclass(frozen=True, eq=False)
class Camera:
    """What a camera looks at, and where its pictures are.

    Attributes:
        board: What it looks at.
        corners: Name of the table of corners, beside a campaign; '' where the campaign names pictures.
        image: (2,) width and height of a picture [px]; None where they are not declared.
    """

    board: Board
    corners: str = ""
    image: Array | None = None


@dataclass(frozen=True, eq=False)
class Pixels(Kind):
    """(N, 2 C) places u, v [px] of a board's C corners in a picture; those that were not found are left out."""

    unit, quantity = "px", "pixel"
    channels = ("",)
    nuisances = (*LENS, *CAMERA, *BOARD, SIZE)
    apart = 2

    @property
    def dimension(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride] - a board has as many as it has
        """2 C."""
        return self.values.shape[1]

    @property
    def headers(self) -> tuple[str, ...]:
        """One for u and one for v of each corner."""
        return tuple(f"{self.name}_{axis}{i}" for i in range(self.dimension // 2) for axis in "uv")

    @classmethod
    def unread(cls, count: int, sigma: ArrayLike = 1.0, name: str = "", about: object = None) -> Pixels:
        assert isinstance(about, Camera)
        shape = (count, 2 * len(about.board.points))
        return cls(np.zeros(shape), np.broadcast_to(np.asarray(sigma, dtype=float), shape), name)

    @classmethod
    def declared(cls, table: Declaration, robot: Robot) -> dict[str, Any]:
        """Return the links that board and camera are on, the base where they are on none, and the camera."""
        if not table.has("board_link") and not table.has("camera_link"):
            text = "give the link that the camera is on or, of a camera that stands beside the arm, board_link"
            raise table.fail("camera_link", f"is missing: {text}")
        corners = table.text("corners", "") if table.has("corners") else ""
        image = table.numbers("image", (2,)) if table.has("image") else None
        about = Camera(read_board(table.sub("board")), corners, image)
        board = link_in(table, "board_link", robot) if table.has("board_link") else robot.base
        eye = link_in(table, "camera_link", robot, board) if table.has("camera_link") else robot.base
        if eye == board:
            raise table.fail("board_link", f"{board!r} is the link itself: nothing moves between the two")
        return {"link": board, "seen_from": eye, "about": about}

    def _seen(self, at: Postures) -> tuple[End, End, Array, Array, Array, Array]:
        """Return board and camera, (N, C, 3) the points in the base [m], the same in the camera's frame, (N, C, 2)
        their pictures [px], and (N, C, 2, 3) the change of these with the points in the camera's frame.
        """
        board, eye = at.end(self.name), at.end(self.name, "eye")
        size = 1.0 + at.of(self.name, "scale")[:, :, None]
        there = board.place[:, None] + (size * at.about(self.name, Camera).board.points) @ board.axes.swapaxes(1, 2)
        in_camera = (there - eye.place[:, None]) @ eye.axes
        in_camera[..., 2] = np.where(np.abs(in_camera[..., 2]) < NEAREST, NEAREST, in_camera[..., 2])
        pixels, change = projected(in_camera, *(at.of(self.name, nuisance.name) for nuisance in LENS))
        return board, eye, there, in_camera, pixels, change

    def ideal(self, at: Postures) -> Array:
        return self._seen(at)[4].reshape(self.values.shape)

    def ends(self, at: Postures) -> Ends:
        """Return board and camera."""
        board, eye, there, in_camera, _, change = self._seen(at)
        # As far before the camera as it is taken to be.
        there = eye.place[:, None] + in_camera @ eye.axes.swapaxes(1, 2)
        change = change @ eye.axes.swapaxes(1, 2)[:, None]  # with the points in the base

        def moved(end: End) -> Array:
            about = rigid_motion((there - end.place[:, None]).reshape(-1, 3)).reshape(*there.shape, 6)
            return (change @ about).reshape(*self.values.shape, 6)

        return {"end": (board, moved(board)), "eye": (eye, -moved(eye))}

    def others(self, at: Postures) -> Mapping[str, Array]:
        board, eye, _, in_camera, pixels, change = self._seen(at)
        lens = by_lens(in_camera, pixels, *(at.of(self.name, nuisance.name) for nuisance in LENS[:2]))
        points = at.about(self.name, Camera).board.points @ (eye.axes.swapaxes(1, 2) @ board.axes).swapaxes(1, 2)
        parts = np.split(lens, [2, 4], axis=3), [change @ points[..., None]]
        each = zip((*LENS, SIZE), (*parts[0], *parts[1]), strict=True)
        return {nuisance.name: part.reshape(*self.values.shape, -1) for nuisance, part in each}

    def by_shift(self, at: Postures) -> Array:
        return np.linalg.norm(self._seen(at)[5], axis=3).reshape(self.values.shape)

    @property
    def look(self) -> Pixels:
        """The readings with four corners of each picture, the farthest apart: about as many numbers as a pose has."""
        sigma = np.full(self.sigma.shape, np.inf).reshape(len(self.sigma), -1, 2)
        places, stated = self.values.reshape(sigma.shape), self.sigma.reshape(sigma.shape)
        for row, seen in enumerate(np.all(np.isfinite(stated), axis=2)):
            which = np.flatnonzero(seen)
            kept = which[:0]
            for _ in range(min(4, len(which))):  # corners stand for a picture
                ends = places[row, kept] if len(kept) else places[row, which].mean(axis=0, keepdims=True)
                apart = np.linalg.norm(places[row, which, None] - ends, axis=2).min(axis=1)
                kept = np.append(kept, which[apart.argmax()])
            sigma[row, kept] = stated[row, kept]
        return replace(self, sigma=sigma.reshape(self.sigma.shape))

    def readable(self, at: Postures) -> np.ndarray:
        """Return (N, 2 C) which corners are in a picture that shows the front of the board, and `SHOWN` of it or more.

        A picture of no size that is declared is twice its centre.
        """
        size, points = at.about(self.name, Camera).image, at.about(self.name, Camera).board.points
        board, eye, _, in_camera, pixels, _ = self._seen(at)
        edge = 2.0 * at.of(self.name, "centre") if size is None else np.broadcast_to(size, (len(in_camera), 2))
        inside = np.all((pixels > 0.0) & (pixels < edge[:, None]), axis=2)
        shown = (in_camera[..., 2] > NEAREST) & inside
        if not np.ptp(points[:, 2]):  # a print's z points away from who looks at it
            away = np.einsum("nij,ni->nj", eye.axes, board.axes[..., 2])
            shown &= (away * in_camera.mean(axis=1)).sum(axis=1, keepdims=True) > 0.0
        return np.repeat(shown & (shown.mean(axis=1, keepdims=True) >= SHOWN), 2, axis=1)

    def start(self, at: Postures) -> Array:
        """Return where a fit may begin, from where it is: what is not known nearly is found in closed form."""
        sensor, declared = at.sensors[self.name], at.sensors[self.name].declared
        names = np.array([nuisance.name for nuisance in self.nuisances for _ in nuisance.axes])
        near = np.array(
            [NEAR[nuisance.unit] if nuisance.anywhere else np.inf for nuisance in self.nuisances for _ in nuisance.axes]
        )
        lost = sensor.std > near
        if not lost.any():
            return np.zeros(len(declared))
        camera = at.about(self.name, Camera)
        corners = np.where(np.isfinite(self.sigma), self.values, np.nan).reshape(len(self.values), -1, 2)
        board, link = at.pose(sensor.link), at.pose(sensor.seen_from)
        stated = {nuisance.name: declared[names == nuisance.name] for nuisance in LENS}
        focal = None if lost[names == "focal"].any() else stated["focal"]
        centre = None if lost[names == "centre"].any() else stated["centre"]
        sight = Sighting(camera.board.points, corners, np.linalg.inv(board) @ link, camera.image)
        placed = sighted(sight, focal, centre, stated["distortion"])
        if placed is None:
            return np.zeros(len(declared))
        values = dict(zip(("focal", "centre", "anchor", "mounting", "board_at", "board_turn"), placed, strict=True))
        step = np.zeros(len(declared))
        for name, value in values.items():
            of_name = names == name
            step[of_name] = np.where(lost[of_name], value - at.of(self.name, name)[0], 0.0)
        return step
