"""What ROS 2 sees: a topic of the graph, read while a ROS 2 node listens; a latched one always."""

from __future__ import annotations

from typing import Any

import rospy
from sensor_msgs.msg import CompressedImage

from surg_ros.byte_topics import as_bytes
from surg_ros2 import jpeg
from surg_ros2.bridged_topics import OURS, Quality, dds_topic, dds_type
from surg_ros2.message_types_node import codec, message_class, packed


class Outgoing:
    """A topic that ROS 2 sees."""

    def __init__(
        self, port: Any, topic: str, kind: str, quality: Quality, convert: Any = None
    ) -> None:
        self._topic, self._kind, self._latched = topic, kind, quality.latched
        sent, name = (kind, topic) if convert is None else convert.sent(topic)
        self._codec = codec(message_class(sent))
        self._convert = convert
        self._writer = port.writer(dds_topic(name), dds_type(sent), quality)
        self._subscriber: Any = None

    def look(self) -> None:
        """Subscribe if somebody listens, unsubscribe if nobody does."""
        wanted = self._latched or self._writer.readers > 0
        if wanted and self._subscriber is None:
            kind = as_bytes(message_class(self._kind))
            keys = {"queue_size": 10, "tcp_nodelay": True, "buff_size": 1 << 22}
            self._subscriber = rospy.Subscriber(self._topic, kind, self._pass_on, **keys)
        elif not wanted:
            self._unsubscribe()

    def appeared(self, topic: str) -> None:
        """The graph has this topic itself now: nothing is converted any more."""
        if self._convert is not None:
            self._unsubscribe()
            self._kind, self._topic, self._convert = self._convert.sent("")[0], topic, None

    def _unsubscribe(self) -> None:
        if self._subscriber is not None:
            self._subscriber.unregister()
            self._subscriber = None

    def _pass_on(self, message: Any) -> None:
        if message._connection_header.get("callerid", "").startswith(OURS):
            return  # it came from ROS 2
        data = message.data if self._convert is None else self._convert.convert(message.data)
        if data is not None:
            self._writer.send(self._codec.to_ros2(data))


class Compressed:
    """Makes `.../compressed` of a raw picture."""

    def __init__(self, kind: str) -> None:
        self._class = message_class(kind)

    def sent(self, topic: str) -> tuple[str, str]:
        """Type and name of what is sent."""
        return "sensor_msgs/CompressedImage", f"{topic}/compressed"

    def convert(self, data: bytes) -> bytes | None:
        """The picture as JPEG; None: it cannot be one."""
        image = self._class().deserialize(data)
        picture = jpeg.encode(image)
        if picture is None:
            return None
        return packed(CompressedImage(image.header, "jpeg", picture))
