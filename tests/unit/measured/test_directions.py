"""Two angles of what an axis points at, or of a point from a theodolite: read, fitted, refused where they are none."""

import re
from pathlib import Path

import numpy as np
import pytest
from support.telescope import MOUNT

from armflex import Arm, calibrate, load_arm, predict, read_measurements
from armflex.errors import ArmFileError, TableError
from armflex.readings import Direction, Position
from armflex.readings.air import Air, bending

ARCSEC = np.pi / 648000.0
SAG = 9.81 * 10.0 * 0.5 * 1e-6
"""Of the tube where it is level [rad]."""


def mount(folder: Path, more: str = "", text: str = MOUNT) -> Arm:
    (folder / "mount.toml").write_text(text + more)
    return load_arm(folder / "mount.toml")


def table(folder: Path, header: str, *columns: object) -> Path:
    cells = [[f"{one:.12g}" if isinstance(one, float) else one for one in np.asarray(own).tolist()] for own in columns]
    rows = zip(*cells, strict=True)
    (folder / "run.csv").write_text("\n".join([header, *map(",".join, rows)]) + "\n")
    return folder / "run.csv"


def stars(count: int = 40, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-3.0, 3.0, count), rng.uniform(0.3, 1.4, count)


def test_an_axis_reads_where_it_points_lower_by_its_sag(tmp_path: Path) -> None:
    az, el = stars()
    arm = mount(tmp_path)
    ((kind, _),) = predict(arm, table(tmp_path, "q_az,q_el", az, el)).sensors
    assert isinstance(kind, Direction)
    np.testing.assert_allclose(np.exp(1j * kind.values[:, 0]), np.exp(1j * az), atol=1e-9)
    np.testing.assert_allclose(kind.values[:, 1], el - SAG * np.cos(el), atol=1e-8)


def sexagesimal(angle: float, mark: str = ":") -> str:
    sign, seconds = "-" if angle < 0.0 else "+", abs(float(np.degrees(angle))) * 3600.0
    return f"{sign}{int(seconds // 3600)}{mark}{int(seconds % 3600 // 60):02d}{mark}{seconds % 60:.7f}"


@pytest.mark.parametrize("form", ["rad", "deg", "dms", "hms", "vector"])
def test_angles_are_read_in_every_form(form: str, tmp_path: Path) -> None:
    az, el = stars(6)
    arm, head = mount(tmp_path), "q_az,q_el,star_azimuth{},star_elevation{}"
    forms = {
        "rad": (head.format("", ""), az, el),
        "deg": (head.format("_deg", "_deg"), np.degrees(az), np.degrees(el)),
        "dms": (head.format("_dms", "_dms"), list(map(sexagesimal, az)), list(map(sexagesimal, el))),
        "hms": (head.format("_hms", "_arcsec"), [sexagesimal(one / 15.0, " ") for one in az], el / ARCSEC),
        "vector": ("q_az,q_el,star_x,star_y,star_z", np.cos(el) * np.cos(az), -np.cos(el) * np.sin(az), np.sin(el)),
    }
    header, *columns = forms[form]
    kind = read_measurements(table(tmp_path, header, az, el, *columns), arm).readings.of(Direction, "star")
    assert kind is not None
    np.testing.assert_allclose(kind.values, np.column_stack([az, el]), atol=2e-10)


def test_a_mount_is_calibrated_by_stars_and_its_errors_are_on_the_sky(tmp_path: Path) -> None:
    (az, el), rng, arm = stars(80), np.random.default_rng(3), mount(tmp_path)
    seen = np.column_stack([az + 2e-3 + 1e-4 / np.cos(el), el - 1e-3 - 0.5 * SAG * np.cos(el)])
    seen += rng.normal(0.0, 5e-6, seen.shape) / np.column_stack([np.cos(el), np.ones(80)])
    path = table(tmp_path, "q_az,q_el,star_azimuth,star_elevation", az, el, *seen.T)
    found = calibrate(arm, read_measurements(path, arm))
    assert found.held_out is not None and found.fit.view.readings.shown_in[0] == "arcsec"
    # Two numbers a row, whatever the elevation: azimuths counted as they are would be some times that.
    assert found.held_out[1] == pytest.approx(np.sqrt(2.0) * 5e-6, rel=0.15)
    factor = {one.name: one.value for one in found.parameters}["compliance tube rz"]
    assert np.exp(factor) == pytest.approx(0.5, abs=0.15)


def test_a_turn_of_the_frame_that_nobody_knows_is_found(tmp_path: Path) -> None:
    az, el = stars(30)
    arm = mount(tmp_path, "mounting_std = 3.0\n", MOUNT.replace("5e-3", "0").replace("2e-3", "0").replace("2.0", "0"))
    path = table(tmp_path, "q_az,q_el,star_azimuth,star_elevation", az, el, az + 2.5, el - SAG * np.cos(el))
    found = calibrate(arm, read_measurements(path, arm))
    assert found.rms < 1e-6


REFRACTED = "refraction = { pressure_hPa = 800, temperature_C = 10, humidity = 0.9, wavelength_um = 0.4 }\n"


def test_air_bends_as_in_sofa(tmp_path: Path) -> None:
    """The constants are those of SOFA's own test of iauRefco."""
    a, b = Air(800.0, 10.0, 0.9, 0.4).constants
    assert a == pytest.approx(0.2264949956241415009e-3, rel=1e-12)
    assert b == pytest.approx(-0.2598658261729343970e-6, rel=1e-12)
    az, el = stars(5)
    rows = table(tmp_path, "q_az,q_el", az, el)
    (plain, _), (bent, _) = (predict(mount(tmp_path, more), rows).sensors[0] for more in ("", REFRACTED))
    lower = plain.values[:, 1] - bent.values[:, 1]
    np.testing.assert_allclose(lower, bending(a, b, np.sin(plain.values[:, 1]))[0], rtol=1e-9)
    np.testing.assert_allclose(plain.values[:, 0], bent.values[:, 0], atol=1e-12)


THEODOLITE = """
[robot]
dh = "standard"
gravity = [0, 0, -9.81]
[robot.joint]
J1 = { d = 0.5, alpha_deg = 90, mass = 5 }
J2 = { a = 0.6, mass = 5, com = [-0.3, 0, 0] }
J3 = { a = 0.5, mass = 3, com = [-0.2, 0, 0] }
[prior]
joint_offset = 2e-3
[instrument.theo]
kind = "direction"
link = "flange"
point = [0, 0, 0.1]
place = [2.0, -1.0, 0.4]
place_std = 0.002
mounting_std = 0.002
sigma = 1e-5
"""


def test_a_theodolite_determines_joint_offsets_and_where_it_stands(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    q = rng.uniform(-1.0, 1.0, (60, 3))
    moved = THEODOLITE.replace("place = [2.0, -1.0, 0.4]", "place = [2.001, -1.001, 0.4005]")
    truth = q + np.array([0.0, 1e-3, -1.5e-3])
    ((kind, _),) = predict(mount(tmp_path, "", moved), table(tmp_path, "q_J1,q_J2,q_J3", *truth.T)).sensors
    seen = kind.values + rng.normal(0.0, 1e-5, (60, 2))
    path = table(tmp_path, "q_J1,q_J2,q_J3,theo_azimuth,theo_elevation", *q.T, *seen.T)
    arm = mount(tmp_path, "", THEODOLITE)
    found = calibrate(arm, read_measurements(path, arm))
    values = {one.name: (one.value, one.std) for one in found.parameters}
    for name, wanted in (("joint_offset J2", 1e-3), ("joint_offset J3", -1.5e-3)):
        value, std = values[name]
        assert abs(value - wanted) < 3.5 * std < 3e-4, name
    assert found.rms < 2e-5


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (MOUNT.replace("axis = [1, 0, 0]\n", ""), "is missing: give `axis`"),
        (MOUNT + "place = [1, 0, 0]\n", "stands beside `place`"),
        (MOUNT.replace("axis = [1, 0, 0]", "axis = [0, 0, 0]"), "expected a direction in the link's frame"),
        (
            MOUNT.replace("north_to_east", "north_to_west"),
            r"'north_to_west' is not known, did you mean 'north_to_east'",
        ),
        (MOUNT + "refraction = { pressure_hPa = 75000, temperature_C = 5 }\n", "expected 0 to 1200, got 75000"),
        (MOUNT + "refraction = { pressure_hPa = 750 }\n", "needs 'temperature_C'"),
        (
            THEODOLITE + "refraction = { pressure_hPa = 750, temperature_C = 5 }\n",
            "the effect `refraction` is for more",
        ),
        (THEODOLITE.replace("[2.0, -1.0", "[2000.0, -1.0"), "millimetres"),
    ],
)
def test_what_is_no_direction_is_refused(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(ArmFileError, match=said):
        mount(tmp_path, "", text)


@pytest.mark.parametrize(
    ("header", "cells", "said"),
    [
        (
            "star_azimuth,star_elevation",
            (12.0, 45.0),
            "star_elevation is 45 rad, beyond 1.57.: in degrees, call the column",
        ),
        ("star_x,star_y,star_z", (1.0, 1.0, 0.0), "star_x, star_y, star_z are no unit vector"),
        ("star_azimuth_dms,star_elevation_dms", ("12:61:00", "4:00:00"), "is '12:61:00', not a finite number"),
        ("star_azimuth,star_elevation,star_x,star_y,star_z", (0.1, 0.1, 1.0, 0.0, 0.0), "give one of them"),
    ],
)
def test_angles_that_are_none_are_refused_by_line(header: str, cells: tuple, said: str, tmp_path: Path) -> None:
    path = table(tmp_path, f"q_az,q_el,{header}", [0.1], [0.2], *([one] for one in cells))
    with pytest.raises(TableError, match=said):
        read_measurements(path, mount(tmp_path))


def test_readings_that_want_a_compliance_below_zero_are_said_to(tmp_path: Path) -> None:
    """A tube that rises with its weight: what calibration reaches is next to nothing, and no number says why."""
    (az, el), rng, arm = stars(80), np.random.default_rng(1), mount(tmp_path)
    flags = {}
    for sign in (1.0, -1.0):
        seen = np.column_stack([az, el - sign * SAG * np.cos(el)]) + rng.normal(0.0, 5e-6, (80, 2))
        path = table(tmp_path, "q_az,q_el,star_azimuth,star_elevation", az, el, *seen.T)
        flags[sign] = [one for one in calibrate(arm, read_measurements(path, arm)).flags if one.code == "opposite_sign"]
    (one,) = flags[-1.0]
    assert not flags[1.0]
    wanted = re.match(
        r"compliance tube rz: the readings want (\S+) ± (\S+) times what was declared, the opposite", one.text
    )
    assert wanted is not None and abs(float(wanted[1]) + 1.0) < 3.0 * float(wanted[2]) < 0.5


def test_the_length_of_a_unit_vector_is_no_reading() -> None:
    """It has no error, which would say that nothing else has one either."""
    points, noise = np.random.default_rng(0).normal(size=(2, 40, 3))
    units = points / np.linalg.norm(points, axis=1, keepdims=True)
    sigma = np.full(points.shape, 5e-6)
    for digits in (9, 12):
        assert Position(np.round(units, digits), sigma).exact == 40
    assert Position(points, sigma).exact == Position(units + 5e-6 * noise, sigma).exact == 0
    assert Position(units[:4], sigma[:4]).exact == 0  # by chance
