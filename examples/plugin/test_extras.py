"""The conformance suites of armflex, on what this distribution adds."""

from contact import CONTACT
from following_error import FOLLOWING_ERROR
from stiffness_csv import export
from wall_distance import WallDistance

from armflex.testing import check_effect, check_exporter, check_law, check_reading


def test_following_error() -> None:
    check_effect(FOLLOWING_ERROR, {"speed_J2": (-0.5, 0.5), "speed_J3": (-0.5, 0.5)})


def test_contact() -> None:
    check_law(CONTACT)


def test_wall_distance() -> None:
    check_reading(WallDistance, 'link = "tool"\nsigma = 2e-5')


def test_stiffness_csv() -> None:
    check_exporter(export)
