"""Calibrations of resampled campaigns: their spread against what a fit says of itself, right or wrong."""

from pathlib import Path

import numpy as np
import pytest
from support.heavy_campaign import PAYLOADS, declared
from support.plant import Campaign, Plant

from armflex import Arm, Measurements, calibrate, load_arm, read_measurements
from armflex.errors import InputError
from armflex.estimate import Bootstrap, bootstrap

pytestmark = pytest.mark.slow

GEOMETRY = "joint_offset = 1e-3\ntool = 5e-3"
SESSIONS = "session_translation = 5e-4\nsession_rotation = 5e-5"
DRAWS = 12


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three sessions, in each of which the instrument stood a little differently."""
    folder = tmp_path_factory.mktemp("campaign")
    plant = Plant.read(declared(folder, GEOMETRY))
    plant.offset = {joint.name: 5e-4 for joint in plant.joints}
    Campaign(3, poses=40, payloads=PAYLOADS).write(plant, folder / "measurements.csv")
    return folder


def asked(folder: Path, prior: str) -> tuple[Arm, Measurements]:
    arm = load_arm(declared(folder, prior))
    return arm, read_measurements(folder / "measurements.csv", arm)


def spread_over_stated(folder: Path, prior: str) -> float:
    """Return the median ratio of standard deviations, over the parameters that the campaign determines.

    The fit's are those of the noise as stated, before they are widened by how far the readings scatter beyond it, and
    by how many of them count as one.
    """
    arm, measurements = asked(folder, prior)
    found = bootstrap(arm, measurements, draws=DRAWS, seed=1)
    calibrated = calibrate(arm, measurements, as_stated=True)
    stated, widened = {one.name: one for one in calibrated.parameters}, max(1.0, calibrated.fit.noise)
    assert calibrated.arm.certainty is not None
    widened *= float(np.sqrt(calibrated.arm.certainty.design_effect))
    ratios = [
        std / (stated[name].std / widened)
        for name, std in zip(found.names, found.std, strict=True)
        if stated[name].determined and stated[name].block in ("joint_offset", "tool")
    ]
    assert len(ratios) == 7
    return float(np.median(ratios))


def test_it_agrees_with_a_fit_that_knows_its_errors(campaign: Path) -> None:
    """Twelve draws know a standard deviation to a fifth, the median of seven better."""
    assert 0.7 < spread_over_stated(campaign, f"{GEOMETRY}\n{SESSIONS}") < 1.4


def test_it_tells_a_fit_that_does_not(campaign: Path) -> None:
    """Rows of a session are off together; a fit that takes them for independent is too sure."""
    assert spread_over_stated(campaign, GEOMETRY) > 1.4


def test_two_processes_find_the_same(campaign: Path) -> None:
    arm, measurements = asked(campaign, GEOMETRY)
    done = []
    one = bootstrap(arm, measurements, draws=3, progress=lambda now, total: done.append((now, total)))
    other = bootstrap(arm, measurements, draws=3, jobs=2)
    # Equal to rounding: how many threads an algebra library takes is another matter in each process.
    np.testing.assert_allclose(one.values, other.values, rtol=1e-9, atol=1e-14)
    assert one.names == other.names
    assert not any(name.startswith("instrument") for name in one.names) and done == [(1, 3), (2, 3), (3, 3)]
    assert not np.array_equal(one.values[0], one.values[1])


def test_intervals_hold_their_share() -> None:
    values = np.random.default_rng(0).normal([0.0, 3.0], [1.0, 2.0], (4000, 2))
    found = Bootstrap(("a", "b"), values)
    np.testing.assert_allclose(found.std, [1.0, 2.0], rtol=0.04)
    np.testing.assert_allclose(found.interval(0.95), [[-1.96, 3.0 - 3.92], [1.96, 3.0 + 3.92]], atol=0.2)
    for coverage in (0.0, 1.0, float("nan")):
        with pytest.raises(InputError, match="between 0 and 1"):
            found.interval(coverage)


def test_too_little_is_refused(campaign: Path) -> None:
    arm, measurements = asked(campaign, GEOMETRY)
    with pytest.raises(InputError, match="1 draws: expected 2 or more"):
        bootstrap(arm, measurements, draws=1)
