"""Draws the instrument's tip into an exported video, from joints and calibration alone.

It shows through which lens a data set looks, and from where. It reads the video,
``observation.camera_pose``, ``observation.cartesian_state`` and ``meta/calibration/``::

    ./surg run endoscope_guidance --episodes 1 --out runs/guidance
    ./surg episode export runs/guidance --format lerobot --out runs/guidance_dataset
    ./surg dev shell -c "python3 -m surg_recording.video.tip_in_video runs/guidance_dataset"
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_core.transforms import inverse_pose, make_pose

Array = npt.NDArray[np.float64]

EYES = {"observation.images.endoscope.left": "endoscope_left",
        "observation.images.endoscope.right": "endoscope_right"}  # fmt: skip
"""Feature of a picture → camera."""


def tip_pixels(dataset: Path, arm: str, feature: str, episode: int = 0) -> Array:
    """Where the tip of an arm is in each picture of an episode of a LeRobot 2.1 data set.

    Returns:
        (frames, 2) pixels from the centre of the upper left one.
    """
    from pyarrow import parquet

    info = json.loads((dataset / "meta/info.json").read_text("utf-8"))
    index = json.loads((dataset / "meta/calibration/index.json").read_text("utf-8"))
    calibration = index["sets"][index["episodes"][episode]]
    names = info["features"]["observation.cartesian_state"]["names"]
    place = names.index(f"{arm}/x")

    table = parquet.read_table(next((dataset / "data").rglob(f"episode_{episode:06d}.parquet")))
    state = np.array(table["observation.cartesian_state"].to_pylist())
    camera = np.array(table["observation.camera_pose"].to_pylist())
    X_WB = np.array(calibration["endoscope"]["bases"][arm])
    p_WTip = state[:, place : place + 3] @ X_WB[:3, :3].T + X_WB[:3, 3]
    X_LEye = np.eye(4)
    if EYES[feature] == "endoscope_right":
        X_LEye = np.array(calibration["endoscope"]["X_LR"])
    p_Eye = []
    for seven, p_W in zip(camera, p_WTip, strict=True):
        X_EyeW = inverse_pose(make_pose(seven[:3], seven[3:]) @ X_LEye)
        p_Eye.append(X_EyeW[:3, :3] @ p_W + X_EyeW[:3, 3])
    return project(np.array(p_Eye), calibration["camera_info"][EYES[feature]])


def project(points: Array, model: Mapping[str, Any]) -> Array:
    """Points (n, 3) [m] of the camera's optical frame as pixels (n, 2) of its raw picture."""
    import cv2

    K, D = np.array(model["K"]).reshape(3, 3), np.array(model["D"], dtype=np.float64)
    still = np.zeros(3)
    if model["distortion_model"] == "equidistant":
        found, _ = cv2.fisheye.projectPoints(points[:, None], still, still, K, D)
    else:
        found, _ = cv2.projectPoints(points, still, still, K, D)
    return np.asarray(found, dtype=np.float64).reshape(-1, 2)


def draw(video: Path, pixels: Array, out: Path) -> int:
    """Write the video with a ring round each pixel; returns the number of frames."""
    import av
    import cv2

    with av.open(str(video)) as source, av.open(str(out), "w") as target:
        shown = source.streams.video[0]
        stream = target.add_stream("h264", rate=shown.average_rate)
        stream.width, stream.height, stream.pix_fmt = shown.width, shown.height, "yuv420p"
        for frame, (u, v) in zip(source.decode(shown), pixels, strict=True):
            picture = frame.to_ndarray(format="rgb24")
            cv2.circle(picture, (round(u), round(v)), 8, (0, 255, 0), 1, cv2.LINE_AA)
            drawn = av.VideoFrame.from_ndarray(picture, format="rgb24")
            target.mux(stream.encode(drawn))
        target.mux(stream.encode(None))
    return len(pixels)


def main() -> None:
    """Draw the first episode."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--arm", default="PSM1")
    parser.add_argument("--feature", choices=tuple(EYES), default=next(iter(EYES)))
    parser.add_argument("--out", type=Path, default=Path("tip.mp4"))
    options = parser.parse_args()
    if not (options.dataset / "meta/calibration/index.json").is_file():
        raise SystemExit(
            f"{options.dataset}: no meta/calibration/index.json; export it anew: "
            "./surg episode export"
        )
    pixels = tip_pixels(options.dataset, options.arm, options.feature)
    video = next(options.dataset.glob(f"videos/*/{options.feature}/episode_000000.mp4"))
    frames = draw(video, pixels, options.out)
    print(f"{frames} frames with the tip of {options.arm} -> {options.out}")


if __name__ == "__main__":
    main()
