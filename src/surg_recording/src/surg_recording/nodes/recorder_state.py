"""State that the parts of the recorder node share: the recording, and what has been received."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Hashable, Iterable
from typing import Any

from surg_core.contract import TICK_NS
from surg_recording.clock.clock_steps import SteppedClock
from surg_recording.episode.duplicate_filter import DuplicateFilter
from surg_recording.episode.episode_recorder import Recording
from surg_recording.episode.topic_selection import TopicChoice
from surg_recording.nodes.recorder_parameters import Settings

FACTS = ("task", "setting", "operator", "seed")
"""Facts about a run that the manifest also states at its top level."""


class RecorderState:
    """Read and written by the callbacks of the node's topics and by its threads.

    Attributes:
        recording: The running recording; None while there is none.
        problem: Why the last recording is incomplete or did not start; None if it is fine.
        started: Whether the last start succeeded.
        finished: Folder of the last finished recording.
        run_info: Facts about the run received on /record/info.
        sim_outcome: The manifest's entry about the simulator; empty until it has reported.
        operating_states: Last operating state of each arm, as recorded.
        drift: Since when the picture is not what was calibrated, and why; empty: it is.
        camera_models: Content of ``camera_info`` of each camera that has said it.
        mounted: Instrument and calibration of each arm, as on ``tool/mounted``.
        last_row: Steady time of the last tick that arrived [s].
        choice: Further topics to record.
    """

    def __init__(
        self, settings: Settings, own_topics: Iterable[str], warn: Callable[[str], None]
    ) -> None:
        self.settings = settings
        self.lockstep = settings.mode == "lockstep"
        self.recording: Recording | None = None
        self.problem: str | None = None
        self.started = False
        self.finished: str | None = None
        self.finishing = False
        self.starts = 0
        self.warnings: list[str] = []
        self.run_info: dict[str, Any] = {}
        self.sim_outcome: dict[str, Any] = {}
        self.operating_states: dict[str, str] = {}
        self.mounted: dict[str, str] = {}
        self.drift: dict[str, Any] = {}
        self.camera_models: dict[str, dict[str, Any]] = {}
        self.last_row = time.monotonic()
        self.clock = SteppedClock(self._on_clock_step)
        taken = frozenset((*own_topics, *settings.camera_topics.values()))
        self.choice = TopicChoice(list(settings.topics), taken)
        self._warn = warn
        self._filters: dict[tuple[str, str], DuplicateFilter] = {}
        self._repeatable: dict[str, int] = {}
        self._ticks: dict[str, int] = {}
        for arm in settings.arms:
            self._ticks[f"cycle_{arm}"] = self._ticks[f"ground_truth_{arm}"] = 0

    # --- ticks and time -----------------------------------------------------------------------

    def received(self, table: str, tick: int) -> None:
        """A row of a tick has arrived for ``cycle_<arm>`` or ``ground_truth_<arm>``."""
        self._ticks[table] = tick
        self.last_row = time.monotonic()

    @property
    def tick(self) -> int:
        """Newest tick that has been received completely."""
        return min(self._ticks.values())

    def episode_now(self, wall_ns: int) -> int:
        """The present on the clock of the episode's stamps [ns]."""
        return self.tick * TICK_NS if self.lockstep else wall_ns

    def _on_clock_step(self, step_ns: int, wall_ns: int) -> None:
        if self.recording is not None:
            self.recording.clock_stepped(step_ns, wall_ns)
        self._warn(f"recorder: the clock was set by {step_ns * 1e-9:+.3f} s")

    # --- messages -----------------------------------------------------------------------------

    def is_duplicate(self, topic: str, header: Any, key: Hashable) -> bool:
        """Whether a second connection to the same publisher has delivered this message before.

        ``header`` is the connection's (one object per connection), ``key`` identifies the message.
        """
        publisher = (topic, str(header.get("callerid", "")))
        known = self._filters.get(publisher)
        if known is None:
            known = self._filters.setdefault(publisher, DuplicateFilter())
        return known.is_duplicate(id(header), key, time.monotonic())

    def is_repeated(self, topic: str, tick: int) -> bool:
        """Whether the simulator has sent the state of this tick before.

        In lock-step it publishes a state again that nobody has answered for some time.
        """
        newest, self._repeatable[topic] = self._repeatable.get(topic), tick
        return self.lockstep and tick == newest

    def forget_duplicates(self) -> None:
        """Begin to count anew, for a new recording."""
        self._filters, self._repeatable = {}, {}

    @property
    def duplicates(self) -> dict[str, int]:
        """Number of duplicate messages by topic, without topics that had none."""
        counts: Counter[str] = Counter()
        for (topic, _), known in list(self._filters.items()):
            counts[topic] += known.duplicates
        return dict(+counts)

    def event(self, topic: str, source: str, text: str, stamp_ns: int = 0) -> None:
        """Record a text, if a recording is running."""
        if self.recording is not None:
            self.recording.event(topic, source, text, self.clock.now_ns(), stamp_ns)

    # --- facts --------------------------------------------------------------------------------

    @property
    def facts(self) -> dict[str, Any]:
        """Facts about the run: from the parameter, and from /record/info since."""
        run = {**self.settings.run_info, **self.run_info}
        return {"run": run, **{key: run.get(key) for key in FACTS}}

    def waiting_for(self, recording: Recording) -> list[str]:
        """Requested topics that have sent nothing in this recording."""
        messages = {topic: entry["messages"] for topic, entry in recording.topics().items()}
        cameras = [
            topic
            for name, topic in self.settings.camera_topics.items()
            if not recording.cameras.newest(name)[0]
        ]
        return [*cameras, *self.choice.silent(messages)]
