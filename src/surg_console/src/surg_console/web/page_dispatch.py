"""Hands the messages of a page to the session."""

from __future__ import annotations

from surg_console.session import operator_messages
from surg_console.session.console_session import ConsoleSession
from surg_console.session.system_state import Robot
from surg_console.web.page_protocol import (
    JUDGEMENTS,
    Hidden,
    Input,
    PageMessage,
    Press,
    ProtocolError,
    Scale,
)


def dispatch(
    session: ConsoleSession, message: PageMessage, page: str, robot: Robot, now: float
) -> str:
    """Hand a message of the control socket to the session; returns why it is refused.

    Raises:
        ProtocolError: It belongs on another socket.
    """
    if isinstance(message, Input):
        session.receive(page, message, now)
        return ""
    if isinstance(message, Press):
        return _press(session, message, page, robot, now)
    if isinstance(message, Hidden):
        session.hide(page, message.why)
        return ""
    if isinstance(message, Scale):
        return session.scale(page, message.value)
    raise ProtocolError(f"{type(message).__name__.lower()} does not belong on this socket")


def _press(session: ConsoleSession, message: Press, page: str, robot: Robot, now: float) -> str:
    in_time = session.in_time(page, message.at, now)
    if message.button == "stop":  # obeyed however late
        session.stop(robot, page)
        return ""
    if message.button == "release":
        session.release(page)
        return ""
    if not in_time:
        return operator_messages.LATE
    if message.button == "take":
        return session.take(page, now)
    if message.button == "enable":
        return session.enable(page, robot, now)
    if message.button == "guide_home":
        return session.guide_home(page, robot)
    if message.button == "policy":
        return session.policy(page, robot, now)
    if message.button == "new_episode":
        return session.new_episode(page, robot, now)
    if message.button in JUDGEMENTS:
        return session.judge(page, robot)
    return session.record(page, robot, message.button == "record")
