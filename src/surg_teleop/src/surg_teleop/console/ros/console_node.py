"""The operator console as a node: serves the page, and is a CRTK leader on topics.

Parameters: ``~cell`` (folder or cell.yaml); ``~arm`` (the first with jaws) and ``~arms`` (others to
show); ``~leader`` (browser; empty: another device moves the arm), ``~teleop`` (name of the
teleoperation node); ``~views`` (left; or left,right; empty: no camera); ``~episodes`` (the
recorder's ``~out``); ``~bind`` (127.0.0.1), ``~port`` (8090), ``~host_names``, ``~cert``, ``~key``,
``~token_file``: who may connect (docs/guide/console.md). Exit code 1: the port cannot be had; 2: a
parameter that must not be used.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import sys
from pathlib import Path
from typing import Any

import rosgraph
import rospy

import surg_core
from surg_teleop.console.ros.ros_system_node import RosSystem
from surg_teleop.console.session.console_session import Session
from surg_teleop.console.web import access
from surg_teleop.console.web.encoder_process import EncoderProcess
from surg_teleop.console.web.web_server import Server

PORT = 8090
KEYS = (
    *("cell", "arm", "arms", "leader", "teleop", "views", "episodes"),
    *("bind", "port", "host_names", "cert", "key", "token_file"),
)
LIMITS = (
    *("rcm_error_warn", "rcm_error_fault", "trocar_force_warn", "trocar_force_fault"),
    *("tip_force_soft", "tip_force_hard", "depth_min", "depth_max"),
)
"""Limits of the driven arm that the page shows."""


class ParameterError(ValueError):
    """A parameter that must not be used: which, its value, what is allowed."""


def names(value: Any) -> tuple[str, ...]:
    """A list parameter, also as a rosrun line gives it: ``a,b``."""
    items = value.split(",") if isinstance(value, str) else value
    if not isinstance(items, list):
        raise ParameterError(f"{value!r}; allowed: names, with commas between them")
    return tuple(str(item).strip() for item in items if str(item).strip())


class Settings:
    """The node's parameters, read once.

    Raises:
        ParameterError, access.AccessError, surg_core.ConfigError: One must not be used.
    """

    def __init__(self, given: dict[str, Any]) -> None:
        unknown = sorted(set(given) - set(KEYS))
        if unknown:
            raise ParameterError(f"~{unknown[0]} is unknown; allowed: ~{' ~'.join(KEYS)}")
        if not given.get("cell"):
            raise ParameterError("~cell is missing: the folder of the cell")
        self.cell = surg_core.load_cell(str(given["cell"]))
        instruments = [a.name for a in self.cell.arms.values() if a.instrument.camera is None]
        self.arm = str(given.get("arm") or instruments[0] if instruments else "")
        if self.arm not in instruments:
            allowed = ", ".join(instruments) or "none of this cell"
            raise ParameterError(f"~arm: '{self.arm}'; allowed: {allowed}")
        others = names(given.get("arms", list(self.cell.arms)))
        self.arms = (self.arm, *(name for name in others if name != self.arm))
        strangers = sorted(set(self.arms) - set(self.cell.arms))
        if strangers:
            raise ParameterError(f"~arms: no arm '{strangers[0]}' in this cell")
        self.views = names(given.get("views", ["left"]))
        if self.views not in ((), ("left",), ("left", "right")):
            raise ParameterError(f"~views: {','.join(self.views)}; allowed: left, or left,right")
        self.leader = str(given.get("leader", "browser")).strip("/")
        self.teleop = str(given.get("teleop", "teleop")).strip("/")
        self.episodes = Path(str(given["episodes"])) if given.get("episodes") else None
        port = given.get("port", PORT)
        if isinstance(port, bool) or not isinstance(port, int) or not 1 <= port <= 65535:
            raise ParameterError(f"~port: {port!r}; allowed: 1 to 65535")
        files = {
            key: Path(str(given[key])) for key in ("cert", "key", "token_file") if given.get(key)
        }
        self.access = access.rules(
            str(given.get("bind", "127.0.0.1")),
            port,
            names(given.get("host_names", [])),
            files.get("cert"),
            files.get("key"),
            access.read_token(files["token_file"]) if "token_file" in files else "",
        )

    @property
    def limits(self) -> dict[str, float]:
        """What the page draws its bars against [SI]."""
        limits = self.cell.arms[self.arm].limits
        return {name: float(getattr(limits, name)) for name in LIMITS}


async def serve(settings: Settings, stop: asyncio.Event) -> None:
    """Run the console until `stop` is set.

    Raises:
        OSError: The port cannot be had.
    """
    system = RosSystem(settings.arms, settings.leader, settings.teleop, settings.episodes)
    facts = {
        "cell": settings.cell.config.name,
        "arm": settings.arm,
        "views": list(settings.views),
        "leads": bool(settings.leader),
        "limits": settings.limits,
    }
    name = f"{rospy.get_name().strip('/').replace('/', '_')}_video"
    argv = [sys.executable, "-s", "-m", "surg_teleop.console.ros.video_node", name]

    def show(packet: Any) -> None:
        server.show(packet)

    def problem(text: str) -> None:
        server.picture_problem(text)

    encoder = EncoderProcess([*argv, ",".join(settings.views)], show, problem)
    session = Session(pictures=bool(settings.views), leads=bool(settings.leader))
    server = Server(settings.access, session, system, encoder, facts, settings.limits)
    video = asyncio.create_task(encoder.run()) if settings.views else None
    try:
        print(f"console: {settings.access.url}", flush=True)
        await server.serve(stop)
    finally:
        if video is not None:
            video.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await video


async def _run(settings: Settings) -> None:
    loop, stop = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    rospy.on_shutdown(lambda: loop.is_closed() or loop.call_soon_threadsafe(stop.set))
    await serve(settings, stop)


def main() -> int:
    """Run the node; returns the exit code."""
    if not rosgraph.is_master_online():
        uri = rosgraph.get_master_uri()
        print(f"console: no ROS master at {uri}; start one with './surg teleop'", file=sys.stderr)
        return 1
    rospy.init_node("console", disable_signals=True)
    try:
        settings = Settings(dict(rospy.get_param("~", {})))
    except (ParameterError, access.AccessError, surg_core.ConfigError) as error:
        print(f"console: {error}", file=sys.stderr)
        return 2
    # Hand the interpreter over quickly: an input must not wait for a status.
    sys.setswitchinterval(1e-3)
    try:
        asyncio.run(_run(settings))
    except OSError as error:
        where = f"{settings.access.bind}, port {settings.access.port}"
        print(f"console: cannot listen on {where}: {error.strerror}", file=sys.stderr)
        return 1
    finally:
        rospy.signal_shutdown("the console has ended")
    return 0
