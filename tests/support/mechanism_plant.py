"""Machines with loops that MuJoCo simulates: what nobody declared of them, and campaigns that a tracker reads.

Where a machine rests is the root of MuJoCo's own equation, with what its pins do beyond it: torques of the tree balance
the forces in loops, and a pin gaps by what it gives and by its play.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np
from scipy.optimize import root
from scipy.spatial.transform import Rotation

import armflex
from support.machines import MACHINES, Machine, Z

SIGMA = 1e-4
"""Of a tracker's reading [m]."""

LOADS = {"none": 0.0, "half": 150.0, "full": 300.0}
"""Payloads [kg] at the tip."""

CYLINDER = 1.5
"""Length of a cylinder in the middle of its travel [m]."""

STANDS = np.array([[3.0, -2.0, 0.5], [0.02, -0.01, 2.0]])
"""Shift and rotation vector of the base in the tracker's frame [m, rad]."""

SEATED = 1.0
"""Force [N] below which a pin with play is between its sides."""


@dataclass(frozen=True)
class Truth:
    """How a machine differs from its drawing.

    Attributes:
        offsets: Of drives [rad] and cylinders [m], by name.
        softer: Factors on the compliances of hinges and cylinders.
        springs: By name the share by which the rate is higher, and how much longer the spring is [m].
        lost: Share of its tension that a spring has lost.
        pins: Shift of a loop's or cylinder's two points [m], by name and by `NAME:to`.
        frames: Shift and rotation vector of a hinge's frame [m, rad].
        tool: Shift of what is measured, in the axes of the last link [m].
        compliance: (3,) of a loop's pin, in the axes of its first link [m/N].
        play: Diametral, of a loop's pin [m].
        leaks: Of a cylinder, length per force and time [m/(N s)].
    """

    offsets: Mapping[str, float] = field(default_factory=dict)
    softer: Mapping[str, float] = field(default_factory=dict)
    springs: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    lost: Mapping[str, float] = field(default_factory=dict)
    pins: Mapping[str, np.ndarray] = field(default_factory=dict)
    frames: Mapping[str, np.ndarray] = field(default_factory=dict)
    tool: tuple[float, ...] = (0.0, 0.0, 0.0)
    compliance: Mapping[str, np.ndarray] = field(default_factory=dict)
    play: Mapping[str, float] = field(default_factory=dict)
    leaks: Mapping[str, float] = field(default_factory=dict)

    def built(self, machine: Machine) -> Machine:
        """Return a machine as it was built."""

        def placed(name: str, one: tuple) -> tuple:
            shifts = (self.pins.get(name, np.zeros(3)), self.pins.get(f"{name}:to", np.zeros(3)))
            first, second = (tuple(np.add(at, shift)) for at, shift in zip((one[1], one[3]), shifts, strict=True))
            return (one[0], first, one[2], second, *one[4:])

        def stiff(name: str, stiffness: float) -> float:
            return stiffness / self.softer.get(name, 1.0)

        springs = {}
        for name, (*ends, rate, free) in machine.springs.items():
            share, longer = self.springs.get(name, (0.0, 0.0))
            springs[name] = (*ends, rate * (1.0 + share) * (1.0 - self.lost.get(name, 0.0)), free + longer)
        hinges = {}
        for name, one in machine.hinges.items():
            twist = self.frames.get(name, np.zeros(6))
            place = tuple(np.add(one.place, twist[:3]).tolist())
            hinges[name] = replace(one, place=place, turned=tuple(twist[3:].tolist()))
        cylinders = {name: placed(name, one) for name, one in machine.cylinders.items()}
        return replace(
            machine,
            hinges=hinges,
            gives={name: (axis, stiff(name, stiffness)) for name, (axis, stiffness) in machine.gives.items()},
            loops={name: placed(name, one) for name, one in machine.loops.items()},
            cylinders={name: (*one[:4], stiff(name, one[4]), *one[5:]) for name, one in cylinders.items()},
            springs=springs,
        )


@dataclass(frozen=True, eq=False)
class Plant:
    """A machine as MuJoCo has it, under one payload."""

    machine: Machine
    truth: Truth
    mass: float

    @cached_property
    def _model(self) -> mujoco.MjModel:
        lengths = dict.fromkeys(self.machine.cylinders, 1.0)
        found = mujoco.MjModel.from_xml_string(self.machine.mjcf(lengths, self.mass))
        found.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT  # loops are closed here
        return found

    @cached_property
    def _data(self) -> mujoco.MjData:
        return mujoco.MjData(self._model)

    @cached_property
    def _names(self) -> list[str]:
        return [self._model.joint(i).name for i in range(self._model.njnt)]

    def tip(self, at: Mapping[str, float], hold: float) -> np.ndarray:
        """Return (3,) where the tip comes to rest in the base [m].

        Args:
            at: Drives and cylinders as their controllers report them.
            hold: How long the load has stood [s].
        """
        model, data, truth = self._model, self._data, self.truth
        q = {name: value + truth.offsets.get(name, 0.0) for name, value in at.items()}
        for k, (name, one) in enumerate(self.machine.cylinders.items()):
            model.tendon_lengthspring[k] = q[name]
            model.tendon_stiffness[k] = 1.0 / (1.0 / one[4] + truth.leaks.get(name, 0.0) * hold)
        free = np.array([i for i, name in enumerate(self._names) if name not in q])
        first = np.array([q.get(name, 0.0) for name in self._names])
        middle = {name: CYLINDER if name in self.machine.cylinders else 0.0 for name in q}

        def look(here: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            data.qpos[:] = first
            data.qpos[free] = here
            data.qvel[:] = 0.0
            mujoco.mj_forward(model, data)
            pairs = [between(loop) for loop in self.machine.loops]
            ways = np.concatenate([np.zeros((0, model.nv)), *(way for _, way in pairs)])
            gaps = np.concatenate([np.zeros(0), *(gap for gap, _ in pairs)])
            return (data.qfrc_passive - data.qfrc_bias)[free], ways[:, free], gaps

        def between(name: str) -> tuple[np.ndarray, np.ndarray]:
            ends, moved = [model.site(f"{name}/{i}").id for i in range(2)], np.zeros((2, 3, model.nv))
            for end, way in zip(ends, moved, strict=True):
                mujoco.mj_jacSite(model, data, way, None, end)
            return data.site_xpos[ends[1]] - data.site_xpos[ends[0]], moved[1] - moved[0]

        here = np.zeros(len(free))
        for part in np.linspace(0.0, 1.0, 6):  # the drives go from the middle of their travel, the loops stay closed
            passing = {name: middle[name] + part * (q[name] - middle[name]) for name in q}
            first = np.array([passing.get(name, 0.0) for name in self._names])
            for _ in range(15):
                _, ways, gaps = look(here)
                for name in self.machine.cylinders:
                    way, moved = between(name)
                    length = np.linalg.norm(way)
                    gaps = np.append(gaps, length - passing[name])
                    ways = np.vstack([ways, (way / length @ moved)[free]])
                step = np.linalg.lstsq(ways, gaps, rcond=1e-2)[0]
                here = here - step
                if np.abs(step).max() < 1e-9:
                    break
        left, jacobian, _ = look(here)
        # A plane loop does not gap across its plane, and nothing determines the force there.
        turns, sizes, _ = np.linalg.svd(jacobian)
        across = turns[:, : int((sizes > 1e-6 * sizes.max(initial=0.0)).sum())]

        def given(forces: np.ndarray) -> np.ndarray:
            found = np.zeros(len(forces))
            for k, loop in enumerate(self.machine.loops):
                own = slice(3 * k, 3 * k + 3)
                turn = data.body(self.machine.loops[loop][0]).xmat.reshape(3, 3)
                found[own] = turn @ (truth.compliance.get(loop, np.zeros(3)) * (turn.T @ forces[own]))
                size = np.sqrt(forces[own] @ forces[own] + SEATED**2)
                found[own] += 0.5 * truth.play.get(loop, 0.0) * forces[own] / size
            return found

        def equation(at: np.ndarray) -> np.ndarray:
            left, ways, gaps = look(at[: len(free)])
            forces = 1e4 * across @ at[len(free) :]
            return np.concatenate([1e-4 * (left - ways.T @ forces), across.T @ (gaps - given(forces))])

        forces = 1e-4 * np.linalg.lstsq(jacobian.T, left, rcond=1e-2)[0]
        found = root(equation, np.concatenate([here, across.T @ forces]), tol=1e-14)
        assert np.abs(found.fun).max() < 1e-8, f"MuJoCo's equation has no root near here: {np.abs(found.fun).max():.1e}"
        look(found.x[: len(free)])
        tool = data.site("tool")
        return tool.xpos + tool.xmat.reshape(3, 3) @ truth.tool


GIVES = (2e-8, 1e-6, 2e-8)
"""Declared compliance of a loop's pin [m/N]: balls float along y, where nothing else gives."""


def declared(machine: Machine, folder: Path, more: str) -> armflex.Arm:
    """Return a machine as its file declares it, its loops' pins balls that give, with payloads and more text."""
    balls = {loop: (*one[:4], None) for loop, one in machine.loops.items()}
    replace(machine, loops=balls).load(folder)
    path = folder / "arm.toml"
    gives = f'kind = "spherical"\ncompliance = {[*GIVES, 0.0, 0.0, 0.0]}\n'
    path.write_text(path.read_text().replace('kind = "spherical"\n', gives))
    loads = "".join(f"[payload.{one}]\nmass = {mass}\ncom = [0, 0, 0]\n" for one, mass in LOADS.items() if mass)
    path.write_text(path.read_text() + loads + more)
    return armflex.load_arm(path)


def campaign(
    machine: Machine, arm: armflex.Arm, truth: Truth, rows: int, rng: np.random.Generator, path: Path
) -> armflex.Measurements:
    """Return what a tracker reads of a machine at random positions under payloads in turn, a random while each.

    The tracker stands at `STANDS`.
    """
    built, q = truth.built(machine), spread(machine, rows, rng)
    carried = [list(LOADS)[i % 3] for i in range(len(q))]
    plants = {load: Plant(built, truth, mass) for load, mass in LOADS.items()}
    hold = rng.choice([20.0, 60.0, 180.0, 600.0], len(q))
    head = ["pose", "session", "time", "payload", "hold", *(f"q_{joint}" for joint in arm.joint_names)]
    table, time = [[*head, "x", "y", "z", "sigma"]], 0.0
    for i, (at, load) in enumerate(zip(q, carried, strict=True)):
        time += float(hold[i]) + 30.0
        drives = dict(zip(arm.joint_names, at.tolist(), strict=True))
        tip = plants[load].tip(drives, float(hold[i]))
        tip = STANDS[0] + Rotation.from_rotvec(STANDS[1]).apply(tip)
        numbers = [*at.tolist(), *(tip + SIGMA * rng.normal(size=3)).tolist(), SIGMA]
        table.append([f"p{i}", "s", repr(time), load, repr(float(hold[i])), *map(repr, numbers)])
    path.write_text("\n".join(",".join(row) for row in table))
    return armflex.read_measurements(path, arm)


def spread(machine: Machine, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return (count, nq) positions that a machine can take."""
    middle = [CYLINDER if drive in machine.cylinders else 0.0 for drive in machine.driven]
    reach = [
        0.2
        if drive in machine.cylinders
        else 0.9
        if machine.hinges[drive].axis == Z
        else 0.5 / max(len(machine.loops), 1)
        for drive in machine.driven
    ]
    return np.asarray(middle) + np.asarray(reach) * rng.uniform(-1.0, 1.0, (count, len(reach)))


def _heavier(machine: Machine, link: str, mass: float, centre: tuple[float, float, float]) -> Machine:
    return replace(machine, bodies={**machine.bodies, link: (mass, centre)})


REVERSING = {
    "parallelogram": _heavier(MACHINES["parallelogram"], "fore", 200.0, (-0.3, 0.02, 0.1)),
    "uneven": replace(
        _heavier(MACHINES["uneven"], "fore", 200.0, (-0.3, 0.02, 0.1)),
        springs={"balancer": (*MACHINES["uneven"].springs["balancer"][:4], 60e3, 0.5)},
    ),
    "crane": MACHINES["crane"],
    "five_bar": _heavier(MACHINES["five_bar"], "platform", 900.0, (-0.35, 0.05, 0.3)),
}
"""The machines with a counterweight, so that payloads reverse the load on their rods: else no play would show; and a
spring that carries as much as the lower arm weighs."""
