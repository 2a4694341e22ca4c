"""Episodes of the real graph, labelled by keyboard, filmed, exported by verdict and evaluated.

Runs in `./surg test --full`: about two minutes.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import av
import pytest

from helpers.graph.surg import start, surg
from helpers.teleop import chromium
from helpers.teleop.chromium import Chromium, Tab
from surg_recording.episode import episode_reader, verdicts

pytestmark = [
    pytest.mark.ros,
    pytest.mark.untimed,
    pytest.mark.full,
    pytest.mark.skipif(bool(chromium.missing()), reason=chromium.missing()),
]

NOTE = "held too long"
STAGES = ["point", "grasp", "assist", "retract", "still"]
"""Of the task, in their order."""


def run(*words: object) -> str:
    """The output of a command that succeeds."""
    done = surg(*words, timeout_s=900.0)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@contextlib.contextmanager
def labelling(episodes: Path, log: Path) -> Iterator[str]:
    """`./surg episode label` until Ctrl-C; gives the address that it prints."""
    process = start(log, "episode", "label", episodes, "--by", "A. Surgeon")
    try:
        deadline = time.monotonic() + 60.0
        while "http://" not in log.read_text() and time.monotonic() < deadline:
            assert process.poll() is None, log.read_text()
            time.sleep(0.1)
        yield next(line for line in log.read_text().splitlines() if line.startswith("http://"))
        os.killpg(process.pid, signal.SIGINT)
        assert process.wait(20.0) == 0, log.read_text()
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


async def press(tab: Tab, keys: str) -> None:
    """Press keys until what they said is saved."""
    await tab.type(keys)
    await tab.until("document.getElementById('saved').textContent === 'saved'", "saving")


async def label(url: str) -> None:
    """The first episode failed, with a note; the second one succeeded."""
    async with Chromium() as browser:
        tab = await browser.open(url)
        place = "document.getElementById('place')?.textContent.startsWith('{} of 2 ')"
        await tab.until(place.format(1), "the first page", 60.0)
        note = " ".join("_" if letter == " " else letter for letter in NOTE)
        keys = await tab.run("document.getElementById('names').textContent")
        assert [keys.index(stage) for stage in STAGES] == sorted(map(keys.index, STAGES)), keys
        await press(tab, f"f n {note} Escape")
        if folder := os.environ.get("SURG_TEST_PICTURES"):
            await tab.screenshot(Path(folder) / "label_of_a_run.png")
        await tab.type("Enter")
        await tab.until(place.format(2), "the second page", 60.0)
        await press(tab, "s Home 1")
        assert not browser.errors


def test_a_verdict_by_keyboard_decides_export_and_evaluation(tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    run("run", "bgr", "--episodes", 2, "--seed", 10001, "--cameras", "left", "--out", runs)
    folders = episode_reader.below(runs)
    before = [verdicts.verdict(episode_reader.read(each).manifest) for each in folders]
    assert [(each.success, each.by) for each in before] == [(True, "task")] * 2

    log = tmp_path / "label.log"
    with labelling(runs, log) as url:
        asyncio.run(asyncio.wait_for(label(url), 240.0))
    assert "2 of 2 episodes have labels" in log.read_text()
    given = [episode_reader.read(each).manifest["labels"] for each in folders]
    assert [(each["success"], each["by"]) for each in given] == [
        (False, "A. Surgeon"),
        (True, "A. Surgeon"),
    ]
    assert given[0]["note"] == NOTE

    run("episode", "film", folders[0], "--out", tmp_path / "film.mp4", "--seconds", 4)
    with av.open(str(tmp_path / "film.mp4")) as container:
        frames = sum(1 for _ in container.decode(video=0))
    assert frames > 40

    out = tmp_path / "set"
    run("episode", "export", runs, "--where", "success", "--format", "lerobot_v30", "--out", out)
    stated = json.loads((out / "surg_export.json").read_text())
    assert [each["source"] for each in stated["recordings"]] == [str(folders[1])]

    run("episode", "evaluate", runs, "--out", tmp_path / "all")
    summary = json.loads((tmp_path / "all/summary.json").read_text())
    (condition,) = summary["conditions"].values()
    assert (condition["success_rate"]["k"], condition["success_rate"]["n"]) == (1, 2)
    assert "task" in summary["episodes"][0]["disagreement"], "the person says otherwise"
    assert summary["episodes"][1]["disagreement"] is None
    run("episode", "evaluate", runs, "--where", "not success", "--out", tmp_path / "failed")
    failed = json.loads((tmp_path / "failed/summary.json").read_text())
    assert [each["folder"] for each in failed["episodes"]] == [str(folders[0])]
    print(f"film {frames} frames, exported {stated['recordings'][0]['frames']} frames, 1 of 2")
