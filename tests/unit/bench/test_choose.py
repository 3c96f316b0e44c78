"""`train --model auto`: the plainest model that the data ask for, judged with the choice inside the loop."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.command_line import Run, fine, strict_json
from support.small_arms import ROBOTS

from armflex import InputError, read_joint_data, train
from armflex.bench.cross_validation import (
    INNER,
    OUTER,
    ModelCandidate,
    ModelScore,
    assess,
    chosen,
    compare,
    hold_out,
    negligible,
    race,
    random_folds,
)
from armflex.bench.fitted import NOWHERE, Fitted
from armflex.bench.learners import Options, affordable_starts, candidates, learner
from armflex.bench.training import CHOICE
from armflex.laws.law_file import load_law
from armflex.measured.joint_data import JointData

TABLE = ROBOTS / "tarm_like" / "a4_table_1.csv"
QUICK = Options(neurons=4, starts=1)
NOISE = 1e-6


def bench(kind: str, seed: int, rows: int = 50) -> JointData:
    rng = np.random.default_rng(seed)
    loads = rng.normal(size=(rows, 3)) * 2e3
    compliance = np.diag([4e-9, 6e-9, 9e-9])
    if kind != "diagonal":
        compliance = compliance + 2e-9 * np.array([[0.0, 1.0, -0.5], [0.4, 0.0, 1.0], [-1.0, 0.3, 0.0]])
    exact = loads @ compliance.T
    if kind == "radial":
        exact += np.outer(np.hypot(loads[:, 0], loads[:, 1]), [3e-9, 0.0, -4e-9])
    if kind == "wavy":
        exact += 1e-5 * np.sin(loads / 700.0)
    deflections = exact + NOISE * rng.normal(size=exact.shape)
    return JointData(loads, deflections, ("m",) * 3, np.ones(3), "0" * 64, Path("made.csv"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "names"),
    [("diagonal", ("linear, diagonal",)), ("radial", ("full + radial", "terms as found"))],
)
def test_the_plainest_that_the_data_ask_for(kind: str, names: tuple[str, ...]) -> None:
    result = train(bench(kind, 1), "auto", options=QUICK)
    assert result.parameters["chosen"] in names
    np.testing.assert_allclose(result.held_out_rms, NOISE, rtol=0.35)
    assert result.held_out.endswith("choice inside")
    assert "not_worth_its_weights" in {flag.code for flag in result.flags}


@pytest.mark.slow
def test_a_network_is_taken_where_nothing_plain_will_do() -> None:
    result = train(bench("wavy", 2, 120), "auto", options=Options(neurons=9, starts=1))
    assert result.trained.model == "neural"
    assert not {flag.code for flag in result.flags} & {"not_worth_its_weights"}
    plain = min(rms.mean() for name, rms in result.compared if not name.startswith("network"))
    assert result.held_out_rms.mean() < 0.6 * plain


def test_within_one_standard_error_the_plainer_is_taken() -> None:
    squares = np.random.default_rng(0).chisquare(1, size=(40, 3))
    near, far = ModelScore("near", "linear", 1.05 * squares), ModelScore("far", "linear", 2.0 * squares)
    best = ModelScore("best", "linear", squares)
    assert chosen([far, near, best]) == 1
    assert chosen([far, best]) == 1
    broken = ModelScore("broken", "linear", np.full((40, 3), np.inf), "3 rows are too few")
    assert chosen([broken, best]) == 1
    with pytest.raises(InputError, match="not even 'broken': 3 rows are too few"):
        chosen([broken])


def test_a_column_that_is_followed_exactly_does_not_decide() -> None:
    """Ten times as large an error on two columns counts, 1e-15 against 1e-18 on a third does not."""
    squares = np.random.default_rng(0).chisquare(1, size=(40, 3))
    exact, other = squares * [1.0, 1.0, 0.0], squares * [0.01, 0.01, 1e-30]
    among = [ModelScore("exact", "linear", exact), ModelScore("other", "neural", other)]
    assert chosen(among, np.array([1e-6, 1e-6, 1e-6])) == 1
    data = bench("full", 1)
    least = negligible(data.deflections * [1.0, 0.0, 1.0])
    np.testing.assert_allclose(least[[0, 2]], 1e-6 * np.sqrt((data.deflections[:, [0, 2]] ** 2).mean(axis=0)))
    assert least[1] == least.max()


def test_rivals_are_compared_on_the_same_rows() -> None:
    data = bench("full", 3)
    among = [candidate for candidate in candidates(QUICK) if candidate.name.startswith("linear")]
    compared = compare(among, data, seed=4, folds=7, repeats=1)
    again = hold_out(learner("linear", Options()), data, random_folds(len(data), 7, 4))
    np.testing.assert_allclose(compared[2].rms, again.rms)


@pytest.mark.slow
def test_the_choice_is_made_anew_in_every_fold() -> None:
    held, count = assess([r for r in candidates(QUICK) if not r.name.startswith("network")], bench("radial", 5))
    assert sum(count.values()) == 10
    assert held.residual.shape == (50, 3)


def test_the_choice_sees_no_row_that_is_held_out() -> None:
    """Every fit that leads to the choice in a fold, and the fit chosen, is without that fold's rows."""
    data, seen = bench("full", 5, 40), []

    def watched(candidate: ModelCandidate) -> ModelCandidate:
        def learn(loads: np.ndarray, deflections: np.ndarray, seed: int) -> Fitted:
            seen.append(set(loads[:, 0]))
            return candidate.learner(loads, deflections, seed)

        return replace(candidate, learner=learn)

    assess([watched(candidate) for candidate in candidates(QUICK)[:2]], data, seed=3)
    per_fold = 2 * INNER + 1
    assert len(seen) == OUTER * per_fold
    fold = random_folds(40, OUTER, 3)
    for i, fits in enumerate(np.array(seen).reshape(OUTER, per_fold)):
        out = set(data.loads[fold == i, 0])
        assert not any(fitted & out for fitted in fits)
        assert len(fits[-1]) == 40 - len(out)


@pytest.mark.slow
def test_auto_on_the_published_rows(armflex: Run, tmp_path: Path) -> None:
    asked = ["train", TABLE, "--model", "auto", "--neurons", "4", "--starts", "1", "-o", "a.safetensors"]
    shown = fine(armflex(*asked, "--json", "a.json"))
    assert "comparing on 20 rows: linear, diagonal; " in shown.stderr and "from 1 of 1 starts" in shown.stderr
    assert "took s" in shown.stdout and "Selecting the model anew in every fold" in shown.stdout
    found = strict_json(tmp_path / "a.json")
    assert found["model"] == "polynomial"
    assert len(found["compared"]) == 8
    np.testing.assert_array_less(found["held_out_rms"], [0.13, 0.17, 0.3])
    law = load_law(tmp_path / "a.safetensors").law
    data = read_joint_data(TABLE)
    wrench = np.concatenate([data.loads[3], np.zeros(3)])
    np.testing.assert_allclose(law.twist(wrench, NOWHERE)[:3], data.deflections[3], atol=5e-4)


@pytest.mark.slow
@pytest.mark.parametrize("model", ["polynomial", "neural", "bayesian"])
def test_every_model_is_written_and_answers_in_an_arm(armflex: Run, tmp_path: Path, model: str) -> None:
    small = {"polynomial": [], "neural": ["--neurons", "3", "--starts", "1"], "bayesian": ["--neurons", "3"]}[model]
    fine(armflex("train", TABLE, "--model", model, *small, "--read-as", "mm=um", "-o", "law.safetensors"))
    arm = (
        (ROBOTS / "tarm_like" / "arm.toml")
        .read_text()
        .replace('urdf = "robot.urdf"', f'urdf = "{ROBOTS}/tarm_like/robot.urdf"')
    )
    arm = arm.split("[flexure.A4]")[0] + f'[flexure.A4]\njoint = "A4"\nmodel = "{model}"\nfile = "law.safetensors"\n'
    (tmp_path / "arm.toml").write_text(arm)
    shown = fine(armflex("deflect", "arm.toml", "--q", "A1=0.1", "--json", "d.json"))
    assert shown.stdout
    assert all(np.isfinite(strict_json(tmp_path / "d.json")["displacement"]))
    assert "outside" in shown.stderr
    refused = armflex("deflect", "arm.toml", "--q", "A1=0.1", "--strict")
    assert "outside" in fine(refused, 1).stderr


@pytest.mark.parametrize(("kind", "seed"), [("diagonal", 1), ("full", 2), ("radial", 3), ("wavy", 4), ("wavy", 5)])
def test_fits_are_left_out_only_where_the_choice_is_the_same(kind: str, seed: int) -> None:
    data, fitted = bench(kind, seed, 60 if kind == "wavy" else 30), []
    *plain, network = candidates(replace(QUICK, neurons=8))

    def learn(loads: np.ndarray, deflections: np.ndarray, own: int) -> Fitted:
        fitted.append(len(loads))
        return network.learner(loads, deflections, own)

    among, least = (*plain, replace(network, learner=learn)), negligible(data.deflections)
    whole = chosen(compare(among, data, 7, INNER, 1), least)
    everything = len(fitted)
    assert race(among, data, 7, INNER, least) == whole and everything == INNER
    # A network that is by far the worst is left after its first rows; one that may yet win is fitted to the end.
    assert (len(fitted) - everything == INNER) if kind == "wavy" else (len(fitted) - everything < INNER)


def test_a_network_of_auto_is_trained_in_proportion_to_the_rows() -> None:
    options = Options()
    assert [affordable_starts(options, rows * 3) for rows in (4, 20, 40, 67, 1000)] == [1, 3, 6, 10, 10]
    assert affordable_starts(replace(options, starts=2), 3000) == 2


@pytest.mark.slow
def test_auto_with_its_own_numbers_ends_and_says_what_took_how_long() -> None:
    began = time.process_time()
    seen: list[tuple[int, int]] = []
    result = train(read_joint_data(TABLE), "auto", progress=lambda done, total: seen.append((done, total)))
    assert time.process_time() - began < 60.0
    done = [count for count, _ in seen]  # a network's fits count for as much more as they take
    assert done == sorted(set(done)) and {total for _, total in seen} == {done[-1]} and len(seen) == 170
    assert [name for name, _ in result.compared] + [CHOICE] == list(result.seconds)
    assert all(seconds > 0.0 for seconds in result.seconds.values())
