"""A neutral description of a 3-D picture: what is drawn, where, in which colour, and from where it is seen.

Lengths are metres, times are seconds, the world frame has z up. A pose is the (4, 4) homogeneous matrix
which takes coordinates of the named frame to world coordinates; colours are written #rrggbb, and an opacity below 1
draws a ghost. Nothing here knows how the picture is drawn. Mesh files named by a URDF are opened only on request and
only from beside it.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from armflex.conventions import Array
from armflex.errors import Place, UrdfError
from armflex.storage.read_file import read_file

ShapeKind = Literal["box", "cylinder", "sphere", "capsule", "cone", "mesh"]


@dataclass(frozen=True, eq=False)
class Shape:
    """One solid, rigidly attached to a node.

    Attributes:
        kind: "box", "cylinder", "sphere", "capsule", "cone" or "mesh".
        size: Of a box (3,) full side lengths; of a cylinder (radius, length) about z, a cone's point at +z; of a sphere
            (radius,); of a capsule (radius, length of the cylindrical part) about z; of a mesh (3,) scale factors.
        place: (4, 4) pose of the shape's centre in the node frame.
        color, opacity: How it is painted.
        data: Content of a mesh file.
        data_format: "stl", "obj" or "dae".
    """

    kind: ShapeKind
    size: Array
    place: Array = field(default_factory=lambda: np.eye(4))
    color: str = "#8a94a6"
    opacity: float = 1.0
    data: bytes = b""
    data_format: str = ""


@dataclass(frozen=True, eq=False)
class Node:
    """A frame of the world which carries shapes, at (T, 4, 4) `poses`, one for each time of the scene or one for all.

    A '/' in `name` groups nodes: "ghost/boom" is shown (and can be hidden) under "ghost" in the viewer. Names differ,
    and none is that of a group. `link` is the one that it moves with when a joint's slider is moved, '' for none;
    `flexed` whether with that of the flexed arm, and `turns` whether it turns with it, too.
    """

    name: str
    poses: Array
    shapes: tuple[Shape, ...] = ()
    link: str = ""
    flexed: bool = True
    turns: bool = True


@dataclass(frozen=True, eq=False)
class Polyline:
    """A path in the world, `points` (N, 3) of which two differ, drawn as a tube of the given `radius`."""

    name: str
    points: Array
    color: str
    radius: float


@dataclass(frozen=True, eq=False)
class Marker:
    """A small ball at `position` (3,) in the world, none of no radius, with an optional text label beside it."""

    position: Array
    color: str = "#2f6fb3"
    radius: float = 0.05
    label: str = ""


@dataclass(frozen=True)
class LegendRow:
    """One line of the legend: a swatch, a text, and a value with its unit."""

    color: str
    text: str
    value: str = ""
    opacity: float = 1.0


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """Where the scene is seen from: `position` (3,) and `target` (3,) in the world.

    `view_deg` holds the full horizontal and vertical angles which must be in view; whatever the shape of the
    window, at least these are shown.
    """

    position: Array
    target: Array
    view_deg: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Scene:
    """All that one picture shows.

    `times` (T,) seconds, strictly increasing, date the poses of the nodes that move, which are played `speed` times
    faster; None where nothing moves. `posable` is the arm of the frame `shown` as the page moves its joints, see
    `arm_scene.posable`; None where they stay. `table` has a row of cells for each via-point, its head first. `floor_z`
    is the height of the floor grid. Without a `camera` everything is framed in a three-quarter view.
    """

    title: str
    subtitle: str = ""
    nodes: tuple[Node, ...] = ()
    polylines: tuple[Polyline, ...] = ()
    markers: tuple[Marker, ...] = ()
    legend_title: str = ""
    legend: tuple[LegendRow, ...] = ()
    notes: tuple[str, ...] = ()
    table_title: str = ""
    table: tuple[tuple[str, ...], ...] = ()
    camera: Viewpoint | None = None
    times: Array | None = None
    speed: float = 1.0
    floor_z: float = 0.0
    posable: dict[str, Any] | None = None
    shown: int = 0


def frame_camera(points: Array, fov_deg: float = 26.0, aspect: float = 1.6) -> Viewpoint:
    """Return a camera which sees all `points` (N, 3) in a picture of the given width/height `aspect`.

    It looks down a little, 65 degrees away from the longest horizontal extent of the points, which gives a
    three-quarter view. The nearest one is taken whose vertical field `fov_deg`, shrunk by a margin, holds the points.
    """
    longest = np.linalg.eigh(np.cov(points[:, :2].T, bias=True))[1][:, 1]
    # An eigenvector has no sign: take the one nearest to x, so that the view does not flip between two runs.
    longest = -longest if longest[0] < 0.0 else longest
    azimuth, elevation, margin = float(np.arctan2(longest[1], longest[0]) - np.radians(65.0)), np.radians(14.0), 1.06
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
    return Viewpoint(axes.T @ eye, axes.T @ target, (horizontal, vertical))


def scene_points(scene: Scene) -> Array:
    """Points (N, 3) in the world which bound what the scene draws over all its frames."""
    corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
    clouds = [line.points for line in scene.polylines]
    clouds += [marker.radius * corners + marker.position for marker in scene.markers]
    for node in scene.nodes:
        for shape in node.shapes:
            if shape.kind == "box":
                half = np.asarray(shape.size) / 2.0
            elif shape.kind == "mesh":
                half = np.zeros(3)  # the extent of a mesh file is unknown before it is parsed
            else:
                radius, long = shape.size[0], shape.size[-1]
                length = {"sphere": 2.0 * radius, "capsule": long + 2.0 * radius}.get(shape.kind, long)
                half = np.array([radius, radius, length / 2.0])
            around = np.hstack([half * corners, np.ones((8, 1))]) @ shape.place.T
            clouds.append((node.poses @ around.T).transpose(0, 2, 1)[..., :3].reshape(-1, 3))
    return np.concatenate(clouds) if clouds else np.zeros((1, 3))


FORMATS = {".stl": "stl", ".obj": "obj", ".dae": "dae"}
MAX_BYTES = 100_000_000


def read_mesh(urdf: Path, filename: str) -> tuple[bytes, str] | None:
    """Return a mesh's bytes and format, or None where the file is not there or of no drawable format.

    `package://NAME/rest` is looked for beside the URDF and in the folders above it that hold NAME.

    Raises:
        UrdfError: The name leads out of the folders it may be in, or the file is too large or no text (.obj, .dae).
    """
    for root, relative in _candidates(urdf.resolve(), filename):
        path = (root / relative).resolve()
        if not path.is_relative_to(root):
            raise UrdfError(Place(urdf), f"mesh {filename!r} leads out of {root}")
        try:
            if path.is_file() and (form := FORMATS.get(path.suffix.lower())):
                data = read_file(path, MAX_BYTES)
                if form != "stl":
                    data.decode()  # the others are text
                return data, form
        except (OSError, ValueError) as error:
            problem = getattr(error, "strerror", None) or error
            raise UrdfError(Place(urdf), f"mesh {filename[:200]!r} cannot be read: {problem}") from None
    return None


def _candidates(urdf: Path, filename: str) -> list[tuple[Path, str]]:
    scheme, separator, rest = filename.partition("://")
    if not separator:
        return [(urdf.parent, filename)]
    if scheme == "file":
        return [(urdf.parent, str(Path(rest)))]
    package = rest.partition("/")[0]
    holders = [folder for folder in urdf.parents if (folder / package).is_dir()]
    return [(holder, rest) for holder in holders[:3]]
