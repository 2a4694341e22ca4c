"""`./surg record`: start, stop and tag a recording of a running system."""

from __future__ import annotations

import argparse
import json
import os
import threading
import time
from typing import Any

from surg_cli.graph import master, processes, running
from surg_cli.host.option_types import tcp_port
from surg_cli.host.terminal import Problem, Progress, say, warn

ACTIONS = {
    "start": "begin an episode",
    "stop": "end it and wait for its files",
    "status": "what is being recorded, what was dropped, what is missing",
    "tag": "note TEXT at this moment",
    "stage": "the stage TEXT begins now",
}
CONNECT_S = 5.0
START_S = 20.0
STOP_S = 120.0


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = "\n".join(f"  {name:7s} {text}" for name, text in ACTIONS.items())
    add = parser.add_argument
    add("action", choices=tuple(ACTIONS), metavar="ACTION", help=", ".join(ACTIONS))
    add("text", nargs="?", default="", metavar="TEXT", help="of tag and stage")
    add("--port", type=tcp_port, metavar="P", help="of the ROS master")
    for fact in ("operator", "task", "setting", "seed"):
        add(f"--{fact}", metavar="X", help=f"start: the {fact}, for the manifest")
    verdict = parser.add_mutually_exclusive_group()
    verdict.add_argument("--success", action="store_true", help="stop: the episode succeeded")
    verdict.add_argument("--failure", metavar="WHY", help="stop: it failed, and why")


def main(options: argparse.Namespace, command: str) -> int:
    """Do one thing; exit status 1 when the recorder says that something is wrong."""
    action = options.action
    if action in ("tag", "stage") and not options.text:
        raise Problem(f"record {action}: TEXT is missing", 2)
    if action not in ("tag", "stage") and options.text:
        raise Problem(f"record {action}: takes no text ({options.text!r})", 2)
    judged = options.success or options.failure is not None
    if judged and action != "stop":
        raise Problem("--success and --failure belong to record stop", 2)
    recorder = Recorder(_port(options.port))
    try:
        return _do(recorder, action, options)
    finally:
        recorder.close()


def _do(recorder: Recorder, action: str, options: argparse.Namespace) -> int:
    """One action on a recorder that has been found."""
    if action == "start":
        return _start(recorder, options)
    if action == "status":
        _show(recorder.status)
        return 1 if recorder.status.get("problem") else 0
    if not recorder.status.get("recording"):
        raise Problem(f"record {action}: nothing is being recorded (./surg record start)")
    if action == "stop":
        return _stop(recorder, options)
    recorder.say("tag", json.dumps({action: options.text}))
    say(f"record: {action} {options.text!r}")
    return 0


def _start(recorder: Recorder, options: argparse.Namespace) -> int:
    if recorder.status.get("recording"):
        raise Problem(f"record start: {recorder.status.get('folder')} is being recorded already")
    facts = {k: getattr(options, k) for k in ("operator", "task", "setting", "seed")}
    known = {key: value for key, value in facts.items() if value is not None}
    if known:
        recorder.say("info", json.dumps(known))
        time.sleep(0.2)  # another topic: it must be there before the start
    before = recorder.status.get("starts")
    recorder.switch(True)
    with Progress("record"):
        processes.wait_until(lambda: recorder.status.get("starts") != before, START_S)
    status = recorder.status
    if not status.get("recording"):
        raise Problem(f"record start: {status.get('problem') or 'the recorder does not answer'}")
    say(f"recording {status.get('folder')}")
    return 0


def _stop(recorder: Recorder, options: argparse.Namespace) -> int:
    if options.success or options.failure is not None:
        verdict = {"success": options.success, "reason": options.failure or ""}
        recorder.say("tag", json.dumps(verdict))
        time.sleep(0.2)
    recorder.switch(False)
    with Progress("record"):
        done = processes.wait_until(lambda: not recorder.status.get("recording"), STOP_S)
    if not done:
        raise Problem(f"record stop: not finished after {STOP_S:g} s; ./surg record status")
    status = recorder.status
    for text in status.get("warnings") or []:
        warn(f"surg: {text}")
    say(str(status.get("finished")))
    if status.get("problem"):
        warn(f"surg: incomplete: {status['problem']}")
        return 1
    return 0


def _show(status: dict[str, Any]) -> None:
    """The status in words."""
    if not status.get("recording"):
        said = "nothing is being recorded"
        last = status.get("finished")
        say(f"record: {said}" + (f"; the last one is {last}" if last else ""))
    else:
        say(f"recording {status.get('folder')}")
        for key in ("rows", "frames"):
            for name, count in (status.get(key) or {}).items():
                dropped = (status.get("drops") or {}).get(name, 0)
                say(f"  {name}: {count} {key}" + (f", {dropped} DROPPED" if dropped else ""))
        for topic in status.get("waiting_for") or []:
            say(f"  nothing yet on {topic}")
    for text in status.get("warnings") or []:
        say(f"  warning: {text}")
    if status.get("problem"):
        say(f"  problem: {status['problem']}")


def _port(given: int | None) -> int:
    """Port of the system that is meant."""
    if given is not None:
        return given
    systems = running.systems()
    if not systems:
        raise Problem("no system of this checkout is running (./surg up CELL, or --port)")
    return systems[0].port


class Recorder:
    """The recorder of a running system, over its topics."""

    def __init__(self, port: int) -> None:
        """Become a ROS node and find the recorder.

        Raises:
            Problem: There is no master, or no recorder.
        """
        uri = f"http://localhost:{port}"
        master.nodes(uri)
        os.environ["ROS_MASTER_URI"] = uri
        import rospy
        from std_msgs.msg import Bool, String

        rospy.init_node("surg_record", anonymous=True, disable_signals=True)
        self._lock = threading.Lock()
        self._status: dict[str, Any] = {}
        self._bool, self._string = Bool, String
        self._switch = rospy.Publisher("/record/record", Bool, queue_size=1)
        self._said = {
            name: rospy.Publisher(f"/record/{name}", String, queue_size=10)
            for name in ("tag", "info")
        }
        self._ear = rospy.Subscriber("/record/status", String, self._hear)
        ends = [self._switch, *self._said.values()]
        if not processes.wait_until(
            lambda: bool(self.status) and all(e.get_num_connections() > 0 for e in ends), CONNECT_S
        ):
            self.close()
            raise Problem(f"no recorder runs beside the ROS master at {uri}")

    @property
    def status(self) -> dict[str, Any]:
        """The newest /record/status."""
        with self._lock:
            return dict(self._status)

    def switch(self, on: bool) -> None:
        """Start or stop."""
        self._switch.publish(self._bool(on))

    def say(self, topic: str, text: str) -> None:
        """Publish a text on /record/TOPIC."""
        self._said[topic].publish(self._string(text))

    def close(self) -> None:
        """Leave the graph."""
        import rospy

        time.sleep(0.1)  # what was published last must leave this process
        rospy.signal_shutdown("surg is done")

    def _hear(self, message: Any) -> None:
        try:
            status = json.loads(message.data)
        except ValueError:
            return
        with self._lock:
            self._status = status if isinstance(status, dict) else {}
