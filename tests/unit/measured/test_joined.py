"""Several campaigns as one: names, columns, times, loads and readings of its rows, and what is not remembered."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import three_joint_plant
from support.campaign_files import numbers, write_columns

from armflex import Arm, Measurements, load_arm, read_measurements
from armflex.errors import MissingCovariateError
from armflex.laws.effects.catalogue import CATALOGUE
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.location import Location
from armflex.measured.joined import joined
from armflex.mechanics.history import known_rows
from armflex.readings import Inclination, Position

LEVEL = '[instrument.level]\nkind = "inclination"\nlink = "tip"\nsigma = 1e-5\n'
COUNT = 6


@pytest.fixture
def arm(tmp_path: Path) -> Arm:
    three_joint_plant.declared(tmp_path)
    file = tmp_path / "arm.toml"
    file.write_text(file.read_text() + LEVEL)
    return load_arm(file)


def campaign(arm: Arm, path: Path, q: np.ndarray | None = None, **more: list) -> Measurements:
    """Write and read rows with positions, but where `more` has something in their place."""
    q = np.random.default_rng(sum(map(ord, path.stem))).uniform(-1.0, 1.0, (COUNT, 3)) if q is None else q
    columns: dict[str, list] = {f"q_J{i + 1}": numbers(q[:, i]) for i in range(3)}
    if "level_x" not in more:
        columns |= {axis: numbers(q[:, 0]) for axis in "xyz"} | {"sigma": [1e-4] * len(q)}
    write_columns(path, columns | more)
    return read_measurements(path, arm)


def test_sessions_and_poses_are_of_their_campaign(arm: Arm, tmp_path: Path) -> None:
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (COUNT, 3))
    names = [f"p{i}" for i in range(COUNT)]
    one = campaign(arm, tmp_path / "one.csv", q, pose=names, session=["a"] * 3 + ["b"] * 3)
    other = campaign(arm, tmp_path / "other.csv", np.vstack([q[:3] + 5e-3, -q[3:]]), pose=names)
    both = joined([one, other], arm)
    assert dict.fromkeys(both.session) == dict.fromkeys(("one/a", "one/b", "other"))
    assert both.pose == (*names, *names[:3], *(f"other/{name}" for name in names[3:]))
    assert len(set(both.pose_number)) == 9 and (both.pose_number[:3] == both.pose_number[6:9]).all()
    assert both.covariates["campaign"] == both.campaign == ("one",) * COUNT + ("other",) * COUNT
    assert [str(place) for place in both.places[:7:6]] == [f"{tmp_path}/one.csv:2", f"{tmp_path}/other.csv:2"]
    assert both.sha256 not in (one.sha256, other.sha256)
    part = both.some(np.arange(4, 8))
    assert {name: own.tolist() for name, own in part.pieces.items()} == {"one": [0, 1], "other": [2, 3]}


def test_columns_that_one_lacks_are_left_out_and_named(arm: Arm, tmp_path: Path) -> None:
    common = {"humidity": list(range(COUNT)), "operator": ["ann"] * COUNT}
    one = campaign(
        arm, tmp_path / "one.csv", **common, temperature=[20.0 + i for i in range(COUNT)], hold=[1.0] * COUNT
    )
    two = campaign(arm, tmp_path / "two.csv", humidity=[0.5] * COUNT, operator=list(range(COUNT)))
    both = joined([one, two], arm)
    assert set(both.covariates) == {"humidity", "operator", "campaign"} and both.hold is None
    assert both.covariates["operator"][COUNT - 1 : COUNT + 2] == ("ann", "0", "1")
    left = {flag.about: flag.text for flag in both.flags if flag.code == "column_left_out"}
    assert left == {name: f"column '{name}' is left out: two has none" for name in ("temperature", "hold")}
    law = CATALOGUE["thermal_bending"]
    effect = Effect(law, Location("J2", "ry", ("temperature",)), (0.0,) * (len(law.amplitudes) + len(law.inner)))
    with pytest.raises(MissingCovariateError, match=r"two\.csv.*'temperature'"):
        joined([one, two], replace(arm, effects=(effect,)))


def test_times_go_on(arm: Arm, tmp_path: Path) -> None:
    clock = [float(i) for i in range(COUNT)]
    one, two = (campaign(arm, tmp_path / f"{name}.csv", time=clock) for name in ("one", "two"))
    late = campaign(arm, tmp_path / "late.csv", time=[100.0 + x for x in clock])
    np.testing.assert_array_equal(joined([one, two, late], arm).time, [*clock, *(5.0 + x for x in clock), *late.time])
    without = joined([one, campaign(arm, tmp_path / "none.csv")], arm)
    assert "time" in without.derived and (np.diff(without.time) == 1.0).all()


def test_readings_and_loads_are_where_they_were(arm: Arm, tmp_path: Path) -> None:
    pulled = {"force_fx": [1.0] * COUNT, "force_fy": [0.0] * COUNT, "force_fz": [-2.0] * COUNT}
    one = campaign(arm, tmp_path / "one.csv", **pulled)
    two = campaign(arm, tmp_path / "two.csv", level_x=[0.1] * COUNT, level_y=[0.2] * COUNT)
    both = joined([two, one], arm)
    positions, level = both.readings.of(Position), both.readings.of(Inclination, "level")
    assert both.readings.kinds == (positions, level)
    assert np.isinf(positions.sigma[:COUNT]).all() and np.isinf(level.sigma[COUNT:]).all()
    np.testing.assert_array_equal(positions.values[COUNT:], one.position)
    np.testing.assert_array_equal(level.values[:COUNT], two.readings.of(Inclination, "level").values)
    (load,) = both.wrenches
    np.testing.assert_array_equal(load.force, [[0.0, 0.0, 0.0]] * COUNT + [[1.0, 0.0, -2.0]] * COUNT)
    assert both.measured.all() and both.positioned.tolist() == [False] * COUNT + [True] * COUNT


def test_nothing_is_remembered_from_campaign_to_campaign(arm: Arm, tmp_path: Path) -> None:
    given = {"time": [3600.0 * i for i in range(COUNT)], "temperature": [20.0, 30.0, 30.0, 30.0, 30.0, 30.0]}
    one, two = (campaign(arm, tmp_path / f"{name}.csv", **given) for name in ("one", "two"))
    law = next(law for law in CATALOGUE.values() if law.memory is not None and law.memory.lag)
    place = Location("J2", "ry", ("temperature",))
    values = (0.0,) * len(law.amplitudes) + (7200.0,) * len(law.inner)
    lagging = replace(arm, effects=(Effect(law, place, values),))
    state = lagging.effects[0].state
    alone = known_rows(lagging, one)[state]
    np.testing.assert_allclose(known_rows(lagging, joined([one, two], lagging))[state], [*alone, *alone])
