"""What telescopes and long beams lack: a support that lifts off its stop is named, and air that bends a beam."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.campaigns import draw
from support.telescope import MOUNT

from armflex import Arm, calibrate, load_arm, predict, read_measurements, trace

LIFT = """
[[effect]]
name = "support_lift"
site = "el"
axis = "rz"
partner = "{partner}"
parameters = {parameters}
"""


def mount(folder: Path, effect: str = "") -> Arm:
    (folder / "mount.toml").write_text(MOUNT.replace("sigma = 5e-6", "sigma = 2e-6") + effect)
    return load_arm(folder / "mount.toml")


def run(folder: Path, arm: Arm, count: int, noise: float = 0.0) -> Path:
    """Write what an arm would read of stars over the sky."""
    rng = np.random.default_rng(4)
    az, el = rng.uniform(-3.0, 3.0, count), rng.uniform(0.3, 1.45, count)
    columns, header = [az, el], "q_az,q_el"
    path = folder / "run.csv"
    for _ in range(2):
        rows = np.column_stack(columns)
        path.write_text("\n".join([header, *(",".join(map(repr, row)) for row in rows.tolist())]) + "\n")
        if len(columns) == 2:
            ((kind, _),) = predict(arm, path).sensors
            off = rng.normal(0.0, noise, (count, 2)) / np.column_stack([np.cos(el), np.ones(count)])
            columns += [*(kind.values + off).T]
            header += ",star_azimuth,star_elevation"
    return path


def test_a_support_does_nothing_up_to_its_start_and_then_turns_by_its_slope(tmp_path: Path) -> None:
    """By the angle of its drive from either side, and by the weight that it carries along the tube."""
    bare = read_measurements(run(tmp_path, mount(tmp_path), 60), mount(tmp_path)).readings.kinds[0].values
    el = np.loadtxt(tmp_path / "run.csv", delimiter=",", skiprows=1)[:, 1]
    weight = 98.1 * np.sin(el)
    for partner, parameters, turned in [
        ("q", "{ slope = 1e-4, start = 0.8 }", 1e-4 * np.maximum(0.0, el - 0.8)),
        ("-q", "{ slope = 1e-4, start = -0.8 }", 1e-4 * np.maximum(0.0, 0.8 - el)),
        ("-fx", "{ slope = 1e-6, start = 60.0 }", 1e-6 * np.maximum(0.0, weight - 60.0)),
        ("-fx", "{ slope = 1e-6, flexure = -2e-6, start = 60.0 }",
         1e-6 * np.maximum(0.0, weight - 60.0) - 2e-6 * weight),
    ]:  # fmt: skip
        arm = mount(tmp_path, LIFT.format(partner=partner, parameters=parameters))
        kind = read_measurements(run(tmp_path, arm, 60), mount(tmp_path)).readings.kinds[0]
        np.testing.assert_allclose(kind.values[:, 1] - bare[:, 1], turned, atol=1e-7, err_msg=partner)


@pytest.mark.slow
def test_a_support_that_lifts_off_is_named(tmp_path: Path) -> None:
    lifted = LIFT.format(partner="-fx", parameters="{ slope = 8e-7, flexure = -3e-7, start = 55.0 }")
    path = run(tmp_path, mount(tmp_path, lifted), 160, 2e-6)
    arm = mount(tmp_path)
    found = trace(arm, read_measurements(path, arm))
    (one,) = found.found
    assert (one.effect.law.name, one.effect.location.site) == ("support_lift", "el")
    start = abs(one.effect.named["start"])  # of the weight along the tube, or of the elevation
    assert start == pytest.approx(np.arcsin(55.0 / 98.1), abs=0.07) or start == pytest.approx(55.0, abs=6.0)
    assert found.rms == pytest.approx(np.sqrt(2.0) * 2e-6, rel=0.1)


@pytest.mark.slow
def test_a_beam_that_the_air_bends_is_named(tmp_path: Path) -> None:
    truth = draw("none", 21, "six").write(tmp_path, every=3)
    arm = load_arm(truth.arm)
    rows = read_measurements(truth.train, arm)
    up = -(calibrate(arm, rows).fit.setup.instrument.pose.rotation @ arm.robot.gravity)
    lifted = 4e-5 * (rows.position**2).sum(axis=1)[:, None] * up / np.linalg.norm(up)
    (one,) = trace(arm, replace(rows, position=rows.position + lifted)).found
    assert one.effect.law.name == "refraction" and one.probability > 0.9
    assert one.effect.named["k"] == pytest.approx(4e-5, rel=0.3)
