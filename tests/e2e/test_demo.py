"""The main job, end to end: operator, RCM nodelet, MuJoCo bridge, held to what the README says.

Reduced: the first seconds of the bundled motion on a few combinations. Full (`./surg test --full`):
the whole motion on all of them, and their rows in docs/results/main_job.md are written anew. Set
SURG_TEST_MOTION to a CSV of your own to have it played as well.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from conftest import FULL
from helpers.control.third_arm import write_third_arm
from helpers.graph import socket_jitter
from helpers.graph.surg import surg
from surg_cli.host.paths import ROOT

pytestmark = [pytest.mark.ros, pytest.mark.untimed]

SECONDS = None if FULL else 2.0
SHORT_S = 2.0
DEMO_TIMEOUT_S = 900
MOTIONS = {"bundled": None}
if os.environ.get("SURG_TEST_MOTION"):
    MOTIONS["given"] = os.environ["SURG_TEST_MOTION"]
ROWS: list[tuple[str, dict[str, Any]]] = []


@pytest.fixture(scope="module", autouse=True)
def results_page() -> Iterator[None]:
    """Write the figures of a full run to docs/results/main_job.md."""
    ROWS.clear()
    yield
    if FULL and ROWS:
        page = ROOT / "docs" / "results" / "main_job.md"
        before = page.read_text("utf-8") if page.exists() else ""
        page.parent.mkdir(parents=True, exist_ok=True)
        page.write_text(render(ROWS, before), encoding="utf-8")


HEAD = """\
# The main job: measured

Written by `SURG_TEST_MOTION=FILE ./surg test --full tests/e2e/test_demo.py`. Whole motions at scale
1 in lock-step; definitions in [conventions](../reference/conventions.md). Deviations, tip error,
displacement: mm; lag: ms.

| run | RCM kinematic mean / max | RCM true max | tip rms / max | lag | path in → out \
| sweep | enabled, unscaled | trocar force max, displacement max | compute p99 |
|---|---|---|---|---|---|---|---|---|---|
"""


def render(rows: list[tuple[str, dict[str, Any]]], before: str) -> str:
    """The page as Markdown; what the page of before says of other runs, and its notes, stay."""
    lines = before.splitlines()
    table = [i for i, line in enumerate(lines) if line.startswith("|")]
    kept = {lines[i].split(" | ")[0].removeprefix("| "): lines[i] for i in table[2:]}
    kept.update({name: row(name, summary) for name, summary in rows})
    notes = lines[table[-1] + 1 :] if table else []
    return HEAD + "".join(f"{line}\n" for line in (*kept.values(), *notes))


def row(name: str, s: dict[str, Any]) -> str:
    """A line of the table."""
    rcm, true, tip = s["rcm_kinematic_mm"], s["rcm_true_mm"], s["tip_error_mm"]
    path, trocar = s["path_length_mm"], s["trocar"]
    return (
        f"| {name} | {rcm['mean']:.4f} / {rcm['max']:.3f} | {true['max']:.3f} "
        f"| {tip['rms']:.3f} / {tip['max']:.2f} | {s['tip_lag_ms']:.1f} "
        f"| {path['input']:.0f} → {path['executed']:.0f} "
        f"({100 * (path['executed'] / path['input'] - 1):+.1f} %) "
        f"| {s['shaft_sweep_deg']:.1f}° "
        f"| {100 * s['enabled_fraction']:.1f} %, {100 * s['unscaled_fraction']:.2f} % "
        f"| {trocar['force_n']['max']:.2f} N, {trocar['displacement_mm']['max']:.2f} "
        f"| {s['controller']['compute_us']['p99']:.0f} µs |"
    )


def demo(
    out: Path, *options: object, env: dict[str, str] | None = None, video: bool = False
) -> dict[str, Any]:
    """Run `./surg demo`; its summary, with the exit status added."""
    argv = ["demo", "--out", out, *options]
    if not video:
        argv.append("--no-video")
    if SECONDS is not None and "--duration" not in options:
        argv += ["--duration", SECONDS]
    done = surg(*argv, timeout_s=DEMO_TIMEOUT_S, extra=env)
    assert done.stdout.strip(), done.stderr
    last = done.stdout.strip().splitlines()[-1]
    assert last == str(out / "summary.json"), done.stdout + done.stderr
    summary: dict[str, Any] = json.loads(Path(last).read_text())
    summary["exit"] = done.returncode
    return summary


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The UR5e's short motion; reduced, one run serves two tests."""
    return demo(tmp_path_factory.mktemp("plain") / "run", "--duration", SHORT_S)


def note(name: str, summary: dict[str, Any]) -> None:
    ROWS.append((name, summary))
    rcm, tip = summary["rcm_kinematic_mm"], summary["tip_error_mm"]
    print(f"{name}: RCM mean {rcm['mean']:.4f} max {rcm['max']:.3f}, tip rms {tip['rms']:.3f} mm")


def assert_within_limits(summary: dict[str, Any]) -> None:
    """The Shows: first that the motion was really made, then that the pivot was kept."""
    path = summary["path_length_mm"]
    assert abs(path["executed"] / path["input"] - 1) <= 0.03
    if SECONDS is None:
        assert summary["shaft_sweep_deg"] >= 20
    assert summary["enabled_fraction"] == 1
    assert summary["unscaled_fraction"] >= 0.98
    assert summary["tip_error_mm"]["rms"] <= 1
    assert summary["rcm_kinematic_mm"]["mean"] <= 0.03
    assert summary["rcm_kinematic_mm"]["max"] <= 0.3
    assert summary["rcm_true_mm"]["max"] <= 0.5
    assert summary["exit"] == 0, summary["reasons"]
    assert summary["deterministic"] is True


COMBINATIONS = [
    pytest.param(robot, mode, motion, id=f"{robot}-{mode}-{motion}")
    for robot in ("ur5e", "panda")
    for mode in ("cartesian", "spherical")
    for motion in MOTIONS
    if FULL or (robot, mode) in {("ur5e", "cartesian"), ("panda", "spherical")}
]


@pytest.mark.parametrize(("robot", "mode", "motion"), COMBINATIONS)
def test_the_shaft_stays_in_the_trocar(
    robot: str, mode: str, motion: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    if not FULL and (robot, mode, motion) == ("ur5e", "cartesian", "bundled"):
        summary = request.getfixturevalue("plain")
    else:
        file = MOTIONS[motion]
        options = ["--motion", file] if file else []
        summary = demo(tmp_path / "run", "--robot", robot, "--mode", mode, *options)
    note(f"{robot}, {mode}, {motion}", summary)
    assert_within_limits(summary)


def test_a_third_arm_from_outside_the_tree(tmp_path: Path) -> None:
    bundled = ROOT / "src" / "surg_description" / "robots" / "ur5e.yaml"
    robot = write_third_arm(tmp_path / "arm", bundled)
    summary = demo(tmp_path / "run", "--robot", robot)
    note("third arm, cartesian, bundled", summary)
    assert_within_limits(summary)


@pytest.mark.full
@pytest.mark.parametrize("robot", ["ur5e", "panda"])
def test_behind_a_twist_link(robot: str, tmp_path: Path) -> None:
    summary = demo(tmp_path / "run", "--robot", robot, "--link", "twist")
    note(f"{robot}, cartesian, bundled, twist link", summary)
    assert summary["link"] == "twist"
    assert summary["rcm_kinematic_mm"]["max"] <= 0.5


@pytest.mark.full
def test_the_papers_law_and_no_feedback_drift(tmp_path: Path) -> None:
    ours = demo(tmp_path / "ours")
    paper = demo(tmp_path / "paper", "--law", "paper")
    open_loop = demo(tmp_path / "open", "--feedback-gain", 0, "--law", "velocity")
    note("ur5e, cartesian, bundled, `--law paper`", paper)
    note("ur5e, cartesian, bundled, `--law velocity --feedback-gain 0`", open_loop)
    assert paper["rcm_kinematic_mm"]["max"] >= 1
    assert paper["rcm_kinematic_mm"]["max"] >= 5 * ours["rcm_kinematic_mm"]["max"]
    faulted = any("rcm_error" in reason for reason in open_loop["reasons"])
    assert open_loop["rcm_kinematic_mm"]["max"] >= 1 or faulted


def test_one_seed_one_hash_whatever_the_scheduler_does(
    tmp_path: Path, plain: dict[str, Any]
) -> None:
    # A tick takes about a millisecond: half of it already shuffles everybody's messages.
    jitter_ms = 20.0 if FULL else 0.5
    shaken = demo(
        tmp_path / "shaken", "--duration", SHORT_S, env=socket_jitter.environment(jitter_ms)
    )
    print(f"{plain['counts']} ticks, jitter 0 to {jitter_ms} ms: {plain['state_hash']}")
    assert plain["deterministic"] is True
    assert shaken["deterministic"] is True
    assert plain["state_hash"] == shaken["state_hash"]


@pytest.mark.full
def test_ten_minutes_in_real_time_with_the_camera(tmp_path: Path) -> None:
    """Needs a quiet machine: what it measures is time."""
    summary = demo(tmp_path / "run", "--free-run", "--duration", 600, video=True)
    note("ur5e, cartesian, bundled repeated for 600 s, free-run", summary)
    controller = summary["controller"]
    print(controller)
    assert summary["enabled_fraction"] == 1
    assert not any("FAULT" in reason for reason in summary["reasons"])
    assert controller["rate_hz"] == pytest.approx(500, rel=0.01)
    assert controller["compute_us"]["p99"] <= 50
    assert summary["rcm_kinematic_mm"]["max"] <= 0.3
