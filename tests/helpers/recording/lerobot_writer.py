"""Writes data sets with the real lerobot, in an environment of its own; prints JSON lines.

Usage: ``python lerobot_writer.py SPECIFICATIONS``, a JSON list of root, fps, names, cameras, dtype,
codec, the colours of dark and bright squares and, per episode, the task of each frame. Picture k of
episode n says so; the states are k. Of each set it prints the colours that lerobot itself reads,
and what lerobot loses of them in its own videos of these pictures.
"""

from __future__ import annotations

import json
import sys
import time
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import torch

# As in lerobot_reader: torchvision is of another build than a CPU-only torch.
if torch.__version__.endswith("+cpu"):
    _OPERATORS = torch.library.Library("torchvision", "DEF")
    for _name in ("nms", "qnms"):
        _OPERATORS.define(f"{_name}(Tensor a, Tensor b, float c) -> Tensor")

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from helpers.recording.picture_identity import HEIGHT, WIDTH, Identity, draw, shades


def coded(codec: str) -> dict[str, Any]:
    """How a version is told of a codec."""
    if metadata.version("lerobot") < "0.6":
        return {"vcodec": codec}
    from lerobot.configs.video import RGBEncoderConfig

    return {"rgb_encoder": RGBEncoderConfig(vcodec=codec)}


def write(what: dict[str, Any], root: str, dtype: str) -> float:
    """One data set; returns how long that took [s]."""
    began = time.monotonic()
    dark, bright = (np.array(colour, np.uint8) for colour in what["colours"])
    state = {"dtype": "float32", "shape": (5,), "names": what["names"]}
    axes = ["height", "width", "channels"]
    image = {"dtype": dtype, "shape": (HEIGHT, WIDTH, 3), "names": axes}
    features = {"observation.state": state, "action": state}
    features |= {f"observation.images.{camera}": image for camera in what["cameras"]}
    made = LeRobotDataset.create(
        "local/foreign",
        what["fps"],
        features,
        root=root,
        use_videos=dtype == "video",
        **coded(what["codec"]),
    )
    for number, tasks in enumerate(what["episodes"]):
        for k, task in enumerate(tasks):
            values = np.array([0.01, 0.001 * k, -0.1, 0.1, 0.2], np.float32)
            shown = {
                f"observation.images.{name}": np.where(
                    draw(Identity(number, place, k)) > 128, bright, dark
                )
                for place, name in enumerate(what["cameras"])
            }
            made.add_frame({"observation.state": values, "action": values, "task": task, **shown})
        made.save_episode()
    made.finalize()
    return time.monotonic() - began


def seen(what: dict[str, Any], root: str) -> dict[str, Any]:
    """The colours that lerobot reads from a data set, by episode, frame and camera."""
    read = LeRobotDataset("local/foreign", root=root)
    return {
        f"{int(item['episode_index'])} {int(item['frame_index'])} {place}": (
            255 * shades(item[f"observation.images.{name}"].permute(1, 2, 0).numpy())[1]
        ).tolist()
        for item in (read[index] for index in range(len(read)))
        for place, name in enumerate(what["cameras"])
    }


print(json.dumps({"lerobot": metadata.version("lerobot")}))
for _what in json.loads(Path(sys.argv[1]).read_text("utf-8")):
    _root, _video = _what["root"], _what["dtype"] == "video"
    _seconds = write(_what, _root, _what["dtype"])
    _seen = _videos = seen(_what, _root)
    if not _video:
        write(_what, f"{_root}_too", "video")
        _videos = seen(_what, f"{_root}_too")
    _lost = max(np.abs(np.array(each) - _what["colours"]).max() for each in _videos.values())
    print(json.dumps({"shades": _seen, "lost": _lost, "seconds": _seconds}))
