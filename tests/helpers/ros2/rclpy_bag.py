"""Real rclpy: reads a bag of ROS 2 in SQLite 3. Runs in an environment of its own, without ROS 1.

`rclpy_bag.py FILE` prints `[topic, time of reception, values]` in JSON for each message.
"""

from __future__ import annotations

import json
import sqlite3
import sys

from rclpy.serialization import deserialize_message
from rclpy_script import message_class, values

MESSAGES = """SELECT topics.name, topics.type, messages.timestamp, messages.data
FROM messages JOIN topics ON topics.id = messages.topic_id
ORDER BY messages.timestamp, messages.id"""

if __name__ == "__main__":
    with sqlite3.connect(f"file:{sys.argv[1]}?mode=ro", uri=True) as _bag:
        for _topic, _kind, _time, _data in _bag.execute(MESSAGES):
            _message = deserialize_message(_data, message_class(_kind.replace("/msg/", "/")))
            print(json.dumps([_topic, _time, values(_message)]))
