"""Any other topic: every value of every message comes back, under its own name."""

from __future__ import annotations

import math
import random
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from helpers.recording import camera_recording
from surg_recording.episode import episode_reader
from surg_recording.episode.message_fields import MAX_ITEMS, Flat, file_name
from surg_recording.episode.topic_selection import TopicChoice
from surg_recording.recording_errors import EpisodeError


def message(**fields: tuple[str, Any]) -> Any:
    """A message as genpy makes them: slots, their types, their values."""
    made = SimpleNamespace(**{name: value for name, (_, value) in fields.items()})
    made.__slots__ = list(fields)
    made._slot_types = [kind for kind, _ in fields.values()]
    return made


def header(stamp_ns: int, frame: str = "world") -> Any:
    stamp = SimpleNamespace(secs=stamp_ns // 10**9, nsecs=stamp_ns % 10**9)
    return message(seq=("uint32", 7), stamp=("time", stamp), frame_id=("string", frame))


def joints(stamp_ns: int, position: list[float], names: list[str]) -> Any:
    return message(
        header=("std_msgs/Header", header(stamp_ns)),
        name=("string[]", names),
        position=("float64[]", position),
    )


def record(tmp_path: Path, sent: list[tuple[str, str, Any]], **more: Any) -> episode_reader.Episode:
    recording = camera_recording.start(tmp_path / "e", cameras=())
    for number, (topic, kind, content) in enumerate(sent):
        recording.topic(topic, kind, Flat(content), "/sender", 2 * 10**18 + number)
    return episode_reader.read(recording.close({}, **more))


def test_every_kind_of_field_has_its_name_and_its_value() -> None:
    nested = message(x=("float64", 0.1), ok=("bool", True))
    duration = SimpleNamespace(secs=-1, nsecs=999_999_999)
    flat = Flat(
        message(
            header=("std_msgs/Header", header(1_732_147_200_123_456_789)),
            pose=("a/Pose", nested),
            poses=("a/Pose[]", [nested, nested]),
            q=("float64[3]", [1.0, 2.0, math.nan]),
            big=("int64", 2**63 - 1),
            raw=("uint8[]", b"\x00\xff"),
            text=("string", 'a,"b"'),
            wait=("duration", duration),
            source=("string", "mine"),
        )
    )
    assert flat.stamp_ns == 1_732_147_200_123_456_789
    assert flat.cut == []
    q = flat.values.pop("q_2")
    assert math.isnan(q)
    assert flat.values == {
        "header.seq": 7,
        "header.frame_id": "world",
        "pose.x": 0.1,
        "pose.ok": 1,
        "poses.length": 2,
        "poses_0.x": 0.1,
        "poses_0.ok": 1,
        "poses_1.x": 0.1,
        "poses_1.ok": 1,
        "q_0": 1.0,
        "q_1": 2.0,
        "big": 2**63 - 1,
        "raw.length": 2,
        "raw": "00ff",
        "text": 'a,"b"',
        "wait_ns": -1,
        "source_": "mine",
    }
    assert flat.kinds["wait_ns"] == "int" and flat.kinds["raw"] == "text"


def test_what_is_sent_is_what_is_read(tmp_path: Path, rng: random.Random) -> None:
    start = 1_732_147_200_000_000_000
    sent = []
    for k in range(200):
        q = [rng.uniform(-3, 3) for _ in range(6)]
        names = [f"joint, {i}" for i in range(6)]
        sent.append(("/PSM1/measured_js", "sensor_msgs/JointState", joints(start + k, q, names)))
    sent += [("/n", "std_msgs/Int64", message(data=("int64", 2**62 + k))) for k in range(5)]
    recorded = record(tmp_path, sent)
    assert recorded.complete
    assert recorded.topics == {
        "/PSM1/measured_js": ["topics/PSM1_measured_js"],
        "/n": ["topics/n"],
    }
    (table,) = recorded.topic("/PSM1/measured_js")
    assert table["stamp_ns"].tolist() == [start + k for k in range(200)]
    assert table["receive_ns"].tolist() == [2 * 10**18 + k for k in range(200)]
    for i in range(6):
        assert table[f"position_{i}"].tolist() == [m.position[i] for *_, m in sent[:200]]
        assert set(table[f"name_{i}"]) == {f"joint, {i}"}
    assert set(table["source"]) == {"/sender"}
    (numbers,) = recorded.topic("/n")
    assert numbers["data"].tolist() == [2**62 + k for k in range(5)], "every digit"
    assert numbers["stamp_ns"].tolist() == [0] * 5
    entry = recorded.manifest["tables"]["topics/n"]
    assert (entry["topic"], entry["type"], entry["rows"]) == ("/n", "std_msgs/Int64", 5)
    assert recorded.manifest["topics"]["/n"]["messages"] == 5
    with pytest.raises(EpisodeError, match=r"no topic '/m'; there are /PSM1/measured_js, /n"):
        recorded.topic("/m")


def test_arrays_that_grow_and_shrink_lose_nothing(tmp_path: Path, rng: random.Random) -> None:
    lengths = [0, 2, 2, 1, 5, 0, 5, 3, 7, 7, 2]
    sent = []
    for k, n in enumerate(lengths):
        q = [rng.random() for _ in range(n)]
        sent.append(("/q", "sensor_msgs/JointState", joints(k + 1, q, [])))
    recorded = record(tmp_path, sent)
    tables = recorded.topic("/q")
    assert [len(t) for t in tables] == [1, 3, 4, 3]
    assert [t.name for t in tables] == ["q", "q.2", "q.3", "q.4"]
    found = {}
    for table in tables:
        for row, stamp in enumerate(table["stamp_ns"]):
            n = table["position.length"][row]
            found[stamp] = [table[f"position_{i}"][row] for i in range(n)]
    assert found == {k + 1: m.position for k, (*_, m) in enumerate(sent)}
    assert recorded.complete and recorded.warnings == []


def test_an_array_without_end_is_cut_and_said(tmp_path: Path) -> None:
    sent = [("/cloud", "a/Cloud", message(data=("float32[]", [0.5] * 100_000)))]
    sent += [("/raw", "a/Raw", message(data=("uint8[]", bytes(100_000))))]
    recorded = record(tmp_path, sent)
    (table,) = recorded.topic("/cloud")
    assert table["data.length"].tolist() == [100_000]
    assert len(table.columns) == 4 + MAX_ITEMS
    assert recorded.manifest["topics"]["/cloud"]["cut"] == 1
    assert recorded.warnings == [f"/{n}: data is too long: it is cut" for n in ("cloud", "raw")]


def test_two_topics_never_share_a_file_and_a_new_type_gets_a_new_one(tmp_path: Path) -> None:
    number, text = message(data=("int32", 1)), message(data=("string", "one"))
    sent = [("/a/b", "I", number), ("/a_b", "I", number), ("/a/b", "S", text)]
    recorded = record(tmp_path, sent)
    assert recorded.topics == {
        "/a/b": ["topics/a_b", "topics/a_b.3"],
        "/a_b": ["topics/a_b.2"],
    }
    assert recorded.topic("/a/b")[1]["data"].tolist() == ["one"]
    assert file_name("/") == "root"


def test_a_topic_that_never_publishes_is_named(tmp_path: Path) -> None:
    choice = TopicChoice(["/never", "/heard", "/lost/*"], frozenset())
    quiet = choice.silent({"/heard": 3})
    assert quiet == ["/never", "/lost/*"]
    sent = [("/heard", "I", message(data=("int32", 1)))]
    recorded = record(tmp_path, sent, topics=choice.describe({"/heard": 2}))
    never = recorded.manifest["topics"]["/never"]
    assert (never["messages"], never["tables"]) == (0, [])
    assert recorded.manifest["topics"]["/lost/*"]["messages"] == 0
    heard = recorded.manifest["topics"]["/heard"]
    assert (heard["messages"], heard["repeats"], heard["type"]) == (1, 2, "I")
    assert recorded.topics == {"/heard": ["topics/heard"]}


def test_patterns_find_what_appears_and_leave_the_rest() -> None:
    choice = TopicChoice(["/PSM?/measured_*", "/tf"], frozenset({"/PSM1/measured_cp"}))
    assert choice.chosen == {"/tf"}
    published = {
        "/PSM1/measured_cp": "geometry_msgs/PoseStamped",
        "/PSM1/measured_js": "sensor_msgs/JointState",
        "/PSM1/jaw/measured_js": "sensor_msgs/JointState",
        "/PSM2/measured_image": "sensor_msgs/Image",
        "/record/status": "surg_msgs/RecordStatus",
    }
    assert choice.newly_chosen(published) == ["/PSM1/measured_js"]
    assert choice.newly_chosen(published) == []
    assert choice.newly_chosen({**published, "/PSM2/measured_js": "x/Y"}) == ["/PSM2/measured_js"]
    assert list(choice.refused) == ["/PSM2/measured_image"]
    assert "~cameras" in choice.refused["/PSM2/measured_image"]
    with pytest.raises(ValueError, match="'tf': a name or a pattern that begins with /"):
        TopicChoice(["tf"], frozenset())


def test_a_small_map_is_kept_whole_and_a_picture_is_not() -> None:
    from surg_msgs.msg import PolicyPlan

    whole, cut = (Flat(PolicyPlan(attention=bytes(range(256)) * n)) for n in (4, 5))
    assert bytes.fromhex(whole.values["attention"]) == bytes(range(256)) * 4 and not whole.cut
    assert cut.values["attention"] == whole.values["attention"] and len(cut.cut) == 1
