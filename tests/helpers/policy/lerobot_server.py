"""Asks lerobot's own asynchronous policy server by lerobot's own client; for `lerobot_policy.py`.

What goes between them can run code at the receiver, so the platform does not speak it. Here both
ends are lerobot's, in one process; only the robot is made up.
"""

from __future__ import annotations

import threading
import time
from concurrent import futures
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import grpc
import numpy as np
from lerobot.async_inference import robot_client
from lerobot.async_inference.configs import PolicyServerConfig, RobotClientConfig
from lerobot.async_inference.helpers import TimedObservation
from lerobot.async_inference.policy_server import PolicyServer
from lerobot.robots import RobotConfig
from lerobot.transport import services_pb2_grpc

PREFIX = "observation.images."
LONGEST_S = 60.0


def chunk(
    folder: Path, state: np.ndarray, pictures: dict[str, np.ndarray], rows: int, instruction: str
) -> np.ndarray:
    """The chunk (rows, A) of an ACT checkpoint for one observation.

    Args:
        folder: Of the checkpoint.
        state: (n,) `observation.state`.
        pictures: (height, width, 3), uint8, by key.
        rows: Of the chunk.
        instruction: Of the episode.
    """
    names = [f"number_{i}" for i in range(len(state))]
    views = {key.removeprefix(PREFIX): picture for key, picture in pictures.items()}
    robot = SimpleNamespace(
        connect=lambda: None,
        disconnect=lambda: None,
        observation_features={
            **dict.fromkeys(names, float),
            **{k: v.shape for k, v in views.items()},
        },
    )
    seen = {**dict(zip(names, map(float, state), strict=True)), **views, "task": instruction}
    server = grpc.server(futures.ThreadPoolExecutor(2))
    served = PolicyServer(PolicyServerConfig(host="127.0.0.1", port=8080, fps=20))
    services_pb2_grpc.add_AsyncInferenceServicer_to_server(served, server)
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    config = RobotClientConfig(
        policy_type="act",
        pretrained_name_or_path=str(folder),
        robot=RobotConfig(),
        actions_per_chunk=rows,
        server_address=f"127.0.0.1:{port}",
        fps=20,
    )
    with mock.patch.object(robot_client, "make_robot_from_config", lambda config: robot):
        client = robot_client.RobotClient(config)
    try:
        assert client.start()
        thread = threading.Thread(target=client.receive_actions, daemon=True)
        thread.start()
        client.start_barrier.wait()
        client.send_observation(TimedObservation(time.time(), 0, seen, must_go=True))
        end = time.monotonic() + LONGEST_S
        while client.action_queue.qsize() < rows and time.monotonic() < end:
            time.sleep(0.02)
        client.shutdown_event.set()
        thread.join(LONGEST_S)
    finally:
        client.stop()
        server.stop(0).wait()
    found = sorted(client.action_queue.queue, key=lambda each: each.get_timestep())
    return np.stack([each.get_action().numpy() for each in found])
