"""A search says what it does, and never makes an arm worse."""

import dataclasses
import errno
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support.campaigns import Drawn, Truth, draw
from support.command_line import strict_json
from support.scoring import Score, judge

from armflex import calibrate, load_arm, predict, read_measurements, trace
from armflex.cli.trace_command import Outputs, as_json
from armflex.errors import FileError
from armflex.estimate.held_out import held_out, pose_folds
from armflex.measured.measurements import Measurements
from armflex.progress import Doing
from armflex.trace.account import conclude
from armflex.trace.averaging import alone
from armflex.trace.findings import Trace
from armflex.trace.screen import ALMOST
from armflex.trace.search import Standing, refitted, standing
from armflex.trace.selection import SCALES, Chosen
from armflex.trace.state import begin

pytestmark = pytest.mark.slow


@dataclasses.dataclass
class Whole:
    """A search that nobody interrupted, and what there was on the way."""

    drawn: Drawn
    truth: Truth
    rows: Measurements
    used: np.ndarray
    finished: Trace
    heard: list[Doing]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Whole:
    """Hysteresis, whose memory asks for the rows that were not read as well."""
    drawn = draw("hysteresis", 100, "boom")
    truth = drawn.write(tmp_path_factory.mktemp("whole"))
    arm = load_arm(truth.arm)
    rows = read_measurements(truth.train, arm)
    used, heard = np.flatnonzero(rows.measured), []
    return Whole(drawn, truth, rows, used, trace(arm, rows, used, progress=heard.append), heard)


def test_what_was_hidden_is_named_where_it_is(whole: Whole) -> None:
    found = Score("hysteresis", 100, "boom", 1.0)
    judge(found, whole.drawn, whole.truth, whole.finished)
    assert found.verdict == "exact", found
    assert found.after < 1.08 * found.floor and found.after < found.before


def test_a_search_that_some_poses_lead_ends_where_one_of_all_does(
    whole: Whole, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its effect, its values and its errors are of all rows."""
    said, poses = list[str](), len(np.unique(whole.rows.pose_number[whole.used]))
    monkeypatch.setattr(sys.modules["armflex.trace.search"], "ROWS_AT_ONCE", poses)
    led = trace(load_arm(whole.truth.arm), whole.rows, whole.used, report=said.append)
    assert any(one.startswith(f"beginning with {poses // 2} of {poses} ") for one in said)
    (found,), (other,) = led.found, whole.finished.found
    assert found.effect.title == other.effect.title and found.effect.seen == other.effect.seen
    assert found.effect.values == pytest.approx(other.effect.values, rel=1e-2)
    assert led.held_out == pytest.approx(whole.finished.held_out, rel=1e-3)
    assert np.array_equal(led.rows, whole.finished.rows)


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """A disk that takes no more bytes once the list holds something."""
    full: list[int] = []
    replace = os.replace

    def refused(source: str, target: str) -> None:
        if full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        replace(source, target)

    monkeypatch.setattr(os, "replace", refused)
    yield full


def test_a_full_disk_spoils_no_file(whole: Whole, tmp_path: Path, full_disk: list[int]) -> None:
    outputs = Outputs(tmp_path / "t.toml", None, tmp_path / "t.json")
    outputs.write(whole.finished)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    full_disk.append(1)
    with pytest.raises(FileError, match=r"t\.toml: cannot be written: No space left on device"):
        outputs.write(whole.finished)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    full_disk.clear()
    outputs.write(whole.finished)
    assert "unfinished" not in strict_json(outputs.json)


def test_a_long_stage_says_how_far_it_is_and_what_there_is(whole: Whole) -> None:
    heard = whole.heard
    for stage, within in (("calibrating", "step"), ("screening", "screening candidates"), ("refitting with", "step")):
        assert any(one.stage.startswith(stage) and one.trying.startswith(within) for one in heard), (stage, within)
    before, after = heard[0], heard[-1]
    assert before.rms is None and str(before) == "calibrating"
    assert after.effects == tuple(effect.title for effect in whole.finished.state.fitted)
    assert after.rms == pytest.approx(whole.finished.state.fit.rms, rel=0.05)
    told = Doing("searching", "refining backlash A2 ry", 3, 9, ("backlash at A2 (ry)",), 3.31e-4)
    assert str(told) == "searching: refining backlash A2 ry, 3 of 9 [1 effect; RMS 0.331 mm]"


# Never worse.


@pytest.fixture(scope="module")
def empty(tmp_path_factory: pytest.TempPathFactory) -> Standing:
    """A third of a campaign of which nothing is hidden, calibrated."""
    truth = draw("none", 101, "six").write(tmp_path_factory.mktemp("empty"), every=3)
    arm = load_arm(truth.arm)
    return standing(begin(calibrate(arm, read_measurements(truth.train, arm), as_stated=True)))


def test_an_effect_that_makes_held_out_poses_worse_is_no_finding(empty: Standing) -> None:
    """A shape of many amplitudes explains noise, too: where it is likelier to be nothing, it leaves the arm."""
    groups = empty.screen.groups
    most = max(range(len(groups)), key=lambda i: len(groups[i].places))
    believed = refitted(empty, (Chosen(most, len(SCALES) - 1),))
    assert believed is not None
    after = standing(believed)
    poses = pose_folds(believed.groups)
    before, with_it = (held_out(one, poses, judged=believed.judged).rms for one in (believed.calibrated, believed.fit))
    assert with_it > before
    assert conclude(after, empty.places).found == ()


@pytest.mark.slow
def test_a_free_shape_that_has_the_column_of_a_law_is_that_law(tmp_path: Path) -> None:
    """A turn that follows the temperature where a link begins is the bend of that link at its root."""
    truth = draw("none", 103, "boom").write(tmp_path)
    arm = load_arm(truth.arm)
    rows = read_measurements(truth.train, arm)
    screen = standing(begin(calibrate(arm, rows, np.flatnonzero(rows.measured)[::3], as_stated=True))).screen
    seen = [i for i, share in screen.single().items() if share is not None and share > ALMOST]
    free = [i for i in seen if not screen.groups[i].hypothesis.one.law.physical]
    laws = [i for i in seen if screen.groups[i].hypothesis.one.law.physical]
    places = [screen.groups[i].places[0] for i in (*free, *laws)]
    gram, _ = screen.among(np.array(places))
    size = np.sqrt(np.diag(gram))
    best = ((gram / size / size[:, None]) ** 2)[: len(free), len(free) :].max(axis=1)
    named = np.array([not np.isfinite(screen.groups[i].hypothesis.prior) for i in free])
    assert named.any() and not named.all()
    assert (best[named] > 1.0 - 3.0 * ALMOST).all() and (best[~named] < 1.0 - ALMOST / 3.0).all()


def test_an_effect_that_is_not_distinguished_from_zero_is_no_finding(empty: Standing) -> None:
    play = next(i for i, one in enumerate(empty.screen.groups) if one.hypothesis.one.name.startswith("backlash"))
    state = refitted(empty, (Chosen(play, len(SCALES) // 2),))
    assert state is not None
    believed = standing(state, empty)
    (effect,), (block,) = believed.state.fitted, believed.state.effects
    assert abs(effect.acting[0]) < 2.0 * next(iter(alone(believed.state).std_of(block).values()))
    assert conclude(believed, empty.places).found == ()


def test_what_is_there_makes_poses_better_that_it_was_chosen_without(whole: Whole) -> None:
    found = whole.finished
    assert found.compared.after < found.compared.before
    told = as_json(found)["held_out_chosen_again_rms_mm"]
    assert told == {"calibrated": 1e3 * found.compared.before, "after": 1e3 * found.compared.after}


def test_the_prior_of_an_effect_is_in_its_probability(whole: Whole) -> None:
    """Probabilities of an effect and of what else it may be are a distribution, and are in the JSON as contracted."""
    for one, told in zip(whole.finished.found, as_json(whole.finished)["effects"], strict=True):
        assert 0.0 <= one.probability <= 1.0 and told["probability"] == one.probability
        assert {"effect", "site", "axis", "probability"} <= set(told["credible"][0])
        assert sum(each["probability"] for each in told["credible"]) <= 1.0 + 1e-9


def test_calibrating_with_too_few_poses_is_said_to_make_it_worse(tmp_path: Path) -> None:
    """The arm is just as declared and the instrument errs: what is fitted to a few poses is error."""
    truth = draw("none", 100, "six").write(tmp_path)
    arm = load_arm(truth.arm)
    alone = dataclasses.replace(arm, prior=dataclasses.replace(arm.prior, tool=0.0))  # its target as declared
    rows = read_measurements(truth.train, arm)
    measured = np.flatnonzero(rows.measured)
    exact = predict(arm, rows).position
    read = dataclasses.replace(rows, position=exact + np.random.default_rng(0).normal(0.0, 5e-3, exact.shape))
    few = measured[np.unique(rows.pose_number[measured], return_index=True)[1]][:8]
    found = calibrate(alone, read, few)
    assert found.held_out is not None
    declared, calibrated = found.held_out
    assert calibrated > declared > found.rms
    (flag,) = (flag for flag in found.flags if flag.code == "worse_than_declared")
    assert f"{1e3 * calibrated:.3g} mm RMS, by the arm as declared to {1e3 * declared:.3g} mm" in flag.text
    well = calibrate(arm, rows)
    assert well.held_out is not None and well.held_out[1] < well.held_out[0] and not well.flags
    assert calibrate(arm, read, few[:4], anyway=True).held_out is None  # fewer poses than folds
    told = found.content()["held_out_rms_mm"]
    assert told == {"declared": 1e3 * declared, "calibrated": 1e3 * calibrated}
