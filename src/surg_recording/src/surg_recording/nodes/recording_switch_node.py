"""Starts and stops recordings."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rospy

from surg_core.contract import TICK_NS
from surg_core.host.niceness import give_way
from surg_recording.episode import provenance
from surg_recording.episode.episode_reader import PARTIAL
from surg_recording.episode.episode_recorder import Recording
from surg_recording.episode.recovery import recover
from surg_recording.nodes.recorder_state import RecorderState
from surg_recording.nodes.ros_master_node import parameters
from surg_recording.recording_errors import EpisodeError

SETTLE_S = 0.3
"""Silence after which no message sent before the stop is expected [s]."""
STOP_WAIT_S = 10.0
"""Longest wait for that silence in lock-step [s]."""
FREERUN_STOP_S = 0.5
"""The same in free-run, where the arms never fall silent [s]."""
FRAME_WAIT_S = 2.0
"""Longest wait for the next frame of a camera that lags behind the ticks [s]."""


class RecordingSwitch:
    """Begins and ends episodes; calls from several threads are serialised.

    ``announce`` is called after every start and stop.
    """

    def __init__(self, state: RecorderState, announce: Callable[[], None]) -> None:
        self._state, self._announce = state, announce
        self._lock = threading.RLock()
        self._described: dict[str, Any] | None = None  # the cell at the start of the recording

    def start(self) -> None:
        """Begin an episode; does nothing while one is being recorded."""
        with self._lock:
            state, settings = self._state, self._state.settings
            if state.recording is not None:
                return
            manifest: dict[str, Any] = {
                **state.facts,
                "clock": "simulator ticks" if state.lockstep else "wall clock",
                "started_ns": state.clock.now_ns(),
                "cell": (cell := self._cell()),
                "parameters": parameters(),
                "versions": provenance.versions(),
                "host": provenance.host(),
            }
            state.forget_duplicates()
            try:
                state.recording = Recording(
                    settings.out,
                    mode=settings.mode,
                    arms=settings.arms,
                    cameras=list(settings.camera_topics),
                    manifest=manifest,
                    min_free_bytes=settings.min_free_bytes,
                    video_preset=settings.video_preset,
                    video_quality=settings.video_quality,
                )
                state.problem = state.finished = None
                state.started = True
                self._described = cell
            except EpisodeError as problem:
                state.problem, state.started = str(problem), False
                rospy.logerr("recording does not start: %s", problem)
            state.starts += 1
            for arm, text in state.operating_states.items():
                state.event(f"/{arm}/operating_state", "", text)
            self._announce()

    def _cell(self) -> dict[str, Any] | None:
        cell = self._state.settings.cell
        return provenance.describe_cell(cell, self._state.mounted) if cell else None

    def _names_the_tools(self) -> bool:
        """Whether the cell was described with the tools that are mounted.

        A controller may say what it has after the start of the recording.
        """
        arms = (self._described or {}).get("arms", {})
        known = {name: entry["mounted"] for name, entry in arms.items()}
        return all(known.get(arm, files) == files for arm, files in self._state.mounted.items())

    def tool_mounted(self, arm: str, files: str) -> None:
        """Note an arm's tool. A recording has one tool per arm: a change ends it."""
        with self._lock:
            recording, before = self._state.recording, self._state.mounted.get(arm)
            if recording is not None and before is not None:
                recording.warn(f"{arm}: the tool was changed from {before!r} to {files!r}")
                self.stop()
            self._state.mounted[arm] = files

    def stop(self) -> None:
        """End the episode: wait for messages in transit, write everything, finish the folder."""
        with self._lock:
            state, recording = self._state, self._state.recording
            if recording is None:
                return
            state.finishing = True
            if not recording.failed:
                self._settle(recording)
            state.recording = None
            self._warn_of_silence(recording)
            stopped = state.clock.now_ns()
            try:
                self._close(recording, stopped)
            except EpisodeError as problem:
                state.problem = str(problem)
            except Exception as problem:  # the folder stays; the next start recovers it
                state.problem = f"not finished: {type(problem).__name__}: {problem}"
            finally:
                state.finishing = False
                state.warnings = recording.warnings
            if state.problem:
                rospy.logerr("recording incomplete: %s", state.problem)
            self._announce()

    def _close(self, recording: Recording, stopped_ns: int) -> None:
        state = self._state
        duplicates = state.duplicates
        known = {
            **state.facts,
            "sim": state.sim_outcome,
            **({} if self._names_the_tools() else {"cell": self._cell()}),
            "stopped_ns": stopped_ns,
            "repeats": duplicates,
            "camera_info": dict(state.camera_models),
            **({"drift": state.drift} if state.drift else {}),
        }
        folder = recording.close(
            known,
            topics=state.choice.describe(duplicates),
            end_stamp_ns=state.episode_now(stopped_ns),
        )
        state.finished, state.problem = str(folder), recording.problem
        _start_sync_report(folder)

    def _warn_of_silence(self, recording: Recording) -> None:
        """Warn of requested topics that never sent a message."""
        choice = self._state.choice
        messages = {topic: entry["messages"] for topic, entry in recording.topics().items()}
        for topic in choice.silent(messages):
            recording.warn(f"{topic}: nothing was received")
        for topic, why in choice.refused.items():
            recording.warn(f"{topic}: not recorded as a table: {why}")

    def _settle(self, recording: Recording) -> None:
        """Wait until everything that was sent before the stop has arrived."""
        state = self._state
        deadline = time.monotonic() + (STOP_WAIT_S if state.lockstep else FREERUN_STOP_S)
        while time.monotonic() < deadline and time.monotonic() - state.last_row <= SETTLE_S:
            time.sleep(0.02)
        if state.lockstep:  # cameras may be many frames behind the ticks
            for camera in state.settings.camera_topics:
                _await_frames(recording, camera, state.tick * TICK_NS)


def _await_frames(recording: Recording, camera: str, end_ns: int) -> None:
    """Wait while frames arrive and the camera's next one is due before ``end_ns``."""
    since, newest = time.monotonic(), -1
    while time.monotonic() - since < FRAME_WAIT_S:
        last, period = recording.cameras.newest(camera)
        if not last or last > end_ns - period:
            return
        if last != newest:
            since, newest = time.monotonic(), last
        time.sleep(0.02)
    last, period = recording.cameras.newest(camera)
    if last + 2 * period <= end_ns:  # the end itself is uncertain by one frame
        recording.note(f"{camera}: ends {(end_ns - last) * 1e-9:.2f} s before the motion")


def _start_sync_report(folder: Path) -> None:
    """Make sync.json in a process of low priority: it decodes the videos. Nobody waits for it."""
    argv = [sys.executable, "-m", "surg_recording.clock.sync_report", "--quiet", str(folder)]
    try:
        report = subprocess.Popen(
            argv, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True
        )
        give_way(10, report.pid)
    except OSError as problem:
        rospy.logwarn("no sync.json: %s", problem.strerror)


def recover_interrupted(parent: Path, name: str) -> None:
    """Finish the recordings of killed recorders: of this name now, those of other runs later."""

    def report(folders: list[Path]) -> None:
        for folder in folders:
            rospy.logwarn("an earlier recording was cut off; what it held is now in %s", folder)

    def refused(problem: str) -> None:
        rospy.logerr("an earlier recording cannot be recovered: %s", problem)

    def other_runs() -> None:
        # Each run has a folder of its own beside this one.
        for run in sorted({path.parent for path in parent.parent.glob(f"*/{name}*{PARTIAL}")}):
            if run != parent:
                report(recover(run, name, refused))

    report(recover(parent, name, refused))
    threading.Thread(target=other_runs, name="recover", daemon=True).start()
