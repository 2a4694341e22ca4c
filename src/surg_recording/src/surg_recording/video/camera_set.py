"""The cameras of an episode: their sinks, and which of them have fallen silent."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from surg_recording.video.camera_sink import CameraSink
from surg_recording.video.image_frame import Frame

START_S = 10.0
"""Time for the encoders to start [s]; after that, frames wait in memory."""

STALL_PERIODS = 3
"""Number of missed frame periods after which a camera counts as silent."""

STALL_MIN_S = 0.15
"""Shortest silence that counts [s]."""

STALLED = "fell silent for more than"
"""In the warning of a camera; the console's list of episodes looks for it."""


class CameraSet:
    """Writes all cameras of an episode; options as for ``VideoSink``."""

    def __init__(self, folder: Path, names: Sequence[str], **options: Any) -> None:
        self.sinks: dict[str, CameraSink] = {}
        self._problems: list[str] = []
        self._heard: dict[str, float] = {}
        self._silent: dict[str, float] = {}
        self._lost: Counter[str] = Counter()
        for name in names:
            try:
                self.sinks[name] = CameraSink(folder, name, **options)
            except OSError as problem:
                self._problems.append(f"{name}: no encoder ({problem.strerror})")
        deadline = time.monotonic() + START_S
        for sink in self.sinks.values():
            sink.part.wait_ready(max(0.0, deadline - time.monotonic()))

    def put(self, name: str, frame: Frame) -> None:
        """Record a frame; blocks in lock-step when the encoder is behind."""
        sink = self.sinks.get(name)
        if sink is None:
            self._lost[name] += 1
            return
        self._heard[name] = time.monotonic()
        sink.put(frame)

    def changes(self, now: float) -> list[tuple[str, str, str]]:
        """Cameras that fell silent or came back by ``now`` [s]: event topic, its text, warning."""
        events = []
        for name, heard in list(self._heard.items()):
            allowed = max(STALL_MIN_S, STALL_PERIODS * self.sinks[name].newest[1] * 1e-9)
            since = self._silent.get(name)
            if since is None and now - heard > allowed:
                self._silent[name] = heard
                warning = f"{name}: {STALLED} {allowed:.2f} s"
                events.append(
                    ("camera_stall", f"{name}: no frame for {now - heard:.2f} s", warning)
                )
            elif since is not None and heard > since:
                del self._silent[name]
                text = f"{name}: frames again after {heard - since:.2f} s"
                events.append(("camera_back", text, ""))
        return events

    @property
    def silent(self) -> list[str]:
        """Cameras that have fallen silent."""
        return sorted(self._silent)

    @property
    def problems(self) -> list[str]:
        """Why videos are incomplete."""
        errors = [f"{name}: {sink.error}" for name, sink in self.sinks.items() if sink.error]
        return [*self._problems, *errors]

    def drops(self) -> dict[str, int]:
        """Frames received but not written."""
        return {**self._lost, **{name: sink.dropped for name, sink in self.sinks.items()}}

    def newest(self, camera: str) -> tuple[int, int]:
        """Stamp of a camera's newest image and its distance to the one before [ns]; 0: none."""
        sink = self.sinks.get(camera)
        return sink.newest if sink else (0, 0)

    def last_skip(self, camera: str) -> str:
        """Why the last image that a camera lost could not be recorded, in brackets; or nothing."""
        sink = self.sinks.get(camera)
        skipped = sink.last_skip if sink else None
        return f" (the last that could not be recorded: {skipped})" if skipped else ""

    def describe(self) -> dict[str, Any]:
        """The manifest's entry of each camera's stream."""
        return {name: sink.describe() for name, sink in self.sinks.items()}

    def close(self, timeout_s: float) -> list[str]:
        """Write the backlogs and finish the files; returns the cameras without any image."""
        for sink in self.sinks.values():
            sink.close(timeout_s)
        return [name for name, sink in self.sinks.items() if not sink.received]
