"""The harness itself: what it must call a failure is one."""

import time

import numpy as np
import pytest
from harness import TooSlowError, check_numbers, judge, limited, written

from armflex.errors import InputError


def test_a_refusal_must_name_the_file() -> None:
    path = written("a.csv", b"")

    def refuse(text: str) -> None:
        raise InputError(text)

    assert not judge(lambda: refuse("a.csv:1: empty"), path)
    with pytest.raises(AssertionError, match=r"does not name a\.csv"):
        judge(lambda: refuse("empty"), path)
    with pytest.raises(AssertionError, match="without a message"):
        judge(lambda: refuse(""), path)


def test_another_exception_or_a_warning_of_numpy_fails() -> None:
    path = written("a.csv", b"")
    with pytest.raises(ZeroDivisionError):
        judge(lambda: 1 / 0, path)
    with pytest.raises(AssertionError, match="numpy warned"):
        judge(lambda: np.log(np.array([0.0, -1.0])), path)


@pytest.mark.parametrize(
    ("name", "values", "problem"),
    [
        ("position", [np.nan], "NaN"),
        ("position", [np.inf], "not finite"),
        ("sigma", [np.nan], "NaN"),
        ("covariance", [[1.0, 2.0], [2.0, 1.0]], "semidefinite"),
        ("covariance", [[1.0, 0.5], [0.0, 1.0]], "symmetric"),
        ("covariance", [[-1.0, 0.0], [0.0, 1.0]], "semidefinite"),
    ],
)
def test_wrong_numbers_fail(name: str, values: list, problem: str) -> None:
    with pytest.raises(AssertionError, match=problem):
        check_numbers(name, values)


def test_time_and_memory_have_an_end_and_are_given_back() -> None:
    with pytest.raises(TooSlowError), limited(seconds=0.05):
        while True:
            pass
    with pytest.MonkeyPatch.context() as patch, pytest.raises(TooSlowError):
        patch.setattr("harness.STILL", 0.05)
        with limited():
            time.sleep(600.0)
    with pytest.raises(MemoryError), limited(more_bytes=1 << 28):
        np.zeros(1 << 28)
    assert np.zeros(1 << 28).nbytes == 1 << 31
