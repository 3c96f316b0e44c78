"""A search that is interrupted loses nothing, says what it does, and never makes an arm worse."""

from __future__ import annotations

import dataclasses
import errno
import hashlib
import importlib
import json
import os
import re
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from support.campaigns import Truth, draw
from support.command_line import strict_json
from support.effect_arms import quietly

from armflex import calibrate, load_arm, predict, read_measurements, trace
from armflex.cli.calibrate_command import as_json as calibrated_json
from armflex.cli.trace_command import Outputs, as_json, command, print_trace
from armflex.errors import ConvergenceError, FileError, InputError
from armflex.files import arm_file, calibration_table
from armflex.measured.measurements import Measurements
from armflex.show.report import render_report
from armflex.trace.checkpoint import identity, read_checkpoint, restored
from armflex.trace.findings import Trace, write_traced
from armflex.trace.state import begin
from armflex.trace.telling import Doing
from armflex.version import __version__

pytestmark = pytest.mark.slow

search, grow, findings = (importlib.import_module(f"armflex.trace.{name}") for name in ("rounds", "grow", "findings"))
"""The modules: `armflex.trace` is the function where armflex is imported."""


@dataclasses.dataclass
class Whole:
    """A search that nobody interrupted, and what there was on the way."""

    truth: Truth
    rows: Measurements
    used: np.ndarray
    finished: Trace
    accounts: list[Trace]
    checkpoints: list[str]
    left: bool
    heard: list[Doing]
    stages: list[str]

    @property
    def arm(self):
        return load_arm(self.truth.arm)

    def again(self, path: Path, **more: Any) -> Trace:
        return trace(self.arm, self.rows, self.used, checkpoint=path, resume=True, **more)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Whole:
    """Hysteresis, whose memory asks for the rows that were not read as well."""
    folder = tmp_path_factory.mktemp("whole")
    truth = draw("hysteresis", 100, "boom").write(folder)
    arm = load_arm(truth.arm)
    rows = read_measurements(truth.train, arm)
    used = np.flatnonzero(rows.measured)
    checkpoint, accounts, checkpoints, heard, stages = folder / "c.json", [], [], [], []

    def account(found: Trace) -> None:
        accounts.append(found)
        checkpoints.append(checkpoint.read_text())

    options = {"account": account, "progress": heard.append, "report": stages.append, "checkpoint": checkpoint}
    finished = trace(arm, rows, used, **options)
    return Whole(truth, rows, used, finished, accounts, checkpoints, checkpoint.exists(), heard, stages)


# What there is on the way.


def test_after_every_effect_there_is_an_account_and_a_checkpoint(whole: Whole) -> None:
    *passing, last = whole.accounts
    assert len(passing) == len(whole.finished.found) >= 1 and last is whole.finished
    assert [len(one.found) for one in passing] == list(range(1, len(passing) + 1))
    assert all(one.unfinished for one in passing) and not last.unfinished and not whole.left
    told = [json.loads(text) for text in whole.checkpoints]
    assert [len(one["steps"]) for one in told] == [*range(1, len(passing) + 1), len(passing)]
    assert [one["ended"] for one in told] == [False] * len(passing) + [True]


def test_what_is_unfinished_says_so_wherever_it_is_read(whole: Whole, tmp_path: Path) -> None:
    """In the arm, the page and the JSON; and the mark is gone with the finished one."""
    outputs = Outputs(whole.truth.arm, tmp_path / "t.toml", tmp_path / "t.html", tmp_path / "t.json")
    for found, marked in ((whole.accounts[0], True), (whole.finished, False)):
        outputs.write(found)
        with warnings.catch_warnings(record=True) as flags:
            warnings.simplefilter("always")
            arm = load_arm(outputs.arm)
        said = [str(doubt.message) for doubt in flags]
        assert any(re.search(r"t\.toml:\d+: written while `armflex trace` was", one) for one in said) is marked
        assert ("unfinished" in [flag.code for flag in arm.flags]) is marked
        assert [effect.name for effect in arm.effects] == [one.effect.name for one in found.found]
        assert np.isfinite(predict(arm, whole.rows).position[whole.used]).all()
        assert strict_json(outputs.json).get("unfinished", False) is marked
        page = outputs.report.read_text()
        assert ("Unfinished: written while" in page) is marked
        assert ("Not computed yet." in page) is marked


def test_an_unfinished_arm_stays_whole_until_the_next_takes_its_place(
    whole: Whole, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where a large covariance is in a file of its own, and whoever writes is killed between the two."""
    monkeypatch.setattr(calibration_table, "MOST_ROWS", 5)
    path = tmp_path / "t.toml"
    write_traced(whole.truth.arm, whole.accounts[0], path)
    first = quietly(path)

    def killed(target: Path, data: bytes) -> None:
        raise KeyboardInterrupt

    write = arm_file.write_whole
    for found in (dataclasses.replace(whole.finished, unfinished=True), whole.finished):
        monkeypatch.setattr(
            arm_file, "write_whole", lambda target, data: (killed if target == path else write)(target, data)
        )
        with pytest.raises(KeyboardInterrupt):
            write_traced(whole.truth.arm, found, path)
        np.testing.assert_array_equal(quietly(path).certainty.covariance, first.certainty.covariance)
    monkeypatch.setattr(arm_file, "write_whole", write)
    write_traced(whole.truth.arm, whole.finished, path)
    quietly(path)
    beside = {file.name for file in tmp_path.glob("*.safetensors")}
    assert "t.covariance.safetensors" in beside and (tmp_path / "t.toml").exists()


# Going on.


def same(one: Trace, other: Trace) -> None:
    """See that two traces are the same to rounding."""
    assert [found.effect.name for found in one.found] == [found.effect.name for found in other.found]
    for first, second in zip(one.found, other.found, strict=True):
        np.testing.assert_allclose(first.effect.values, second.effect.values, rtol=1e-6)
        np.testing.assert_allclose(first.evidence, second.evidence, rtol=1e-5)
        assert [effect.title for effect, _ in first.equivalent] == [effect.title for effect, _ in second.equivalent]
        assert first.proof == second.proof and first.witness == second.witness
        assert [entry.candidate for entry in first.ranking] == [entry.candidate for entry in second.ranking]
    np.testing.assert_allclose(one.rms, other.rms, rtol=1e-7)
    np.testing.assert_allclose(one.held_out_after, other.held_out_after, rtol=1e-7)
    np.testing.assert_array_equal(one.rows, other.rows)
    known, again = (found.arm.certainty.covariance for found in (one, other))
    std = np.sqrt(np.diag(known))
    assert np.abs((again - known) / np.outer(std, std)).max() < 1e-6
    assert one.next_measurement == other.next_measurement


@pytest.mark.parametrize("which", [0, -1], ids=["after the first effect", "in the final account"])
def test_what_goes_on_ends_as_what_was_not_interrupted(whole: Whole, tmp_path: Path, which: int) -> None:
    path, stages = tmp_path / "c.json", []
    path.write_text(whole.checkpoints[which])
    same(whole.again(path, report=stages.append), whole.finished)
    assert not path.exists() and not any(
        "refitting with" in stage for stage in stages[: stages.index("calibrating") + 2]
    )
    if which == -1:
        assert not any(stage.startswith("refitting") for stage in stages)


def test_a_random_twist_and_rows_left_out_are_kept(tmp_path: Path) -> None:
    truth = draw("random_pose", 100, "six").write(tmp_path)
    arm = load_arm(truth.arm)
    rows = read_measurements(truth.train, arm)
    used, path = np.flatnonzero(rows.measured), tmp_path / "c.json"
    written: list[str] = []
    write = search.write_checkpoint
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search, "write_checkpoint", lambda *given: (write(*given), written.append(path.read_text()))[0])
        finished = trace(arm, rows, used, checkpoint=path)
    assert finished.state.random is not None and not finished.found
    path.write_text(next(text for text in written if any(one["random"] for one in json.loads(text)["rounds"])))
    same(trace(arm, rows, used, checkpoint=path, resume=True), finished)


def resealed(text: str, change: Callable[[dict], object]) -> str:
    """Return a checkpoint with other content and a digest that fits it."""
    said = json.loads(text)
    del said["sha256"]
    change(said)
    plain = json.dumps(said, sort_keys=True, separators=(",", ":"))
    return json.dumps({**said, "sha256": hashlib.sha256(plain.encode()).hexdigest()})


def test_what_belongs_to_something_else_is_refused_and_named(whole: Whole, tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    path.write_text(whole.checkpoints[0])
    arm, rows = whole.arm, whole.rows
    softer = dataclasses.replace(arm, prior=dataclasses.replace(arm.prior, tool=2.0 * arm.prior.tool + 1e-3))
    later = dataclasses.replace(rows, time=rows.time + 1.0)
    for given, options, complaint in (
        ((softer, rows, whole.used), {}, "the arm is not the same (in prior)"),
        ((arm, later, whole.used), {}, "the measurements are not the same (in time)"),
        ((arm, rows, whole.used[1:]), {}, "the options are not the same (rows was "),
        ((arm, rows, whole.used), {"keep": True}, "(keep was False and is True)"),
    ):
        with pytest.raises(FileError) as refused:
            trace(*given, checkpoint=path, resume=True, **options)
        assert f"{path}: belongs to another search: " in str(refused.value) and complaint in str(refused.value)
    older = resealed(path.read_text(), lambda said: said["about"]["version"].update(armflex="0.0.1"))
    path.write_text(older)
    with pytest.raises(FileError, match=f"the version is not the same .armflex was '0.0.1' and is '{__version__}'"):
        whole.again(path)
    assert path.read_text() == older
    with pytest.raises(FileError, match="does not exist: there is no interrupted search"):
        whole.again(tmp_path / "none.json")
    with pytest.raises(InputError, match="resume needs the checkpoint"):
        trace(arm, rows, resume=True)


DAMAGED = {
    "cut": lambda text: text[: len(text) // 2],
    "empty": lambda text: "",
    "a list": lambda text: "[]",
    "another format": lambda text: text.replace("armflex-trace-checkpoint-2", "armflex-trace-1"),
    "one digit": lambda text: text.replace('"gain": ', '"gain": 1', 1),
    "no number": lambda text: text.replace('"witness": false', '"witness": NaN'),
    "deep": lambda text: "[" * 100_000,
}


@pytest.mark.parametrize("damage", DAMAGED.values(), ids=DAMAGED)
def test_what_is_damaged_is_refused(whole: Whole, tmp_path: Path, damage: Callable[[str], str]) -> None:
    path = tmp_path / "c.json"
    path.write_text(damage(whole.checkpoints[0]))
    with pytest.raises(FileError, match=r"c\.json: (is damaged|is no checkpoint|its SHA-256 is not)"):
        read_checkpoint(path, identity(whole.arm, whole.rows, whole.used, False))


def first_block(said: dict) -> dict:
    return next(one["effects"][0] for one in said["rounds"] if one["effects"])


def first_effect(said: dict) -> dict:
    return first_block(said)["effect"]


def first_place(said: dict) -> dict:
    return first_effect(said)["location"]


FOREIGN = {
    "no such law": (lambda said: first_effect(said).update(law="backlsh"), "no law 'backlsh', did you mean 'backlash'"),
    "no such site": (lambda said: first_place(said).update(site="A99"), "no site 'A99'"),
    "no such axis": (lambda said: first_place(said).update(axis="rw"), "no axis 'rw'"),
    "no such column": (lambda said: first_place(said).update(covariates=["tide"]), "no columns tide in"),
    "too many values": (lambda said: first_effect(said)["values"].append(1.0), "values of "),
    "text for a number": (lambda said: said["rounds"][-1]["values"].__setitem__(0, "1"), "expected a finite number"),
    "a value more": (lambda said: said["rounds"][-1]["values"].append(0.0), "values for "),
    "a huge number": (lambda said: said["rounds"][-1]["values"].__setitem__(0, 10**400), "does not hold a search"),
    "no prior": (lambda said: first_block(said)["prior"].__setitem__(0, 0.0), "numbers above 0"),
    "a row beyond": (lambda said: said["rounds"][-1]["left_out"].append(10**6), "whole number from 0 to"),
    "a round beyond": (lambda said: first_block(said).update(context=7), "context is 7"),
    "a step too many": (lambda said: said["steps"].append(said["steps"][0]), "steps for"),
    "no proof": (lambda said: said["steps"][0].pop("proof"), "'proof' is missing"),
    "true for a flag": (lambda said: said.update(ended="yes"), "ended is 'yes', expected bool"),
    "rounds of texts": (lambda said: said.update(rounds=["a"]), "does not hold a search"),
}


@pytest.fixture(scope="module")
def begun(whole: Whole):
    return begin(calibrate(whole.arm, whole.rows, whole.used, as_stated=True))


@pytest.mark.parametrize(("change", "complaint"), FOREIGN.values(), ids=FOREIGN)
def test_what_fits_no_such_arm_is_refused_although_its_digest_is_right(
    whole: Whole, begun, tmp_path: Path, change: Callable[[dict], object], complaint: str
) -> None:
    path = tmp_path / "c.json"
    path.write_text(resealed(whole.checkpoints[0], change))
    said = read_checkpoint(path, identity(whole.arm, whole.rows, whole.used, False))
    with pytest.raises(FileError) as refused:
        restored(path, said, begun)
    assert complaint in str(refused.value)


def test_a_row_that_is_not_used_cannot_be_left_out(whole: Whole, begun, tmp_path: Path) -> None:
    path, unread = tmp_path / "c.json", int(np.flatnonzero(~whole.rows.measured)[0])
    path.write_text(resealed(whole.checkpoints[0], lambda said: said["rounds"][-1]["left_out"].append(unread)))
    said = read_checkpoint(path, identity(whole.arm, whole.rows, whole.used, False))
    with pytest.raises(FileError, match="left_out names a row that is not used"):
        restored(path, said, begun)


# The command.


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Truth:
    """One effect."""
    return draw("backlash", 1, "six").write(tmp_path_factory.mktemp("field"))


def asked(field: Truth, folder: Path, *more: str) -> list[str]:
    files = {"-o": "t.toml", "--json": "t.json", "--report": "t.html"}
    return [str(field.arm), str(field.train), *(x for o, name in files.items() for x in (o, str(folder / name))), *more]


def run(field: Truth, folder: Path, *more: str) -> Result:
    return CliRunner().invoke(command, asked(field, folder, *more))


KILLED = """
import importlib, os, signal, sys
import armflex.cli.trace_command
signal.signal(signal.SIGINT, signal.default_int_handler)
module = importlib.import_module("armflex.trace.rounds")
how = getattr(signal, sys.argv.pop())
module.conclude = lambda *given: os.kill(os.getpid(), how)
sys.argv[1:] = ["trace", *sys.argv[1:]]
from armflex.cli.main import main
main()
"""


@pytest.mark.skipif(os.name != "posix", reason="sends signals")
def test_whatever_ends_it_what_was_accepted_is_there_and_goes_on(field: Truth, tmp_path: Path, monkeypatch) -> None:
    """Killed, then Ctrl-C, then an error in the final account, then one in the page's making; then it ends."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    kept, codes = tmp_path / "t.checkpoint.json", []
    for name in ("SIGKILL", "SIGINT", "SIGTERM"):
        more = ["--resume"] if codes else []
        command_line = [sys.executable, "-c", KILLED, *asked(field, tmp_path, *more), name]
        ended = subprocess.run(command_line, capture_output=True, text=True, env=environment, timeout=600)
        codes.append(ended.returncode)
        assert codes[-1] in (-signal.SIGKILL, 130, -signal.SIGTERM), ended.stderr
        assert "Traceback" not in ended.stderr, ended.stderr
        arm = quietly(tmp_path / "t.toml")
        assert len(arm.effects) == 1 and "unfinished" in [flag.code for flag in arm.flags]
        assert strict_json(tmp_path / "t.json")["unfinished"] and kept.exists()
        assert "Unfinished" in (tmp_path / "t.html").read_text()
    assert codes == [-signal.SIGKILL, 130, -signal.SIGTERM]

    def unsettled(*given: Any) -> None:
        raise ConvergenceError("calibration did not settle", [1.0])

    with monkeypatch.context() as patch:
        patch.setattr(findings, "pruned", unsettled)
        failed = run(field, tmp_path, "--resume")
    assert isinstance(failed.exception, ConvergenceError) and f"kept in {kept}" in failed.stderr
    assert quietly(tmp_path / "t.toml").effects == arm.effects

    def unmade(*given: Any) -> None:
        raise ValueError("no ink")

    page = (tmp_path / "t.html").read_text()
    with monkeypatch.context() as patch:
        patch.setattr("armflex.cli.trace_command.write_report", unmade)
        failed = run(field, tmp_path, "--resume")
    assert str(failed.exception) == "no ink" and kept.exists() and "Effects identified" in failed.stdout
    assert strict_json(tmp_path / "t.json")["unfinished"] and (tmp_path / "t.html").read_text() == page

    finished = run(field, tmp_path, "--resume")
    assert finished.exit_code == 0, finished.output
    assert sorted(path.name for path in tmp_path.iterdir()) == ["t.html", "t.json", "t.toml"]
    assert "Unfinished" not in (tmp_path / "t.html").read_text()
    assert "unfinished" not in [flag.code for flag in quietly(tmp_path / "t.toml").flags]
    nothing = run(field, tmp_path, "--resume")
    assert isinstance(nothing.exception, FileError) and "does not exist" in str(nothing.exception)


def test_a_search_that_begins_anew_says_that_another_could_go_on(field: Truth, tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "t.checkpoint.json").write_text("{}")
    monkeypatch.setattr("armflex.cli.trace_command.trace", lambda *given: (_ for _ in ()).throw(KeyboardInterrupt))
    said = run(field, tmp_path)
    assert "--resume continues that one" in said.stderr
    assert (tmp_path / "t.checkpoint.json").read_text() == "{}"


def test_no_output_takes_the_place_of_the_checkpoint(field: Truth, tmp_path: Path) -> None:
    asked = [field.arm, field.train, "-o", tmp_path / "t.toml", "--json", tmp_path / "t.checkpoint.json"]
    refused = CliRunner().invoke(command, [str(one) for one in asked])
    assert isinstance(refused.exception, InputError) and "is where the search is kept" in str(refused.exception)
    refused = CliRunner().invoke(command, [str(field.arm), str(field.train), "-o", os.devnull, "--resume"])
    assert isinstance(refused.exception, InputError) and "which is no file" in str(refused.exception)


# A full disk.


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


def test_a_full_disk_ends_no_search_and_spoils_no_file(
    whole: Whole, tmp_path: Path, full_disk: list[int], capsys: pytest.CaptureFixture
) -> None:
    outputs = Outputs(whole.truth.arm, tmp_path / "t.toml", None, tmp_path / "t.json")
    outputs.write(whole.accounts[0])
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    full_disk.append(1)
    outputs.write(whole.accounts[0])
    said = capsys.readouterr().err
    assert f"{outputs.arm}: cannot be written: No space left on device; the search goes on" in said
    with pytest.raises(FileError, match=r"t\.toml: cannot be written: No space left on device"):
        outputs.write(whole.finished)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    full_disk.clear()
    outputs.write(whole.finished)
    assert "unfinished" not in strict_json(outputs.json)


def test_a_checkpoint_that_cannot_be_written_ends_no_search_and_leaves_the_last_one(
    whole: Whole, tmp_path: Path, full_disk: list[int]
) -> None:
    path, seen, stages = tmp_path / "c.json", [], []
    path.write_text(whole.checkpoints[0])
    full_disk.append(1)
    found = whole.again(path, report=stages.append, account=lambda found: seen.append(path.read_text()))
    assert f"{path}: cannot be written: No space left on device; the search goes on" in stages
    assert seen == [whole.checkpoints[0]] and [one.effect.name for one in found.found] == [
        one.effect.name for one in whole.finished.found
    ]
    with pytest.raises(FileError, match=r"d\.json: cannot be written: No space left on device"):
        trace(whole.arm, whole.rows, whole.used, checkpoint=tmp_path / "d.json")
    assert not list(tmp_path.iterdir())


# What it says.


def test_every_long_stage_says_how_far_it_is_and_what_there_is(whole: Whole) -> None:
    heard = whole.heard
    for stage, within in (
        ("calibrating", "step"),
        ("searching", "screening candidates"),
        ("searching", "refining"),
        ("searching", "what chance gives"),
        ("refitting with hysteresis", "step"),
        ("predicting held-out poses", "screening candidates"),
        ("comparing what else would do", "refining"),
    ):
        assert any(one.stage.startswith(stage) and one.trying.startswith(within) for one in heard), (stage, within)
    before, after = heard[0], heard[-1]
    assert before.rms is None and str(before) == "calibrating"
    assert after.effects == tuple(one.effect.title for one in whole.finished.found)
    assert after.rms == pytest.approx(whole.finished.state.fit.rms, rel=0.05)
    assert after.held_out is not None and after.held_out > after.rms
    told = Doing("searching", "refining backlash A2 ry", 3, 9, ("backlash at A2 (ry)",), 3.31e-4, 3.61e-4)
    assert str(told) == "searching: refining backlash A2 ry, 3 of 9 [1 effect; RMS 0.331 mm, held out 0.361 mm]"


# Never worse.


def believing(patch: pytest.MonkeyPatch) -> None:
    """Have a search believe the best candidate, whatever chance and rows that it has not seen say."""

    def proven(state, looked, refitted, null, apart):
        for _, after in refitted:
            proof = grow.prove(state, after, null, after.effects[-1:])
            return dataclasses.replace(after, steps=(*state.steps, grow.Step(looked.ranking, proof, False)))
        return None

    patch.setattr(grow, "ENOUGH", -np.inf)
    patch.setattr(grow, "MARGIN", -np.inf)
    patch.setattr(search, "MOST_EFFECTS", 1)
    patch.setattr(importlib.import_module("armflex.trace.exchange"), "SAME", -np.inf)
    patch.setattr(grow, "_proven", proven)


def test_an_effect_that_makes_held_out_poses_worse_is_withdrawn(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """Noise has a best explanation, too: poses that it was not chosen for tell."""
    truth = draw("none", 101, "six").write(tmp_path)
    arm = load_arm(truth.arm)
    rows = read_measurements(truth.train, arm)
    used, accounts = np.flatnonzero(rows.measured)[::3], []
    with pytest.MonkeyPatch.context() as patch:
        believing(patch)
        found = trace(arm, rows, used, account=accounts.append)
    (gone,) = found.withdrawn
    assert [one.effect.name for one in accounts[0].found] == [gone.effect.name]
    calibrated, with_it = gone.errors
    assert with_it > calibrated and gone.compared.worse
    assert not found.found and not found.arm.effects and found.compared is None
    assert found.held_out_after == found.held_out_before and found.rms == found.calibrated_rms
    (told,) = as_json(found)["withdrawn"]
    assert told["effect"] == gone.effect.law.name or told["effect"] == "unnamed"
    assert told["held_out_rms_mm"] == {"calibrated": 1e3 * calibrated, "after": 1e3 * with_it}
    json.dumps(as_json(found), allow_nan=False)
    print_trace(found)
    said = " ".join(capsys.readouterr().out.split())
    assert f"Withdrawn: {gone.title}; with it poses held out are predicted to " in said
    assert "No further effect" not in said
    assert "The search ended at its limit of 1 effect: more may be missing." in said
    assert found.stopped_at == as_json(found)["stopped_at_limit"] == 1
    page = render_report(found)
    assert found.said_of_limit in page
    assert "Withdrawn: " in page and "predicts held-out poses better than the calibrated arm" in page


def test_what_is_there_is_not_withdrawn(whole: Whole) -> None:
    found = whole.finished
    assert found.stopped_at is None and "stopped_at_limit" not in as_json(found)
    assert found.withdrawn == () and found.compared.after < found.compared.before
    assert as_json(found)["withdrawn"] == []
    told = as_json(found)["held_out_chosen_again_rms_mm"]
    assert told == {"calibrated": 1e3 * found.compared.before, "after": 1e3 * found.compared.after}


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
    assert calibrate(arm, read, few[:4]).held_out is None  # fewer poses than folds
    told = calibrated_json(found)["held_out_rms_mm"]
    assert told == {"declared": 1e3 * declared, "calibrated": 1e3 * calibrated}
