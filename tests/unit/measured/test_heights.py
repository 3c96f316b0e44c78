"""Heights above a table whose own height and tilt nobody measured."""

from pathlib import Path

import numpy as np
import pytest
from support.instruments import Machine, heavy, in_base

from armflex import calibrate, load_arm, predict, read_measurements
from armflex.errors import ArmFileError, ArmflexError

RULER = """
[instrument.ruler]
kind = "height"
link = "tool"
point = [0.0, 0.0, 0.1]
table_std = 0.05
tilt_std = 0.02
sigma = 1e-4
"""


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Machine, Path]:
    folder = tmp_path_factory.mktemp("heights")
    arm = heavy(folder, RULER)
    arm.write_text(in_base(arm.read_text()))
    machine = Machine.draw(arm, 2)
    rows = machine.rows(80)
    state = machine.plant.relax(rows)
    place = state.frames[:, -1, :3, 3] + 0.1 * state.frames[:, -1, :3, 2]
    normal = np.array([0.01, -0.005, 1.0])
    heights = place @ normal / np.linalg.norm(normal) - 0.03 + machine.rng.normal(0.0, 1e-4, len(place))
    names = [f"q_{joint.name}" for joint in machine.plant.joints]
    payloads = [("empty", "p100", "p200")[i] for i in rows.payload]
    lines = [",".join([*names, "payload", "ruler_mm"])]
    lines += [
        ",".join([*map(repr, map(float, q)), payload, repr(float(1e3 * height))])
        for q, payload, height in zip(rows.q, payloads, heights, strict=True)
    ]
    (folder / "rows.csv").write_text("\n".join(lines) + "\n")
    return machine, arm


def test_a_ruler_finds_the_table_and_foretells_heights(written: tuple[Machine, Path]) -> None:
    _, file = written
    arm = load_arm(file)
    rows = read_measurements(file.with_name("rows.csv"), arm)
    found = calibrate(arm, rows.some(np.arange(60)))
    assert found.scatter == pytest.approx(1.0, abs=0.2) and found.declared_rms > 3.0 * found.rms
    ruler = found.arm.sensors["ruler"]
    std = {one.which.name: one.std for one in found.parameters}
    assert ruler.of("table", ("x",))[0, 0] == pytest.approx(0.03, abs=4.0 * std["table"])
    tilt = np.abs(ruler.of("tilt", ("x",))[0])  # about which axes is the reader's choice
    np.testing.assert_allclose(np.sort(tilt), [0.005, 0.01], atol=4.0 * max(std["tilt x"], std["tilt y"]))
    held_out = rows.some(np.arange(60, 80))
    kind, sigma = predict(found.arm, held_out).sensors[0]
    assert sigma is not None
    whitened = (held_out.readings.kinds[0].values - kind.values) / np.hypot(1e-4, sigma)
    assert 0.6 < np.sqrt((whitened**2).mean()) < 1.5


@pytest.mark.filterwarnings("ignore:gravity:armflex.ArmflexWarning")
def test_a_table_without_gravity_needs_its_direction(written: tuple[Machine, Path], tmp_path: Path) -> None:
    _, file = written
    text = file.read_text().replace("gravity = [0.0, 0.0, -9.81]", "gravity = [0.0, 0.0, 0.0]")
    other = tmp_path / "arm.toml"
    other.write_text(text)
    with pytest.raises(ArmFileError, match="there is no gravity to be level to"):
        load_arm(other)
    other.write_text(text.replace("table_std", "up = [0.0, 0.0, 1.0]\ntable_std"))
    assert load_arm(other).sensors["ruler"].kind.unit == "m"


def one_coordinate(folder: Path, head: str, cells: str) -> Path:
    """Write a campaign of 40 rows of the machine's arm; the cells are those of a height [m]."""
    machine, rng = Machine.draw(folder / "arm.toml", 2), np.random.default_rng(1)
    names = [f"q_{joint.name}" for joint in machine.plant.joints]
    lines = [",".join([*names, head])]
    rows = machine.rows(40)
    places = machine.plant.relax(rows).frames[:, -1, :3, 3] + rng.normal(0.0, 1e-4, (40, 3))
    for q, place in zip(rows.q, places.tolist(), strict=True):
        lines.append(",".join([*map(repr, map(float, q)), cells.format(z=place[2])]))
    (folder / "alone.csv").write_text("\n".join(lines) + "\n")
    return folder / "alone.csv"


@pytest.mark.parametrize(
    ("head", "cells", "said"),
    [
        ("x,y,z,sigma", ",,{z},1e-4", r"alone.csv:2: only some of x, y, z are given: one coordinate alone .*height"),
        ("z,sigma", "{z},1e-4", r"alone.csv:1: has no column 'x', 'y': one coordinate alone .*height"),
        (
            "x,y,z,sigma",
            "0,0,{z},1e-4",
            r"x, y were not read, as the same number is in every row\?.*\[instrument.NAME\]",
        ),
    ],
)
def test_one_coordinate_alone_is_called_what_it_is(
    written: tuple[Machine, Path], head: str, cells: str, said: str
) -> None:
    """The zeros were called metres beside millimetres, which changes nothing of them."""
    arm = load_arm(written[1])
    with pytest.raises(ArmflexError, match=said):
        calibrate(arm, read_measurements(one_coordinate(written[1].parent, head, cells), arm))


def test_errors_are_over_coordinates_that_were_read(written: tuple[Machine, Path]) -> None:
    head, cells = "x,y,z,sigma_x,sigma_y,sigma_z", "0,0,{z},1e3,1e3,1e-4"
    arm = load_arm(written[1])
    found = calibrate(arm, read_measurements(one_coordinate(written[1].parent, head, cells), arm))
    assert found.rms < 0.01 and found.noise_rms == pytest.approx(1e-4)
