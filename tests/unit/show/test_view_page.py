"""The page is self-contained, escapes what it is given, and a real browser draws and plays it."""

import base64
import re
from pathlib import Path

import numpy as np
import pytest
from support.pages import BROWSER, hue_share, picture

from armflex.show.view.meshcat_page import capsule_mesh, commands, render_page, tube_mesh
from armflex.show.view.scene_3d import LegendRow, Marker, Node, Polyline, Scene, Shape, frame_camera, scene_points

pytestmark = pytest.mark.slow

ARM, GREEN, RED = "#2255cc", "#18a048", "#d02828"
FRAMES = 30


def translation(x: float, y: float, z: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def pitch(angle: float) -> np.ndarray:
    pose = np.eye(4)
    pose[0, 0] = pose[2, 2] = np.cos(angle)
    pose[0, 2], pose[2, 0] = np.sin(angle), -np.sin(angle)
    return pose


def link_poses(bend: float) -> list[np.ndarray]:
    poses = [translation(0.0, 0.0, 3.0) @ pitch(bend)]
    for _ in range(2):
        poses.append(poses[-1] @ translation(1.0, 0.0, 0.0) @ pitch(bend))
    return poses


def arm(group: str, bends: np.ndarray, color: str, opacity: float) -> list[Node]:
    motion = np.array([link_poses(bend) for bend in bends])
    body = Shape("box", (0.95, 0.2, 0.2), translation(0.5, 0.0, 0.0), color, opacity)
    hub = Shape("cylinder", (0.14, 0.3), pitch(0.0), color, opacity)
    return [Node(f"{group}/link {i}", motion[:, i], (body, hub)) for i in range(3)]


def small_scene(title: str = "Arm under load") -> Scene:
    bends = np.linspace(-0.2, 0.5, FRAMES)
    path = np.array([(link_poses(bend)[-1] @ translation(1.0, 0.0, 0.0))[:3, 3] for bend in bends])
    return Scene(
        title,
        "three links",
        arm("arm", bends + 0.06, ARM, 1.0) + arm("ghost", bends, "#6f8fb0", 0.25),
        (Polyline("tip path", path, "#e07010", 0.03),),
        (
            Marker(path[0] + [0.0, 0.0, 0.5], GREEN, 0.15, "start"),
            Marker(path[-1] - [0.0, 0.0, 0.6], RED, 0.15, "end"),
        ),
        legend_title="Deflection",
        legend=(LegendRow(ARM, "Flexure 1", "1.72°"), LegendRow(GREEN, "Payload", "25 kg")),
        notes=("Deflections are not amplified.",),
        times=np.linspace(0.0, 3.0, FRAMES),
    )


def test_page_fetches_nothing() -> None:
    page = render_page(small_scene())
    assert not re.search(r"<(script|img|iframe)[^>]*\bsrc\s*=|<link\b|@import|<base\b", page)
    assert "default-src 'none'" in page
    assert page.count("<script") == page.count("</script>")


def test_page_keeps_the_licences_of_the_viewer() -> None:
    page = render_page(small_scene())
    assert "Copyright (c) 2018 Robin Deits" in page
    assert "Three.js Authors" in page


def test_numbers_are_packed_as_the_page_unpacks_them() -> None:
    scene = small_scene()
    camera = frame_camera(scene_points(scene))
    told = {one["path"]: one for one in commands(scene, camera) if one["type"] == "set_object"}
    (geometry,) = told["/Paths/tip path"]["object"]["geometries"]
    vertices, faces = tube_mesh(scene.polylines[0].points, scene.polylines[0].radius)
    for found, kind, expected in (
        (geometry["data"]["attributes"]["position"], np.dtype("<f4"), vertices),
        (geometry["data"]["index"], np.dtype("<u4"), faces),
    ):
        numbers = np.frombuffer(base64.b64decode(found["array"]["base64"]), kind).reshape(-1, found["itemSize"])
        np.testing.assert_allclose(numbers, expected, rtol=1e-6, atol=1e-6)
        assert found["type"] == found["array"]["packed"]


def test_same_scene_gives_same_page() -> None:
    assert render_page(small_scene()) == render_page(small_scene())


def test_user_text_is_escaped() -> None:
    evil = "<script>alert(1)</script>"
    scene = Scene(
        evil, evil, markers=(Marker(np.zeros(3), label=evil),), legend_title=evil,
        legend=(LegendRow(ARM, evil, evil),), notes=(evil,),
    )  # fmt: skip
    page = render_page(scene)
    assert evil not in page and "<script>alert" not in page
    assert "<title>&lt;script&gt;alert(1)&lt;/script&gt;</title>" in page


@pytest.mark.skipif(BROWSER is None, reason="no chromium, chromium-browser or google-chrome on PATH")
def test_browser_draws_and_plays_the_scene(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    page.write_text(render_page(small_scene()), encoding="utf-8")
    early, late = picture(page, 400), picture(page, 1900)
    for color, least in ((ARM, 0.005), (GREEN, 0.0008), (RED, 0.0008)):
        assert hue_share(early, color) > least, f"{color} was not drawn"
    # Skip the player at the bottom: its clock alone would make the pictures differ.
    moved = np.mean(np.abs(early - late)[:700].max(axis=-1) > 40.0)
    assert moved > 0.005


@pytest.mark.parametrize("aspect", [1.0, 1.6, 2.4])
def test_camera_sees_all_points_and_stays_close(aspect: float) -> None:
    points = np.random.default_rng(7).uniform([-1.0, -2.0, 0.0], [8.0, 2.0, 5.0], (200, 3))
    camera = frame_camera(points, fov_deg=40.0, aspect=aspect)
    back = camera.position - camera.target
    back /= np.linalg.norm(back)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    seen = (points - camera.position) @ np.array([right, np.cross(back, right), -back]).T
    reach = np.abs(seen[:, :2] / seen[:, 2:]).max(axis=0)
    limits = np.tan(np.radians(20.0)) * np.array([aspect, 1.0])
    assert np.all(seen[:, 2] > 0.0) and np.all(reach < limits) and np.max(reach / limits) > 0.9
    assert np.all(reach < np.tan(np.radians(camera.view_deg) / 2.0))
    assert camera.position[2] > camera.target[2]


def test_camera_of_a_single_point() -> None:
    camera = frame_camera(np.array([[1.0, 2.0, 3.0]]))
    np.testing.assert_allclose(camera.target, [1.0, 2.0, 3.0], atol=1e-9)


@pytest.mark.parametrize(
    "points",
    [
        np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 2.0]]),
        np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]),
    ],
)
def test_tube_has_its_radius_and_faces_outwards(points: np.ndarray) -> None:
    vertices, faces = tube_mesh(points, 0.1)
    assert np.all(np.isfinite(vertices))
    distance = np.linalg.norm(vertices[:-2, None] - points[None], axis=2).min(axis=1)
    np.testing.assert_allclose(distance, 0.1, atol=1e-9)
    assert is_closed(faces)


def test_straight_tube_and_capsule_have_their_volume() -> None:
    tube = enclosed_volume(*tube_mesh(np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]), 0.1))
    assert 0.94 < tube / (np.pi * 0.01 * 2.0) < 1.0
    capsule = enclosed_volume(*capsule_mesh(0.3, 1.0))
    assert 0.97 < capsule / (np.pi * 0.09 + 4.0 / 3.0 * np.pi * 0.027) < 1.0
    assert is_closed(capsule_mesh(0.3, 1.0)[1])


def enclosed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    first, second, third = vertices[faces].transpose(1, 0, 2)
    return float(np.einsum("ij,ij->", first, np.cross(second, third)) / 6.0)


def is_closed(faces: np.ndarray) -> bool:
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).tolist()
    return {tuple(edge) for edge in edges} == {(b, a) for a, b in edges} and len(edges) % 2 == 0


def test_scene_points_follow_the_motion() -> None:
    poses = np.array([translation(0.0, 0.0, 0.0), translation(5.0, 0.0, 0.0)])
    scene = Scene("s", nodes=(Node("n", poses, (Shape("box", (2.0, 1.0, 1.0)),)),))
    points = scene_points(scene)
    np.testing.assert_allclose([points[:, 0].min(), points[:, 0].max()], [-1.0, 6.0])
