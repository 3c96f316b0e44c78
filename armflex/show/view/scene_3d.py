"""A neutral description of a 3-D picture: what is drawn, where, in which colour, and from where it is seen.

Lengths are metres, times are seconds, the world frame has z up. A pose is the (4, 4) homogeneous matrix
which takes coordinates of the named frame to world coordinates. Nothing here knows how the picture is drawn.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

ShapeKind = Literal["box", "cylinder", "sphere", "capsule", "mesh"]

_SIZE_LENGTHS = {"box": 3, "cylinder": 2, "sphere": 1, "capsule": 2, "mesh": 3}
_MESH_FORMATS = ("stl", "obj", "dae")
_COLOR = re.compile(r"#[0-9a-fA-F]{6}")


@dataclass(frozen=True, eq=False)
class Shape:
    """One solid, rigidly attached to a node.

    `size` depends on `kind`: box (3,) full side lengths; cylinder (radius, length) about z; sphere (radius,);
    capsule (radius, length of the cylindrical part) about z; mesh (3,) scale factors. All centred on the
    shape frame, of which `T_node_shape` (4, 4) is the pose in the node frame. `data` is the content of a mesh
    file and `data_format` its format: stl, obj or dae. An `opacity` below 1 draws a ghost.
    Raises ValueError on a size, matrix, colour, opacity or mesh which cannot be drawn.
    """

    kind: ShapeKind
    size: np.ndarray
    T_node_shape: np.ndarray = field(default_factory=lambda: np.eye(4))
    color: str = "#8a94a6"
    opacity: float = 1.0
    data: bytes | None = None
    data_format: str = ""

    def __post_init__(self) -> None:
        if self.kind not in _SIZE_LENGTHS:
            raise ValueError(f"unknown shape kind {self.kind!r}, expected one of {', '.join(_SIZE_LENGTHS)}")
        _store(self, "size", (_SIZE_LENGTHS[self.kind],))
        _store(self, "T_node_shape", (4, 4))
        _check_paint(self.color, self.opacity)
        if self.kind != "mesh" and np.any(self.size <= 0.0):
            raise ValueError(f"size of a {self.kind} must be positive, got {self.size.tolist()}")
        if self.kind == "mesh" and (self.data is None or self.data_format not in _MESH_FORMATS):
            raise ValueError(f"a mesh needs data and a data_format among {', '.join(_MESH_FORMATS)}")


@dataclass(frozen=True, eq=False)
class Node:
    """A moving frame of the world which carries shapes.

    A '/' in `name` groups nodes: "ghost/boom" is shown (and can be hidden) under "ghost" in the viewer.
    `pose` (4, 4) is the pose at rest; `poses` (T, 4, 4), if given, one pose per time of the scene.
    Raises ValueError on an empty name or on a matrix of the wrong shape or with a non-finite entry.
    """

    name: str
    pose: np.ndarray
    shapes: tuple[Shape, ...] = ()
    poses: np.ndarray | None = None

    def __post_init__(self) -> None:
        if not self.name.strip("/"):
            raise ValueError("a node needs a name")
        _store(self, "pose", (4, 4))
        object.__setattr__(self, "shapes", tuple(self.shapes))
        if self.poses is not None:
            _store(self, "poses", (None, 4, 4))


@dataclass(frozen=True, eq=False)
class Polyline:
    """A path in the world, `points` (N, 3) with N >= 2, drawn as a tube of the given `radius`.

    Raises ValueError if fewer than two distinct points are given, or on a bad colour, opacity or radius.
    """

    name: str
    points: np.ndarray
    color: str = "#2f6fb3"
    radius: float = 0.02
    opacity: float = 1.0

    def __post_init__(self) -> None:
        _store(self, "points", (None, 3))
        _check_paint(self.color, self.opacity, self.radius)
        if len(self.points) == 0 or not np.any(self.points != self.points[0]):
            raise ValueError(f"polyline {self.name!r} needs at least two distinct points")


@dataclass(frozen=True, eq=False)
class Marker:
    """A small ball at `position` (3,) in the world, with an optional text label beside it.

    Raises ValueError on a bad position, colour or radius.
    """

    name: str
    position: np.ndarray
    color: str = "#2f6fb3"
    radius: float = 0.05
    label: str = ""

    def __post_init__(self) -> None:
        _store(self, "position", (3,))
        _check_paint(self.color, radius=self.radius)


@dataclass(frozen=True)
class LegendRow:
    """One line of the legend: a swatch (none if `color` is None), a text, and a value with its unit.

    Raises ValueError on a bad colour or opacity.
    """

    color: str | None
    text: str
    value: str = ""
    opacity: float = 1.0

    def __post_init__(self) -> None:
        _check_paint(self.color or "#000000", self.opacity)


@dataclass(frozen=True, eq=False)
class Camera:
    """Where the scene is seen from: `position` (3,) and `target` (3,) in the world.

    `view_deg` holds the full horizontal and vertical angles which must be in view; whatever the shape of the
    window, at least these are shown. Raises ValueError if position and target coincide.
    """

    position: np.ndarray
    target: np.ndarray
    view_deg: tuple[float, float] = (90.0, 60.0)

    def __post_init__(self) -> None:
        _store(self, "position", (3,))
        _store(self, "target", (3,))
        if np.allclose(self.position, self.target):
            raise ValueError("the camera must not sit on its target")
        if not all(0.0 < angle < 170.0 for angle in self.view_deg):
            raise ValueError(f"view angles must lie between 0 and 170 degrees, got {self.view_deg}")


@dataclass(frozen=True, eq=False)
class Scene:
    """All that one picture shows.

    `times` (T,) seconds, strictly increasing, date the `poses` of the animated nodes; left out, the frames
    follow each other at `fps`; they play `speed` times faster than these seconds. `floor_z` is the height of
    the floor grid, None for no floor. Without a `camera` everything is framed in a three-quarter view. Raises
    ValueError if two nodes bear one name, if a node is named like a group of others, or if numbers of frames
    disagree.
    """

    title: str
    subtitle: str = ""
    nodes: tuple[Node, ...] = ()
    polylines: tuple[Polyline, ...] = ()
    markers: tuple[Marker, ...] = ()
    legend_title: str = ""
    legend: tuple[LegendRow, ...] = ()
    notes: tuple[str, ...] = ()
    camera: Camera | None = None
    times: np.ndarray | None = None
    fps: float = 30.0
    speed: float = 1.0
    floor_z: float | None = 0.0

    def __post_init__(self) -> None:
        for name in ("nodes", "polylines", "markers", "legend", "notes"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if not self.fps > 0.0:
            raise ValueError(f"fps must be positive, got {self.fps}")
        if not self.speed > 0.0:
            raise ValueError(f"speed must be positive, got {self.speed}")
        for items in (self.nodes, self.polylines, self.markers):
            names = [item.name.strip("/") for item in items]
            taken = set(names)
            if len(taken) < len(names):
                raise ValueError(f"names must be unique, got {sorted(n for n in taken if names.count(n) > 1)} twice")
            groups = {name[:end] for name in names for end, letter in enumerate(name) if letter == "/"}
            for group in sorted(groups & taken):
                raise ValueError(f"{group!r} cannot be both an item and a group")
        if self.times is not None:
            _store(self, "times", (None,))
            if len(self.times) == 0 or np.any(np.diff(self.times) <= 0.0):
                raise ValueError("times must hold at least one time and increase strictly")
        counts = {len(node.poses) for node in self.nodes if node.poses is not None}
        if counts and self.times is not None:
            counts.add(len(self.times))
        if len(counts) > 1 or 0 in counts:
            raise ValueError(f"animated nodes, and times, need one number of frames, got {sorted(counts)}")


def frame_times(scene: Scene) -> np.ndarray:
    """Times of the frames, (T,) seconds; empty if no node of the scene moves."""
    counts = [len(node.poses) for node in scene.nodes if node.poses is not None]
    if not counts:
        return np.empty(0)
    return np.arange(counts[0]) / scene.fps if scene.times is None else scene.times


def frame_camera(
    points: np.ndarray,
    azimuth_deg: float | None = None,
    elevation_deg: float = 14.0,
    fov_deg: float = 26.0,
    aspect: float = 1.6,
    margin: float = 1.06,
) -> Camera:
    """Camera which sees all `points` (N, 3) in a picture of the given width/height `aspect`.

    `azimuth_deg` is the heading, about z from x, of the direction from target to camera; by default 65
    degrees away from the longest horizontal extent of the points, which gives a three-quarter view. The
    nearest camera is taken whose vertical field `fov_deg`, shrunk by `margin`, holds the points.
    Raises ValueError if there is no point or one is not finite.
    """
    points = np.atleast_2d(np.asarray(points, dtype=float))
    if points.size == 0 or points.shape[1] != 3 or not np.all(np.isfinite(points)):
        raise ValueError("points must be finite, of shape (N, 3) with N >= 1")
    if azimuth_deg is None:
        longest = np.linalg.eigh(np.cov(points[:, :2].T, bias=True))[1][:, 1]
        # An eigenvector has no sign: take the one nearest to x, so that the view does not flip between two runs.
        longest = -longest if longest[0] < 0.0 else longest
        azimuth = float(np.arctan2(longest[1], longest[0]) - np.radians(65.0))
    else:
        azimuth = np.radians(azimuth_deg)
    elevation = np.radians(elevation_deg)
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    back = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    axes = np.array([right, np.cross(back, right), back])
    seen = points @ axes.T
    tangents = np.tan(np.radians(fov_deg) / 2.0) * np.array([aspect, 1.0]) / margin
    # A point is inside a side of the field when  +-(x - eye_x) <= tangent * (eye_z - z): the tightest points
    # of two opposite sides give at once the eye between them and how far back it must stand.
    leaning = seen[:, 2:] * tangents
    high, low = np.max(seen[:, :2] + leaning, axis=0), np.max(leaning - seen[:, :2], axis=0)
    away = max(np.max((high + low) / (2.0 * tangents)), np.max(seen[:, 2]) + 0.5)
    eye = np.array([*((high - low) / 2.0), away])
    depth = eye[2] - seen[:, 2]
    spans = margin * np.max(np.abs(seen[:, :2] - eye[:2]) / depth[:, None], axis=0)
    horizontal, vertical = (float(np.clip(np.degrees(2.0 * np.arctan(span)), 1.0, 160.0)) for span in spans)
    target = eye - [0.0, 0.0, float(np.mean([depth.min(), depth.max()]))]
    return Camera(axes.T @ eye, axes.T @ target, (horizontal, vertical))


def scene_points(scene: Scene) -> np.ndarray:
    """Points (N, 3) in the world which bound what the scene draws over all its frames."""
    clouds = [line.points for line in scene.polylines]
    clouds += [_corners(marker.radius * np.ones(3)) + marker.position for marker in scene.markers]
    for node in scene.nodes:
        poses = node.pose[None] if node.poses is None else node.poses
        for shape in node.shapes:
            if shape.kind == "box":
                half = shape.size / 2.0
            elif shape.kind == "mesh":
                half = np.zeros(3)  # the extent of a mesh file is unknown before it is parsed
            else:
                radius, long = shape.size[0], shape.size[-1]
                length = {"sphere": 2.0 * radius, "cylinder": long, "capsule": long + 2.0 * radius}[shape.kind]
                half = np.array([radius, radius, length / 2.0])
            corners = np.hstack([_corners(half), np.ones((8, 1))]) @ shape.T_node_shape.T
            clouds.append((poses @ corners.T).transpose(0, 2, 1)[..., :3].reshape(-1, 3))
    return np.concatenate(clouds) if clouds else np.zeros((1, 3))


def _corners(half: np.ndarray) -> np.ndarray:
    return np.array(np.meshgrid(*np.array([-half, half]).T)).reshape(3, -1).T


def _store(owner: object, name: str, shape: tuple[int | None, ...]) -> None:
    array = np.array(getattr(owner, name), dtype=float)
    fits = array.ndim == len(shape) and all(w in (None, n) for w, n in zip(shape, array.shape, strict=True))
    if not fits or not np.all(np.isfinite(array)):
        wanted = ", ".join("N" if want is None else str(want) for want in shape)
        raise ValueError(f"{name} must be finite, of shape ({wanted}); its shape is {array.shape}")
    array.setflags(write=False)
    object.__setattr__(owner, name, array)


def _check_paint(color: str, opacity: float = 1.0, radius: float = 1.0) -> None:
    if not _COLOR.fullmatch(color):
        raise ValueError(f"a colour is written #rrggbb, got {color!r}")
    if not 0.0 <= opacity <= 1.0:
        raise ValueError(f"opacity must lie between 0 and 1, got {opacity}")
    if not 0.0 < radius < np.inf:
        raise ValueError(f"radius must be positive, got {radius}")
