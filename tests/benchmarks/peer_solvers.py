"""The boom at rest as other programs find it: Pinocchio by hand, MuJoCo and Exudyn, each the fastest way we know.

Every function builds a model of a `Boom` once and returns a call that goes from straight springs to the tip's (3,)
position [m]. The posture is part of the model, which armflex is not granted: it is asked with q.
"""

from collections.abc import Callable

import numpy as np
import pinocchio as pin
from boom import Boom

from armflex.conventions import Array

Solve = Callable[[], Array]
SETTLED = 1e-13
"""Largest change of a spring from one step to the next [m, rad] at which a peer stops."""
MOST_STEPS = 5000
DRIVEN = ("PX", "PY", "PZ", "RX", "RY", "RZ")


def by_hand(boom: Boom) -> tuple[pin.Model, Array, pin.SE3]:
    """Return a Pinocchio model with a joint for every spring, their (n,) stiffnesses, and the tip on the last."""
    model, parent, stiffness = pin.Model(), 0, []
    model.gravity.linear = boom.gravity
    for station in boom.stations:
        here = pin.SE3(station.placement)
        for axis in station.springs:
            kind = getattr(pin, f"JointModel{DRIVEN[axis]}")()
            parent, here = model.addJoint(parent, kind, here, f"{model.njoints}"), pin.SE3.Identity()
            stiffness.append(1.0 / station.compliance[axis])
        model.appendBodyToJoint(parent, pin.Inertia(station.mass, station.com, np.eye(3) * station.mass * 0.1), here)
    return model, np.array(stiffness), pin.SE3(np.eye(3), boom.tip)


def pinocchio_newton(boom: Boom) -> Solve:
    """Newton with Pinocchio's derivative of gravity: also what the others are judged by."""
    model, stiffness, tip = by_hand(boom)
    data, diagonal = model.createData(), np.diag(stiffness)

    def solve() -> Array:
        x = np.zeros(model.nv)
        for _ in range(50):
            residual = stiffness * x + pin.computeGeneralizedGravity(model, data, x)
            slope = pin.computeGeneralizedGravityDerivatives(model, data, x)
            step = np.linalg.solve(diagonal + slope, residual)
            x = x - step
            if np.abs(step).max() < SETTLED:
                break
        pin.forwardKinematics(model, data, x)
        return data.oMi[model.njoints - 1].act(tip.translation)

    return solve


def pinocchio_fixed_point(boom: Boom) -> Solve:
    """A dozen lines that a user of Pinocchio would write."""
    model, stiffness, tip = by_hand(boom)
    data, minus_compliance = model.createData(), -1.0 / stiffness

    def solve() -> Array:
        x = np.zeros(model.nv)
        for _ in range(200):
            before, x = x, minus_compliance * pin.computeGeneralizedGravity(model, data, x)
            if np.abs(x - before).max() < SETTLED:
                break
        pin.forwardKinematics(model, data, x)
        return data.oMi[model.njoints - 1].act(tip.translation)

    return solve


def mujoco_model(boom: Boom, damping: float, step: float) -> tuple[object, Array]:
    """Return the model, its springs damped `damping` s times their stiffness, and the (n,) stiffnesses."""
    import mujoco

    spec, stiffness = mujoco.MjSpec(), []
    spec.option.gravity, spec.option.timestep = boom.gravity, step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICIT
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    body = spec.worldbody
    for station in boom.stations:
        rotation = station.placement[:3, :3]
        body = body.add_body(pos=station.placement[:3, 3], quat=pin.Quaternion(rotation).coeffs()[[3, 0, 1, 2]])
        body.mass, body.ipos, body.inertia = station.mass, station.com, np.full(3, 0.1 * station.mass)
        body.explicitinertial = True
        for axis in station.springs:
            kind = mujoco.mjtJoint.mjJNT_SLIDE if axis < 3 else mujoco.mjtJoint.mjJNT_HINGE
            stiffness.append(1.0 / station.compliance[axis])
            body.add_joint(type=kind, axis=np.eye(3)[axis % 3])
    body.add_site(name="tip", pos=boom.tip)
    model = spec.compile()
    model.jnt_stiffness[:], model.dof_damping[:] = stiffness, damping * np.array(stiffness)
    return model, np.array(stiffness)


def mujoco_stepped(boom: Boom, damping: float, step: float) -> Solve:
    """`mj_step` until it rests: implicit, `damping` s times the stiffness, and a step [s] as long as it stands.

    With a step of the damping's own time a step is nearly one of Newton's; with a longer one it diverges.
    """
    import mujoco

    model, _ = mujoco_model(boom, damping, step)
    data = mujoco.MjData(model)

    def solve() -> Array:
        mujoco.mj_resetData(model, data)
        for _ in range(MOST_STEPS):
            mujoco.mj_step(model, data)
            if np.abs(data.qvel).max() < SETTLED:
                break
        mujoco.mj_kinematics(model, data)
        return data.site_xpos[0].copy()

    return solve


def mujoco_fixed_point(boom: Boom) -> Solve:
    """MuJoCo's kinematics and bias forces alone, in a loop of our own."""
    import mujoco

    model, stiffness = mujoco_model(boom, damping=1.0, step=0.1)
    data, minus_compliance, bias = mujoco.MjData(model), -1.0 / stiffness, np.zeros(model.nv)

    def solve() -> Array:
        data.qpos[:] = 0.0
        for _ in range(200):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_rne(model, data, 0, bias)
            updated = minus_compliance * bias
            change = np.abs(updated - data.qpos).max()
            data.qpos[:] = updated
            if change < SETTLED:
                break
        mujoco.mj_kinematics(model, data)
        return data.site_xpos[0].copy()

    return solve


def exudyn_static(boom: Boom, modified: bool = False) -> Solve:
    """Exudyn's static solver on a kinematic tree whose joints are held by linear control; Newton full or modified."""
    import exudyn

    system, tip = exudyn_system(boom)
    settings = exudyn.SimulationSettings()
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = 1e9
    settings.staticSolver.verboseMode = 0
    settings.staticSolver.newton.useModifiedNewton = modified
    settings.staticSolver.newton.relativeTolerance = 1e-12
    settings.staticSolver.newton.absoluteTolerance = 1e-12
    settings.linearSolver.solverType = exudyn.LinearSolverType.EXUdense

    def solve() -> Array:
        system.SolveStatic(settings, updateInitialValues=False)
        return np.array(system.GetSensorValues(tip))

    return solve


def exudyn_system(boom: Boom) -> tuple[object, int]:
    """Return the system, and the number of a sensor of the tip's position."""
    import exudyn
    from exudyn.itemInterface import NodeGenericODE2, ObjectKinematicTree, SensorKinematicTree

    system, zero = exudyn.SystemContainer().AddSystem(), [0.0] * boom.freedoms
    starts = {"referenceCoordinates": zero, "initialCoordinates": zero, "initialCoordinates_t": zero}
    node = system.AddNode(NodeGenericODE2(numberOfODE2Coordinates=boom.freedoms, **starts))
    tree = system.AddObject(ObjectKinematicTree(nodeNumber=node, gravity=boom.gravity, **exudyn_links(boom)))
    what = {"outputVariableType": exudyn.OutputVariableType.Position, "writeToFile": False}
    sensor = SensorKinematicTree(objectNumber=tree, linkNumber=boom.freedoms - 1, localPosition=boom.tip, **what)
    tip = system.AddSensor(sensor)
    system.Assemble()
    return system, tip


def exudyn_links(boom: Boom) -> dict[str, object]:
    """Return the arguments of the tree: a link for every spring, the body on a station's last."""
    import exudyn

    kinds = [exudyn.JointType.PrismaticX, exudyn.JointType.PrismaticY, exudyn.JointType.PrismaticZ]
    kinds += [exudyn.JointType.RevoluteX, exudyn.JointType.RevoluteY, exudyn.JointType.RevoluteZ]
    links = []
    for station in boom.stations:
        frame = station.placement
        for axis in station.springs:
            body = station.mass if axis == station.springs[-1] else 0.0
            links.append((kinds[axis], frame, 1.0 / station.compliance[axis], body, station.com))
            frame = np.eye(4)
    return {
        "jointTypes": [kind for kind, *_ in links],
        "linkParents": np.arange(len(links)) - 1,
        "jointTransformations": exudyn.Matrix3DList([frame[:3, :3] for _, frame, *_ in links]),
        "jointOffsets": exudyn.Vector3DList([frame[:3, 3] for _, frame, *_ in links]),
        "linkMasses": [mass for *_, mass, _ in links],
        "linkCOMs": exudyn.Vector3DList([com for *_, com in links]),
        "linkInertiasCOM": exudyn.Matrix3DList([0.1 * mass * np.eye(3) for *_, mass, _ in links]),
        "jointPControlVector": [stiffness for _, _, stiffness, *_ in links],
        "jointDControlVector": [0.0] * len(links),
        "jointPositionOffsetVector": [0.0] * len(links),
        "jointVelocityOffsetVector": [0.0] * len(links),
    }
