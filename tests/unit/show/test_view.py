"""`view`: what the page of an arm shows is what the arm does, drawn in process and from the URDF's own folder only."""

import json
import os
import re
import shutil
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from support.pages import BROWSER, QUIET, browse, hue_share, picture, sheets
from support.small_arms import ROBOTS, joint, link, robot, write

from armflex import Arm, InputError, Payload, Trajectory, Wrench, check, load_arm, view
from armflex.arm import Flexure
from armflex.errors import FileError, UrdfError
from armflex.laws import LinearLaw
from armflex.show.view import scene_3d
from armflex.show.view.arm_scene import (
    FLEXED_PATH,
    MAX_FRAMES,
    SCALE,
    VERDICTS,
    Motion,
    arm_scene,
    contribution_colors,
    nice_magnification,
    payload_box,
    posable,
)
from armflex.show.view.arm_scene import motion_along as motion_of
from armflex.show.view.scene_3d import Scene

needs_browser = pytest.mark.skipif(BROWSER is None, reason="no chromium, chromium-browser or google-chrome on PATH")
TRIANGLE = bytes(80) + struct.pack("<I12fH", 1, *[0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0], 0)


def still(arm: Arm, q: np.ndarray, payload: str | None = None) -> Motion:
    return Motion(np.zeros(1), (arm.deflection(q, payload),), 0)


def drawn(scene: Scene) -> dict[str, list[str]]:
    """Return the kinds of the shapes by node."""
    return {node.name: [shape.kind for shape in node.shapes] for node in scene.nodes}


def small(folder: Path, visual: str = "", child: str = "arm") -> Arm:
    """Return one turning link of 1 m with the given <visual> and a tool at its end."""
    mass = link("x", 5.0, (0.5, 0, 0)).split("\n", 1)[1].removesuffix("</link>")
    parts = [
        link("base"),
        joint("j", "base", child, (0, 0, 1)),
        f'<link name="{child}">{mass}{visual}</link>',
        joint("f", child, f"{child}/tool", (1, 0, 0), kind="fixed"),
        f'<link name="{child}/tool">{visual}</link>',
    ]
    write(folder, robot(*parts))
    (folder / "arm.toml").write_text(
        f'[robot]\nurdf = "robot.urdf"\ntip = "{child}/tool"\ngravity = [0, 0, -9.81]\n'
        '[flexure."j/1"]\njoint = "j"\ncompliance = [1e-9, 1e-9, 1e-9, 1e-5, 1e-5, 1e-5]\n'
    )
    return load_arm(folder / "arm.toml")


def geometry(inside: str) -> str:
    return f"<visual><geometry>{inside}</geometry></visual>"


def test_page_at_one_configuration(tarm: Arm, tmp_path: Path) -> None:
    q = tarm.position(M1=2.0, A3=0.4)
    path = view(tarm, q, "p600", path=tmp_path / "v.html")
    page, found = path.read_text(), tarm.deflection(q, "p600")
    sigma = np.sqrt(found.displacement[:3] @ found.covariance[:3, :3] @ found.displacement[:3])
    sigma /= np.linalg.norm(found.displacement[:3])
    moved = np.linalg.norm(found.displacement[:3])
    assert f"Tip moves {moved * 1e3:.4g} ± {sigma * 1e3:.2g} mm" in page
    assert "600 kg" in page and "Base crane, tip tool" in page
    assert [p.name for p in tmp_path.iterdir()] == ["v.html"]


def test_page_of_a_trajectory(heavy: Arm, heavy_path: Trajectory, tmp_path: Path) -> None:
    report = check(heavy, heavy_path, 0.005)
    page = view(heavy, trajectory=heavy_path, report=report, path=tmp_path / "v.html").read_text()
    sizes = [
        np.linalg.norm(heavy.deflection(q, p).displacement[:3])
        for q, p in zip(heavy_path.q, heavy_path.payload, strict=True)
    ]
    assert f"Tip moves {max(sizes) * 1e3:.4g} " in page and f" at {heavy_path.time[int(np.argmax(sizes))]:g} s" in page
    for verdict in VERDICTS:
        count = sum(point.verdict == verdict for point in report.via_points)
        assert f"via-point: {verdict}</td><td>{count}</td>" in page


@pytest.mark.parametrize("given", [None, 7.0, 1000.0])
def test_magnification_is_stated(tarm: Arm, tmp_path: Path, given: float | None) -> None:
    page = view(tarm, payload="p600", magnification=given, path=tmp_path / "v.html").read_text()
    factor = given or nice_magnification(tarm, still(tarm, np.zeros(7), "p600"))
    assert f"Shown × {factor:g}." in page
    assert f"Deflections are drawn {factor:g} times as large as they are; the rigid arm is to scale." in page


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf, 1e300])
def test_magnification_must_be_drawable(tarm: Arm, tmp_path: Path, bad: float) -> None:
    with pytest.raises(InputError, match="magnification must be positive"):
        view(tarm, magnification=bad, path=tmp_path / "v.html")
    assert not list(tmp_path.iterdir())


def test_round_factor_keeps_the_sag_below_an_eighth_of_the_reach(heavy: Arm) -> None:
    motion = still(heavy, np.zeros(6), "p200")
    sag = np.linalg.norm(motion.frames[0].displacement[:3])
    factor = nice_magnification(heavy, motion)
    assert factor * sag <= heavy.robot.reach / 8.0 < 2.5 * factor * sag and f"{factor:g}"[0] in "125"


def test_drawn_arm_is_where_the_arm_is(tarm: Arm) -> None:
    q = tarm.position(M1=1.0, A4=0.7)
    found = tarm.deflection(q, "p300")
    scene = arm_scene(tarm, still(tarm, q, "p300"), magnification=1.0)
    line = next(line for line in scene.polylines if line.name == "displacement")
    np.testing.assert_allclose(line.points, [found.rigid_pose.translation, found.pose.translation], atol=1e-12)
    poses = {node.name: node.poses[0] for node in scene.nodes}
    bent, rigid = found.link_poses(1.0), found.link_poses(0.0)
    for name in tarm.robot.urdf.links:
        if f"flexed/{name}" in poses:
            np.testing.assert_allclose(poses[f"flexed/{name}"], bent[name], atol=1e-12)
        if f"rigid/{name}" in poses:
            np.testing.assert_allclose(poses[f"rigid/{name}"], rigid[name], atol=1e-12)
    assert sum(name.startswith("flexed/") for name in poses) >= 7 and "payload" in poses


def test_magnified_arm_bends_so_much_more(heavy: Arm) -> None:
    motion = still(heavy, np.zeros(6), "p200")
    tips = {f: arm_scene(heavy, motion, magnification=f).polylines[0].points for f in (1.0, 20.0)}
    once, often = (np.diff(points, axis=0)[0] for points in tips.values())
    assert np.linalg.norm(often - 20.0 * once) < 0.1 * np.linalg.norm(
        often
    )  # angles of 0.1 rad: a tenth beyond first order
    np.testing.assert_allclose(once, motion.frames[0].displacement[:3], atol=1e-12)


def test_colours_follow_the_shares(tarm: Arm) -> None:
    found = tarm.deflection(np.zeros(7), "p600")
    colors = contribution_colors(found)
    shares = np.abs(found.contributions[:, :3] @ found.displacement[:3])
    assert colors[tarm.flexure_names[int(np.argmax(shares))]] == SCALE[-1]
    assert len(set(colors.values())) > 3


def test_via_points_carry_the_colour_of_their_verdict(heavy: Arm, heavy_path: Trajectory) -> None:
    report = check(heavy, heavy_path, 0.005)
    scene = arm_scene(heavy, motion_of(heavy, heavy_path), heavy_path, report)
    expected = {point.name: VERDICTS[point.verdict] for point in report.via_points}
    assert {marker.label: marker.color for marker in scene.markers} == expected and len(set(expected.values())) == 3
    for marker in scene.markers:
        q = heavy_path.q[heavy_path.via.index(marker.label)]
        np.testing.assert_allclose(marker.position, heavy.rigid_pose(q).translation, atol=1e-12)


def test_long_trajectory_is_thinned_and_keeps_its_via_points(heavy: Arm, heavy_path: Trajectory) -> None:
    path = heavy_path
    while len(path) <= 2 * MAX_FRAMES:
        path = path.with_midpoints(np.ones(len(path) - 1, dtype=bool))
    times = motion_of(heavy, path).times
    vias = [time for time, name in zip(path.time, path.via, strict=True) if name]
    assert len(times) <= MAX_FRAMES + len(vias) + 1 and set(vias) <= set(times) and times[-1] == path.time[-1]


def test_page_is_made_without_process_or_socket(heavy: Arm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object, **kwargs: object) -> None:
        raise AssertionError("a page must be made in process")

    for place in ("subprocess.Popen.__init__", "os.fork", "socket.socket.connect", "socket.socket.bind"):
        monkeypatch.setattr(place, refuse)
    view(heavy, path=tmp_path / "v.html")


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "killpg"), reason="no process groups")
def test_command_leaves_no_process_behind(tmp_path: Path) -> None:
    code = "from armflex.cli.main import main; main()"
    arguments = [sys.executable, "-c", code, "view", ROBOTS / "heavy_six" / "arm.toml", "-o", tmp_path / "v.html"]
    child = subprocess.Popen(arguments, cwd=ROBOTS.parent, start_new_session=True, stdout=subprocess.DEVNULL)
    assert child.wait(timeout=600) == 0
    with pytest.raises(ProcessLookupError):
        os.killpg(child.pid, 0)


def test_links_without_visuals_are_rods(tmp_path: Path) -> None:
    arm = small(tmp_path)
    kinds = drawn(arm_scene(arm, still(arm, np.zeros(1))))
    links = [one for name, one in kinds.items() if name.startswith(("rigid/", "flexed/"))]
    assert {kind for one in links for kind in one} == {"capsule"}
    rod = next(node for node in arm_scene(arm, still(arm, np.zeros(1))).nodes if node.name == "flexed/arm").shapes[0]
    np.testing.assert_allclose(rod.size[1], 1.0)
    np.testing.assert_allclose(rod.place[:3, 3], [0.5, 0.0, 0.0])
    np.testing.assert_allclose(np.abs(rod.place[:3, 2]), [1.0, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("visual", ["", geometry('<mesh filename="none.stl"/>') + geometry('<sphere radius="0.01"/>')])
def test_every_link_that_goes_somewhere_has_a_stick(tmp_path: Path, visual: str) -> None:
    """One of 20 mm as well, shorter than sticks are wide, and one of which a mesh is not drawn."""
    small(tmp_path, visual)
    text = (tmp_path / "robot.urdf").read_text()
    short = text.replace('<origin xyz="1.0 0.0 0.0"', '<origin xyz="0.02 0.0 0.0"')
    assert short != text
    (tmp_path / "robot.urdf").write_text(short)
    arm = load_arm(tmp_path / "arm.toml")
    assert "capsule" in drawn(arm_scene(arm, still(arm, np.zeros(1))))["flexed/arm"]


def test_what_is_less_than_a_nanometre_is_shown_as_nothing(tmp_path: Path) -> None:
    arm = replace(small(tmp_path), flexures=(Flexure("j/1", "j", LinearLaw(1e-20 * np.eye(6))),))
    scene = arm_scene(arm, still(arm, np.zeros(1)))
    assert "Tip moves 0 mm and turns 0 mrad" in scene.subtitle and scene.legend[0].value == "0 mm"


@pytest.mark.parametrize(
    "inside", ['<box size="0 1 1"/>', '<cylinder radius="0.1" length="0"/>', '<sphere radius="0"/>']
)
def test_visuals_without_extent_are_left_out(tmp_path: Path, inside: str) -> None:
    arm = small(tmp_path, geometry(inside))
    assert drawn(arm_scene(arm, still(arm, np.zeros(1))))["flexed/arm"] == ["capsule"]


def test_names_with_slashes(tmp_path: Path) -> None:
    """The viewer takes a slash for a group, and 'arm/tool' would then be inside the item 'arm'."""
    arm = small(tmp_path, geometry('<box size="0.1 0.1 0.1"/>'))
    names = set(drawn(arm_scene(arm, still(arm, np.zeros(1)))))
    assert {"flexed/arm", "flexed/arm∕tool", "flexure/j∕1"} <= names
    assert view(arm, path=tmp_path / "v.html").is_file()


def meshed(folder: Path, filename: str) -> Callable[[], Scene]:
    arm = small(folder, geometry(f'<mesh filename="{filename}" scale="2 2 2"/>'))
    return lambda: arm_scene(arm, still(arm, np.zeros(1)), meshes=True)


@pytest.mark.parametrize(
    "filename", ["part.stl", "meshes/part.stl", "package://here/meshes/part.stl", "meshes/../part.stl"]
)
def test_meshes_beside_the_urdf_are_drawn_on_request(tmp_path: Path, filename: str) -> None:
    folder = tmp_path / "here"
    (folder / "meshes").mkdir(parents=True)
    for place in (folder, folder / "meshes"):
        (place / "part.stl").write_bytes(TRIANGLE)
    scene = meshed(folder, filename)()
    shape = next(node for node in scene.nodes if node.name == "flexed/arm").shapes[0]
    assert (shape.kind, shape.data, shape.data_format, shape.size.tolist()) == ("mesh", TRIANGLE, "stl", [2.0] * 3)
    arm = load_arm(folder / "arm.toml")
    assert "mesh" not in str(drawn(arm_scene(arm, still(arm, np.zeros(1)))))
    assert view(arm, meshes=True, path=tmp_path / "v.html").is_file()


@pytest.mark.parametrize(
    "filename",
    ["../secret.stl", "/etc/secret.stl", "file:///etc/secret.stl", "link.stl", "package://here/../../etc/secret.stl"],
)
def test_meshes_from_elsewhere_are_refused(tmp_path: Path, filename: str) -> None:
    folder = tmp_path / "here"
    folder.mkdir()
    (tmp_path / "secret.stl").write_bytes(TRIANGLE)
    (folder / "link.stl").symlink_to(tmp_path / "secret.stl")
    with pytest.raises(UrdfError, match=r"robot\.urdf: mesh '.*' leads out of"):
        meshed(folder, filename)()


@pytest.mark.parametrize("filename", ["none.stl", "http://host/part.stl", "part.blend", "package://nowhere/part.stl"])
def test_meshes_that_are_not_there_become_rods(tmp_path: Path, filename: str) -> None:
    (tmp_path / "part.blend").write_bytes(b"x")
    assert drawn(meshed(tmp_path, filename)())["flexed/arm"] == ["capsule"]


@pytest.mark.parametrize(
    ("filename", "content"), [("m.obj", b"v 0 0 0 \xff"), ("m.dae", b"\xff"), ("a" * 300 + ".stl", None)]
)
def test_meshes_that_cannot_be_read(tmp_path: Path, filename: str, content: bytes | None) -> None:
    if content:
        (tmp_path / filename).write_bytes(content)
    with pytest.raises(UrdfError, match="cannot be read"):
        meshed(tmp_path, filename)()


def test_mesh_that_is_too_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "m.stl").write_bytes(TRIANGLE)
    monkeypatch.setattr(scene_3d, "MAX_BYTES", 100)
    with pytest.raises(UrdfError, match="larger than the 100 bytes"):
        meshed(tmp_path, "m.stl")()


def test_rigid_arm_says_so(heavy: Arm, tmp_path: Path) -> None:
    page = view(replace(heavy, flexures=()), path=tmp_path / "v.html").read_text()
    assert "No flexure is declared: this arm is rigid." in page and "times as large" not in page


def test_user_text_in_names_is_escaped(heavy: Arm, heavy_path: Trajectory, tmp_path: Path) -> None:
    evil = "<script>alert(1)</script>"
    via = tuple(evil if name else "" for name in heavy_path.via)
    page = view(heavy, trajectory=replace(heavy_path, via=via), path=tmp_path / "v.html").read_text()
    assert evil not in page and "<script>alert" not in page


def test_what_is_asked_must_make_sense(heavy: Arm, heavy_path: Trajectory, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="q or a trajectory, not both"):
        view(heavy, np.zeros(6), trajectory=heavy_path, path=tmp_path / "v.html")
    for place in (tmp_path, tmp_path / "none" / "v.html"):
        with pytest.raises(FileError, match="cannot be written"):
            view(heavy, path=place)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@needs_browser
def test_browser_shows_the_arm(tarm: Arm, tmp_path: Path) -> None:
    """Each link in the colour of its flexure's share; a rigid arm has the URDF's colours, none of these two."""
    q = tarm.position(M1=1.0, A4=0.5)
    colors = contribution_colors(tarm.deflection(q, "p600"))
    flexed = picture(view(tarm, q, "p600", path=tmp_path / "v.html"), 300)
    rigid = picture(view(replace(tarm, flexures=()), q, "p600", path=tmp_path / "r.html"), 300)
    for name in ("M1", "A5"):
        assert hue_share(flexed, colors[name]) > 0.002, f"{name} in {colors[name]} was not drawn"
        assert hue_share(rigid, colors[name]) < 0.0002
    assert hue_share(flexed, colors["A2"]) > 0.002 and colors["A2"] == SCALE[-1]


@pytest.mark.slow
@needs_browser
def test_browser_plays_the_trajectory(heavy: Arm, tmp_path: Path) -> None:
    """The arm swings evenly for 8 s; a busy computer may show a late moment later, but not never."""
    time = np.linspace(0.0, 8.0, 9)
    q = np.outer(time / 8.0, [2.0, 0.5, 0.0, 0.0, 0.8, 0.0]) - [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    path = Trajectory(heavy.joint_names, time, q, ("p200",) * 9, ("",) * 9)
    page = view(heavy, trajectory=path, path=tmp_path / "v.html")
    early = picture(page, 300)
    assert hue_share(early, FLEXED_PATH) > 0.0002
    # The player at the bottom is left out: its clock alone would make the pictures differ.
    moved = (np.mean(np.abs(early - picture(page, late))[:700].max(axis=-1) > 40.0) for late in (1500, 3000, 5000))
    assert any(share > 0.005 for share in moved)


@pytest.mark.slow
def test_the_worst_row_of_a_long_path_is_shown(tmp_path: Path, tarm: Arm) -> None:
    count = 1500
    q = np.zeros((count, 7))
    q[:, 2], q[:, 3], q[:, 4] = 0.1, 1.7, 1.7  # folded in
    q[733] = 0.0
    path = Trajectory(tarm.joint_names, np.arange(count) / 10.0, q, ("p600",) * count, ("",) * count)
    page = view(tarm, trajectory=path, path=tmp_path / "v.html").read_text()
    sag = np.linalg.norm(tarm.deflection(q[733], "p600").displacement[:3]) * 1e3
    assert f"Tip moves {sag:.4g}" in page and "at 73.3 s" in page and "of 1500 rows are drawn" in page


def facts_of(page: str) -> dict:
    found = re.search(r'id="page-facts">(.*?)</script>', page, re.S)
    assert found
    return json.loads(found[1])


def test_sliders_move_the_arm_as_it_moves(tarm: Arm) -> None:
    """Products of exponentials about the present pose give the rigid arm at any other; the table how it flexes."""
    q = tarm.position(M1=2.0, A3=0.4)
    found = tarm.deflection(q, "p600")
    arm = posable(tarm, found, 5.0)
    i, there = 3, 4
    asked = q.copy()
    slider = arm["sliders"][i]
    asked[i] = slider["samples"][there]
    other = tarm.deflection(asked, "p600")
    for k, name in enumerate(arm["links"]):
        pose = np.reshape(arm["rigid"][k], (4, 4)).T.copy()
        if i in arm["behind"][k]:
            point, turned = np.array(slider["point"]), pin.exp3(np.array(slider["axis"]) * (asked[i] - slider["here"]))
            pose[:3, 3] = point + turned @ (pose[:3, 3] - point)
            pose[:3, :3] = turned @ pose[:3, :3]
        np.testing.assert_allclose(pose, other.link_poses(0.0)[name], atol=1e-12)
        shift, turn = np.split(np.array(slider["flexed"][there][k]), 2)
        flexed = pose @ np.block([[pin.exp3(turn), shift[:, None]], [np.zeros(3), np.ones(1)]])
        np.testing.assert_allclose(flexed, other.link_poses(5.0)[name], atol=2e-7)  # seven decimals
    assert arm["links"][arm["tip"]] == tarm.robot.tip


def test_what_is_drawn_can_be_hidden(tarm: Arm) -> None:
    page = facts_of(view(tarm, payload="p600", wrenches=[Wrench("tool", [300, 0, 0], [0, 0, 0])]).html)
    assert {"rigid", "flexed", "payload", "axes", "joint axes", "forces"} <= set(page["groups"])
    carried = {"/".join(path): link for path, link, *_ in page["carried"]}
    assert carried["Nodes/forces/1 tool"] == "tool" == carried["Nodes/axes/tip"]
    assert [one["name"] for one in page["posable"]["sliders"]] == list(tarm.joint_names)


def test_joints_of_a_path_are_moved_from_its_worst_row(heavy: Arm, heavy_path: Trajectory) -> None:
    told: list[tuple[int, int]] = []
    page = facts_of(view(heavy, trajectory=heavy_path, progress=lambda done, total: told.append((done, total))).html)
    assert told[-1] == (len(heavy_path), len(heavy_path)) and len(told) == len(heavy_path)
    found = heavy.deflection(heavy_path.q, heavy_path.payload).displacement
    worst = int(np.linalg.norm(found[:, :3], axis=1).argmax())
    sliders = page["posable"]["sliders"]
    np.testing.assert_allclose([one["here"] for one in sliders], heavy_path.q[worst])
    assert page["posable"]["when"] == f" at {heavy_path.time[worst]:g} s"
    arm = dict(zip(page["posable"]["links"], page["posable"]["rigid"], strict=True))
    ghosts = {link: own for path, link, flexed, _, own in page["carried"] if path[1] == "rigid" and not flexed}
    assert ghosts and all(np.allclose(arm[link], own) for link, own in ghosts.items())


def test_a_payload_is_drawn_to_its_size() -> None:
    """An even box of sides a, b, c has moments m (b^2 + c^2) / 12, ...; without inertia it is a cube of stone."""
    a, b, c, mass = 0.2, 0.5, 0.9, 30.0
    moments = [mass * (b**2 + c**2) / 12, mass * (a**2 + c**2) / 12, mass * (a**2 + b**2) / 12]
    size, place = payload_box(Payload(mass, [0.1, 0, 0.2], [*moments, 0, 0, 0]))
    np.testing.assert_allclose(np.abs(place[:3, :3]) @ size, [a, b, c], rtol=1e-12)
    np.testing.assert_allclose(place[:3, 3], [0.1, 0, 0.2])
    np.testing.assert_allclose(payload_box(Payload(2500.0, [0, 0, 0]))[0], 1.0)


def test_meshes_that_are_not_drawn_are_said(tmp_path: Path, heavy: Arm) -> None:
    shutil.copytree(ROBOTS / "heavy_six", tmp_path / "arm")
    urdf = next((tmp_path / "arm").glob("*.urdf"))
    mesh = geometry('<mesh filename="package://parts/gone.stl"/>')
    urdf.write_text(re.sub(r'(<link name="[^"]*">)', rf"\1{mesh}", urdf.read_text(), count=1))
    arm = load_arm(tmp_path / "arm" / "arm.toml")
    assert "1 meshes of the URDF are not drawn" in view(arm).html
    assert "package://parts/gone.stl" in view(arm, meshes=True).html


@pytest.mark.slow
@needs_browser
def test_a_page_swings_its_modes(tarm: Arm, tmp_path: Path) -> None:
    """The tip goes the way that `modes` says, and where the address asks for a mode the picture moves."""
    q = tarm.position(A2=0.3)
    found, shown = tarm.modes(q, "p600"), tarm.deflection(q, "p600")
    moved = posable(tarm, shown, 1.0)
    assert [one["hz"] for one in moved["swings"]] == pytest.approx(found.frequencies[:6].tolist())
    rigid = shown.link_poses(0.0)[tarm.robot.tip]
    for one, shape in zip(moved["swings"], found.shapes, strict=False):
        tip = rigid[:3, :3] @ one["flexed"][moved["tip"]][:3]
        np.testing.assert_allclose(tip, 0.05 * tarm.robot.reach * shape[:3], rtol=0, atol=2e-3)
    if BROWSER is not None:
        page = view(tarm, q, "p600", path=tmp_path / "v.html")
        swinging = [picture(page, late, "#mode=1") for late in (1500, 1700, 1900)]
        assert max(np.abs(one - swinging[0]).max(axis=-1).mean() for one in swinging[1:]) > 0.3


def test_modes_are_drawn(armflex: Callable[..., subprocess.CompletedProcess], tmp_path: Path) -> None:
    said = armflex(
        "modes",
        ROBOTS / "tarm_like" / "arm.toml",
        "--payload",
        "p600",
        "--picture",
        "modes.png",
        "--json",
        "modes.json",
    )
    assert said.returncode == 0 and (tmp_path / "modes.png").stat().st_size > 20_000
    wrong = armflex("modes", ROBOTS / "tarm_like" / "arm.toml", "--picture", "modes.doc", "--json", "no.json")
    assert wrong.returncode == 2 and "expected a name that ends in" in wrong.stderr
    assert not (tmp_path / "no.json").exists()


@pytest.mark.slow
@needs_browser
def test_a_printed_page_has_the_picture(tarm: Arm, tmp_path: Path) -> None:
    """What a browser keeps of a canvas is empty when it prints."""
    assert sheets(view(tarm, payload="p600").html, tmp_path / "print") == 1
    parts = (tmp_path / "print" / "page.pdf").read_bytes().split(b" obj")
    drawn = [part.split(b"stream\n", 1)[1] for part in parts if b"/Subtype /Image" in part]
    assert any(np.frombuffer(zlib.decompressobj().decompress(one), np.uint8).std() > 10.0 for one in drawn)


@pytest.mark.slow
@needs_browser
def test_names_of_via_points_at_one_place_are_stacked(heavy: Arm, tmp_path: Path) -> None:
    q = np.outer(np.repeat([0.0, 0.2], 6), np.full(6, 0.3))
    names = tuple(f"weld_{i}" for i in range(12))
    path = Trajectory(heavy.joint_names, np.arange(12.0), q, ("none",) * 12, names)
    view(heavy, trajectory=path, path=tmp_path / "stacked.html")
    flags = [*QUIET, "window-size=1280,800", "virtual-time-budget=300", "dump-dom"]
    drawn = browse((tmp_path / "stacked.html").as_uri(), flags, tmp_path / "profile")
    form = re.compile(r"<span[^>]*visibility: visible; transform: translate\(([\d.]+)px, ([\d.]+)px\)[^>]*>weld_")
    places = np.array([match.groups() for match in form.finditer(drawn)], dtype=float)
    apart = np.abs(places[:, None] - places) + np.diag(np.full(len(places), 1e3))[:, :, None]
    assert len(places) == 12 and ((apart[:, :, 0] > 40.0) | (apart[:, :, 1] >= 18.0)).all()


@pytest.mark.slow
@needs_browser
def test_many_via_points_and_moved_joints_are_drawn(heavy: Arm, tarm: Arm, tmp_path: Path) -> None:
    """Two hundred labels leave each other room; a joint's slider moves both arms."""
    rows = np.linspace(0.0, 1.0, 200)
    q = np.outer(np.sin(9.0 * rows), np.full(6, 0.2))
    names = tuple(f"weld_{i}" for i in range(200))
    path = Trajectory(heavy.joint_names, np.arange(200.0), q, ("none",) * 200, names)
    page = view(heavy, trajectory=path, path=tmp_path / "many.html")
    assert len(facts_of(page.read_text())["labels"]) == 200
    assert hue_share(picture(page, 300), "#21918c") > 0.0 or picture(page, 300).std() > 10.0
    still = view(tarm, payload="p600", path=tmp_path / "still.html")
    for own, name in ((still, "A1"), (page, "J2")):  # of a path, too, whose animation then rests
        moved = tmp_path / f"moved {name}.html"
        moved.write_text(own.read_text().replace("location.hash.slice(1)", f'"{name}=0.9"'))
        assert np.abs(picture(own, 300) - picture(moved, 300)).max(axis=-1).mean() > 1.0
