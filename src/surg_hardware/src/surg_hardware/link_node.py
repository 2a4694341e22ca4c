"""The node of a link to a real arm: its topics on one side, the driver's process on the other.

Parameters: ``~cell`` (folder or cell.yaml), ``~arm``. Exit code 0: shut down; 2: this robot must
not be driven, with the reason on stderr. A driver that ends by itself is started again; the arm
moves again only after a person has started it.
"""

from __future__ import annotations

import contextlib
import gc
import select
import socket
import struct
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import rospy
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import String

import surg_core
from crtk_msgs.msg import OperatingState, StringStamped
from surg_hardware import identity
from surg_hardware.conditions import OFFLINE, Condition
from surg_hardware.driver_datagrams import (
    LONGEST,
    CommandDatagram,
    DatagramError,
    IdentityDatagram,
    NoticeDatagram,
    RequestDatagram,
    StateDatagram,
    decode_from_driver,
)
from surg_hardware.driver_process import NotHere, is_emulated, realtime
from surg_hardware.driver_start import driver_settings, start_driver
from surg_hardware.robot_link import Status
from surg_msgs.msg import LinkStatus
from surg_ros import link_messages
from surg_ros.byte_topics import BytesPublisher, as_bytes
from surg_ros.params import read, text

STATUS_PERIOD = 0.02
"""[s]"""
SILENCE = 0.04
"""[s] Without a word of the driver, after which the robot counts as lost."""
RESTART = 1.0
"""[s] Pause before a driver that has ended is started again."""
FAREWELL = 1.0
"""[s] For the driver to bring the arm to rest at the end."""
REFUSED = 2
"""Exit code of a driver whose robot must not be driven."""


@dataclass(frozen=True)
class Parameters:
    """Parameters of the node."""

    cell: str = text()
    arm: str = text()


class LinkNode:
    """One arm's link on topics."""

    def __init__(self, arm: surg_core.Arm, cell: str) -> None:
        self._arm, self._cell, self._settings = arm, cell, driver_settings(arm)
        self._layout = link_messages.JointStateLayout(list(arm.robot.joint_names))
        self._serial = ""
        self._status = Status(Condition.OFFLINE, OFFLINE.text, False, 0, 1.0)
        self._said: Status | None = None
        self._said_at = self._heard_at = 0.0
        self._tick = self._stamp_ns = 0
        self._known = False  # whether this is the arm that the cell means
        self._enabled = False
        self.refusal = ""
        """Why this robot must not be driven; empty: no reason yet."""
        root = f"/{arm.name}"
        self._state_out = BytesPublisher(f"{root}/robot/measured_js", JointState, blocking=False)
        self._status_out = BytesPublisher(f"{root}/robot/status", LinkStatus, blocking=False)
        self._force_out = BytesPublisher(f"{root}/robot/measured_cf", WrenchStamped, blocking=False)
        self._force_frame = link_messages.text(f"{arm.name}_base")
        self._warning_out = rospy.Publisher(f"{root}/warning", String, queue_size=10)
        self._driver, self._socket = self._start_driver()
        keys: dict[str, Any] = {"tcp_nodelay": True}
        rospy.Subscriber(f"{root}/robot/servo_jv", as_bytes(JointState), self._on_velocity, **keys)
        rospy.Subscriber(f"{root}/robot/request", StringStamped, self._on_request, **keys)
        rospy.Subscriber(f"{root}/operating_state", OperatingState, self._on_operating_state)

    # --- the driver's process -------------------------------------------------------------------

    def _start_driver(self) -> tuple[subprocess.Popen[bytes], socket.socket]:
        driver, ours = start_driver(self._arm)
        self._heard_at = time.monotonic()
        return driver, ours

    def run(self) -> int:
        """Serve until shutdown; returns the exit code."""
        try:
            while not rospy.is_shutdown() and not self.refusal:
                select.select((self._socket,), (), (), STATUS_PERIOD)
                self._hear()
                self._check_silence()
                self._say_status()
                if (code := self._driver.poll()) is not None:
                    if code == REFUSED:
                        return REFUSED
                    self._restart_driver(code)
        finally:
            self._end_driver()
        if self.refusal:
            print(self.refusal, file=sys.stderr, flush=True)
            return REFUSED
        return 0

    def _restart_driver(self, code: int) -> None:
        self._warn(f"the driver of the robot has ended ({code}); it is started again")
        self._socket.close()
        self._lose("the driver of the robot has ended")
        self._say_status()
        time.sleep(RESTART)
        self._known = False
        self._driver, self._socket = self._start_driver()

    def _end_driver(self) -> None:
        self._driver.terminate()
        try:
            self._driver.wait(FAREWELL)
        except subprocess.TimeoutExpired:
            self._driver.kill()
            self._driver.wait()

    # --- from the driver ------------------------------------------------------------------------

    def _hear(self) -> None:
        """Take what the driver has sent; of several states the newest one counts."""
        newest: StateDatagram | None = None
        try:
            while data := self._socket.recv(LONGEST):
                try:
                    message = decode_from_driver(data)
                except DatagramError as error:
                    self._warn(f"from the driver: {error}")
                    continue
                if isinstance(message, StateDatagram):
                    newest = message
                elif isinstance(message, NoticeDatagram):
                    self._warn(message.text)
                else:
                    self._check_identity(message)
        except (BlockingIOError, ConnectionError):
            pass
        if newest is None:
            return
        self._heard_at = time.monotonic()
        self._status, self._tick = newest.status, newest.tick
        if newest.q:
            self._stamp_ns = newest.stamp_ns
            self._publish_state(newest)

    def _publish_state(self, state: StateDatagram) -> None:
        # The status first: the arrival of the joint state starts the controller's work.
        self._say_status()
        q, qd = np.array(state.q), np.array(state.qd)
        self._state_out.send(self._layout.pack(state.tick, state.stamp_ns, q, qd))
        if state.wrench:
            frame = self._force_frame
            self._force_out.send(
                link_messages.pack_wrench(state.tick, state.stamp_ns, frame, state.wrench)
            )

    def _check_silence(self) -> None:
        if time.monotonic() - self._heard_at > SILENCE:
            self._lose(OFFLINE.text)

    def _lose(self, why: str) -> None:
        """The robot counts as lost; a sentence that says more than that stays."""
        if self._status.condition is not Condition.OFFLINE:
            self._status = replace(self._status, condition=Condition.OFFLINE, fault=why)

    def _check_identity(self, found: IdentityDatagram) -> None:
        """Whether this is the arm that the cell means; another one is refused for good."""
        self._serial = found.said.serial or ""
        wrong = identity.all_mismatches(self._arm, found.q, found.said)
        if wrong:
            sentences = "; ".join(map(str, wrong)).replace("robot CELL", f"robot {self._cell}")
            self.refusal = f"{self._arm.name}: {sentences}"
        self._known = not wrong

    # --- to the driver --------------------------------------------------------------------------

    def _on_velocity(self, message: Any) -> None:
        try:
            stamp_ns, _, velocity = link_messages.unpack_joint_state(message.data)
        except struct.error as error:
            self._warn(f"robot/servo_jv: unreadable message: {error}")
            return
        self._tell(CommandDatagram(stamp_ns, tuple(velocity.tolist())).pack())

    def _on_request(self, message: StringStamped) -> None:
        if message.string == "start" and not self._known:
            self._warn("start: the robot has not said yet which one it is: wait")
            return
        self._tell(RequestDatagram(message.string, self._enabled).pack())

    def _on_operating_state(self, message: OperatingState) -> None:
        self._enabled = message.state == "ENABLED"

    def _tell(self, data: bytes) -> None:
        # A driver that has ended, or that does not read, stops the arm by its own dead-man.
        with contextlib.suppress(OSError):
            self._socket.send(data)

    # --- topics ---------------------------------------------------------------------------------

    def _say_status(self) -> None:
        """Publish the status on change, and 50 times a second."""
        now = time.monotonic()
        lasting = replace(self._status, last_command_ns=0)
        if lasting == self._said and now - self._said_at < STATUS_PERIOD:
            return
        self._said, self._said_at = lasting, now
        status = self._status
        emulated = " (emulated)" if is_emulated(self._settings.address) else ""
        says = link_messages.LinkSays(
            condition=status.condition,
            command="joint_velocity",
            last_command_ns=status.last_command_ns,
            dead_man=status.dead_man,
            lockstep=False,
            fault=status.fault.replace("robot CELL", f"robot {self._cell}"),
            speed_scaling=status.speed_scaling,
            serial=self._serial + emulated,
        )
        stamp_ns = self._stamp_ns or time.time_ns()
        self._status_out.send(says.pack(stamp_ns, self._tick))

    def _warn(self, sentence: str) -> None:
        rospy.logwarn(f"{self._arm.name}: {sentence}")
        self._warning_out.publish(String(f"{self._arm.name}: {sentence}"))


def main() -> int:
    """Entry point; returns the exit code."""
    rospy.init_node("link")
    sys.setswitchinterval(1e-4)  # commands arrive on a thread of their own
    try:
        parameters = read(Parameters, rospy.get_param("~", {}))
        cell = surg_core.load_cell(parameters.cell)
        if parameters.arm not in cell.arms:
            raise ValueError(f"~arm {parameters.arm!r}; allowed: {', '.join(cell.arms)}")
        arm = cell.arms[parameters.arm]
        settings = driver_settings(arm)
        # Threads inherit it: those that receive commands start later.
        realtime(settings.realtime - 1, settings.address)
        node = LinkNode(arm, cell.folder.name)
    except (ValueError, OSError, NotHere) as error:
        print(f"surg_hardware: {error}", file=sys.stderr, flush=True)
        return REFUSED
    gc.freeze()  # a collection of all that was imported would hold commands up for 20 ms and more
    return node.run()


if __name__ == "__main__":
    sys.exit(main())
