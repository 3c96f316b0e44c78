"""Every command says on the bundled arms what it said before; `goldens.py` says how the files are made anew."""

from __future__ import annotations

import pytest
from goldens import COMMANDS, command_json, compare, differences


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_says_what_it_said(name: str) -> None:
    assert compare(name, command_json(COMMANDS[name])) == []


def test_a_difference_is_found() -> None:
    golden = {"a": [1.0, {"b": "x"}], "c": None}
    assert not list(differences(golden, {"a": [1.0 + 1e-9, {"b": "x"}], "c": None}))
    assert list(differences(golden, {"a": [1.1, {"b": "x"}], "c": None})) == [".a[0]: 1.1, it was 1.0"]
    assert list(differences(golden, {"a": [1.0, {"b": "y"}]})) == [".a[1].b: 'y', it was 'x'", ".c: missing"]
