"""`view`: one self-contained page of an arm, at one configuration or along a trajectory.

The picture has a ghost of the rigid arm, the flexed arm, its flexures, payload, paths and via-points.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from html import escape
from pathlib import Path
from typing import Any, TypedDict, Unpack, cast, overload

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from armflex.arguments import checked_kinds
from armflex.arm import Arm
from armflex.conventions import Array, number
from armflex.errors import ArmflexError, InputError, listing, naming
from armflex.laws.effects.in_arm import settled_covariates
from armflex.measured.table import Tabular
from armflex.mechanics.deflection import Deflection
from armflex.mechanics.loaded import Payload
from armflex.mechanics.modes import modes_of
from armflex.progress import Progress
from armflex.robot.urdf import Joint
from armflex.rows.wrench import Wrench
from armflex.show.view.scene_3d import (
    LegendRow,
    Marker,
    Node,
    Polyline,
    Scene,
    Shape,
    ShapeKind,
    read_mesh,
    scene_points,
)
from armflex.storage.whole_file import write_whole
from armflex.tasks.check import CheckReport
from armflex.trajectory import Trajectory, as_trajectory

GHOST, STEEL, LOAD = "#9fb4c8", "#c9ced6", "#7a4a21"
PIN, TIE, SPRING = "#3b4252", "#b08d3c", "#5f8f5a"
RIGID_PATH, FLEXED_PATH = "#6c8ebf", "#e4572e"
VERDICTS = {"ok": "#2e9e4f", "uncertain": "#f0a202", "fail": "#d7263d"}
MARKER_SIZES = {"ok": 1.0, "uncertain": 1.2, "fail": 1.4}
SCALE = ("#440154", "#3b528b", "#21918c", "#5ec962", "#fde725")
"""Five stops of the viridis colour map: least to most contribution."""

AXES = ("#d62728", "#2ca02c", "#1f5fd0")
GRAVITY, FORCE = "#5a6776", "#c2185b"
STONE = 2500.0
"""Density that a payload is drawn with where its inertia does not determine its size [kg/m^3]."""

SLIDERS = 2.0 * np.pi
"""Largest position of a slider [rad or m]: of a joint without limits a turn either way."""

SWINGS, SWUNG, SMALL = 6, 0.05, 1e-5
"""Modes that a page can show, how far the tip then swings as a share of the reach, and the step that shapes are of."""

DIGITS = 7
"""Decimals of magnified shifts and turns on a page."""

TINY = 1e-6
"""Length [mm] and turn [mrad] that a page shows as 0: nobody looks at less than a nanometre."""

MAX_FRAMES = 240
LARGEST_MAGNIFICATION = 1e6

Poses = Sequence[Mapping[str, Array]]
"""(4, 4) pose of every link by name, for each frame of a motion."""


@dataclass(frozen=True)
class Motion:
    """Configurations to be shown in turn, which of them the legend speaks of, and how many rows there were."""

    times: Array
    frames: tuple[Deflection, ...]
    worst: int
    rows: int = 1


@dataclass(frozen=True, repr=False)
class Page:
    """A page that opens in any browser, and shows itself in a notebook; `html` is all of it."""

    html: str

    def __repr__(self) -> str:
        """One line: a page is too much to print."""
        return f"<Page: {len(self.html) / 1e6:.1f} MB; write(path) makes a file of it>"

    def _repr_html_(self) -> str:
        return f'<iframe srcdoc="{escape(self.html)}" style="width:100%;height:520px;border:0"></iframe>'

    @checked_kinds
    def write(self, path: str | Path) -> Path:
        """Write the page, whole or not at all."""
        return write_whole(Path(path), self.html.encode())


class ViewOptions(TypedDict, total=False):
    """What `view` may be given by name beside the file."""

    trajectory: Trajectory | Tabular | None
    report: CheckReport | None
    magnification: float | None
    meshes: bool
    covariates: Mapping[str, float] | None
    wrenches: Sequence[Wrench]
    progress: Progress | None


@overload
def view(
    arm: Arm, q: ArrayLike | None = ..., payload: str | Payload | None = ..., **options: Unpack[ViewOptions]
) -> Page: ...
@overload
def view(
    arm: Arm,
    q: ArrayLike | None = ...,
    payload: str | Payload | None = ...,
    *,
    path: str | Path,
    **options: Unpack[ViewOptions],
) -> Path: ...
@checked_kinds
def view(
    arm: Arm,
    q: ArrayLike | None = None,
    payload: str | Payload | None = None,
    *,
    trajectory: Trajectory | Tabular | None = None,
    report: CheckReport | None = None,
    magnification: float | None = None,
    meshes: bool = False,
    covariates: Mapping[str, float] | None = None,
    wrenches: Sequence[Wrench] = (),
    path: str | Path | None = None,
    progress: Progress | None = None,
) -> Path | Page:
    """Return a page of the arm, which shows itself in a notebook, or write it as a file for any browser.

    It needs no network, no server and no display.

    Args:
        arm: The arm.
        q: (nq,) joint positions [rad or m]; as `Arm.position` has them when neither q nor a trajectory is given.
        payload: What it carries at q.
        trajectory: Shown as an animation instead of one configuration.
        report: Result of `check` on the trajectory; colours the via-points.
        magnification: Factor on the deflections shown; a round one is chosen, and stated, when not given.
        meshes: Draw the URDF's meshes where they lie beside it.
        covariates: What the arm's effects depend on, at q or the same in every row of the trajectory.
        wrenches: Loads from outside at q; a trajectory has its own.
        path: The HTML file to write, which is then returned; without it the page is.
        progress: Called with (rows of the trajectory done, rows in all).

    Raises:
        InputError: Both q and a trajectory are given, one cannot be used, or no effect depends on a covariate.
    """
    trajectory = None if trajectory is None else as_trajectory(trajectory, arm)
    from armflex.show.view.meshcat_page import render_page  # meshcat is imported only when something is drawn

    if trajectory is not None and (q is not None or wrenches):
        what = "wrenches" if q is None else "q"
        raise InputError(f"view takes {what} or a trajectory, not both")
    if magnification is not None and not 0.0 < magnification <= LARGEST_MAGNIFICATION:
        raise InputError(f"magnification must be positive and at most {LARGEST_MAGNIFICATION:g}, got {magnification}")
    magnification = None if magnification is None else 1.0 * magnification
    columns = covariates or {}
    if trajectory is None:
        here = arm.position() if q is None else arm.checked(q, "q")
        asked = {"covariates": settled_covariates(arm, columns), "wrenches": wrenches}
        motion = Motion(np.zeros(1), (arm.deflection(here, payload, **asked),), 0, 1)
    else:
        trajectory = trajectory.with_constants(arm, columns).prepared(arm)
        motion = motion_along(arm, trajectory, progress)
    page = Page(render_page(arm_scene(arm, motion, trajectory, report, magnification, meshes)))
    return page if path is None else page.write(path)


def motion_along(arm: Arm, trajectory: Trajectory, progress: Progress | None = None) -> Motion:
    """Return every row, or every second, third ... of a long trajectory, its via-points and worst row kept.

    `progress` is called with (rows done, rows in all).
    """

    def frame(i: int) -> Deflection:  # asked twice rather than kept: thousands of rows are many megabytes
        with naming(trajectory.where(i)):
            return arm.deflection(trajectory.q[i], trajectory.payload[i], **trajectory.asked(i))

    rows = range(len(trajectory))
    moved = np.zeros(len(rows))
    for i in rows:
        moved[i] = np.linalg.norm(frame(i).displacement[:3])
        if progress:
            progress(i + 1, len(rows))
    worst = int(np.argmax(moved))
    stride = -(-len(rows) // MAX_FRAMES)
    kept = [i for i in rows if i % stride == 0 or trajectory.via[i] or i in (worst, len(rows) - 1)]
    return Motion(trajectory.time[kept], tuple(frame(i) for i in kept), kept.index(worst), len(rows))


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
    times = motion.times
    rigid, flexed = ([frame.link_poses(scale) for frame in motion.frames] for scale in (0.0, factor))
    shapes, missing = _link_shapes(arm, rigid, meshes)
    tree = not arm.robot.linkage
    parts = list(_parts(arm, shown, factor, rigid, flexed, colors))
    shapes |= dict.fromkeys((part.name.rpartition("/")[2] for part in parts), ())
    scene = Scene(
        title=arm.robot.urdf.name,
        subtitle=_subtitle(arm, shown, motion, factor),
        nodes=(
            *_nodes(arm, motion, rigid, flexed, colors, shapes),
            *_ties(arm, flexed),
            *parts,
            *_triads(arm, flexed),
            *_arrows(arm, motion, flexed),
        ),
        polylines=tuple(_paths(arm, rigid, flexed)),
        markers=tuple(_markers(arm, trajectory, report)),
        legend_title="Share of each flexure in the tip's displacement" if arm.flexures else "",
        legend=tuple(_legend(shown, colors, trajectory, report, factor)),
        table_title=f"Via-points {f'against {report.asked}' if report else '(no tolerance was given)'}",
        table=_table(motion, trajectory, report),
        notes=(*_notes(arm, shown, motion, factor), *missing),
        times=times if len(times) > 1 else None,
        speed=float(max(1.0, round((times[-1] - times[0]) / 14.0))),
        # A slider moves what its joint carries; with loops other joints move as well.
        posable=posable(arm, shown, factor, _when(motion)) if tree else None,
        shown=motion.worst,
    )
    scene = _standing(scene, arm.robot.mount)
    return replace(scene, floor_z=float(scene_points(scene)[:, 2].min()) - 0.02 * arm.robot.reach)


def _standing(scene: Scene, mount: Array) -> Scene:
    """Return a scene in base axes as it stands in a level world, the base turned by a (3, 3) rotation."""
    if np.array_equal(mount, np.eye(3)):
        return scene
    turned = np.eye(4)
    turned[:3, :3] = mount
    nodes = tuple(replace(node, poses=turned @ node.poses) for node in scene.nodes)
    lines = tuple(replace(line, points=line.points @ mount.T) for line in scene.polylines)
    markers = tuple(replace(marker, position=mount @ marker.position) for marker in scene.markers)
    return replace(scene, nodes=nodes, polylines=lines, markers=markers)


def posable(arm: Arm, shown: Deflection, factor: float, when: str = "") -> dict[str, Any]:
    """Return what a page needs to move the arm's joints: screws of the rigid arm, and a table of how it flexes.

    Along each joint the arm is asked with all others as shown; where it has no answer it is taken to flex as shown.
    What joints do together adds up, which is exact of none of them and first order of several.

    It is as JSON has it, in the level world [m, rad]. `sliders` has each joint with `low`, `high` and `here`, a `point`
    of its axis and the `axis` here, and `flexed` at its `samples`: shift and rotation vector of every link, magnified,
    from the rigid one, in that one's axes. `rigid` has the (4, 4) poses of `links` by columns, `behind` which joints
    move each, `flexed` as that of a slider, here, `tip` the number of the link whose shift is shown; `swings` has
    frequency `hz` and largest change of `flexed` of the slowest modes, the drives holding.
    """
    robot, rigid, mount = arm.robot, shown.link_poses(0.0), arm.robot.mount
    links = tuple(rigid)
    parent = {joint.child: (joint, link) for link, joints in robot.urdf.children.items() for joint in joints}

    def behind(link: str) -> Iterator[str]:
        while link in parent:
            joint, link = parent[link]
            yield joint.name

    def flexed(deflection: Deflection, further: Array | None = None) -> Array:
        rigid, other = deflection.link_poses(0.0), deflection.link_poses(factor, further)
        apart = [np.linalg.inv(rigid[link]) @ other[link] for link in links]
        return np.array([[*pose[:3, 3], *pin.log3(pose[:3, :3])] for pose in apart])

    now, sliders, case = flexed(shown), [], shown.case
    asked: dict[str, Any] = {"covariates": dict(case.covariates), "wrenches": case.wrenches, "enforce_limits": False}

    def there(q: Array) -> Array:
        try:
            return flexed(arm.deflection(q, shown.payload, **asked))
        except ArmflexError:
            return now

    for i, joint in enumerate(robot.moving):
        low, high = np.clip([joint.lower, joint.upper], -SLIDERS, SLIDERS)
        # Positions along a joint at which the arm is asked for a slider's table.
        samples = np.linspace(min(low, shown.q[i]), max(high, shown.q[i]), 9)
        table = [there(np.where(np.arange(len(shown.q)) == i, position, shown.q)) for position in samples]
        sliders.append(_slider(joint, float(shown.q[i]), mount, rigid[joint.child], samples, table))
    level = pin.SE3(mount, np.zeros(3)).homogeneous
    return {
        "sliders": sliders,
        "links": links,
        "rigid": [(level @ rigid[link]).T.ravel().tolist() for link in links],
        "behind": [[i for i, joint in enumerate(robot.moving) if joint.name in {*behind(link)}] for link in links],
        "flexed": np.round(now, DIGITS).tolist(),
        "tip": links.index(robot.tip),
        "magnification": factor,
        "when": when,
        "swings": list(_swings(shown, arm, lambda twists: flexed(shown, SMALL * twists) - now)),
    }


def _slider(
    joint: Joint, here: float, mount: Array, pose: Array, samples: Array, table: Sequence[Array]
) -> dict[str, Any]:
    """Return what a page needs to move one joint, see `posable`."""
    return {
        "name": joint.name,
        "slides": joint.kind == "prismatic",
        "low": float(samples[0]),
        "high": float(samples[-1]),
        "here": here,
        "point": (mount @ pose[:3, 3]).tolist(),
        "axis": (mount @ pose[:3, :3] @ joint.axis).tolist(),
        "samples": samples.tolist(),
        "flexed": np.round(table, DIGITS).tolist(),
    }


def _swings(shown: Deflection, arm: Arm, change: Callable[[Array], Array]) -> Iterator[dict[str, Any]]:
    """Yield the slowest modes, none where nothing that moves has a mass or nothing gives.

    `change` is what `SMALL` times some twists of the flexures makes of the links.
    """
    with contextlib.suppress(ArmflexError):
        modes = modes_of(shown.solved, SWINGS, arm.damping_ratio)
        size = SWUNG * max(arm.robot.reach, 0.1)
        for frequency, twists in zip(modes.frequencies.tolist(), modes.twists, strict=True):
            yield {"hz": frequency, "flexed": np.round(change(twists) * (size / SMALL), DIGITS).tolist()}


def _triads(arm: Arm, flexed: Poses) -> Iterator[Node]:
    """Yield axes x y z, red green blue, at the base, at the flexed tip, and in a group of their own at every joint."""
    size = 0.1 * max(arm.robot.reach, 0.1)
    axes = tuple(
        Shape("capsule", np.array([0.05 * size, size]), _along(size * np.eye(3)[i]), color)
        for i, color in enumerate(AXES)
    )
    places = {"axes/base": arm.robot.base, "axes/tip": arm.robot.tip}
    places |= {f"joint axes/{_leaf(joint.name)}": joint.child for joint in arm.robot.jointed}
    for name, link in places.items():
        yield Node(name, np.array([pose[link] for pose in flexed]), axes, link)


def _arrows(arm: Arm, motion: Motion, flexed: Poses) -> Iterator[Node]:
    """Yield arrows: gravity beside the base, and every force from outside where it acts; their lengths compare."""
    reach = max(arm.robot.reach, 0.1)
    if (size := float(np.linalg.norm(arm.robot.gravity))) > 0.0:
        place = _upon(arm.robot.gravity / size)
        aside = np.eye(3)[int(np.argmin(np.abs(arm.robot.gravity)))]
        place[:3, 3] = 0.3 * reach * aside
        yield Node("forces/gravity", place[None], _arrow(0.15 * reach, GRAVITY))
    pulls: dict[str, list[tuple[Array, Array]]] = {}
    for frame, poses in zip(motion.frames, flexed, strict=True):
        for i, wrench in enumerate(frame.case.wrenches):
            force = wrench.at(poses[wrench.frame])[:3]
            pulls.setdefault(f"forces/{i + 1} {_leaf(wrench.frame)}", []).append((force, poses[wrench.frame][:3, 3]))
    most = max((float(np.linalg.norm(force)) for all_of in pulls.values() for force, _ in all_of), default=0.0)
    for name, all_of in pulls.items():
        largest = max(float(np.linalg.norm(force)) for force, _ in all_of)
        if largest > 0.0 and len(all_of) == len(flexed):
            places = [_upon(force / (np.linalg.norm(force) or 1.0)) for force, _ in all_of]
            for place, (_, point) in zip(places, all_of, strict=True):
                place[:3, 3] = point
            wrench = motion.frames[0].case.wrenches[int(name.split("/")[1].split(" ")[0]) - 1]
            size = reach * (0.06 + 0.14 * largest / most)
            yield Node(name, np.array(places), _arrow(size, FORCE), wrench.frame, turns=not wrench.dead)


def _arrow(length: float, color: str) -> tuple[Shape, ...]:
    """Return an arrow from the origin along z."""
    head = 0.3 * length
    shaft, point = np.eye(4), np.eye(4)
    shaft[2, 3], point[2, 3] = 0.5 * (length - head), length - 0.5 * head
    return (
        Shape("capsule", np.array([0.04 * length, length - head]), shaft, color),
        Shape("cone", np.array([0.12 * length, head]), point, color),
    )


def _upon(axis: Array) -> Array:
    """Return a pose at the origin whose z is along a unit vector."""
    pose = _along(axis)
    pose[:3, 3] = 0.0
    return pose


def _leaf(name: str) -> str:
    """Return a name without '/', which would make it a group of the viewer's."""
    return name.replace("/", "\N{DIVISION SLASH}")


def nice_magnification(arm: Arm, motion: Motion) -> float:
    """Return the largest round factor that keeps the shown sag below an eighth of the reach."""
    most = max(float(np.linalg.norm(frame.displacement[:3])) for frame in motion.frames)
    nice, largest = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000), 0.125 * max(arm.robot.reach, 1e-3)
    return float(max((factor for factor in nice if factor * most <= largest), default=1)) if most > 1e-9 else 1.0


def contribution_colors(deflection: Deflection) -> dict[str, str]:
    """Return a colour for each flexure by its share along the tip's displacement."""
    shares = np.abs(deflection.shares())
    fractions = shares / (shares.max(initial=0.0) or 1.0)
    stops = np.array([[int(stop[i : i + 2], 16) for i in (1, 3, 5)] for stop in SCALE], dtype=float)
    channels = [np.interp(fractions, np.linspace(0.0, 1.0, len(SCALE)), stop) for stop in stops.T]
    colors = (
        "#" + "".join(f"{round(channel):02x}" for channel in channel_values)
        for channel_values in zip(*channels, strict=True)
    )
    return dict(zip(deflection.names.flexures, colors, strict=True))


def _link_shapes(arm: Arm, rigid: Poses, meshes: bool) -> tuple[dict[str, tuple[Shape, ...]], tuple[str, ...]]:
    """Return what to draw for each link, and what is said of meshes that are not drawn.

    That is its primitives, its meshes on request, and rods to its joints where it has nothing or a mesh is left out. A
    link that slides gets a rod back along its slide, too, so that the arm does not fall apart.
    """
    drawn, missing = {}, []
    radius = 0.025 * max(arm.robot.reach, 0.1)
    slides = {
        joint.child: max(
            ((np.linalg.inv(pose[joint.child]) @ pose[joint.parent] @ [*joint.origin, 1.0])[:3] for pose in rigid),
            key=lambda end: float(np.linalg.norm(end)),
        )
        for joint in arm.robot.jointed
        if joint.kind == "prismatic"
    }
    joined = {}
    for closure in (*arm.robot.linkage.loops, *arm.robot.linkage.cylinders):
        joined.setdefault(closure.link, []).append(closure.at)
        joined.setdefault(closure.to, []).append(closure.at_to)
    for name, link in arm.robot.urdf.links.items():
        shapes, missed = [], len(missing)
        for visual in link.visuals:
            size, color = np.array(visual.size), visual.color or STEEL
            if visual.kind != "mesh" and size.min() > 0.0:
                shapes.append(Shape(cast("ShapeKind", visual.kind), size, visual.pose, color))
            elif visual.kind == "mesh" and meshes and (file := read_mesh(arm.robot.urdf.path, visual.mesh or "")):
                shapes.append(Shape("mesh", size, visual.pose, color, data=file[0], data_format=file[1]))
            elif visual.kind == "mesh":
                missing.append(visual.mesh or "")
        if not shapes or len(missing) > missed:
            ends = [joint.origin for joint in arm.robot.urdf.children[name]]
            ends += [slides[name]] if name in slides else []
            ends += joined.get(name, [])
            rods = [(end, float(np.linalg.norm(end))) for end in ends]
            shapes += [
                Shape("capsule", np.array([radius, length]), _along(end), STEEL) for end, length in rods if length > 0.0
            ]
        drawn[name] = tuple(shapes)
    if missing and not meshes:
        return drawn, (f"{len(missing)} meshes of the URDF are not drawn: ask for them (meshes=True, --meshes).",)
    names = listing(dict.fromkeys(missing), 4)
    said = f"{len(missing)} meshes are not there, or of no format that is drawn (STL, OBJ, DAE): {names}."
    return drawn, (said,) if missing else ()


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


def _nodes(
    arm: Arm, motion: Motion, rigid: Poses, flexed: Poses, colors: dict[str, str], shapes: dict[str, tuple[Shape, ...]]
) -> Iterator[Node]:
    """Yield the links of the rigid arm that move apart from it, the flexed arm, its flexures, and the payload."""
    owner: dict[str, str] = {}  # the flexure that each link hangs on most directly
    at_joint = {flexure.joint: flexure.name for flexure in arm.flexures}
    stack = [(arm.robot.base, "")]
    while stack:
        link, flexure = stack.pop()
        owner[link] = flexure
        stack.extend((joint.child, at_joint.get(joint.name, flexure)) for joint in arm.robot.urdf.children[link])
    for link in rigid[0]:
        if shapes[link] and owner.get(link):
            ghost = (replace(shape, color=GHOST, opacity=0.22) for shape in shapes[link])
            poses = np.array([pose[link] for pose in rigid])
            yield Node(f"rigid/{_leaf(link)}", poses, tuple(ghost), link, flexed=False)
    for link in flexed[0]:
        if shapes[link]:
            color = colors.get(owner.get(link, ""))
            solids = (replace(shape, color=color or shape.color, opacity=1.0) for shape in shapes[link])
            yield Node(f"flexed/{_leaf(link)}", np.array([pose[link] for pose in flexed]), tuple(solids), link)
    child = {joint.name: joint.child for joint in arm.robot.places}
    for flexure in arm.flexures:
        if flexure.joint not in child and flexure.joint is not None:
            continue  # a pin or a cylinder, which is drawn itself
        link = child[flexure.joint] if flexure.joint else arm.robot.base
        ball = Shape("sphere", np.array([0.022 * max(arm.robot.reach, 0.1)]), color=colors[flexure.name])
        yield Node(f"flexure/{_leaf(flexure.name)}", np.array([pose[link] for pose in flexed]), (ball,), link)

    # The heaviest payload at its place; while it is not carried it stands where it is picked up or set down.
    masses = [frame.payload.mass for frame in motion.frames]
    heaviest = max((frame.payload for frame in motion.frames), key=lambda payload: payload.mass)
    if heaviest.mass:
        size, place = payload_box(heaviest)
        carried = np.flatnonzero(masses)
        tips = [flexed[i][arm.robot.tip] for i in np.clip(range(len(flexed)), carried[0], carried[-1])]
        yield Node("payload", np.array(tips), (Shape("box", size, place, LOAD),), arm.robot.tip)


def _ties(arm: Arm, flexed: Poses) -> Iterator[Node]:
    """Yield the pins of loops, and cylinders and springs: halves that turn about either end and slide in each other."""
    radius = 0.02 * max(arm.robot.reach, 0.1)

    def at(link: str, point: Array) -> Array:
        return np.array([pose[link][:3, :3] @ point + pose[link][:3, 3] for pose in flexed])

    for loop in arm.robot.linkage.loops:
        poses = np.tile(np.eye(4), (len(flexed), 1, 1))
        poses[:, :3, 3] = at(loop.link, loop.at)
        ball = Shape("sphere", np.array([1.2 * radius]), color=PIN)
        yield Node(f"loops/{_leaf(loop.name)}", poses, (ball,), loop.link)
    for kind, ties in (("cylinders", arm.robot.linkage.cylinders), ("springs", arm.springs)):
        for tie in ties:
            ends = at(tie.link, tie.at), at(tie.to, tie.at_to)
            longest = float(np.linalg.norm(ends[1] - ends[0], axis=1).max())
            for part, (here, there), thick in (("barrel", ends, 1.0), ("rod", ends[::-1], 0.55)):
                poses = np.array([_along(end) for end in there - here])
                poses[:, :3, 3] = here
                place = np.eye(4)
                place[2, 3] = 0.275 * longest
                size = np.array([thick * radius, 0.55 * longest])
                shape = Shape("cylinder", size, place, TIE if kind == "cylinders" else SPRING)
                yield Node(f"{kind}/{_leaf(tie.name)} {part}", poses, (shape,))


def payload_box(payload: Payload) -> tuple[Array, Array]:
    """Return full sides [m] and (4, 4) pose at the tip of a box that is drawn for a payload.

    It is the even box of its mass and inertia where that is given, else a cube of the density of stone.
    """
    place = np.eye(4)
    place[:3, 3] = payload.com
    if payload.inertia is None or not np.any(payload.inertia):
        return np.full(3, (payload.mass / STONE) ** (1.0 / 3.0)), place
    moments, axes = np.linalg.eigh(payload.inertia_matrix)
    place[:3, :3] = axes * np.linalg.det(axes)
    sides = np.sqrt(np.maximum(6.0 / payload.mass * (moments.sum() - 2.0 * moments), 0.0))
    return np.maximum(sides, 0.02 * sides.max()), place


def _parts(
    arm: Arm, shown: Deflection, factor: float, rigid: Poses, flexed: Poses, colors: dict[str, str]
) -> Iterator[Node]:
    """Yield the meshes of condensed parts, rigid as ghosts and bent as in the row that the legend speaks of."""
    child = {joint.name: joint.child for joint in arm.robot.chain}
    for flexure in arm.flexures:
        if flexure.meshed is None or (drawing := flexure.meshed.drawing) is None or flexure.joint is None:
            continue
        link = child[flexure.joint]
        name = flexure.name if flexure.joint == f"{flexure.name}:end" else f"part:{flexure.name}"  # a link, or a joint
        twist = factor * shown.twists[arm.flexure_names.index(flexure.name)]
        for group, bend, placed in (("rigid", np.zeros(6), rigid), ("flexed", twist, flexed)):
            if (surface := drawing.bent(bend)) is None:
                continue
            color, opacity = (GHOST, 0.22) if group == "rigid" else (colors[flexure.name], 1.0)
            corners = surface[0][surface[1]]
            facets = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
            facets["normal"] = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            facets["normal"] /= np.linalg.norm(facets["normal"], axis=1, keepdims=True).clip(1e-30)
            facets["corners"] = corners
            data = bytes(80) + np.uint32(len(facets)).tobytes() + facets.tobytes()  # an STL file
            shape = Shape("mesh", np.ones(3), color=color, opacity=opacity, data=data, data_format="stl")
            poses = np.array([pose[link] for pose in placed])
            yield Node(f"{group}/{_leaf(name)}", poses, (shape,), link, flexed=group == "flexed")


def _paths(arm: Arm, rigid: Poses, flexed: Poses) -> Iterator[Polyline]:
    radius = 0.004 * max(arm.robot.reach, 0.1)
    before, after = (np.array([pose[arm.robot.tip][:3, 3] for pose in poses]) for poses in (rigid, flexed))
    if len(rigid) > 1 and np.ptp(before, axis=0).max() > 1e-6:
        yield Polyline("rigid path", before, RIGID_PATH, radius)
        yield Polyline("flexed path", after, FLEXED_PATH, radius)
    elif np.linalg.norm(after[0] - before[0]) > 1e-6:
        yield Polyline("displacement", np.array([before[0], after[0]]), FLEXED_PATH, radius)


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
            yield Marker(position, VERDICTS.get(verdict, RIGID_PATH), radius, name)


def _legend(
    shown: Deflection, colors: dict[str, str], trajectory: Trajectory | None, report: CheckReport | None, factor: float
) -> Iterator[LegendRow]:
    for name, share in zip(shown.names.flexures, shown.shares(), strict=True):
        yield LegendRow(colors[name], name, f"{number(share * 1e3, 3, TINY)} mm")
    if colors:
        yield LegendRow(GHOST, "rigid arm", opacity=0.4)
    if trajectory is not None:
        yield LegendRow(RIGID_PATH, "tip path, rigid")
    if colors:
        yield LegendRow(FLEXED_PATH, f"tip {'path' if trajectory is not None else 'shift'}, flexed × {factor:g}")
    if shown.payload.mass:
        yield LegendRow(LOAD, "payload", f"{shown.payload.mass:g} kg")
    for wrench in shown.case.wrenches:
        yield LegendRow(FORCE, f"force at {wrench.frame}", f"{number(float(np.linalg.norm(wrench.force)), 3)} N")
    if np.any(shown.arm.robot.gravity):
        yield LegendRow(GRAVITY, "gravity", f"{float(np.linalg.norm(shown.arm.robot.gravity)):.3g} m/s²")
    if report is not None:
        for verdict, color in VERDICTS.items():
            count = sum(point.verdict == verdict for point in report.via_points)
            yield LegendRow(color, f"via-point: {verdict}", str(count))


def _table(motion: Motion, trajectory: Trajectory | None, report: CheckReport | None) -> tuple[tuple[str, ...], ...]:
    """Return the via-points of a path in their order, the head first; of a checked one with margin and verdict."""
    if report is not None:
        rows = [
            (
                point.name,
                f"{point.time:g}",
                number(point.displacement_m * 1e3, 4, TINY)
                + ("" if point.sigma_m is None else f" ± {number(point.sigma_m * 1e3, 2, TINY)}"),
                number(point.margin_m * 1e3, 3),
                point.verdict,
            )
            for point in sorted(report.via_points, key=lambda point: point.time)
        ]
        return (("name", "s", "moves mm", "margin mm", "verdict"), *rows) if rows else ()
    via = {} if trajectory is None else dict(zip(trajectory.time.tolist(), trajectory.via, strict=True))
    rows = [
        (via[time], f"{time:g}", number(float(np.linalg.norm(frame.displacement[:3])) * 1e3, 4, TINY))
        for time, frame in zip(motion.times.tolist(), motion.frames, strict=True)
        if via.get(time)
    ]
    return (("name", "s", "moves mm"), *rows) if rows else ()


def _subtitle(arm: Arm, shown: Deflection, motion: Motion, factor: float) -> str:
    if not arm.flexures:
        return "No flexure is declared: this arm is rigid."
    moved, turned = (float(np.linalg.norm(part)) * 1e3 for part in (shown.displacement[:3], shown.displacement[3:]))
    when = _when(motion)
    uncertainty = shown.sigma()
    sigma = "" if uncertainty is None else f" ± {number(uncertainty * 1e3, 2, TINY)}"
    moves = f"Tip moves {number(moved, 4, TINY)}{sigma} mm and turns {number(turned, 3, TINY)} mrad{when}"
    return f"{moves}. Shown × {factor:g}."


def _when(motion: Motion) -> str:
    """Return when that is which figures speak of."""
    return f" at {motion.times[motion.worst]:g} s" if len(motion.frames) > 1 else ""


def _notes(arm: Arm, shown: Deflection, motion: Motion, factor: float) -> Iterator[str]:
    yield f"Base {arm.robot.base}, tip {arm.robot.tip}; grid lines are 0.5 m apart. Made on {date.today().isoformat()}."
    if arm.robot.linkage:
        text = "Here are no sliders and no modes: with loops, cylinders or passive joints each pose is solved anew"
        yield f"{text}, which a page cannot do. view --q shows another pose, armflex modes --picture how it swings."
    if arm.flexures:
        left = float(np.linalg.norm(shown.remainder[:3]) * 1e3)
        yield f"Deflections are drawn {factor:g} times as large as they are; the rigid arm is to scale."
        yield f"Shares are first order; together they miss the displacement by {number(left, 2, TINY)} mm."
        if shown.corrected.any():
            size = float(np.linalg.norm(shown.corrected[:3]) * 1e3)
            yield f"Beside them the calibrated geometry moves the tip by {number(size, 3, TINY)} mm."
    if shown.payload.mass and shown.payload.inertia is None:
        yield "The payload is drawn as a cube of its mass in stone: its size is not known without an inertia."
    if len(motion.frames) < motion.rows:
        yield f"{len(motion.frames)} of {motion.rows} rows are drawn; the figures are of the worst of all rows."
    if shown.covariance is not None:
        yield "± is one standard uncertainty."
