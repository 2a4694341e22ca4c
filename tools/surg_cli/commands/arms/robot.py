"""`./surg robot CELL ACTION`: power, start, stop and guide the robots of a cell; their lag."""

from __future__ import annotations

import argparse
import math
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from surg_cli.graph import master, running
from surg_cli.host import cells
from surg_cli.host.option_types import tcp_port
from surg_cli.host.terminal import CliError, Progress, confirm, report_findings, say, table, warn
from surg_cli.robots import drive_service, rehearsal, robot_doctor, robot_service
from surg_cli.robots.robot_request import RobotRequests, condition_name

ACTIONS = {
    "status": "condition of each robot, and what to do",
    "start": "let each robot obey its commands; nothing moves by it",
    "stop": "bring each robot to rest; it obeys nothing until the next start",
    "guide": "let a person guide each robot by hand, until stop",
    "lag": "measure the lag of each arm's link from its motion",
    **robot_service.ACTIONS,
    "doctor": "examine each arm, its link and its calibrations; moves nothing",
    "drive": "of the instrument: find, id, home or test, as the word behind it",
    "rehearse": "lead through the next stop of the rehearsal, measure it, write the report",
}
TOLERANCE_S = 0.003
"""Above this difference the controller warns (docs/reference/safety.md)."""
SPREAD_S = 0.0015
"""Joints whose lags differ by more are stated one by one."""
LATE_SHARE = 0.01
"""Of late cycles: with more, the age of a state says little, and the lag is not believed."""
TIMEOUT_S = 60.0
LOOK_S = 0.1
JOINTS_S = 5.0
"""The wait for joints that have hardly moved, once the lag of all together is known."""


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
    words = "; ".join(f"{word}: {text}" for word, text in drive_service.WORDS.items())
    add("word", nargs="?", choices=tuple(drive_service.WORDS), help=f"behind drive. {words}")
    add("--arm", metavar="ARM", help="only this arm (default: every arm)")
    add("--port", type=tcp_port, metavar="P", help="of the ROS master")


@dataclass(frozen=True)
class Lag:
    """A link's lag [s], stated and measured (NaN: not enough motion yet).

    Attributes:
        stated: Of the slowest joint.
        measured: Of all joints together.
        joints_stated: Of each joint; empty: one value is stated for all.
        joints: Of each joint, measured.
        late: Largest share of late control cycles in the meantime.
    """

    stated: float
    measured: float
    joints_stated: tuple[float, ...] = ()
    joints: tuple[float, ...] = ()
    late: float = 0.0

    @property
    def unmoved(self) -> list[int]:
        """Joints that have moved too little, counted from 1."""
        return [i for i, lag in enumerate(self.joints, 1) if math.isnan(lag)]

    @property
    def unequal(self) -> bool:
        """Whether the joints differ so much that each needs its own value."""
        known = [lag for lag in self.joints if not math.isnan(lag)]
        return bool(known) and max(known) - min(known) > SPREAD_S

    @property
    def differs(self) -> bool:
        """Whether stated and measured lags differ by more than the controller tolerates."""
        if self.joints_stated:
            pairs = zip(self.joints, self.joints_stated, strict=False)
            return any(abs(measured - stated) > TOLERANCE_S for measured, stated in pairs)
        return self.unequal or abs(self.measured - self.stated) > TOLERANCE_S


def main(options: argparse.Namespace, command: str) -> int:
    """Ask or measure; exit status 1 if a robot refused, did not move, or its lag differs."""
    if options.word is not None and options.action != "drive":
        raise CliError(f"robot: {options.word!r} is a word behind drive, not {options.action}", 2)
    if options.action == "doctor":
        seconds = robot_doctor.MEASURED_S
        return report_findings(robot_doctor.findings(options.cell, options.arm, seconds))
    folder = cells.find(options.cell)
    cell = cells.load(folder)
    arms = cells.chosen_arms(cell, options.arm)
    if options.action == "drive":
        return drive_service.serve(options.word, folder, cell, arms, options.port)
    served = [arm for arm in arms if robot_service.serves(options.action, cell.arms[arm])]
    for arm in served:
        robot_service.serve(options.action, cell.arms[arm], folder)
    arms = [arm for arm in arms if arm not in served]
    if not arms:
        return 0
    system = running.of_cell(folder, options.port)
    if system is None:
        raise CliError(
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
    lags = _measure(system.master_uri, arms, TIMEOUT_S)
    say(table([row(arm, lags.get(arm)) for arm in arms]))
    for arm in arms:
        if text := advice(arm, lags.get(arm)):
            warn(f"surg: {text}")
    return 1 if any(advice(arm, lags.get(arm)) for arm in arms) else 0


def _rehearse(system: running.System, arm: Any, folder: Path) -> int:
    """Perform the first stop that an arm has not passed; exit status 1 where it fails."""
    from surg_cli.robots import rehearse_stop

    if arm.hardware is None:
        raise CliError(f"{arm.name}: link {arm.link!r} has nothing to rehearse", 2)
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
    with master.joined(uri, "surg_robot"):
        links = RobotRequests(arms)
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
    each = lag.joints if lag.unequal else (lag.measured,)
    return [arm, f"measured {_ms(each)}", f"link_lag {_ms(lag.joints_stated or (lag.stated,))}"]


def _ms(lags: tuple[float, ...]) -> str:
    """In milliseconds."""
    words = ["not known" if math.isnan(lag) else f"{1e3 * lag:.1f} ms" for lag in lags]
    return ", ".join(words)


def advice(arm: str, lag: Lag | None) -> str:
    """What to do about a lag; empty: nothing."""
    if lag is None:
        return f"{arm}: its controller sent no diagnostics; see ./surg status"
    enough = "0.1 rad/s for about half a second"
    if math.isnan(lag.measured):
        return f"{arm} moved too little: its joints need {enough}"
    if not lag.differs:
        return ""
    if lag.late > LATE_SHARE:
        return (
            f"{arm}: {100 * lag.late:.0f} % of the control cycles were late, so this lag is not to "
            "be believed; link_lag stays as it is. Free the CPU, then repeat this command"
        )
    value = f"{lag.measured:.4f} s"
    if lag.unequal and lag.unmoved:
        joints = ", ".join(map(str, lag.unmoved))
        return f"{arm}: the lags of its joints differ; joints that moved too little: {joints}. " + (
            f"Each needs {enough}; then repeat this command"
        )
    if lag.unequal:
        value = f"[{', '.join(f'{each:.4f}' for each in lag.joints)}] s, one value per joint"
    return f"{arm}: set link_lag to {value}. The pivot then follows as exactly as the link allows"


def lags_of(statuses: Any) -> dict[str, Lag]:
    """Arm -> its lag, of the statuses of one diagnostic_msgs/DiagnosticArray."""
    found = {}
    for status in statuses:
        arm, _, node = status.name.partition("/")
        values = {pair.key: pair.value for pair in status.values}
        if node == "controller" and "link_lag_s" in values:
            found[arm] = Lag(
                float(values["link_lag_stated_s"]),
                float(values["link_lag_s"]),
                _numbers(values.get("joint_lag_stated_s", "")),
                _numbers(values.get("joint_lag_s", "")),
                float(values.get("late_share", "0")),
            )
    return found


def _numbers(text: str) -> tuple[float, ...]:
    """Numbers with spaces between them."""
    return tuple(float(word) for word in text.split())


def _measure(uri: str, arms: list[str], timeout_s: float) -> dict[str, Lag]:
    """Listen until every arm's lag is known, of its joints if they move, or time is up."""
    import rospy
    from diagnostic_msgs.msg import DiagnosticArray

    lags: dict[str, Lag] = {}
    lock = threading.Lock()

    def heard(message: Any) -> None:
        with lock:
            for arm, lag in lags_of(message.status).items():
                before = lags[arm].late if arm in lags else 0.0
                lags[arm] = replace(lag, late=max(before, lag.late))

    def missing() -> list[str]:
        with lock:
            return [a for a in arms if a not in lags or math.isnan(lags[a].measured)]

    def unmoved() -> bool:
        with lock:
            return any(lags[arm].unmoved for arm in arms)

    end = time.monotonic() + timeout_s
    with master.joined(uri, "surg_robot"), Progress("robot lag") as progress:
        rospy.Subscriber("/diagnostics", DiagnosticArray, heard)
        while (still := missing()) and (left := end - time.monotonic()) > 0:
            progress.update(1 - left / timeout_s, f"move {' and '.join(still)}")
            time.sleep(LOOK_S)
        end = min(end, time.monotonic() + JOINTS_S)
        while not still and unmoved() and time.monotonic() < end:
            time.sleep(LOOK_S)
    with lock:
        return dict(lags)
