"""The check-up of an arm through its own driver: it connects and listens, and moves nothing.

For every link whose vendor library only a driver has: FR3, Panda, and drivers from elsewhere.
"""

from __future__ import annotations

import contextlib
import select
import socket
import subprocess
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from surg_hardware import checkup, identity
from surg_hardware.arm_driver import FIRST_CONNECTION
from surg_hardware.checkup import Finding
from surg_hardware.conditions import Condition
from surg_hardware.driver_datagrams import (
    LONGEST,
    IdentityDatagram,
    NoticeDatagram,
    StateDatagram,
    decode_from_driver,
)
from surg_hardware.driver_process import is_emulated
from surg_hardware.driver_start import start_driver
from surg_hardware.link_programs import NoProgram

if TYPE_CHECKING:
    import surg_core

START_TIME = 6.0
"""[s] For the driver's interpreter and its library."""
CONNECTION = "check power, cable and address; release the brakes and activate FCI in Desk"


@dataclass
class Heard:
    """What a driver has said.

    Attributes:
        states: With joints, and their arrivals on our clock [s].
        newest: The newest state, with or without joints.
        identity: What the robot says of itself.
        notices: Its sentences for people.
        refusal: Why it has ended; empty: it has not.
    """

    states: list[tuple[float, StateDatagram]] = field(default_factory=list)
    newest: StateDatagram | None = None
    identity: IdentityDatagram | None = None
    notices: list[str] = field(default_factory=list)
    refusal: str = ""

    def read(self, node: socket.socket, now: float) -> None:
        """Take all messages that have come until now [s]."""
        with contextlib.suppress(BlockingIOError):
            while data := node.recv(LONGEST):
                self.take(decode_from_driver(data), now)

    def take(self, message: object, now: float) -> None:
        """Take a message that has come [s]."""
        if isinstance(message, StateDatagram):
            self.newest = message
            if message.q:
                self.states.append((now, message))
        elif isinstance(message, IdentityDatagram):
            self.identity = message
        elif isinstance(message, NoticeDatagram):
            self.notices.append(message.text)


def examine(arm: surg_core.Arm, seconds: float) -> list[Finding]:
    """All findings about the arm at the cell's address.

    Args:
        arm: Of the cell, with hardware.
        seconds: How long its states are measured [s].
    """
    try:
        heard = listen(arm, seconds)
    except NoProgram as error:
        text, _, cure = str(error).rpartition(": ")
        return [Finding("link", text, False, cure)]
    return findings(arm, heard)


def listen(arm: surg_core.Arm, seconds: float) -> Heard:
    """Start the driver, and hear it for some time after its first state."""
    driver, node = start_driver(arm, subprocess.PIPE)
    heard = Heard()
    end = time.monotonic() + START_TIME + FIRST_CONNECTION
    with driver, node:
        try:
            while time.monotonic() < end and driver.poll() is None:
                select.select((node,), (), (), 0.1)
                first, now = not heard.states, time.monotonic()
                heard.read(node, now)
                if first and heard.states:
                    end = now + seconds
        finally:
            driver.terminate()
            _, errors = driver.communicate()
    if driver.returncode not in (0, -15) or heard.newest is None:
        heard.refusal = errors.decode(errors="replace").strip() or "the driver said nothing"
    return heard


def findings(arm: surg_core.Arm, heard: Heard) -> list[Finding]:
    """What is good and what is wrong by a driver's words."""
    assert arm.hardware is not None
    address, status = arm.hardware.address, heard.newest and heard.newest.status
    if heard.refusal or status is None:
        words = heard.refusal.splitlines()[-1].removeprefix(f"{address}: ")
        words = words.removeprefix("hardware.address: ")
        return [Finding("hardware.address", f"{address}: {words}", False, CONNECTION)]
    found = [Finding("hardware.address", f"a robot answers at {address}"), _condition(heard)]
    for text in dict.fromkeys(heard.notices):
        found.append(Finding("notice", text, False, "see the page of this link"))
    if heard.identity is not None:
        found += identity.findings(arm, heard.identity.q, heard.identity.said)
    if len(heard.states) > 2:
        stamps = [1e-9 * state.stamp_ns for _, state in heard.states]
        exchange = checkup.Exchange.of(stamps, [arrival for arrival, _ in heard.states])
        # The stamps are on our clock: the driver has followed the robot's.
        found.append(checkup.exchange_findings(exchange, is_emulated(address))[0])
    return found


def _condition(heard: Heard) -> Finding:
    """Brakes, stops, hands: what the robot would say to `start`."""
    assert heard.newest is not None
    status = heard.newest.status
    if status.condition is Condition.READY:
        return Finding("condition", "brakes released, no stop")
    text, _, cure = status.fault.rpartition(": ")
    if status.condition is Condition.OFFLINE:
        cure = CONNECTION
    return Finding("condition", text or status.fault, False, cure)
