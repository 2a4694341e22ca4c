"""The example policies and `./surg policy keys`: what they do and say when given nonsense."""

import ast
import importlib
import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from helpers.policy.policy_server import ACTION, STATE, PolicyServer, spec
from surg_cli.host import paths
from surg_cli.host.terminal import CliError
from surg_policy_client import Observation
from surg_policy_client.errors import SpecMismatch
from surg_policy_client.keys import server_keys
from surg_policy_client.policies.hold import Hold
from surg_policy_client.policies.replay import load
from surg_policy_client.policies.scripted import Circle

NAMES = [f"PSM1/{name}" for name in ACTION]
AT = np.array([0.01, 0.02, 0.1, 0.3, 0.5, 0.011, 0.021, 0.101, 0.31], np.float32)
HELD = np.array([0.011, 0.021, 0.101, 0.31, 0.5])
assert len(STATE) == len(AT)


def seen(step: int) -> Observation:
    return Observation({"observation.state": AT}, step, 0, 0, "", spec())


def test_hold_holds_what_was_there_first() -> None:
    policy = Hold()
    policy.reset("", None)
    assert np.allclose(policy.act(seen(5)), np.tile(HELD, (8, 1)), atol=1e-6)
    moved = Observation({"observation.state": AT + 1}, 6, 0, 0, "", spec())
    assert np.allclose(policy.act(moved), np.tile(HELD, (8, 1)), atol=1e-6)


def test_a_circle_begins_at_rest_and_is_the_same_however_often_it_is_asked() -> None:
    policy = Circle(radius=0.005, period=5.0)
    policy.reset("", None)
    by_step: dict[int, np.ndarray] = {}
    for step in (7, 8, 9, 12, 20, 25, 33, 40, 50, 60, 70):
        for i, row in enumerate(policy.act(seen(step))):
            known = by_step.setdefault(step + 1 + i, row)
            assert np.allclose(known, row, atol=1e-9)
    rows = np.array([by_step[step] for step in sorted(by_step)])
    assert np.linalg.norm(rows[0] - HELD) < 1e-4
    assert np.abs(np.diff(rows[:, :2], axis=0)).max() < 0.0006
    late = rows[40:, :2] - HELD[:2] + np.array([0.005, 0.0])
    assert np.allclose(np.linalg.norm(late, axis=1), 0.005, atol=1e-6)


def test_a_recording_is_replayed_row_by_row_and_its_end_held(tmp_path: Path) -> None:
    rows = np.random.default_rng(3).normal(size=(25, 5))
    order = [3, 1, 0, 4, 2]
    lines = [",".join(NAMES[i] for i in order)]
    lines += [",".join(repr(float(row[i])) for i in order) for row in rows]
    (tmp_path / "episode.csv").write_text("\n".join(lines) + "\n")
    policy = load(tmp_path / "episode.csv")
    for start in (4, 1000):
        policy.reset("", None)
        assert np.array_equal(policy.act(seen(start)), rows[:10])
        assert np.array_equal(policy.act(seen(start + 18))[:7], rows[18:25])
        assert (policy.act(seen(start + 900)) == rows[-1]).all()


def test_an_exported_episode_is_replayed(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    rows = np.random.default_rng(4).normal(size=(12, 5)).astype(np.float32)
    (tmp_path / "meta").mkdir()
    (tmp_path / "data" / "chunk-000").mkdir(parents=True)
    info = {"features": {"action": {"names": NAMES}}}
    (tmp_path / "meta" / "info.json").write_text(json.dumps(info))
    for episode in (0, 1):
        table = {
            "episode_index": [episode] * 6,
            "frame_index": list(range(6)),
            "action": [list(row) for row in rows[6 * episode : 6 * episode + 6]],
        }
        file = tmp_path / "data" / "chunk-000" / f"episode_{episode:06d}.parquet"
        parquet.write_table(pyarrow.table(table), file)
    policy = load(tmp_path, index=1)
    policy.reset("", None)
    assert np.array_equal(policy.act(seen(0))[:6], rows[6:].astype(float))
    with pytest.raises(ValueError, match="has no episode 7"):
        load(tmp_path, index=7)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("PSM1/x\nfast\n", "could not convert"),
        ("PSM1/x\nnan\n", "no numbers"),
        ("PSM1/x\n", "names"),
    ],
)
def test_a_bad_recording_is_refused(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(text)
    with pytest.raises(ValueError, match=said):
        load(tmp_path / "x.csv")


def test_a_recording_of_another_arm_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("PSM2/x\n0.0\n")
    policy = load(tmp_path / "x.csv")
    policy.reset("", None)
    with pytest.raises(SpecMismatch, match=r"no PSM1/x, .*it has PSM2/x"):
        policy.act(seen(0))


# --- as programs ----------------------------------------------------------------------------------


def program(*words: str) -> subprocess.Popen[str]:
    argv = [sys.executable, "-m", *words]
    return subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_a_program_serves_until_it_is_ended_and_says_how_it_went() -> None:
    with PolicyServer() as server:
        process = program("surg_policy_client.policies.scripted", "--server", server.address)
        server.wait("PING", 60.0)
        assert server.ask(0).arrays["chunk"].shape == (10, 5)
        process.terminate()
        out, err = process.communicate(timeout=60.0)
        assert server.wait("BYE").head["reason"] == "stopped by the user"
    assert (process.returncode, err) == (0, "")
    assert "connected to tcp://127.0.0.1" in out
    assert "1 observations answered in 0 episodes" in out


def test_a_program_without_a_server_ends_with_what_to_do() -> None:
    words = ("--server", "tcp://127.0.0.1:9", "--timeout", "0.2")
    process = program("surg_policy_client.policies.hold", *words)
    out, err = process.communicate(timeout=60.0)
    assert process.returncode == 1
    assert "no server listens there" in err
    assert "Traceback" not in out + err


@pytest.mark.parametrize(
    "page", ["docs/guide/policy_client.md", "src/surg_policy_bridge/client/README.md"]
)
def test_the_code_on_a_page_is_python_3_8_and_uses_what_there_is(page: str) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (paths.ROOT / page).read_text("utf-8"), re.DOTALL)
    used = 0
    for block in blocks:
        for node in ast.walk(ast.parse(block, feature_version=(3, 8))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("surg_"):
                module = importlib.import_module(node.module or "")
                assert all(hasattr(module, alias.name) for alias in node.names), ast.dump(node)
                used += 1
    assert used >= 1


# --- ./surg policy keys ---------------------------------------------------------------------------


def test_surg_keys_makes_them_once(
    surg: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "keys"
    assert surg("policy", "keys", "--out", folder) == 0
    said = capsys.readouterr().out
    assert str(folder / "server" / "server.key_secret") in said
    assert f"--policy-keys {folder}" in said
    with pytest.raises(CliError, match="nothing is overwritten") as caught:
        surg("policy", "keys", "--out", folder)
    assert caught.value.code == 2
    assert surg("policy", "keys", "laboratory", "--out", folder) == 0
    assert sorted(server_keys(folder).clients) == ["laboratory", "policy"]
