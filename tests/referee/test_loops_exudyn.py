"""Exudyn's static solver as referee of loops, cylinders and springs: a tree with joints and spring-dampers."""

import numpy as np
import pinocchio as pin
import pytest
from support.loop_kinds import CLOSED, PAYLOAD, built
from support.machines import MACHINES, Machine, poses

exudyn = pytest.importorskip("exudyn", reason="pip install 'armflex[bench]'")

PLANE = {"tail": [1, 0, 1]}
"""What of a point is held where across its plane nothing can give."""


HELD = {"spherical": "xyz", "revolute": "xyza", "cylindrical": "xzac", "fixed": "xyzabc", "level": "xz"}
"""Shifts and turns that a loop of a kind about y holds, but for those that nothing answers to: Exudyn has no such."""


def solved(
    machine: Machine,
    q: np.ndarray,
    start: dict[str, float],
    kinds: dict[str, tuple[str, np.ndarray]] | None = None,
    carried: float = 0.0,
) -> np.ndarray:
    """Return the (3,) place of the tip that Exudyn finds.

    Args:
        machine: The machine.
        q: (nq,) positions of its drives [rad or m].
        start: Where passive joints begin; what gives begins at zero.
        kinds: Of the loops, with (3, 3) axes of the other link that are to be those of the first; points where none.
        carried: At the tool [kg].
    """
    from exudyn.itemInterface import (
        MarkerBodyRigid,
        MarkerKinematicTreeRigid,
        NodeGenericODE2,
        ObjectConnectorSpringDamper,
        ObjectGround,
        ObjectJointGeneric,
        ObjectJointSpherical,
        ObjectKinematicTree,
        SensorKinematicTree,
    )

    at = dict(zip(machine.driven, q.tolist(), strict=True))
    links, carrier, begin = [], {"base": (-1, pin.SE3.Identity())}, []

    def add(parent: int, place: pin.SE3, axis: tuple[float, float, float], stiffness: float, first: float) -> int:
        links.append((parent, place, "XYZ"[int(np.argmax(axis))], stiffness))
        begin.append(first)
        return len(links) - 1

    bodies = {}
    for key, hinge in machine.hinges.items():
        parent, place = carrier[hinge.parent]
        place = place * pin.SE3(np.eye(3), np.array(hinge.place))
        if hinge.passive:
            parent, place = add(parent, place, hinge.axis, 0.0, start[key]), pin.SE3.Identity()
        else:
            place = place * pin.SE3(pin.exp3(at[key] * np.array(hinge.axis)), np.zeros(3))
        if key in machine.gives:
            parent, place = add(parent, place, *machine.gives[key], 0.0), pin.SE3.Identity()
        carrier[hinge.child] = parent, place
        mass, com = machine.bodies[hinge.child]
        if parent >= 0:
            bodies.setdefault(parent, []).append((mass, place.act(np.array(com))))
    held, place = carrier[machine.tool[0]]
    bodies.setdefault(held, []).append((carried, place.act(np.array(machine.tool[1]))))
    system, count = exudyn.SystemContainer().AddSystem(), len(links)
    zero = [0.0] * count
    node = system.AddNode(
        NodeGenericODE2(
            numberOfODE2Coordinates=count,
            referenceCoordinates=zero,
            initialCoordinates=begin,
            initialCoordinates_t=zero,
        )
    )
    masses = [sum(mass for mass, _ in bodies.get(i, [])) for i in range(count)]
    centres = [sum((m * c for m, c in bodies.get(i, [])), np.zeros(3)) / (masses[i] or 1.0) for i in range(count)]
    tree = system.AddObject(
        ObjectKinematicTree(
            nodeNumber=node,
            gravity=[0.0, 0.0, -9.81],
            jointTypes=[getattr(exudyn.JointType, f"Revolute{axis}") for _, _, axis, _ in links],
            linkParents=[parent for parent, *_ in links],
            jointTransformations=exudyn.Matrix3DList([place.rotation for _, place, *_ in links]),
            jointOffsets=exudyn.Vector3DList([place.translation for _, place, *_ in links]),
            linkMasses=masses,
            linkCOMs=exudyn.Vector3DList(centres),
            linkInertiasCOM=exudyn.Matrix3DList([np.eye(3)] * count),
            jointPControlVector=[stiffness for *_, stiffness in links],
            jointDControlVector=zero,
            jointPositionOffsetVector=zero,
            jointVelocityOffsetVector=zero,
        )
    )
    ground = system.AddObject(ObjectGround())

    def marker(body: str, point: tuple[float, float, float]) -> int:
        link, place = carrier[body]
        here = place.act(np.array(point))
        if link < 0:
            return system.AddMarker(MarkerBodyRigid(bodyNumber=ground, localPosition=here))
        return system.AddMarker(MarkerKinematicTreeRigid(objectNumber=tree, linkNumber=link, localPosition=here))

    for key, (one, at_one, to, at_to, _) in machine.loops.items():
        ends = [marker(one, at_one), marker(to, at_to)]
        if kinds is None:
            system.AddObject(ObjectJointSpherical(markerNumbers=ends, constrainedAxes=PLANE.get(key, [1, 1, 1])))
            continue
        kind, turn_to = kinds[key]
        first, second = (carrier[link][1].rotation for link in (one, to))
        turns = {"rotationMarker0": first, "rotationMarker1": second @ turn_to}
        axes = [int(axis in HELD[kind]) for axis in "xyzabc"]
        system.AddObject(ObjectJointGeneric(markerNumbers=ends, constrainedAxes=axes, **turns))
    for key, (one, at_one, to, at_to, stiffness, *_) in machine.cylinders.items():
        ends = [marker(one, at_one), marker(to, at_to)]
        system.AddObject(ObjectConnectorSpringDamper(markerNumbers=ends, referenceLength=at[key], stiffness=stiffness))
    for one, at_one, to, at_to, rate, free in machine.springs.values():
        ends = [marker(one, at_one), marker(to, at_to)]
        system.AddObject(ObjectConnectorSpringDamper(markerNumbers=ends, referenceLength=free, stiffness=rate))
    link, place = carrier[machine.tool[0]]
    what = {"outputVariableType": exudyn.OutputVariableType.Position, "writeToFile": False}
    tool = place.act(np.array(machine.tool[1]))
    tip = system.AddSensor(SensorKinematicTree(objectNumber=tree, linkNumber=link, localPosition=tool, **what))
    system.Assemble()
    settings = exudyn.SimulationSettings()
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = 1e9
    settings.staticSolver.verboseMode = 0
    settings.staticSolver.newton.residualMode = 1  # steps, not forces, are small where it ends
    settings.staticSolver.newton.relativeTolerance = 1e-12
    settings.staticSolver.newton.absoluteTolerance = 1e-12
    settings.linearSolver.solverType = exudyn.LinearSolverType.EigenDense  # the other one fails by rounding
    system.SolveStatic(settings, updateInitialValues=False)
    return np.array(system.GetSensorValues(tip))


@pytest.mark.parametrize("row", range(2))
@pytest.mark.parametrize("name", MACHINES)
def test_a_machine_rests_where_exudyn_has_it(name, row, tmp_path):
    q = poses(name)[row]
    if name in ("parallelogram", "uneven"):
        q[0] = 0.0  # Exudyn holds the loop in the plane of the world's axes
    arm = MACHINES[name].load(tmp_path)
    rigid = arm.loaded(None).mechanics.closed(q)
    found = arm.deflection(q)
    assert np.linalg.norm(found.displacement[:3]) > 1e-4
    tip = solved(MACHINES[name], q, dict(zip(found.passive, rigid.tolist(), strict=True)))
    assert np.linalg.norm(tip - found.pose.translation) < 1e-9


@pytest.mark.parametrize("way", [name for name, one in CLOSED.items() if not any(one.gives)])
@pytest.mark.filterwarnings("ignore:ObjectJointGeneric:DeprecationWarning")
def test_a_machine_with_everything_rests_where_exudyn_has_it(way, tmp_path):
    machine, arm = built(CLOSED[way], tmp_path)
    turns, rng = {loop.name: loop.turn_to for loop in arm.robot.linkage.loops}, np.random.default_rng(5)
    kinds = {"tail": (CLOSED[way].kind, turns["tail"]), "level": ("level", turns["level"])}
    for payload, carried in ((None, 0.0), ("p", PAYLOAD)):
        q = np.array([*rng.uniform(-0.5, 0.5, 3), 1.2 + rng.uniform(-0.05, 0.05)])
        found = arm.deflection(q, payload)
        rigid = arm.loaded(payload).mechanics.closed(q)
        tip = solved(machine, q, dict(zip(found.passive, rigid.tolist(), strict=True)), kinds, carried)
        assert np.linalg.norm(tip - found.pose.translation) < 1e-9
