"""Every answer of a linearised arm is what the whole arm does when it is changed a little."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest
from support.small_arms import arm_of, joint, link, random_compliance

from armflex import Arm, Flexure, Payload, Wrench
from armflex.conventions import Array
from armflex.laws import Law, LinearLaw, Row
from armflex.laws.effects import CATALOGUE, Effect, Location
from armflex.laws.effects.location import same_site, site_of
from armflex.laws.law import WithoutParameters
from armflex.mechanics.response import Response, respond
from armflex.robot import Corrections

STEP = 1e-5
"""m or rad: central differences are then good to some 1e-10, and Newton's last step to less."""

PAYLOADS = {"light": Payload(5.0, np.array([0.1, 0.0, 0.05])), "heavy": Payload(60.0, np.array([0.2, -0.1, 0.1]))}
WARM = {"temperature": np.array([23.0, 31.0, 12.5]), "approach_lift": np.array([1.0, -1.0, -1.0])}
CARRIED = ("heavy", "none", "light")

EFFECTS = (
    ("stiffening", Location("pitch", "ry", terms=(0, 1)), (3e-10, 2e-13)),
    ("cross_coupling", Location("pitch", "rx", partner="rz"), (3e-7,)),
    ("thermal_softening", Location("roll", None, ("temperature",)), (0.02, 20.0, 0.0)),
    ("backlash", Location("lift", "dz", ("approach_lift",)), (2e-3,)),
    ("link_flexure", Location("link:roll", terms=(3, 4, 5, 8)), (0.0, 0.0, 0.0, 1e-6, 2e-6, 5e-7, 0.0, 0.0, 3e-7)),
    ("base_compliance", Location("base"), (3e-7, *[0.0] * 6)),
    ("link_geometry", Location("tool", "dx", terms=(0,)), (1e-3, 0.0, 0.0, 0.0, 0.0, 0.0)),
    ("umbilical", Location("link:roll"), (900.0, 1.0, 2.0, 3.0, 0.3, 0.8, 0.1, -0.05, 0.2)),
    ("magnetic_pull", Location("tool"), (400.0, 2.5, 0.5, 1.0, 0.2)),
)


def crooked(folder, soft: dict[str, Array], **options) -> Arm:
    """A lift, a yaw behind a fixed mount, a pitch and a roll, with another fixed joint before the tip."""
    parts = [
        link("base", 20.0, (0.1, 0.0, 0.1)),
        joint("lift", "base", "sled", (0.1, -0.05, 0.4), (0.1, 0.05, -0.2), (0, 0, 1), "prismatic"),
        link("sled", 90.0, (0.05, 0.02, 0.2), 4.0),
        joint("mount", "sled", "plate", (0.2, 0.1, 0.1), (0.3, 0.0, 0.1), kind="fixed"),
        link("plate", 12.0, (0.0, 0.05, 0.0)),
        joint("pitch", "plate", "upper", (0.1, 0, 0.5), (0, -0.3, 0.2), (0, 1, 0)),
        link("upper", 60.0, (0.5, 0.05, 0.02), 5.0),
        joint("roll", "upper", "fore", (1.0, 0.02, 0.1), (0.2, 0.1, 0), (0.6, 0, 0.8)),
        link("fore", 30.0, (0.3, -0.04, 0), 2.0),
        joint("flange", "fore", "tool", (0.6, 0.05, 0.1), (0, 0.4, 0), kind="fixed"),
        link("tool", 2.0, (0.0, 0.0, 0.02)),
    ]
    return replace(arm_of(folder, parts, "tool", soft, **options), payloads=PAYLOADS)


def with_all(arm: Arm) -> Arm:
    effects = tuple(Effect(CATALOGUE[name], location, values) for name, location, values in EFFECTS)
    return replace(arm, effects=effects)


def corrected(arm: Arm) -> Arm:
    moved = Corrections({"pitch": 4e-3, "lift": 2e-3}, {"roll": np.full(6, 2e-3)}, {"fore": np.full(4, 0.01)})
    return replace(arm, corrections=moved)


SOFT = {"lift": random_compliance(1), "pitch": random_compliance(2), "roll": random_compliance(3)}
ARMS = {
    "soft": lambda folder: crooked(folder, SOFT),
    "one flexure": lambda folder: crooked(folder, {"pitch": random_compliance(4, 3.0)}),
    "soft mount and tool": lambda folder: crooked(
        folder, {"mount": random_compliance(5), "flange": random_compliance(6), "roll": random_compliance(7)}
    ),
    "corrected": lambda folder: corrected(crooked(folder, SOFT)),
    "effects": lambda folder: with_all(crooked(folder, SOFT)),
    "effects where it is rigid": lambda folder: with_all(corrected(crooked(folder, {"roll": random_compliance(8)}))),
}


@dataclass(frozen=True)
class Given(WithoutParameters):
    """A law with a constant twist and a changed load, beside what it is."""

    law: Law | None
    twisted: Array
    loaded: Array

    def twist(self, wrench: Array, row: Row) -> Array:
        known = 0.0 if self.law is None else self.law.twist(wrench + self.loaded, row)
        return known + self.twisted

    def tangent(self, wrench: Array, row: Row) -> Array:
        return np.zeros((6, 6)) if self.law is None else self.law.tangent(wrench + self.loaded, row)


@pytest.fixture(scope="module", params=ARMS)
def solved(request, tmp_path_factory) -> tuple[Arm, Array, Response]:
    arm = ARMS[request.param](tmp_path_factory.mktemp("arm"))
    q = np.random.default_rng(0).uniform(-1.2, 1.2, (3, 3))
    return arm, q, respond(arm, q, CARRIED, WARM)


def deflected(arm: Arm, q: Array, row: int, wrenches: tuple[Wrench, ...] = ()):
    known = {name: values[row] for name, values in WARM.items()}
    return arm.deflection(q[row], CARRIED[row], covariates=known, wrenches=wrenches)


def motion(change: Callable[[float], Arm], q: Array, row: int, size: float = STEP, **given) -> Array:
    """Return the (6,) motion of the tip per unit of a change, base axes."""
    ends = [deflected(change(side * size), q, row, **given).pose for side in (1.0, -1.0)]
    turn = pin.log3(ends[0].rotation @ ends[1].rotation.T)
    return np.concatenate([ends[0].translation - ends[1].translation, turn]) / (2.0 * size)


def assert_answers(found: Array, change: Callable[[int, float], Arm], q: Array, row: int, size: float = STEP) -> None:
    """Every column of (6, k) answers is the motion per unit of its change."""
    for axis in range(found.shape[1]):
        expected = motion(lambda by, axis=axis: change(axis, by), q, row, size)
        # Relative to the column; below 1e-9 m or rad over the step it is rounding.
        atol = 2e-6 * np.abs(found).max() + 1e-13 / size
        np.testing.assert_allclose(found[:, axis], expected, rtol=0.0, atol=atol)


def loads_of(arm: Arm) -> tuple[Effect, ...]:
    return tuple(effect for effect in arm.effects if effect.law.name in ("umbilical", "magnetic_pull"))


def flexure_at(arm: Arm, site: str) -> int | None:
    """Return the number of the flexure that a twist at a site adds to; None where it comes by itself."""
    place = site_of(site, arm.robot)
    if place.before:
        return None  # the end of a link is outboard of what the link gives
    found = [i for i, flexure in enumerate(arm.modelled) if same_site(flexure.site, place)]
    return found[-1] if found else None


def probed(arm: Arm, site: str, twist: Array) -> Arm:
    """Return the arm with a twist added to what a site gives."""
    known, place = flexure_at(arm, site), site_of(site, arm.robot)
    if known is not None:
        return changed_law(arm, known, twist, np.zeros(6))
    probe = Flexure("probe", place.joint, Given(None, twist, np.zeros(6)), place.before)
    return replace(arm, flexures=(*arm.modelled, probe), effects=loads_of(arm))


def changed_law(arm: Arm, index: int, twisted: Array, loaded: Array) -> Arm:
    flexures = list(arm.modelled)
    flexures[index] = replace(flexures[index], law=Given(flexures[index].law, twisted, loaded))
    return replace(arm, flexures=tuple(flexures), effects=loads_of(arm))


def test_the_tip_is_where_the_arm_has_it(solved):
    arm, q, line = solved
    for row in range(len(q)):
        found = deflected(arm, q, row)
        np.testing.assert_allclose(line.tip[row], found.pose.homogeneous, atol=1e-12)
        np.testing.assert_allclose(line.flexure_wrenches[row], found.wrenches, rtol=1e-9, atol=1e-7)


def test_sites_are_named_from_base_to_tool(solved):
    assert solved[2].sites == ("base", "link:lift", "lift", "link:pitch", "pitch", "link:roll", "roll", "tool")


@pytest.mark.slow
def test_a_twist_at_any_site(solved):
    """Twists of the body: where a flexure is bent already, the exponential's Jacobian is between."""
    arm, q, line = solved
    for row in range(len(q)):
        bent = deflected(arm, q, row).twists
        for site in line.sites:
            known = flexure_at(arm, site)
            turned = np.eye(6) if known is None else pin.Jexp6(pin.Motion(bent[known]))
            found = line.site(site)[row] @ turned
            assert_answers(found, lambda axis, by, site=site: probed(arm, site, by * np.eye(6)[axis]), q, row)


def test_loads_at_every_site(solved):
    arm, q, line = solved
    for row in range(len(q)):
        found = deflected(arm, q, row)
        for index, name in enumerate(arm.joint_names):
            load = pin.Force(found.joint_loads[index])  # inboard of the flexures at the joint
            for flexure, twist in zip(arm.modelled, found.twists, strict=True):
                if same_site(flexure.site, site_of(name, arm.robot)):
                    load = pin.exp6(pin.Motion(twist)).actInv(load)
            np.testing.assert_allclose(line.load_at(name)[row], load.vector, rtol=1e-8, atol=1e-7)
        for site in line.sites:
            known, probe = flexure_at(arm, site), deflected(probed(arm, site, np.zeros(6)), q, row)
            expected = probe.wrenches[-1 if known is None else known]
            np.testing.assert_allclose(line.load_at(site)[row], expected, rtol=1e-8, atol=1e-7)


def test_a_changed_law(solved):
    arm, q, line = solved
    for index in range(len(arm.modelled)):
        assert_answers(
            line.laws[1, :, index],
            lambda axis, by, index=index: changed_law(arm, index, by * np.eye(6)[axis], np.zeros(6)),
            q,
            1,
        )


def test_a_changed_load_of_a_law(solved):
    arm, q, line = solved
    for index in range(len(arm.modelled)):
        assert_answers(
            line.per_load[0, :, index],
            lambda axis, by, index=index: changed_law(arm, index, np.zeros(6), by * np.eye(6)[axis]),
            q,
            0,
            0.1,
        )


def test_a_joint_that_is_elsewhere_than_reported(solved):
    arm, q, line = solved

    def moved(axis: int, by: float) -> Arm:
        known, name = arm.corrections, arm.joint_names[axis]
        offset = {**known.joint_offset, name: known.joint_offset.get(name, 0.0) + by}
        return replace(arm, corrections=replace(known, joint_offset=offset))

    for row in range(len(q)):
        assert_answers(line.joints[row], moved, q, row)


def test_gravity_that_is_otherwise(solved):
    arm, q, line = solved

    def heavier(axis: int, by: float) -> Arm:
        return replace(arm, robot=replace(arm.robot, gravity=arm.robot.gravity + by * np.eye(3)[axis]))

    for row in range(len(q)):
        assert_answers(line.gravity[row], heavier, q, row, 1e-3)


def test_a_load_on_any_link(solved):
    arm, q, line = solved
    for index, name in enumerate(line.link_names):
        for axis in range(6):
            ends = [
                deflected(arm, q, 2, (Wrench(name, *(side * np.eye(6)[axis]).reshape(2, 3)),)).pose
                for side in (1.0, -1.0)
            ]
            turn = pin.log3(ends[0].rotation @ ends[1].rotation.T)
            expected = 0.5 * np.concatenate([ends[0].translation - ends[1].translation, turn])
            atol = 2e-6 * np.abs(line.link_loads[2]).max()
            np.testing.assert_allclose(line.link_loads[2, index, :, axis], expected, rtol=0.0, atol=atol)


def test_links_are_where_the_arm_has_them(solved):
    arm, q, line = solved
    assert line.link_names == ("base", "sled", "plate", "upper", "fore", "tool")
    found = deflected(arm, q, 0)
    flex = found._mechanics.flex
    data = flex.model.createData()
    pin.framesForwardKinematics(flex.model, data, found._configuration)
    for index, name in enumerate(line.link_names):
        np.testing.assert_allclose(line.links[0, index], data.oMf[flex.frame(name)].homogeneous, atol=1e-11)


def test_a_law_that_bends_with_its_load_is_linearised_where_it_is(tmp_path):
    """Twice the stiffening term is twice the answer's change, not a term left at zero load."""
    arm = crooked(tmp_path, {"pitch": np.diag([0, 0, 0, 0, 1e-6, 0])})
    location = Location("pitch", "ry", terms=(0, 1))
    q = np.array([[0.2, 0.3, 0.1]])
    answers = []
    for size in (0.0, 1.0, 2.0):
        effect = Effect(CATALOGUE["stiffening"], location, (size * 1e-10, 0.0))
        bent = replace(arm, effects=(effect,))
        answers.append(respond(bent, q, ["heavy"]).per_load[0, :, 0, 4])
    load = respond(arm, q, ["heavy"]).load_at("pitch")[0, 4]
    rigid = answers[0] / 1e-6
    for size in (1, 2):
        expected = rigid * (1e-6 + 2e-10 * size * abs(load))
        np.testing.assert_allclose(answers[size], expected, atol=2e-3 * np.abs(expected).max())  # the load sags, too


@pytest.mark.slow
def test_payloads_of_one_name_share_a_model_and_others_do_not(tmp_path):
    arm = crooked(tmp_path, {"pitch": LinearLaw(random_compliance(2))})
    q = np.full((4, 3), 0.3)
    together = respond(arm, q, ["heavy", "light", "none", "heavy"])
    np.testing.assert_array_equal(together.tip[0], together.tip[3])
    for row, name in enumerate(("heavy", "light", "none")):
        alone = respond(arm, q[:1], [name])
        np.testing.assert_allclose(alone.twists[0], together.twists[row], rtol=1e-12, atol=1e-14)
