"""Records one episode, without ROS: messages in, an episode folder out.

Failures of the disk or a camera raise nothing: ``problem`` states why the episode will be
incomplete, and everything else is still recorded.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from surg_recording.clock.clock_steps import CLOCK_STEP, FUTURE_NS
from surg_recording.episode import table_columns, table_rows
from surg_recording.episode.annotations import Annotations, Tag
from surg_recording.episode.csv_sink import CsvTable, CsvWriter
from surg_recording.episode.episode_reader import TOPICS
from surg_recording.episode.episode_writer import MIN_FREE_BYTES, EpisodeWriter
from surg_recording.episode.message_fields import Flat
from surg_recording.episode.topic_tables import TopicTables
from surg_recording.video.camera_set import CameraSet
from surg_recording.video.image_frame import frame_of
from surg_recording.video.video_encoder import CRF

TASK_STATE = "task_state"
"""Table of a task's ground truth."""

FREERUN_QUEUE = 5000
"""Rows per table that may wait in free-run: 10 s at 500 Hz."""

DISK_CHECK_S = 0.5
"""Period of the check of free disk space [s]."""

STOP_FREE_BYTES = 32 << 20
"""Free space at which a recording ends by itself [bytes]; leaves room to finish the folder."""


class Recording:
    """An episode that is being recorded. All methods may be called from any thread."""

    def __init__(
        self,
        final: Path,
        *,
        mode: str,
        arms: Sequence[str],
        cameras: Sequence[str],
        manifest: Mapping[str, Any],
        min_free_bytes: int = MIN_FREE_BYTES,
        video_preset: str = "ultrafast",
        video_quality: str = str(CRF),
        stop_free_bytes: int = STOP_FREE_BYTES,
    ) -> None:
        """Create the folder and start writing.

        Args:
            final: The episode folder.
            mode: ``lockstep`` (nothing is dropped, senders wait) or ``freerun`` (bounded queues).
            arms: Names of the arms.
            cameras: Names of the cameras.
            manifest: Facts known at the start.
            min_free_bytes: Free space needed to start [bytes].
            video_preset: Preset of x264.
            video_quality: crf of x264, or ``lossless``.
            stop_free_bytes: Free space at which the recording ends by itself [bytes].

        Raises:
            EpisodeError: The folder cannot be created.
        """
        self.arms = list(arms)
        self._lockstep = mode == "lockstep"
        self._stop_free = min(stop_free_bytes, min_free_bytes)
        facts = {"mode": mode, "arms": self.arms, "cameras": list(cameras), **manifest}
        self._folder = EpisodeWriter(final, facts, min_free_bytes)
        self._limit = None if self._lockstep else FREERUN_QUEUE
        self._writer = CsvWriter()
        self._tables: dict[str, CsvTable] = {}
        self._topics = TopicTables(self._open_topic, self.warn)
        self._annotations = Annotations()
        self._segments: list[dict[str, Any]] = []
        self._future: dict[str, int] = {}
        self._known_forces: dict[str, int] = {}  # stamps of forces that are known, by table
        self._warnings: list[str] = []
        self._lock = threading.Lock()
        self._problems: list[str] = []
        self._disk_checked = 0.0
        self._disk_full = False
        for arm in self.arms:
            self._table(f"command_{arm}", table_columns.COMMAND)
        self._table("events", table_columns.EVENTS)
        self.cameras = CameraSet(
            self.folder,
            cameras,
            block=self._lockstep,
            preset=video_preset,
            quality=video_quality,
            keep_open=(self._folder.lock,),
        )

    # --- state ----------------------------------------------------------------------------------

    @property
    def folder(self) -> Path:
        """Where files are being written now."""
        return self._folder.folder

    @property
    def problem(self) -> str | None:
        """Why this episode will be incomplete; None if it is complete so far."""
        rows_lost = [f"rows lost: {self._writer.error}"] if self._writer.error else []
        problems = [*self._problems, *rows_lost, *self.cameras.problems]
        return "; ".join(dict.fromkeys(problems)) or None

    @property
    def failed(self) -> bool:
        """Whether the disk is full or broken, so that recording must end."""
        if not self._disk_full and time.monotonic() - self._disk_checked > DISK_CHECK_S:
            self._disk_checked = time.monotonic()
            try:
                free = self._folder.free_bytes()
            except OSError as problem:
                self._disk_full = True
                self._problems.append(f"disk lost: {problem.strerror}")
            else:
                if free < self._stop_free:
                    self._disk_full = True
                    self._problems.append(f"disk full: {free / 2**20:.0f} MiB left")
        return self._disk_full or self._writer.error is not None

    @property
    def warnings(self) -> list[str]:
        """Warnings so far."""
        return list(self._warnings)

    def warn(self, text: str) -> None:
        """Add a warning to the manifest; the recording stays complete."""
        if text not in self._warnings:
            self._warnings.append(text)

    def note(self, problem: str) -> None:
        """Mark the episode as incomplete."""
        self._problems.append(problem)

    def written_tick(self) -> int:
        """Newest tick whose cycles and ground truths of all arms have been handed to the kernel."""
        ticks = []
        for arm in self.arms:
            for name in (f"cycle_{arm}", f"ground_truth_{arm}"):
                table = self._tables.get(name)
                column = 2  # both tables: stamp_ns, receive_ns, tick
                ticks.append(table.last[column] if table is not None and table.last else 0)
        return min(ticks, default=0)

    def newest_image(self, camera: str) -> tuple[int, int]:
        """Stamp of a camera's newest image and its distance to the one before [ns]; 0: none."""
        sink = self.cameras.sinks.get(camera)
        return sink.newest if sink else (0, 0)

    def topics(self) -> dict[str, dict[str, Any]]:
        """Type, tables and truncated fields of every further topic."""
        return self._topics.describe()

    def status(self) -> dict[str, Any]:
        """Counters: rows, frames, drops, backlog."""
        tables, sinks = dict(self._tables), self.cameras.sinks
        return {
            "folder": str(self._folder.final),
            "rows": {name: table.rows for name, table in tables.items()},
            "frames": {name: sink.frames for name, sink in sinks.items()},
            "drops": self._drops(),
            "backlog": {
                "rows": sum(table.backlog for table in tables.values()),
                "frames": sum(sink.part.backlog for sink in sinks.values()),
            },
            "warnings": self.warnings,
            "future_stamps": dict(self._future),
            "silent_cameras": self.cameras.silent,
            "segments": len(self._segments) + 1,
            "stage": self._annotations.stage,
        }

    # --- messages -------------------------------------------------------------------------------

    def cycle(self, arm: str, message: Any, receive_ns: int) -> None:
        """Record a surg_msgs/Cycle."""
        name = f"cycle_{arm}"
        table = self._tables.get(name) or self._table(name, table_columns.cycle(len(message.q)))
        self._put_fitting(table, table_rows.cycle(message, receive_ns), "number of joints")

    def ground_truth(self, message: Any, receive_ns: int) -> None:
        """Record a surg_msgs/GroundTruth, arm by arm."""
        stamp = table_rows.nanoseconds(message.header.stamp)
        for arm in message.arms:
            row = table_rows.ground_truth(stamp, message.tick, arm, receive_ns)
            self._put(self._table(f"ground_truth_{arm.arm}", table_columns.GROUND_TRUTH), row)

    def force(self, arm: str, place: str, message: Any, receive_ns: int) -> None:
        """Record what a sensor says of the force on the ``tip`` or the ``trocar`` of an arm.

        That a force is not known is recorded once, after a known one, with the stamp of that.
        """
        name = f"{place}_force_{arm}"
        row = table_rows.force(message, receive_ns, self._known_forces.get(name, 0))
        if row[2] == 1:
            self._known_forces[name] = row[0]
        elif self._known_forces.pop(name, None) is None:
            return
        self._put(self._table(name, table_columns.MEASURED_FORCE), row)

    def task_state(self, message: Any, receive_ns: int) -> None:
        """Record a surg_msgs/TaskState."""
        table = self._tables.get(TASK_STATE)
        if table is None:
            try:
                table = self._table(TASK_STATE, table_columns.task(message.names))
            except ValueError as problem:
                self._problems.append(f"{TASK_STATE}: {problem}")
                return
        row = table_rows.task_state(message, receive_ns)
        self._annotations.phase(message.phase, row[0], message.done)
        self._put_fitting(table, row, "number of values")

    def command(self, arm: str, topic: str, message: Any, source: str, receive_ns: int) -> None:
        """Record a motion command sent to an arm, or to the ``assistant``'s instrument."""
        row = table_rows.command(topic, message, source, receive_ns)
        self._put(self._table(f"command_{arm}", table_columns.COMMAND), row)

    def clock_sync(self, message: Any, receive_ns: int) -> None:
        """Record a surg_msgs/ClockSync: the status of a machine's PTP clock."""
        row = table_rows.clock_sync(message, receive_ns)
        self._put(self._table("clock_sync", table_columns.CLOCK_SYNC), row)

    def topic(self, topic: str, kind: str, flat: Flat, source: str, receive_ns: int) -> None:
        """Record a message of any other topic and type ``kind`` (``sensor_msgs/JointState``)."""
        table = self._topics.table(topic, kind, flat)
        if table is not None:
            self._put(table, flat.row(table.columns, receive_ns, source))

    def event(self, topic: str, source: str, text: str, receive_ns: int, stamp_ns: int = 0) -> None:
        """Record a text: a state, a warning, an error. ``stamp_ns`` 0: the message has none."""
        self._put(self._tables.get("events"), (stamp_ns, receive_ns, topic, source, text))

    def tag(self, tag: Tag, text: str, source: str, receive_ns: int, stamp_ns: int) -> None:
        """Record a tag: the parsed message, its text, its sender, and its reception [ns].

        ``stamp_ns`` is the present on the clock of the episode's stamps [ns].
        """
        stamp = stamp_ns if tag.stamp_ns is None else tag.stamp_ns
        self._annotations.add(tag, stamp, source)
        self.event("/record/tag", source, text, receive_ns, stamp)

    def image(self, camera: str, message: Any, receive_ns: int) -> None:
        """Record a sensor_msgs/Image or CompressedImage.

        Blocks in lock-step when the encoder is behind.
        """
        frame = frame_of(message, table_rows.nanoseconds(message.header.stamp), receive_ns)
        self._count_future_stamp(camera, frame.stamp_ns, receive_ns)
        self.cameras.put(camera, frame)

    def clock_stepped(self, step_ns: int, wall_ns: int) -> None:
        """Mark a step of the wall clock: an event, and a new segment of the episode."""
        tables = {name: table.taken for name, table in dict(self._tables).items()}
        frames = {name: sink.received for name, sink in self.cameras.sinks.items()}
        self._segments.append(
            {"begin_ns": wall_ns, "step_ns": step_ns, "rows": tables, "frames": frames}
        )
        self.warn(f"the clock was set by {step_ns * 1e-9:+.3f} s: stamps on either side differ")
        text = f"the wall clock stepped by {step_ns} ns"
        self.event(CLOCK_STEP, "", text, wall_ns, wall_ns)
        if step_ns < 0 and not self._lockstep:
            for sink in self.cameras.sinks.values():
                sink.expect_earlier_stamps()

    def watch_cameras(self, now: float, wall_ns: int) -> None:
        """Detect cameras that have fallen silent or have come back (free-run only).

        Args:
            now: Steady clock [s].
            wall_ns: Wall clock [ns].
        """
        if self._lockstep:
            return
        for topic, text, warning in self.cameras.changes(now):
            if warning:
                self.warn(warning)
            self.event(topic, "", text, wall_ns)

    def close(
        self,
        manifest: Mapping[str, Any],
        video_timeout_s: float = 60.0,
        topics: Mapping[str, Mapping[str, Any]] | None = None,
        end_stamp_ns: int = 0,
    ) -> Path:
        """Write every backlog, finish the videos and the folder; returns the folder.

        Args:
            manifest: Facts learnt since the start.
            video_timeout_s: Longest time to write a video's backlog [s].
            topics: Facts about further topics, including those that never sent.
            end_stamp_ns: End of the last stage on the clock of the episode's stamps [ns].

        Raises:
            EpisodeError: The folder could not be finished; the next start recovers it.
        """
        self._writer.close()
        without_image = self.cameras.close(video_timeout_s)
        problems = [self.problem] if self.problem else []
        problems += [f"{name}: no image was received" for name in without_image]
        for arm in self.arms:
            if f"cycle_{arm}" not in self._tables:
                problems.append(f"{arm}: no cycle was received")
        drops = self._drops()
        for name, count in drops.items():
            if count:
                sink = self.cameras.sinks.get(name)
                skipped = sink.last_skip if sink else None
                why = f" (the last that could not be recorded: {skipped})" if skipped else ""
                problems.append(f"{name}: {count} dropped{why}")
        for name, count in self._future.items():
            self.warn(f"{name}: {count} stamps more than {FUTURE_NS * 1e-6:g} ms in the future")
        self._annotations.end(end_stamp_ns)
        requested, recorded = topics or {}, self.topics()
        known = {
            "camera_streams": self.cameras.describe(),
            "topics": {
                topic: {**requested.get(topic, {}), **recorded.get(topic, {})}
                for topic in sorted({*requested, *recorded})
            },
            "segments": self._segments,
            "future_stamps": dict(self._future),
            "stages": self._annotations.stages({**self._folder.manifest, **manifest}.get("run")),
            "tags": self._annotations.tags,
            "result": self._annotations.judged(dict(manifest.get("sim") or {}).get("task")),
            "warnings": self.warnings,
        }
        return self._folder.finalise({**manifest, **known}, drops, "; ".join(problems) or None)

    # --- tables ---------------------------------------------------------------------------------

    def _drops(self) -> dict[str, int]:
        tables = {name: table.dropped for name, table in list(self._tables.items())}
        return {**tables, **self.cameras.drops()}

    def _put_fitting(self, table: CsvTable | None, row: table_rows.Row, what: str) -> None:
        """Queue a row if it has as many fields as its table."""
        if table is not None and len(row) != len(table.columns):
            self._problems.append(f"{table.path.stem}: a message with another {what}")
            table.dropped += 1
            return
        self._put(table, row)

    def _put(self, table: CsvTable | None, row: table_rows.Row) -> None:
        if table is not None:
            self._count_future_stamp(table.path.stem, row[0], row[1])
            self._writer.put(table, row)

    def _count_future_stamp(self, name: str, stamp_ns: int, receive_ns: int) -> None:
        """Count a stamp in the future; lock-step stamps are simulated time and do not count."""
        if stamp_ns > receive_ns + FUTURE_NS and not self._lockstep:
            self._future[name] = self._future.get(name, 0) + 1

    def _open_topic(
        self, name: str, names: Sequence[str], about: Mapping[str, Any]
    ) -> CsvTable | None:
        """Create a table below ``topics/``, with facts for a reader beside it."""
        folder = self.folder / TOPICS
        try:
            folder.mkdir(exist_ok=True)
            # Not synced: a callback calls this and must not wait for the disk.
            (folder / f"{name}.json").write_text(json.dumps(about, indent=1) + "\n", "utf-8")
        except OSError as problem:
            self._problems.append(f"{TOPICS}/{name}: {problem.strerror}")
            return None
        # Further topics are never waited for, even in lock-step: their queues are always bounded.
        return self._table(f"{TOPICS}/{name}", names, FREERUN_QUEUE)

    def _table(self, name: str, names: Sequence[str], limit: int | None = None) -> CsvTable | None:
        """The table of this name, created with these columns if new; None if that fails."""
        if table := self._tables.get(name):
            return table
        with self._lock:
            if name not in self._tables:
                try:
                    self._tables[name] = self._writer.table(
                        self.folder / f"{name}.csv", names, limit or self._limit
                    )
                except OSError as problem:
                    self._problems.append(f"{name}: {problem.strerror}")
                    return None
            return self._tables[name]
