"""Colours of decoded video frames: matrix, range and rotation as the file's tags state them.

PyAV takes BT.601 and limited range for all. FFmpeg's filter ``scale`` reads each frame's tags, and
takes BT.601 only for a frame without tags.
"""

from __future__ import annotations

import json
import subprocess
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray


class Colours:
    """Turns the frames of one stream into RGB pictures."""

    def __init__(self, rotation: int = 0) -> None:
        """``rotation``: clockwise, before a picture is shown; 0, 90, 180 or 270 [degrees]."""
        self._quarters = rotation // 90
        self._kind: tuple[int, int, str] | None = None
        self._graph: tuple[Any, Any, Any] | None = None

    def __call__(self, frame: av.VideoFrame) -> NDArray[np.uint8]:
        """A decoded frame as (height, width, 3), upright."""
        kind = (frame.width, frame.height, frame.format.name)
        if kind != self._kind:
            self._kind, self._graph = kind, _graph(frame)
        assert self._graph is not None
        _, source, sink = self._graph
        source.push(frame)
        picture = sink.pull().to_ndarray()
        return np.ascontiguousarray(np.rot90(picture, -self._quarters))


def _graph(frame: av.VideoFrame) -> tuple[Any, Any, Any]:
    """A graph, where frames of this size and format go in, and where RGB comes out.

    Both ends die with the graph, which they do not hold (PyAV 14).
    """
    graph = av.filter.Graph()
    kind = {"width": frame.width, "height": frame.height, "format": frame.format}
    source = graph.add_buffer(**kind, time_base=frame.time_base or Fraction(1, 1000))
    scale = graph.add("scale", "flags=bilinear+accurate_rnd+full_chroma_int")
    shape, sink = graph.add("format", "rgb24"), graph.add("buffersink")
    source.link_to(scale)
    scale.link_to(shape)
    shape.link_to(sink)
    graph.configure()
    return graph, source, sink


def rotation_of(path: Path) -> int:
    """Clockwise turn that makes the pictures of a video upright: 0, 90, 180 or 270 [degrees]."""
    asked = ["ffprobe", "-v", "error", "-select_streams", "v:0", "-of", "json"]
    asked += ["-show_entries", "stream_side_data=rotation", str(path)]
    done = subprocess.run(asked, capture_output=True, text=True, check=False)
    streams = json.loads(done.stdout or "{}").get("streams") or [{}]
    turns = [side.get("rotation", 0) for side in streams[0].get("side_data_list", ())]
    return -round(float(sum(turns)) / 90) * 90 % 360
