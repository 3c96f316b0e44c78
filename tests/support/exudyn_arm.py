"""A tree that MuJoCo has compiled, built in Exudyn with springs as drives: its linearisation gives frequencies."""

import mujoco
import numpy as np
from scipy.linalg import eigvals

from support.mujoco_arm import Sprung


def exudyn_frequencies(plant: Sprung, q: np.ndarray) -> np.ndarray:
    """Return (m,) natural frequencies [Hz], the slowest first, about where Exudyn's static solver has the arm rest."""
    import exudyn
    from exudyn.itemInterface import NodeGenericODE2, ObjectKinematicTree
    from exudyn.solver import ComputeLinearizedSystem

    model, zero = plant.model, [0.0] * len(plant.dofs)
    number = {int(model.dof_bodyid[dof]): place for place, dof in enumerate(plant.dofs)}
    order = sorted(number)  # MuJoCo numbers parents first
    carrier: dict[int, tuple[int, np.ndarray]] = {0: (-1, np.eye(4))}
    joints, parents, places = [], [], []
    links: list[list[tuple[float, np.ndarray, np.ndarray]]] = [[] for _ in order]
    for body in range(1, model.nbody):
        parent, place = carrier[int(model.body_parentid[body])]
        place = place @ _placed(model.body_pos[body], model.body_quat[body])
        after = np.eye(4)
        if body in number:
            joint = int(model.body_jntadr[body])
            turn = np.eye(4)
            turn[:3, :3] = _to_z(model.jnt_axis[joint])
            slides = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
            joints.append(exudyn.JointType.PrismaticZ if slides else exudyn.JointType.RevoluteZ)
            parents.append(parent)
            places.append(place @ turn)
            parent, after, place = len(joints) - 1, turn.T, np.eye(4)
        place = place @ after
        carrier[body] = parent, place
        if parent >= 0:
            own = place @ _placed(model.body_ipos[body], model.body_iquat[body])
            inertia = own[:3, :3] @ np.diag(model.body_inertia[body]) @ own[:3, :3].T
            links[parent].append((float(model.body_mass[body]), own[:3, 3], inertia))
    drives = [number[body] for body in order]  # of Exudyn's coordinates among the plant's
    masses, centres, inertias = (list(one) for one in zip(*(_together(link) for link in links), strict=True))
    system = exudyn.SystemContainer().AddSystem()
    target = q[drives].tolist()
    node = system.AddNode(
        NodeGenericODE2(
            numberOfODE2Coordinates=len(order),
            referenceCoordinates=zero,
            initialCoordinates=target,
            initialCoordinates_t=zero,
        )
    )
    system.AddObject(
        ObjectKinematicTree(
            nodeNumber=node,
            gravity=model.opt.gravity.tolist(),
            jointTypes=joints,
            linkParents=parents,
            jointTransformations=exudyn.Matrix3DList([one[:3, :3] for one in places]),
            jointOffsets=exudyn.Vector3DList([one[:3, 3] for one in places]),
            linkMasses=masses,
            linkCOMs=exudyn.Vector3DList(centres),
            linkInertiasCOM=exudyn.Matrix3DList(inertias),
            jointPControlVector=plant.stiffness[drives].tolist(),
            jointDControlVector=zero,
            jointPositionOffsetVector=target,
            jointVelocityOffsetVector=zero,
        )
    )
    system.Assemble()
    settings = exudyn.SimulationSettings()
    settings.solution.file.write = False
    settings.staticSolver.verboseMode = 0
    settings.staticSolver.newton.residualMode = 1
    settings.staticSolver.newton.relativeTolerance = 1e-12
    settings.staticSolver.newton.absoluteTolerance = 1e-12
    settings.staticSolver.newton.numericalDifferentiation.relativeEpsilon = 1e-6
    settings.linearSolver.solverType = exudyn.LinearSolverType.EXUdense
    system.SolveStatic(settings, updateInitialValues=True)
    mass, stiffness, _ = ComputeLinearizedSystem(system, settings)
    squares = np.sort(eigvals(stiffness, mass).real)
    return np.sqrt(squares) / (2.0 * np.pi)


def _placed(position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    place, turn = np.eye(4), np.zeros(9)
    mujoco.mju_quat2Mat(turn, quaternion)
    place[:3, :3], place[:3, 3] = turn.reshape(3, 3), position
    return place


def _to_z(axis: np.ndarray) -> np.ndarray:
    """Return a rotation whose third column is an axis."""
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(axis, first), axis])


def _together(parts: list[tuple[float, np.ndarray, np.ndarray]]) -> tuple[float, np.ndarray, np.ndarray]:
    """Return mass, centre and moments of inertia about it [kg, m, kg m^2] of bodies that move together."""
    mass = sum(one for one, _, _ in parts)
    centre = sum((one * place for one, place, _ in parts), np.zeros(3)) / mass
    total = np.zeros((3, 3))
    for one, place, inertia in parts:
        arm = place - centre
        total += inertia + one * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return mass, centre, total
