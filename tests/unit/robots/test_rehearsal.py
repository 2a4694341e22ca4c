"""The rehearsal of an arm's stops: what passes, what does not, what comes next, the report."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

import surg_core
from surg_cli.host import paths
from surg_cli.robots import rehearsal, rehearse_stop
from surg_cli.robots.rehearsal import STEPS, RehearsalOutcome, RehearsalStep, Trace

DT, EVENT = 0.002, 1.0
BY_NAME = {step.name: step for step in STEPS}
ESTOP = BY_NAME["emergency stop"]


def trace(
    rest_ms: float = 60.0,
    off_mm: float = 0.1,
    condition: str = "ESTOP",
    reason: str = "robot",
    again: bool = False,
    ends: float = 3.0,
) -> Trace:
    """An arm that moves until the event, is at rest some time later, and may move once more."""
    times = [DT * n for n in range(round(ends / DT))]
    speeds = [
        0.05 if time < EVENT + 1e-3 * rest_ms or (again and time > EVENT + 1.0) else 0.0
        for time in times
    ]
    deviations = [1e-3 * off_mm if time > EVENT else 2e-5 for time in times]
    return Trace(times, speeds, deviations, condition, reason)


def judged(step: RehearsalStep, found: Trace) -> RehearsalOutcome:
    return rehearsal.judge(step, EVENT, found, "2026-11-23", "77")


def test_a_stop_within_the_bounds_passes_with_its_figures() -> None:
    outcome = judged(ESTOP, trace())
    assert outcome.problems == ()
    assert outcome.to_rest == pytest.approx(0.06, abs=2 * DT)
    assert outcome.deviation == pytest.approx(1e-4)


@pytest.mark.parametrize(
    ("found", "word"),
    [
        (trace(rest_ms=130.0), "at rest after 130 ms"),
        (trace(off_mm=0.21), "0.21 mm off"),
        (trace(condition="ACTIVE"), "ACTIVE"),
        (trace(reason=""), "FAULT"),
        (trace(reason="rcm_error"), "rcm_error"),
        (trace(again=True), "moved again"),
        (trace(rest_ms=5000.0), "did not come to rest"),
    ],
)
def test_a_stop_that_is_not_as_it_must_be_says_why(found: Trace, word: str) -> None:
    (problem,) = judged(ESTOP, found).problems
    assert word in problem


def test_a_machine_that_hears_late_does_not_make_a_stop_longer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The arm rests 60 ms after the stop; states and status come 300 ms late, all at once."""
    ours = {"now": 0.0}
    monkeypatch.setattr(rehearse_stop.time, "monotonic", lambda: ours["now"])
    record, arm = rehearse_stop.Record(), trace()
    stopped = False
    for n, stamp in enumerate(arm.times):
        ours["now"] = stamp if stamp < EVENT else max(stamp, EVENT + 0.3)
        record.state(stamp, [0.0] * 6, [arm.speeds[n]] * 6)
        stopped = stopped or stamp >= EVENT
        record.status(stamp, not stopped)
    assert record.stopped_at is not None
    times, _, speeds = record.since(record.stopped_at - 0.1)
    found = Trace(times, speeds, [0.0] * len(times), "ESTOP", "robot")
    outcome = rehearsal.judge(ESTOP, record.stopped_at, found, "2026-11-23", "77")
    assert outcome.problems == ()
    assert outcome.to_rest == pytest.approx(0.06, abs=2 * DT)
    assert not record.silent
    ours["now"] += 2 * rehearse_stop.GONE_S
    assert record.silent


def test_an_arm_that_stood_still_has_rehearsed_nothing() -> None:
    found = trace(rest_ms=-1000.0)
    (problem,) = judged(ESTOP, found).problems
    assert "stood still" in problem


def test_a_pulled_cable_leaves_the_way_to_rest_unmeasured() -> None:
    found = trace(rest_ms=5000.0, condition="OFFLINE", reason="link", ends=EVENT + 0.01)
    outcome = judged(BY_NAME["unplugged cable"], found)
    assert outcome.problems == () and math.isnan(outcome.to_rest)


def test_a_driver_that_is_started_again_has_not_seen_the_arm_come_to_rest() -> None:
    found = trace(condition="READY", reason="link")
    seen = [n for n, time in enumerate(found.times) if not EVENT < time < EVENT + 0.8]
    again = Trace(
        *([values[n] for n in seen] for values in (found.times, found.speeds, found.deviations)),
        found.condition,
        found.reason,
    )
    outcome = judged(BY_NAME["driver killed"], again)
    assert outcome.problems == () and math.isnan(outcome.to_rest)
    assert outcome.deviation == pytest.approx(1e-4)


def test_every_expected_reason_is_one_of_the_controllers() -> None:
    named = [getattr(surg_core.Reason, name) for name in dir(surg_core.Reason) if name.isupper()]
    names = {surg_core.reason_name(each) for each in named}
    assert {step.reason for step in STEPS} - {""} <= names


def test_each_stop_is_led_through_until_this_arm_has_passed_it(tmp_path: Path) -> None:
    file = tmp_path / "rehearsal_PSM1.jsonl"
    done = []
    while (step := rehearsal.next_step(rehearsal.load(file), "77")) is not None:
        done.append(step.name)
        failed = RehearsalOutcome(step.name, "2026-11-23", "77", 0.2, 0.0, "", "", ("too late",))
        rehearsal.append(file, failed)
        assert rehearsal.next_step(rehearsal.load(file), "77") == step, "a failure is repeated"
        rehearsal.append(
            file, RehearsalOutcome(step.name, "2026-11-23", "77", math.nan, 0.0, "READY", "", ())
        )
    assert done == [step.name for step in STEPS]
    assert rehearsal.next_step(rehearsal.load(file), "78") == STEPS[0], "another arm begins anew"
    page = rehearsal.report(rehearsal.load(file), "PSM1 of lab")
    assert page.count("| passed |") == len(STEPS) and "not measured" in page
    assert "missing" in rehearsal.report({}, "PSM1 of lab")


def test_the_page_on_the_first_power_on_has_every_stop() -> None:
    page = (paths.ROOT / "docs" / "guide" / "link_ur.md").read_text("utf-8")
    assert [step.name for step in STEPS if step.name not in page] == []
    assert f"{1e3 * rehearsal.REST_S:.0f} ms" in page
    assert f"{1e3 * rehearsal.PIVOT_M:.1f} mm" in page
