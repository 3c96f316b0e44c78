"""MuJoCo as referee of springs between links: hinges with stiffness behind the drives, tendons between sites.

Its own equation, springs and tendons against gravity, is compared at armflex's equilibrium, and solved here by itself.
"""

import mujoco
import numpy as np
import pytest
from scipy.optimize import root
from support.small_arms import spaced
from support.sprung_arm import BALANCER, BODIES, JOINTS, SOFTNESS, TIE, TOOL, sprung

from armflex.mechanics.spring import CoilSpring, Spring

SPRINGS = (BALANCER, TIE)


def tendon(spring: Spring) -> str:
    """Return a spring as a tendon; a preload is a longer or shorter free length."""
    law = spring.law
    assert isinstance(law, CoilSpring)
    free = law.length - law.preload / law.stiffness
    sites = "".join(f'<site site="{spring.name}/{link}"/>' for link, _ in spring.ends)
    return f'<spatial stiffness="{law.stiffness!r}" springlength="{free!r}">{sites}</spatial>'


def machine() -> mujoco.MjModel:
    """Return the arm with a hinge that gives behind every driven one, about the same axis."""
    sites = {name: "" for name in ("base", *BODIES)}
    for spring in SPRINGS:
        for link, point in spring.ends:
            sites[link] += f'<site name="{spring.name}/{link}" pos="{spaced(point)}"/>'
    text = f'<site name="tool" pos="{spaced(TOOL)}"/>'
    for name, (_, child, place, axis) in reversed(JOINTS.items()):
        mass, com = BODIES[child]
        inner = f'<inertial mass="{mass}" pos="{spaced(com)}" diaginertia="1 1 1"/>{sites[child]}{text}'
        hinges = f'<joint name="{name}" axis="{spaced(axis)}"/>'
        hinges += f'<joint name="{name}/gives" axis="{spaced(axis)}" stiffness="{1.0 / SOFTNESS[name]!r}"/>'
        text = f'<body pos="{spaced(place)}">{hinges}{inner}</body>'
    tendons = "".join(map(tendon, SPRINGS))
    option = '<compiler angle="radian" autolimits="false"/><option gravity="0 0 -9.81"/>'
    world = f"<worldbody>{sites['base']}{text}</worldbody>"
    return mujoco.MjModel.from_xml_string(f"<mujoco>{option}{world}<tendon>{tendons}</tendon></mujoco>")


def residual(model: mujoco.MjModel, data: mujoco.MjData, q: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Return the (3,) torque that is left at the hinges that give [Nm]."""
    data.qpos[::2], data.qpos[1::2], data.qvel[:] = q, turns, 0.0
    mujoco.mj_forward(model, data)
    return (data.qfrc_passive - data.qfrc_bias)[1::2]


@pytest.mark.parametrize("seed", range(6))
def test_an_arm_with_springs_rests_where_mujoco_has_it(seed, tmp_path):
    arm, model = sprung(tmp_path, SPRINGS), machine()
    data, q = mujoco.MjData(model), np.random.default_rng(seed).uniform(-1.2, 1.2, 3)
    found = arm.deflection(q)
    about = [found.twists[i, 3:] @ axis for i, (*_, axis) in enumerate(JOINTS.values())]
    moments = [found.wrenches[i, 3:] @ axis for i, (*_, axis) in enumerate(JOINTS.values())]
    # Its own equation, where armflex has the arm, and where it has the arm itself.
    assert np.abs(residual(model, data, q, np.array(about))).max() < 1e-7 * np.abs(moments).max()
    assert np.abs(data.ten_length - found.spring_states[:, 0]).max() < 1e-9
    rest = root(lambda turns: residual(model, data, q, turns) * 1e-4, np.zeros(3), tol=1e-14).x
    residual(model, data, q, rest)
    assert np.linalg.norm(data.site("tool").xpos - found.pose.translation) < 1e-9
    assert np.abs(rest - about).max() < 1e-9
    np.testing.assert_allclose(
        found.spring_states[:, 1], [s.law.tension(x) for s, x in zip(SPRINGS, data.ten_length, strict=True)], rtol=1e-7
    )
    without = sprung(tmp_path, ()).deflection(q)
    assert np.linalg.norm(without.displacement[:3] - found.displacement[:3]) > 1e-3
