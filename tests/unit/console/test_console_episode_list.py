"""The console's list of episodes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from surg_console.labelling import label_file
from surg_console.session.episode_list import Episodes
from surg_recording.episode import labels
from surg_recording.episode.episode_reader import below
from surg_recording.recording_errors import EpisodeError


def test_episodes_are_listed_with_their_outcome(tmp_path: Path) -> None:
    folder = tmp_path / "episode"
    listed = Episodes(folder)
    assert listed.entries() == []

    def episode(name: str, **manifest: object) -> None:
        (tmp_path / name).mkdir()
        (tmp_path / name / "manifest.json").write_text(json.dumps(manifest))

    done = {"task": {"name": "bgr", "done": True, "success": True}}
    late = {"task": {"name": "bgr", "done": True, "success": False, "reason": "late"}}
    episode("episode", outcome="complete", started_ns=10**9, stopped_ns=3 * 10**9, sim=done)
    episode("episode_2", outcome="incomplete", reason="disk", started_ns=2 * 10**9, sim=late)
    (tmp_path / "episode_3.partial").mkdir()
    (tmp_path / "episode_4").mkdir()
    (tmp_path / "episode_4" / "manifest.json").write_text("[" * 10)
    (tmp_path / "another").mkdir()
    (tmp_path / "episode_depth").mkdir()  # what commands write beside an episode
    for name in ("episode_view.html", "episode_2.mp4"):
        (tmp_path / name).touch()
    (tmp_path / "episode" / "labels.json").write_text("{}")
    assert {e.name: e.files for e in listed.entries()}["episode"] == "unreadable"
    (tmp_path / "episode" / "labels.json").unlink()
    by_name = {entry.name: entry for entry in listed.entries()}
    assert set(by_name) == {"episode", "episode_2", "episode_3", "episode_4"}
    first, second = by_name["episode"], by_name["episode_2"]
    assert (first.files, first.seconds, first.outcome) == ("complete", 2.0, "success")
    assert (second.files, second.reason, second.outcome) == (
        "incomplete",
        "disk; late",
        "failure",
    )
    assert (by_name["episode_3"].files, by_name["episode_4"].files) == ("unfinished", "unreadable")
    assert by_name["episode_4"].outcome == ""
    assert [entry.name for entry in listed.entries()][-2:] == ["episode_2", "episode"]


def test_an_episode_that_an_export_would_refuse_says_so(tmp_path: Path) -> None:
    """Its camera stalled: the recording is complete, its pictures are too old at some times."""
    (tmp_path / "episode").mkdir()
    said = ["/policy/rejected: nothing was received", "left: fell silent for more than 0.15 s"]
    kept = json.dumps({"outcome": "complete", "warnings": said})
    (tmp_path / "episode" / "manifest.json").write_text(kept)
    (entry,) = Episodes(tmp_path / "episode").entries()
    assert entry.files == "with old pictures"
    assert said[0] not in entry.reason and said[1] in entry.reason
    assert "export needs --allow old-pictures" in entry.reason


def test_a_judgement_is_the_word_that_every_command_says(tmp_path: Path) -> None:
    """A recording that was stopped early is aborted; a person's word counts before the task's."""
    folder, listed = tmp_path / "episode", Episodes(tmp_path / "episode")
    folder.mkdir()
    stopped = {"task": {"name": "bgr", "done": False, "success": False}}
    (folder / "manifest.json").write_text(json.dumps({"outcome": "complete", "sim": stopped}))

    def now() -> tuple[str, str, str]:
        (entry,) = listed.entries()
        return entry.files, entry.outcome, entry.by

    assert now() == ("complete", "aborted", "")
    note = {"success": None, "note": "kept", "stages": None, "trim": None}
    label_file.save(folder, note, "A")
    assert now() == ("complete", "aborted", "")
    for success, word in ((True, "success"), (False, "failure")):
        label_file.judge(folder, success, "console")
        assert now() == ("complete", word, "person")
    assert labels.read(folder)["note"] == "kept"
    label_file.discard(folder)
    assert now() == ("discarded", "", "")
    assert below(tmp_path) == [], "no command takes it"
    with pytest.raises(EpisodeError, match="cannot be discarded"):
        label_file.discard(folder)


def test_only_an_episode_of_this_list_is_judged(tmp_path: Path) -> None:
    listed = Episodes(tmp_path / "episode")
    for name in ("episode_2", "other", "episode_depth"):
        (tmp_path / name).mkdir()
    assert listed.has(tmp_path / "episode_2")
    for elsewhere in (tmp_path / "other", tmp_path / "episode_9", tmp_path.parent / "episode_2"):
        assert not listed.has(elsewhere)
    assert not listed.has(tmp_path / "episode_depth"), "it lies beside an episode"
