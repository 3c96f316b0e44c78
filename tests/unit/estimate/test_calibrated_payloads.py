"""An arm says which payloads it was calibrated under where rows carry another."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.campaign_files import write_columns

from armflex import calibrate, check, compensate, load_arm, map_workspace, predict
from armflex.export.c_code import export
from armflex.measured.measurements import read_measurements
from armflex.parameters import Certainty
from armflex.tasks.settle import settle
from armflex.trajectory import read_trajectory

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
[payload.p40]
mass = 40.0
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
    assert "payload none" in said("none", "p80", "none") and "(2 rows in all)" in said("none", "none", "p80")
    assert "p20, p80 alone" in said("none")


@pytest.mark.filterwarnings("ignore:weightless:armflex.ArmflexWarning")
def test_every_answer_says_a_payload_that_no_campaign_had(tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_text(DECLARED)
    declared, seen = load_arm(tmp_path / "arm.toml"), ("p20",)
    arm = replace(declared, certainty=Certainty((), np.zeros((0, 0)), payloads=seen))
    path = {"time": [0.0, 1.0, 2.0], **{f"q_{name}": [0.1, 0.2, 0.3] for name in arm.joint_names}}
    carried = ["p20", "p80", "p40"]
    write_columns(tmp_path / "path.csv", path | {"payload": carried})
    trajectory = read_trajectory(tmp_path / "path.csv", arm)
    q = np.array([path[f"q_{name}"] for name in arm.joint_names]).T
    flagged = {
        "deflection": [flag for name in carried for flag in arm.deflection(q[0], name).flags],
        "batch": arm.deflection(q, carried).flags,
        "modes": [flag for name in carried for flag in arm.modes(q[0], name).flags],
        "check": check(arm, trajectory, 1.0).flags,
        "compensate": compensate(arm, trajectory).flags,
        "map": map_workspace(arm, carried, rows=64).flags,
        "settle": settle(arm, trajectory, 1e-3).flags,
        "c": export(arm).flags,
        "predict": predict(arm, read_measurements(tmp_path / "path.csv", arm, inputs_only=True)).flags,
    }
    said = {name: {flag.about for flag in flags if flag.code == "new_payload"} for name, flags in flagged.items()}
    assert said.pop("settle") == {"p40"}  # where the path ends
    assert said.pop("c") == {"none", "p40", "p80"}
    assert all(names == {"p40", "p80"} for names in said.values()), said
    assert not [flag for flag in declared.deflection(q[0], "p80").flags if flag.code == "new_payload"]
