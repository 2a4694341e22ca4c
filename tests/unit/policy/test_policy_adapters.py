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
        for reply in ({"action.arm": npy(np.ones((16, 5)))}, {"error": "no such embodiment"}):
            asked.append(msgpack.unpackb(server.recv()))
            server.send(msgpack.packb(reply))

    policy = Gr00tPolicy(
        f"tcp://127.0.0.1:{port}",
        inputs=lambda o: {"state.arm": o[STATE][None], "annotation": [o.instruction]},
        rows=lambda reply: reply["action.arm"],
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
    assert asked[0]["data"]["annotation"] == ["retract the bowel"]
    state = np.load(io.BytesIO(asked[0]["data"]["state.arm"]["as_npy"]))
    assert state.tolist() == [list(range(9))]
    server.close(0)
    context.destroy(0)


# What lerobot's policies import and reading its datasets does not need.
POLICIES = (
    *("pyzmq", "msgpack", "diffusers", "importlib_metadata", "zipp", "regex", "pyserial"),
    *("gymnasium<2", "farama-notifications", "cloudpickle"),
)


@pytest.mark.oracle
def test_a_lerobot_checkpoint_answers_as_lerobot_itself(tmp_path: Path) -> None:
    python = lerobot_venv.python("0.4.4")
    beside = paths.ROOT / ".venv-oracle-lerobot-policies"
    stamp = beside / ".complete"
    if not stamp.exists():
        pip = [str(python), "-m", "pip", "install", "-q", "--no-deps", "--target", str(beside)]
        done = subprocess.run([*pip, *POLICIES], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            pytest.skip(f"missing: {', '.join(POLICIES)}: {done.stderr.strip()[-300:]}")
        stamp.touch()
    client = paths.ROOT / "src" / "surg_policy_bridge" / "client" / "src"
    env = {**os.environ, "PYTHONPATH": f"{client}:{beside}", "HF_HUB_OFFLINE": "1"}
    program = Path(__file__).parents[2] / "helpers" / "policy" / "lerobot_policy.py"
    done = subprocess.run(
        [str(python), str(program), str(tmp_path / "checkpoint")],
        capture_output=True,
        text=True,
        timeout=600,
        env=env,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    told = json.loads(done.stdout.splitlines()[-1])
    print(told)
    assert (told["lerobot"], told["shape"], told["refused"]) == ("0.4.4", [20, 5], [])
    assert told["wants"] == [STATE, LEFT]
    assert told["worst"] <= 1e-5 < told["spread"]
