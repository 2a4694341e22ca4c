"""Keeps the process of one device running and hands on what it delivers."""

from __future__ import annotations

import contextlib
import fcntl
import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict

from surg_perception.capture import frame_pipe
from surg_perception.capture.capture_parameters import CaptureSettings
from surg_perception.capture.frame_pipe import DeviceState, Pictures

PIPE_BYTES = 1 << 20
"""What Linux allows without privileges."""
RESTART_S = 1.0
HUNG_S = 5.0
"""A device that is open and delivers nothing for so long is taken for hung; its process is started
anew."""


class DeviceReader:
    """One device.

    Args:
        settings: Of its process.
        take: Called with every message, in the reader's thread.
        watch_hung: Whether silence of an open device is a fault; a file may end.
    """

    def __init__(
        self,
        settings: CaptureSettings,
        take: Callable[[Pictures | DeviceState], None],
        watch_hung: bool = True,
    ) -> None:
        self._settings, self._take = settings, take
        self._open, self._heard = False, time.monotonic()
        self._closing = threading.Event()
        self._child: subprocess.Popen[bytes] | None = None
        self._threads = [threading.Thread(target=self._run, name="device", daemon=True)]
        if watch_hung:
            self._threads.append(threading.Thread(target=self._watch, name="hung", daemon=True))
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End the process and the threads."""
        self._closing.set()
        self._kill()
        for thread in self._threads:
            thread.join(2.0)

    def _run(self) -> None:
        while not self._closing.is_set():
            status = self._once()
            if self._closing.wait(RESTART_S):
                return
            text = f"{self._settings.source}: its process ended with status {status}; restarting it"
            self._take(DeviceState("failed", f"endoscope.source: {text}"))

    def _once(self) -> int:
        """Run the process until it ends; returns its exit status."""
        argv = [sys.executable, "-m", "surg_perception.capture.device_process"]
        child = subprocess.Popen(
            [*argv, json.dumps(asdict(self._settings))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        self._child = child
        assert child.stdout is not None
        with contextlib.suppress(OSError):  # a smaller pipe works, too
            fcntl.fcntl(child.stdout, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        try:
            while (message := frame_pipe.read(child.stdout)) is not None:  # type: ignore[arg-type]
                self._heard = time.monotonic()
                if isinstance(message, DeviceState):
                    self._open = message.code == frame_pipe.OPEN
                self._take(message)
        except frame_pipe.FramePipeError as error:
            self._take(DeviceState("failed", str(error)))
        self._open = False
        self._kill()
        return child.wait()

    def _watch(self) -> None:
        while not self._closing.wait(1.0):
            if self._open and time.monotonic() - self._heard > HUNG_S:
                self._open = False
                text = f"{self._settings.source}: no picture for {HUNG_S:.0f} s: opened anew"
                self._take(DeviceState("hung", f"endoscope.source: {text}"))
                self._kill()

    def _kill(self) -> None:
        child = self._child
        if child is not None:
            with contextlib.suppress(ProcessLookupError):
                child.kill()
