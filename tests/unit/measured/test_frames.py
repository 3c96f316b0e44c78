"""A data frame is taken wherever a table is, with the same result and the same errors; rows are named by the index."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.small_arms import ROBOTS
from support.two_arms import beside, two_arms

import armflex
from armflex.errors import ArmflexWarning, TableError
from armflex.rows.wrench import Wrench

pandas = pytest.importorskip("pandas")
FOLDER = ROBOTS / "tarm_like"


@pytest.fixture(scope="module")
def arm() -> armflex.Arm:
    return armflex.load_arm(FOLDER / "measured.toml")


def named(table: str) -> pandas.DataFrame:
    frame = pandas.read_csv(FOLDER / table)
    return frame.set_index(pandas.Index([f"shot {i}" for i in range(len(frame))]))


def test_a_frame_is_read_as_its_file(arm: armflex.Arm) -> None:
    file, frame = (armflex.read_measurements(one, arm) for one in (FOLDER / "campaign.csv", named("campaign.csv")))
    np.testing.assert_array_equal(file.q, frame.q)
    np.testing.assert_array_equal(file.position, frame.position)
    np.testing.assert_array_equal(file.measured, frame.measured)
    assert file.pose == frame.pose and file.session == frame.session and frame.sha256 != file.sha256
    assert str(frame.places[3]) == "data frame, row 'shot 3'"
    again = armflex.read_measurements(named("campaign.csv"), arm)
    assert again.sha256 == frame.sha256


def test_every_public_function_takes_a_frame(arm: armflex.Arm) -> None:
    path, bench = named("trajectory.csv"), named("a4_table_1.csv")
    file = armflex.read_trajectory(FOLDER / "trajectory.csv", arm)
    assert armflex.check(arm, path, 0.1).to_dict() == armflex.check(arm, file, 0.1).to_dict()
    np.testing.assert_array_equal(
        armflex.compensate(arm, path).trajectory.q, armflex.compensate(arm, file).trajectory.q
    )
    rows = named("held_out.csv").iloc[:5]
    assert len(armflex.predict(arm, rows).position) == 5
    assert (
        armflex.train(bench).to_dict()["parameters"] == armflex.train(FOLDER / "a4_table_1.csv").to_dict()["parameters"]
    )


def test_what_a_result_gives_is_read_again(arm: armflex.Arm) -> None:
    file = armflex.read_measurements(FOLDER / "campaign.csv", arm)
    again = armflex.read_measurements(file.to_frame(), arm)
    np.testing.assert_array_equal(file.position[file.measured], again.position[again.measured])
    np.testing.assert_array_equal(file.sigma[file.measured], again.sigma[again.measured])
    path = armflex.read_trajectory(FOLDER / "trajectory.csv", arm)
    np.testing.assert_array_equal(armflex.read_trajectory(path.to_frame(), arm).q, path.q)


def driven(count: int) -> pandas.DataFrame:
    """Return rows of two arms, the tool of one pulled at in some of them."""
    rng = np.random.default_rng(1)
    own = {f"q_{name}": rng.uniform(-1.5, 1.5, count) for name in ("to_torso", "to_upper", "to_fore")}
    own |= {f"q_{name}": values for name, values in beside(count).items()}
    pulled = np.arange(count) % 3 > 0
    forces = {f"force_{name}": np.where(pulled, rng.normal(size=count), 0.0) for name in ("fx", "fz", "my")}
    where = {"force_frame": np.where(np.arange(count) % 2, "fore", "tool"), "force_axes": "link"}
    return pandas.DataFrame({"payload": "part", "warmth": rng.normal(size=count), **own, **forces, **where})


def same_loads(some: tuple[Wrench, ...], others: tuple[Wrench, ...]) -> None:
    assert [(one.frame, one.axes, one.hangs) for one in some] == [(one.frame, one.axes, one.hangs) for one in others]
    for one, other in zip(some, others, strict=True):
        np.testing.assert_array_equal(one.force, other.force)
        np.testing.assert_array_equal(one.moment, other.moment)


@pytest.mark.parametrize("given", [{}, {"hold": 3.0, "time": np.arange(9.0), "approach_to_upper": [-1, 0, 1] * 3}])
def test_a_campaign_is_read_again_with_its_loads(tmp_path: Path, given: dict[str, object]) -> None:
    arm, read = two_arms(tmp_path), {name: [np.nan, *[0.3] * 8] for name in "xyz"} | {"sigma": 1e-4}
    whole = armflex.read_measurements(driven(9).assign(**read, **given), arm)
    assert [one.hangs for one in whole.wrenches] == [False, False, True]
    for campaign in (whole, whole.some([5, 3, 4])):
        again = armflex.read_measurements(campaign.to_frame(), arm)
        same_loads(campaign.wrenches, again.wrenches)
        for name in ("pose", "session", "payload"):
            assert getattr(campaign, name) == getattr(again, name)
        for name in ("q", "approach", "measured", "hold", "position"):
            np.testing.assert_array_equal(getattr(campaign, name), getattr(again, name))
        assert campaign.covariates.keys() == again.covariates.keys() == {"warmth"}
        np.testing.assert_array_equal(campaign.covariates["warmth"], again.covariates["warmth"])
    assert armflex.read_measurements(whole.to_frame(), arm).derived == whole.derived


def test_a_path_is_read_again_with_its_loads_and_where_it_is_meant_to_be(tmp_path: Path) -> None:
    arm, rng = two_arms(tmp_path), np.random.default_rng(2)
    moved = {f"{prefix}_{joint}": rng.normal(size=6) for prefix in "va" for joint in arm.joint_names}
    path = armflex.read_trajectory(driven(6).assign(time=np.arange(6.0), via=[*"abcdef"], **moved), arm)
    for meant in (path, path.towards(replace(path, q=path.q + 0.01))):
        file = armflex.write_trajectory(meant, tmp_path / "path.csv")
        assert list(pandas.read_csv(file)) == list(meant.to_frame())
        for again in (armflex.read_trajectory(one, arm) for one in (file, meant.to_frame())):
            same_loads(meant.wrenches, again.wrenches)
            assert (again.payload, again.via) == (meant.payload, meant.via)
            for name in ("time", "q", "v", "a"):
                np.testing.assert_array_equal(getattr(meant, name), getattr(again, name))
            np.testing.assert_array_equal(meant.covariates["warmth"], again.covariates["warmth"])
            assert (meant.target is None) == (again.target is None)
            if meant.target is not None:
                np.testing.assert_array_equal(meant.target, again.target)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda frame: frame.assign(x=frame.x.astype(object).where(frame.index != "shot 4", "a lot")),
         r"^data frame, row 'shot 4': column 'x' is 'a lot', not a finite number"),
        (lambda frame: frame.rename(columns={"q_A1": "q_AA1"}), r"^data frame: has no column 'q_A1'"),
        (lambda frame: frame.assign(payload="p601"), r"^data frame, row 'shot 0': no payload named 'p601'"),
        (lambda frame: frame.assign(x=[[1.0]] * len(frame)), r"^data frame: column 'x' holds \[1\.0\], expected"),
        (lambda frame: frame.assign(pose="a\x1b[2J"), r"^data frame, row 'shot 0': holds the character"),
        (lambda frame: frame.iloc[:0], r"^data frame: has a header but no rows"),
        (lambda frame: frame.set_axis(range(frame.shape[1]), axis=1), r"^data frame: has no header row"),
    ],
)  # fmt: skip
def test_the_same_errors(arm: armflex.Arm, change, words: str) -> None:
    with pytest.raises(TableError, match=words):
        armflex.read_measurements(change(named("campaign.csv")), arm)


def test_units_in_the_headers(arm: armflex.Arm) -> None:
    frame = named("trajectory.csv")
    turned = [name for name in frame.columns if name.startswith("q_A")]
    degrees = frame.assign(**{f"{name}_deg": np.degrees(frame[name]) for name in turned}).drop(columns=turned)
    np.testing.assert_allclose(
        armflex.read_trajectory(degrees, arm).q, armflex.read_trajectory(frame, arm).q, rtol=0.0, atol=1e-12
    )


def test_a_tolerance_in_millimetres_is_questioned(arm: armflex.Arm) -> None:
    path = FOLDER / "trajectory.csv"
    with pytest.warns(
        ArmflexWarning, match=r"a tolerance of 2 m for an arm of .* m: lengths are metres, 2 mm are 0\.002"
    ):
        assert "tolerance" in [flag.code for flag in armflex.check(arm, path, tolerance=2).flags]
    assert "tolerance" not in [flag.code for flag in armflex.check(arm, path, tolerance=0.1).flags]
    with pytest.warns(ArmflexWarning, match=r"a tolerance of 5 rad .*: angles are radians, 5 degrees are 0\.08727"):
        assert "tolerance_angle" in [flag.code for flag in armflex.check(arm, path, 0.1, angle=5).flags]
    assert not [flag for flag in armflex.check(arm, path, 0.1, angle=0.05).flags if "tolerance" in flag.code]
    found = armflex.map_workspace(arm, rows=64, voxel=1.0)
    with pytest.warns(ArmflexWarning, match=r"a tolerance of 2 m .*: lengths are metres, 2 mm are 0\.002"):
        found.verdicts(2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found.margin(0.1)


@pytest.mark.slow
def test_a_page_shows_itself_in_a_notebook(arm: armflex.Arm, tmp_path: Path) -> None:
    page = armflex.view(arm)
    assert (page._repr_html_().startswith("<iframe") and "&lt;" in page._repr_html_()) or "&quot;" in page._repr_html_()
    written = page.write(tmp_path / "arm.html")
    assert written.read_text(encoding="utf-8") == page.html
    assert armflex.view(arm, path=tmp_path / "same.html").read_text() == page.html and len(repr(page)) < 200
