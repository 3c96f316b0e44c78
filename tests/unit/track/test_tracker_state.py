"""A tracker's state in a file: goes on as if nothing had been, or is refused."""

from dataclasses import replace

import numpy as np
import pytest
from support.tracking import SIGMA, followed, shifted

from armflex import Tracker
from armflex.errors import InputError, ModelFileError

pytestmark = pytest.mark.slow


def test_saved_and_restored_without_loss(known, machine, tmp_path):
    readings = machine.readings(700, 60, softer={"A4": 1.2})
    tracker = followed(Tracker(known, {"compliance": 1e-3}), readings[:33])
    tracker.save(tmp_path / "state.safetensors")
    again = Tracker.restore(tmp_path / "state.safetensors", known)
    one, other = followed(tracker, readings[33:]), followed(again, readings[33:])
    assert (one.values == other.values).all() and (one.covariance == other.covariance).all()
    assert one.readings == other.readings == 60 and one.outliers == other.outliers
    assert [vars(c).keys() for c in one.changes] == [vars(c).keys() for c in other.changes] and one.changes
    one.save(tmp_path / "one"), other.save(tmp_path / "other")
    assert (tmp_path / "one").read_bytes() == (tmp_path / "other").read_bytes()


def test_memory_is_constant(known, machine, tmp_path):
    readings = machine.readings(3, 150)
    tracker, sizes = Tracker(known), []
    for reading in readings * 2:
        tracker.update(reading)
        sizes.append(tracker.save(tmp_path / "state").stat().st_size if tracker.readings % 50 == 0 else 0)
    assert max(sizes) < 1.2 * min(size for size in sizes if size)


def test_a_state_is_refused_for_another_arm_or_damaged(known, machine, tmp_path):
    path = Tracker(known).save(tmp_path / "state")
    with pytest.raises(ModelFileError, match="another arm"):
        Tracker.restore(path, machine.arm)
    data = bytearray(path.read_bytes())
    data[-5] ^= 1
    path.write_bytes(bytes(data))
    with pytest.raises(ModelFileError, match="damaged"):
        Tracker.restore(path, known)
    path.write_bytes(b"nothing")
    with pytest.raises(ModelFileError, match="safetensors"):
        Tracker.restore(path, known)


def test_readings_kept_for_another_look_are_saved(machine, tmp_path):
    """Saved while all is unsettled, with numbers of other kinds among the readings."""
    readings = shifted(machine.readings(8, 60), {2: [0.0, 0.0, 0.04]})
    kinds = [
        replace(one, q=one.q.tolist(), sigma=np.full(3, SIGMA), time=np.float32(i), covariates={"hold": np.int64(1)})
        for i, one in enumerate(readings)
    ]
    one = followed(Tracker(machine.arm, {"compliance": np.float32(1e-3)}), kinds[:7])
    other = Tracker.restore(one.save(tmp_path / "state"), machine.arm)
    followed(one, kinds[7:]), followed(other, kinds[7:])
    assert (one.values == other.values).all() and (one.covariance == other.covariance).all() and one.outliers == 1
    assert one.save(tmp_path / "one").read_bytes() == other.save(tmp_path / "other").read_bytes()


@pytest.mark.parametrize("time", [np.float32(3.0), np.int64(3), 3, np.float64(3.0)])
def test_a_time_of_any_kind_is_saved(known, machine, tmp_path, time):
    tracker, (reading,) = Tracker(known), machine.readings(3, 1)
    tracker.update(replace(reading, time=time))
    again = Tracker.restore(tracker.save(tmp_path / "state"), known)
    with pytest.raises(InputError, match="time: 2 s after 3"):
        again.update(replace(reading, time=2))
