"""Why did it fail? One figure and one sentence for every roll-out without a success."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from helpers.recording.recording_synthetic import Synthetic, path, record
from surg_recording.episode import episode_reader
from surg_recording.reports import failure_figure, trial_report, trials
from surg_recording.reports.trials import TrialOutcome

WHY = "time limit of 45 s in phase 'grasp'"


def test_every_roll_out_without_a_success_has_a_figure_and_a_sentence(tmp_path: Path) -> None:
    """Failed, aborted, crashed: three pictures; crashed before it began: a sentence."""
    ended = [
        TrialOutcome(False, WHY, "grasp", 45.0, True, "failure"),
        TrialOutcome(None, "the node sim has ended", "point", 1.25, False, "aborted"),
        TrialOutcome(None, "Traceback\n…\nValueError: no", "grasp", 3.0, False, "crashed"),
        TrialOutcome(None, "no such file", "", 0.0, False, "crashed"),
        TrialOutcome(True, "", "done", 12.0, True, "success"),
    ]
    entries = [trials.describe(k, "phantom", "ours", end, None) for k, end in enumerate(ended)]
    made = record(tmp_path / "made", Synthetic(seconds=0.5, refused_from=0.4))
    for k in (0, 1, 2, 4):
        entries[k]["folder"] = f"episodes/{k:03d}"
        shutil.copytree(made, tmp_path / f"episodes/{k:03d}/episode")
    trial_report.write(trials.summarise(entries, {"task": "bgr", "robot": "ur5e"}), tmp_path)
    drawn = sorted(file.name for file in (tmp_path / "figures").glob("failure_*"))
    assert drawn == [f"failure_{k:03d}.png" for k in (0, 1, 2)]
    page = (tmp_path / "report.html").read_text("utf-8")
    for sentence in (
        "Episode 0: failure after 45.0 s: time limit of 45 s in phase",
        "Episode 1: aborted after 1.2 s in phase",
        "Traceback ValueError: no.",
        "Episode 3: crashed after 0.0 s: no such file.",
    ):
        assert sentence in page
    assert "Episode 4: " not in page and page.count("Nothing that could be drawn") == 1


def test_it_shows_command_set_point_tip_and_each_refusal(tmp_path: Path) -> None:
    """What the axes hold is the path that was made up, and the refused samples are marked."""
    folder = record(tmp_path / "episode", Synthetic(seconds=1.0, lag_s=0.1, refused_from=0.8))
    figure = failure_figure.draw(episode_reader.read(folder))
    x, _, _, jaw = figure.axes
    lines = {line.get_label(): line for line in x.lines}
    assert set(lines) == {"command", "set-point", "tip", "refused: 201"}
    t = np.asarray(lines["command"].get_xdata())
    begin = path(0.002 - 0.1)[0]
    wanted = [1e3 * (path(at + 0.002)[0] - begin) for at in t]
    np.testing.assert_allclose(lines["command"].get_ydata(), wanted, atol=1e-6)
    late = [1e3 * (path(min(at + 0.002 - 0.1, 0.8))[0] - begin) for at in t]
    np.testing.assert_allclose(lines["tip"].get_ydata(), late, atol=1e-6)
    assert jaw.lines[0].get_ydata()[-1] == pytest.approx(np.degrees(0.1))
