"""`./surg run --policy P --observe forces`: one force on the wire, in process and in the export."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from helpers.graph.surg import surg
from helpers.policy.nudge_policy import begin, row
from surg_cli.host import paths
from surg_core.contract import ARM_STATE, FORCE_KEY, STEP_NS
from surg_recording import datasets

pytestmark = pytest.mark.untimed

TASK = paths.ROOT / "tests" / "helpers" / "sim" / "felt_nudge_task.py"
FEELING = paths.ROOT / "tests" / "helpers" / "policy" / "feeling_policy.py"
WITNESS = "SURG_TEST_WITNESS"
SEED = 10_004


def in_one_process() -> tuple[str, np.ndarray]:
    """State hash, and what an environment observes, (steps, 16)."""
    from surg_sim.envs.surg_env import SurgEnv

    env = SurgEnv(str(TASK), forces=True)
    seen, _ = env.reset(seed=SEED)
    names = [f"{arm}/{name}" for arm in env.arms for name in ARM_STATE]
    state = seen["state"][[env.state_names.index(name) for name in names]]
    start, done, felt = begin(state.astype(np.float32)), False, []
    while not done:
        felt.append(seen["force"])
        seen, _, terminated, truncated, _ = env.step(row(start, len(felt)))
        done = terminated or truncated
    env.close()
    return env.session.hash, np.array(felt)


@pytest.mark.full
@pytest.mark.ros
def test_a_policy_feels_what_an_environment_and_the_export_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    account, out = tmp_path / "account.txt", tmp_path / "run"
    monkeypatch.setenv(WITNESS, str(account))
    words = ("--policy", FEELING, "--observe", "forces", "--seed", SEED, "--out", out)
    done = surg("run", TASK, *words)
    assert done.returncode == 0, done.stdout + done.stderr
    (entry,) = json.loads((out / "summary.json").read_text("utf-8"))["episodes"]
    wanted, felt = in_one_process()
    assert entry["deterministic"] and entry["state_hash"] == wanted, entry["policy"]
    said = np.array([line.split() for line in account.read_text().splitlines()], dtype=float)
    assert np.abs(said[:, 1:4]).max() > 1.0 and set(said[:, 4]) == {1.0}
    np.testing.assert_allclose(said[:, 1:], felt[: len(said)], atol=1e-3)
    assert len(felt) - len(said) in (0, 1)
    report = datasets.load("lerobot").write(
        [out / "episodes/000/episode"],
        tmp_path / "set",
        datasets.ExportOptions(executor="serial", splits={"train": 1.0}),
    )
    assert report.ok, report
    (file,) = (tmp_path / "set" / "data").rglob("*.parquet")
    table = pq.read_table(file)
    steps = np.array(table.column("timing.grid_ns").to_pylist()) // STEP_NS
    exported = dict(zip(steps.tolist(), table.column(FORCE_KEY).to_pylist(), strict=True))
    both = [line for line in said if int(line[0]) in exported]
    assert len(both) > 20
    for line in both:
        assert np.array_equal(np.float32(line[1:]), np.float32(exported[int(line[0])])), line[0]


@pytest.mark.ros
@pytest.mark.full
def test_a_policy_that_needs_forces_is_told_how_to_get_them(tmp_path: Path) -> None:
    done = surg("run", TASK, "--policy", FEELING, "--seed", SEED, "--out", tmp_path / "run")
    assert done.returncode == 1 and "--observe forces" in done.stdout + done.stderr
