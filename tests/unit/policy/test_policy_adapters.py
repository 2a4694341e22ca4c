"""Policies of other projects: what they are asked, what becomes of their answers."""

import io
import json
import os
import subprocess
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgpack
import numpy as np
import pytest
import zmq

from helpers.policy import lerobot_venv
from helpers.policy.policy_server import spec
from helpers.tree import oracle_venv
from surg_cli.host import paths
from surg_policy_client import BadAction, NoServer, Observation
from surg_policy_client.adapters.gr00t import Gr00tPolicy
from surg_policy_client.adapters.openpi import OpenPiPolicy

LEFT, STATE = "observation.images.endoscope.left", "observation.state"


def seen() -> Observation:
    arrays = {
        STATE: np.arange(9, dtype=np.float32),
        LEFT: np.full((480, 640, 3), 51, np.uint8),
    }
    for array in arrays.values():
        array.flags.writeable = False
    return Observation(arrays, 3, 0, 0, "retract the bowel", spec(pictures=True))


def test_openpi_is_asked_in_its_own_words() -> None:
    asked: list[dict[str, Any]] = []

    def infer(request: dict[str, Any]) -> dict[str, Any]:
        asked.append(request)
        return {"actions": np.arange(64.0).reshape(2, 32), "server_timing": {}}

    remote = SimpleNamespace(infer=infer, reset=lambda: asked.clear())
    policy = OpenPiPolicy(remote, {"observation/image": LEFT, "observation/state": STATE})
    assert policy.wants == (LEFT, STATE)
    policy.reset("", None)
    assert policy.act(seen()).tolist() == [[0, 1, 2, 3, 4], [32, 33, 34, 35, 36]]
    assert sorted(asked[0]) == ["observation/image", "observation/state", "prompt"]
    assert asked[0]["prompt"] == "retract the bowel"
    turned = OpenPiPolicy(remote, {"s": STATE}, prompt="", columns=[4, 3, 2, 1, 0])
    assert turned.act(seen()).tolist()[0] == [4, 3, 2, 1, 0]
    assert list(asked[1]) == ["s"]
    with pytest.raises(BadAction, match="answered error and no actions"):
        OpenPiPolicy(SimpleNamespace(infer=lambda r: {"error": 1}), {"s": STATE}).act(seen())


def npy(value: np.ndarray) -> dict[str, Any]:
    stream = io.BytesIO()
    np.save(stream, value)
    return {"__ndarray_class__": True, "as_npy": stream.getvalue()}


def test_gr00t_is_asked_over_its_socket_and_a_lost_answer_is_no_end() -> None:
    """The stand-in speaks as the public service does; the real one was not tried."""
    context = zmq.Context()
    server = context.socket(zmq.REP)
    port = server.bind_to_random_port("tcp://127.0.0.1")
    asked: list[dict[str, Any]] = []

    def answer() -> None:
        replies = [[{"action.arm": npy(np.ones((16, 5)))}, {}], {"error": "no such embodiment"}]
        for reply in replies:
            asked.append(msgpack.unpackb(server.recv()))
            server.send(msgpack.packb(reply))

    policy = Gr00tPolicy(
        f"tcp://127.0.0.1:{port}",
        inputs=lambda o: {
            "observation": {"state.arm": o[STATE][None], "annotation": [o.instruction]},
            "options": None,
        },
        rows=lambda reply: reply[0]["action.arm"],
        wants=(STATE,),
        timeout_s=0.2,
    )
    with pytest.raises(NoServer, match=r"within 0\.2 s"):
        policy.act(seen())
    assert server.recv()  # the lost one
    server.send(b"\x80")
    thread = threading.Thread(target=answer)
    thread.start()
    assert policy.act(seen()).shape == (16, 5)
    with pytest.raises(BadAction, match="no such embodiment"):
        policy.act(seen())
    thread.join()
    assert asked[0]["endpoint"] == "get_action"
    seen_there = asked[0]["data"]["observation"]
    assert seen_there["annotation"] == ["retract the bowel"]
    state = np.load(io.BytesIO(seen_there["state.arm"]["as_npy"]))
    assert state.tolist() == [list(range(9))]
    server.close(0)
    context.destroy(0)


def test_a_gr00t_service_is_told_of_an_episode_and_of_a_token() -> None:
    """One that has no such endpoint, as N1.5, is none the worse; one that refuses is."""
    context = zmq.Context()
    server = context.socket(zmq.REP)
    port = server.bind_to_random_port("tcp://127.0.0.1")
    replies = [
        msgpack.packb({"info": {}}),
        msgpack.packb({"error": "Unknown endpoint: reset"}),
        msgpack.packb({"error": "Unauthorized: Invalid API token"}),
        b"ERROR",
    ]
    asked: list[dict[str, Any]] = []

    def answer() -> None:
        for reply in replies:
            asked.append(msgpack.unpackb(server.recv()))
            server.send(reply)

    thread = threading.Thread(target=answer)
    thread.start()
    policy = Gr00tPolicy(
        f"tcp://127.0.0.1:{port}", lambda o: {}, lambda reply: reply, (STATE,), api_token="secret"
    )
    policy.reset("retract", 1)
    policy.reset("retract", 2)
    with pytest.raises(BadAction, match="Invalid API token"):
        policy.reset("retract", 3)
    with pytest.raises(BadAction, match="answered b'ERROR'"):
        policy.act(seen())
    thread.join()
    told = {"endpoint": "reset", "data": {"options": None}, "api_token": "secret"}
    assert asked[:3] == [told] * 3
    assert asked[3] == {"endpoint": "get_action", "data": {}, "api_token": "secret"}
    server.close(0)
    context.destroy(0)


OPENPI = (("--no-deps", "-r", str(paths.ROOT / "benchmarks" / "policy.lock")), ("pyzmq",))
HELPERS = Path(__file__).parents[2] / "helpers" / "policy"


@pytest.mark.oracle
def test_the_client_of_openpi_brings_what_is_asked_and_answered() -> None:
    """The real client and serialiser; a server by the public protocol, with a made-up model."""
    python = oracle_venv.python("openpi-client", OPENPI, ("openpi_client", "websockets"))
    done = subprocess.run(
        [str(python), str(HELPERS / "openpi_policy.py")],
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, "PYTHONPATH": str(lerobot_venv.CLIENT)},
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    told = json.loads(done.stdout.splitlines()[-1])
    print(told)
    assert told["asked"] == ["observation/image", "observation/state", "prompt"]
    assert (told["openpi"], told["prompt"], told["arrived"]) == ("0.1.2", "retract", [True, True])
    assert (told["shape"], told["worst"], told["refused"]) == ([16, 5], 0.0, [])
    # The server's trace is of its own files; who runs the robot gets the last line.
    assert told["failed"] == {
        "kind": "BadAction",
        "text": "the openpi policy failed: ValueError: a black picture",
    }
    assert told["gone"]["kind"] == "NoServer"


@pytest.mark.oracle
def test_a_lerobot_checkpoint_answers_as_lerobot_itself(tmp_path: Path) -> None:
    python, env = lerobot_venv.with_policies("0.4.4", tmp_path)
    done = subprocess.run(
        [str(python), str(HELPERS / "lerobot_policy.py"), str(tmp_path / "checkpoint")],
        capture_output=True,
        text=True,
        timeout=600,
        env=env,
        cwd=tmp_path,  # lerobot's server writes logs where it stands
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    told = json.loads(done.stdout.splitlines()[-1])
    print(told)
    assert (told["lerobot"], told["shape"], told["refused"]) == ("0.4.4", [20, 5], [])
    assert told["wants"] == [STATE, LEFT]
    assert max(told["worst"], told["worst_served"]) <= 1e-5 < told["spread"]
