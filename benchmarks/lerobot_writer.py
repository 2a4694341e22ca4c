"""The same frames written by lerobot itself; run by bench_export in an environment with lerobot.

Usage: ``python lerobot_writer.py OUT FPS EPISODE…``. Decodes the recorded videos, gives every frame
to ``LeRobotDataset.add_frame`` and saves: H.264 with lerobot's own settings (crf 30, a key frame
every second frame, x264's default preset). Prints frames, wall and processor time as JSON.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from importlib import metadata
from pathlib import Path

import av
import numpy as np
import torch

# torchvision's compiled part is of another build than a CPU-only torch; lerobot does not need it.
_OPERATORS = torch.library.Library("torchvision", "DEF")
for _name in ("nms", "qnms"):
    _OPERATORS.define(f"{_name}(Tensor a, Tensor b, float c) -> Tensor")

from lerobot.datasets.lerobot_dataset import LeRobotDataset  # noqa: E402


def main(out: Path, fps: int, episodes: list[Path]) -> None:
    """Write, measure, print."""
    cameras = sorted(path.stem for path in episodes[0].glob("*.mp4"))
    with av.open(str(episodes[0] / f"{cameras[0]}.mp4")) as container:
        context = container.streams.video[0].codec_context
        shape = (context.height, context.width, 3)
    names = ["height", "width", "channels"]
    features = {
        f"observation.images.{name}": {"dtype": "video", "shape": shape, "names": names}
        for name in cameras
    }
    numbers = {key: np.zeros(9, np.float32) for key in ("observation.state", "action")}
    features |= {key: {"dtype": "float32", "shape": (9,), "names": None} for key in numbers}
    # From here on: what the imports have cost is no writing.
    started, used, frames = time.monotonic(), _cpu(), 0
    dataset = LeRobotDataset.create(
        "local/bench",
        fps,
        features,
        root=out,
        image_writer_threads=4 * len(cameras),
        vcodec="h264",
    )
    for episode in episodes:
        decoded = [av.open(str(episode / f"{name}.mp4")).decode(video=0) for name in cameras]
        for pictures in zip(*decoded, strict=True):
            shown = {
                f"observation.images.{name}": picture.to_ndarray(format="rgb24")
                for name, picture in zip(cameras, pictures, strict=True)
            }
            dataset.add_frame({**shown, **numbers, "task": "bench"})
            frames += 1
        # Encoders forked beside the image writer's threads may wait for ever; x264 has threads too.
        dataset.save_episode(parallel_encoding=False)
    dataset.finalize()
    wall = time.monotonic() - started
    print(
        json.dumps(
            {
                "lerobot": metadata.version("lerobot"),
                "frames": frames,
                "wall_s": wall,
                "cpu_s": _cpu() - used,
            }
        )
    )


def _cpu() -> float:
    """Processor time of this process and its ended children [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(t.ru_utime + t.ru_stime for t in used)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), [Path(name) for name in sys.argv[3:]])
