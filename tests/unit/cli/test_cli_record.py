"""`./surg episode recover`, and `./surg record` without a system: what they say and refuse."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from surg_cli.commands import record
from surg_cli.graph import running
from surg_cli.host.terminal import CliError
from surg_recording.episode import episode_reader
from surg_recording.episode.episode_writer import EpisodeWriter
from surg_recording.nodes.recorder_parameters import Settings
from surg_ros.params import ParamError, read


def test_recover_finds_what_lies_below_a_folder(
    surg: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a/episode", "b/episode"):
        os.close(EpisodeWriter(tmp_path / name, {"arms": ["PSM1"]}, 0).lock)
        text = "stamp_ns,receive_ns,topic,source,text\n1,2,/x,,one\n3,4,/x,,tw"
        (tmp_path / f"{name}.partial" / "events.csv").write_text(text)
    assert surg("episode", "recover", tmp_path) == 0
    said = capsys.readouterr().out
    for name in ("a/episode", "b/episode"):
        assert f"{tmp_path / name}: 1 rows, 0 frames; the recorder was killed" in said
        assert len(episode_reader.read(tmp_path / name).table("events")) == 1
    assert surg("episode", "recover", tmp_path) == 0
    assert "no interrupted recordings" in capsys.readouterr().out


def test_recover_says_what_it_cannot_do_and_goes_on(
    surg: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    held = EpisodeWriter(tmp_path / "held", {}, 0)
    os.close(EpisodeWriter(tmp_path / "good", {}, 0).lock)
    assert surg("episode", "recover", tmp_path) == 1
    said = capsys.readouterr()
    assert "held.partial: is being recorded now" in said.err
    assert f"{tmp_path / 'good'}: 0 rows" in said.out
    os.close(held.lock)
    with pytest.raises(CliError, match="no such folder"):
        surg("episode", "recover", tmp_path / "none")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["tag"], "record tag: TEXT is missing"),
        (["start", "now"], "takes no text"),
        (["start", "--outcome", "success"], "--outcome belongs to record stop"),
        (["stop", "--info", "seed=3"], "--info belongs to record start"),
        (["status"], "no system of this checkout is running"),
    ],
)
def test_record_refuses_in_words(
    surg: Callable[..., int], monkeypatch: pytest.MonkeyPatch, words: list[str], said: str
) -> None:
    monkeypatch.setattr(running, "systems", list)
    with pytest.raises(CliError, match=said):
        surg("record", *words)


def test_the_status_is_readable(capsys: pytest.CaptureFixture[str]) -> None:
    messages = pytest.importorskip("surg_msgs.msg")
    stream, kind = messages.RecordStream, messages.RecordStatus
    status = kind(
        state=kind.STATE_RECORDING,
        folder="/e",
        streams=[
            stream("cycle_PSM1", stream.KIND_TABLE, 7, 0, 0),
            stream("cam", stream.KIND_CAMERA, 3, 2, 0),
        ],
        waiting_for=["/never"],
        warnings=["cam: silent"],
        problem=kind.PROBLEM_INCOMPLETE,
        detail="disk full",
    )
    record._show(status)
    assert capsys.readouterr().out.splitlines() == [
        "recording /e",
        "  cycle_PSM1: 7 rows",
        "  cam: 3 frames, 2 DROPPED",
        "  nothing yet on /never",
        "  warning: cam: silent",
        "  problem: disk full",
    ]


def settings(**given: Any) -> Settings:
    return read(Settings, {"out": "/tmp/e", **given})


def test_the_recorders_parameters() -> None:
    found = settings(
        arms="[PSM1, /PSM2]",
        cameras="endoscope_left,/cam/image_raw",
        topics="[/PSM[12]/measured_*,/tf]",
        run_info='{"operator": "A"}',
        min_free_bytes=4.3e9,
    )
    assert found.arms == ("PSM1", "PSM2")
    assert found.camera_topics == {
        "endoscope_left": "/endoscope/left/image_raw",
        "cam": "/cam/image_raw",
    }
    assert found.topics == ("/PSM[12]/measured_*", "/tf")
    assert found.run_info == {"operator": "A"}
    assert (found.min_free_bytes, found.autostart) == (4_300_000_000, True)
    assert settings(topics="/PSM[12]").topics == ("/PSM[12]",)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"mode": "fast"}, "mode"),
        ({"video_preset": "best"}, "video_preset"),
        ({"cameras": ["a_b", "/a/b/image_raw"]}, "cameras"),
        ({"topics": 3}, "topics"),
        ({"min_free_bytes": -1}, "min_free_bytes"),
        ({"min_free_bytes": float("nan")}, "min_free_bytes"),
        ({"min_free_bytes": True}, "min_free_bytes"),
        ({"run_info": "[1]"}, "run_info"),
    ],
)
def test_a_parameter_out_of_range_is_named(given: dict[str, Any], said: str) -> None:
    with pytest.raises(ParamError) as caught:
        settings(**given)
    assert caught.value.name == said
    assert repr(caught.value.value) == repr(given[said])
