"""Results show themselves on a few lines and in a notebook, and give plain values; the package shows its names."""

import json
import re
from collections.abc import Callable
from html.parser import HTMLParser

import numpy as np
import pytest
from support.small_arms import ROBOTS

import armflex
from armflex.estimate import Calibration
from armflex.measured.repeats import repeats

FOLDER = ROBOTS / "tarm_like"


@pytest.fixture(scope="module")
def arm() -> armflex.Arm:
    return armflex.load_arm(FOLDER / "arm.toml")


@pytest.fixture(scope="module")
def path(arm: armflex.Arm) -> armflex.Trajectory:
    return armflex.read_trajectory(FOLDER / "trajectory.csv", arm)


def fitted() -> Calibration:
    arm = armflex.load_arm(FOLDER / "measured.toml")
    return armflex.calibrate(arm, armflex.read_measurements(FOLDER / "campaign.csv", arm))


RESULTS: dict[str, Callable[[armflex.Arm, armflex.Trajectory], object]] = {
    "deflection": lambda arm, path: arm.deflection(path.q[0], "p600"),
    "batch": lambda arm, path: arm.deflection(path.q[:20], "p600"),
    "path": lambda arm, path: path,
    "check": lambda arm, path: armflex.check(arm, path, tolerance=0.1),
    "compensate": lambda arm, path: armflex.compensate(arm, path),
    "predict": lambda arm, path: armflex.predict(
        arm, armflex.read_measurements(FOLDER / "held_out.csv", arm, inputs_only=True)
    ),
    "calibrate": lambda arm, path: fitted(),
    "train": lambda arm, path: armflex.train(armflex.read_joint_data(FOLDER / "a4_table_1.csv")),
    "plan": lambda arm, path: armflex.plan(arm, 3, sigma=1e-4),
    "map": lambda arm, path: armflex.map_workspace(arm, rows=64, voxel=2.0),
    "campaign": lambda arm, path: armflex.read_measurements(FOLDER / "campaign.csv", arm),
    "repeats": lambda arm, path: repeats(armflex.read_measurements(FOLDER / "campaign.csv", arm)),
    "bench": lambda arm, path: armflex.read_joint_data(FOLDER / "a4_table_1.csv"),
    "iso9283": lambda arm, path: armflex.iso9283(arm, FOLDER / "campaign.csv"),
}


class Balanced(HTMLParser):
    """Raises where a tag is closed that is not open."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.cells = 0

    def handle_starttag(self, tag: str, attrs: list) -> None:
        self.open.append(tag)
        self.cells += tag == "td"

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.slow
@pytest.mark.parametrize("name", RESULTS)
def test_results_show_themselves(name: str, arm: armflex.Arm, path: armflex.Trajectory) -> None:
    result = RESULTS[name](arm, path)
    assert len(repr(result).splitlines()) < 15 and len(repr(result)) < 1200
    assert not re.search(r"\d\.\d{8}", repr(result))
    page = Balanced()
    page.feed(result._repr_html_())
    assert page.open == [] and page.cells
    told = result.to_dict()
    assert json.loads(json.dumps(told, allow_nan=False)) == told and {*result.FIELDS} <= {*told}
    pytest.importorskip("pandas")
    assert len(result.to_frame())


def test_plain_values_are_those_of_the_result(arm: armflex.Arm, path: armflex.Trajectory) -> None:
    found = arm.deflection(path.q[0], "p600")
    told = found.to_dict()
    np.testing.assert_array_equal(told["displacement"], found.displacement)
    np.testing.assert_array_equal(told["wrenches"], found.wrenches)


def test_frames(arm: armflex.Arm, path: armflex.Trajectory) -> None:
    pytest.importorskip("pandas")
    report = armflex.check(arm, path, tolerance=0.1)
    frame = report.to_frame()
    assert list(frame["name"]) == [point.name for point in report.via_points]
    np.testing.assert_array_equal(path.to_frame()["q_A1"], path.q[:, 1])
    rows = armflex.compensate(arm, path).to_frame()
    assert {"before_0", "change_6", "reached"} <= set(rows.columns) and len(rows) == len(path)


def test_an_arm_in_a_notebook(arm: armflex.Arm) -> None:
    page = Balanced()
    page.feed(arm._repr_html_())
    assert page.open == [] and page.cells == 4 * len(arm.flexures)


@pytest.mark.slow
def test_the_package_shows_its_own_names_alone() -> None:
    assert dir(armflex) == sorted(armflex.__all__) and len(armflex.__all__) < 40
