"""Systems come up, say what they are, and leave nothing behind however they end."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from helpers.graph.surg import environment, start, surg
from surg_cli.graph import master, processes, running
from surg_cli.host import paths
from surg_ros.arm_port import MOTION_COMMANDS, OTHER_COMMANDS

pytestmark = pytest.mark.ros

START_S = 90.0


def entry_of(pid: int) -> running.System | None:
    """The list entry of a running command."""
    return next((s for s in running.systems() if s.pid == pid and s.nodes), None)


def wait_for_entry(pid: int, log: Path) -> running.System:
    """Wait until a system has started all its nodes."""
    up = processes.wait_until(lambda: entry_of(pid) is not None, START_S, 0.1)
    assert up, log.read_text()
    found = entry_of(pid)
    assert found is not None
    return found


def all_gone(pids: list[int]) -> bool:
    return all(processes.start_time(pid) is None for pid in pids)


def test_up_status_stop_down(tmp_path: Path) -> None:
    port, log = master.free_port(), tmp_path / "up.log"
    with start(log, "up", "sim_ur5e", "--cameras", "none", "--port", port) as process:
        system = wait_for_entry(process.pid, log)
        assert json.loads(system.file.read_text())["command"] == "up", "the list is plain JSON"
        assert {"/sim", "/PSM1/controller", "/recorder"} <= set(system.nodes)
        assert processes.wait_until(lambda: "is up" in log.read_text(), START_S, 0.1)
        subscribers = dict(master.call(system.master_uri, "getSystemState")[1])
        for name in {*MOTION_COMMANDS, *OTHER_COMMANDS} - {"rcm/track"}:  # no trocar moves
            assert subscribers[f"/PSM1/{name}"] == ["/PSM1/controller"]
        status = surg("status", "--port", port)
        assert status.returncode == 0, status.stdout + status.stderr
        for word in ("/PSM1/controller", "/PSM1/cycle", " Hz", "last errors", "running"):
            assert word in status.stdout
        again = surg("up", "sim_ur5e", "--cameras", "none", "--port", port)
        assert again.returncode == 2
        assert "--port" in again.stderr
        enable(port)
        done = surg("stop", "--port", port)
        assert done.returncode == 0, done.stdout + done.stderr
        assert "PSM1 PAUSED" in done.stdout
        again = surg("stop", "--port", port)  # an arm at rest is no reason to fail
        assert again.returncode == 0
        assert process.poll() is None, "the system stays up"
        down = surg("down", "--port", port)
        assert down.returncode == 0
        assert process.wait(30) == 130
    assert processes.wait_until(lambda: all_gone(list(system.nodes.values())), 5.0)
    assert not system.file.exists()


def enable(port: int) -> None:
    """Enable and home the arm, as a client of the system."""
    env = {**environment(), "ROS_MASTER_URI": f"http://localhost:{port}"}
    env["PYTHONPATH"] = f"{paths.ROOT / 'tests'}:{env['PYTHONPATH']}"
    client = subprocess.Popen(
        [sys.executable, "-m", "helpers.graph.session_client", "PSM1"],
        env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert client.stdin is not None and client.stdout is not None
    for word in ("enable", "home"):
        command = f'"{{string: {word}}}"'
        client.stdin.write(
            f"rostopic pub -1 /PSM1/state_command crtk_msgs/StringStamped {command}\n"
        )
        client.stdin.flush()
        answer = json.loads(client.stdout.readline())
    assert answer["state"] == "ENABLED", answer
    client.stdin.close()
    client.wait(60)


def test_a_dying_node_ends_the_system_and_is_named(tmp_path: Path) -> None:
    port, log = master.free_port(), tmp_path / "up.log"
    with start(log, "up", "sim_ur5e", "--cameras", "none", "--port", port) as process:
        system = wait_for_entry(process.pid, log)
        os.kill(system.nodes["/PSM1/controller"], signal.SIGKILL)
        assert process.wait(30) == 1
    text = log.read_text()
    assert "/PSM1/controller was killed by signal 9" in text
    assert processes.wait_until(lambda: all_gone(list(system.nodes.values())), 5.0)


@pytest.mark.untimed
@pytest.mark.parametrize(
    "number",
    [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.full), signal.SIGKILL],
)
def test_demo_leaves_nothing_behind(number: signal.Signals, tmp_path: Path) -> None:
    log = tmp_path / "demo.log"
    with start(log, "demo", "--no-video", "--out", tmp_path / "run") as process:
        system = wait_for_entry(process.pid, log)
        process.send_signal(number)
        expected = -number if number is signal.SIGKILL else 130
        assert process.wait(30) == expected
    # Also after SIGKILL, when nobody is left to stop the nodes: the kernel does.
    assert processes.wait_until(lambda: all_gone(list(system.nodes.values())), 5.0)
    assert processes.wait_until(lambda: not master.port_in_use(system.port), 5.0)


@pytest.mark.untimed
def test_a_dying_node_fails_the_demo_and_is_named(tmp_path: Path) -> None:
    log, out = tmp_path / "demo.log", tmp_path / "run"
    with start(log, "demo", "--no-video", "--out", out) as process:
        system = wait_for_entry(process.pid, log)
        cycles = out / "episode.partial" / "cycle_PSM1.csv"
        assert processes.wait_until(lambda: cycles.exists() and cycles.stat().st_size > 0, 60.0)
        os.kill(system.nodes["/sim"], signal.SIGKILL)
        assert process.wait(60) == 1
    text = log.read_text()
    assert "/sim was killed by signal 9" in text
    # What was recorded until then is reported, and not as a success.
    assert text.splitlines()[-1] == str(out / "summary.json")
    assert json.loads((out / "summary.json").read_text())["ok"] is False
    assert processes.wait_until(lambda: all_gone(list(system.nodes.values())), 5.0)


@pytest.mark.untimed
def test_status_without_a_system_says_how_to_start_one() -> None:
    port = master.free_port()
    done = surg("status", "--port", port)
    assert done.returncode == 1
    assert "./surg up CELL" in done.stderr


@pytest.mark.untimed
def test_stop_without_a_system_says_so() -> None:
    done = surg("stop", "--port", master.free_port())
    assert done.returncode == 1
    assert "no ROS master answers" in done.stderr
