"""Laws as terms: they are the law, their tangents are its derivatives, and a law that says nothing else is answered
alike and at full speed by the engine, Pinocchio and exported C."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from support.compiled_arm import COMPILER, compiled
from support.effect_arms import INNER, KNOWN, LAWS, locations, plain
from support.small_arms import random_compliance, three_joints

from armflex.conventions import Array
from armflex.errors import MissingCovariateError, UnsupportedError
from armflex.laws import Law, LinearLaw, Row
from armflex.laws.effects.effect import Act, Effect
from armflex.laws.effects.in_arm import BoundTwist
from armflex.laws.effects.location import resolve
from armflex.laws.joint.carried import AtNode
from armflex.laws.law import WithoutParameters, by_wrench
from armflex.laws.terms import Curve, Factor, Of, Term, Terms, part, power, straight, table, tangent_of, twist_of

SIZE = np.repeat([300.0, 500.0], 3)
TWISTS = sorted(name for name, law in LAWS.items() if law.act is Act.TWIST)


@pytest.mark.parametrize("name", TWISTS)
def test_the_terms_of_an_effect_are_its_twist(name: str) -> None:
    law, arm, rng = LAWS[name], plain(), np.random.default_rng(0)
    known = {
        column: rng.choice([-1.0, 0.0, 1.0], 5) if column.startswith("approach") else value + rng.normal(size=5)
        for column, value in KNOWN.items()
    }
    row = Row(rng.normal(size=(5, 6)), arm.joint_index, known)
    for location in locations(law)[:30]:
        values = [rng.normal() if i in location.terms else 0.0 for i in range(len(law.amplitudes))]
        effect = Effect(law, location, (*values, *(INNER[one.name] for one in law.inner)))
        here = BoundTwist(effect, resolve(location, arm.robot, arm.flexures))
        if effect.state is not None:
            row.covariates[effect.state] = rng.normal(size=5)  # pyright: ignore[reportIndexIssue]
        wrench = SIZE * rng.normal(size=(5, 6))
        wanted = values @ law.twists(here.here, wrench, row, effect.inner)
        np.testing.assert_allclose(
            twist_of(here.terms(), wrench, row), wanted, rtol=1e-9, atol=1e-12 * abs(wanted).max()
        )
        each = [term for some in law.terms(here.here, effect.inner) for term in some]
        assert law.loaded == any(term.loaded for term in each)


def test_the_tangent_of_every_feature_is_its_derivative() -> None:
    rng, row = np.random.default_rng(1), Row(np.array([0.4]), {"J": 0}, {"heat": np.array(3.0)})
    form = random_compliance(2) * 1e3
    ways = [
        part(rng.normal(size=6) / SIZE, kind, 0.2)
        for kind in (Curve.PART, Curve.SIZE, Curve.CLIPPED, Curve.TANH, Curve.RAMP)
    ]
    features = [
        *ways,
        power(form, 0.5),
        power(form, -0.5, 1.0),
        power(form, 1.3, 0.1),
        power(rng.normal(size=(6, 6)), 1.0),
    ]
    factors = (Factor(Of.CREEP, "heat", (2.0,)), Factor(Of.POWER, "q_J", (0.1, 2.0, 2.0)))
    for feature in features:
        for matrix in (None, random_compliance(3)):
            term = Term(rng.normal(size=6), matrix, features=(feature, ways[0]), factors=factors)
            for wrench in SIZE * rng.normal(size=(10, 6)):
                wanted = by_wrench(lambda w, at, term=term: twist_of([term], w, at), wrench, row)
                found = tangent_of([term], wrench, row)
                np.testing.assert_allclose(found, wanted, rtol=2e-4, atol=1e-6 * abs(wanted).max())


@dataclass(frozen=True)
class OneSided(WithoutParameters):
    """A joint that is softer one way about its y axis, and the more the warmer it is: said by its terms alone."""

    compliance: Array
    column: str = ""

    def terms(self) -> Terms:
        way = np.eye(6)[4]
        factors = (Factor(Of.POWER, self.column, (20.0, 10.0, 1.0)),) if self.column else ()
        bent = Term(
            np.zeros(6),
            0.3 * self.compliance * np.outer(way, way),
            features=(part(way / 80.0, Curve.TANH),),
            factors=factors,
        )
        return straight(self.compliance), bent


@pytest.mark.parametrize("column", ["", "temperature"])
def test_a_law_by_its_terms_alone_is_answered_by_both_engines(tmp_path: Path, column: str) -> None:
    one: Law = OneSided(random_compliance(1), column)
    arm = three_joints(tmp_path, [one, AtNode(one, np.array([0.1, 0.0, 0.2])), LinearLaw(random_compliance(3))])
    assert not arm.stack.asked  # nothing is asked of Python in a row: the engine has it in numbers
    rng = np.random.default_rng(2)
    q, heat = rng.uniform(-1.0, 1.0, (60, 3)), rng.uniform(15.0, 30.0, 60)
    known = {"temperature": heat} if column else {}
    many, loop = arm.deflection(q, covariates=known).displacement, arm.prepared()
    for i in (0, 7, 59):
        now = {name: float(values[i]) for name, values in known.items()}
        exact = arm.deflection(q[i], covariates=now, method="newton").displacement
        np.testing.assert_allclose(many[i], exact, rtol=0, atol=1e-12)
        np.testing.assert_allclose(loop(q[i], **now), exact, rtol=0, atol=1e-12)
    plainly = three_joints(tmp_path, [LinearLaw(random_compliance(1))] * 2 + [LinearLaw(random_compliance(3))])
    assert np.abs(many - plainly.deflection(q).displacement).max() > 1e-6


@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")
def test_a_law_by_its_terms_alone_is_exported(tmp_path: Path) -> None:
    one = OneSided(random_compliance(1))
    arm = three_joints(tmp_path, [one, AtNode(one, np.array([0.1, 0.0, 0.2])), LinearLaw(random_compliance(3))])
    code, q = compiled(arm, tmp_path), np.random.default_rng(4).uniform(-1.0, 1.0, (20, 3))
    codes, poses = code.tips(q, np.zeros(20, dtype=int))
    assert not codes.any()
    wanted = [arm.deflection(row).pose.homogeneous[:3] for row in q]
    np.testing.assert_allclose(poses, wanted, rtol=0, atol=1e-12)


@dataclass(frozen=True)
class Curved(WithoutParameters):
    """A joint that is as soft as a curve over its position says, and turns by another that closes."""

    compliance: Array

    def terms(self) -> Terms:
        open_ = table("q_yaw", -0.6, 0.4, [0.5, 1.0, 0.7, 1.2])
        closed = table("q_yaw", 0.0, 1.3, [1.0, -2.0, 0.5], True)
        return [straight(self.compliance, open_), Term(1e-5 * np.eye(6)[5], factors=(closed,))]


@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")
def test_a_curve_over_a_position_is_exported(tmp_path: Path) -> None:
    arm = three_joints(tmp_path, [Curved(random_compliance(i)) for i in range(3)])
    code, q = compiled(arm, tmp_path), np.random.default_rng(4).uniform(-1.0, 1.0, (40, 3))
    codes, poses = code.tips(q, np.zeros(40, dtype=int))
    assert not codes.any()
    wanted = [arm.deflection(row, method="newton").pose.homogeneous[:3] for row in q]
    np.testing.assert_allclose(poses, wanted, rtol=0, atol=1e-12)
    assert np.abs(arm.deflection(q).displacement - arm.deflection(np.zeros_like(q)).displacement).max() > 1e-5


def test_a_missing_column_of_a_term_is_named_with_its_effect(tmp_path: Path) -> None:
    law = LAWS["slip_step"]
    arm = replace(plain(), effects=(Effect(law, locations(law)[0], (1e-9, 10.0)),))
    with pytest.raises(MissingCovariateError, match="slip_step"):
        arm.deflection(np.zeros((500, 6)))


def test_a_law_without_terms_says_why() -> None:
    class Odd(WithoutParameters):
        def twist(self, wrench: Array, row: Row) -> Array:
            return 1e-9 * np.arctan(wrench)

    with pytest.raises(UnsupportedError, match="is a Odd, which has no form in C"):
        Odd().terms()
    assert Odd().known_terms is None
