"""`./surg stop`: pause every arm, without the console and its web server."""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
import time
from typing import Any

from surg_cli.graph import master, running
from surg_cli.graph.watch import PAUSE_SIGNAL, pause_arms
from surg_cli.host.option_types import tcp_port
from surg_cli.host.terminal import CliError, say

CYCLE_TYPE = "surg_msgs/Cycle"
"""Only controllers publish it: a leader has an operating state, too, but nothing to pause."""
PATIENCE_S = 0.3
"""[s] The supervising process has paused the arms by then, or this process does it."""
TIMEOUT_S = 5.0
LOOK_S = 0.01


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.add_argument("--port", type=tcp_port, metavar="P", help="only the system on this port")


def at_once(options: argparse.Namespace) -> list[running.System]:
    """Signal the systems' supervising processes: they are connected already, the fastest way."""
    systems = running.systems(options.port)
    for system in systems:
        with contextlib.suppress(ProcessLookupError):
            os.kill(system.pid, PAUSE_SIGNAL)
    return systems


def main(options: argparse.Namespace, command: str) -> int:
    """Pause, then check that every arm has left ENABLED; exit status 1 if one has not."""
    systems = at_once(options)
    uris = list(dict.fromkeys(system.master_uri for system in systems))
    if not uris and options.port is None:
        raise CliError("no system of this checkout is running (--port P names another ROS master)")
    if len(uris) > 1:  # a process belongs to one ROS master
        ports = [str(s.port) for s in systems]
        return max(
            subprocess.run([sys.executable, "-s", "-m", "surg_cli", "stop", "--port", p]).returncode
            for p in ports
        )
    return _confirm(uris[0] if uris else f"http://localhost:{options.port}")


def _confirm(uri: str) -> int:
    """Wait until no arm is ENABLED; tell those that still are."""
    arms = sorted(
        topic.split("/")[1]
        for topic, kind in master.call(uri, "getTopicTypes")
        if kind == CYCLE_TYPE and topic.count("/") == 2
    )
    if not arms:
        raise CliError(f"no arm's controller reports to the ROS master at {uri}")
    import rospy

    from crtk_msgs.msg import OperatingState

    states: dict[str, str] = {}

    def heard(message: Any, arm: str) -> None:
        states[arm] = message.state

    with master.joined(uri, "surg_stop"):
        keys: dict[str, Any] = {"tcp_nodelay": True}
        for arm in arms:
            rospy.Subscriber(f"/{arm}/operating_state", OperatingState, heard, arm, **keys)
        began, told = time.monotonic(), False
        while (moving := _moving(arms, states)) and time.monotonic() - began < TIMEOUT_S:
            if not told and time.monotonic() - began > PATIENCE_S:
                pause_arms(moving)
                told = True
            time.sleep(LOOK_S)
    for arm in arms:
        say(f"{arm} {states.get(arm, 'silent')}")
    if moving := _moving(arms, states):
        raise CliError(f"{', '.join(moving)} did not pause: press the robot's emergency stop")
    return 0


def _moving(arms: list[str], states: dict[str, str]) -> list[str]:
    """Arms that are ENABLED, or have not reported yet."""
    return [arm for arm in arms if states.get(arm, "ENABLED") == "ENABLED"]
