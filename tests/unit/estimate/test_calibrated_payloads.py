"""An arm says which payloads it was calibrated under where rows carry another."""

import csv
from pathlib import Path

import numpy as np
import pytest
from support.campaign_files import write_columns

from armflex import calibrate, load_arm, predict
from armflex.measured.measurements import read_measurements

DECLARED = """[robot]
dh = "standard"
gravity = [0.0, 0.0, -9.81]
[robot.joint]
A1 = { d_mm = 450, a_mm = 150, alpha_deg = -90 }
A2 = { theta_deg = -90, a_mm = 850 }
A3 = { a_mm = 600 }
[payload.p20]
mass = 20.0
com = [0.0, 0.0, 0.1]
[payload.p80]
mass = 80.0
com = [0.0, 0.0, 0.1]
[flexure.A2]
joint = "A2"
joint_stiffness = 1e6
[measurement]
frame = "base"
[prior]
compliance = 0.5
"""


@pytest.mark.filterwarnings("ignore:weightless:armflex.ArmflexWarning")
def test_rows_under_a_payload_that_no_campaign_had_are_flagged(tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_text(DECLARED)
    arm, rng = load_arm(tmp_path / "arm.toml"), np.random.default_rng(1)
    q, payload = rng.uniform(-1.0, 1.0, (12, 3)), ["p20", "p80"] * 6
    at = arm.deflection(q, payload).pose[:, :3, 3] + rng.normal(0.0, 1e-5, (12, 3))
    with (tmp_path / "campaign.csv").open("w", newline="") as file:
        rows = [[name, *here, *seen, 1e-5] for name, here, seen in zip(payload, q, at, strict=True)]
        # Where nothing was read a payload was carried, and was not seen.
        rows.append(["none", *q[0], "", "", "", 1e-5])
        csv.writer(file).writerows([["payload", "q_A1", "q_A2", "q_A3", "x", "y", "z", "sigma"], *rows])
    calibrate(arm, read_measurements(tmp_path / "campaign.csv", arm)).write(tmp_path / "fit.toml")
    calibrated = load_arm(tmp_path / "fit.toml")

    def said(*payloads: str) -> str:
        asked = {f"q_{name}": [0.1] * len(payloads) for name in arm.joint_names} | {"payload": list(payloads)}
        write_columns(tmp_path / "rows.csv", asked)
        flags = predict(calibrated, read_measurements(tmp_path / "rows.csv", calibrated, inputs_only=True)).flags
        return " ".join(flag.text for flag in flags if flag.code == "new_payload")

    assert said("p80", "p20") == ""
    assert "none (2 rows)" in said("none", "p80", "none") and "p20, p80 alone" in said("none")
