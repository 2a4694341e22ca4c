"""lerobot 0.6.1 trains on our data set and judges what it trained in the phantom, by its commands.

Opt-in: `./surg test --tier oracle`. Needs Python 3.13; its environment, made at first use, is big.
`docs/guide/learning/lerobot_act.md` shows the same commands.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np
import pytest

from helpers.lerobot.lerobot_today import VERSION, LeRobot, options
from helpers.recording import datasets_synthetic
from helpers.recording.picture_identity import HEIGHT, WIDTH
from surg_recording import datasets
from surg_recording.datasets import ExportOptions
from surg_sim.tasks import names

pytestmark = pytest.mark.oracle

STEPS = 50
SMALL = options(
    policy__chunk_size=20,
    policy__n_action_steps=20,
    policy__dim_model=64,
    policy__n_heads=2,
    policy__dim_feedforward=64,
    policy__n_encoder_layers=1,
    policy__n_vae_encoder_layers=1,
    policy__optimizer_lr=1e-4,
    policy__optimizer_lr_backbone=1e-4,
    batch_size=4,
    num_workers=0,
)
"""As in the guide, but smaller."""


@dataclass
class Trained:
    """What lerobot made of our data set."""

    lerobot: LeRobot
    checkpoint: Path
    said: str


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Trained:
    root = tmp_path_factory.mktemp("lerobot")
    lerobot = LeRobot(root)
    folders = [
        datasets_synthetic.record(root / f"r{i}", i, 1.0 + 0.35 * i, cameras=("endoscope_left",))
        for i in (1, 2, 3)
    ]
    export = ExportOptions(
        executor="serial",
        columns=("observation.state", "observation.images.*"),
        drop=("observation.meta.tool",),
        splits={"train": 1.0},
    )
    report = datasets.load("lerobot_v30").write(folders, root / "set", export)
    assert report.ok, report
    where = {"dataset__repo_id": "local/made_up", "dataset__root": root / "set"}
    act = {"policy__type": "act", "policy__device": "cpu", "policy__push_to_hub": "false"}
    act["policy__pretrained_backbone_weights"] = "null"
    steps = {"steps": STEPS, "log_freq": 10, "output_dir": root / "act"}
    said = lerobot.run("lerobot-train", *options(**where, **act, **steps), *SMALL)
    last = root / "act" / "checkpoints" / "last" / "pretrained_model"
    return Trained(lerobot, last, said)


def test_it_trains_for_fifty_steps(trained: Trained) -> None:
    losses = [float(loss) for loss in re.findall(r" loss:(\S+)", trained.said)]
    print(f"lerobot {VERSION}, {STEPS} steps: loss {losses}")
    assert len(losses) == STEPS // 10 and np.isfinite(losses).all() and losses[-1] < losses[0]
    config = json.loads((trained.checkpoint / "config.json").read_text("utf-8"))
    shapes = {key: feature["shape"] for key, feature in config["input_features"].items()}
    assert shapes == {
        "observation.state": [9],
        "observation.images.endoscope.left": [3, HEIGHT, WIDTH],
    }


def evaluated(trained: Trained, out: Path, *words: str, **more: object) -> str:
    """What lerobot-eval says of the checkpoint."""
    told = {"policy__path": trained.checkpoint, "policy__device": "cpu", "output_dir": out}
    size = {"env__observation_width": WIDTH, "env__observation_height": HEIGHT}
    return trained.lerobot.run("lerobot-eval", *options(**told, **size, **more), *words)


def test_it_judges_its_checkpoint_in_the_phantom(trained: Trained, tmp_path: Path) -> None:
    """Two episodes of a second: no success, and a film of each as long as the episode."""
    short = {"env__episode_length": 20, "eval__n_episodes": 2, "eval__batch_size": 1}
    evaluated(trained, tmp_path, **{"env__type": "surg_bgr", **short})
    told = json.loads((tmp_path / "eval_info.json").read_text("utf-8"))
    print(told["overall"])
    assert told["overall"]["n_episodes"] == 2 and told["overall"]["pc_success"] == 0.0
    films = told["overall"]["video_paths"]
    assert len(films) == 2
    for film in films:
        with av.open(str(trained.lerobot.home / film)) as container:
            pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
        assert len(pictures) == 20 and pictures[0].shape == (HEIGHT, WIDTH, 3)
        assert pictures[0].std() > 5


def test_every_task_is_a_type_and_another_is_none(trained: Trained, tmp_path: Path) -> None:
    said = trained.lerobot.run("lerobot-eval", "--help")
    assert {f"surg_{name}" for name in names()} <= set(re.findall(r"surg_\w+", said)), said[:2000]
    with pytest.raises(AssertionError, match="surg_nothing"):
        evaluated(trained, tmp_path, env__type="surg_nothing")
