"""Many episodes together: the success interval, the summary, the plots and the page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import escape
from matplotlib.lines import Line2D

from surg_recording.reports import trial_figures, trial_report, trials
from surg_recording.reports.trials import TrialOutcome


def entry(seed: int, **changes: Any) -> dict[str, Any]:
    """An episode as ``describe`` would make it, with numbers drawn by its seed."""
    rng = np.random.default_rng(seed)
    mean, peak, force = rng.uniform(0.01, 0.04), rng.uniform(0.1, 0.25), rng.uniform(1, 5)
    found = trials.describe(seed, "phantom", "ours", TrialOutcome(True, "", "done", 12.0), None)
    found.update(
        rcm_kinematic_mm={"mean": mean, "median": mean, "p95": peak, "max": peak},
        rcm_true_mm={"mean": 2 * mean, "median": mean, "p95": peak, "max": 2 * peak},
        trocar={
            "force_n": {"mean": force / 2, "max": force},
            "displacement_mm": {"mean": 0.1, "max": 0.2},
        },
        smoothness={"preset": "reference", "sparc": -2.0 - mean, "ldlj": -8.0 - mean},
        state_hash=f"{seed:064x}",
    )
    return {**found, **changes}


INFO = {"task": "bgr", "robot": "ur5e"}


# --- the summary --------------------------------------------------------------------------------


def test_the_summary_counts_by_condition() -> None:
    episodes = [entry(s) for s in range(6)]
    episodes += [entry(s, setting="in_vivo") for s in range(4)]
    episodes += [
        entry(9, setting="in_vivo", success=False, failure_reason="the robot lost its grasp")
    ]
    summary = trials.summarise(episodes, INFO)
    assert summary["ok"] is True and summary["reasons"] == []
    assert summary["setting"] == ["phantom", "in_vivo"]
    assert summary["task"] == "bgr"
    assert (summary["success_rate"]["n"], summary["success_rate"]["k"]) == (11, 10)
    phantom, vivo = summary["conditions"]
    assert (phantom["success_rate"]["k"], vivo["success_rate"]["k"]) == (6, 4)
    means = [e["rcm_kinematic_mm"]["mean"] for e in episodes[:6]]
    assert phantom["rcm_kinematic_mm"]["mean"] == {
        "n": 6,
        "min": min(means),
        "median": float(np.median(means)),
        "max": max(means),
    }
    assert [b["value"] for b in phantom["bounds"]] == [0.05, 0.3]
    assert [b["value"] for b in vivo["bounds"]] == [1.0]
    assert all(b["met"] for c in summary["conditions"] for b in c["bounds"])


def test_one_bad_episode_misses_a_bound() -> None:
    bad = {"mean": 0.06, "median": 0.06, "p95": 0.2, "max": 0.31}
    summary = trials.summarise([entry(1), entry(2, rcm_kinematic_mm=bad)], INFO)
    assert [b["met"] for b in summary["conditions"][0]["bounds"]] == [False, False]
    assert summary["setting"] == "phantom"


def test_an_episode_that_was_not_played_is_a_failed_run() -> None:
    broken = TrialOutcome(False, "node /sim ended (1)", "grasp", 3.0, played=False)
    episodes = [entry(1), trials.describe(2, "phantom", "ours", broken, None)]
    summary = trials.summarise(episodes, INFO)
    assert summary["ok"] is False
    assert summary["reasons"] == ["episode 1 (seed 2, phantom): node /sim ended (1)"]
    assert summary["success_rate"]["k"] == 1 and summary["success_rate"]["n"] == 2
    assert summary["conditions"][0]["rcm_kinematic_mm"]["max"]["n"] == 1
    assert episodes[1]["rcm_kinematic_mm"] is None


def test_no_deviation_meets_no_bound(tmp_path: Path) -> None:
    still = trials.describe(2, "phantom", "ours", TrialOutcome(False, "late", "point", 45.0), None)
    summary = trials.summarise([still], INFO)
    assert [b["met"] for b in summary["conditions"][0]["bounds"]] == [False, False]
    trial_report.write(summary, tmp_path)
    page = (tmp_path / "report.html").read_text("utf-8")
    assert "0 of 1" in page and 'class="verdict' not in page, "no bar, above all no green one"


# --- plots and page -----------------------------------------------------------------------------


def test_a_box_shows_the_quartiles_of_its_episodes() -> None:
    episodes = [entry(s) for s in range(20)] + [entry(s, setting="ex_vivo") for s in range(7)]
    summary = trials.summarise(episodes, INFO)
    groups = trial_figures.grouped(summary)
    figure = trial_figures.deviation(groups, summary)
    axes = figure.axes[0]
    labels = [tick.get_text() for tick in axes.get_xticklabels()]
    assert labels == ["phantom\nn = 20", "ex vivo\nn = 7"]
    assert "kinematic" in axes.get_title()
    for i, (_, entries) in enumerate(groups):
        kinematic = np.array(trials.values(entries, "rcm_kinematic_mm", "max"))
        lines = [line for line in axes.lines if near(line, i + 0.175)]
        heights = {round(float(y), 9) for line in lines for y in line.get_ydata()}
        quartiles = np.percentile(kinematic, (25, 50, 75))
        assert round(float(quartiles[1]), 9) in heights
        boxes = [p.get_path().vertices[:, 1] for p in axes.patches]
        assert any(np.isclose(b.min(), quartiles[0]) & np.isclose(b.max(), quartiles[2])
                   for b in boxes)  # fmt: skip
    dots = sum(len(line.get_ydata()) for line in axes.lines if line.get_marker() == "o")
    assert dots == 2 * 27 + 0  # every episode once per series; the legend's dots hold none


def near(line: Line2D, x: float) -> bool:
    data = np.asarray(line.get_xdata(), dtype=float)
    return len(data) > 0 and abs(float(data.mean()) - x) < 0.12


def test_the_page_names_every_failure_and_escapes_it(tmp_path: Path) -> None:
    reason = "<script>lost & 'gone'</script>"
    episodes = [
        entry(1, folder="episodes/000"),
        entry(2, success=False, failure_reason=reason, law="paper"),
        trials.describe(3, "phantom", "ours", TrialOutcome(False, "boom", "", 0.0, False), None),
    ]
    trial_report.write(trials.summarise(episodes, INFO), tmp_path)
    page = (tmp_path / "report.html").read_text("utf-8")
    assert reason not in page and str(escape(reason)) in page
    assert "1 of 3 (95 % interval 6.1 to 79.2 %) succeeded" in page
    assert "episodes/000/report.html" in page and "boom" in page
    assert 'src="data:image/png;base64,' in page and '<img src="http' not in page
    written = json.loads((tmp_path / "summary.json").read_text("utf-8"))
    assert [e["seed"] for e in written["episodes"]] == [1, 2, 3]
    assert {f.name for f in (tmp_path / "figures").iterdir()} == {
        f"{name}.png" for name in trial_figures.FIGURES
    }


def test_a_run_without_any_measurement_has_a_page(tmp_path: Path) -> None:
    broken = TrialOutcome(False, "no graph", "", 0.0, played=False)
    episodes = [trials.describe(1, "phantom", "ours", broken, None)]
    trial_report.write(trials.summarise(episodes, INFO), tmp_path)
    page = (tmp_path / "report.html").read_text("utf-8")
    assert (
        "no graph" in page
        and page.count(": not measured") == 2
        and "missed" not in page.partition("</style>")[2]
    )
