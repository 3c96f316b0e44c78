"""Composed joints against the paper's condensation, beam theory, and somebody else's root finder."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import root
from support.small_arms import ROBOTS, central_difference, line_of, one_joint, random_compliance, skew_parts, write
from support.structures import SPRING, STEEL, UP, nonlinear
from support.two_links import GOOD

from armflex import load_arm
from armflex.errors import ArmFileError, LawError, UnknownNameError
from armflex.laws import AtNode, Beam, LinearFit, LinearLaw, PositionDependentLaw, Row, Section, StructuralLaw, SubJoint

ROW = Row(np.zeros(1), {"j": 0})
RIGID = LinearLaw(np.zeros((6, 6)))


# The paper's joint: nodes of three components, sub-joints 1 and 2, beams 3 and 4 to the tip node 3.


def paper_structure() -> tuple[StructuralLaw, np.ndarray]:
    """Return the law and the compliance K^-1 with K = K22 - K21 K11^-1 K12, assembled here by hand."""
    places = {"1": np.zeros(3), "2": np.array([0.0, 0.4, 0.1]), "3": np.array([0.9, 0.15, -0.1])}
    third, fourth = STEEL, replace(STEEL, A=2e-3, Iy=4e-6, Iz=1e-6)
    joints = [random_compliance(i)[:3, :3] for i in (1, 2)]
    subs = tuple(
        SubJoint(n, LinearLaw(np.kron(np.diag([1, 0]), c)), (0, 1, 2)) for n, c in zip("12", joints, strict=True)
    )
    beams = (Beam("1", "3", third, UP), Beam("2", "3", fourth, UP))
    law = StructuralLaw(places, "3", subs, beams, components=3)

    k3, k4 = beam_block(third, places["3"] - places["1"]), beam_block(fourth, places["3"] - places["2"])
    k1, k2 = (np.linalg.inv(c) for c in joints)
    zero = np.zeros((3, 3))
    upper = np.block([[k1 + k3, zero], [zero, k2 + k4]])  # K11: nodes 1 and 2
    across = np.vstack([-k3, -k4])  # K12: K13^3 above, K23^4 below
    condensed = (k3 + k4) - across.T @ np.linalg.inv(upper) @ across
    return law, np.linalg.inv(condensed)


def beam_block(section: Section, along: np.ndarray) -> np.ndarray:
    """EA/L along the beam, 12 E I / L^3 across it; z is the direction across nearest to up."""
    length = np.linalg.norm(along)
    x = along / length
    z = UP - (UP @ x) * x
    z /= np.linalg.norm(z)
    y = np.cross(z, x)
    bending = 12 * section.E / length**3
    return (
        section.E * section.A / length * np.outer(x, x)
        + bending * section.Iz * np.outer(y, y)
        + bending * section.Iy * np.outer(z, z)
    )


def test_the_papers_condensation():
    law, expected = paper_structure()
    np.testing.assert_allclose(law.constant[:3, :3], expected, rtol=1e-10)
    assert not law.constant[3:].any() and not law.constant[:, 3:].any()
    wrench = np.array([1e3, -2e3, 5e2, 0, 0, 0])
    np.testing.assert_allclose(law.twist(wrench, ROW)[:3], expected @ wrench[:3], rtol=1e-10)


# A cantilever of six components on a rigid sub-joint.

LENGTH = 1.3
BENDING = {
    "force along": (0, {0: LENGTH / (STEEL.E * STEEL.A)}),
    "force across, y": (1, {1: LENGTH**3 / (3 * STEEL.E * STEEL.Iz), 5: LENGTH**2 / (2 * STEEL.E * STEEL.Iz)}),
    "force across, z": (2, {2: LENGTH**3 / (3 * STEEL.E * STEEL.Iy), 4: -(LENGTH**2) / (2 * STEEL.E * STEEL.Iy)}),
    "torque": (3, {3: LENGTH / (STEEL.G * STEEL.J)}),
    "moment about y": (4, {4: LENGTH / (STEEL.E * STEEL.Iy), 2: -(LENGTH**2) / (2 * STEEL.E * STEEL.Iy)}),
    "moment about z": (5, {5: LENGTH / (STEEL.E * STEEL.Iz), 1: LENGTH**2 / (2 * STEEL.E * STEEL.Iz)}),
}


def cantilever(direction: np.ndarray, up: np.ndarray, pieces: int = 1, root_law=RIGID) -> StructuralLaw:
    """Return a beam of `pieces` from the origin along a direction, held at its root."""
    nodes = {str(i): direction * LENGTH * i / pieces for i in range(pieces + 1)}
    beams = tuple(Beam(str(i), str(i + 1), STEEL, up) for i in range(pieces))
    return StructuralLaw(nodes, str(pieces), (SubJoint("0", root_law),), beams)


def at_tip(law: StructuralLaw) -> np.ndarray:
    """Return the compliance at the tip node itself, from that at the flexure's origin."""
    node = pin.SE3(np.eye(3), np.asarray(law.nodes[law.tip])).actionInverse
    return node @ law.constant @ node.T


@pytest.mark.parametrize("pieces", [1, 4])
@pytest.mark.parametrize(("component", "expected"), BENDING.values(), ids=BENDING)
def test_cantilever_against_euler_bernoulli(component, expected, pieces):
    column = at_tip(cantilever(np.array([1.0, 0, 0]), UP, pieces))[:, component]
    theory = np.zeros(6)
    theory[list(expected)] = list(expected.values())
    np.testing.assert_allclose(column, theory, rtol=1e-7, atol=1e-9 * np.abs(theory).max())


@pytest.mark.parametrize("rpy", [(0, 0, 1.0), (0.4, -0.7, 2.0), (0, np.pi / 2, 0)])
def test_cantilever_in_any_direction(rpy):
    turn = pin.rpy.rpyToMatrix(*rpy)
    straight = at_tip(cantilever(np.array([1.0, 0, 0]), UP))
    turned = at_tip(cantilever(turn[:, 0], turn[:, 2]))
    both = np.kron(np.eye(2), turn)
    np.testing.assert_allclose(turned, both @ straight @ both.T, rtol=1e-7, atol=1e-9 * np.abs(straight).max())


def test_a_soft_root_in_series_with_the_beam():
    """Compliances add when the root's is carried to the tip."""
    soft = random_compliance(4)
    carried = pin.SE3(np.eye(3), np.array([LENGTH, 0, 0])).actionInverse
    expected = at_tip(cantilever(np.array([1.0, 0, 0]), UP)) + carried @ soft @ carried.T
    got = at_tip(cantilever(np.array([1.0, 0, 0]), UP, root_law=LinearLaw(soft)))
    np.testing.assert_allclose(got, expected, rtol=1e-7, atol=1e-9 * np.abs(expected).max())


# Two bearings and a drive.

HALF, RADIAL, DRIVE = 0.2, 2e-9, 3e-7


def bearings() -> StructuralLaw:
    """Two spherical bearings at z = +-h hold translations, a drive holds the turn about z; all but rigid beams."""
    shaft = replace(STEEL, E=1e7 * STEEL.E, G=1e7 * STEEL.G)
    nodes = {"up": np.array([0, 0, HALF]), "down": np.array([0, 0, -HALF]), "flange": np.zeros(3)}
    seat, drive = LinearLaw(np.diag([RADIAL] * 3 + [0] * 3)), LinearLaw(np.diag([0, 0, 0, 0, 0, DRIVE]))
    subs = (SubJoint("up", seat, (0, 1, 2)), SubJoint("down", seat, (0, 1, 2)), SubJoint("flange", drive, (5,)))
    along = np.array([1.0, 0, 0])
    return StructuralLaw(
        nodes, "flange", subs, (Beam("down", "flange", shaft, along), Beam("flange", "up", shaft, along))
    )


def test_two_bearings_and_a_drive_by_hand():
    """A couple M about x loads the bearings by +-M / 2h, which turns the shaft by C M / 2 h^2."""
    expected = np.diag([RADIAL / 2] * 3 + [RADIAL / (2 * HALF**2)] * 2 + [DRIVE])
    np.testing.assert_allclose(bearings().constant, expected, rtol=1e-6, atol=1e-14)


@pytest.mark.parametrize("factor", [1e-9, 1e-3, 1e3, 1e9])
def test_whether_it_holds_does_not_depend_on_units(factor):
    law = bearings()
    section = replace(STEEL, E=factor * STEEL.E, G=factor * STEEL.G)
    beams = tuple(replace(beam, section=section) for beam in law.beams)
    assert np.linalg.eigvalsh(replace(law, beams=beams).constant).min() > 0.0
    with pytest.raises(LawError, match="mechanism"):
        replace(law, subjoints=law.subjoints[:2], beams=beams)


def test_bearings_must_be_apart():
    """Without the lower bearing the shaft swings about the upper one."""
    law = bearings()
    with pytest.raises(LawError, match="mechanism"):
        replace(law, subjoints=law.subjoints[::2])


@pytest.mark.parametrize(
    "subjoints",
    [
        (),
        (SubJoint("0", RIGID, (0, 1, 2)),),
        (SubJoint("0", RIGID, (0, 1, 2, 3, 4)),),
        (SubJoint("0", RIGID, (3, 4, 5)),),
    ],
    ids=["free", "ball", "no-drive", "only-turns-held"],
)
def test_a_mechanism_is_refused(subjoints):
    with pytest.raises(LawError, match="mechanism"):
        replace(cantilever(np.array([1.0, 0, 0]), UP), subjoints=subjoints)


def test_nodes_and_beams_must_make_sense():
    nodes = {"0": np.zeros(3), "1": np.array([1.0, 0, 0]), "2": np.zeros(3)}
    ground = (SubJoint("0", RIGID),)
    with pytest.raises(UnknownNameError, match="no node named 'one'"):
        StructuralLaw(nodes, "one", ground, (Beam("0", "1", STEEL, UP),))
    with pytest.raises(LawError, match="has no length"):
        StructuralLaw(nodes, "1", ground, (Beam("0", "1", STEEL, UP), Beam("0", "2", STEEL, UP)))
    with pytest.raises(LawError, match="parallel"):
        StructuralLaw(nodes, "1", ground, (Beam("0", "1", STEEL, np.array([1.0, 0, 0])),))
    with pytest.raises(LawError, match="Iy is -1"):
        replace(STEEL, Iy=-1.0)


# A nonlinear sub-joint.


LOAD = np.array([3e4, -2e4, 5e4, 1e4, -2e4, 1.5e4])


def twist_by_scipy(law: StructuralLaw, wrench: np.ndarray) -> np.ndarray:
    """Return the tip's twist: stiffness laws at the nodes, scipy's own iteration."""
    places = [slice(6 * i, 6 * i + 6) for i in range(3)]
    soft = np.linalg.inv(law.subjoints[1].law.compliance)
    x, y, z = law.nodes["t"]
    at_node = np.concatenate([wrench[:3], wrench[3:] - np.cross([x, y, z], wrench[:3])])

    def unbalanced(scaled: np.ndarray) -> np.ndarray:
        u = scaled * 1e-3
        force = law.beam_stiffness @ u
        force[places[0]] += SPRING.stiffness * u[places[0]] + SPRING.cubic * u[places[0]] ** 3
        force[places[1]] += soft @ u[places[1]]
        force[places[2]] -= at_node
        return force / 1e4

    found = root(unbalanced, np.zeros(18), tol=1e-14)
    assert np.abs(unbalanced(found.x)).max() < 1e-9
    tip = found.x[places[2]] * 1e-3
    return np.concatenate([tip[:3] + np.cross([x, y, z], tip[3:]), tip[3:]])


def test_a_nonlinear_subjoint_against_scipy():
    law = nonlinear()
    assert law.constant is None
    got = law.twist(LOAD, ROW)
    np.testing.assert_allclose(got, twist_by_scipy(law, LOAD), rtol=1e-8, atol=1e-13)
    doubled = law.twist(2 * LOAD, ROW)
    assert np.abs(doubled - 2 * got).max() > 0.05 * np.abs(got).max()  # it is nonlinear here


@pytest.mark.parametrize("factor", [0.0, 1.0, -2.0])
def test_tangent_of_a_nonlinear_structure(factor):
    law = nonlinear()
    step = np.array([100.0] * 3 + [50.0] * 3)
    expected = central_difference(lambda scaled: law.twist(scaled * step, ROW), factor * LOAD / step, 1e-2) / step
    got = law.tangent(factor * LOAD, ROW)
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-6 * np.abs(expected).max())
    np.testing.assert_allclose(got, got.T, atol=1e-12 * np.abs(got).max())


def test_covariance_of_a_structure_is_that_of_its_joint():
    """One uncertain joint on a rigid-like cantilever: its own covariance, carried to the flexure's origin (here: 0)."""
    certain = random_compliance(5)
    law = cantilever(np.array([1.0, 0, 0]), UP, root_law=LinearLaw(certain, relative_std=0.1))
    np.testing.assert_allclose(
        law.covariance(LOAD, ROW), LinearLaw(certain, 0.1).covariance(LOAD, ROW), rtol=1e-6, atol=1e-16
    )
    assert cantilever(np.array([1.0, 0, 0]), UP).covariance(LOAD, ROW) is None


def test_a_nonlinear_structure_in_an_arm(tmp_path):
    """The equilibrium of the arm holds with the law inside it, and its tangent is the derivative."""
    law = nonlinear()
    arm = one_joint(tmp_path, law, (1, 0.1, 0), mass=2000.0)
    result = arm.deflection([0.2])
    np.testing.assert_allclose(result.twists[0], law.twist(result.wrenches[0], ROW), atol=1e-12)
    assert len(arm.deflection([0.2], method="newton").residuals) <= 5 and result.displacement[2] < -1e-4


# A law measured at a node.


def test_transport_from_a_node_is_exact():
    """T exp6(x) T^-1 for a large twist, and the load by the moment about the node."""
    node, compliance = np.array([0.3, -0.2, 0.5]), random_compliance(6, softness=100.0)
    wrench = np.array([3e3, -2e3, 5e3, 1e3, -2e3, 1.5e3])
    at_node = np.concatenate([wrench[:3], wrench[3:] - np.cross(node, wrench[:3])])
    frame = pin.SE3(np.eye(3), node)
    expected = frame * pin.exp6(compliance @ at_node) * frame.inverse()
    got = pin.exp6(AtNode(LinearLaw(compliance), node).twist(wrench, ROW))
    np.testing.assert_allclose(got.homogeneous, expected.homogeneous, atol=1e-14)
    assert np.linalg.norm(pin.log3(got.rotation)) > 0.1


def test_transport_of_tangent_and_covariance():
    node, inner = np.array([0.3, -0.2, 0.5]), LinearLaw(random_compliance(6), relative_std=0.1)
    law = AtNode(inner, node)
    expected = central_difference(lambda wrench: law.twist(wrench, ROW), LOAD, 10.0)
    np.testing.assert_allclose(law.tangent(LOAD, ROW), expected, atol=1e-16)
    np.testing.assert_allclose(law.tangent(LOAD, ROW), law.tangent(LOAD, ROW).T, atol=1e-20)
    carry = np.block([[np.eye(3), skew_parts(node)], [np.zeros((3, 3)), np.eye(3)]])
    inside = inner.covariance(np.concatenate([LOAD[:3], LOAD[3:] - np.cross(node, LOAD[:3])]), ROW)
    np.testing.assert_allclose(law.covariance(LOAD, ROW), carry @ inside @ carry.T, rtol=1e-12)
    assert AtNode(RIGID, node).covariance(LOAD, ROW) is None


def test_doubts_are_about_the_loads_on_the_trained_law():
    """A force with a lever is a moment at the node, and a sub-joint carries what the beam brings it."""
    seen = np.array([[-1e3] * 3 + [-1.0] * 3, [1e3] * 3 + [1.0] * 3])
    fitted = LinearLaw(random_compliance(3), fit=LinearFit(np.zeros((6, 6, 6)), np.zeros(6), seen))
    force = np.array([0, 0, 500.0, 0, 0, 0])
    assert fitted.trained and fitted.flags(force, ROW) == ()
    at_node = AtNode(fitted, np.array([0.1, 0, 0])).flags(force, ROW)
    assert [flag.text[:17] for flag in at_node] == ["load my = 50 Nm i"]
    beyond = cantilever(np.array([1.0, 0, 0]), UP, root_law=fitted).flags(3 * force, ROW)
    assert [flag.text[:38] for flag in beyond] == ["sub-joint at '0': load fz = 1500 N is "]
    certain = cantilever(np.array([1.0, 0, 0]), UP)
    assert not certain.trained and certain.flags(force, ROW) == () and not AtNode(RIGID, np.zeros(3)).trained


# The bundled mast: guide rollers and a cantilever that lengthens.


def mast() -> PositionDependentLaw:
    return load_arm(ROBOTS / "tarm_like" / "arm.toml").flexures[0].law


@pytest.mark.parametrize("extension", [0.0, 1.5, 3.0, 6.0])
def test_the_bundled_mast_is_rollers_and_a_cantilever(extension):
    """The formulas in its arm.toml, from our own beam: hanging along -z, clamped at the top."""
    length = 1.0 + extension
    section = Section(E=210e9, G=81e9, A=0.0330, Iy=2.606e-3, Iz=2.606e-3, J=3.908e-3)
    nodes = {"top": np.array([0, 0, length]), "end": np.zeros(3)}
    beam = StructuralLaw(nodes, "end", (SubJoint("top", RIGID),), (Beam("top", "end", section, np.array([1.0, 0, 0])),))
    rollers = np.diag(1 / np.array([4e6, 4e6, 3e8, 3e7, 3e7, 2e7]))
    compliance = mast().compliance(Row(np.array([extension]), {"M1": 0}))
    np.testing.assert_allclose(compliance, rollers + beam.constant, rtol=1e-5, atol=1e-15)
    np.testing.assert_array_equal(compliance, compliance.T)
    assert np.linalg.eigvalsh(compliance).min() > 1e-9


def test_a_push_bends_the_hanging_mast_the_right_way():
    """+x bends the end towards +x and turns it back about y; +y turns it forward about x."""
    row = Row(np.array([4.0]), {"M1": 0})
    pushed, aside = (mast().twist(np.eye(6)[i] * 1e4, row) for i in (0, 1))
    assert pushed[0] > 0 > pushed[4] and not pushed[[1, 2, 3, 5]].any()
    assert aside[1] > 0 and aside[3] > 0 and not aside[[0, 2, 4, 5]].any()


def test_a_batch_of_positions_and_loads():
    law, q, wrenches = mast(), np.array([[0.0], [2.0], [6.0]]), np.outer([1, 2, 3], LOAD)
    batch = law.twist(wrenches, Row(q, {"M1": 0}))
    for i in range(3):
        np.testing.assert_allclose(batch[i], law.twist(wrenches[i], Row(q[i], {"M1": 0})), rtol=1e-14)


# As declared in an arm.toml.

DECLARED = """[robot]
urdf = "robot.urdf"
tip = "tool"
gravity = [0.0, 0.0, -9.81]

[flexure.S]
joint = "shoulder"
model = "structural"
tip = "flange"
nodes = { up = [0.0, 0.2, 0.0], down = [0.0, -0.2, 0.0], flange = [0.0, 0.0, 0.0] }

[[flexure.S.subjoint]]
at = "up"
holds = ["dx", "dy", "dz"]
compliance = [2e-9, 2e-9, 2e-9, 0.0, 0.0, 0.0]

[[flexure.S.subjoint]]
at = "down"
holds = ["dx", "dy", "dz"]
compliance = [2e-9, 2e-9, 2e-9, 0.0, 0.0, 0.0]

[[flexure.S.subjoint]]
at = "flange"
holds = ["ry"]
compliance = [0.0, 0.0, 0.0, 0.0, 3e-7, 0.0]

[[flexure.S.beam]]
between = ["down", "flange"]
E = 2.1e18
G = 8.1e17
A = 3.3e-3
Iy = 2.6e-6
Iz = 1.7e-6
J = 3.9e-6

[[flexure.S.beam]]
between = ["flange", "up"]
E = 2.1e18
G = 8.1e17
A = 3.3e-3
Iy = 2.6e-6
Iz = 1.7e-6
J = 3.9e-6
"""


def test_two_bearings_and_a_drive_as_declared(tmp_path):
    write(tmp_path, GOOD)
    (flexure,) = load_arm(write(tmp_path, DECLARED, "arm.toml")).flexures
    expected = np.diag([1e-9, 1e-9, 1e-9, 2.5e-8, 3e-7, 2.5e-8])
    np.testing.assert_allclose(flexure.law.constant, expected, rtol=1e-6, atol=1e-14)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('holds = ["ry"]', 'holds = ["yaw"]', "holds: expected some of dx"),
        ('at = "up"', 'at = "upp"', r"no node named 'upp', did you mean 'up'"),
        ('["down", "flange"]', '["down", "flang"]', r"no node named 'flang', did you mean 'flange'"),
        ('["down", "flange"]', '["down"]', "two node names"),
        ('["down", "flange"]', "[1, 3]", "expected texts"),
        ('["down", "flange"]', '["down", "down"]', r"beam\] between: .* has no length"),
        ('holds = ["ry"]', 'holds = ["ry", ["dx"]]', "expected texts"),
        ('tip = "flange"', 'tip = "flang"', r"S\] tip: no node named 'flang'"),
        ('tip = "flange"', 'tip = "flange"\ncomponents = 3.7', "expected 3 or 6, got 3.7"),
        (
            'at = "flange"',
            'at = "flange"\nmodel = "position_dependent"\ndepends_on = "elbo"',
            "depends_on: 'elbo' is no driven joint of the chain, did you mean 'elbow'",
        ),
        (
            'at = "flange"',
            'at = "flange"\nmodel = "position_dependent"\ncompliance_q1 = [0.0, 0.0, 0.0, 0.0, -1e-6, 0.0]',
            "subjoint.*negative",
        ),
        ('holds = ["ry"]', 'holds = ["rx"]', "mechanism"),
        ('tip = "flange"', 'tip = "flange"\ncomponents = 4', "expected 3 or 6"),
        ('at = "flange"', 'at = "flange"\nhold = 1', "unknown key, did you mean 'holds'"),
    ],
)
def test_declared_structures_that_cannot_be(tmp_path, old, new, words):
    assert DECLARED.count(old) == 1
    write(tmp_path, GOOD)
    with pytest.raises(ArmFileError, match=words):
        load_arm(write(tmp_path, DECLARED.replace(old, new), "arm.toml"))


@pytest.mark.parametrize(
    ("old", "new"),
    [('at = "down"', 'at = "ghost"'), ('holds = ["ry"]', 'holds = ["up"]'), ('at = "flange"', 'att = "flange"'),
     ('["flange", "up"]', '["flange", "u"]'), ('["flange", "up"]', '["flange", "up"]\nup = [0, 1, 0]')],
)  # fmt: skip
def test_the_right_one_of_several_tables_is_blamed(tmp_path, old, new):
    write(tmp_path, GOOD)
    text = DECLARED.replace(old, new)
    with pytest.raises(ArmFileError) as caught:
        load_arm(write(tmp_path, text, "arm.toml"))
    assert caught.value.place.line == line_of(text, new.splitlines()[-1])


def test_a_number_of_the_second_beam_is_blamed_where_it_stands(tmp_path):
    write(tmp_path, GOOD)
    head, tail = DECLARED.rsplit("Iy = 2.6e-6", 1)
    text = f"{head}Iy = -1.0{tail}"
    with pytest.raises(ArmFileError, match="Iy: expected more than 0, got -1") as caught:
        load_arm(write(tmp_path, text, "arm.toml"))
    assert caught.value.place.line == line_of(text, "Iy = -1.0")
