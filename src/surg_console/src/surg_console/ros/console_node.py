"""The operator console as a node: serves the page, and is a CRTK leader on topics.

Parameters: ``~cell`` (folder or cell.yaml); ``~arm`` (the first with jaws) and ``~arms`` (others to
show); ``~leader`` (browser; empty: another device moves the arm), ``~teleop`` (name of the
teleoperation node); ``~views`` (left; or left,right; empty: no camera); ``~episodes`` (the
recorder's ``~out``); ``~language`` (JSON of the task's ``instruction`` and ``stages``);
``~bind`` (127.0.0.1), ``~port`` (8090), ``~host_names``, ``~cert``, ``~key``,
``~token_file``: who may connect (docs/guide/console.md). Exit code 1: the port cannot be had; 2: a
parameter that must not be used.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rospy

import surg_core
from surg_console.ros.ros_system_node import RosSystem
from surg_console.session.console_session import ConsoleSession
from surg_console.session.task_view import TaskView
from surg_console.web import access
from surg_console.web.console_server import ConsoleServer
from surg_console.web.encoder_process import EncoderProcess
from surg_ros.master_check import master_is_online
from surg_ros.params import ParamError, names, path, read, text, whole

PORT = 8090
LIMITS = (
    *("rcm_error_warn", "rcm_error_fault", "trocar_force_warn", "trocar_force_fault"),
    *("tip_force_soft", "tip_force_hard", "depth_min", "depth_max"),
)
"""Limits of the driven arm that the page shows."""


@dataclass(frozen=True)
class Parameters:
    """Parameters of the node."""

    cell: str = text(allowed="the folder of the cell")
    arm: str = text("", empty=True)
    arms: tuple[str, ...] = names(())
    leader: str = text("browser", empty=True)
    teleop: str = text("teleop")
    views: tuple[str, ...] = names(("left",))
    episodes: Path | None = path(None)
    language: str = text("", empty=True)
    bind: str = text("127.0.0.1")
    port: int = whole(1, 65535, PORT)
    host_names: tuple[str, ...] = names(())
    cert: Path | None = path(None)
    key: Path | None = path(None)
    token_file: Path | None = path(None)

    def __post_init__(self) -> None:
        if self.views not in ((), ("left",), ("left", "right")):
            raise ParamError("views", list(self.views), "left, or left,right")


class Settings:
    """The node's parameters, read once.

    Raises:
        ParamError, access.AccessError, surg_core.ConfigError: One must not be used.
    """

    def __init__(self, given: dict[str, Any]) -> None:
        parameters = read(Parameters, given)
        self.cell = surg_core.load_cell(parameters.cell)
        instruments = [a.name for a in self.cell.arms.values() if a.instrument.camera is None]
        self.arm = parameters.arm or (instruments[0] if instruments else "")
        if self.arm not in instruments:
            raise ParamError("arm", self.arm, ", ".join(instruments) or "none of this cell")
        others = parameters.arms or tuple(self.cell.arms)
        self.arms = (self.arm, *(name for name in others if name != self.arm))
        if not set(self.arms) <= set(self.cell.arms):
            raise ParamError("arms", list(others), f"arms of the cell: {', '.join(self.cell.arms)}")
        self.views = parameters.views
        self.leader = parameters.leader.strip("/")
        self.teleop = parameters.teleop.strip("/")
        self.episodes = parameters.episodes
        try:
            self.task = TaskView(parameters.language)
        except ValueError as error:
            raise ParamError("language", parameters.language[:40], f"JSON ({error})") from None
        self.access = access.rules(
            parameters.bind,
            parameters.port,
            parameters.host_names,
            parameters.cert,
            parameters.key,
            access.read_token(parameters.token_file) if parameters.token_file else "",
        )

    @property
    def overlays(self) -> list[str]:
        """What the page can show over and beside the picture."""
        held = any(arm.instrument.camera is not None for arm in self.cell.arms.values())
        over = (["marks"] if held else []) + ["plan"]
        return [*(over if self.views else []), "scene"]

    @property
    def limits(self) -> dict[str, float]:
        """What the page draws its bars against [SI]."""
        limits = self.cell.arms[self.arm].limits
        guard = surg_core.clearance_setup(self.cell, self.arm)
        kept = {} if guard is None else {"clearance": guard.distance}
        return {name: float(getattr(limits, name)) for name in LIMITS} | kept


async def serve(settings: Settings, stop: asyncio.Event) -> None:
    """Run the console until `stop` is set.

    Raises:
        OSError: The port cannot be had.
    """
    system = RosSystem(
        settings.cell, settings.arms, settings.leader, settings.teleop, settings.episodes
    )
    facts = {
        "cell": settings.cell.config.name,
        "arm": settings.arm,
        "views": list(settings.views),
        "leads": bool(settings.leader),
        "overlays": settings.overlays,
        "limits": settings.limits,
    }
    name = f"{rospy.get_name().strip('/').replace('/', '_')}_video"
    argv = [sys.executable, "-s", "-m", "surg_console.ros.video_node", name]
    encoder = EncoderProcess(
        [*argv, ",".join(settings.views)],
        show=lambda packet: server.show(packet),
        problem=lambda text: server.picture_problem(text),
    )
    session = ConsoleSession(pictures=bool(settings.views), leads=bool(settings.leader))
    server = ConsoleServer(
        settings.access, session, system, encoder, facts, settings.limits, settings.task
    )
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
    if not master_is_online("console"):
        return 1
    rospy.init_node("console", disable_signals=True)
    try:
        settings = Settings(dict(rospy.get_param("~", {})))
    except (ParamError, access.AccessError, surg_core.ConfigError) as error:
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
