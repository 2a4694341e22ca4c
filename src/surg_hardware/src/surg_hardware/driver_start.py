"""Starts the driver of an arm, in the Python that its link wants."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from dataclasses import asdict
from typing import TYPE_CHECKING

from surg_hardware.driver_settings import DriverSettings
from surg_hardware.link_programs import NoProgram, driver_name, driver_words, search_path

if TYPE_CHECKING:
    import surg_core


def driver_settings(arm: surg_core.Arm) -> DriverSettings:
    """What the driver needs of an arm.

    Raises:
        ConfigError: The cell states no hardware for it, or nothing drives its link.
    """
    from surg_core import ConfigError

    hardware = arm.hardware
    if hardware is None:
        raise ConfigError(f"arms.{arm.name}.hardware: is missing; link_node needs it")
    try:
        driver = driver_name(arm.link, arm.driver)
    except NoProgram as error:
        raise ConfigError(f"arms.{arm.name}.{error}") from error
    return DriverSettings(
        address=hardware.address,
        realtime=hardware.realtime,
        velocity=tuple(arm.robot.velocity.tolist()),
        # The controller keeps to the link's share of it.
        acceleration=tuple((arm.robot.acceleration / arm.link_config.acceleration).tolist()),
        dead_man=arm.link_config.dead_man,
        stop_deceleration=arm.link_config.stop_deceleration,
        driver=driver,
        options=dict(arm.link_settings),
    )


def start_driver(
    arm: surg_core.Arm, errors: int | None = None
) -> tuple[subprocess.Popen[bytes], socket.socket]:
    """Start the driver of an arm; it moves nothing until it is asked to.

    Args:
        arm: Of a cell, with hardware.
        errors: Where its standard error goes, as `subprocess.Popen` takes it.

    Returns:
        Its process, and the socket that speaks with it; it does not block.

    Raises:
        ConfigError: The cell states no hardware for it, or nothing drives its link.
        NoProgram: The environment of the driver is missing.
    """
    settings = driver_settings(arm)
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    program = driver_words(arm.link, arm.driver)
    ours_only = program[0] == sys.executable
    driver = subprocess.Popen(
        [*program, json.dumps(asdict(settings)), str(theirs.fileno())],
        pass_fds=(theirs.fileno(),),
        stdin=subprocess.DEVNULL,
        stderr=errors,
        env=None if ours_only else {**os.environ, "PYTHONPATH": search_path()},
    )
    theirs.close()
    ours.setblocking(False)
    return driver, ours
