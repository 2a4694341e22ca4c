"""`./surg record`: start, stop and tag a recording of a running system; declare an edit of one."""

from __future__ import annotations

import argparse
import json
import os
import time
from typing import Any

from surg_cli.graph import follow, master, processes, running
from surg_cli.graph.watch import Watch
from surg_cli.host.option_types import tcp_port
from surg_cli.host.terminal import CliError, Progress, say, warn

ACTIONS = {
    "start": "begin an episode",
    "stop": "end it and wait for its files",
    "status": "what is being recorded, what was dropped, what is missing",
    "tag": "note TEXT at this moment",
    "stage": "the stage TEXT begins now",
}
FACTS = ("operator", "task", "setting", "seed")
SUCCESS = "success"
_NO_REASONS = ("success", "succeeded", "failure", "failed", "yes", "no", "true", "false")
_WITH_TEXT = ("tag", "stage")
STATUS = "/record/status"
CONNECT_S = 5.0
START_S = 20.0
STOP_S = 120.0


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = "\n".join(f"  {name:7s} {text}" for name, text in ACTIONS.items())
    add = parser.add_argument
    add("action", choices=tuple(ACTIONS), metavar="ACTION", help=", ".join(ACTIONS))
    add("text", nargs="?", default="", metavar="TEXT", help="of tag, stage")
    add("--port", type=tcp_port, metavar="P", help="of the ROS master")
    add(
        "--info",
        nargs="+",
        action="extend",
        type=_fact,
        default=[],
        metavar="KEY=VALUE",
        help=f"start: {', '.join(FACTS)}, for the manifest",
    )
    add("--outcome", type=_outcome, metavar="X", help="stop: success, or why it failed")


def _fact(text: str) -> tuple[str, str]:
    key, _, value = text.partition("=")
    if key not in FACTS or not value:
        known = ", ".join(f"{name}=…" for name in FACTS)
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: {known}")
    return key, value


def _outcome(text: str) -> str:
    if not text.strip() or (text != SUCCESS and text.strip().lower() in _NO_REASONS):
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: {SUCCESS}, or why it failed")
    return text


def main(options: argparse.Namespace, command: str) -> int:
    """Do one thing; exit status 1 when the recorder says that something is wrong."""
    action = options.action
    if action in _WITH_TEXT and not options.text:
        raise CliError(f"record {action}: TEXT is missing", 2)
    if action not in _WITH_TEXT and options.text:
        raise CliError(f"record {action}: takes no text ({options.text!r})", 2)
    for option, of in (("outcome", "stop"), ("info", "start")):
        if getattr(options, option) and action != of:
            raise CliError(f"--{option} belongs to record {of}", 2)
    with Recorder(_port(options.port)) as recorder:
        return _do(recorder, action, options)


def _do(recorder: Recorder, action: str, options: argparse.Namespace) -> int:
    """One action on a recorder that has been found."""
    if action == "start":
        return _start(recorder, options)
    status = recorder.status
    if action == "status":
        _show(status)
        return 0 if status.problem == status.PROBLEM_NONE else 1
    if status.state != status.STATE_RECORDING:
        raise CliError(f"record {action}: nothing is being recorded (./surg record start)")
    if action == "stop":
        return _stop(recorder, options)
    recorder.annotate("tag", json.dumps({action: options.text}))
    say(f"record: {action} {options.text!r}")
    return 0


def _start(recorder: Recorder, options: argparse.Namespace) -> int:
    status = recorder.status
    if status.state == status.STATE_RECORDING:
        raise CliError(f"record start: {status.folder} is being recorded already")
    if options.info:
        recorder.annotate("info", json.dumps(dict(options.info)))
    recorder.record(True)
    with Progress("record"):
        answered = processes.wait_until(
            lambda: recorder.record_status.starts not in (0, status.starts), START_S
        )
    begun = recorder.status
    if not answered or begun.state != begun.STATE_RECORDING:
        raise CliError(f"record start: {begun.detail or 'the recorder does not answer'}")
    say(f"recording {begun.folder}")
    return 0


def _stop(recorder: Recorder, options: argparse.Namespace) -> int:
    if options.outcome:
        failed = "" if options.outcome == SUCCESS else options.outcome
        recorder.annotate("tag", json.dumps({"success": not failed, "reason": failed}))
    recorder.record(False)
    with Progress("record"):
        done = processes.wait_until(lambda: follow.recorder_idle(recorder), STOP_S)
    if not done:
        raise CliError(f"record stop: not finished after {STOP_S:g} s; ./surg record status")
    status = recorder.status
    for text in status.warnings:
        warn(f"surg: {text}")
    say(status.finished)
    if status.problem != status.PROBLEM_NONE:
        warn(f"surg: incomplete: {status.detail}")
        return 1
    return 0


def _show(status: Any) -> None:
    """The status in words."""
    if status.state == status.STATE_IDLE:
        last = f"; the last one is {status.finished}" if status.finished else ""
        say(f"record: nothing is being recorded{last}")
    else:
        finishing = status.state == status.STATE_FINISHING
        say(f"{'finishing' if finishing else 'recording'} {status.folder}")
        for stream in status.streams:
            unit = "rows" if stream.kind == stream.KIND_TABLE else "frames"
            lost = f", {stream.dropped} DROPPED" if stream.dropped else ""
            say(f"  {stream.name}: {stream.received} {unit}{lost}")
        for topic in status.waiting_for:
            say(f"  nothing yet on {topic}")
    for text in status.warnings:
        say(f"  warning: {text}")
    if status.problem != status.PROBLEM_NONE:
        say(f"  problem: {status.detail}")


def _port(given: int | None) -> int:
    """Port of the system that is meant."""
    if given is not None:
        return given
    systems = running.systems()
    if not systems:
        raise CliError("no system of this checkout is running (./surg up CELL, or --port)")
    return systems[0].port


class Recorder(Watch):
    """The recorder of a running system, over its topics.

    Raises:
        CliError: There is no master at this port, or no recorder.
    """

    def __init__(self, port: int) -> None:
        uri = f"http://localhost:{port}"
        master.nodes(uri)
        os.environ["ROS_MASTER_URI"] = uri
        super().__init__((), "surg_record")
        import rospy
        from std_msgs.msg import String

        self._texts = {
            name: rospy.Publisher(f"/record/{name}", String, queue_size=10)
            for name in ("tag", "info")
        }
        publishers = [self._record_switch, *self._texts.values()]

        def connected() -> bool:
            reached = all(publisher.get_num_connections() > 0 for publisher in publishers)
            return reached and not self.problem(STATUS)

        if not processes.wait_until(connected, CONNECT_S):
            why = f" ({problem})" if (problem := self.problem(STATUS)) else ""
            rospy.signal_shutdown("no recorder")
            raise CliError(f"no recorder runs beside the ROS master at {uri}{why}")

    @property
    def status(self) -> Any:
        """The newest surg_msgs/RecordStatus.

        Raises:
            CliError: There is none that is valid and fresh.
        """
        if problem := self.problem(STATUS):
            raise CliError(f"the recorder's status must not be acted on: {problem}")
        return self.record_status

    def annotate(self, topic: str, text: str) -> None:
        """Publish JSON for the manifest on /record/TOPIC."""
        self._texts[topic].publish(text)
        time.sleep(0.2)  # a start or stop on another topic must not overtake it
