"""One self-contained HTML page from a scene: open it in a browser, no server, no network.

The page holds meshcat's viewer and, instead of a connection to meshcat's server, the very commands the server
would have sent. They are made here, in process, from meshcat's own geometry, command and animation classes.
"""

# pyright: reportArgumentType=false
# meshcat has no types: those that follow from its defaults are too narrow.

from __future__ import annotations

import base64
from collections.abc import Iterator
from importlib import resources
from io import BytesIO
from string import Template

import numpy as np
import umsgpack
from meshcat import geometry as mg
from meshcat.animation import Animation, AnimationClip, AnimationTrack, js_position, js_quaternion
from meshcat.commands import SetAnimation, SetObject, SetProperty, SetTransform
from meshcat.path import Path as ScenePath

from armflex.export.quoting import html_data, html_script, html_text
from armflex.show.view.scene_3d import Camera, Posable, Scene, Shape, frame_camera, scene_points

Command = dict[str, object]

_CAMERA = ScenePath(("Cameras", "default", "rotated", "<object>"))
_BACKGROUND_TOP, _BACKGROUND_BOTTOM = (0.97, 0.98, 0.99), (0.84, 0.87, 0.90)
_TUBE_SIDES, _BALL_SIDES, _CAPSULE_SIDES = 12, 12, 24
"""A page of many via-points is drawn by a processor alone, too: what is small has few sides."""
_FRAMES_A_SECOND = 30.0
_CIRCLE_SIDES = 48
_Y_TO_Z = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
_LICENCES = ("LICENSE", "dist/main.min.js.LICENSE.txt", "dist/main.min.js.THIRD_PARTY_LICENSES.json")
_MESH_GEOMETRIES = {"stl": mg.StlMeshGeometry, "obj": mg.ObjMeshGeometry, "dae": mg.DaeMeshGeometry}


def render_page(scene: Scene) -> str:
    """The page of `scene`, as HTML text. The same scene gives the same text, byte for byte."""
    points = scene_points(scene)
    floor = None
    if scene.floor_z is not None:
        low, high = points.min(axis=0), points.max(axis=0)
        x, y = (low[:2] + high[:2]) / 2.0
        floor = [float(x), float(y), float(scene.floor_z), float(np.linalg.norm(high - low))]
        points = np.concatenate([points, points * [1.0, 1.0, 0.0] + [0.0, 0.0, scene.floor_z]])  # and their shadows
    camera = scene.camera or frame_camera(points)
    facts = {
        "eye": camera.position.tolist(),
        "target": camera.target.tolist(),
        "viewDeg": list(camera.view_deg),
        "labels": [[*one.position.tolist(), one.label, one.radius] for one in scene.markers if one.label],
        "groups": list(dict.fromkeys(node.name.split("/")[0] for node in scene.nodes)),
        "posable": None if scene.posable is None else _posable(scene.posable),
        "carried": [
            [_parts("Nodes", node.name), node.link, node.flexed, node.turns, pose.T.ravel().tolist()]
            for node in scene.nodes
            if node.link and scene.posable
            for pose in (node.poses[min(scene.posable.frame, len(node.poses) - 1)],)
        ],
        "floor": floor,
        "start": 0.0 if scene.times is None else float(scene.times[0]),
        "speed": scene.speed,
    }
    legend = ""
    if scene.legend:
        rows = []
        for row in scene.legend:
            swatch = f'<i style="background:{row.color};opacity:{row.opacity}"></i>' if row.color else ""
            rows.append(f"<tr><td>{swatch}</td><td>{html_text(row.text)}</td><td>{html_text(row.value)}</td></tr>")
        heading = f"<h2>{html_text(scene.legend_title)}</h2>" if scene.legend_title else ""
        legend = f"{heading}<table>{''.join(rows)}</table>"
    if scene.table:
        head, *rows = ("".join(f"<td>{html_text(cell)}</td>" for cell in row) for row in scene.table)
        body = "".join(f"<tr>{row}</tr>" for row in rows)
        legend += f'<h2>{html_text(scene.table_title)}</h2><table class="points"><tr>{head}</tr>{body}</table>'
    viewer = resources.files("meshcat") / "viewer"
    files = [viewer.joinpath(*name.split("/")) for name in _LICENCES]
    licences = ["meshcat viewer", *(file.read_text("utf-8") for file in files if file.is_file())]
    commands = [base64.b64encode(umsgpack.packb(command)).decode() for command in _commands(scene, camera)]
    template = Template((resources.files("armflex.show.view") / "overlay.html").read_text(encoding="utf-8"))
    return template.substitute(
        title=html_text(scene.title),
        subtitle=html_text(scene.subtitle),
        legend=legend,
        notes="".join(f"<li>{html_text(note)}</li>" for note in scene.notes),
        licences=html_script("\n\n".join(licences)),
        viewer=html_script((viewer / "dist" / "main.min.js").read_text(encoding="utf-8")),
        facts=html_data(facts),
        commands=html_data(commands),
    )


def _posable(arm: Posable) -> dict[str, object]:
    """Return an arm that can be moved as JSON has it, matrices by columns as the viewer takes them."""
    sliders = [
        {
            **{name: getattr(one, name) for name in ("name", "slides", "low", "high", "here")},
            **{name: getattr(one, name).tolist() for name in ("point", "axis", "samples")},
            "flexed": np.round(one.flexed, 7).tolist(),
        }
        for one in arm.sliders
    ]
    return {
        "sliders": sliders,
        "links": arm.links,
        "rigid": [pose.T.ravel().tolist() for pose in arm.rigid],
        "behind": [np.flatnonzero(joints).tolist() for joints in arm.behind],
        "flexed": np.round(arm.flexed, 7).tolist(),
        "tip": arm.tip,
        "magnification": arm.magnification,
        "when": arm.when,
        "swings": [{"hz": one.frequency, "flexed": np.round(one.flexed, 7).tolist()} for one in arm.swings],
    }


def tube_mesh(points: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Closed tube around a polyline: vertices (V, 3) in metres and triangles (F, 3) which face outwards.

    `points` (N, 3) are the corners of the axis; repeated ones are dropped.
    """
    moved = np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9
    axis = points[np.concatenate([[True], moved])]
    steps = np.diff(axis, axis=0)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    tangents = np.concatenate([steps[:1], steps[:-1] + steps[1:], steps[-1:]])
    back = np.linalg.norm(tangents, axis=1) < 1e-6  # Where the path turns right back on itself.
    tangents[back] = np.concatenate([steps, steps[-1:]])[back]
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    sides, side = np.empty_like(axis), np.zeros(3)
    for index, tangent in enumerate(tangents):
        # Carry the side along instead of choosing it afresh at each point: the tube must not twist.
        side = sides[index] = _across(tangent, side)
    angles = 2.0 * np.pi * np.arange(_TUBE_SIDES) / _TUBE_SIDES
    ups = np.cross(tangents, sides)
    around = np.cos(angles)[:, None] * sides[:, None] + np.sin(angles)[:, None] * ups[:, None]
    rings = axis[:, None] + radius * around
    return np.concatenate([rings.reshape(-1, 3), axis[:1], axis[-1:]]), _lathe_faces(len(axis), _TUBE_SIDES)


def capsule_mesh(radius: float, length: float, sides: int = _CAPSULE_SIDES) -> tuple[np.ndarray, np.ndarray]:
    """Capsule about z, its cylindrical part `length` long: vertices (V, 3) and outward triangles (F, 3)."""
    latitudes = np.linspace(-0.5 * np.pi, 0.5 * np.pi, sides // 2 + 1)[1:-1]
    if length:
        latitudes = np.insert(latitudes, len(latitudes) // 2, 0.0)  # Both ends of the cylinder need a ring.
    shift = np.where(np.arange(len(latitudes)) < len(latitudes) / 2, -0.5, 0.5) * length
    angles = 2.0 * np.pi * np.arange(sides) / sides
    circle = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    rings = radius * np.cos(latitudes)[:, None, None] * circle
    rings[..., 2] += (radius * np.sin(latitudes) + shift)[:, None]
    poles = (radius + length / 2.0) * np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    return np.concatenate([rings.reshape(-1, 3), poles]), _lathe_faces(len(latitudes), sides)


def _across(tangent: np.ndarray, wish: np.ndarray) -> np.ndarray:
    side = wish - (wish @ tangent) * tangent
    if np.linalg.norm(side) < 1e-3:
        return _across(tangent, np.eye(3)[np.argmin(np.abs(tangent))])
    return side / np.linalg.norm(side)


def _lathe_faces(rings: int, sides: int) -> np.ndarray:
    ring, side = np.meshgrid(np.arange(rings - 1), np.arange(sides), indexing="ij")
    here, there = (ring * sides + side).ravel(), (ring * sides + (side + 1) % sides).ravel()
    walls = [np.stack([here, there, there + sides], 1), np.stack([here, there + sides, here + sides], 1)]
    first, turn = np.arange(sides), (np.arange(sides) + 1) % sides
    last, bottom, top = (rings - 1) * sides, np.full(sides, rings * sides), np.full(sides, rings * sides + 1)
    caps = [np.stack([bottom, turn, first], 1), np.stack([top, last + first, last + turn], 1)]
    return np.concatenate(walls + caps)


def _commands(scene: Scene, camera: Camera) -> Iterator[Command]:
    background, grid = ScenePath(("Background",)), ScenePath(("Grid",))
    yield SetProperty("top_color", list(_BACKGROUND_TOP), background).lower()
    yield SetProperty("bottom_color", list(_BACKGROUND_BOTTOM), background).lower()
    yield SetProperty("visible", False, ScenePath(("Axes",))).lower()
    if scene.floor_z is None:
        yield SetProperty("visible", False, grid).lower()
    else:
        # Whole metres: the lines of the grid, half a metre apart, then lie on round coordinates.
        pose = np.eye(4)
        pose[:3, 3] = *np.round(camera.target[:2]), scene.floor_z
        yield SetTransform(pose, grid).lower()
        yield SetProperty("color", [1.0, 1.0, 1.0, 0.22], grid).lower()
    # The viewer's cameras live in a frame with y up, the scene in one with z up.
    x, y, z = camera.position.tolist()
    yield SetProperty("position", [x, z, -y], _CAMERA).lower()
    yield SetProperty("far", 1000.0, _CAMERA).lower()
    for node in scene.nodes:
        path = _path("Nodes", node.name)
        for number, shape in enumerate(node.shapes):
            place = path.append(f"shape {number}")
            yield from _shape_commands(shape, place)
            yield SetTransform(shape.place, place).lower()
        yield SetTransform(node.poses[0], path).lower()
    for line in scene.polylines:
        mesh = mg.TriangularMeshGeometry(*tube_mesh(line.points, line.radius))
        yield _object_command(mg.Mesh, mesh, _paint(line.color, 1.0), _path("Paths", line.name))
    ball, sides = capsule_mesh(1.0, 0.0, _BALL_SIDES)
    for color in dict.fromkeys(one.color for one in scene.markers if one.radius):  # hundreds of balls are one mesh
        balls = [one.position + one.radius * ball for one in scene.markers if one.color == color and one.radius]
        faces = [i * len(ball) + sides for i in range(len(balls))]
        mesh = mg.TriangularMeshGeometry(np.concatenate(balls), np.concatenate(faces))
        yield _object_command(mg.Mesh, mesh, _paint(color, 1.0), _path("Markers", color))
    if scene.times is None:
        return
    frames = ((scene.times - scene.times[0]) * _FRAMES_A_SECOND / scene.speed).tolist()
    animation = Animation(default_framerate=_FRAMES_A_SECOND)
    for node in scene.nodes:
        if len(node.poses) > 1:
            tracks = {
                name: AnimationTrack(name, kind, frames, [[float(x) for x in of(pose)] for pose in node.poses])
                for name, kind, of in (
                    ("position", "vector3", js_position),
                    ("quaternion", "quaternion", js_quaternion),
                )
            }
            animation.clips[_path("Nodes", node.name)] = AnimationClip(tracks, fps=_FRAMES_A_SECOND)
    yield SetAnimation(animation, play=True, repetitions=float("inf")).lower()


def _shape_commands(shape: Shape, place: ScenePath) -> Iterator[Command]:
    size, kind, solid = [float(size) for size in shape.size], shape.kind, place.append("solid")
    if kind == "box":
        geometry = mg.Box(size)
    elif kind == "sphere":
        geometry = mg.Sphere(size[0])
    elif kind == "cylinder":
        geometry = mg.Cylinder(height=size[1], radius=size[0])
    elif kind == "cone":
        geometry = mg.Cylinder(height=size[1], radiusTop=0.0, radiusBottom=size[0])
    elif kind == "capsule":
        geometry = mg.TriangularMeshGeometry(*capsule_mesh(*size))
    else:
        geometry = _MESH_GEOMETRIES[shape.data_format].from_stream(BytesIO(shape.data or b""))
    yield _object_command(mg.Mesh, geometry, _paint(shape.color, shape.opacity, closed=kind != "mesh"), solid)
    if kind in ("cylinder", "cone"):
        yield SetTransform(_Y_TO_Z, solid).lower()  # A cylinder of the viewer stands along y.
    if kind == "mesh":
        yield SetTransform(np.diag([*shape.size, 1.0]), solid).lower()
    if kind in ("box", "cylinder"):
        red, green, blue = (int(int(shape.color[i : i + 2], 16) * 0.62) for i in (1, 3, 5))
        shade = (red << 16) + (green << 8) + blue
        ink = mg.LineBasicMaterial(color=shade, opacity=min(1.0, 0.25 + shape.opacity))
        lines = mg.PointsGeometry(_edge_points(shape).T.astype(np.float32))
        yield _object_command(mg.LineSegments, lines, ink, place.append("edges"))


def _edge_points(shape: Shape) -> np.ndarray:
    if shape.kind == "box":
        corners = np.array(np.meshgrid(*np.multiply.outer(shape.size, [-0.5, 0.5]), indexing="ij"))
        corners = corners.reshape(3, 8).T
        return corners[[0, 1, 2, 3, 4, 5, 6, 7, 0, 2, 1, 3, 4, 6, 5, 7, 0, 4, 1, 5, 2, 6, 3, 7]]
    radius, length = shape.size
    angles = np.repeat(2.0 * np.pi * np.arange(_CIRCLE_SIDES + 1) / _CIRCLE_SIDES, 2)[1:-1]
    rim = np.stack([radius * np.cos(angles), radius * np.sin(angles), np.zeros_like(angles)], axis=1)
    end = np.array([0.0, 0.0, length / 2.0])
    return np.concatenate([rim - end, rim + end])


def _object_command(kind: type[mg.Object], shape: mg.Geometry, material: mg.Material, path: ScenePath) -> Command:
    thing = kind(shape, material)
    # meshcat numbers its elements from the clock and the network card: name them after their place, so that
    # a page depends on its scene alone.
    for role, element in (("object", thing), ("geometry", shape), ("material", material)):
        element.uuid = f"{path.lower()}:{role}"
    return SetObject(thing, path=path).lower()


def _paint(color: str, opacity: float, closed: bool = True) -> mg.Material:
    if opacity == 1.0:
        return mg.MeshPhongMaterial(color=int(color[1:], 16), shininess=18, side=0 if closed else 2)
    # A ghost shows its front faces only, or its own back would muddy it; and it is drawn a hair further away
    # than it is, so that where it coincides with a solid the solid is seen.
    behind = {"polygonOffset": True, "polygonOffsetFactor": 2.0, "polygonOffsetUnits": 4.0}
    return mg.MeshPhongMaterial(color=int(color[1:], 16), opacity=opacity, side=0, shininess=0, **behind)


def _path(group: str, name: str) -> ScenePath:
    return ScenePath(_parts(group, name))


def _parts(group: str, name: str) -> tuple[str, ...]:
    return (group, *(part for part in name.split("/") if part))
