"""Records one episode, without ROS: messages in, an episode folder out.

Failures of the disk or a camera raise nothing: ``problem`` states why the episode will be
incomplete, and everything else is still recorded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from surg_recording.clock.clock_steps import CLOCK_STEP, FUTURE_NS
from surg_recording.episode import table_columns, table_rows
from surg_recording.episode.annotations import Annotations, Tag
from surg_recording.episode.episode_writer import MIN_FREE_BYTES, STOP_FREE_BYTES, EpisodeWriter
from surg_recording.episode.message_fields import Flat
from surg_recording.episode.recorded_tables import RecordedTables
from surg_recording.episode.topic_tables import TopicTables
from surg_recording.video.camera_set import CameraSet
from surg_recording.video.image_frame import frame_of
from surg_recording.video.video_encoder import CRF

TASK_STATE = "task_state"
"""Table of a task's ground truth."""


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
        self._problems: list[str] = []
        self.tables = RecordedTables(self.folder, self._lockstep, self._problems)
        self._topics = TopicTables(self.tables.open_topic, self.warn)
        self._annotations = Annotations()
        self._segments: list[dict[str, Any]] = []
        self._known_forces: dict[str, int] = {}  # stamps of forces that are known, by table
        self.warnings: list[str] = []
        for arm in self.arms:
            self.tables.open(f"command_{arm}", table_columns.COMMAND)
        self.tables.open("events", table_columns.EVENTS)
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
        error = self.tables.writer.error
        rows_lost = [f"rows lost: {error}"] if error else []
        problems = [*self._problems, *rows_lost, *self.cameras.problems]
        return "; ".join(dict.fromkeys(problems)) or None

    @property
    def failed(self) -> bool:
        """Whether the disk is full or broken, so that recording must end."""
        if problem := self._folder.disk_problem(self._stop_free):
            self._problems.append(problem)
        return self._folder.disk_lost or self.tables.writer.error is not None

    def warn(self, text: str) -> None:
        """Add a warning to the manifest; the recording stays complete."""
        if text not in self.warnings:
            self.warnings.append(text)

    def note(self, problem: str) -> None:
        """Mark the episode as incomplete."""
        self._problems.append(problem)

    def topics(self) -> dict[str, dict[str, Any]]:
        """Type, tables and truncated fields of every further topic."""
        return self._topics.describe()

    def status(self) -> dict[str, Any]:
        """Counters: rows, frames, drops, backlog."""
        tables, sinks = self.tables.all(), self.cameras.sinks
        return {
            "folder": str(self._folder.final),
            "rows": {name: table.rows for name, table in tables.items()},
            "frames": {name: sink.frames for name, sink in sinks.items()},
            "drops": self._drops(),
            "backlog": {
                "rows": sum(table.backlog for table in tables.values()),
                "frames": sum(sink.part.backlog for sink in sinks.values()),
            },
            "warnings": list(self.warnings),
            "future_stamps": dict(self.tables.future),
            "silent_cameras": self.cameras.silent,
            "segments": len(self._segments) + 1,
            "stage": self._annotations.stage,
        }

    # --- messages -------------------------------------------------------------------------------

    def cycle(self, arm: str, message: Any, receive_ns: int) -> None:
        """Record a surg_msgs/Cycle."""
        name = f"cycle_{arm}"
        table = self.tables.get(name)
        if table is None:
            columns = table_columns.cycle(len(message.q), wristed=len(message.wrist) > 0)
            table = self.tables.open(name, columns)
        self.tables.put_fitting(table, table_rows.cycle(message, receive_ns), "number of joints")

    def ground_truth(self, message: Any, receive_ns: int) -> None:
        """Record a surg_msgs/GroundTruth, arm by arm."""
        stamp = table_rows.nanoseconds(message.header.stamp)
        for arm in message.arms:
            row = table_rows.ground_truth(stamp, message.tick, arm, receive_ns)
            self.tables.put(
                self.tables.open(f"ground_truth_{arm.arm}", table_columns.GROUND_TRUTH), row
            )

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
        self.tables.put(self.tables.open(name, table_columns.MEASURED_FORCE), row)

    def task_state(self, message: Any, receive_ns: int) -> None:
        """Record a surg_msgs/TaskState."""
        table = self.tables.get(TASK_STATE)
        if table is None:
            try:
                table = self.tables.open(TASK_STATE, table_columns.task(message.names))
            except ValueError as problem:
                self._problems.append(f"{TASK_STATE}: {problem}")
                return
        row = table_rows.task_state(message, receive_ns)
        self._annotations.phase(message.phase, row[0], message.done)
        self.tables.put_fitting(table, row, "number of values")

    def command(self, arm: str, topic: str, message: Any, source: str, receive_ns: int) -> None:
        """Record a motion command sent to an arm, or to the ``assistant``'s instrument."""
        row = table_rows.command(topic, message, source, receive_ns)
        self.tables.put(self.tables.open(f"command_{arm}", table_columns.COMMAND), row)

    def clock_sync(self, message: Any, receive_ns: int) -> None:
        """Record a surg_msgs/ClockSync: the status of a machine's PTP clock."""
        row = table_rows.clock_sync(message, receive_ns)
        self.tables.put(self.tables.open("clock_sync", table_columns.CLOCK_SYNC), row)

    def topic(self, topic: str, kind: str, flat: Flat, source: str, receive_ns: int) -> None:
        """Record a message of any other topic and type ``kind`` (``sensor_msgs/JointState``)."""
        table = self._topics.table(topic, kind, flat)
        if table is not None:
            self.tables.put(table, flat.row(table.columns, receive_ns, source))

    def event(self, topic: str, source: str, text: str, receive_ns: int, stamp_ns: int = 0) -> None:
        """Record a text: a state, a warning, an error. ``stamp_ns`` 0: the message has none."""
        self.tables.put(self.tables.get("events"), (stamp_ns, receive_ns, topic, source, text))

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
        self.tables.count_future_stamp(camera, frame.stamp_ns, receive_ns)
        self.cameras.put(camera, frame)

    def clock_stepped(self, step_ns: int, wall_ns: int) -> None:
        """Mark a step of the wall clock: an event, and a new segment of the episode."""
        tables = {name: table.taken for name, table in self.tables.all().items()}
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
        self.tables.writer.close()
        without_image = self.cameras.close(video_timeout_s)
        problems = [self.problem] if self.problem else []
        problems += [f"{name}: no image was received" for name in without_image]
        for arm in self.arms:
            if self.tables.get(f"cycle_{arm}") is None:
                problems.append(f"{arm}: no cycle was received")
        drops = self._drops()
        for name, count in drops.items():
            if count:
                problems.append(f"{name}: {count} dropped{self.cameras.last_skip(name)}")
        for name, count in self.tables.future.items():
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
            "future_stamps": dict(self.tables.future),
            "stages": self._annotations.stages({**self._folder.manifest, **manifest}.get("run")),
            "tags": self._annotations.tags,
            "result": self._annotations.judged(dict(manifest.get("sim") or {}).get("task")),
            "warnings": self.warnings,
        }
        return self._folder.finalise({**manifest, **known}, drops, "; ".join(problems) or None)

    def _drops(self) -> dict[str, int]:
        tables = {name: table.dropped for name, table in self.tables.all().items()}
        return {**tables, **self.cameras.drops()}
