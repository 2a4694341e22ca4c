"""Evaluations: which episodes, grouped how, measured as what; tables, figures and page."""

from __future__ import annotations

import csv
import html
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.recording import jigsaws_synthetic
from helpers.recording.evaluated import DONE, episode
from helpers.recording.recording_synthetic import Synthetic
from helpers.recording.restated import edit_field, restate
from surg_recording import metrics
from surg_recording.episode import episode_reader as episodes
from surg_recording.recording_errors import EpisodeError
from surg_recording.reports import (
    evaluation,
    evaluation_figures,
    evaluation_report,
    evaluation_tables,
)
from surg_recording.reports.evaluation import LeftOut

FAILED = {**DONE, "success": False, "reason": "the bowel slipped <away>"}


def quiet(fraction: float, note: str) -> None:
    assert 0.0 <= fraction <= 1.0 and note


def entry(seed: int, **changes: Any) -> dict[str, Any]:
    """An episode as ``measure`` would make it, with numbers drawn by its seed."""
    rng = np.random.default_rng(seed)
    mean, peak = rng.uniform(0.01, 0.04), rng.uniform(0.1, 0.25)
    values = {
        name: {"sparc": -k - mean, "ldlj": -10.0 * k - mean}
        for k, name in enumerate(metrics.PRESETS, start=2)
    }
    found = {
        "folder": f"runs/a_run/episodes/{seed:03d}/episode",
        "task": "bgr",
        "setting": "phantom",
        "robot": "ur5e",
        "law": "ours",
        "source": "simulation",
        "arm": "PSM1",
        "seed": seed,
        "operator": "scripted expert",
        "success": True,
        "outcome": "success",
        "failure_reason": None,
        "judged_by": "task",
        "disagreement": None,
        "duration_s": 10.0 + seed,
        "rcm_kinematic_mm": {"mean": mean, "median": mean, "p95": peak, "max": peak},
        "rcm_true_mm": {"mean": 2 * mean, "median": mean, "p95": peak, "max": 2 * peak},
        "trocar": {"force_n": {"mean": 1.0, "max": 2.0}, "displacement_mm": {"max": 0.2}},
        "smoothness": {"preset": "reference", "presets": values},
        "path_length_mm": {"input": 500.0, "executed": 500.0 + seed},
        "idle": {"s": 0.1 * seed},
        "complete": True,
        "problem": None,
        "state_hash": f"{seed:064x}",
    }
    return {**found, **changes}


def many(count: int, start: int = 0, **changes: Any) -> list[dict[str, Any]]:
    return [entry(seed, **changes) for seed in range(start, start + count)]


def of(entries: list[dict[str, Any]], preset: str = "reference", **more: Any) -> dict[str, Any]:
    left_out, compared = more.get("left_out", []), more.get("compared")
    info = {"versions": {}, "paper_values": more.get("paper_values", False)}
    return evaluation.summarise(entries, left_out, preset, compared, info)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs: four good episodes in two settings, and four that cannot be used."""
    root = tmp_path_factory.mktemp("runs")
    first, second = root / "one" / "episodes", root / "two" / "episodes"
    for seed in (1, 2):
        place = first / f"{seed:03d}" / "episode"
        episode(place, seed, task=DONE if seed == 1 else FAILED, setting="in_vivo")
        place = second / f"{seed:03d}" / "episode"
        episode(place, 10 + seed, task=DONE, setting="phantom")
    bad = root / "bad"
    episode(bad / "again", 1, task=DONE, setting="in_vivo")
    still = Synthetic(seconds=1.0, command="move_cp")
    made = episode(bad / "still", 20, still, task=DONE, setting="phantom")
    table = made / "cycle_PSM1.csv"
    lines = table.read_text().splitlines()
    place = lines[0].split(",").index("command")
    rows = [line.split(",") for line in lines[1:]]
    for row in rows:
        row[place] = "0"
    table.write_text("\n".join([lines[0], *map(",".join, rows)]) + "\n")
    restate(made)
    killed = {"outcome": "incomplete", "reason": "the recorder was killed"}
    episode(bad / "killed", 21, task=DONE, setting="phantom", manifest=killed)
    made = episode(bad / "torn", 22, task=DONE, setting="phantom")
    with open(made / "cycle_PSM1.csv", "a") as file:
        file.write("1,2\n")
    return root


# --- finding ------------------------------------------------------------------------------------


def test_episodes_are_found_at_any_depth_and_once(recorded: Path) -> None:
    found = episodes.find([recorded])
    assert len(found) == 8
    assert episodes.find([recorded, recorded / "one", found[0]]) == found
    assert episodes.find([recorded / "two"]) == [
        recorded / "two" / "episodes" / name / "episode" for name in ("001", "002")
    ]


def test_other_folders_with_a_manifest_are_no_episodes(tmp_path: Path) -> None:
    (tmp_path / "export").mkdir()
    (tmp_path / "export" / "manifest.json").write_text('{"format": "something/1"}')
    with pytest.raises(EpisodeError, match="no episode"):
        episodes.find([tmp_path])
    with pytest.raises(EpisodeError, match="no such folder"):
        episodes.find([tmp_path / "nowhere"])
    # What claims to be one but is broken is not passed over in silence.
    (tmp_path / "torn").mkdir()
    (tmp_path / "torn" / "manifest.json").write_text('{"format": "surg_epi')
    (folder,) = episodes.find([tmp_path])
    entries, (left,) = evaluation.measure_all([folder], None, False, quiet)
    assert entries == [] and "not valid JSON" in left.reason


# --- measuring ----------------------------------------------------------------------------------


def test_the_numbers_are_those_of_the_construction(recorded: Path) -> None:
    entries, left_out = evaluation.measure_all(episodes.find([recorded]), None, False, quiet)
    print([(each.folder, each.reason) for each in left_out])
    reasons = {Path(each.folder).name: each.reason for each in left_out}
    assert "accepted no servo command" in reasons["still"]
    assert "incomplete recording: the recorder was killed" in reasons["killed"]
    assert "2 fields, the header has" in reasons["torn"]
    # Of two recordings of one simulation the first by name is taken, here the one under bad/.
    assert "the same simulation as" in reasons["episode"]
    assert len(entries) == len(left_out) == 4
    by_seed = {e["seed"]: e for e in entries}
    assert set(by_seed) == {1, 2, 11, 12}
    for seed, found in by_seed.items():
        assert found["rcm_kinematic_mm"]["max"] == pytest.approx((10 + seed) * 1e-3, rel=1e-4)
        assert found["rcm_true_mm"]["mean"] == pytest.approx(0.2, rel=1e-4)
        assert found["duration_s"] == pytest.approx(2.0, abs=0.003)
        assert (found["task"], found["robot"], found["source"]) == ("bgr", "ur5e", "simulation")
        assert found["success"] is (seed != 2)
    assert by_seed[2]["failure_reason"] == FAILED["reason"]
    # By hand, from the recorded tip.
    recording = episodes.read(by_seed[11]["folder"])
    truth = recording.ground_truth("PSM1")
    assert truth is not None
    tip = truth.vector("tip")[50:-50]
    mine = metrics.smoothness(tip, 500.0, "paper")
    got = by_seed[11]["smoothness"]["presets"]["paper"]
    assert (got["sparc"], got["ldlj"]) == pytest.approx((mine.sparc, mine.ldlj), abs=1e-6)
    length = metrics.path_length(tip, 500.0, 3.0) * 1e3
    assert by_seed[11]["path_length_mm"]["executed"] == pytest.approx(length, rel=1e-6)


def test_incomplete_ones_come_when_asked_for(recorded: Path) -> None:
    folders = [recorded / "bad" / "killed"]
    (found,), left_out = evaluation.measure_all(folders, None, True, quiet)
    assert left_out == [] and found["complete"] is False
    summary = of([found, entry(3)])
    assert summary["conditions"]["phantom"]["incomplete"] == 1


def test_an_arm_that_is_not_there_is_said(recorded: Path) -> None:
    folder = episodes.find([recorded / "two"])[0]
    with pytest.raises(EpisodeError, match=r"no arm 'PSM9'; there are PSM1"):
        evaluation.measure(episodes.read(folder), "PSM9")


def test_numbers_that_are_none_leave_the_episode_out(tmp_path: Path) -> None:
    made = episode(tmp_path / "e", 1, Synthetic(seconds=1.0), task=DONE, setting="phantom")
    edit_field(made / "ground_truth_PSM1.csv", 300, "tip_x", "")
    restate(made)
    entries, (left,) = evaluation.measure_all([made], None, False, quiet)
    assert (
        entries == [] and "column tip_x: not a number" in left.reason and str(made) in left.reason
    )


def test_a_recording_without_a_simulator(tmp_path: Path) -> None:
    what = Synthetic(seconds=2.0, truth=False)
    made = episode(tmp_path / "e", 1, what, manifest={"sim": None}, setting="phantom")
    found = evaluation.measure(episodes.read(made))
    assert found["source"] == "real" and found["success"] is None
    assert found["rcm_true_mm"] is None
    summary = of([found])
    condition = summary["conditions"]["phantom"]
    assert condition["rcm_true_max_mm"]["n"] == 0 and condition["success_rate"] is None
    evaluation_report.write(summary, tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "not judged" in page and "Simulation," not in page


# --- conditions ---------------------------------------------------------------------------------


def test_conditions_are_named_by_what_tells_them_apart() -> None:
    assert list(of(many(3))["conditions"]) == ["phantom"]
    three = many(2, setting="in_vivo") + many(2, setting="phantom") + many(2, setting="ex_vivo")
    assert list(of(three)["conditions"]) == ["phantom", "ex_vivo", "in_vivo"]
    mixed = [*many(2), *many(2, robot="panda"), *many(2, robot="panda", law="paper")]
    assert list(of(mixed)["conditions"]) == ["panda, ours", "panda, paper", "ur5e, ours"]
    real = [*many(1), *many(1, source="real", setting=None)]
    assert list(of(real)["conditions"]) == ["no setting, real", "phantom, simulation"]
    assert list(of(many(1, setting=None, task="needle"))["conditions"]) == ["needle"]


def test_a_condition_says_how_many_and_how_sure() -> None:
    entries = many(10) + many(5, start=10, setting="in_vivo", success=False, failure_reason="late")
    conditions = of(entries)["conditions"]
    phantom, vivo = conditions["phantom"], conditions["in_vivo"]
    assert (phantom["n"], vivo["n"]) == (10, 5)
    assert phantom["success_rate"] == pytest.approx(
        {"n": 10, "k": 10, "low": 0.72247, "high": 1.0}, abs=1e-5
    )
    means = sorted(e["rcm_kinematic_mm"]["mean"] for e in entries[:10])
    found = phantom["rcm_kinematic_mean_mm"]
    assert found["median"] == pytest.approx(np.median(means))
    assert found["interval"] == [means[1], means[8]]
    assert found["quartiles"] == pytest.approx(np.percentile(means, (25, 75)).tolist())
    assert vivo["rcm_kinematic_mean_mm"]["interval"] is None  # five are too few


@pytest.mark.parametrize("preset", list(metrics.PRESETS))
def test_one_evaluation_has_one_preset(preset: str, tmp_path: Path) -> None:
    entries = many(4)
    summary = of(entries, preset)
    values = [e["smoothness"]["presets"][preset]["ldlj"] for e in entries]
    assert summary["conditions"]["phantom"]["ldlj"]["median"] == np.median(values)
    assert summary["preset"] == metrics.PRESETS[preset].parameters()
    figure = evaluation_figures.smoothness(summary)
    drawn = [
        y for line in figure.axes[1].lines if line.get_marker() == "o" for y in line.get_ydata()
    ]
    assert sorted(drawn) == sorted(values)
    label = figure.get_supxlabel() if hasattr(figure, "get_supxlabel") else ""
    texts = label + " ".join(text.get_text() for text in figure.texts)
    assert metrics.PRESETS[preset].label() in texts.replace("\n", " ") and "Simulation" in texts
    evaluation_report.write(summary, tmp_path)
    page = html.unescape((tmp_path / "report.html").read_text("utf-8"))
    assert f"preset {preset}:" in page
    for other in set(metrics.PRESETS) - {preset}:
        assert f"preset {other}" not in page
        assert f"preset {other}" not in (tmp_path / "tables" / "conditions.tex").read_text()


# --- what is written ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    root = tmp_path_factory.mktemp("evaluation")
    skills = {"B001": "N", "C001": "I", "D001": "E", "D002": "E"}
    task = jigsaws_synthetic.write_task(root, skills)
    (task / "kinematics" / "AllGestures" / "Knot_Tying_I001.txt").write_text("")
    compared = evaluation.compare(f"jigsaws:{task}", "reference", quiet)
    entries = many(10) + many(7, start=20, setting="in_vivo")
    entries[3].update(success=False, failure_reason="<b>50 % & more</b>")
    left_out = [LeftOut("runs/x", "runs/x: <torn>")]
    summary = of(entries, compared=compared, left_out=left_out)
    evaluation_report.write(summary, root / "out")
    return summary, root / "out"


def test_the_page_is_whole_and_safe(written: tuple[dict[str, Any], Path]) -> None:
    _, out = written
    page = (out / "report.html").read_text("utf-8")
    assert page.count("data:image/png;base64,") == len(evaluation_figures.FIGURES)
    assert not re.search(r"(src|href)=[\"'](?!data:)", page)
    assert "<b>50" not in page and "<torn>" not in page
    assert "&lt;torn&gt;" in page and "9 of 10 (95 % interval" in page
    assert "JIGSAWS Knot Tying" in page and "Knot_Tying_I001" in page
    assert "Simulation, Bowel grasping and retraction, UR5e, law ours" in page
    names = {f"{name}.{kind}" for name in evaluation_figures.FIGURES for kind in ("png", "svg")}
    assert {file.name for file in (out / "figures").iterdir()} == names
    found = json.loads((out / "summary.json").read_text("utf-8"))
    assert set(found["conditions"]) == {"phantom", "in_vivo"}
    assert found["reference"]["trials"] == 4
    for name in ("sparc", "ldlj"):
        assert found["reference"][name]["median"] < 0 < found["reference"][name]["iqr"]
    assert found["left_out"] == [{"folder": "runs/x", "reason": "runs/x: <torn>"}]
    assert len(found["reference"]["left_out"]) == 1


def test_the_tables_hold_the_summary_s_numbers(written: tuple[dict[str, Any], Path]) -> None:
    summary, out = written
    with open(out / "tables" / "episodes.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 17
    assert [float(row["rcm_kinematic_max_mm"]) for row in rows] == [
        e["rcm_kinematic_mm"]["max"] for e in summary["episodes"]
    ]
    assert {row["preset"] for row in rows} == {"reference"}
    with open(out / "tables" / "conditions.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    names = ["JIGSAWS Knot Tying" + end for end in ("", ", novice", ", intermediate", ", expert")]
    assert [row["condition"] for row in rows] == ["phantom", "in_vivo", *names]
    for row in rows[:2]:
        found = summary["conditions"][row["condition"]]
        for metric in evaluation.METRICS:
            value = found[metric.name]
            parts = dict(zip(("q1", "q3"), value["quartiles"], strict=True))
            parts.update(zip(("low", "high"), value["interval"], strict=True))
            parts.update({key: value[key] for key in ("n", "min", "median", "max")})
            for part, expected in parts.items():
                assert float(row[f"{metric.name}_{part}"]) == expected, (metric.name, part)
        assert int(row["n"]) == found["n"]
    assert rows[0]["successes"] == "9" and rows[2]["successes"] == ""
    assert float(rows[2]["ldlj_median"]) == summary["reference"]["ldlj"]["median"]
    assert rows[5]["n"] == "2" and rows[5]["sparc_low"] == ""


def test_the_latex_table_is_one(written: tuple[dict[str, Any], Path]) -> None:
    _, out = written
    text = (out / "tables" / "conditions.tex").read_text()
    body = [line for line in text.splitlines() if line.endswith(r"\\")]
    columns = 3 + len(evaluation_tables.LATEX)
    assert all(line.count(" & ") == columns - 1 for line in body) and len(body) == 1 + 2 + 4
    assert re.search(rf"\\begin{{tabular}}{{l[r]{{{columns - 1}}}}}", text)
    assert r"in\_vivo" in text and text.count("$") % 2 == 0
    assert text.startswith("% simulation;") and r"success [\%]" in text
    assert evaluation_tables.escape("a_b & 5% {x}~\\^") == (
        r"a\_b \& 5\% \{x\}\textasciitilde{}\textbackslash{}\textasciicircum{}"
    )
    page = (out / "tables" / "conditions.md").read_text().splitlines()
    assert {line.count("|") for line in page} == {1 + 1 + 2 + 4}


def test_a_box_per_condition_and_the_reference_apart(
    written: tuple[dict[str, Any], Path],
) -> None:
    summary, _ = written
    figure = evaluation_figures.smoothness(summary)
    axes = figure.axes[0]
    labels = [tick.get_text() for tick in axes.get_xticklabels()]
    assert labels == [
        "phantom\nn = 10", "in vivo\nn = 7",
        "JIGSAWS\nKnot Tying\nn = 4", "JIGSAWS\nKnot Tying\nexperts\nn = 2",
    ]  # fmt: skip
    dots = [line.get_ydata() for line in axes.lines if line.get_marker() == "o"]
    assert [len(line) for line in dots] == [10, 7, 4, 2]
    medians = [summary["conditions"][name]["sparc"]["median"] for name in ("phantom", "in_vivo")]
    medians.append(summary["reference"]["sparc"]["median"])
    assert [float(np.median(line)) for line in dots[:3]] == pytest.approx(medians)
    deviation = evaluation_figures.deviation(summary)
    heights = [line.get_ydata() for line in deviation.axes[1].lines if line.get_marker() == "o"]
    assert sorted(len(line) for line in heights if len(line)) == [7, 7, 10, 10]
    words = [text.get_text() for text in deviation.axes[0].get_legend().get_texts()]
    assert words == ["mean", "max"]
    titles = [axes.get_title() for axes in deviation.axes]
    assert titles == ["RCM deviation, kinematic", "RCM deviation, true"]


def test_figures_for_print(tmp_path: Path) -> None:
    """One value is no box, no dot is cut, every axis has its unit, small print fits."""
    summary = of([*many(6), *many(1, 50, setting="ex_vivo")], "paper", paper_values=True)
    for name, (_, _, draw) in evaluation_figures.FIGURES.items():
        figure = draw(summary)
        figure.savefig(tmp_path / f"{name}.png")
        for axes in figure.axes:
            assert re.search(r"\[(mm|s|–)\]", axes.get_ylabel()), axes.get_ylabel()
            dots = [
                line for line in axes.lines if line.get_marker() == "o" and len(line.get_ydata())
            ]
            assert all(not line.get_clip_on() for line in dots)
            of_one = [line for line in dots if len(line.get_ydata()) == 1]
            assert of_one and len(axes.patches) == len(dots) - len(of_one)
            low, high = sorted(axes.get_ylim())
            for line in axes.lines:
                assert all(low <= y <= high for y in line.get_ydata()), name
        for text in figure.texts:
            box = text.get_window_extent()
            assert box.x0 >= 0 and box.x1 <= figure.bbox.width and box.y0 >= 0


def test_published_values_are_marked_where_asked_for() -> None:
    entries = [*many(3), *many(3, 50, setting="ex_vivo")]

    def marks(draw: Any, summary: Any) -> list[float]:
        lines = draw(summary).axes[0].lines
        return [float(y) for line in lines if line.get_marker() == "D" for y in line.get_ydata()]

    asked = of(entries, "paper", paper_values=True)
    assert marks(evaluation_figures.deviation, asked) == [0.035, 0.052]
    assert marks(evaluation_figures.smoothness, asked) == [-2.0, -2.0]
    other_preset = of(entries, paper_values=True)
    assert marks(evaluation_figures.deviation, other_preset) == [0.035, 0.052]
    assert marks(evaluation_figures.smoothness, other_preset) == []
    assert marks(evaluation_figures.deviation, of(entries, "paper")) == []
    other_task = of([{**entry, "task": "knots"} for entry in entries], "paper", paper_values=True)
    assert marks(evaluation_figures.deviation, other_task) == []


def test_the_same_episodes_make_the_same_files(tmp_path: Path) -> None:
    for name in ("a", "b"):
        evaluation_report.write(of(many(6)), tmp_path / name)
    files = sorted(f.relative_to(tmp_path / "a") for f in (tmp_path / "a").rglob("*.*"))
    assert len(files) == 2 + 4 + 2 * len(evaluation_figures.FIGURES)
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes(), file


def test_nothing_at_all_still_has_a_page(tmp_path: Path) -> None:
    summary = of([], left_out=[LeftOut("x", "x: no motion")])
    evaluation_report.write(summary, tmp_path)
    page = (tmp_path / "report.html").read_text("utf-8")
    assert "No episode could be evaluated" in page and "x: no motion" in page
