"""Stages, tags, verdicts and facts: what people say of an episode."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from helpers.recording import camera_recording, datasets_synthetic
from surg_recording.episode import episode_reader, recovery
from surg_recording.episode.annotations import Annotations, parse_info, parse_tag


def test_stages_follow_one_another_and_end_with_the_episode(tmp_path: Path) -> None:
    recording = camera_recording.start(tmp_path / "e", cameras=())
    said = [
        (10, '{"stage": "approach"}'),
        (20, "slipped, once"),
        (30, '{"stage": "grasp", "tag": "second try"}'),
        (40, '{"success": false, "reason": "dropped"}'),
        (50, '{"success": true, "stamp_ns": 45}'),
    ]
    for stamp, text in said:
        recording.tag(parse_tag(text), text, "/console", stamp + 1, stamp)
    assert recording.status()["stage"] == "grasp"
    recorded = episode_reader.read(recording.close({}, end_stamp_ns=60))
    assert recorded.stages == [
        {"name": "approach", "begin_ns": 10, "end_ns": 30, "by": "/console"},
        {"name": "grasp", "begin_ns": 30, "end_ns": 60, "by": "/console"},
    ]
    assert [(t["stamp_ns"], t["text"]) for t in recorded.tags] == [
        (20, "slipped, once"),
        (30, "second try"),
    ]
    assert recorded.manifest["result"] == {"success": True, "reason": "", "by": "/console"}
    events = recorded.table("events")
    assert events["stamp_ns"].tolist() == [10, 20, 30, 40, 45]
    assert list(events["text"]) == [text for _, text in said]
    assert set(events["topic"]) == {"/record/tag"}


def test_phases_of_the_task_are_stages_unless_a_person_marked_one() -> None:
    found, run = Annotations(), {"stages": {"grasp": "Grasp the ring."}}
    for stamp, phase, done in ((0, "reach", 0), (5, "reach", 0), (10, "grasp", 0), (20, "x", 1)):
        found.phase(phase, stamp, bool(done))
    found.end(25)
    assert found.stages(run) == [
        {"name": "reach", "begin_ns": 0, "end_ns": 10, "by": "task"},
        {"name": "grasp", "begin_ns": 10, "end_ns": 20, "by": "task", "text": "Grasp the ring."},
    ]
    assert found.stage is None
    found.add(parse_tag('{"stage": "mine", "stamp_ns": 7}'), 30, "/console")
    assert found.stage == "mine"
    assert [stage["name"] for stage in found.stages("nonsense")] == ["mine"]


def test_a_recovery_finds_the_phases_of_the_task(tmp_path: Path) -> None:
    source = datasets_synthetic.record(tmp_path / "source", 1, 0.7, cameras=())
    stages = episode_reader.read(source).stages
    assert [stage["name"] for stage in stages] == ["wait", "reach", "follow"]
    partial = source.rename(tmp_path / "killed.partial")
    last = json.loads((partial / "manifest.json").read_text())
    datasets_synthetic.edit(partial, stages=[], tables={}, videos={}, outcome="recording")
    found = episode_reader.read(recovery.recover_one(partial)).stages
    assert found[:-1] == last["stages"][:-1]
    assert found[-1] | {"end_ns": 0} == last["stages"][-1] | {"end_ns": 0}


def test_the_tasks_verdict_counts_where_nobody_judged() -> None:
    task = {"done": True, "success": False, "reason": "time"}
    found = Annotations()
    assert found.judged(task) == {"success": False, "reason": "time", "by": "task"}
    assert found.judged({"done": False})["success"] is None
    assert found.judged("nonsense")["success"] is None
    found.add(parse_tag('{"success": null}'), 1, "/a")
    assert found.judged(task) == {"success": None, "reason": "", "by": "/a"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("  ", "an empty tag"),
        ("{", "must be JSON"),
        ("{}", "no key"),
        ('{"phase": 1}', "key 'phase' is unknown; allowed are tag, stage, success"),
        ('{"stage": 3}', "stage is 3, must be a text"),
        ('{"success": 1}', "success is 1, allowed are true, false and null"),
        ('{"tag": "a", "stamp_ns": 1.5}', "stamp_ns is 1.5, must be an integer"),
        ('{"tag": "a", "stamp_ns": true}', "stamp_ns is True"),
        ("a" * 1001, "has 1001 characters, at most 1000"),
        ('{"tag":' + "[" * 100_000, "must be JSON"),
    ],
)
def test_a_tag_that_says_nothing_right_is_refused_in_words(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said.replace("{", r"\{")):
        parse_tag(text)


def test_facts_are_a_json_object() -> None:
    assert parse_info('{"operator": "A"}') == {"operator": "A"}
    for text in ("A", "[1]", json.dumps({"a": "b" * 20_000})):
        with pytest.raises(ValueError, match="info"):
            parse_info(text)
