"""Only an arm's controller subscribes to its command topics, in every system that `./surg` starts.

A client takes the first subscriber of its topic for the controller. With any other one its first
command can go there alone.
"""

from __future__ import annotations

import signal
import subprocess
import time
from pathlib import Path

import pytest

from helpers.graph.surg import start
from surg_cli.graph import master, processes, running
from surg_cli.graph.topic_contract import load
from surg_ros.arm_port import MOTION_COMMANDS, OTHER_COMMANDS

pytestmark = [pytest.mark.ros, pytest.mark.untimed]

COMMANDS = {*MOTION_COMMANDS, *OTHER_COMMANDS, "hold"}
TRACKED = "rcm/track"
"""Subscribed to only where the trocar moves."""
START_S = 120.0
SETTLED_S = 4.0
"""[s] in which every node has subscribed, and the recorder has looked for topics twice."""


def test_the_commands_are_those_of_the_page() -> None:
    entries = load().entries
    first = next(k for k, entry in enumerate(entries) if entry.direction == "out")
    commands = [entry for entry in entries[:first] if entry.direction == "in"]
    assert {entry.name.removeprefix("<arm>/") for entry in commands} == COMMANDS


def listeners(uri: str) -> dict[str, list[str]]:
    """Nodes that subscribe to each topic."""
    _, subscriptions, _ = master.call(uri, "getSystemState")
    return dict(subscriptions)


@pytest.mark.full  # in every run `test_cli_lifecycle` does this with one arm
@pytest.mark.parametrize(
    ("words", "cell", "servants"),
    [
        (("up", "--cameras", "none", "--record-topics", "/*", "--"), "sim_two_arms", ()),
        (("teleop",), "sim_ur5e", ()),
        (("run",), "bgr", ("/assistant/servo_jp", "/assistant/jaw/servo_jp")),
    ],
)
def test_only_controllers_subscribe(
    tmp_path: Path, words: tuple[str, ...], cell: str, servants: tuple[str, ...]
) -> None:
    port, log = master.free_port(), tmp_path / "log"
    more = {
        "up": ("--port", port),
        "teleop": ("--port", port, "--bind", f"127.0.0.1:{master.free_port()}"),
        "run": ("--out", tmp_path / "run"),
    }[words[0]]
    with start(log, words[0], *more, *words[1:], cell) as process:
        try:
            system = started(process, log)
            expected = {topic: ["/sim"] for topic in servants}
            for node in system.nodes:
                if node.endswith("/controller"):
                    arm = node.removesuffix("/controller")
                    expected |= {f"{arm}/{name}": [node] for name in COMMANDS - {TRACKED}}
            uri = system.master_uri
            processes.wait_until(lambda: expected.keys() <= listeners(uri).keys(), START_S, 0.5)
            time.sleep(SETTLED_S)
            found = listeners(uri)
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(120)
    assert len(expected) >= len(COMMANDS) - 1
    assert {topic: found.get(topic) for topic in expected} == expected


def started(process: subprocess.Popen[bytes], log: Path) -> running.System:
    """The system of a command, once all its nodes have been started."""

    def found() -> list[running.System]:
        every = [system for system in running.systems() if "/recorder" in system.nodes]
        return [s for s in every if s.pid == process.pid or str(log.parent) in s.logs]

    assert processes.wait_until(lambda: bool(found()), START_S, 0.2), log.read_text()
    return found()[0]
