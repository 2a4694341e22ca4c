"""The benchmark of the recorder reads the recorder's own message."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import pytest

from surg_cli.host.paths import ROOT
from surg_msgs.msg import RecordStatus, RecordStream

sys.path.insert(0, str(ROOT / "benchmarks" / "recording"))
import side_by_side


@pytest.mark.parametrize(
    ("frames", "there"),
    [
        ({}, False),
        ({"endoscope_left": 3}, False),
        ({"endoscope_left": 3, "endoscope_right": 1}, True),
    ],
)
def test_it_waits_for_a_frame_of_each_camera(frames: dict[str, int], there: bool) -> None:
    streams = [RecordStream(name=name, received=count) for name, count in frames.items()]
    watch: Any = SimpleNamespace(record_status=RecordStatus(streams=streams))
    plan: Any = SimpleNamespace(streams=("endoscope_left", "endoscope_right"))
    assert side_by_side._all_cameras(watch, plan) is there
