"""The figures of docs/results/phantom.md, and the arithmetic they are made with."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from surg_core.wilson import wilson_interval
from surg_sim import tasks
from surg_sim.envs import expert_evaluation
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
