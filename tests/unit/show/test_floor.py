"""What a page says of the stated noise beside the error that is left."""

from armflex.show.report.cover import floor


def test_stated_noise_is_no_floor_of_what_is_below_it() -> None:
    assert floor(2.08, 0.45) == "more than the readings scatter"
    assert floor(0.087, 0.09) == "what no model can get below"
