"""A calibrated arm is written from Python as the commands write it, and read again it predicts the same."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.lost_campaign import STIFFNESS, write_arm, write_campaign

from armflex import Arm, calibrate, load_arm, make_arm, predict, read_measurements
from armflex.arm import Measurement, Prior
from armflex.errors import UnsupportedError
from armflex.estimate import Calibration

pytestmark = pytest.mark.filterwarnings("ignore::armflex.ArmflexWarning")

PRIOR = Prior(joint_offset=2e-3, compliance=0.5, tool=5e-3)


def declared(folder: Path, form: str) -> Arm:
    """Return the same arm as a file, make_arm or a bare URDF declares it, with what a calibration needs."""
    path = write_arm(folder)
    if form == "file":
        return load_arm(path)
    urdf = folder / "six.urdf"
    drives = {f"J{i}": k for i, k in enumerate(STIFFNESS, 1)}
    arm = make_arm(urdf, drives, gravity=np.array([0.0, 0.0, -9.81])) if form == "make_arm" else load_arm(urdf)
    return replace(arm, prior=PRIOR, measurement=Measurement("unknown"))


def calibrated(folder: Path, form: str) -> Calibration:
    arm = declared(folder, form)
    return calibrate(arm, read_measurements(write_campaign(folder, 3)[0], arm), anyway=True)


@pytest.mark.parametrize("form", ["file", "make_arm", "urdf"])
def test_what_is_written_predicts_the_same(tmp_path: Path, form: str) -> None:
    found = calibrated(tmp_path, form)
    (tmp_path / "sub").mkdir()
    again = load_arm(found.write(str(tmp_path / "sub" / "written.toml")))
    assert (again.prior, again.measurement) == (found.arm.prior, found.arm.measurement)
    there, back = (predict(arm, found.measurements) for arm in (found.arm, again))
    np.testing.assert_allclose(back.position, there.position, atol=1e-12)
    np.testing.assert_allclose(back.sigma, there.sigma, rtol=1e-9)  # 11 digits of a covariance give 1e-6
    assert ("[calibration]" in (tmp_path / "sub" / "written.toml").read_text()) and found.declared_rms > found.rms


def test_what_a_file_cannot_say_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    found = calibrated(tmp_path, "file")
    softer = [replace(one, law=replace(one.law, compliance=2.0 * one.law.compliance)) for one in found.arm.flexures]
    changed = replace(found, arm=replace(found.arm, flexures=tuple(softer)))
    with pytest.raises(UnsupportedError, match=r"arm\.toml: .*its flexures are not those .* changed in Python"):
        changed.write(tmp_path / "written.toml")
    with pytest.raises(UnsupportedError, match=r"no arm\.toml declares this arm"):
        replace(found, arm=replace(found.arm, source=None)).write(tmp_path / "written.toml")
    assert not (tmp_path / "written.toml").exists()
