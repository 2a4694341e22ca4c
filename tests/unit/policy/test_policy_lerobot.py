"""`LeRobotPolicy`: what it asks of a server, how it scales, what it refuses before anything moves.

The tests of the tier oracle train a policy by lerobot's own command line.
"""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import numpy as np
import pytest

from helpers.policy import lerobot_venv
from helpers.policy.policy_server import PolicyServer, spec
from helpers.recording import datasets_synthetic
from helpers.recording.picture_identity import HEIGHT, WIDTH
from surg_policy_client import ActionSpec, Feature, Spec, SpecMismatch
from surg_policy_client.adapters import lerobot
from surg_policy_client.adapters.scaled import scaled

LEFT, STATE = "observation.images.endoscope.left", "observation.state"


def policy(action: ActionSpec | None = None, numbers: int = 9) -> lerobot.LeRobotPolicy:
    features = {
        STATE: SimpleNamespace(shape=[numbers]),
        LEFT: SimpleNamespace(shape=[3, 96, 128]),
    }
    model = SimpleNamespace(config=SimpleNamespace(input_features=features), name="act")
    return lerobot.LeRobotPolicy(model, action=action)


# --- what it asks for ---------------------------------------------------------------------------


def test_a_server_is_asked_for_what_the_checkpoint_reads() -> None:
    """Pictures of any size, as they are scaled; the state as long as it was."""
    assert policy().wants.mismatches(spec(pictures=True)) == []
    (said,) = policy().wants.mismatches(spec())
    assert LEFT in said and "--cameras" in said
    (said,) = policy(numbers=18).wants.mismatches(spec(pictures=True))
    assert STATE in said and "(18,)" in said and "(9,)" in said


def checkpoint(folder: Path, names: tuple[str, ...] | None, root: str = "set") -> Path:
    """What lerobot leaves beside the weights, and the data set that it names."""
    (folder / "model").mkdir(parents=True)
    trained = {"dataset": {"repo_id": "local/bgr", "root": str(folder / root)}}
    (folder / "model" / "train_config.json").write_text(json.dumps(trained), "utf-8")
    if names is not None:
        (folder / "set" / "meta").mkdir(parents=True)
        info = {"features": {"action": {"names": list(names)}}}
        (folder / "set" / "meta" / "info.json").write_text(json.dumps(info), "utf-8")
    return folder / "model"


@pytest.mark.parametrize("space", ["absolute", "relative", "velocity", "joint"])
def test_the_actions_are_those_of_the_data_set(space: str, tmp_path: Path) -> None:
    own = ActionSpec.of_space(space)
    model = checkpoint(tmp_path, own.names)
    assert lerobot.checked_action(model, None) == lerobot.checked_action(model, own) == own
    other = ActionSpec.of_space("relative" if space == "absolute" else "absolute")
    with pytest.raises(ValueError, match="was trained with actions") as said:
        lerobot.checked_action(model, other)
    assert own.names[0] in str(said.value) and other.names[0] in str(said.value)


def test_a_data_set_that_is_gone_says_nothing_of_the_actions(tmp_path: Path) -> None:
    asked = ActionSpec.of_space("velocity")
    moved = checkpoint(tmp_path / "moved", None)
    own_names = checkpoint(tmp_path / "own", ("shoulder", "elbow"))
    for model in (moved, tmp_path):
        assert lerobot.checked_action(model, None) is None
        assert lerobot.checked_action(model, asked) == asked
    assert lerobot.checked_action(own_names, None) is None


def test_a_folder_that_is_no_checkpoint_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"pretrained_model") as said:
        lerobot.check_folder(tmp_path)
    assert str(tmp_path) in str(said.value)
    lerobot.check_folder(tmp_path / "on_the_hub")
    (tmp_path / "config.json").touch()
    lerobot.check_folder(tmp_path)


# --- pictures -----------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [(96, 128), (240, 320), (84, 112), (480, 640), (3, 4)])
def test_a_pixel_is_the_mean_of_the_area_that_it_covers(size: tuple[int, int]) -> None:
    """Against the picture's integral, which knows nothing of pixels."""
    rng = np.random.default_rng(1)
    picture = rng.integers(0, 256, (480, 640, 3), dtype=np.uint8)
    found = scaled(picture, *size)
    assert found.shape == (*size, 3) and found.dtype == np.uint8
    integral = np.zeros((481, 641, 3))
    integral[1:, 1:] = picture.astype(float).cumsum(0).cumsum(1)

    def up_to(edges: np.ndarray, axis: int, values: np.ndarray) -> np.ndarray:
        low = np.minimum(edges.astype(int), values.shape[axis] - 2)
        part = np.expand_dims(edges - low, tuple(i for i in range(3) if i != axis))
        return values.take(low, axis) * (1 - part) + values.take(low + 1, axis) * part

    height, width = size
    rows = up_to(np.linspace(0, 480, height + 1), 0, integral)
    corners = up_to(np.linspace(0, 640, width + 1), 1, rows)
    mean = np.diff(np.diff(corners, axis=0), axis=1) * (height * width / 480 / 640)
    assert np.abs(found - mean).max() <= 0.5 + 1e-3


def test_what_is_seen_is_what_was_exported() -> None:
    """The exporter scales by libswscale; a grey level apart, by its rounding in YUV."""
    from surg_recording.datasets import pictures

    y, x = np.mgrid[0:480, 0:640]
    waves = [
        120 + 60 * np.sin(x / (40 + 9 * channel)) + 50 * np.cos(y / 31) for channel in range(3)
    ]
    noise = np.random.default_rng(3).normal(0, 3, (480, 640, 3))
    shown = np.clip(np.stack(waves, -1) + noise, 0, 255).astype(np.uint8)
    frame = av.VideoFrame.from_ndarray(shown, format="rgb24")
    for size in ((128, 96), (320, 240), (160, 120)):
        off = np.abs(pictures.rgb(frame, size).astype(int) - scaled(shown, size[1], size[0]))
        print(size, off.max())
        assert off.max() <= 1
    # The check sees a picture that is not the same: one pixel further.
    off = np.abs(scaled(np.roll(shown, 1, 1), 96, 128).astype(int) - scaled(shown, 96, 128))
    assert off.max() > 1


@pytest.mark.parametrize(
    ("shape", "size"),
    [((480, 640, 3), (480, 480)), ((480, 640, 3), (960, 1280)), ((480, 720, 3), (240, 320))],
    ids=["stretched", "larger", "other proportions"],
)
def test_a_picture_that_does_not_fit_is_refused(shape: Any, size: tuple[int, int]) -> None:
    with pytest.raises(SpecMismatch, match=f"{size[1]} x {size[0]}.*{shape[1]} x {shape[0]}"):
        scaled(np.zeros(shape, np.uint8), *size)


# --- trained by lerobot-train -------------------------------------------------------------------

VERSION, STEPS, ROWS = "0.4.4", 20, 20
TRAINING = {
    "policy.type": "act",
    "policy.device": "cpu",
    "policy.push_to_hub": "false",
    "policy.pretrained_backbone_weights": "null",
    "policy.chunk_size": ROWS,
    "policy.n_action_steps": ROWS,
    "policy.dim_model": 64,
    "policy.n_heads": 2,
    "policy.dim_feedforward": 64,
    "policy.n_encoder_layers": 1,
    "policy.n_vae_encoder_layers": 1,
    "policy.optimizer_lr": 1e-4,
    "policy.optimizer_lr_backbone": 1e-4,
    "batch_size": 4,
    "steps": STEPS,
    "log_freq": 5,
    "eval_freq": 0,
    "num_workers": 0,
}
"""As in docs/guide/learning/lerobot_act.md, but smaller."""


@dataclass
class Trained:
    """What lerobot made of our data set."""

    argv: list[str]  # to run a module in its environment
    env: dict[str, str]
    checkpoint: Path
    said: str


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Trained:
    from surg_recording import datasets
    from surg_recording.datasets import ExportOptions

    root = tmp_path_factory.mktemp("lerobot")
    python, env = lerobot_venv.with_policies(VERSION, root)
    folders = [
        datasets_synthetic.record(root / f"r{i}", i, 1.0 + 0.35 * i, cameras=("endoscope_left",))
        for i in (1, 2, 3)
    ]
    options = ExportOptions(
        executor="serial",
        action_space="relative",
        columns=(STATE, "observation.images.*"),
        drop=("observation.meta.tool",),
        splits={"train": 1.0},
    )
    report = datasets.load("lerobot_v30").write(folders, root / "set", options)
    assert report.ok, report
    argv = [str(python), str(lerobot_venv.PROGRAM)]
    where = {"dataset.repo_id": "local/made_up", "dataset.root": root / "set"}
    words = {**where, **TRAINING, "output_dir": root / "act"}
    done = subprocess.run(
        [*argv, "lerobot.scripts.lerobot_train", *(f"--{k}={v}" for k, v in words.items())],
        env=env,
        cwd=root,
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    last = root / "act" / "checkpoints" / "last" / "pretrained_model"
    return Trained(argv, env, last, done.stdout + done.stderr)


@contextmanager
def served(trained: Trained, address: str, *words: object) -> Iterator[subprocess.Popen[str]]:
    """The checkpoint as a policy, by our client's command line."""
    module = "surg_policy_client.adapters.lerobot"
    argv = [*trained.argv, module, str(trained.checkpoint), "--server", address]
    argv += map(str, words)
    pipe = subprocess.PIPE
    client = subprocess.Popen(argv, env=trained.env, stdout=pipe, stderr=pipe, text=True)
    try:
        yield client
    finally:
        if client.poll() is None:
            client.kill()
            client.communicate()


RELATIVE = ActionSpec.of_space("relative")


def relative(served_spec: Spec) -> Spec:
    """A server that serves the actions of the data set."""
    return replace(served_spec, action=RELATIVE)


def twice_as_large() -> Spec:
    """A server with relative actions, and pictures twice as wide and high as in the training."""
    state = spec().observation[STATE]
    picture = Feature(dtype="u1", shape=(2 * HEIGHT, 2 * WIDTH, 3))
    return Spec("bgr", 0.05, {STATE: state, LEFT: picture}, RELATIVE)


@pytest.mark.oracle
def test_lerobot_trains_on_our_data_set_and_its_checkpoint_answers(trained: Trained) -> None:
    """By lerobot's own command line; through our client over a real socket."""
    losses = [float(loss) for loss in re.findall(r" loss:(\S+)", trained.said)]
    print(f"lerobot {VERSION}, {STEPS} steps: loss {losses}")
    assert len(losses) == STEPS // 5 and np.isfinite(losses).all() and losses[-1] < losses[0]
    # Trained with a backbone of torchvision, it needs none of it any more: nothing is fetched.
    config = trained.checkpoint / "config.json"
    facts = json.loads(config.read_text("utf-8"))
    facts["pretrained_backbone_weights"] = "ResNet18_Weights.IMAGENET1K_V1"
    config.write_text(json.dumps(facts), "utf-8")
    with (
        PolicyServer(twice_as_large()) as server,
        served(trained, server.address, "--every", 2) as client,
    ):
        hello = server.wait("HELLO", 120.0).head
        assert hello["wants"]["action"]["names"] == list(RELATIVE.names)
        server.episode(0)
        first, second, third = (server.ask(step, timeout_s=60.0) for step in (7, 8, 9))
        assert [first.head["step0"], third.head["step0"]] == [8, 10]
        chunks = [message.arrays["chunk"] for message in (first, second, third)]
        assert [chunk.shape for chunk in chunks] == [(ROWS, 5), (0, 5), (ROWS, 5)]
        assert np.isfinite(chunks[0]).all() and np.abs(chunks[0] - chunks[2]).max() > 0
        server.episode(0, "end", True)
        assert client.poll() is None


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("served_spec", "words", "code", "said"),
    [
        (None, ("--device", "cuda"), 2, r"device cuda: PyTorch .* finds no GPU; allowed here: cpu"),
        (None, ("--action-space", "absolute"), 2, r"trained with actions PSM1/dx"),
        (relative(spec()), (), 1, r"the policy wants it, .*--cameras"),
        (relative(spec(pictures=True)), (), 2, rf"{WIDTH} x {HEIGHT}, the server's are 640 x 480"),
    ],
    ids=["GPU", "action space", "no pictures", "other proportions"],
)
def test_what_does_not_fit_is_said_in_words_and_nothing_is_sent(
    trained: Trained, served_spec: Spec | None, words: tuple[str, ...], code: int, said: str
) -> None:
    with (
        PolicyServer(served_spec) as server,
        served(trained, server.address, *words) as client,
    ):
        if served_spec is not None and LEFT in served_spec.observation:
            server.wait("HELLO", 120.0)
            server.episode(0)
            server.observe(1)
        _, errors = client.communicate(timeout=120.0)
        heard = [message.kind for _, message in server.heard]
    print(errors)
    assert client.returncode == code and re.search(said, errors), errors[-2000:]
    assert "Traceback" not in errors and "ACT" not in heard
