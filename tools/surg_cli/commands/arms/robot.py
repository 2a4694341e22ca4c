"""`./surg robot CELL ACTION`: power, start, stop and guide the robots of a cell; their lag."""

from __future__ import annotations

import argparse
import math
import os
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surg_cli.graph import running
from surg_cli.host import cells
from surg_cli.host.option_types import positive, tcp_port
from surg_cli.host.terminal import Problem, Progress, confirm, say, table, warn
from surg_cli.robots import rehearsal, robot_service
from surg_cli.robots.robot_request import RobotRequests, condition_name

ACTIONS = {
    "status": "condition of each robot, and what to do",
    "start": "let each robot obey its commands; nothing moves by it",
    "stop": "bring each robot to rest; it obeys nothing until the next start",
    "guide": "let a person guide each robot by hand, until stop",
    "lag": "measure the lag of each arm's link from its motion",
    **robot_service.ACTIONS,
    "rehearse": "lead through the next stop of the rehearsal, measure it, write the report",
}
TOLERANCE_S = 0.003
"""Above this difference the controller warns (docs/reference/safety.md)."""
TIMEOUT_S = 60.0
LOOK_S = 0.1


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    add = parser.add_argument
    add(
        "cell",
        metavar="CELL",
        help="name in cells/, or a folder. Instead, without a cell: "
        "check FILE or home FILE, for a robot's YAML",
    )
    add("action", choices=tuple(ACTIONS), help="; ".join(f"{a}: {h}" for a, h in ACTIONS.items()))
    add("--arm", metavar="ARM", help="only this arm (default: every arm)")
    add("--timeout", type=positive, default=TIMEOUT_S, metavar="S", help="of lag: default 60 s")
    add("--port", type=tcp_port, metavar="P", help="of the ROS master")


@dataclass(frozen=True)
class Lag:
    """A link's lag [s]: stated in the robot's YAML, and measured (NaN: not enough motion yet)."""

    stated: float
    measured: float

    @property
    def differs(self) -> bool:
        """Whether the two differ by more than the controller tolerates."""
        return abs(self.measured - self.stated) > TOLERANCE_S


def main(options: argparse.Namespace, command: str) -> int:
    """Ask or measure; exit status 1 if a robot refused, did not move, or its lag differs."""
    folder = cells.find(options.cell)
    cell = cells.load(folder)
    arms = cells.chosen_arms(cell, options.arm)
    served = [arm for arm in arms if robot_service.serves(options.action, cell.arms[arm])]
    for arm in served:
        robot_service.serve(options.action, cell.arms[arm], folder)
    arms = [arm for arm in arms if arm not in served]
    if not arms:
        return 0
    system = running.of_cell(folder, options.port)
    if system is None:
        raise Problem(
            f"no system of {folder.name} is running. Start it with ./surg up {options.cell}, "
            + (
                "enable the arm, then repeat this command and move the arm"
                if options.action == "lag"
                else "then repeat this command"
            )
        )
    if options.action == "rehearse":
        return max(_rehearse(system, cell.arms[arm], folder) for arm in arms)
    if options.action != "lag":
        return _ask(system.master_uri, arms, options.action)
    lags = _measure(system.master_uri, arms, options.timeout)
    say(table([row(arm, lags.get(arm)) for arm in arms]))
    for arm in arms:
        if text := advice(arm, lags.get(arm)):
            warn(f"surg: {text}")
    return 1 if any(advice(arm, lags.get(arm)) for arm in arms) else 0


def _rehearse(system: running.System, arm: Any, folder: Path) -> int:
    """Perform the first stop that an arm has not passed; exit status 1 where it fails."""
    from surg_cli.robots import rehearse_stop

    if arm.hardware is None:
        raise Problem(f"{arm.name}: link {arm.link!r} has nothing to rehearse", 2)
    serial = f"{arm.hardware.serial}{' (emulated)' if arm.hardware.emulated else ''}"
    data = folder / f"rehearsal_{arm.name}.jsonl"
    page = data.with_suffix(".md")
    step = rehearsal.next_step(rehearsal.load(data), serial)
    if step is None:
        say(f"{arm.name}: all stops are passed: {page}")
        return 0
    does = step.do or f"this program kills the {step.victim}"
    confirm(f"{arm.name}: {step.name}. The arm will move at 10 mm/s; then {does}. Ready?")
    outcome = rehearse_stop.perform(system, arm, folder, step)
    rehearsal.append(data, outcome)
    outcomes = rehearsal.load(data)
    page.write_text(rehearsal.report(outcomes, f"{arm.name} of {folder.name}"), "utf-8")
    say(f"{step.name}: {'; '.join(outcome.problems) or 'passed'}; report: {page}")
    after = step.after.replace("robot CELL", f"robot {folder.name}")
    say(f"Then: {after}; ./surg robot {folder.name} start; ./surg robot {folder.name} rehearse")
    return 1 if outcome.problems else 0


def _ask(uri: str, arms: list[str], word: str) -> int:
    """Ask each robot for something, and print what it is doing then."""
    failed = False
    with RobotRequests(uri, arms) as links:
        for arm in arms if word != "status" else ():
            if refusal := links.ask(arm, word):
                warn(f"surg: {arm}: {refusal}")
                failed = True
        statuses = links.statuses()
        say(table([status_row(arm, statuses[arm]) for arm in arms]))
    return 1 if failed or None in statuses.values() else 0


def status_row(arm: str, status: Any) -> list[str]:
    """One line of the table; status None: its link says nothing."""
    if status is None:
        return [arm, "no link", "start it, or see ./surg status"]
    serial = f"serial {status.serial}" if status.serial else "no serial"
    return [arm, condition_name(status), serial, status.fault]


def row(arm: str, lag: Lag | None) -> list[str]:
    """One line of the table."""
    if lag is None:
        return [arm, "no diagnostics"]
    found = "not known" if math.isnan(lag.measured) else f"{1e3 * lag.measured:.1f} ms"
    return [arm, f"measured {found}", f"link_lag {1e3 * lag.stated:.1f} ms"]


def advice(arm: str, lag: Lag | None) -> str:
    """What to do about a lag; empty: nothing."""
    if lag is None:
        return f"{arm}: its controller sent no diagnostics; see ./surg status"
    if math.isnan(lag.measured):
        return f"{arm} moved too little: its joints need 0.1 rad/s for about half a second"
    if lag.differs:
        return (
            f"{arm}: set link_lag to {lag.measured:.4f} s. The pivot then follows as exactly as "
            "the link allows"
        )
    return ""


def lags_of(statuses: Any) -> dict[str, Lag]:
    """Arm -> its lag, of the statuses of one diagnostic_msgs/DiagnosticArray."""
    found = {}
    for status in statuses:
        arm, _, node = status.name.partition("/")
        values = {pair.key: pair.value for pair in status.values}
        if node == "controller" and "link_lag_s" in values:
            found[arm] = Lag(float(values["link_lag_stated_s"]), float(values["link_lag_s"]))
    return found


def _measure(uri: str, arms: list[str], timeout_s: float) -> dict[str, Lag]:
    """Listen until every arm's lag is known, or time is up."""
    os.environ["ROS_MASTER_URI"] = uri
    import rospy
    from diagnostic_msgs.msg import DiagnosticArray

    lags: dict[str, Lag] = {}
    lock = threading.Lock()

    def heard(message: Any) -> None:
        with lock:
            lags.update(lags_of(message.status))

    def missing() -> list[str]:
        with lock:
            return [a for a in arms if a not in lags or math.isnan(lags[a].measured)]

    rospy.init_node("surg_robot", anonymous=True, disable_signals=True)
    rospy.Subscriber("/diagnostics", DiagnosticArray, heard)
    end = time.monotonic() + timeout_s
    with Progress("robot lag") as progress:
        while (still := missing()) and (left := end - time.monotonic()) > 0:
            progress.update(1 - left / timeout_s, f"move {' and '.join(still)}")
            time.sleep(LOOK_S)
    rospy.signal_shutdown("measured")
    with lock:
        return dict(lags)
