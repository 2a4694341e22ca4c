"""`./surg run TASK --policy`: a policy's process through wire, server, graph and recording."""

from __future__ import annotations

import csv
import json
import shutil
import zlib
from pathlib import Path

import numpy as np
import pytest

from helpers.examples.course import EXAMPLES, ROS_STEP, play
from helpers.graph.surg import called, surg
from helpers.policy.nudge_policy import begin, row
from helpers.results.policy_results import note
from surg_cli.host import paths
from surg_cli.host.terminal import CliError
from surg_core.contract import ARM_STATE
from surg_policy_client.policies import skeleton
from surg_sim.appearance.opengl import NoOpenGL, choose_backend

pytestmark = pytest.mark.untimed

TASK = paths.ROOT / "tests" / "helpers" / "sim" / "nudge_task.py"
POLICY = paths.ROOT / "tests" / "helpers" / "policy" / "nudge_policy.py"
LOOKING = paths.ROOT / "tests" / "helpers" / "policy" / "witness_policy.py"
DYING = paths.ROOT / "tests" / "helpers" / "policy" / "dying_policy.py"
WITNESS = "SURG_TEST_WITNESS"
"""Where the looking one writes."""
SEED = 10_004
"""The task is solved where the policy leads the arms: back to where they were."""
ENDS_S = 2.0
"""[s simulated] The task's own time limit is twice that."""
DEATHS: dict[str, float] = {}
"""How long an episode was [s simulated], by the way in which its policy's program died."""
N_DEATHS = 7
"""Ways that are tried."""


def in_one_process() -> tuple[str, int, list[int]]:
    """State hash, number of actions and checksums of the pictures of the same in an environment."""
    from surg_sim.envs.surg_env import SurgEnv

    env = SurgEnv(str(TASK), images=("left",), width=640, height=480, seed_look=SEED)
    seen, _ = env.reset(seed=SEED)
    names = [f"{arm}/{name}" for arm in env.arms for name in ARM_STATE]
    state = seen["state"][[env.state_names.index(name) for name in names]]
    start, n, done, shown = begin(state.astype(np.float32)), 0, False, []
    while not done:
        n += 1
        shown += [zlib.crc32(picture) for picture in seen["images"].values()]
        seen, _, terminated, truncated, info = env.step(row(start, n))
        done = terminated or truncated
    assert info["success"], info
    env.close()
    return env.session.hash, n, shown


@pytest.mark.full
@pytest.mark.ros
def test_every_observation_holds_the_picture_of_its_own_tick(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the last bit those that an environment renders, none early, late or left out."""
    try:
        choose_backend()
    except NoOpenGL as error:
        pytest.skip(str(error))
    account, out = tmp_path / "account.txt", tmp_path / "run"
    monkeypatch.setenv(WITNESS, str(account))
    words = ("--policy", LOOKING, "--cameras", "left", "--seed", SEED, "--out", out)
    done = surg("run", TASK, *words)
    assert done.returncode == 0, done.stdout + done.stderr
    (entry,) = json.loads((out / "summary.json").read_text("utf-8"))["episodes"]
    wanted, steps, shown = in_one_process()
    assert entry["deterministic"] and entry["state_hash"] == wanted
    policy = entry["policy"]
    assert policy["policy"] == "Witness" and policy["accepted"] in (steps, steps - 1)
    counts = ("rejected", "clipped", "late", "stale", "empty", "waited", "strangers")
    assert {name: policy[name] for name in counts} == dict.fromkeys(counts, 0)
    assert policy["sessions"] == 1
    table = out / "episodes" / "000" / "episode" / "topics" / "policy_action.csv"
    with table.open(encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    assert len(rows) == policy["accepted"] and rows[0]["names_0"] == "PSM1/x"
    assert int(rows[0]["step"]) == 4 and int(rows[0]["stamp_ns"]) % 50_000_000 == 2_000_000
    note(7, len(rows), f"the same state hash, {wanted[:12]}…")
    seen = np.array([line.split() for line in account.read_text().splitlines()], dtype=np.int64)
    np.testing.assert_array_equal(seen[:, 0], seen[0, 0] + np.arange(len(seen)))
    np.testing.assert_array_equal(seen[:, 1], seen[:, 0] * 50_000_000)
    print(f"{len(seen)} pictures, {len(set(seen[:, 2]))} different, round trip "
          f"{policy['round_trip_ms']}")  # fmt: skip
    assert len(set(seen[:, 2])) > len(seen) / 2
    assert seen[:, 2].tolist() == shown[: len(seen)] and steps - len(seen) in (0, 1)


@pytest.mark.full
@pytest.mark.ros
def test_a_score_card_plays_the_episode_that_run_plays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The skeleton goes to a place in the world: by the rcm frame that it is told."""
    monkeypatch.syspath_prepend(str(paths.ROOT / "benchmarks"))
    from policy import card_cell, shut_in

    policy, out = tmp_path / "mine" / "reach.py", tmp_path / "run"
    policy.parent.mkdir()
    shutil.copy(skeleton.__file__, policy)
    surg("run", "bgr", "--policy", policy, "--seed", SEED, "--out", out)
    (entry,) = json.loads((out / "summary.json").read_text("utf-8"))["episodes"]
    program = shut_in.Program.of(str(policy))
    (played,) = card_cell.play(card_cell.CellJob(program, "bgr", "as served", (SEED,)))["episodes"]
    assert played["state_hash"] == entry["state_hash"] is not None
    logs = (out / "episodes" / "000" / "logs").glob("*.log")
    lines = [line for log in logs for line in log.read_text("utf-8").splitlines()]
    assert [line for line in lines if "WARN" in line or "ERROR" in line] == [], "no alarm"
    note(14, 1, f"the same state hash, {played['state_hash'][:12]}…")


@pytest.mark.ros
@pytest.mark.parametrize(  # refused at once, and once it is served
    ("more", "how"),
    [
        ([], "before it had"),
        pytest.param(["--observe", "privileged"], "program ended (1)", marks=pytest.mark.full),
    ],
)
def test_an_episode_without_its_policy_ends(tmp_path: Path, more: list[str], how: str) -> None:
    out = tmp_path / "run"
    done = surg("run", TASK, "--policy", LOOKING, *more, "--seed", SEED, "--out", out)
    told = done.stdout + done.stderr
    assert done.returncode == 1 and how in told and "endoscope.left" in told
    assert "time limit" not in told


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--policy", "nobody.py"], "nobody.py: no such file"),
        (["--policy", "nobody"], "neither an address"),
        (["--policy", "tcp://0.0.0.0:5555"], "./surg policy keys"),
        (["--policy", "udp://127.0.0.1:1"], "such as tcp://127.0.0.1:5555"),
        (["--policy", "tcp://127.0.0.1:5555", "--policy-keys", "/nowhere"], "/nowhere"),
        (["--observe", "privileged"], "--observe needs --policy"),
        (["--free-run"], "--free-run needs --policy"),
    ],
)
def test_what_cannot_be_a_policy_is_said(tmp_path: Path, words: list[str], said: str) -> None:
    with pytest.raises(CliError) as problem:
        called("run", TASK, *words, "--out", tmp_path / "run")
    assert problem.value.code == 2 and said in str(problem.value)
    assert not (tmp_path / "run").exists()


@pytest.mark.ros
@pytest.mark.parametrize(
    ("death", "said"),
    [
        ("raises", "ValueError: the weights are gone"),
        pytest.param("killed", "was killed by signal 9", marks=pytest.mark.full),
        pytest.param("starts", "ended (1) before it had connected", marks=pytest.mark.full),
        pytest.param("aborts", "was killed by signal 6", marks=pytest.mark.full),
        pytest.param("exits", "ended (0)", marks=pytest.mark.full),
        pytest.param("wrong shape", "a chunk is [K, 10]", marks=pytest.mark.full),
        pytest.param(
            "no numbers", "PSM1/x is nan; allowed: finite numbers", marks=pytest.mark.full
        ),
    ],
)
def test_a_death_is_named_and_ends_the_episode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, death: str, said: str
) -> None:
    monkeypatch.setenv("SURG_TEST_DEATH", death)
    out = tmp_path / "run"
    done = surg("run", TASK, "--policy", DYING, "--seed", SEED, "--out", out)
    told = done.stdout + done.stderr
    assert done.returncode == 1 and "crashed: episode 0" in told and said in told, told
    assert "no such folder" not in told and "waiting for a model server" not in told
    assert told.count("the policy's program") <= 2, "in the episode's line, and with its last lines"
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    (entry,) = summary["episodes"]
    assert entry["outcome"] == "crashed" and entry["success"] is None
    assert said in entry["failure_reason"] and "the weights are gone" in entry["failure_reason"]
    assert summary["success_rate"]["n"] == 0, "it counts neither for nor against the policy"
    assert entry["duration_s"] <= ENDS_S
    DEATHS[death] = entry["duration_s"]
    if len(DEATHS) == N_DEATHS:
        longest = max(DEATHS.values())
        note(15, N_DEATHS, f"each named, exit status 1, ended after {longest:.2f} s simulated")
    page = (out / "report.html").read_text("utf-8")
    assert "crashed" in page and "the weights are gone" in page


@pytest.mark.ros
@pytest.mark.full  # the chain before it is in tests/unit/examples
def test_the_policy_of_the_course_solves_its_task_through_the_model_server(tmp_path: Path) -> None:
    for name in ("05_recording.py", "07_export.py", "08_training.py"):
        play(EXAMPLES / name, tmp_path)
    out = tmp_path / "run"
    words = ("--policy", ROS_STEP, "--observe", "privileged", "--seed", 20_000, "--out", out)
    weights = str(tmp_path / "runs/course/weights.npz")
    done = surg("run", EXAMPLES / "04_task.py", *words, extra={"SURG_COURSE_WEIGHTS": weights})
    assert done.returncode == 0, done.stdout + done.stderr
    (entry,) = json.loads((out / "summary.json").read_text("utf-8"))["episodes"]
    assert entry["success"] and entry["policy"]["policy"] == "TouchPolicy"
    assert entry["policy"]["accepted"] > 0
    assert [entry["policy"][name] for name in ("rejected", "clipped", "late")] == [0, 0, 0]
