"""Laws that are learned on the whole arm: their derivatives, what always holds of them, and what tip readings teach."""

import dataclasses
import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from support.bent_joints import Bent, bent
from support.learned_laws import DECLARED, LOADS, ROW, SIZE, compliance, moved, structure
from support.small_arms import central_difference

from armflex import Arm, calibrate, load_arm, predict, read_measurements
from armflex.cli.main import armflex
from armflex.conventions import TWIST_NAMES
from armflex.errors import ArmFileError, ConvergenceError, InputError
from armflex.estimate import Calibration
from armflex.estimate.block import law_block, with_laws
from armflex.estimate.calibrate import loads_seen
from armflex.estimate.learn import learned_axes
from armflex.estimate.placement import first_guess
from armflex.estimate.sample import sample_laws
from armflex.estimate.view import look
from armflex.laws import AtNode, LinearLaw, Row, StructuralLaw, SubJoint
from armflex.laws.declared import Flexure
from armflex.laws.joint.linear import LinearFit
from armflex.laws.law import beyond
from armflex.laws.learned import LearnedLaw, Learning, learned_law, seen_in


def ending(law: LearnedLaw, **changed: object) -> LearnedLaw:
    """Return a law whose correction ends otherwise."""
    return replace(law, seen=replace(law.seen, **changed))


@pytest.mark.parametrize("name", DECLARED)
def test_a_law_begins_as_it_was_declared(name):
    law, learning = DECLARED[name]
    start = learned_law(law, learning, seen_in(law, LOADS, ROW))
    np.testing.assert_allclose(start.twist(LOADS, ROW), law.twist(LOADS, ROW), rtol=1e-9, atol=1e-15)
    names = [one.name for one in start.parameters]
    assert len(names) == len(set(names)) == len(start.values) == len(start.prior)


@pytest.mark.slow
@pytest.mark.parametrize("name", DECLARED)
@pytest.mark.parametrize(("number", "out"), [(0, 0.8), (7, 1.3), (31, 2.5)])
@pytest.mark.parametrize("energy", [None, compliance(rigid=2) / 5.0], ids=["by distance", "by energy"])
def test_derivatives_by_load_and_by_values(name, number, out, energy):
    """Some of the loads are where a correction is carried on, and fades."""
    law, row, load = ending(moved(name), faded=3.0, energy=energy), ROW.some(number), out * LOADS[number]
    tangent = central_difference(lambda z: law.twist(z * SIZE, row), load / SIZE, 1e-5)
    np.testing.assert_allclose(law.tangent(load, row) * SIZE, tangent, rtol=1e-5, atol=1e-6 * np.abs(tangent).max())
    by_values = central_difference(lambda values: law.at(values).twist(load, row), law.values, 1e-5)
    np.testing.assert_allclose(law.by_values(load, row), by_values, rtol=1e-5, atol=1e-7 * np.abs(by_values).max())


@pytest.mark.parametrize("name", DECLARED)
def test_rows_at_once_are_rows_one_by_one(name):
    law = moved(name)
    for ask in (law.twist, law.tangent, law.by_values):
        together = ask(LOADS[:5], Row(ROW.q[:5], ROW.joint_index))
        each = [ask(load, ROW.some(i)) for i, load in enumerate(LOADS[:5])]
        np.testing.assert_allclose(together, each, rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize("name", ["polynomial", "neural"])
def test_a_row_among_the_loads_seen_is_what_it_is_whatever_the_others_are(name):
    law, others = ending(moved(name), faded=3.0), LOADS.copy()
    others[-1] *= 20.0
    for ask in (law.twist, law.tangent, law.by_values):
        np.testing.assert_array_equal(ask(others, ROW)[:-1], ask(LOADS, ROW)[:-1])


@settings(max_examples=40)
@given(seed=st.integers(0, 10_000), size=st.floats(0.0, 3.0))
def test_a_learned_compliance_is_symmetric_and_gains_no_energy(seed, size):
    for name in ("linear", "position_dependent"):
        tangent = moved(name, seed, size).tangent(LOADS[0], ROW.some(0))
        diagonal = np.diag(tangent)
        scaled = tangent / np.sqrt(np.outer(*2 * [np.where(diagonal > 0.0, diagonal, 1.0)]))
        np.testing.assert_allclose(scaled, scaled.T, atol=1e-9)
        assert np.linalg.eigvalsh(scaled)[0] > -1e-7
        assert not tangent[2].any() or name != "linear"  # what was rigid stays rigid


@pytest.mark.parametrize("name", ["polynomial", "neural"])
def test_a_correction_is_nothing_beyond_the_loads_seen_and_its_doubt_grows(name):
    law = moved(name).with_posterior(1e-4 * np.eye(len(moved(name).values)), LOADS, ROW)
    plain = law.plain
    row, mean = ROW.some(0), law.seen.mean
    far = mean + 1.001 * law.seen.faded * (LOADS[0] - mean) / law.seen.outreach(LOADS[0])
    assert law.seen.weight(LOADS).min() == 1.0
    assert np.abs(law.twist(LOADS, ROW) - plain.twist(LOADS, ROW)).max() > 1e-6
    np.testing.assert_array_equal(law.twist(far, row), plain.twist(far, row))
    near, beyond = (np.diag(law.covariance(load, row)).max() for load in (LOADS[0], far))
    assert beyond > 4.0 * near
    assert {flag.code for flag in law.flags(20.0 * LOADS[0], row)} == {"extrapolating"}


@pytest.mark.slow
@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), size=st.floats(0.0, 0.1), name=st.sampled_from(["polynomial", "neural"]))
def test_fading_takes_a_quarter_of_the_compliance_at_most(seed, size, name):
    """What is left in any direction is what the correction leaves where it does not fade, or all, less a quarter."""
    law = moved(name, seed, size)
    law = law.with_posterior(1e-9 * np.eye(len(law.values)), LOADS, ROW)
    root = np.linalg.pinv(compliance_root(law))
    out = np.random.default_rng(seed).normal(size=(300, 6)) @ np.diag(SIZE)
    out /= law.seen.outreach(law.seen.mean + out)[:, None]
    far = law.seen.mean + out * np.geomspace(0.8, 1.2 * law.seen.faded, 300)[:, None]
    row = ROW.some(np.zeros(len(far), int))
    for whole, faded in zip(ending(law, faded=np.inf).tangent(far, row), law.tangent(far, row), strict=True):
        assert least(root, faded[None]) > min(1.0, least(root, whole[None])) - 0.25 - 1e-9


@pytest.mark.slow
def test_all_loads_seen_are_within_reach_and_others_before_long(learned):
    """A correction is what was learned at every load within the ellipsoid, and nothing at a few times the energy."""
    _, found = learned
    rng = np.random.default_rng(3)
    for law in (flexure.law for flexure in found.arm.flexures if flexure.learn):
        root = np.linalg.cholesky(np.linalg.inv(law.seen.precision))
        out = rng.normal(size=(2000, 6))
        edge = law.seen.mean + (out / np.linalg.norm(out, axis=1)[:, None]) @ root.T
        np.testing.assert_allclose(law.seen.distance(edge), 1.0, rtol=1e-6)
        assert (law.seen.weight(edge) == 1.0).all() and law.seen.outreach(edge).max() > 0.8
        assert law.seen.faded < 20.0


def compliance_root(law: LearnedLaw) -> np.ndarray:
    """R of the plain part's C = R R'."""
    plain = law.plain.constant
    size, vectors = np.linalg.eigh(plain)
    return vectors * np.sqrt(np.maximum(size, 0.0))


def least(root: np.ndarray, tangents: np.ndarray) -> float:
    """The smallest part of the plain compliance that tangents have, over the axes that give."""
    scaled = root @ (0.5 * (tangents + np.swapaxes(tangents, 1, 2))) @ root.T
    own = np.flatnonzero(np.abs(root).max(axis=1) > 0.0)
    return float(np.linalg.eigvalsh(scaled[:, own][:, :, own])[:, 0].min())


def test_a_compliance_at_a_node_is_learned_there():
    """What moves is the compliance at the node, carried to the joint by the adjoint."""
    law = moved("at a node")
    there = moved("linear")
    free = learned_law(law.declared.law, Learning("linear"), seen_in(law.declared.law, LOADS, ROW)).at(law.values)
    moved_there = AtNode(free, law.declared.node)
    assert len(law.values) == 21 and law.constant is not None and len(there.values) == 15
    np.testing.assert_allclose(law.twist(LOADS, ROW), moved_there.twist(LOADS, ROW), rtol=1e-9)
    with_polynomial = learned_law(*DECLARED["about a node"], seen_in(DECLARED["about a node"][0], LOADS, ROW))
    assert len(with_polynomial.groups) == 3  # a compliance, not a correction alone


def test_what_a_bench_says_of_a_law_is_kept():
    """Its standard errors are the prior, and its scatter is none that parameters explain."""
    diagonal = np.array([1e-9, 2e-9, 1e-9, 1e-8, 1e-8, 2e-8])
    rows = np.array([np.diag((0.02 * c * np.ones(6)) ** 2) for c in diagonal])
    scatter = np.array([1e-6, 2e-6, 3e-6, 1e-5, 2e-5, 3e-5])
    fitted = LinearLaw(np.diag(diagonal), fit=LinearFit(rows, scatter, np.array([-SIZE, SIZE])))
    law = learned_law(fitted, Learning("linear"), seen_in(fitted, LOADS, ROW))
    np.testing.assert_allclose(law.prior[:6], 0.02, rtol=1e-9)
    settled = law.with_posterior(np.zeros((len(law.values),) * 2), LOADS, ROW)
    np.testing.assert_allclose(settled.covariance(LOADS[0], ROW.some(0)), np.diag(scatter**2), rtol=1e-12)
    away = AtNode(fitted, np.array([0.5, 0.0, 0.2]))
    law = learned_law(away, Learning("linear"), seen_in(away, LOADS, ROW))
    exact = replace(fitted, fit=replace(fitted.fit, row_covariance=np.zeros((6, 6, 6))))
    carried = AtNode(exact, away.node).covariance(LOADS[0], ROW.some(0))
    assert np.abs(carried - np.diag(np.diag(carried))).max() > 0.1 * np.diag(carried)[:3].max()
    np.testing.assert_allclose(law.covariance(LOADS[0], ROW.some(0)), carried, rtol=1e-12)
    noisy = replace(structure(), noise=scatter)
    law = learned_law(noisy, Learning("structural"), seen_in(noisy, LOADS, ROW))
    np.testing.assert_allclose(law.covariance(LOADS[0], ROW.some(0)), np.diag(scatter**2), rtol=1e-12)


def test_the_worst_row_is_the_one_furthest_beyond_the_loads_seen():
    """In parts of the range that was seen, on whichever side."""
    seen = np.array([[-100.0, 0.0], [300.0, 1.0]])
    sizes = [[flag.size for flag in beyond(seen, np.array(load))] for load in ([500.0, 0.5], [-140.0, 3.0], [0.0, 1.0])]
    np.testing.assert_allclose(sizes[0], [0.5])
    np.testing.assert_allclose(sizes[1], [0.1, 2.0])
    assert not sizes[2]


def test_loads_are_told_apart_from_those_seen():
    (flag,) = beyond(np.array([[-33401.0], [10.0]]), np.array([-33402.0]))
    assert "-33402 N is outside the -33401 to" in flag.text


@pytest.fixture(scope="module")
def boom() -> Bent:
    return bent(2)


@pytest.fixture(scope="module")
def learned(boom, tmp_path_factory) -> tuple[Path, Calibration]:
    folder = tmp_path_factory.mktemp("learned")
    arm = load_arm(boom.write(folder, "polynomial"))
    return folder, calibrate(arm, read_measurements(folder / "train.csv", arm))


@pytest.fixture(scope="module")
def six() -> Bent:
    """On an arm that is calibrated in a tenth of the time."""
    return bent(4, "six")


@pytest.fixture(scope="module")
def learned_on_six(six, tmp_path_factory) -> tuple[Path, Calibration]:
    folder = tmp_path_factory.mktemp("six")
    arm = load_arm(six.write(folder, "polynomial"))
    return folder, calibrate(arm, read_measurements(folder / "train.csv", arm))


@pytest.mark.parametrize("model", ["linear", "polynomial", "neural", "bayesian"])
def test_columns_are_derivatives_through_the_equilibrium(boom, tmp_path, model):
    """Laws answer to loads, and loads to where the arm gives way: both are in the columns."""
    arm = load_arm(boom.write(tmp_path, model))
    measurements, rows = read_measurements(tmp_path / "train.csv", arm), np.arange(0, 40, 8)
    setup, _ = first_guess(arm, measurements, np.flatnonzero(measurements.measured))
    block = law_block(setup, look(setup, measurements, np.flatnonzero(measurements.measured)))
    at = block.start + 0.2 * np.random.default_rng(0).normal(size=len(block.labels))
    columns = block.jacobian(look(block.apply(setup, at), measurements, rows))
    for i in np.random.default_rng(1).choice(len(at), 12, replace=False):
        step = 1e-4 * np.eye(len(at))[i]
        ends = [look(block.apply(setup, at + side * step), measurements, rows).residual for side in (1.0, -1.0)]
        atol = 1e-6 * np.abs(columns).max()
        np.testing.assert_allclose(columns[:, :, i], (ends[1] - ends[0]) / 2e-4, rtol=1e-5, atol=atol)


def held_out(arm: Arm, boom: Bent, path: Path) -> tuple[float, float]:
    """RMS of what is predicted at rows not used [mm], and of their noise."""
    rows = read_measurements(path, arm)
    read = np.flatnonzero(rows.measured)
    errors = (rows.position - predict(arm, rows).position)[read], boom.drawn.errors[read]
    return tuple(1e3 * float(np.sqrt((e**2).sum(axis=1).mean())) for e in errors)


@pytest.mark.slow
def test_what_nobody_declared_is_learned(boom, learned, tmp_path):
    folder, found = learned
    straight = load_arm(boom.write(tmp_path, "none"))
    before, noise = held_out(
        calibrate(straight, read_measurements(folder / "train.csv", straight)).arm, boom, folder / "test.csv"
    )
    after, _ = held_out(found.arm, boom, folder / "test.csv")
    assert before > 1.5 * noise
    assert after < 1.2 * noise


@pytest.mark.slow
def test_the_true_laws_are_within_their_bands(boom, learned):
    _, found = learned
    state, names = boom.state(), list(found.arm.joint_names)
    row = Row(boom.drawn.rows.q, {name: i for i, name in enumerate(names)})
    for joint, axis in zip(boom.joints, boom.axes, strict=True):
        law = found.arm.flexures[names.index(joint)].law
        loads = state.wrenches[:, names.index(joint)]
        error = (law.twist(loads, row) - boom.twist(joint, loads))[:, axis]
        std = np.sqrt(law.covariance(loads, row)[:, axis, axis])
        assert np.mean(np.abs(error) < 1.96 * std) > 0.8
        assert std.mean() < 0.5 * np.abs(boom.twist(joint, loads)[:, axis]).mean()


@pytest.mark.slow
def test_what_was_learned_is_written_and_read(boom, learned, tmp_path):
    folder, found = learned
    again = load_arm(found.write(tmp_path / "learned.toml"))
    q = boom.drawn.rows.q[3]
    one, other = (arm.deflection(q, "p300") for arm in (found.arm, again))
    np.testing.assert_array_equal(one.displacement, other.displacement)
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-6)
    for kept, before in zip(again.flexures, found.arm.flexures, strict=True):
        if kept.learn is not None:  # beyond the loads seen, too
            load, row = 3.0 * before.law.seen.loads[1], Row(q, found.arm.joint_index)
            np.testing.assert_allclose(kept.law.covariance(load, row), before.law.covariance(load, row), rtol=1e-6)
            assert before.law.seen.weight(load) < 1.0
            np.testing.assert_array_equal(kept.law.twist(load, row), before.law.twist(load, row))
    rows = read_measurements(folder / "test.csv", again)
    np.testing.assert_allclose(predict(again, rows).sigma, predict(found.arm, rows).sigma, rtol=1e-6)


def named_as(arm: Arm, names: tuple[str, str], node: str) -> Arm:
    """The boom with A2 and A3 renamed and learned, the second as a bearing at a node of some name."""

    def change(flexure: Flexure) -> Flexure:
        if flexure.name == "A2":
            return dataclasses.replace(flexure, name=names[0], learn=Learning("linear"))
        if flexure.name == "A3":
            law = StructuralLaw({node: np.zeros(3)}, node, (SubJoint(node, flexure.law),), ())
            return dataclasses.replace(flexure, name=names[1], learn=Learning("structural"), law=law)
        return flexure

    return dataclasses.replace(arm, flexures=tuple(map(change, arm.flexures)))


@pytest.mark.slow
def test_names_that_begin_alike_and_hold_blanks_are_names_like_others(boom, tmp_path):
    plain = load_arm(boom.write(tmp_path, "none"))
    rows = read_measurements(tmp_path / "train.csv", plain)
    found = []
    for names, node in ((("one", "other"), "a"), (("A2", "A2 x"), "2@the bearing")):
        arm = calibrate(named_as(plain, names, node), rows, np.flatnonzero(rows.measured)[:60]).arm
        found.append(arm.total_covariance(boom.drawn.rows.q[3], "p300"))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-6)


@pytest.mark.slow
def test_laws_of_names_that_begin_alike_are_read_with_their_own_covariance(boom, tmp_path):
    path = boom.write(tmp_path, "none")
    text = path.read_text().replace("[flexure.A3]", '[flexure."A2 x"]')
    path.write_text(re.sub(r'(joint = "A[23]"\nmodel = "linear"\n)', r"\1learn = true\n", text))
    arm = load_arm(path)
    rows = read_measurements(tmp_path / "train.csv", arm)
    found = calibrate(arm, rows, np.flatnonzero(rows.measured)[:60])
    again = load_arm(found.write(tmp_path / "learned.toml"))
    for kept, before in zip(again.flexures, found.arm.flexures, strict=True):
        if kept.learn is not None:
            np.testing.assert_allclose(kept.law.posterior, before.law.posterior, rtol=1e-6)


@pytest.mark.slow
def test_learning_again_begins_at_what_was_declared(learned_on_six):
    """What the same readings taught must not count twice."""
    folder, found = learned_on_six
    again = calibrate(found.arm, read_measurements(folder / "train.csv", found.arm))
    assert again.fit.labels == found.fit.labels
    np.testing.assert_allclose(again.rms, found.rms, rtol=1e-2)


@pytest.mark.slow
def test_a_campaign_is_within_the_loads_that_it_taught_and_others_are_told_once(boom, learned):
    folder, found = learned
    line, names = found.fit.view.line, found.arm.flexure_names
    laws = {f.name: f.law for f in found.arm.flexures if f.learn}
    for name, law in laws.items():
        assert not [d for load in line.flexure_wrenches[:, names.index(name)] for d in law.flags(load, ROW.some(0))]
    narrow = {name: replace(law, seen=replace(law.seen, loads=0.2 * law.seen.loads)) for name, law in laws.items()}
    flags = predict(with_laws(found.arm, narrow), read_measurements(folder / "train.csv", found.arm)).flags
    told = [flag.text for flag in flags if flag.code == "extrapolating"]
    assert len(told) == len(boom.joints) and all("the worst of" in text and "% of all)" in text for text in told)
    for (name, law), text in zip(narrow.items(), told, strict=True):  # rows in the order of the flexures
        loads, (low, high) = line.flexure_wrenches[:, names.index(name)], law.seen.loads
        excess = (np.maximum(low - loads, loads - high) / (high - low)).max(axis=1)
        assert int(re.search(r"row (\d+)", text)[1]) == found.fit.view.rows[excess.argmax()], name


@pytest.mark.slow
def test_a_search_that_has_not_settled_says_so_or_is_refused(boom, learned, monkeypatch):
    folder, found = learned
    learn, rows = sys.modules["armflex.estimate.learn"], read_measurements(folder / "train.csv", found.arm)
    assert found.fit.left == 0.0 and not found.flags
    arm = load_arm(folder / "arm.toml")
    monkeypatch.setattr(learn, "ROUNDS", 1)
    monkeypatch.setattr(learn, "ROUGH", replace(learn.ROUGH, iterations=1))
    told = calibrate(arm, rows).flags
    assert [flag.code for flag in told] == ["unsettled"] and "after 1 fits" in told[0].text
    monkeypatch.setattr(learn, "THOROUGH", replace(learn.THOROUGH, iterations=1))
    with pytest.raises(ConvergenceError, match=r"learned laws did not settle: .* a simpler model"):
        calibrate(arm, rows)


@pytest.mark.slow
def test_drawn_campaigns_keep_the_loads_of_the_whole(learned_on_six):
    folder, found = learned_on_six
    arm, rows = load_arm(folder / "arm.toml"), read_measurements(folder / "train.csv", found.arm)
    seen, some = loads_seen(arm, rows), np.flatnonzero(rows.measured)[::2]
    half = calibrate(arm, rows, rows=some, seen=seen).arm
    for flexure in half.flexures:
        if flexure.learn:
            np.testing.assert_array_equal(flexure.law.seen.precision, seen[flexure.name].precision)


def test_what_was_declared_is_told_beside_what_was_learned(learned):
    _, found = learned
    laws = {f.name: f.law for f in found.arm.flexures if f.learn}
    view = found.fit.view
    for axis in learned_axes(found.fit, laws, None):
        law = laws[axis.flexure]
        start = learned_law(law.declared, Learning("polynomial"), law.seen)
        loads = view.line.flexure_wrenches[:, found.arm.flexure_names.index(axis.flexure)]
        std = start.std(np.diag(start.prior**2), loads, view.line.row)[:, TWIST_NAMES.index(axis.axis)]
        assert axis.before == pytest.approx(np.sqrt((std**2).mean()), rel=1e-6)


def test_a_law_that_is_not_learned_any_more_is_refused(learned, tmp_path):
    found = learned[1]
    path = found.write(tmp_path / "learned.toml")
    path.write_text(path.read_text().replace('model = "polynomial"\nlearn = true', 'model = "linear"'))
    with pytest.raises(ArmFileError, match=r"learned\.toml:\d+.*no learn = true"):
        load_arm(path)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("faded", "1.0", "expected 2 or more, got 1"),
        ("faded", "0.5", "expected 2 or more, got 0.5"),
        ("faded", "-3.0", "expected 2 or more, got -3"),
        ("load_scale", "[1, 1, 1, 1, 1, 0.0]", "above 0, got 0"),
        ("twist_scale", "[1, 1, 1, 1, 1, -2.0]", "below 0, got -2"),
        ("reach", "[1, 1, 1, 1, 1, -2.0]", "below 0, got -2"),
        ("precision", str((-np.eye(6)).tolist()), "negative eigenvalues"),
        ("energy", str(np.triu(np.ones((6, 6))).tolist()), "symmetric"),
    ],
)
def test_what_learning_never_leaves_is_refused_at_its_line(learned, tmp_path, key, value, message):
    found = learned[1]
    lines = found.write(tmp_path / "learned.toml").read_text().splitlines()
    number = next(i for i, line in enumerate(lines) if line.startswith(f"{key} = "))
    (tmp_path / "bad.toml").write_text("\n".join([*lines[:number], f"{key} = {value}", *lines[number + 1 :]]))
    with pytest.raises(ArmFileError, match=rf"bad\.toml:{number + 1}: .*{key}: .*{re.escape(message)}"):
        load_arm(tmp_path / "bad.toml")


@pytest.mark.parametrize("size", [-3e5, 3e5])
def test_a_factor_that_is_no_number_is_refused(learned, tmp_path, size):
    found = learned[1]
    path = found.write(tmp_path / "learned.toml")
    text, count = re.subn(r"(?m)^values = \[[^,]+,", f"values = [{size},", path.read_text(), count=1)
    path.write_text(text)
    with pytest.raises(ArmFileError, match=r"values: .*logarithm of a factor.*200 either way, got") as caught:
        load_arm(path)
    assert count == 1 and text.splitlines()[caught.value.place.line - 1].startswith("values")


def test_a_correction_of_a_file_without_energy_fades_by_distance(learned, tmp_path):
    found = learned[1]
    path = found.write(tmp_path / "learned.toml")
    path.write_text(re.sub(r"^energy = .*\n", "", path.read_text(), flags=re.M))
    laws = [flexure.law for flexure in load_arm(path).flexures if flexure.learn]
    assert laws and all(
        law.seen.energy is None and law.seen.outreach(LOADS[0]) == law.seen.distance(LOADS[0]) for law in laws
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ('model = "neural"\nneurons = 0', "neurons: .*from 1 to 64, got 0"),
        ('model = "neural"\nneurons = 2.5', "neurons: .*got 2.5"),
        ('model = "polynomial"\nneuron = 3', "neuron"),
        ('model = "linear"\nneurons = 3', "neurons: .*a linear law has none: only neural and bayesian laws do"),
        ('model = "linear"\n#', "is zero: there is nothing"),
    ],
)
def test_what_cannot_be_learned_is_refused(boom, tmp_path, change, message):
    path = boom.write(tmp_path, "linear")
    text = path.read_text().replace('model = "linear"\nlearn = true', f"{change}\nlearn = true", 1)
    if "#" in change:
        text = re.sub(r"learn = true\ncompliance = \[.*\]", "learn = true\ncompliance = [0, 0, 0, 0, 0, 0]", text)
    path.write_text(text)
    with pytest.raises(ArmFileError, match=message):
        load_arm(path)


@pytest.mark.slow
def test_sampled_bands_are_laplace_bands_where_laws_are_nearly_straight(six, tmp_path):
    """A compliance about its most probable value is almost linear in its parameters: both ways must agree."""
    arm = load_arm(six.write(tmp_path, "linear"))
    found = calibrate(arm, read_measurements(tmp_path / "train.csv", arm))
    samples = sample_laws(found.fit, 60, seed=3, chains=2)
    view, names = found.fit.view, found.arm.flexure_names
    for axis in learned_axes(found.fit, {f.name: f.law for f in found.arm.flexures if f.learn}, samples):
        if axis.determined:
            assert axis.sampled == pytest.approx(axis.std, rel=0.35)
    loads = view.line.flexure_wrenches[:5, names.index(six.joints[0])]
    lower, upper = samples.band(six.joints[0], loads, view.line.row.some(np.arange(5)))
    law = samples.laws[six.joints[0]]
    twist = law.twist(loads, view.line.row.some(np.arange(5)))
    assert (lower <= twist).all() and (twist <= upper).all() and (lower < upper)[:, six.axes[0]].all()


def test_nothing_to_sample_is_said(six, tmp_path):
    arm = load_arm(six.write(tmp_path, "none"))
    found = calibrate(arm, read_measurements(tmp_path / "train.csv", arm))
    with pytest.raises(InputError, match="no flexure has learn = true"):
        sample_laws(found.fit)
    with pytest.raises(InputError, match="3 draws: expected 4 or more"):
        sample_laws(found.fit, 3)


@pytest.mark.parametrize(
    ("options", "message"),
    [(["--sample", "3"], "3 is not in the range x>=4"), (["--sample", "9", "--keep"], "leave out one of the two")],
)
def test_what_cannot_be_sampled_is_refused_at_once(learned, tmp_path, options, message):
    folder, found = learned
    arm = found.write(tmp_path / "learned.toml")
    given = ["calibrate", str(arm), str(folder / "train.csv"), "-o", str(tmp_path / "out.toml"), *options]
    ran = CliRunner().invoke(armflex, given)
    assert ran.exit_code and message in f"{ran.output}{ran.exception}"
    assert not (tmp_path / "out.toml").exists()


@pytest.mark.slow
def test_the_command_tells_what_was_learned(six, tmp_path):
    path = six.write(tmp_path, "linear")
    out, told = tmp_path / "learned.toml", tmp_path / "told.json"
    ran = CliRunner().invoke(
        armflex, ["calibrate", *map(str, (path, tmp_path / "train.csv", "-o", out, "--json", told))]
    )
    assert ran.exit_code == 0 and "Laws learned" in ran.output and "Hardly observable in these" in ran.output, (
        ran.output
    )
    laws = json.loads(told.read_text())["laws"]
    assert {law["flexure"] for law in laws} == set(six.joints)
    assert any(law["told"] and law["std"] < 0.2 * law["learned"] for law in laws)
    assert CliRunner().invoke(armflex, ["deflect", str(out), "--q", "J3=0.4"]).exit_code == 0
