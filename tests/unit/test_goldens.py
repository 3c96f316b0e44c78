"""Every command says on the bundled arms what it said before; `goldens.py` says how the files are made anew."""

from types import SimpleNamespace

import numpy as np
import pytest
from goldens import COMMANDS, command_json, compare, differences

from armflex.estimate.identify import partners_of
from armflex.laws.effects.location import Location
from armflex.laws.effects.shapes import shares_of_load
from armflex.linear_gaussian import LinearGaussian

LONG = ("calibrate_tarm", "train_neural")
HERE = [name for name in COMMANDS if name != "trace_tarm"]  # which the demonstration traces, see `cli/test_cli.py`


@pytest.mark.parametrize("name", [pytest.param(one, marks=pytest.mark.slow if one in LONG else ()) for one in HERE])
def test_a_command_says_what_it_said(name: str) -> None:
    assert compare(name, command_json(COMMANDS[name])) == []


def test_a_difference_is_found() -> None:
    golden = {"a": [1.0, {"b": "x"}], "c": None}
    assert not list(differences(golden, {"a": [1.0 + 1e-9, {"b": "x"}], "c": None}))
    assert list(differences(golden, {"a": [1.1, {"b": "x"}], "c": None})) == [".a[0]: 1.1, it was 1.0"]
    assert list(differences(golden, {"a": [1.0, {"b": "y"}]})) == [".a[1].b: 'y', it was 'x'", ".c: missing"]


def test_rounding_is_no_finding() -> None:
    """What a column of rounding resembles, or at which load rounding saturates, differs between processors."""
    known, names = LinearGaussian(np.eye(3)), ["a", "b", "c"]
    columns = np.array([[1.0, 1e-17, 0.0], [0.0, 1e-17, 1.0]])
    assert partners_of(columns.T @ columns, known, 1, names) == ()
    columns[:, 1] = 1e-3
    assert partners_of(columns.T @ columns, known, 1, names) == ("a", "c")
    context = SimpleNamespace(wrenches={"J1": np.array([[1e3, 0.0, 0.0, 5e-10, 20.0, 0.0]])})
    assert shares_of_load(Location("J1", "rx"), context, (0.5,)) == ()
    assert shares_of_load(Location("J1", "ry"), context, (0.5,)) == [10.0]
