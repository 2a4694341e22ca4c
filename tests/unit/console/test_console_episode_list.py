"""The console's list of episodes."""

from __future__ import annotations

import json
from pathlib import Path

from surg_console.session.episode_list import Episodes


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
    by_name = {entry.name: entry for entry in listed.entries()}
    assert set(by_name) == {"episode", "episode_2", "episode_3", "episode_4"}
    first, second = by_name["episode"], by_name["episode_2"]
    assert (first.outcome, first.seconds, first.success) == ("complete", 2.0, True)
    assert (second.outcome, second.reason, second.success) == ("incomplete", "disk", False)
    assert by_name["episode_3"].outcome == "unfinished"
    assert by_name["episode_4"].outcome == "unreadable"
    assert [entry.name for entry in listed.entries()][-2:] == ["episode_2", "episode"]
