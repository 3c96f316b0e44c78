"""Machines with loops, springs and cylinders: as files of this package, as MuJoCo's models and as Exudyn's."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import armflex
from armflex import Arm
from armflex.laws import LinearLaw, Row
from support.small_arms import joint, link, robot, spaced, write

Point = tuple[float, float, float]
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Hinge:
    """A joint that turns about an axis of its child; without a drive where it is passive.

    Its frame is turned by a rotation vector, of which files say nothing.
    """

    parent: str
    child: str
    place: Point
    axis: Point
    passive: bool = False
    turned: Point = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Machine:
    """A machine of hinges.

    Attributes:
        hinges: By name, parents first.
        bodies: Mass [kg] and centre of mass of every link but the base.
        gives: Axis and stiffness [Nm/rad] of what gives behind a hinge.
        loops: Link, point, other link, point, and the axis of a revolute one, None of a spherical one.
        cylinders: Link, point, other link, point, stiffness [N/m], least and greatest length.
        springs: Link, point, other link, point, rate [N/m], free length.
        tool: The link of the tip and its place.
    """

    hinges: Mapping[str, Hinge]
    bodies: Mapping[str, tuple[float, Point]]
    gives: Mapping[str, tuple[Point, float]]
    tool: tuple[str, Point]
    loops: Mapping[str, tuple[str, Point, str, Point, Point | None]] = field(default_factory=dict)
    cylinders: Mapping[str, tuple[str, Point, str, Point, float, float, float]] = field(default_factory=dict)
    springs: Mapping[str, tuple[str, Point, str, Point, float, float]] = field(default_factory=dict)

    @property
    def driven(self) -> tuple[str, ...]:
        """Hinges with a drive, then cylinders."""
        return (*(name for name, hinge in self.hinges.items() if not hinge.passive), *self.cylinders)

    def load(self, folder: Path) -> armflex.Arm:
        """Return the machine as files say it."""
        parts = [link("base"), *(link(name, mass, com, 1.0) for name, (mass, com) in self.bodies.items()), link("tool")]
        parts += [joint(name, one.parent, one.child, one.place, axis=one.axis) for name, one in self.hinges.items()]
        parts.append(joint("flange", self.tool[0], "tool", self.tool[1], kind="fixed"))
        write(folder, robot(*parts))
        return armflex.load_arm(write(folder, self.declared(), "arm.toml"))

    def declared(self) -> str:
        """Return the arm.toml."""
        lines = ['[robot]\nurdf = "robot.urdf"\ntip = "tool"\nbase = "base"\ngravity = [0.0, 0.0, -9.81]\n']
        lines += [f"[joint.{name}]\npassive = true\n" for name, one in self.hinges.items() if one.passive]
        for name, (one, at, to, at_to, axis) in self.loops.items():
            kind = f'"revolute"\naxis = {list(axis)}' if axis else '"spherical"'
            lines.append(f'[[loop]]\nname = "{name}"\n{ends(one, at, to, at_to)}kind = {kind}\n')
        for name, (one, at, to, at_to, stiffness, lower, upper) in self.cylinders.items():
            told = f"stiffness = {stiffness}\nlower = {lower}\nupper = {upper}\n"
            lines.append(f"[cylinder.{name}]\n{ends(one, at, to, at_to)}{told}")
        for name, (one, at, to, at_to, rate, free) in self.springs.items():
            lines.append(f"[spring.{name}]\n{ends(one, at, to, at_to)}rate = {rate}\nfree_length = {free}\n")
        for name, (axis, stiffness) in self.gives.items():
            compliance = np.outer([0, 0, 0, *axis], [0, 0, 0, *axis]) / stiffness
            lines.append(f'[flexure.{name}]\njoint = "{name}"\nmodel = "linear"\ncompliance = {compliance.tolist()}\n')
        return "\n".join(lines)

    def mjcf(self, lengths: Mapping[str, float], carried: float = 0.0) -> str:
        """Return MuJoCo's model with cylinders at their lengths [m], and what its tool carries [kg].

        What gives is a hinge with stiffness.
        """
        points = {f"{name}/{i}": ends for name, *rest in self._joined() for i, ends in enumerate(rest)}
        points["tool"] = self.tool
        spots = {name: "" for name in ("base", *self.bodies)}
        for name, (body, at) in points.items():
            spots[body] += f'<site name="{name}" pos="{spaced(at)}"/>'
        if carried:
            own = f'<inertial mass="{carried}" pos="0 0 0" diaginertia="1 1 1"/>'
            spots[self.tool[0]] += f'<body pos="{spaced(self.tool[1])}">{own}</body>'

        def body(name: str) -> str:
            text = spots[name]
            for key, hinge in self.hinges.items():
                if hinge.parent != name:
                    continue
                mass, com = self.bodies[hinge.child]
                turns = f'<joint name="{key}" axis="{spaced(hinge.axis)}"/>'
                if key in self.gives:
                    axis, stiffness = self.gives[key]
                    turns += f'<joint name="{key}/gives" axis="{spaced(axis)}" stiffness="{stiffness!r}"/>'
                own = f'<inertial mass="{mass}" pos="{spaced(com)}" diaginertia="1 1 1"/>'
                turned = spaced(Rotation.from_rotvec(hinge.turned).as_quat()[[3, 0, 1, 2]])
                place = f'pos="{spaced(hinge.place)}" quat="{turned}"'
                text += f'<body name="{hinge.child}" {place}>{turns}{own}{body(hinge.child)}</body>'
            return text

        ties = "".join(f'<connect site1="{name}/0" site2="{name}/1"/>' for name in self.loops)
        pulls = [(name, one[4], lengths[name]) for name, one in self.cylinders.items()]
        pulls += [(name, one[4], one[5]) for name, one in self.springs.items()]
        tendons = "".join(
            f'<spatial stiffness="{rate!r}" springlength="{free!r}">'
            f'<site site="{name}/0"/><site site="{name}/1"/></spatial>'
            for name, rate, free in pulls
        )
        option = '<compiler angle="radian" autolimits="false"/><option gravity="0 0 -9.81"/>'
        # What gives turns about its hinge's axis: both together would have no inertia.
        option += '<default><joint armature="1"/></default>'
        joined = f"<equality>{ties}</equality><tendon>{tendons}</tendon>"
        return f"<mujoco>{option}<worldbody>{body('base')}</worldbody>{joined}</mujoco>"

    def _joined(self) -> list[tuple[str, tuple[str, Point], tuple[str, Point]]]:
        every = {**self.loops, **self.cylinders, **self.springs}
        return [(name, (one[0], one[1]), (one[2], one[3])) for name, one in every.items()]


def ends(one: str, at: Point, to: str, at_to: Point) -> str:
    return f'link = "{one}"\nat = {list(at)}\nto = "{to}"\nat_to = {list(at_to)}\n'


COLUMN = Hinge("base", "column", (0.0, 0.0, 0.4), Z)
PARALLELOGRAM = Machine(
    hinges={
        "turn": COLUMN,
        "lower": Hinge("column", "arm", (0.2, 0.0, 0.3), Y),
        "elbow": Hinge("arm", "fore", (0.0, 0.0, 1.1), Y, passive=True),
        "crank": Hinge("column", "crank", (0.2, 0.0, 0.3), Y),
        "foot": Hinge("crank", "rod", (-0.4, 0.0, 0.0), Y, passive=True),
    },
    bodies={
        "column": (150.0, (0.05, 0.01, 0.1)),
        "arm": (90.0, (0.0, 0.02, 0.5)),
        "fore": (60.0, (0.6, 0.0, 0.1)),
        "crank": (20.0, (-0.2, 0.0, 0.0)),
        "rod": (15.0, (0.0, 0.0, 0.55)),
    },
    gives={"turn": (Z, 5e5), "lower": (Y, 3e5), "crank": (Y, 2e5)},
    loops={"tail": ("rod", (0.0, 0.0, 1.1), "fore", (-0.4, 0.0, 0.0), Y)},
    tool=("fore", (1.3, 0.1, 0.0)),
)
"""A palletizing arm: a rod beside the lower arm keeps the forearm by a crank."""

UNEVEN = Machine(
    hinges={**PARALLELOGRAM.hinges, "foot": Hinge("crank", "rod", (-0.37, 0.03, 0.02), Y, passive=True)},
    bodies=PARALLELOGRAM.bodies,
    gives=PARALLELOGRAM.gives,
    loops={"tail": ("rod", (0.01, -0.03, 1.13), "fore", (-0.42, 0.0, 0.01), Y)},
    springs={"balancer": ("column", (-0.25, 0.0, 0.1), "arm", (0.05, 0.0, 0.7), 30e3, 0.5)},
    tool=PARALLELOGRAM.tool,
)
"""The same, not quite parallel, with a gravity spring."""

CRANE = Machine(
    hinges={
        "slew": Hinge("base", "mast", (0.0, 0.0, 0.5), Z),
        "boom": Hinge("mast", "boom", (0.3, 0.0, 1.5), Y, passive=True),
        "jib": Hinge("boom", "jib", (3.0, 0.0, 0.0), Y, passive=True),
    },
    bodies={"mast": (800.0, (0.0, 0.0, 0.8)), "boom": (500.0, (1.4, 0.0, 0.1)), "jib": (300.0, (1.1, 0.0, 0.0))},
    gives={"slew": (Z, 2e6), "boom": (Z, 1.5e6), "jib": (X, 4e5)},
    cylinders={
        "lift": ("mast", (0.4, 0.0, 0.4), "boom", (1.2, 0.0, -0.2), 2e7, 0.9, 2.2),
        "fold": ("boom", (1.8, 0.05, 0.3), "jib", (0.3, 0.05, 0.4), 1.2e7, 0.9, 2.0),
    },
    tool=("jib", (2.2, 0.2, 0.0)),
)
"""A loading crane: boom and jib are held by a cylinder each."""


def _tilt(side: float) -> dict[str, Hinge]:
    name = "left" if side > 0.0 else "right"
    return {
        name: Hinge("base", f"{name}_crank", (-0.8, 0.9 * side, 0.2), Y),
        f"{name}_fore": Hinge(f"{name}_crank", f"{name}_fork", (0.5, 0.0, 0.0), Y, passive=True),
        f"{name}_side": Hinge(f"{name}_fork", f"{name}_rod", (0.0, 0.0, 0.0), X, passive=True),
    }


FIVE_BAR = Machine(
    hinges={
        "pitch": Hinge("base", "gimbal", (0.0, 0.0, 1.2), Y, passive=True),
        "roll": Hinge("gimbal", "platform", (0.0, 0.0, 0.0), X, passive=True),
        **_tilt(1.0),
        **_tilt(-1.0),
    },
    bodies={
        "gimbal": (60.0, (0.0, 0.0, 0.02)),
        "platform": (900.0, (0.2, 0.05, 0.3)),
        **{
            f"{name}_{part}": (mass, com)
            for name in ("left", "right")
            for part, mass, com in (
                ("crank", 60.0, (0.25, 0.0, 0.0)),
                ("fork", 8.0, (0.0, 0.0, 0.03)),
                ("rod", 30.0, (0.02, 0.0, 0.5)),
            )
        },
    },
    gives={"left": (Y, 4e5), "right": (Y, 5e5), "roll": (Z, 2e6)},
    loops={
        "left_ball": ("left_rod", (0.0, 0.0, 1.0), "platform", (-0.35, 0.85, 0.05), None),
        "right_ball": ("right_rod", (0.0, 0.0, 1.0), "platform", (-0.35, -0.85, 0.05), None),
    },
    tool=("platform", (1.5, 0.4, 0.6)),
)
"""A tilting platform on a gimbal: two cranks move it through rods with balls at their ends."""

LIFTED = replace(
    UNEVEN,
    hinges={**UNEVEN.hinges, "lower": replace(UNEVEN.hinges["lower"], passive=True)},
    cylinders={"lift": ("column", (0.7, 0.0, 0.1), "arm", (0.1, 0.0, 0.6), 2e7, 0.6, 1.3)},
)
"""The same, its lower arm on a cylinder: with one of everything."""

MACHINES = {"parallelogram": PARALLELOGRAM, "uneven": UNEVEN, "crane": CRANE, "five_bar": FIVE_BAR}


def poses(name: str, count: int = 4) -> np.ndarray:
    """Return (count, nq) positions that a machine can take."""
    rng = np.random.default_rng(7)
    middle = {"crane": [0.0, 1.55, 1.45]}.get(name, np.zeros(len(MACHINES[name].driven)))
    reach = {"crane": [1.0, 0.12, 0.12], "five_bar": 0.25}.get(name, 0.5)
    return middle + np.asarray(reach) * rng.uniform(-1.0, 1.0, (count, len(MACHINES[name].driven)))


def skewed(arm: Arm) -> Arm:
    """Return an arm whose compliances are not symmetric, as where each number of a bench was fitted by itself."""
    twisted = np.eye(6) + 0.05 * np.random.default_rng(5).standard_normal((6, 6))
    row = Row(arm.position(), arm.joint_index, {})
    laws = [LinearLaw(flexure.law.tangent(np.zeros(6), row) @ twisted) for flexure in arm.flexures]
    return replace(arm, flexures=tuple(replace(one, law=law) for one, law in zip(arm.flexures, laws, strict=True)))
