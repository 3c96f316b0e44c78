"""MuJoCo as referee of what hangs beside the chain: what the torso carries with another arm where the row has it."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from support.two_arms import beside, two_arms, urdf

from armflex.rows.branch import branches

STIFF = f"compliance = {[1e-18] * 6}"


@pytest.mark.slow
def test_a_torso_carries_a_second_arm_where_a_row_has_it(tmp_path: Path) -> None:
    # All but rigid, so that loads are those of the arm as MuJoCo has it; gravity askew, so that every drive is loaded.
    arm = two_arms(tmp_path, instead={"compliance = [": STIFF, "gravity": "gravity = [3.0, -2.0, -9.1]"})
    text = urdf().replace("</robot>", '<mujoco><compiler fusestatic="false" boundmass="1e-14"/></mujoco></robot>')
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.gravity, model.dof_armature = arm.robot.gravity, 1.0  # statics does not see the second
    data, at = mujoco.MjData(model), beside(8)
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (8, 3))
    found = arm.deflection(q, wrenches=branches(arm.robot, at))
    torso = model.body("torso").id
    for i in range(8):
        posed = {**dict(zip(arm.joint_names, q[i], strict=True)), **{name: values[i] for name, values in at.items()}}
        posed["to_finger"] = 0.5 * posed["to_other_slide"]
        for name, value in posed.items():
            data.qpos[model.joint(name).qposadr[0]] = value
        mujoco.mj_forward(model, data)
        held = [-data.qfrc_bias[model.joint(name).dofadr[0]] for name in arm.joint_names]
        np.testing.assert_allclose(found.drive_loads[i], held, rtol=0, atol=1e-9)
        turn, weight = data.xmat[torso].reshape(3, 3), model.body_subtreemass[torso] * arm.robot.gravity
        moment = np.cross(data.subtree_com[torso] - data.xpos[torso], weight)
        np.testing.assert_allclose(found.wrenches[i, 0], [*turn.T @ weight, *turn.T @ moment], rtol=0, atol=1e-9)
