"""The digest of an object: the same for what says the same, another for anything else, and none for what is unknown."""

import subprocess
import sys
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from support.small_arms import ROBOTS

from armflex import Arm, load_arm
from armflex.errors import DigestError, Flag, InputError
from armflex.laws.joint.perceptron import Layer, PerceptronLaw
from armflex.storage.digest import digest


@dataclass(frozen=True)
class Thing:
    value: object
    where: Path = Path("here")


def doubled(x: float) -> float:
    return 2.0 * x


def made(factor: float):
    return lambda x: factor * x


SAID = [
    *(None, True, 1, 1.0, -0.0, 0.0, 1j, "1", b"1", float("nan"), (), [], {}, set(), frozenset()),
    *((1, 2), [1, 2], ((1,), 2), (1, (2,)), {1: 2}, {"1": 2}, ({1: 2}, {3: 4}), ({1: 2, 3: 4},), {1, 2}),
    *(np.zeros(3), np.zeros((3, 1)), np.zeros(3, dtype=int), np.ones(3), np.array(["a"]), pin.SE3.Identity()),
    *(Thing(1), Thing(2), Thing(None), Thing, doubled, len, partial(doubled, 1.0), partial(doubled, 2.0)),
    *(made(1.0), made(2.0), lambda x: x, lambda x: x + 1, lambda x: x + 2),
]


def test_what_differs_has_another_digest() -> None:
    assert len({digest(value) for value in SAID}) == len(SAID)


def test_what_says_the_same_has_the_same() -> None:
    same = [
        ({"a": 1, "b": 2}, {"b": 2, "a": 1}),
        ({3, 1, 2}, {2, 3, 1}),
        (Thing(1, Path("a")), Thing(1, Path("b"))),
        (np.float64(1.0), 1.0),
        (made(2.0), made(2.0)),
        (np.asfortranarray(np.arange(6.0).reshape(2, 3)), np.arange(6.0).reshape(2, 3)),
        ([Flag("a", "b")], [Flag("c", "d")]),
    ]
    assert [digest(one) == digest(other) for one, other in same] == [True] * len(same)


@pytest.mark.slow
def test_another_process_says_the_same(tarm: Arm) -> None:
    code = (
        "from armflex import load_arm; from armflex.storage.digest import digest; "
        f"print(digest(load_arm({str(TARM)!r})))"
    )
    command = [sys.executable, "-W", "ignore", "-c", code]
    said = subprocess.run(
        command, cwd=ROBOTS.parent, capture_output=True, text=True, check=True, timeout=600
    ).stdout.split()
    assert said == [digest(load_arm(TARM))] and digest(replace(tarm, payload_rating=1.0)) != said[0]


TARM = ROBOTS / "tarm_like" / "arm.toml"


class Unknown:
    """Says nothing."""


LOOP: list = []
LOOP.append(LOOP)


@pytest.mark.parametrize(
    "value", [Unknown(), [1, Unknown()], {"a": Thing(Unknown())}, np.array([None]), LOOP, iter(()), sys.stdout]
)
def test_what_is_unknown_is_refused(value: object) -> None:
    with pytest.raises(DigestError, match="no digest") as caught:
        digest(value)
    assert isinstance(caught.value, TypeError) and isinstance(caught.value, InputError)


def test_a_class_may_say_what_it_is() -> None:
    class Known(Unknown):
        def __init__(self, said: object) -> None:
            self.said = said

        def digested(self) -> object:
            return self.said

    assert digest(Known(1)) == digest(Known(1)) != digest(Known(2))


def test_a_network_of_layers_is_told_by_weights_activations_and_scales() -> None:
    def law(weight: float = 1.0, activation: str = "Tanh", scale: float = 1.0) -> PerceptronLaw:
        layers = (
            Layer(weight * np.ones((4, 3)), np.zeros(4), activation),
            Layer(np.ones((3, 4)), np.zeros(3), "Identity"),
        )
        return PerceptronLaw(layers, np.zeros(3), scale * np.ones(3), np.ones(3))

    laws = [law(), law(weight=2.0), law(activation="Sigmoid"), law(scale=2.0)]
    assert len({digest(one) for one in laws}) == len(laws)
    assert digest(law()) == digest(laws[0])


@pytest.mark.slow
def test_nothing_is_pickled() -> None:
    code = [path for path in (ROBOTS.parent / "armflex").rglob("*.py") if "import pickle" in path.read_text()]
    assert code == []
