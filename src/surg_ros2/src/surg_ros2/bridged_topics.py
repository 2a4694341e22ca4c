"""Which topics of the graph ROS 2 sees, which it may publish, and under which names.

The contract docs/reference/topics.yaml decides: name, type, direction, latched. No ROS, no DDS.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

PICTURES = ("sensor_msgs/Image", "sensor_msgs/CompressedImage", "sensor_msgs/PointCloud2")
"""Types of which only the newest message counts, and a lost one is not sent again."""
INSIDE = re.compile(r".*/robot/servo_\w+|.*/tool/servo_jp|/sim/(inject|guide_home|undeclared)")
"""What controller, simulator and link say to one another: nothing for a ROS 2 node to say."""
OURS = "/ros2"
"""The gateway's node; names of its callers begin with it too."""
LARGEST_DOMAIN = 232
"""Of DDS: the ports of a higher one do not exist."""
IMPLEMENTATIONS = ("rmw_fastrtps_cpp", "rmw_cyclonedds_cpp")
"""Of ROS 2 on DDS, as RMW_IMPLEMENTATION names them: they frame services in different ways."""
_PLACEHOLDER = re.compile(r"<\w+>")
_ROS2_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")


class NotBridged(ValueError):
    """A topic that ROS 2 cannot have; says why."""


@dataclass(frozen=True)
class Quality:
    """How messages are offered or wanted; the QoS policies of DDS."""

    reliable: bool = True  # a lost message is sent again
    latched: bool = False  # who comes late gets the last ones
    depth: int = 10  # messages that are kept


COMMANDS = Quality(depth=100)
"""Several commands may come at once: `enable` and `home`."""
NAMES = Quality(latched=True, depth=100)
"""Of the topic on which ROS 2 tells the names of its nodes."""


@dataclass(frozen=True)
class _Row:
    pattern: re.Pattern[str]
    type: str
    direction: str
    latched: bool


class Topics:
    """The topics of the contract.

    Args:
        file: The contract.
        lockstep: Whether time waits for its participants: then more topics are latched.

    Raises:
        ValueError: The file cannot be read; names it.
    """

    def __init__(self, file: Path, lockstep: bool = False) -> None:
        try:
            sections = yaml.safe_load(file.read_text("utf-8"))["sections"]
            found = [row for section in sections for row in section.get("topics", ())]
            self._rows = [_row(row, lockstep) for row in found]
            asked = [row for section in sections for row in section.get("services", ())]
            self._services = [(_pattern(row["service"]), row["type"]) for row in asked]
        except (OSError, yaml.YAMLError, KeyError, TypeError) as error:
            raise ValueError(f"{file}: no contract of topics: {error!r}") from error

    def outgoing(self, topic: str, kind: str) -> Quality | None:
        """How a topic of the graph is offered to ROS 2; None: it is not."""
        latched = [row.latched for row in self._matching(topic, kind, "out")]
        if not latched:
            return None
        if kind in PICTURES:
            return Quality(reliable=False, depth=1)
        # Each sender of static transforms has a latched message of its own.
        last = 100 if kind == "tf2_msgs/TFMessage" else 1
        return Quality(latched=True, depth=last) if any(latched) else Quality()

    def incoming(self, topic: str, kind: str) -> Quality | None:
        """How commands are wanted from ROS 2 on a topic; None: they are not."""
        rows = self._matching(topic, kind, "in")
        return COMMANDS if rows and not INSIDE.fullmatch(topic) else None

    def service(self, name: str) -> str | None:
        """The type of a service of the graph; None: ROS 2 does not get it."""
        return next((kind for pattern, kind in self._services if pattern.fullmatch(name)), None)

    def _matching(self, topic: str, kind: str, direction: str) -> list[_Row]:
        return [
            row
            for row in self._rows
            if row.direction == direction and row.type == kind and row.pattern.fullmatch(topic)
        ]


def _row(row: dict[str, Any], lockstep: bool) -> _Row:
    latched = row.get("latched", False)
    if not isinstance(latched, bool):
        latched = latched[0 if lockstep else 1]
    return _Row(_pattern(row["topic"]), row["type"], row["dir"], latched)


def _pattern(name: str) -> re.Pattern[str]:
    """The names that an entry of the contract stands for."""
    parts = re.split(r"(\[\^/\]\+)", _PLACEHOLDER.sub("[^/]+", "/" + name.lstrip("/")))
    return re.compile("".join(part if part == "[^/]+" else re.escape(part) for part in parts))


def dds_topic(topic: str) -> str:
    """The name of a topic of the graph on DDS.

    Raises:
        NotBridged: ROS 2 does not allow this name.
    """
    if not _ROS2_NAME.fullmatch(topic) or "__" in topic:
        raise NotBridged(
            f"{topic}: ROS 2 allows no such name: each part begins with a letter, and has letters, "
            "digits and single underscores. Rename the arm or leader in the cell"
        )
    return f"rt{topic}"


def dds_service(name: str, kind: str) -> tuple[tuple[str, str], tuple[str, str]]:
    """Topic and type on DDS of a service's requests, and of its replies.

    Raises:
        NotBridged: ROS 2 does not allow this name.
    """
    path = dds_topic(name).removeprefix("rt")
    package, _, base = kind.partition("/")
    made = f"{package}::srv::dds_::{base}"
    return (f"rq{path}Request", f"{made}_Request_"), (f"rr{path}Reply", f"{made}_Response_")


def dds_type(kind: str) -> str:
    """The name of a message type on DDS: `std_msgs/Bool` is `std_msgs::msg::dds_::Bool_`."""
    package, _, name = kind.partition("/")
    return f"{package}::msg::dds_::{name}_"


def caller_name(nodes: Iterable[str], key: str, taken: Iterable[str]) -> str:
    """Name in ROS 1 of a process of ROS 2 that sends commands.

    Args:
        nodes: Full names of its nodes, the first of which counts: `/my_script` is `ros2_my_script`.
        key: Of the process, in place of a name that nobody knows.
        taken: Names in use; a second `ros2_my_script` is `ros2_my_script_2`.
    """
    first = next(iter(nodes), f"/peer_{key[9:18]}")
    name = "ros2_" + re.sub(r"\W", "_", first.strip("/"), flags=re.ASCII)
    used, number, unique = set(taken), 1, name
    while unique in used:
        number += 1
        unique = f"{name}_{number}"
    return unique
