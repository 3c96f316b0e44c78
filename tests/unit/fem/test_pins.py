"""Pins on links that bend: one between a link's ends is flagged, and a link split there sags as a beam does."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support.command_line import fine, run_here
from support.meshes import bar, write_bar

import armflex
from armflex.errors import ArmFileError

pytest.importorskip("skfem")

SPAN, OVERHANG, WIDE, HIGH = 0.8, 1.2, 0.05, 0.06
HEAD = """[robot]
urdf = "r.urdf"
tip = "hook"
base = "base"
gravity = [0.0, 0.0, -9.81]
[payload.p]
mass = 200.0
com = [0.0, 0.0, 0.0]
[joint.luff]
passive = true
[cylinder.lift]
link = "base"
at = [0.8, 0.0, -1.0]
lower = 0.5
upper = 1.5
"""
END = '<joint name="end" type="fixed"><parent link="{}"/><child link="hook"/><origin xyz="{} 0 0"/></joint></robot>'


def body(name: str, length: float) -> str:
    mass = 7850.0 * length * WIDE * HIGH
    centre = f'<origin xyz="{length / 2} 0 0"/><mass value="{mass}"/>'
    slender = mass * length**2 / 12.0
    inertia = f'<inertia ixx="1" iyy="{slender}" izz="{slender}" ixy="0" ixz="0" iyz="0"/>'
    return f'<link name="{name}"><inertial>{centre}{inertia}</inertial></link>'


def urdf(*links: tuple[str, float]) -> str:
    text = '<robot name="jib"><link name="base"/><link name="hook"/>' + "".join(body(*link) for link in links)
    text += f'<joint name="luff" type="revolute"><parent link="base"/><child link="{links[0][0]}"/><axis xyz="0 1 0"/>'
    text += '<limit lower="-1" upper="1" effort="1e6" velocity="1"/></joint>'
    for (inner, length), (outer, _) in pairwise(links):
        text += f'<joint name="{outer}_on" type="fixed"><parent link="{inner}"/><child link="{outer}"/>'
        text += f'<origin xyz="{length} 0 0"/></joint>'
    return text + END.format(*links[-1])


def mesh(folder: Path, name: str, length: float) -> None:
    points, nodes = bar("C3D20", (16, 1, 1), (length, WIDE, HIGH))
    text = write_bar(folder / f"{name}.inp", "C3D20", points - [0.0, WIDE / 2.0, HIGH / 2.0], nodes).read_text()
    middle = np.flatnonzero(np.abs(points[:, 0] - 0.5 * length) < 1e-9) + 1
    held = "\n".join(["*NSET, NSET=PIN", *map(str, middle.tolist()), "*MATERIAL"])
    (folder / f"{name}.inp").write_text(text.replace("*MATERIAL", held, 1))
    fine(run_here(folder, "fem", f"{name}.inp", "--fixed", "ROOT", "--loaded", "TIP", "-o", f"{name}.toml"))


def test_a_link_split_at_its_pin_sags_as_a_beam_that_overhangs_its_support(tmp_path: Path) -> None:
    mesh(tmp_path, "inner", SPAN)
    mesh(tmp_path, "outer", OVERHANG)
    (tmp_path / "r.urdf").write_text(urdf(("inner", SPAN), ("outer", OVERHANG)))
    pin = 'to = "outer"\nat_to = [0.0, 0.0, 0.0]\n'
    (tmp_path / "arm.toml").write_text(
        HEAD + pin + '[link.inner]\nfile = "inner.toml"\n[link.outer]\nfile = "outer.toml"\n'
    )
    arm = armflex.load_arm(tmp_path / "arm.toml")
    assert "pin_off_root" not in [flag.code for flag in arm.flags]
    q = arm.position(lift=1.0)
    sag = arm.deflection(q).displacement[2] - arm.deflection(q, "p").displacement[2]
    # Timoshenko's span between root and pin, and what overhangs it, under a load at its end.
    young, shear, area, second = 2.1e11, 2.1e11 / 2.6, WIDE * HIGH, WIDE * HIGH**3 / 12.0
    bent = OVERHANG**2 * (SPAN + OVERHANG) / (3.0 * young * second)
    sheared = (OVERHANG + OVERHANG**2 / SPAN) / (5.0 / 6.0 * shear * area)
    assert sag == pytest.approx(200.0 * 9.81 * (bent + sheared), rel=0.02)


def test_a_pin_between_the_ends_of_a_link_that_bends_is_flagged(tmp_path: Path) -> None:
    mesh(tmp_path, "boom", SPAN + OVERHANG)
    (tmp_path / "r.urdf").write_text(urdf(("boom", SPAN + OVERHANG)))
    head = HEAD + 'to = "boom"\nat_to = [{}, 0.0, -0.1]\n[link.boom]\nfile = "boom.toml"\n'
    (tmp_path / "arm.toml").write_text(head.format(SPAN))
    with pytest.warns(UserWarning, match="pin_off_root"):
        arm = armflex.load_arm(tmp_path / "arm.toml")
    assert [flag.text for flag in arm.flags if flag.code == "pin_off_root"] == [
        "the pin of 'lift' is 0.8 m from the root of link 'boom', 40% along it, and the link bends behind its pins "
        "alone: what bends before this one is taken as unheld, and the sag is wrong; split link 'boom' and its mesh "
        "in two at the pin"
    ]
    assert "pin_off_root: the pin of 'lift'" in run_here(tmp_path, "deflect", "arm.toml", "--q", "lift=1").stderr
    (tmp_path / "arm.toml").write_text(head.format(0.01))
    assert "pin_off_root" not in [flag.code for flag in armflex.load_arm(tmp_path / "arm.toml").flags]


def test_a_part_with_an_interface_at_its_pin_is_refused_with_the_remedy(tmp_path: Path) -> None:
    mesh(tmp_path, "boom", SPAN + OVERHANG)
    fine(run_here(tmp_path, "fem", "boom.inp", "--fixed", "ROOT", "--loaded", "TIP,PIN", "-o", "boom.toml"))
    (tmp_path / "r.urdf").write_text(urdf(("boom", SPAN + OVERHANG)))
    (tmp_path / "arm.toml").write_text(
        HEAD + f'to = "boom"\nat_to = [{SPAN}, 0.0, 0.0]\n[link.boom]\nfile = "boom.toml"\n'
    )
    with pytest.raises(ArmFileError, match="split the link and its mesh in two there"):
        armflex.load_arm(tmp_path / "arm.toml")


def test_a_link_whose_mesh_distributes_its_inertia_is_no_point(tmp_path: Path) -> None:
    mesh(tmp_path, "boom", SPAN + OVERHANG)
    text = urdf(("boom", SPAN + OVERHANG))
    (tmp_path / "r.urdf").write_text(text.replace('<link name="hook"/>', body("hook", 0.1)))
    head = HEAD + 'to = "boom"\nat_to = [0.8, 0.0, 0.0]\n'
    moved = {"v": np.zeros(1), "a": np.ones(1)}
    (tmp_path / "arm.toml").write_text(head + '[link.boom]\nfile = "boom.toml"\n')
    arm = armflex.load_arm(tmp_path / "arm.toml")
    q = arm.position(lift=1.0)
    flags = (*arm.modes(q).flags, *arm.deflection(q, **moved).flags)
    assert not [flag for flag in flags if flag.code in ("no_inertia", "point_masses")]


def test_a_mesh_that_ends_short_of_its_joint_says_by_how_much(tmp_path: Path) -> None:
    mesh(tmp_path, "boom", SPAN + OVERHANG)
    (tmp_path / "arm.toml").write_text(
        HEAD + 'to = "boom"\nat_to = [0.0, 0.0, 0.0]\n[link.boom]\nfile = "boom.toml"\n'.replace("0.0]", "-0.1]", 1)
    )
    for gap, said in ((0.0005, []), (0.05, ["50 mm"])):
        (tmp_path / "r.urdf").write_text(
            urdf(("boom", SPAN + OVERHANG)).replace('<origin xyz="2.0 0 0"/>', f'<origin xyz="{2.0 + gap} 0 0"/>')
        )
        arm = armflex.load_arm(tmp_path / "arm.toml")
        assert [flag.text for flag in arm.flags if flag.code == "mesh_gap"] == [
            f"the mesh of link 'boom' ends {gap} from joint 'end', and the gap is taken as rigid: "
            "move the mesh with xyz and rpy, or mesh the link to the joint"
            for gap in said
        ]
