"""What `predict` states of an arm that lacks something: errors on rows held out are as large as sigma says."""

from pathlib import Path

import numpy as np
import pytest
from support import three_joint_plant
from support.plant import Rows, apply

from armflex import Arm, Measurements, calibrate, load_arm, predict, read_measurements
from armflex.estimate.held_out import apart_folds, excess, held_out
from armflex.tasks.predict import Prediction

WITHIN = 1.959964
"""Standard deviations that hold 95 % of a Gaussian."""


def campaign(folder: Path, seed: int, lacking: float, count: int = 150) -> tuple[Arm, Measurements]:
    """Return an arm and a campaign of it, off by a smooth function of the joints' positions of this size [m]."""
    folder.mkdir()
    plant, rng = three_joint_plant.declared(folder), np.random.default_rng(seed)
    file = folder / "arm.toml"
    file.write_text(file.read_text().replace("joint_offset = 1e-3", "joint_offset = 5e-3\ngeometry = 2e-3"))
    plant.offset = {joint.name: float(rng.normal(0.0, 3e-3)) for joint in plant.joints}
    q, still = rng.uniform(-1.2, 1.2, (count, 3)), np.zeros((count, 3))
    read = apply(three_joint_plant.STATION, plant.points(plant.relax(Rows.plain(q, np.zeros(count), still))))
    waves = np.random.default_rng(17)  # the arm's own, whichever the campaign
    number, phase, size = waves.normal(0.0, 1.2, (3, 12)), waves.uniform(0.0, 6.3, 12), waves.normal(size=(12, 3))
    read += lacking * np.sin(q @ number + phase) @ size / np.sqrt(6.0)
    read += rng.normal(0.0, three_joint_plant.SIGMA, read.shape)
    three_joint_plant.write_campaign(folder / "rows.csv", q, read)
    arm = load_arm(file)
    return arm, read_measurements(folder / "rows.csv", arm)


def ratios(arm: Arm, rows: Measurements, some: np.ndarray) -> np.ndarray:
    """Return (n, 3) errors of what an arm predicts of some rows, over their standard deviations."""
    there = predict(arm, rows)
    assert there.sigma is not None
    return ((there.position - rows.position) / np.hypot(there.sigma, rows.sigma))[some]


def test_rows_held_out_are_within_what_is_stated_of_an_arm_that_lacks_something(tmp_path: Path) -> None:
    among, apart = [], []
    for seed in range(2):
        arm, rows = campaign(tmp_path / str(seed), seed, lacking=1e-3, count=400)
        for cut, part in ((among, np.arange(len(rows)) % 3), (apart, apart_folds(rows.q, 3))):
            for number in range(3):
                found = calibrate(arm, rows, np.flatnonzero(part != number), anyway=True)
                cut.append(ratios(found.arm, rows, part == number))
                assert found.arm.certainty is not None and found.arm.certainty.misfit > 2e-4
    for cut in (among, apart):
        assert 0.90 < (np.abs(np.concatenate(cut)) < WITHIN).mean() < 0.98


@pytest.mark.parametrize("size", [0.0, 3e-4])
def test_what_is_off_on_rows_held_out_beyond_noise_and_fit_is_found(size: float, tmp_path: Path) -> None:
    """Errors are drawn as they would be with everything chosen without a row's fold, and wrong by so much."""
    arm, rows = campaign(tmp_path / "one", 5, lacking=0.0)
    found, rng = calibrate(arm, rows).fit, np.random.default_rng(5)
    folds, judged = np.arange(len(found.view.rows)) % 5, np.isfinite(found.view.sigma)
    exact = np.sqrt(held_out(found, folds).squares[:, None] / 3.0)  # of the parameters and the noise, by its size alone
    errors = exact * rng.choice([-1.0, 1.0], (len(folds), 3)) + rng.normal(0.0, size, (len(folds), 3))
    assert excess(found, folds, errors, judged, 1.0) == pytest.approx(size, rel=0.15)


def test_of_an_arm_that_lacks_nothing_readings_are_independent(tmp_path: Path) -> None:
    effects = []
    for seed in range(3):
        arm, rows = campaign(tmp_path / str(seed), seed, lacking=0.0)
        certainty = calibrate(arm, rows).arm.certainty
        assert certainty is not None and certainty.misfit == 0.0
        effects.append(certainty.design_effect)
    assert np.median(effects) < 2.0


@pytest.mark.parametrize("lacking", [0.0, 5e-4])
def test_what_is_kept_is_as_certain_as_its_errors(lacking: float, tmp_path: Path) -> None:
    """Fitted frames make up for the errors of what is kept: those are not to be counted beside theirs."""
    arm, rows = campaign(tmp_path / "first", 1, lacking)
    first = tmp_path / "first" / "calibrated.toml"
    calibrate(arm, rows).write(first)
    _, later = campaign(tmp_path / "later", 2, lacking)
    few = np.arange(30)
    kept = calibrate(load_arm(first), later, few, keep=True)
    ratio = ratios(kept.arm, later, np.arange(30, len(later)))
    assert 0.5 < np.sqrt((ratio**2).mean()) < 1.5
    second = tmp_path / "first" / "kept.toml"
    there = load_arm(kept.write(second))
    np.testing.assert_allclose(ratios(there, later, few), ratios(kept.arm, later, few), rtol=1e-4, atol=1e-4)


def test_a_shape_without_a_law_is_doubtful_beyond_where_it_was_found(tmp_path: Path) -> None:
    arm, rows = campaign(tmp_path / "one", 3, lacking=0.0)
    path = calibrate(arm, rows).write(tmp_path / "one" / "calibrated.toml")
    plain, calibrated = load_arm(path), path.read_text()
    tents = ", ".join(f"a{i} = 1e-3" for i in range(8))

    def shaped(name: str, parameters: str) -> Prediction:
        effect = f'name = "{name}"\nsite = "J2"\naxis = "ry"\ncovariates = ["q_J2"]\nparameters = {{ {parameters} }}'
        path.write_text(f"{calibrated}\n[[effect]]\n{effect}\nseen = {{ q_J2 = [-0.4, 0.4] }}\n")
        return predict(load_arm(path), rows)

    bare, shape = predict(plain, rows), shaped('unnamed"\nshape = "spline', f"{tents}, low = -5.0, high = 5.0")
    harmonic = shaped("gear_harmonic", "A = 1e-3, B = 5e-4, k = 9")
    assert bare.sigma is not None and shape.sigma is not None and harmonic.sigma is not None
    share = np.clip((np.abs(rows.q[:, 1]) - 0.4) / 0.8, 0.0, 1.0)
    inside, motion = share == 0.0, np.linalg.norm(shape.position - bare.position, axis=1)
    more = np.sqrt(np.maximum((shape.sigma**2 - bare.sigma**2).sum(axis=1), 0.0))
    assert motion.min() > 1e-4 and more[inside].max() < 0.02 * motion.min()
    np.testing.assert_allclose(more[~inside], (share * motion)[~inside], rtol=0.05, atol=2e-6)
    told = [[flag.text for flag in flags] for flags in shape.outside]
    assert not any(told[i] for i in np.flatnonzero(inside))
    (text,) = told[int(share.argmax())]
    assert "unnamed shape at J2 (ry): q_J2 = " in text and "outside the -0.4 to 0.4" in text and "without it" in text
    np.testing.assert_allclose(harmonic.sigma, bare.sigma, rtol=0.05)  # a law goes on
    assert "without it" not in harmonic.outside[int(share.argmax())][0].text
