"""`./surg run TASK --policy`: a policy's process through wire, server, graph and recording."""

from __future__ import annotations

import argparse
import csv
import json
from pathlib import Path

import numpy as np
import pytest

from helpers.nudge_policy import begin, row
from helpers.policy_results import note
from helpers.surg import surg
from surg_cli import paths, run
from surg_cli.terminal import Problem
from surg_policy_bridge.arm import ARM_STATE

pytestmark = pytest.mark.untimed

TASK = paths.ROOT / "tests" / "helpers" / "nudge_task.py"
POLICY = paths.ROOT / "tests" / "helpers" / "nudge_policy.py"
SEED = 10_004
"""The task is solved where the policy leads the arms: back to where they were."""


def in_one_process() -> tuple[str, int]:
    """State hash and number of actions of the same actions in an environment."""
    from surg_sim.env import SurgEnv

    env = SurgEnv(str(TASK))
    seen, _ = env.reset(seed=SEED)
    names = [f"{arm}/{name}" for arm in env.arms for name in ARM_STATE]
    state = seen["state"][[env.state_names.index(name) for name in names]]
    start, n, done = begin(state.astype(np.float32)), 0, False
    while not done:
        n += 1
        _, _, terminated, truncated, info = env.step(row(start, n))
        done = terminated or truncated
    assert info["success"], info
    return env.session.hash, n


@pytest.mark.ros
def test_a_roll_out_is_what_an_environment_computes(tmp_path: Path) -> None:
    """The same actions, through two processes, ZeroMQ, ROS and the safety controller."""
    out = tmp_path / "run"
    done = surg("run", str(TASK), "--policy", str(POLICY), "--seed", str(SEED), "--out", str(out))
    assert done.returncode == 0, done.stdout + done.stderr
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    (entry,) = summary["episodes"]
    wanted, steps = in_one_process()
    assert entry["deterministic"] and entry["state_hash"] == wanted
    policy = entry["policy"]
    assert policy["policy"] == "Nudge" and policy["accepted"] in (steps, steps - 1)
    counts = ("rejected", "clipped", "late", "stale", "empty", "waited", "strangers")
    assert {name: policy[name] for name in counts} == dict.fromkeys(counts, 0)
    table = out / "episodes" / "000" / "episode" / "topics" / "policy_action.csv"
    with table.open(encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    assert len(rows) == policy["accepted"] and rows[0]["names_0"] == "PSM1/x"
    assert int(rows[0]["step"]) == 4 and int(rows[0]["stamp_ns"]) % 50_000_000 == 2_000_000
    note(9, len(rows), f"the same state hash, {wanted[:12]}…")
    print(f"round trip {policy['round_trip_ms']}")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--policy", "nobody.py"], "neither an address"),
        (["--policy", "tcp://0.0.0.0:5555"], "./surg keys"),
        (["--policy", "udp://127.0.0.1:1"], "such as tcp://127.0.0.1:5555"),
        (["--policy", "tcp://127.0.0.1:5555", "--policy-keys", "/nowhere"], "/nowhere"),
        (["--privileged"], "--privileged goes with --policy"),
        (["--free-run"], "--free-run goes with --policy"),
    ],
)
def test_what_cannot_be_a_policy_is_said(tmp_path: Path, words: list[str], said: str) -> None:
    parser = argparse.ArgumentParser()
    run.add_arguments(parser, "run")
    options = parser.parse_args([str(TASK), *words, "--out", str(tmp_path / "run")])
    with pytest.raises(Problem) as problem:
        run.main(options, "run")
    assert problem.value.code == 2 and said in str(problem.value)
    assert not (tmp_path / "run").exists()
