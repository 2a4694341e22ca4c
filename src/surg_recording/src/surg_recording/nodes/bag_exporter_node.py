"""What the formats of ROS messages share: a bag for each recording."""

from __future__ import annotations

import abc
import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar

from surg_recording.calibration import calibration_record
from surg_recording.datasets import pictures
from surg_recording.datasets.dataset import Dataset
from surg_recording.datasets.export_report import Report
from surg_recording.datasets.exporter import Exporter
from surg_recording.datasets.frames.sampling import Sampled
from surg_recording.datasets.options import ExportOptions
from surg_recording.nodes import ros_messages_node
from surg_recording.nodes.ros_messages_node import Stamped, serialised
from surg_recording.recording_errors import EpisodeError

INDEX = "dataset.json"
_CONTENT = "content.json"


class BagExporter(Exporter):
    """Writes every recording as a file of ROS messages, and compares what is read back."""

    needs: ClassVar[Mapping[str, str]] = {
        "genpy": "ROS 1, which ./surg dev setup installs",
        "sensor_msgs": "ROS 1, which ./surg dev setup installs",
        "cv2": "Debian: python3-opencv",
    }
    suffix: ClassVar[str]
    """Of the file's name."""

    @abc.abstractmethod
    def write_file(self, path: Path, stamped: Iterable[Stamped], facts: Mapping[str, str]) -> None:
        """Write messages, given in the order of their time."""

    @abc.abstractmethod
    def read_file(self, path: Path) -> Iterator[tuple[int, str, str, bytes]]:
        """Time [ns], topic, type and serialised message of every message, in file order."""

    def write_part(self, sampled: Sampled, folder: Path, options: ExportOptions) -> None:
        """The recording's file; each topic's messages are compared by hash with what is read."""
        path = folder / f"recording{self.suffix}"
        written = _Digest()

        def passing() -> Iterator[Stamped]:
            for stamped in ros_messages_node.messages(sampled, options):
                time_ns, topic, message = stamped
                written.add(time_ns, topic, message._type, serialised(message))
                yield stamped

        candidate = sampled.candidate
        facts = {"instruction": candidate.instruction, "kind": candidate.kind}
        facts["robots"] = ", ".join(candidate.layout.robots)
        self.write_file(path, passing(), facts)
        if self._content(path) != written.facts():
            raise EpisodeError(f"{path}: what was read back is not what was written")
        content = {"frames": sampled.grid.frames, "topics": written.facts()}
        (folder / _CONTENT).write_text(json.dumps(content) + "\n", "utf-8")

    def _content(self, path: Path) -> dict[str, Any]:
        seen = _Digest()
        for message in self.read_file(path):
            seen.add(*message)
        return seen.facts()

    def assemble(self, dataset: Dataset, out: Path) -> None:
        """Number the files; ``dataset.json`` states what each holds.

        Beside them is ``calibration/``, as in the other formats.
        """
        calibration_record.write([part.about for part in dataset.parts], out)
        episodes = []
        for index, part in enumerate(dataset.parts):
            name = f"episode_{index:06d}{self.suffix}"
            pictures.link_or_copy(part.folder / f"recording{self.suffix}", out / name)
            content = json.loads((part.folder / _CONTENT).read_text("utf-8"))
            about = {"file": name, "instruction": part.instruction, "kind": part.kind}
            episodes.append({**about, **content})
        stated = {
            "robot_type": dataset.robot_type,
            "fps": dataset.options.fps,
            "splits": {name: list(ends) for name, ends in dataset.splits.items()},
            "episodes": episodes,
        }
        (out / INDEX).write_text(json.dumps(stated, indent=1) + "\n", "utf-8")

    def validate(self, out: Path) -> Report:
        """Read every file; each topic must hold what ``dataset.json`` states."""
        report = Report(self.name, out)
        with report.reading():
            stated = json.loads((out / INDEX).read_text("utf-8"))
            for episode in stated["episodes"]:
                if self._content(out / episode["file"]) != episode["topics"]:
                    report.errors.append(f"{episode['file']}: other messages than {INDEX} states")
                report.recordings += 1
                report.frames += episode["frames"]
            report.facts["splits"] = stated["splits"]
            report.errors += calibration_record.check(out, len(stated["episodes"]))
        return report


class _Digest:
    """Number and hash of the messages of each topic."""

    def __init__(self) -> None:
        self._hashes: dict[str, Any] = {}
        self._counts: dict[str, int] = {}
        self._kinds: dict[str, str] = {}

    def add(self, time_ns: int, topic: str, kind: str, data: bytes) -> None:
        digest = self._hashes.setdefault(topic, hashlib.sha256())
        digest.update(time_ns.to_bytes(8, "little") + data)
        self._counts[topic] = self._counts.get(topic, 0) + 1
        self._kinds[topic] = kind

    def facts(self) -> dict[str, Any]:
        return {
            topic: {
                "type": self._kinds[topic],
                "messages": self._counts[topic],
                "sha256": digest.hexdigest(),
            }
            for topic, digest in sorted(self._hashes.items())
        }
