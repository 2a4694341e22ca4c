"""Real rclpy: hears and says what a file lists. Runs in an environment of its own, without ROS 1.

`rclpy_script.py SPEC` prints `[topic, values]` in JSON for each message that it hears, and sends
the others again and again. The file has `{"node": N, "hear": {topic: [type, latched, reliable]},
"say": {topic: [type, values]}}`.
"""

from __future__ import annotations

import array
import importlib
import json
import sys
from pathlib import Path
from typing import Any

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

PERIOD_S = 0.2


def message_class(kind: str) -> Any:
    """The class of `geometry_msgs/Pose`."""
    package, _, name = kind.partition("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def values(thing: Any) -> Any:
    """A message as plain values."""
    if hasattr(thing, "get_fields_and_field_types"):
        names = thing.get_fields_and_field_types()
        return {name.lower(): values(getattr(thing, name)) for name in names}
    if isinstance(thing, bytes):  # a single byte
        return thing[0]
    if isinstance(thing, str):
        return thing
    if hasattr(thing, "__iter__"):
        return [values(each) for each in thing]
    return thing.item() if hasattr(thing, "item") else thing


def fill(message: Any, given: dict[str, Any]) -> Any:
    """Put plain values into a message."""
    for name, kind in message.get_fields_and_field_types().items():
        value = given[name.lower()]
        if kind == "octet":
            value = bytes([value % 256])
        elif kind == "sequence<uint8>":
            value = array.array("B", value)
        elif isinstance(value, dict):
            value = fill(getattr(message, name), value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            made = message_class(kind.removeprefix("sequence<").removesuffix(">"))
            value = [fill(made(), each) for each in value]
        setattr(message, name, value)
    return message


def main(spec: dict[str, Any]) -> None:
    """Hear and say until the process is ended."""
    rclpy.init()
    node = rclpy.create_node(spec["node"])
    for topic, (kind, latched, reliable) in spec["hear"].items():
        quality = QoSProfile(
            depth=100,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        )

        def hear(message: Any, topic: str = topic) -> None:
            print(json.dumps([topic, values(message)]), flush=True)

        node.create_subscription(message_class(kind), topic, hear, quality)
    said = []
    for topic, (kind, given) in spec["say"].items():
        made = message_class(kind)
        said.append((node.create_publisher(made, topic, 10), fill(made(), given)))

    def say() -> None:
        for publisher, message in said:
            publisher.publish(message)

    node.create_timer(PERIOD_S, say)
    print("ready", flush=True)
    rclpy.spin(node)


if __name__ == "__main__":
    main(json.loads(Path(sys.argv[1]).read_text()))
