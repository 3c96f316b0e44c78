"""A crane of four meshed links against one CalculiX 2.20 model of all of them, under their own weight and 200 kg.

In CalculiX the bars of each pose are joined by rigid bodies at their end faces, and everything is linear. The tip's
displacements that it gave are stored here.
"""

import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.command_line import fine, run_here
from support.meshes import bar, write_bar

import armflex

pytest.importorskip("skfem")

LENGTHS = (2.0, 1.8, 1.5, 1.2)
SECTIONS = ((0.2, 0.3), (0.18, 0.25), (0.15, 0.2), (0.12, 0.16))
AXES = ("0 0 1", "0 1 0", "0 1 0", "0 1 0")
CALCULIX = {
    (0.0, 0.0, 0.0, 0.0): (0.0, 0.0, -9.3955),
    (0.5, -0.6, 0.4, 0.3): (1.3946, 0.7619, -8.2874),
    (1.0, -1.0, 0.9, 0.5): (0.5395, 0.8403, -6.6304),
    (-0.4, -0.3, 1.2, -0.5): (-2.0811, 0.8799, -6.9079),
    (2.0, 0.2, -0.5, 1.0): (0.5453, -1.1914, -8.0858),
}
"""Positions of the joints [rad] -> displacement of the tip [mm]."""

MODES = {
    (0.0, 0.0, 0.0, 0.0): ((4.3474, 6.2760, 18.9616, 26.3499), (5.7027, 8.3102, 24.2174, 33.6481)),
    (0.5, -0.6, 0.4, 0.3): ((4.5037, 6.4967, 18.8987, 26.2344), (5.9084, 8.5935, 24.4544, 34.2062)),
    (1.0, -1.0, 0.9, 0.5): ((4.9539, 7.1551, 17.6667, 23.9058), (6.4725, 9.3878, 23.6489, 34.0586)),
    (-0.4, -0.3, 1.2, -0.5): ((4.8545, 7.0333, 16.8963, 22.4885), (6.3820, 9.3077, 21.2034, 29.5072)),
    (2.0, 0.2, -0.5, 1.0): ((4.6012, 6.6641, 19.6554, 27.1791), (5.9201, 8.6335, 25.6941, 35.4487)),
}
"""The same -> its lowest frequencies [Hz]: four with 200 kg, and four without."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the robot and the parts of its links."""
    folder = tmp_path_factory.mktemp("crane")
    links, joints = '<link name="base"/><link name="tip"/>', ""
    for i, (length, (wide, high)) in enumerate(zip(LENGTHS, SECTIONS, strict=True), 1):
        points, nodes = bar("C3D20", (8, 1, 1), (length, wide, high))
        write_bar(folder / "bar.inp", "C3D20", points - [0.0, wide / 2.0, high / 2.0], nodes)
        fine(run_here(folder, "fem", "bar.inp", "--fixed", "ROOT", "--loaded", "TIP", "-o", f"l{i}.toml"))
        mass = 7850.0 * length * wide * high
        moments = [mass * (a * a + b * b) / 12.0 for a, b in ((wide, high), (length, high), (length, wide))]
        inertia = " ".join(f'{name}="{value}"' for name, value in zip(("ixx", "iyy", "izz"), moments, strict=True))
        links += f'<link name="l{i}"><inertial><origin xyz="{length / 2.0} 0 0"/><mass value="{mass}"/>'
        links += f'<inertia {inertia} ixy="0" ixz="0" iyz="0"/></inertial></link>'
        parent, start = ("base", 0.0) if i == 1 else (f"l{i - 1}", LENGTHS[i - 2])
        joints += f'<joint name="j{i}" type="revolute"><parent link="{parent}"/><child link="l{i}"/>'
        joints += f'<origin xyz="{start} 0 0"/><axis xyz="{AXES[i - 1]}"/>'
        joints += '<limit lower="-3" upper="3" effort="1e6" velocity="1"/></joint>'
    joints += '<joint name="end" type="fixed"><parent link="l4"/><child link="tip"/>'
    joints += f'<origin xyz="{LENGTHS[3]} 0 0"/></joint>'
    (folder / "r.urdf").write_text(f'<robot name="crane">{links}{joints}</robot>')
    return folder


def arm(folder: Path, flexures: str) -> armflex.Arm:
    head = '[robot]\nurdf = "r.urdf"\ntip = "tip"\ngravity = [0.0, 0.0, -9.81]\n'
    (folder / "arm.toml").write_text(f"{head}[payload.p]\nmass = 200.0\ncom = [0.0, 0.0, 0.0]\n{flexures}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return armflex.load_arm(folder / "arm.toml")


LINKS = "".join(f'[link.l{i}]\nfile = "l{i}.toml"\n' for i in range(1, 5))


def test_the_tip_is_where_calculix_has_it(folder: Path) -> None:
    crane = arm(folder, LINKS)
    assert crane.flexure_names == ("l1", "l2", "l3", "l4") and not crane.flags
    for q, expected in CALCULIX.items():
        found = 1e3 * crane.deflection(np.array(q), "p").displacement[:3]
        assert np.linalg.norm(found - expected) < 2e-3 * np.linalg.norm(expected)


@pytest.mark.parametrize("q", CALCULIX)
def test_the_modes_are_calculix(folder: Path, q: tuple[float, ...]) -> None:
    """The mass of a link is distributed along it: two bodies alone would be off by several per cent."""
    crane = arm(folder, LINKS)
    for payload, expected in zip(("p", None), MODES[q], strict=True):
        found = crane.modes(np.array(q), payload, count=4).frequencies
        np.testing.assert_allclose(found, expected, rtol=3e-3)


def test_youngs_modulus_of_each_link_is_found(folder: Path) -> None:
    """[prior] young frees one factor a part; two links are not as their meshes say."""
    head = '[measurement]\nframe = "base"\n[prior]\nyoung = 0.2\n'
    nominal, factors = arm(folder, head + LINKS), np.log([1.0, 1.2, 0.9, 1.0])
    pairs = zip(nominal.flexures, factors, strict=True)
    truth = replace(nominal, flexures=tuple(replace(one, law=one.law.at(np.array([f]))) for one, f in pairs))
    rng = np.random.default_rng(0)
    q, sigma = rng.uniform(-1.0, 1.0, (60, 4)), 2e-5
    tips = [truth.deflection(one, "p").pose.translation for one in q] + rng.normal(size=(60, 3)) * sigma
    rows = [",".join(map(repr, [*map(float, a), *map(float, b)])) + f",p,{sigma}" for a, b in zip(q, tips, strict=True)]
    names = [f"q_j{i}_rad" for i in range(1, 5)]
    (folder / "c.csv").write_text("\n".join([",".join([*names, "x_m", "y_m", "z_m", "payload", "sigma_m"]), *rows]))
    fine(run_here(folder, "calibrate", "arm.toml", "c.csv", "-o", "found.toml"))
    found = armflex.load_arm(folder / "found.toml")
    for flexure, factor in zip(found.flexures, factors, strict=True):
        (value,), ((variance,),) = flexure.law.values, flexure.law.posterior
        assert abs(value - factor) < 4.0 * variance**0.5 and variance**0.5 < 0.1


@pytest.mark.filterwarnings("ignore:rigid:armflex.ArmflexWarning")
def test_the_weight_of_the_links_is_what_it_was(folder: Path) -> None:
    """Splitting a link moves none of its weight: loads at the base are those of rigid links, to first order."""
    bent, rigid = arm(folder, LINKS), armflex.load_arm(folder / "r.urdf", tip="tip")
    for model in (bent, rigid):
        inertials = [link.inertial for link in model.robot.urdf.links.values() if link.inertial]
        assert sum(one.mass for one in inertials) == pytest.approx(7850.0 * 0.26904)
    first = bent.robot.urdf.links
    mass, end = first["l1"].inertial.mass, first["l1:end"].inertial.mass
    assert end == pytest.approx(0.5 * (mass + end), rel=0.03)  # half of a uniform beam
    far = np.add(first["l1:end"].inertial.origin, (2.0, 0.0, 0.0))
    com = (mass * first["l1"].inertial.origin + end * far) / (mass + end)
    np.testing.assert_allclose(com, [1.0, 0.0, 0.0], atol=1e-9)


def test_a_query_is_as_quick_as_with_flexures(folder: Path) -> None:
    """The mechanics has as many flexures and joints that move as with laws by numbers; times are printed alone."""
    by_numbers = "".join(
        f'[flexure.f{i}]\njoint = "{joint}"\ncompliance = [1e-9, 1e-9, 1e-9, 1e-7, 1e-7, 1e-7]\n'
        for i, joint in enumerate(("j1", "j2", "j3", "j4"))
    )
    cranes = [arm(folder, text) for text in (LINKS, by_numbers)]
    took = [np.inf, np.inf]
    for _ in range(8):  # in turn, and the quickest of each: other programs run as well
        for place, crane in enumerate(cranes):
            began = time.process_time()
            for _ in range(25):
                crane.deflection(np.zeros(4), "p")
            took[place] = min(took[place], (time.process_time() - began) / 25)
    assert [len(crane.flexures) for crane in cranes] == [4, 4]
    print(f"{1e6 * took[0]:.0f} us a query, {1e6 * took[1]:.0f} us with flexures, {took[0] / took[1]:.2f} times")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('[link.l9]\nfile = "l1.toml"\n', "no link 'l9' between two joints of the chain, did you mean 'l"),
        ('[link.l1]\nfile = "l2.toml"\n', "0.2 m from joint 'j2'"),
        ('[link.l1]\nfile = "l1.toml"\nrpy = [0.0, 1.5708, 0.0]\n', "say with xyz and rpy where the mesh is"),
        ('[link.l1]\nfil = "l1.toml"\n', "[link.l1] needs 'file'"),
        ('[link.l1]\nfile = "l1.toml"\n[flexure.l1]\njoint = "j1"\njoint_stiffness = 1e7\n', "choose another"),
        ('[link.l1]\nfile = "none.toml"\n', "none.toml: cannot be read"),
    ],
)
def test_a_wrong_link_is_named(folder: Path, text: str, expected: str) -> None:
    with pytest.raises(armflex.InputError) as found:
        arm(folder, text)
    assert expected in str(found.value)
