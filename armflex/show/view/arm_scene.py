"""From an arm and its deflection to a picture: ghost, flexed arm, flexures, payload, paths and via-points."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array, number
from armflex.mechanics.deflection import Deflection
from armflex.robot.elements import Link, Visual
from armflex.robot.tree import joints_by_parent
from armflex.show.view.meshes import read_mesh
from armflex.show.view.scene_3d import LegendRow, Marker, Node, Polyline, Scene, Shape, scene_points
from armflex.tasks.check import CheckReport
from armflex.trajectory import Trajectory

GHOST, STEEL, LOAD = "#9fb4c8", "#c9ced6", "#7a4a21"
RIGID_PATH, FLEXED_PATH = "#6c8ebf", "#e4572e"
VERDICTS = {"ok": "#2e9e4f", "uncertain": "#f0a202", "fail": "#d7263d"}
MARKER_SIZES = {"ok": 1.0, "uncertain": 1.2, "fail": 1.4}
SCALE = ("#440154", "#3b528b", "#21918c", "#5ec962", "#fde725")
"""Five stops of the viridis colour map: least to most contribution."""

NICE = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
MAX_FRAMES = 240
PLAY_SECONDS = 14.0


@dataclass(frozen=True)
class Motion:
    """Configurations to be shown in turn, which of them the legend speaks of, and how many rows there were."""

    times: Array
    frames: tuple[Deflection, ...]
    worst: int
    rows: int = 1


def arm_scene(
    arm: Arm,
    motion: Motion,
    trajectory: Trajectory | None = None,
    report: CheckReport | None = None,
    magnification: float | None = None,
    meshes: bool = False,
) -> Scene:
    """Return the picture of an arm.

    Args:
        arm: The arm.
        motion: What it does.
        trajectory: The commanded path, for its via-points and payload names.
        report: Verdicts that colour the via-points.
        magnification: Factor on all deflections shown; a round one is chosen when not given.
        meshes: Draw the URDF's mesh files, where they lie beside it.
    """
    factor = nice_magnification(arm, motion) if magnification is None else magnification
    shown = motion.frames[motion.worst]
    colors = contribution_colors(shown)
    shapes = link_shapes(arm, meshes, _travels(arm, motion))
    nodes = [
        *_link_nodes(arm, motion, shapes, 0.0, None),
        *_link_nodes(arm, motion, shapes, factor, colors),
        *_flexure_nodes(arm, motion, factor, colors),
        *_payload_nodes(arm, motion, factor),
    ]
    scene = Scene(
        title=arm.robot.urdf.name,
        subtitle=_subtitle(arm, shown, motion, factor),
        nodes=tuple(nodes),
        polylines=tuple(_paths(arm, motion, factor)),
        markers=tuple(_markers(arm, trajectory, report)),
        legend_title="Share of each flexure in the tip's displacement" if arm.flexures else "",
        legend=tuple(_legend(shown, colors, trajectory, report, factor)),
        notes=tuple(_notes(arm, shown, motion, factor)),
        times=motion.times if len(motion.times) > 1 else None,
        speed=_speed(motion.times),
    )
    return replace(scene, floor_z=float(scene_points(scene)[:, 2].min()) - 0.02 * arm.robot.reach)


def nice_magnification(arm: Arm, motion: Motion) -> float:
    """Return the largest round factor that keeps the shown sag below an eighth of the reach."""
    most = max(float(np.linalg.norm(frame.displacement[:3])) for frame in motion.frames)
    allowed = [factor for factor in NICE if factor * most <= 0.125 * max(arm.robot.reach, 1e-3)]
    return float(max(allowed, default=1)) if most > 1e-9 else 1.0


def contribution_colors(found: Deflection) -> dict[str, str]:
    """Return a colour for each flexure by its share along the tip's displacement."""
    shares = contribution_shares(found)
    most = max((abs(share) for share in shares.values()), default=0.0) or 1.0
    return {name: color_at(abs(share) / most) for name, share in shares.items()}


def contribution_shares(found: Deflection) -> dict[str, float]:
    """Return each flexure's shift of the tip along the tip's displacement [m]."""
    return dict(zip(found.names.flexures, found.shares().tolist(), strict=True))


def color_at(fraction: float) -> str:
    """Return the scale's colour at a fraction from 0 to 1."""
    stops = np.array([[int(stop[i : i + 2], 16) for i in (1, 3, 5)] for stop in SCALE], dtype=float)
    channels = [np.interp(fraction, np.linspace(0.0, 1.0, len(SCALE)), stops[:, i]) for i in range(3)]
    return "#" + "".join(f"{round(channel):02x}" for channel in channels)


def _travels(arm: Arm, motion: Motion) -> dict[str, Array]:
    """Return, for each link behind a slide, the way back to where it slides out of, at its longest [m]."""
    furthest = np.abs([frame.q for frame in motion.frames]).max(axis=0)
    pairs = zip(arm.robot.moving, furthest, strict=True)
    return {joint.child: -joint.axis * far for joint, far in pairs if joint.kind == "prismatic"}


def link_shapes(arm: Arm, meshes: bool, travels: dict[str, Array]) -> dict[str, tuple[Shape, ...]]:
    """Return what to draw for each link: its primitives, its meshes on request, else rods to its joints.

    A link that slides gets a rod back along its slide, too, so that the arm does not fall apart.
    """
    drawn = {}
    children = joints_by_parent(arm.robot.urdf)
    thick = 0.025 * max(arm.robot.reach, 0.1)
    for name, link in arm.robot.urdf.links.items():
        shapes = [_shape(arm, visual, meshes) for visual in link.visuals]
        kept = tuple(shape for shape in shapes if shape is not None)
        ends = [*(joint.origin for joint in children[name]), *([travels[name]] if name in travels else [])]
        drawn[name] = kept or tuple(_rods(link, ends, thick))
    return drawn


def _shape(arm: Arm, visual: Visual, meshes: bool) -> Shape | None:
    color = visual.color or STEEL
    if visual.kind != "mesh" and min(visual.size) <= 0.0:
        return None
    if visual.kind != "mesh":
        return Shape(visual.kind, np.array(visual.size), visual.pose, color)
    found = read_mesh(arm.robot.urdf.path, visual.mesh or "") if meshes else None
    if found is None:
        return None
    return Shape("mesh", np.array(visual.size), visual.pose, color, data=found[0], data_format=found[1])


def _rods(link: Link, ends: list[Array], radius: float) -> Iterator[Shape]:
    for end in ends:
        length = float(np.linalg.norm(end))
        if length > 2.0 * radius:
            yield Shape("capsule", np.array([radius, length]), _along(end), STEEL)


def _along(end: Array) -> Array:
    """Return the pose of a shape whose z axis runs from the origin to `end`, centred halfway."""
    z = end / np.linalg.norm(end)
    other = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(other, z)
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    pose[:3, 3] = 0.5 * end
    return pose


def _link_nodes(
    arm: Arm, motion: Motion, shapes: dict[str, tuple[Shape, ...]], factor: float, colors: dict[str, str] | None
) -> Iterator[Node]:
    poses = [frame.link_poses(factor) for frame in motion.frames]
    driven = _flexure_of_link(arm) if colors is not None else {}
    for link in poses[0]:
        if not shapes[link] or (colors is None and not _moves(arm, link)):
            continue
        color = colors.get(driven.get(link, "")) if colors is not None else GHOST
        painted = tuple(_paint(shape, color, 1.0 if colors is not None else 0.22) for shape in shapes[link])
        group = "rigid" if colors is None else "flexed"
        yield _node(f"{group}/{_leaf(link)}", [pose[link] for pose in poses], painted, motion)


def _leaf(name: str) -> str:
    """Return a name without '/', which would make it a group of the viewer's."""
    return name.replace("/", "\N{DIVISION SLASH}")


def _paint(shape: Shape, color: str | None, opacity: float) -> Shape:
    return Shape(
        shape.kind, shape.size, shape.T_node_shape, color or shape.color, opacity, shape.data, shape.data_format
    )


def _node(name: str, poses: list[Array], shapes: tuple[Shape, ...], motion: Motion) -> Node:
    moving = np.array(poses) if len(motion.frames) > 1 else None
    return Node(name, poses[motion.worst], shapes, moving)


def _flexure_of_link(arm: Arm) -> dict[str, str]:
    """Return the flexure that each link hangs on most directly."""
    owner: dict[str, str] = {}
    at_joint = {flexure.joint: flexure.name for flexure in arm.flexures}
    children = joints_by_parent(arm.robot.urdf)
    stack = [(arm.robot.base, "")]
    while stack:
        link, flexure = stack.pop()
        owner[link] = flexure
        stack.extend((joint.child, at_joint.get(joint.name, flexure)) for joint in children[link])
    return owner


def _moves(arm: Arm, link: str) -> bool:
    return bool(_flexure_of_link(arm).get(link))


def _flexure_nodes(arm: Arm, motion: Motion, factor: float, colors: dict[str, str]) -> Iterator[Node]:
    child = {joint.name: joint.child for joint in arm.robot.chain}
    poses = [frame.link_poses(factor) for frame in motion.frames]
    radius = 0.022 * max(arm.robot.reach, 0.1)
    for flexure in arm.flexures:
        link = child[flexure.joint] if flexure.joint else arm.robot.base
        ball = Shape("sphere", np.array([radius]), color=colors[flexure.name])
        yield _node(f"flexure/{_leaf(flexure.name)}", [pose[link] for pose in poses], (ball,), motion)


def _payload_nodes(arm: Arm, motion: Motion, factor: float) -> Iterator[Node]:
    """Yield the heaviest payload at its place, out of sight while it is not carried."""
    carried = [frame.payload for frame in motion.frames]
    heaviest = max(carried, key=lambda payload: payload.mass)
    if not heaviest.mass:
        return
    side = float(np.clip((heaviest.mass / 2500.0) ** (1.0 / 3.0), 0.02 * arm.robot.reach, 0.2 * arm.robot.reach))
    place = np.eye(4)
    place[:3, 3] = heaviest.com
    box = Shape("box", np.full(3, side), place, LOAD)
    tips = [frame.link_poses(factor)[arm.robot.tip] for frame in motion.frames]
    last = next(i for i in range(len(carried) - 1, -1, -1) if carried[i].mass)
    first = next(i for i, payload in enumerate(carried) if payload.mass)
    poses = [tips[min(max(i, first), last)] for i in range(len(tips))]
    yield _node("payload", poses, (box,), motion)


def _paths(arm: Arm, motion: Motion, factor: float) -> Iterator[Polyline]:
    radius = 0.004 * max(arm.robot.reach, 0.1)
    tip = arm.robot.tip
    rigid = np.array([frame.link_poses(0.0)[tip][:3, 3] for frame in motion.frames])
    flexed = np.array([frame.link_poses(factor)[tip][:3, 3] for frame in motion.frames])
    if len(motion.frames) > 1 and np.ptp(rigid, axis=0).max() > 1e-6:
        yield Polyline("rigid path", rigid, RIGID_PATH, radius)
        yield Polyline("flexed path", flexed, FLEXED_PATH, radius)
    elif np.linalg.norm(flexed[0] - rigid[0]) > 1e-6:
        yield Polyline("displacement", np.array([rigid[0], flexed[0]]), FLEXED_PATH, radius)


def _markers(arm: Arm, trajectory: Trajectory | None, report: CheckReport | None) -> Iterator[Marker]:
    if trajectory is None:
        return
    verdicts = {point.time: point.verdict for point in report.via_points} if report else {}
    for i, name in enumerate(trajectory.via):
        if name:
            verdict = verdicts.get(float(trajectory.time[i]), "")
            position = arm.rigid_pose(trajectory.q[i], enforce_limits=False).translation
            # A worse verdict is a larger ball: of two via-points at one place the worse one is seen.
            radius = 0.012 * arm.robot.reach * MARKER_SIZES.get(verdict, 1.0)
            yield Marker(f"{i} {name}", position, VERDICTS.get(verdict, RIGID_PATH), radius, name)


def _legend(
    shown: Deflection,
    colors: dict[str, str],
    trajectory: Trajectory | None,
    report: CheckReport | None,
    factor: float,
) -> Iterator[LegendRow]:
    for name, share in contribution_shares(shown).items():
        yield LegendRow(colors[name], name, f"{number(share * 1e3, 3)} mm")
    if colors:
        yield LegendRow(GHOST, "rigid arm", opacity=0.4)
    if trajectory is not None:
        yield LegendRow(RIGID_PATH, "tip path, rigid")
    if colors:
        yield LegendRow(FLEXED_PATH, f"tip {'path' if trajectory is not None else 'shift'}, flexed × {factor:g}")
    if shown.payload.mass:
        yield LegendRow(LOAD, "payload", f"{shown.payload.mass:g} kg")
    if report is not None:
        for verdict, color in VERDICTS.items():
            count = sum(point.verdict == verdict for point in report.via_points)
            yield LegendRow(color, f"via-point: {verdict}", str(count))


def _subtitle(arm: Arm, shown: Deflection, motion: Motion, factor: float) -> str:
    if not arm.flexures:
        return "No flexure is declared: this arm is rigid."
    moved, turned = (float(np.linalg.norm(part)) * 1e3 for part in (shown.displacement[:3], shown.displacement[3:]))
    when = f" at {motion.times[motion.worst]:g} s" if len(motion.frames) > 1 else ""
    doubt = shown.sigma()
    sigma = "" if doubt is None else f" ± {number(doubt * 1e3, 2)}"
    return f"Tip moves {number(moved)}{sigma} mm and turns {number(turned, 3)} mrad{when}. Shown × {factor:g}."


def _notes(arm: Arm, shown: Deflection, motion: Motion, factor: float) -> Iterator[str]:
    yield f"Base {arm.robot.base}, tip {arm.robot.tip}; grid lines are 0.5 m apart."
    if arm.flexures:
        left = float(np.linalg.norm(shown.remainder[:3]) * 1e3)
        yield f"Deflections are drawn {factor:g} times as large as they are; the rigid arm is to scale."
        yield f"Shares are first order; together they miss the displacement by {number(left, 2)} mm."
        if shown.corrected.any():
            size = float(np.linalg.norm(shown.corrected[:3]) * 1e3)
            yield f"Beside them the calibrated geometry moves the tip by {number(size, 3)} mm."
    if len(motion.frames) < motion.rows:
        yield f"{len(motion.frames)} of {motion.rows} rows are drawn; the figures are of the worst of all rows."
    if shown.covariance is not None:
        yield "± is one standard uncertainty."


def _speed(times: Array) -> float:
    if len(times) < 2:
        return 1.0
    return float(max(1.0, round((times[-1] - times[0]) / PLAY_SECONDS)))
