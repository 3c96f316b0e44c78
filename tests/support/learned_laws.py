"""Every law that can be learned on the whole arm, as declared and with its values somewhere."""

import numpy as np

from armflex.laws import AtNode, Beam, Law, LinearLaw, PositionDependentLaw, Row, Section, StructuralLaw, SubJoint
from armflex.laws.learned import LearnedLaw, Learning, learned_law, seen_in

RNG = np.random.default_rng(5)
SIZE = np.array([1e3, 2e3, 500.0, 100.0, 200.0, 300.0])


LOADS = RNG.normal(size=(60, 6)) * SIZE
ROW = Row(RNG.uniform(-1.0, 1.0, (60, 2)), {"A": 0, "B": 1})


def compliance(rigid: int | None = None) -> np.ndarray:
    """A full positive compliance; one axis may be rigid."""
    root = np.random.default_rng(1).normal(size=(6, 6)) * np.repeat([3e-5, 3e-4], 3)[:, None]
    whole = root @ root.T
    if rigid is not None:
        whole[rigid] = whole[:, rigid] = 0.0
    return whole


def structure() -> StructuralLaw:
    """Two bearings on a shaft."""
    nodes = {"a": np.zeros(3), "b": np.array([0.3, 0.0, 0.0]), "tip": np.array([0.4, 0.05, 0.0])}
    section = Section(E=2.1e11, G=8e10, A=1e-3, Iy=2e-7, Iz=3e-7, J=4e-7)
    beams = (Beam("a", "b", section, np.array([0.0, 0, 1])), Beam("b", "tip", section, np.array([0.0, 0, 1])))
    bearings = (SubJoint("a", LinearLaw(compliance())), SubJoint("b", LinearLaw(np.diag([0, 1e-8, 2e-8, 0, 0, 0.0]))))
    return StructuralLaw(nodes, "tip", bearings, beams)


DECLARED: dict[str, tuple[Law, Learning]] = {
    "linear": (LinearLaw(compliance(rigid=2)), Learning("linear")),
    "polynomial": (LinearLaw(compliance(rigid=2), 0.2), Learning("polynomial")),
    "neural": (LinearLaw(compliance()), Learning("neural", neurons=5)),
    "structural": (structure(), Learning("structural")),
    "position_dependent": (
        PositionDependentLaw("B", np.array([compliance(), 0.2 * compliance()])),
        Learning("position_dependent", travel={"B": (-1.3, 1.7)}),
    ),
    "at a node": (AtNode(LinearLaw(compliance()), np.array([0.1, 0.0, 0.2])), Learning("linear")),
    "of a position, at a node": (
        AtNode(PositionDependentLaw("B", np.array([compliance(), 0.2 * compliance()])), np.array([0.1, 0.0, 0.2])),
        Learning("position_dependent", travel={"B": (-1.3, 1.7)}),
    ),
    "about a node": (AtNode(LinearLaw(compliance()), np.array([0.1, 0.0, 0.2])), Learning("polynomial")),
}


def moved(name: str, seed: int = 0, size: float = 0.3) -> LearnedLaw:
    """A law with all its values somewhere."""
    law, learning = DECLARED[name]
    start = learned_law(law, learning, seen_in(law, LOADS, ROW))
    return start.at(start.values + size * np.random.default_rng(seed).normal(size=len(start.values)))
