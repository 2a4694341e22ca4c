"""`./surg run`: episodes through graphs of their own, what it says of them, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from helpers.graph.surg import surg
from helpers.graph.two_arms import write_two_arms
from helpers.sim.nudge_task import BREAKING, LUCKY
from surg_cli.host.paths import ROOT
from surg_recording.episode import episode_reader as episodes
from surg_sim.physics.stability import trouble

pytestmark = [pytest.mark.ros, pytest.mark.untimed]

NUDGE = ROOT / "tests" / "helpers" / "sim" / "nudge_task.py"


@pytest.mark.full
def test_an_unstable_episode_fails_and_the_next_one_starts_clean(tmp_path: Path) -> None:
    assert LUCKY == BREAKING + 1
    out, cell = tmp_path / "run", write_two_arms(tmp_path / "cell")
    words = ["run", NUDGE, "--robot", cell, "--episodes", 2, "--seed", BREAKING]
    done = surg(*words, "--setting", "ex_vivo", "--out", out, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.strip().splitlines()[-1] == str(out / "summary.json")
    assert "MuJoCo" in done.stdout and f"seed {BREAKING}" in done.stdout
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    print(json.dumps(summary["conditions"][0], indent=1)[:600])
    assert (summary["task"], summary["setting"], summary["ok"]) == ("nudge", "ex_vivo", True)
    assert (summary["success_rate"]["n"], summary["success_rate"]["k"]) == (2, 1)

    broken, well = summary["episodes"]
    assert broken["success"] is False
    assert "not to be trusted" in broken["failure_reason"]
    assert broken["duration_s"] == pytest.approx(0.302, abs=0.004)
    assert (well["success"], well["failure_reason"]) == (True, None)
    assert [e["seed"] for e in (broken, well)] == [BREAKING, LUCKY]
    assert well["deterministic"] is True and len(well["state_hash"]) == 64
    assert set(well["arms"]) == {"PSM1", "ECM"}
    assert 0 < well["rcm_kinematic_mm"]["mean"] < well["rcm_kinematic_mm"]["max"] < 1
    assert well["trocar"]["force_n"]["max"] > 0
    assert well["smoothness"]["sparc"] < 0

    # The figures are the recording's own, measured again.
    recorded = episodes.read(out / "episodes" / "001" / "episode")
    cycle = recorded.cycle("PSM1")
    moving = np.flatnonzero(cycle["command"] == 1)
    errors = 1e3 * cycle["rcm_error"][moving[0] : moving[-1] + 1]
    assert well["rcm_kinematic_mm"]["max"] == pytest.approx(errors.max(), rel=1e-6)
    assert well["rcm_kinematic_mm"]["mean"] == pytest.approx(errors.mean(), rel=1e-6)
    assert len(cycle) == round(well["duration_s"] / 0.002)
    assert recorded.manifest["task"] == "nudge" and recorded.manifest["seed"] == LUCKY

    page = (out / "report.html").read_text("utf-8")
    assert "1 of 2 (95 % interval" in page and "not to be trusted" in page
    assert page.count("data:image/png;base64,") == 2
    for name in ("000", "001"):
        assert (out / "episodes" / name / "report.html").exists()
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["dance"], "bgr"),
        (["bgr", "--setting", "space"], "phantom, ex_vivo, in_vivo"),
        (["bgr", "--setting", "phantom,space"], "in_vivo"),
        (["bgr", "--robot", "kuka"], "ur5e, panda"),
        ([str(NUDGE), "--robot", "sim_ur5e"], "needs the arms PSM1, ECM"),
        (["bgr", "--law", "mine"], "ours, velocity, paper"),
        (["bgr", "--episodes", "0"], "1 to 10000"),
        (["bgr", "--seed", "-1"], "0 to"),
        (["/nowhere/task.py"], "/nowhere/task.py"),
        (["bgr", "--cameras", "three"], "stereo"),
        (["bgr", "--seed", "one"], "--seed"),
    ],
)
def test_what_does_not_exist_is_said_before_anything_starts(
    tmp_path: Path, words: list[str], said: str
) -> None:
    out = tmp_path / "run"
    done = surg("run", *words, "--out", out)
    assert done.returncode == 2, done.stdout + done.stderr
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert not out.exists()


@pytest.mark.full
@pytest.mark.parametrize("robot", ["ur5e", "panda"])
def test_bowel_grasping_and_retraction_with_the_camera(tmp_path: Path, robot: str) -> None:
    """A whole episode with a recorded pair of views; its rate needs a quiet machine."""
    out = tmp_path / "run"
    done = surg("run", "bgr", "--robot", robot, "--seed", 10_000, "--cameras", "--out", out)
    assert done.returncode == 0, done.stdout + done.stderr
    (one,) = json.loads((out / "summary.json").read_text("utf-8"))["episodes"]
    print(f"{robot}: {one['real_time_factor']:.2f} of real time, {one['failure_reason']}")
    recorded = episodes.read(out / "episodes" / "000" / "episode")
    assert recorded.cameras == ["endoscope_left", "endoscope_right"]
    left, right = (recorded.video(name).frames["stamp_ns"] for name in recorded.cameras)
    assert np.array_equal(left, right)
    assert np.all(np.diff(left) == 50_000_000)
    assert len(left) >= one["duration_s"] * 20 - 1
    film = out / "film.mp4"
    assert 20_000 < film.stat().st_size < 2_000_000
    assert "data:video/mp4" in (out / "report.html").read_text("utf-8")


def test_trouble_is_noticed() -> None:
    """The check itself: a healthy state is none, each kind of broken one is named."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='0.1'/></body></worldbody></mujoco>"
    )
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: None)
    try:
        for name in ("qpos", "qvel"):
            data = mujoco.MjData(model)
            mujoco.mj_step(model, data)
            assert trouble(data) == ""
            getattr(data, name)[0] = np.nan
            assert "not finite" in trouble(data)
            mujoco.mj_step(model, data)
            assert "MuJoCo" in trouble(data)
    finally:
        mujoco.set_mju_user_warning(before)
