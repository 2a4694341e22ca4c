"""Real rclpy: asks services, each until it is answered. Runs in an environment without ROS 1.

`rclpy_services.py SPEC`: the file has `{"ask": {service: [type, values of the request]}}`; prints
`[service, values of the reply]` in JSON for each.
"""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path
from typing import Any

import rclpy
from rclpy_script import fill, values

PATIENCE_S = 5.0
"""As any client does: the first request may come before the server knows the client."""


def main(spec: dict[str, Any]) -> None:
    """Ask and print."""
    rclpy.init()
    node = rclpy.create_node("asks")
    for name, (kind, given) in spec["ask"].items():
        package, _, base = kind.partition("/")
        made = getattr(importlib.import_module(f"{package}.srv"), base)
        client = node.create_client(made, name)
        client.wait_for_service()
        answer = None
        while answer is None:
            future = client.call_async(fill(made.Request(), given))
            rclpy.spin_until_future_complete(node, future, timeout_sec=PATIENCE_S)
            answer = future.result() if future.done() else None
        print(json.dumps([name, values(answer)]), flush=True)


if __name__ == "__main__":
    main(json.loads(Path(sys.argv[1]).read_text()))
