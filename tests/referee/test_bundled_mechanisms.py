"""The bundled machines with loops: they close on all of their paths, and rest where MuJoCo's own equation has them."""

import mujoco
import numpy as np
import pytest
from support.mujoco_arm import Referee
from support.small_arms import ROBOTS

import armflex


def load(name: str) -> tuple[armflex.Arm, armflex.Trajectory]:
    arm = armflex.load_arm(ROBOTS / name / "arm.toml")
    return arm, armflex.read_trajectory(ROBOTS / name / "trajectory.csv", arm)


class Loops:
    """A bundled machine in MuJoCo, with a hinge for what gives about an axis and sites where loops meet."""

    def __init__(self, name: str, payload: str) -> None:
        referee = Referee(name)
        spec, toml = referee.spec(payload), referee.toml
        self.axes: dict[str, np.ndarray] = {}
        for flexure, told in toml["flexure"].items():
            moved = spec.joint(told["joint"])
            given = np.array(told["compliance"][3:]) if "compliance" in told else moved.axis / told["joint_stiffness"]
            self.axes[flexure] = given / np.linalg.norm(given)
            stiffness = 1.0 / np.linalg.norm(given)
            moved.parent.add_joint(name=f"{flexure}/gives", axis=self.axes[flexure], stiffness=stiffness)
        self.loops = [one["name"] for one in toml.get("loop", ())]
        joined = {**{one["name"]: one for one in toml.get("loop", ())}, **toml.get("cylinder", {})}
        for key, one in {**joined, **toml.get("spring", {})}.items():
            for i, (body, at) in enumerate(((one["link"], one["at"]), (one["to"], one["at_to"]))):
                spec.body(body).add_site(name=f"{key}/{i}", pos=at)
        for key, one in toml.get("spring", {}).items():
            tendon = spec.add_tendon(name=key, stiffness=one["rate"], springlength=[one["free_length"]] * 2)
            tendon.wrap_site(f"{key}/0")
            tendon.wrap_site(f"{key}/1")
        for joint in spec.joints:
            joint.armature = 1.0  # for MuJoCo's own checks of the mass matrix; statics does not see it
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.tip = toml["robot"]["tip"]

    def between(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Return (3,) from one end of a loop or cylinder to the other, and (3, nv) its change."""
        ends, ways = [], []
        for i in range(2):
            way = np.zeros((3, self.model.nv))
            mujoco.mj_jacSite(self.model, self.data, way, None, self.model.site(f"{name}/{i}").id)
            ends.append(self.data.site(f"{name}/{i}").xpos.copy())
            ways.append(way)
        return ends[1] - ends[0], ways[1] - ways[0]

    def put(self, at: dict[str, float]) -> np.ndarray:
        """Return (nv,) what springs and weights exert where every joint is at its position."""
        for name, value in at.items():
            self.data.qpos[self.model.joint(name).qposadr[0]] = value
        mujoco.mj_forward(self.model, self.data)
        return self.data.qfrc_passive - self.data.qfrc_bias


@pytest.mark.parametrize("name", ["palletizer", "hybrid_lifter"])
def test_a_bundled_machine_closes_everywhere_and_rests_where_mujoco_has_it(name):
    arm, path = load(name)
    payload = path.payload[0]
    model = Loops(name, payload)
    for q, via in zip(path.q, path.via, strict=True):
        found = arm.deflection(q, payload)
        assert found.flags == ()
        twists = dict(zip(found.names.flexures, found.twists[:, 3:], strict=True))
        gives = {f"{one}/gives": float(twists[one] @ axis) for one, axis in model.axes.items()}
        drives = {one: at for one, at in zip(arm.joint_names, q, strict=True) if one not in found.cylinder_states}
        left = model.put({**drives, **found.passive, **gives})
        for cylinder, (length, tension) in found.cylinder_states.items():
            apart, way = model.between(cylinder)
            assert np.linalg.norm(apart) == pytest.approx(length, abs=1e-9)
            left -= tension * apart @ way / length
        jacobian = np.zeros((0, len(left)))
        for loop in model.loops:
            gap, way = model.between(loop)
            assert np.abs(gap).max() < 1e-9
            jacobian = np.concatenate([jacobian, way])
        if not via:
            continue
        assert np.linalg.norm(model.data.body(model.tip).xpos - found.pose.translation) < 1e-9
        size = max(np.abs(left).max(), np.abs(found.drive_loads).max())
        free = [k for k in range(len(left)) if model.model.joint(k).name not in drives]
        if model.loops:
            left -= jacobian.T @ np.linalg.lstsq(jacobian[:, free].T, left[free], rcond=1e-9)[0]
        assert np.abs(left[free]).max() < 1e-7 * size
        loads = dict(zip(arm.joint_names, found.drive_loads, strict=True))
        for one in drives:
            assert left[model.model.joint(one).dofadr[0]] == pytest.approx(loads[one], abs=1e-7 * size)


def test_cylinders_shorten_as_their_oil_says():
    """Tension is what the oil on both sides, at the commanded length, makes of the change of length."""
    arm, path = load("hybrid_lifter")
    found = arm.deflection(path.q[-1], "t125")
    for name, told in Referee("hybrid_lifter").toml["cylinder"].items():
        commanded = path.q[-1, arm.joint_names.index(name)]
        head, ring = np.pi / 4 * told["bore"] ** 2, np.pi / 4 * (told["bore"] ** 2 - told["rod"] ** 2)
        first = head * (commanded - told["lower"]) + told["dead_volume"]
        second = ring * (told["upper"] - commanded) + told["dead_volume"]
        stiffness = told["bulk_modulus"] * (head**2 / first + ring**2 / second)
        length, tension = found.cylinder_states[name]
        assert tension == pytest.approx(stiffness * (length - commanded), rel=1e-6)
