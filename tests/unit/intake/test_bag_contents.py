"""What is in a bag beside joints and target is said, and what of them lacks a name or a while."""

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from support.recordings import NAMES, SEEN, TT, Q, T

from armflex.errors import InputError
from armflex.intake import intake

Message = tuple[float, str, str, dict[str, object]]


def joints(rows: np.ndarray, names: Iterable[str] = NAMES) -> list[Message]:
    messages = zip(T[rows].tolist(), Q[rows].tolist(), strict=True)
    return [(time, "/joints", "JointState", {"name": list(names), "position": q}) for time, q in messages]


def places() -> list[Message]:
    return [
        (time, "/prism", "Pose", {"position": dict(zip("xyz", place, strict=True))})
        for time, place in zip(TT.tolist(), SEEN.tolist(), strict=True)
    ]


def bag(folder: Path, messages: Iterable[Message]) -> Path:
    from mcap.writer import Writer

    path, channels = folder / "bag.mcap", dict[str, int]()
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for time, topic, kind, content in messages:
            if topic not in channels:
                schema = writer.register_schema(f"pkg/{kind}", "jsonschema", b"{}")
                channels[topic] = writer.register_channel(topic, "json", schema)
            writer.add_message(channels[topic], int(1e9 * time), json.dumps(content).encode(), int(1e9 * time))
        writer.finish()
    return path


EVERY = np.arange(len(T))


def test_topics_that_are_not_read_are_named(tmp_path: Path) -> None:
    more: list[Message] = [(1.0, "/motor", "Temperature", {"temperature": 40.0}), (1.0, "/rosout", "Log", {})]
    said = " ".join(intake([bag(tmp_path, [*joints(EVERY), *places(), *more])], 5e-5).notes)
    assert "topics of bag.mcap of types that are not read: /motor (Temperature)" in said and "rosout" not in said
    assert "not read" not in " ".join(intake([bag(tmp_path, [*joints(EVERY), *places()])], 5e-5).notes)


def test_frames_that_move_beside_the_target_are_named(tmp_path: Path) -> None:
    def moved(time: float) -> dict[str, object]:
        turn = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
        transform = {"translation": {"x": 0.1 * time, "y": 0.0, "z": 0.0}, "rotation": turn}
        stamp = {"frame_id": "map", "stamp": {"sec": int(time), "nanosec": int(1e9 * (time % 1.0))}}
        return {"transforms": [{"header": stamp, "child_frame_id": "odom", "transform": transform}]}

    more: list[Message] = [(time, "/tf", "TFMessage", moved(time)) for time in T[::10].tolist()]
    found = intake([bag(tmp_path, [*joints(EVERY), *places(), *more])], 5e-5)
    assert any("/tf map->odom moves, too, and is no target" in note for note in found.notes)


def test_a_joint_without_a_name_is_none(tmp_path: Path) -> None:
    path = bag(tmp_path, [*joints(EVERY, [*NAMES[:-1], ""]), *places()])
    with pytest.raises(InputError, match=r"/joints leaves the name of a joint empty, number 3 of 3"):
        intake([path], 5e-5)


def test_a_while_without_joints_is_said(tmp_path: Path) -> None:
    begins, ends = 0.35 * T[-1], 0.6 * T[-1]
    found = intake([bag(tmp_path, [*joints(EVERY[(begins > T) | (ends < T)]), *places()])], 5e-5)
    assert any("/joints has no rows for up to" in note and "moves meanwhile" in note for note in found.notes)
    assert len(found.columns["x"]) < len(intake([bag(tmp_path, [*joints(EVERY), *places()])], 5e-5).columns["x"])
