"""One draw of `tests/studies/learned.py`, a black box beside it, and the picture of the laws."""

import numpy as np
import pytest
from studies.learned import (
    BLACK_BOX,
    CALIBRATED,
    ON_TOP,
    Campaign,
    Told,
    append,
    black_boxes,
    learned,
    read_told,
    table,
)
from support.bent_joints import bent

from armflex import Arm, draw_laws, load_arm
from armflex.errors import InputError, ShapeError, UnknownNameError

pytestmark = pytest.mark.slow

SEED = 1


@pytest.fixture(scope="module")
def campaign(tmp_path_factory) -> Campaign:
    return Campaign(bent(SEED), "inside", tmp_path_factory.mktemp("study"))


@pytest.fixture(scope="module")
def polynomial(campaign) -> tuple[Told, Arm]:
    return learned(campaign, "polynomial")


@pytest.fixture(scope="module")
def told(campaign, polynomial) -> dict[str, Told]:
    pytest.importorskip("torch", reason="the black box is a network of torch's")
    plain, calibrated = learned(campaign, "none")
    with pytest.MonkeyPatch.context() as patch:  # one size of networks: which one hardly matters where all are far off
        patch.setattr("support.black_box.SIZES", ((32,),))
        patch.setattr("support.black_box.DECAYS", (1e-1,))
        patch.setattr("support.black_box.STEPS", 400)
        boxes = black_boxes(campaign, calibrated)
    every = [plain, polynomial[0], *boxes]
    return {one.model: one for one in every}


def test_a_learned_arm_tells_what_a_black_box_cannot(told):
    assert told["polynomial"].rms < 1.25
    assert 0.8 < told["polynomial"].z < 1.2
    assert told[CALIBRATED].rms > 2.0  # what nobody declared matters
    assert told[ON_TOP].rms > 1.8  # and is not found from poses alone
    assert told[BLACK_BOX].rms > 10.0 * told["polynomial"].rms


def test_bands_have_the_true_laws(told):
    assert told["polynomial"].bent > 0.9 and told["polynomial"].turns > 0.9


def test_a_network_is_learned_to_its_end(tmp_path):
    """Left halfway, or led astray by its first steps, it tells tips well enough but has bands that miss its laws."""
    one, _ = learned(Campaign(bent(2), "inside", tmp_path), "neural")
    assert one.rms < 1.25 and 0.8 < one.z < 1.2
    assert one.bent > 0.8 and one.turns > 0.8


def test_what_is_told_is_kept(told, tmp_path):
    append(tmp_path / "learned.csv", list(told.values()))
    again = read_told(tmp_path / "learned.csv")
    assert [(one.model, one.rms, one.rows) for one in again] == [(m, one.rms, one.rows) for m, one in told.items()]
    assert all(model in table(again) for model in told)


def truth(arm: Arm, campaign: Campaign) -> dict:
    loads = dict(zip(arm.joint_names, np.moveaxis(campaign.drawn.state().wrenches, 1, 0), strict=True))
    return {name: (loads[name], campaign.drawn.twist(name, loads[name])) for name in campaign.drawn.joints}


def test_laws_are_drawn_with_their_bands(campaign, polynomial, tmp_path):
    arm = polynomial[1]
    file = draw_laws(arm, tmp_path / "laws.svg", truth(arm, campaign))
    text = file.read_text()
    words = (*campaign.drawn.joints, "95 % band", "declared", "known points", "my [kNm]")
    assert all(f"<!-- {word} -->" in text for word in words)
    assert draw_laws(arm, tmp_path / "laws.png").read_bytes().startswith(b"\x89PNG")


def test_what_cannot_be_drawn_is_refused(campaign, polynomial, tmp_path):
    arm = polynomial[1]
    loads, twists = truth(arm, campaign)["M1"]
    with pytest.raises(InputError, match=r"\.png, \.pdf, \.svg"):
        draw_laws(arm, tmp_path / "laws.gif")
    with pytest.raises(UnknownNameError, match=r"M7.*M1"):
        draw_laws(arm, tmp_path / "laws.png", {"M7": (loads, twists)})
    with pytest.raises(ShapeError, match="twists of M1"):
        draw_laws(arm, tmp_path / "laws.png", {"M1": (loads, twists[:, :3])})
    with pytest.raises(InputError, match="learn = true"):
        draw_laws(load_arm(campaign.drawn.write(tmp_path, "none")), tmp_path / "laws.png")
    assert not (tmp_path / "laws.png").exists()
