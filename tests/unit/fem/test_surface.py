"""The surface that `armflex fem` writes beside a part, and the page that draws it bent."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from support.command_line import fine, run_here
from support.meshes import bar, write_bar

import armflex

pytest.importorskip("skfem")

from armflex.fem.part import Drawing, read_part

URDF = """<robot name="jib"><link name="base"/><link name="hook"/>
<link name="boom"><inertial><origin xyz="1 0 0"/><mass value="314"/>
<inertia ixx="5" iyy="120" izz="120" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="luff" type="revolute"><parent link="base"/><child link="boom"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1e6" velocity="1"/></joint>
<joint name="end" type="fixed"><parent link="boom"/><child link="hook"/><origin xyz="2 0 0"/></joint></robot>"""


def part(folder: Path, kind: str) -> Drawing:
    points, nodes = bar(kind, (4, 1, 1), (2.0, 0.1, 0.2))
    write_bar(folder / "bar.inp", kind, points - [0.0, 0.05, 0.1], nodes)
    fine(run_here(folder, "fem", "bar.inp", "--fixed", "ROOT", "--loaded", "TIP", "-o", "bar.toml"))
    return Drawing(folder / "bar.toml", read_part(folder / "bar.toml"), pin.SE3.Identity())


@pytest.mark.parametrize("kind", ["C3D10", "C3D20"])
def test_the_surface_is_closed_and_bends_from_the_held_end_to_the_loaded_one(tmp_path: Path, kind: str) -> None:
    drawing = part(tmp_path, kind)
    straight, triangles = drawing.bent(np.zeros(6)) or pytest.fail("nothing is drawn")
    a, b, c = np.moveaxis(straight[triangles], 1, 0)
    assert (a * np.cross(b, c)).sum() / 6.0 == pytest.approx(2.0 * 0.1 * 0.2)  # Gauss: faces look outward
    twist = np.array([0.0, 0.0, -2e-4, 0.0, 1.5e-4, 0.0])
    bent, _ = drawing.bent(twist) or pytest.fail("nothing is drawn")
    tip, root = straight[:, 0] > -1e-9, straight[:, 0] < -2.0 + 1e-9
    np.testing.assert_allclose(bent[tip], straight[tip], atol=1e-7)  # these axes move with the loaded end
    back = pin.exp6(pin.Motion(twist)).inverse()
    np.testing.assert_allclose(bent[root], straight[root] @ back.rotation.T + back.translation, atol=1e-7)
    middle = np.abs(straight[:, 0] + 1.0) < 1e-9  # of a cantilever: 5/16 of the end's sag
    sag = 2.0 * 1.5e-4 * 2.0 / 3.0
    there = (bent[middle] @ back.inverse().rotation.T + back.inverse().translation - straight[middle])[:, 2].mean()
    assert there == pytest.approx(-5.0 / 16.0 * sag, rel=0.03)


def test_the_page_draws_the_mesh_of_a_link(tmp_path: Path) -> None:
    part(tmp_path, "C3D20")
    (tmp_path / "r.urdf").write_text(URDF)
    head = '[robot]\nurdf = "r.urdf"\ntip = "hook"\ngravity = [0.0, 0.0, -9.81]\n'
    (tmp_path / "arm.toml").write_text(head + '[link.boom]\nfile = "bar.toml"\n')
    arm = armflex.load_arm(tmp_path / "arm.toml")

    mesh = drawn(arm, "flexed/boom")
    assert len(mesh) == 84 + 50 * int.from_bytes(mesh[80:84], "little")
    (tmp_path / "bar.surface.safetensors").unlink()
    assert drawn(arm, "flexed/boom") == b""  # a rod stands for it


def test_the_flexure_of_a_link_stands_along_the_chain(tmp_path: Path) -> None:
    part(tmp_path, "C3D20")
    (tmp_path / "r.urdf").write_text(URDF)
    head = '[robot]\nurdf = "r.urdf"\ntip = "hook"\ngravity = [0.0, 0.0, -9.81]\n'
    own = '[flexure.foot]\njoint = "luff"\ncompliance = [1e-9, 1e-9, 1e-9, 1e-8, 1e-8, 1e-8]\n'
    (tmp_path / "arm.toml").write_text(f'{head}[link.boom]\nfile = "bar.toml"\n{own}')
    assert armflex.load_arm(tmp_path / "arm.toml").flexure_names == ("foot", "boom")


def drawn(arm: armflex.Arm, name: str) -> bytes:
    from armflex.show.view.arm_scene import Motion, arm_scene

    scene = arm_scene(arm, Motion(np.zeros(1), (arm.deflection(arm.position()),), 0))
    return b"".join(one.data for node in scene.nodes if node.name == name for one in node.shapes)


def test_the_page_draws_the_mesh_of_a_joint(tmp_path: Path) -> None:
    """Its loaded interface is at `node`, turned by `rpy`: the bar ends there and begins 2 m below."""
    part(tmp_path, "C3D10")
    (tmp_path / "r.urdf").write_text(URDF)
    head = '[robot]\nurdf = "r.urdf"\ntip = "hook"\ngravity = [0.0, 0.0, -9.81]\n'
    turned = f"node = [0.0, 0.0, 0.5]\nrpy = [0.0, {-np.pi / 2.0}, 0.0]\n"
    (tmp_path / "arm.toml").write_text(head + '[flexure.boom]\njoint = "luff"\nfile = "bar.toml"\n' + turned)
    mesh = drawn(armflex.load_arm(tmp_path / "arm.toml"), "rigid/part:boom")
    facets = np.frombuffer(mesh[84:], np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")]))
    corners = facets["corners"].reshape(-1, 3)
    np.testing.assert_allclose(corners.min(axis=0), [-0.1, -0.05, -1.5], atol=1e-6)
    np.testing.assert_allclose(corners.max(axis=0), [0.1, 0.05, 0.5], atol=1e-6)
