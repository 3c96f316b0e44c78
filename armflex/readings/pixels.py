"""The corners of a printed board in a picture, by a camera on the arm or beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.readings.board import Board, read_board
from armflex.readings.kind import Kind, mounted, point_of, rigid_motion, skew
from armflex.readings.lens import by_lens, projected
from armflex.readings.postures import Postures
from armflex.readings.sensor import AXES, SCALE, TURNS, Nuisance
from armflex.readings.sighting import Sighting, sighted
from armflex.robot import Robot

LOOK = 4
"""Corners that stand for a picture where what all of them share is looked for."""

NEAR = {"m": 0.05, "rad": 0.05, "px": 50.0}
"""Standard deviation of a place, a turn or a lens up to which a fit finds it from where it is declared."""

SHOWN = 0.5
"""Share of a board's corners in a picture that is worth being planned."""

NEAREST = 1e-6
"""Depth before the camera [m] to which a point is brought that is beside it."""

LENS = (
    Nuisance("focal", ("x", "y"), "px", anywhere=True),
    Nuisance("centre", ("x", "y"), "px", anywhere=True),
    Nuisance("distortion", ("k1", "k2", "p1", "p2", "k3"), "1"),
)
CAMERA = (Nuisance("anchor", AXES, "m", anywhere=True), Nuisance("mounting", TURNS, "rad", anywhere=True))
BOARD = (Nuisance("board_at", AXES, "m", anywhere=True), Nuisance("board_turn", TURNS, "rad", anywhere=True))


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
    nuisances = (*LENS, *CAMERA, *BOARD, SCALE)
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
    def declared(cls, table: Declaration, robot: Robot) -> tuple[None, Camera]:
        """Return the camera."""
        if not table.has("board_link") and not table.has("camera_link"):
            text = "give the link that the camera is on or, of a camera that stands beside the arm, board_link"
            raise table.fail("camera_link", f"is missing: {text}")
        corners = table.text("corners", "") if table.has("corners") else ""
        image = table.numbers("image", (2,)) if table.has("image") else None
        return None, Camera(read_board(table.sub("board")), corners, image)

    def _camera(self, at: Postures) -> Camera:
        about = at.sensors[self.name].about
        assert isinstance(about, Camera)
        return about

    def _seen(self, at: Postures) -> tuple[Array, Array, Array]:
        """Return (N, C, 3) the points in the camera's frame [m], (N, C, 2) their pictures [px], and (N, C, 2, 3) the
        change of these with the points.
        """
        sensor, points = at.sensors[self.name], self._camera(at).board.points
        size = 1.0 + at.of(self.name, "scale")[:, :, None]
        axes = mounted(at, sensor.link, at.of(self.name, "board_turn"))[0]
        place = point_of(at, sensor.link, at.of(self.name, "board_at"))[0]
        there = place[:, None] + (size * points) @ axes.swapaxes(1, 2)
        eye = point_of(at, sensor.seen_from, at.of(self.name, "anchor"))[0]
        looks = mounted(at, sensor.seen_from, at.of(self.name, "mounting"))[0]
        own = (there - eye[:, None]) @ looks
        own[..., 2] = np.where(np.abs(own[..., 2]) < NEAREST, NEAREST, own[..., 2])
        return own, *projected(own, *(at.of(self.name, one.name) for one in LENS))

    def predicted(self, at: Postures) -> Array:
        return self._seen(at)[1].reshape(self.values.shape)

    def jacobian(self, at: Postures) -> Mapping[str | None, Array]:
        """Return (N, 2 C, 6) of the links that board and camera are on."""
        sensor, (own, _, change) = at.sensors[self.name], self._seen(at)
        count, corners = own.shape[:2]
        looks = mounted(at, sensor.seen_from, at.of(self.name, "mounting"))[0]
        turned = change @ looks.swapaxes(1, 2)[:, None]  # with the points in the base
        found: dict[str | None, Array] = {}
        eye = point_of(at, sensor.seen_from, at.of(self.name, "anchor"))[0]
        there = eye[:, None] + own @ looks.swapaxes(1, 2)
        for link, sign in ((sensor.link, 1.0), (sensor.seen_from, -1.0)):
            lever = (there - at.pose(link)[:, None, :3, 3]).reshape(-1, 3)
            moved = rigid_motion(lever).reshape(count, corners, 3, 6)
            found[link] = sign * (turned @ moved).reshape(count, 2 * corners, 6)
        return found

    def by_shift(self, at: Postures) -> Array:
        return np.linalg.norm(self._seen(at)[2], axis=3).reshape(self.values.shape)

    def by_own(self, at: Postures) -> Array:
        sensor, (own, pixels, change) = at.sensors[self.name], self._seen(at)
        count, corners = own.shape[:2]
        looks, changes = mounted(at, sensor.seen_from, at.of(self.name, "mounting"))
        back = looks.swapaxes(1, 2)
        lens = by_lens(own, pixels, *(at.of(self.name, one.name) for one in LENS))
        anchor, board = (back @ at.pose(link)[:, :3, :3] for link in (sensor.seen_from, sensor.link))
        mounting = change @ (skew(own.reshape(-1, 3)).reshape(count, corners, 3, 3) @ changes[:, None])
        axes, turns = mounted(at, sensor.link, at.of(self.name, "board_turn"))
        axes, points = back @ axes, self._camera(at).board.points
        size = 1.0 + at.of(self.name, "scale")[:, :, None]
        turn = -change @ (axes[:, None] @ skew(points) * size[:, :, :, None] @ turns[:, None])
        scale = change @ (points @ axes.swapaxes(1, 2))[..., None]
        parts = (lens, -change @ anchor[:, None], mounting, change @ board[:, None], turn, scale)
        return np.concatenate(parts, axis=3).reshape(count, 2 * corners, -1)

    @property
    def look(self) -> Pixels:
        """The readings with four corners of each picture, the farthest apart: about as many numbers as a pose has."""
        sigma = np.full(self.sigma.shape, np.inf).reshape(len(self.sigma), -1, 2)
        places, stated = self.values.reshape(sigma.shape), self.sigma.reshape(sigma.shape)
        for row, seen in enumerate(np.all(np.isfinite(stated), axis=2)):
            which = np.flatnonzero(seen)
            kept = which[:0]
            for _ in range(min(LOOK, len(which))):
                ends = places[row, kept] if len(kept) else places[row, which].mean(axis=0, keepdims=True)
                apart = np.linalg.norm(places[row, which, None] - ends, axis=2).min(axis=1)
                kept = np.append(kept, which[apart.argmax()])
            sigma[row, kept] = stated[row, kept]
        return replace(self, sigma=sigma.reshape(self.sigma.shape))

    def readable(self, at: Postures) -> np.ndarray:
        """Return (N, 2 C) which corners are in a picture that shows the front of the board, and `SHOWN` of it or more.

        A picture of no size that is declared is twice its centre.
        """
        size, points = self._camera(at).image, self._camera(at).board.points
        own, pixels, _ = self._seen(at)
        edge = 2.0 * at.of(self.name, "centre") if size is None else np.broadcast_to(size, (len(own), 2))
        inside = np.all((pixels > 0.0) & (pixels < edge[:, None]), axis=2)
        shown = (own[..., 2] > NEAREST) & inside
        if not np.ptp(points[:, 2]):  # a print's z points away from who looks at it
            sensor = at.sensors[self.name]
            looks = mounted(at, sensor.seen_from, at.of(self.name, "mounting"))[0]
            axes = mounted(at, sensor.link, at.of(self.name, "board_turn"))[0]
            shown &= (np.einsum("nij,ni->nj", looks, axes[..., 2]) * own.mean(axis=1)).sum(axis=1, keepdims=True) > 0.0
        return np.repeat(shown & (shown.mean(axis=1, keepdims=True) >= SHOWN), 2, axis=1)

    def start(self, at: Postures) -> Array:
        """Return where a fit may begin, from where it is: what is not known nearly is found in closed form."""
        sensor, declared = at.sensors[self.name], at.sensors[self.name].declared
        names = np.array([one.name for one in self.nuisances for _ in one.axes])
        near = np.array([NEAR[one.unit] if one.anywhere else np.inf for one in self.nuisances for _ in one.axes])
        lost = sensor.std > near
        if not lost.any():
            return np.zeros(len(declared))
        camera = self._camera(at)
        corners = np.where(np.isfinite(self.sigma), self.values, np.nan).reshape(len(self.values), -1, 2)
        board, link = at.pose(sensor.link), at.pose(sensor.seen_from)
        known = {one.name: declared[names == one.name] for one in LENS}
        focal = None if lost[names == "focal"].any() else known["focal"]
        centre = None if lost[names == "centre"].any() else known["centre"]
        sight = Sighting(camera.board.points, corners, np.linalg.inv(board) @ link, camera.image)
        found = sighted(sight, focal, centre, known["distortion"])
        if found is None:
            return np.zeros(len(declared))
        values = dict(zip(("focal", "centre", "anchor", "mounting", "board_at", "board_turn"), found, strict=True))
        step = np.zeros(len(declared))
        for name, value in values.items():
            own = names == name
            step[own] = np.where(lost[own], value - at.of(self.name, name)[0], 0.0)
        return step
