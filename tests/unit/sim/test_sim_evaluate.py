"""The figures of docs/results/phantom.md, and the arithmetic they are made with."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest

from surg_core.wilson import wilson_interval
from surg_sim import tasks
from surg_sim.envs import expert_evaluation, rows_of_page
from surg_sim.envs.episode_runner import ArmReport, EpisodeReport, Spread
from surg_sim.physics.patient_settings import SETTINGS, find_setting
from surg_sim.physics.trocar import TrocarParameters


@pytest.mark.parametrize("name", SETTINGS)
def test_each_disturbance_alone_is_the_setting_s_own(name: str) -> None:
    setting = find_setting(name)
    rows = expert_evaluation.alone(setting)
    none = rows["nothing but the drives"]
    assert (none.tool_error, none.encoder, none.breathing.amplitude) == (None, 0.0, 0.0)
    assert none.actuators == setting.actuators
    assert rows["calibration error"].tool_error == setting.tool_error
    assert rows["encoder"].encoder == setting.encoder
    assert rows["wall"].trocar == TrocarParameters(
        setting.trocar.stiffness, setting.trocar.mass, setting.trocar.damping_ratio, 0.0
    )
    both = rows["all together"]
    assert (both.trocar, both.breathing, both.encoder) == (
        setting.trocar,
        setting.breathing,
        setting.encoder,
    )


def report(seed: int, reason: str) -> EpisodeReport:
    spread = Spread(1e-6, 2e-6)
    arm = ArmReport(spread, spread, spread, spread)
    return EpisodeReport(seed, not reason, reason, 10.0, 0.0, {"PSM1": arm}, "00")


def test_failures_are_listed_with_cause_and_seeds() -> None:
    done = [report(1, ""), report(2, "late"), report(5, "late"), report(7, "lost")]
    assert expert_evaluation.failures([("bgr", done)]) == [
        "- bgr: 2 × late (seeds 2, 5)",
        "- bgr: 1 × lost (seeds 7)",
    ]
    assert expert_evaluation.failures([("bgr", done[:1])]) == ["None."]


def page(tasks_of_page: dict[str, list[EpisodeReport]], second: bool) -> str:
    setting = find_setting("phantom")

    def of(label: str) -> expert_evaluation.Series:
        return expert_evaluation.Series(label, "", label.split(",")[0], setting, "ours", ())

    first = [(of(label), done) for label, done in tasks_of_page.items()]
    rest = [(replace(of("phantom: wall"), task="bgr", seeds=(1,)), [report(1, "late")])]
    return expert_evaluation.report(first, rest if second else [], "make all")


@pytest.mark.parametrize("second", [True, False])
def test_rows_put_into_a_page_are_those_of_a_page_made_at_once(second: bool) -> None:
    good, bad = [report(1, "")], [report(1, ""), report(2, "late")]
    both = {
        "bgr, UR5e, phantom": bad,
        "needle_driving, UR5e, phantom": bad,
        "needle_driving, Panda, phantom": good,
        "pick_and_place, UR5e, phantom": good,
    }
    old = {k: v for k, v in both.items() if "needle" not in k}
    whole, text = page(both, second).splitlines(), page(old, second)

    def put(text: str, labels: list[str], done: list[EpisodeReport], command: str) -> str:
        lines = page(dict.fromkeys(labels, done), False).splitlines()
        short = [label.removesuffix(", phantom") for label in labels]
        rows = {label: next(x for x in lines if x.startswith(f"| {label} ")) for label in short}
        causes = expert_evaluation.failures((label, done) for label in labels)
        return rows_of_page.put(text, rows, causes, command)

    needles = [label for label in both if "needle" in label]
    text = put(text, needles, bad, "make needles")
    text = put(text, needles[1:], good, "make Panda")  # again: nothing of the row before is left
    added = [line for line in text.splitlines() if line not in whole]
    assert added == [
        "- Rows of needle_driving with UR5e: by `make needles`",
        "- Rows of needle_driving with Panda: by `make Panda`",
    ]
    left = [line for line in text.splitlines() if line not in added]
    # A list of commands has a line of space round it.
    assert [line for line in left if line] == [line for line in whole if line]


def test_rows_go_into_such_a_page_only(tmp_path: Path) -> None:
    other = tmp_path / "other.md"
    other.write_text("# Another page\n")
    for name in ("other.md", "none.md"):
        words = ["--episodes", "1", "--ablation", "0", "--update", str(tmp_path / name)]
        assert expert_evaluation.main(words) == 2
    assert other.read_text() == "# Another page\n"
    with pytest.raises(SystemExit):
        expert_evaluation.main(["--update", str(other)])


@pytest.mark.full
def test_every_task_in_every_setting(tmp_path: Path) -> None:
    """Writes docs/results/phantom.md; about an hour on two cores."""
    folder = Path(os.environ.get("SURG_RESULTS_DIR", "") or tmp_path)
    first, second = expert_evaluation.plan(100, 10, expert_evaluation.ROBOTS, tasks.names())
    results = expert_evaluation.run_all([*first, *second], jobs=2)
    n = len(first)
    text = expert_evaluation.report(
        list(zip(first, results[:n], strict=True)),
        list(zip(second, results[n:], strict=True)),
        "./surg test --full tests/unit/sim/test_sim_evaluate.py",
    )
    (folder / "phantom.md").write_text(text, encoding="utf-8")
    for series, reports in zip(first, results, strict=False):
        good = sum(report.success for report in reports)
        arms = [report.arms[tasks.load(series.task).commanded[0]] for report in reports]
        if "UR5e" in series.label:
            assert wilson_interval(good, len(reports))[0] >= 0.9, series.label
        assert max(arm.kinematic.max for arm in arms) < 1e-3, series.label
        if series.condition.name == "phantom":
            assert max(arm.kinematic.mean for arm in arms) < 0.05e-3, series.label
            assert max(arm.kinematic.max for arm in arms) < 0.3e-3, series.label
