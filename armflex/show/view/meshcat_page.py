"""One self-contained HTML page from a scene: open it in a browser, no server, no network.

The page holds meshcat's viewer and, instead of a connection to meshcat's server, the commands that the server would
have sent: objects as three.js loads them, https://github.com/mrdoob/three.js/wiki/JSON-Object-Scene-format-4. The
viewer lies in the folder `meshcat` as version 0.3.2 of that package has it, with its licences.
"""

import base64
from collections.abc import Iterator
from importlib import resources
from string import Template
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from armflex.export.quoting import html_data, html_script, html_text
from armflex.show.view.scene_3d import Scene, Shape, Viewpoint, frame_camera, scene_points

Json = dict[str, Any]

_CAMERA = "/Cameras/default/rotated/<object>"
_TUBE_SIDES, _BALL_SIDES, _CAPSULE_SIDES = 12, 12, 24
"""A page of many via-points is drawn by a processor alone, too: what is small has few sides."""
_FRAMES_A_SECOND = 30.0
_CIRCLE_SIDES = 48
_Y_TO_Z = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
_LICENCES = ("LICENSE", "main.min.js.LICENSE.txt", "main.min.js.THIRD_PARTY_LICENSES.json")


def render_page(scene: Scene) -> str:
    """The page of `scene`, as HTML text. The same scene gives the same text, byte for byte."""
    points = scene_points(scene)
    low, high = points.min(axis=0), points.max(axis=0)
    x, y = (low[:2] + high[:2]) / 2.0
    shadows = points * [1.0, 1.0, 0.0] + [0.0, 0.0, scene.floor_z]
    camera = scene.camera or frame_camera(np.concatenate([points, shadows]))
    facts = {
        "eye": camera.position.tolist(),
        "target": camera.target.tolist(),
        "viewDeg": list(camera.view_deg),
        "labels": [
            [*marker.position.tolist(), marker.label, marker.radius] for marker in scene.markers if marker.label
        ],
        "groups": list(dict.fromkeys(node.name.split("/")[0] for node in scene.nodes)),
        "posable": scene.posable,
        "carried": [
            [_path("Nodes", node.name).split("/")[1:], node.link, node.flexed, node.turns, pose.T.ravel().tolist()]
            for node in scene.nodes
            if node.link and scene.posable
            for pose in (node.poses[min(scene.shown, len(node.poses) - 1)],)
        ],
        "floor": [float(x), float(y), scene.floor_z, float(np.linalg.norm(high - low))],
        "start": 0.0 if scene.times is None else float(scene.times[0]),
        "speed": scene.speed,
    }
    here = resources.files("armflex.show.view")
    licences = ["meshcat viewer", *((here / "meshcat" / name).read_text("utf-8") for name in _LICENCES)]
    template = Template((here / "overlay.html").read_text(encoding="utf-8"))
    return template.substitute(
        title=html_text(scene.title),
        subtitle=html_text(scene.subtitle),
        legend=_legend(scene),
        notes="".join(f"<li>{html_text(note)}</li>" for note in scene.notes),
        licences=html_script("\n\n".join(licences)),
        viewer=html_script((here / "meshcat" / "main.min.js").read_text(encoding="utf-8")),
        facts=html_data(facts),
        commands=html_data(list(commands(scene, camera))),
    )


def _legend(scene: Scene) -> str:
    """Return the legend and the table of via-points as HTML."""
    legend = ""
    if scene.legend:
        rows = []
        for row in scene.legend:
            swatch = f'<i style="background:{row.color};opacity:{row.opacity}"></i>'
            rows.append(f"<tr><td>{swatch}</td><td>{html_text(row.text)}</td><td>{html_text(row.value)}</td></tr>")
        heading = f"<h2>{html_text(scene.legend_title)}</h2>" if scene.legend_title else ""
        legend = f"{heading}<table>{''.join(rows)}</table>"
    if scene.table:
        head, *rows = (
            "".join(f"<td>{html_text(cell).replace('_', '_<wbr>')}</td>" for cell in row) for row in scene.table
        )
        body = "".join(f"<tr>{row}</tr>" for row in rows)
        legend += f'<h2>{html_text(scene.table_title)}</h2><table class="points"><tr>{head}</tr>{body}</table>'
    return legend


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


def commands(scene: Scene, camera: Viewpoint) -> Iterator[Json]:
    """Yield the commands to the viewer, in order; arrays of numbers are `_packed`."""
    yield _property("/Background", "top_color", (0.97, 0.98, 0.99))
    yield _property("/Background", "bottom_color", (0.84, 0.87, 0.90))
    yield _property("/Axes", "visible", False)
    # Whole metres: the lines of the grid, half a metre apart, then lie on round coordinates.
    pose = np.eye(4)
    pose[:3, 3] = *np.round(camera.target[:2]), scene.floor_z
    yield _transform("/Grid", pose)
    yield _property("/Grid", "color", (1.0, 1.0, 1.0, 0.22))
    # The viewer's cameras live in a frame with y up, the scene in one with z up.
    x, y, z = camera.position.tolist()
    yield _property(_CAMERA, "position", (x, z, -y))
    yield _property(_CAMERA, "far", 1000.0)
    for node in scene.nodes:
        path = _path("Nodes", node.name)
        for number, shape in enumerate(node.shapes):
            place = f"{path}/shape {number}"
            yield from _shape_commands(shape, place)
            yield _transform(place, shape.place)
        yield _transform(path, node.poses[0])
    for line in scene.polylines:
        yield _object(_path("Paths", line.name), _triangles(*tube_mesh(line.points, line.radius)), _paint(line.color))
    ball, sides = capsule_mesh(1.0, 0.0, _BALL_SIDES)
    shown = [marker for marker in scene.markers if marker.radius]
    for color in dict.fromkeys(marker.color for marker in shown):  # hundreds of balls are one mesh
        balls = [marker.position + marker.radius * ball for marker in shown if marker.color == color]
        faces = [i * len(ball) + sides for i in range(len(balls))]
        yield _object(_path("Markers", color), _triangles(np.concatenate(balls), np.concatenate(faces)), _paint(color))
    if scene.times is not None:
        frames = ((scene.times - scene.times[0]) * _FRAMES_A_SECOND / scene.speed).tolist()
        moving = [node for node in scene.nodes if len(node.poses) > 1]
        clips = [{"path": _path("Nodes", node.name), "clip": _clip(frames, node.poses)} for node in moving]
        options = {"play": True, "repetitions": 1e9}
        yield {"type": "set_animation", "animations": clips, "options": options, "path": ""}


def _clip(frames: list[float], poses: np.ndarray) -> Json:
    """Return the motion through (T, 4, 4) poses as the viewer plays it."""
    values = {
        ("position", "vector3"): poses[:, :3, 3].tolist(),
        ("quaternion", "quaternion"): Rotation.from_matrix(poses[:, :3, :3]).as_quat().tolist(),
    }
    tracks = [
        {
            "name": f".{name}",
            "type": kind,
            "keys": [{"time": time, "value": value} for time, value in zip(frames, track, strict=True)],
        }
        for (name, kind), track in values.items()
    ]
    return {"fps": _FRAMES_A_SECOND, "name": "default", "tracks": tracks}


def _shape_commands(shape: Shape, place: str) -> Iterator[Json]:
    size, kind, solid = [float(size) for size in shape.size], shape.kind, f"{place}/solid"
    if kind == "box":
        geometry = {"type": "BoxGeometry", **dict(zip(("width", "height", "depth"), size, strict=True))}
    elif kind == "sphere":
        geometry = {"type": "SphereGeometry", "radius": size[0], "widthSegments": 20, "heightSegments": 20}
    elif kind in ("cylinder", "cone"):
        radii = {"radiusTop": size[0] if kind == "cylinder" else 0.0, "radiusBottom": size[0]}
        geometry = {"type": "CylinderGeometry", **radii, "height": size[1], "radialSegments": 50}
    elif kind == "capsule":
        geometry = _triangles(*capsule_mesh(size[0], size[1]))
    else:
        data = _packed(np.frombuffer(shape.data, np.uint8)) if shape.data_format == "stl" else shape.data.decode()
        geometry = {"type": "_meshfile_geometry", "format": shape.data_format, "data": data}
    yield _object(solid, geometry, _paint(shape.color, shape.opacity, closed=kind != "mesh"))
    if kind in ("cylinder", "cone"):
        yield _transform(solid, _Y_TO_Z)  # A cylinder of the viewer stands along y.
    if kind == "mesh":
        yield _transform(solid, np.diag([*shape.size, 1.0]))
    if kind in ("box", "cylinder"):
        red, green, blue = (int(int(shape.color[i : i + 2], 16) * 0.62) for i in (1, 3, 5))
        opacity = min(1.0, 0.25 + shape.opacity)
        ink = {"type": "LineBasicMaterial", "color": (red << 16) + (green << 8) + blue}
        ink |= {"opacity": opacity, "transparent": opacity < 1.0}
        lines = _buffer(position=_edge_points(shape))
        yield _object(f"{place}/edges", lines, ink, kind="LineSegments")


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


def _object(path: str, geometry: Json, material: Json, kind: str = "Mesh") -> Json:
    """Return what puts an object of three.js at a path; its parts are named after that, for the same page each time."""
    parts = {"geometry": f"{path}:geometry", "material": f"{path}:material"}
    thing = {
        "metadata": {"version": 4.5, "type": "Object"},
        "geometries": [{**geometry, "uuid": parts["geometry"]}],
        "materials": [{**material, "uuid": parts["material"]}],
        "object": {"uuid": f"{path}:object", "type": kind, **parts},
    }
    return {"type": "set_object", "object": thing, "path": path}


def _transform(path: str, pose: np.ndarray) -> Json:
    return {"type": "set_transform", "path": path, "matrix": np.asarray(pose).T.ravel().tolist()}


def _property(path: str, name: str, value: object) -> Json:
    return {"type": "set_property", "path": path, "property": name, "value": value}


def _triangles(vertices: np.ndarray, faces: np.ndarray) -> Json:
    """Return the geometry of (V, 3) vertices and (F, 3) triangles."""
    geometry = _buffer(position=vertices)
    geometry["data"]["index"] = _attribute(np.asarray(faces, dtype=np.uint32))
    return geometry


def _buffer(position: np.ndarray) -> Json:
    attributes = {"position": _attribute(np.asarray(position, dtype=np.float32))}
    return {"type": "BufferGeometry", "data": {"attributes": attributes}}


def _attribute(rows: np.ndarray) -> Json:
    """Return (N, k) numbers, k of each vertex or triangle."""
    kind = "Float32Array" if rows.dtype == np.float32 else "Uint32Array"
    return {"itemSize": rows.shape[1], "type": kind, "array": _packed(rows), "normalized": False}


def _packed(numbers: np.ndarray) -> Json:
    """Return an array as the page makes a typed array of it."""
    kinds = {"f": "Float32Array", "u": "Uint32Array" if numbers.itemsize == 4 else "Uint8Array"}
    little = numbers.astype(numbers.dtype.newbyteorder("<"), copy=False)
    return {"packed": kinds[numbers.dtype.kind], "base64": base64.b64encode(little.tobytes()).decode()}


def _paint(color: str, opacity: float = 1.0, closed: bool = True) -> Json:
    paint = {"type": "MeshPhongMaterial", "color": int(color[1:], 16), "opacity": opacity}
    if opacity == 1.0:
        return {**paint, "shininess": 18, "side": 0 if closed else 2, "transparent": False}
    # A ghost shows its front faces only, or its own back would muddy it; and it is drawn a hair further away
    # than it is, so that where it coincides with a solid the solid is seen.
    behind = {"polygonOffset": True, "polygonOffsetFactor": 2.0, "polygonOffsetUnits": 4.0}
    return {**paint, "shininess": 0, "side": 0, "transparent": True, **behind}


def _path(group: str, name: str) -> str:
    """Return where the viewer keeps what is named so; a '/' in the name groups."""
    return "/".join(("", group, *(part for part in name.split("/") if part)))
