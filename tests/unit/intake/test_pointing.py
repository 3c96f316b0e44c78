"""Pointing runs of telescopes: TPOINT's forms and the MMT's records become a campaign, or are refused by line."""

from pathlib import Path

import numpy as np
import pytest
from support.command_line import fine, run_here

from armflex import calibrate, load_arm, read_measurements
from armflex.errors import InputError
from armflex.intake import intake

PLACE = "+31 41 19.6 2021 8 21 13.0 741 2608.0 0.75\n"
DEGREES = f"""! converted from raw records
!
A caption; with any sign
: ALTAZ
: ROTNL
{PLACE}333.0949589 78.6684282 333.0167132 78.7625213 293.6668950
; 240.4719461 44.8995879 240.3726938 44.9816645 306.1848271
-6.2657687 36.7445377 353.6410136 36.8002718 317.5486844   ! a remark
172.6853974 53.4019806 172.5781383 53.4555115 302.4060731
END
this is beyond the end
"""


def taken(folder: Path, text: str, name: str = "run.dat"):
    (folder / name).write_text(text)
    return intake([folder / name], None)


def degrees(found, name: str) -> np.ndarray:
    return np.degrees(np.array(found.columns[name], dtype=float))


def test_degrees_are_read_without_comments_up_to_the_end(tmp_path: Path) -> None:
    found = taken(tmp_path, DEGREES)
    assert found.lines == (7, 9, 10) and not found.notes
    np.testing.assert_allclose(degrees(found, "star_azimuth"), [333.0949589, -6.2657687, 172.6853974])
    np.testing.assert_allclose(degrees(found, "star_elevation"), [78.6684282, 36.7445377, 53.4019806])
    np.testing.assert_allclose(degrees(found, "q_az"), [333.0167132, 353.6410136, 172.5781383])
    np.testing.assert_allclose(degrees(found, "q_el"), [78.7625213, 36.8002718, 53.4555115])
    np.testing.assert_allclose(degrees(found, "rotator"), [293.6668950, 317.5486844, 302.4060731])


def test_degrees_minutes_and_seconds_keep_the_sign_of_nought(tmp_path: Path) -> None:
    row = "-00 12 30.0 45 30 00 00:12:30.0 45 29 59.5\n"
    found = taken(tmp_path, f"Caption\n:ALTAZ\n-00 30 00\n{row}END\n")
    np.testing.assert_allclose(degrees(found, "star_azimuth"), [-12.5 / 60.0])
    np.testing.assert_allclose(degrees(found, "q_az"), [12.5 / 60.0])
    np.testing.assert_allclose(degrees(found, "q_el"), [45.0 + 29.0 / 60.0 + 59.5 / 3600.0])


HOURS = (
    "14 16 00.00 +19 12 00.0 14 15 30.00 +19 04 00.0 13 40.5\n14 16 00.00 +19 12 00.0 14 15 30.00 +19 04 00.0 13 41.5\n"
)


def test_an_equatorial_mount_has_hour_angle_and_declination(tmp_path: Path) -> None:
    found = taken(tmp_path, f"Caption\n:EQUAT\n:NODA\n35 52 8.4 2001 5 30\n{HOURS}END\n")
    hours = 13.675 - 14.0 - 16.0 / 60.0
    np.testing.assert_allclose(degrees(found, "star_azimuth"), [15.0 * hours, 15.0 * (hours + 1.0 / 60.0)], atol=1e-9)
    np.testing.assert_allclose(degrees(found, "q_ha")[0], 15.0 * (13.675 - 14.0 - 15.5 / 60.0))
    np.testing.assert_allclose(degrees(found, "q_dec"), 19.0 + 4.0 / 60.0)
    np.testing.assert_allclose(found.columns["time"], [0.0, 60.0 * 0.99726957])
    (tmp_path / "mount.toml").write_text(found.arm)
    arm = load_arm(tmp_path / "mount.toml")
    # The weight pulls the tube down: the pole is as high as the latitude, so that level is to its north.
    up = -arm.robot.gravity / 9.81
    np.testing.assert_allclose(up, [np.cos(np.radians(35.869)), 0.0, np.sin(np.radians(35.869))], atol=1e-6)


def test_places_in_hours_become_azimuth_and_elevation_for_a_mount_that_has_these(tmp_path: Path) -> None:
    """On the meridian, 16 degrees south of the zenith; an hour later it is west of it."""
    place = "12 00 00 +20 00 00 12 00 00 +20 00 00"
    rows = f"{place} 12 00.0 4.76 HARPB\n{place} 13 00.0 4.77 HARPB\n"
    found = taken(
        tmp_path, f"JCMT\n: ALTAZ\n+36 00 00 2009 01 29 -2.25 621.00 4120.00 0.827 866.963\n{rows}", "run.pnt"
    )
    np.testing.assert_allclose(np.abs(degrees(found, "star_azimuth")[0]), 180.0)
    np.testing.assert_allclose(degrees(found, "star_elevation")[0], 74.0)
    assert -180.0 < degrees(found, "star_azimuth")[1] < -90.0
    assert found.columns["aux1"] == [4.76, 4.77] and found.columns["aux2"] == ["HARPB", "HARPB"]
    assert "pressure_hPa = 621" in found.arm and "wavelength_um = 866.963" in found.arm
    assert any("no END" in note for note in found.notes) and any("apparent" in note for note in found.notes)


RECORD = """CAT: GEDR3_{0}   03:10:04.1478  +83:29:00.841  -0.3301    0.9832  10.96    K2  J2000.0
RAA:   25.2917832    0.4362133
AA:   25.2927679    0.7726798
TAA:   25.2930456   -0.7711408
LST: 23:5{0}:35.475
SERR: 304879974 -1058674430
"""


def test_records_of_the_mmt_are_read_and_those_that_are_cut_are_named(tmp_path: Path) -> None:
    cut = RECORD.format(9).splitlines(keepends=True)[:2]
    found = taken(tmp_path, RECORD.format(1) + RECORD.format(8) + "".join(cut))
    np.testing.assert_allclose(degrees(found, "q_az"), [0.4362133] * 2)
    np.testing.assert_allclose(degrees(found, "star_azimuth"), [-0.7711408] * 2)
    np.testing.assert_allclose(degrees(found, "star_elevation"), [25.2930456] * 2)
    assert found.columns["pose"] == ["GEDR3_1", "GEDR3_8"]
    assert "records without RAA or TAA are left out (lines 13)" in found.notes[0]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"C\n:ALTAZ\n{PLACE}1 2 3\nEND\n", ":4: is '1 2 3': 3 numbers are no observation of this mount"),
        (f"C\n:ALTAZ\n{PLACE}1 2 3 4\n1 2 3\nEND\n", ":5: is '1 2 3', expected 4 numbers"),
        (f"C\n:EQUAT\n{PLACE}1 2 3 4\nEND\n", "azimuth and elevation need the option : ALTAZ"),
        ("C\n:ALTAZ\nnorth\n1 2 3 4\nEND\n", ":3: expected the latitude"),
        (f"C\n:GIMBAL\n{PLACE}1 2 3 4\nEND\n", "is of mounts GIMBAL"),
        (f"C\n:ALTAZ\n{PLACE}END\n", "has no observations"),
        (
            f"C\n:EQUAT\n{PLACE}15 23 43.71 -01 01 20.66 0.005 -0.03 2000.00 15 22 50.14 12 30 43.01 14 23.2\nEND\n",
            ":4: gives a place of the catalogue for equinox 2000.00",
        ),
        (f"C\n:EQUAT\n{PLACE}15 73 43.71 -01 01 20 15 22 50.14 12 30 43 14 23.2\nEND\n", "has '15 73 43.71'"),
        (f"C\n:EQUAT\n{PLACE}15 23 43.71 -01 01 20 15 22 50.14 12 30 43 34 23.2\nEND\n", "sidereal time 34 23.2"),
        ("CAT: A\nRAA: 25.1\nTAA: 25.1 0.4\n", ":1: RAA is '25.1', expected elevation and azimuth"),
        ("RAA: 25.1 0.4\nTAA: 25.1 0.4\nwhat is this\n", ":3: is 'what is this', expected a record's KEY"),
    ],
)
def test_what_is_no_observation_is_named_by_line(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as raised:
        taken(tmp_path, text)
    assert said in str(raised.value)


def test_a_pointing_run_is_joined_to_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "run.dat").write_text(DEGREES)
    (tmp_path / "log.csv").write_text("q_az,q_el\n1,2\n")
    with pytest.raises(InputError, match=r"is a pointing run, a campaign by itself: .*log.csv cannot be joined"):
        intake([tmp_path / "run.dat", tmp_path / "log.csv"], None)
    with pytest.raises(InputError, match="leave out --sigma"):
        intake([tmp_path / "run.dat"], 1e-4)


def test_a_run_becomes_a_campaign_and_a_mount_that_calibrates(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    az, el = rng.uniform(0.0, 360.0, 40), rng.uniform(20.0, 80.0, 40)
    noise = rng.normal(0.0, 1.0 / 3600.0, (2, 40))
    rows = np.column_stack([az, el, az - 0.3 + noise[0] / np.cos(np.radians(el)), el + 0.1 + noise[1]])
    text = "".join(" ".join(f"{angle:.8f}" for angle in row) + "\n" for row in rows)
    for name in ("a.dat", "b.dat"):
        (tmp_path / name).write_text(f"Caption\n:ALTAZ\n{PLACE}{text}END\n")
    files = [str(tmp_path / name) for name in ("a.dat", "b.dat", "run.csv", "mount.toml")]
    fine(run_here(tmp_path, "intake", "a.dat", "-o", "run.csv", "--arm", "mount.toml"))
    arm = load_arm(files[3])
    found = calibrate(arm, read_measurements(files[2], arm))
    assert found.rms == pytest.approx(np.sqrt(2.0) * np.pi / 648000.0, rel=0.25)
    both = intake(files[:2], None)
    assert len(both.lines) == 80 and set(both.columns["session"]) == {"a", "b"}
