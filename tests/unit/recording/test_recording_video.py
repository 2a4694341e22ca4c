"""Videos: every frame with its stamp, drops counted, kills survived."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from helpers.results.recording_results import note
from surg_recording.episode import table_file
from surg_recording.recording_errors import EpisodeError
from surg_recording.video import video_file
from surg_recording.video.image_frame import Frame
from surg_recording.video.video_sink import VideoSink

WIDTH, HEIGHT = 160, 120
START_NS = 1_732_147_200_123_456_789


def picture(number: int, width: int = WIDTH, height: int = HEIGHT) -> bytes:
    """A frame that carries its number as 8 grey blocks, one per bit, on a moving ground."""
    y, x = np.mgrid[:height, :width]
    image = np.stack([(x + 3 * number) % 200, (y + number) % 200, (x + y) % 200], -1)
    for bit in range(8):
        block = slice(8 + 12 * bit, 18 + 12 * bit)
        image[8:28, block] = 255 * ((number >> bit) & 1)
    return image.astype(np.uint8).tobytes()


def number_of(image: np.ndarray) -> int:
    return sum((image[12:24, 11 + 12 * b : 15 + 12 * b].mean() > 127) << b for b in range(8))


def put(sink: VideoSink, number: int, **changed: object) -> bool:
    given: dict = {
        "width": WIDTH,
        "height": HEIGHT,
        "step": 3 * WIDTH,
        "encoding": "rgb8",
        "stamp_ns": START_NS + number * 50_000_000,
        "receive_ns": number,
        **changed,
    }
    return sink.put(Frame(picture(number, given["width"], given["height"]), **given))


def test_every_frame_comes_back_with_its_number_and_stamp(tmp_path: Path) -> None:
    sink = VideoSink(tmp_path, "cam", block=True, queue_limit=4)
    for number in range(60):
        assert put(sink, number)
    sink.close()
    assert (sink.frames, sink.dropped, sink.error) == (60, 0, None)
    side = table_file.read_table(tmp_path / "cam.csv")
    assert side["stamp_ns"].tolist() == [START_NS + k * 50_000_000 for k in range(60)]
    assert side["pts"].tolist() == [k * 50_000 for k in range(60)]
    assert video_file.presentation_times(tmp_path / "cam.mp4") == side["pts"].tolist()
    images = video_file.grab(tmp_path / "cam.mp4", list(range(60)))
    assert [number_of(image) for image in images] == list(range(60))


@pytest.mark.skipif(not Path("/proc/self/autogroup").exists(), reason="no scheduling by session")
def test_an_encoder_gives_way_to_other_sessions(tmp_path: Path) -> None:
    sink = VideoSink(tmp_path, "cam", block=True)
    session = Path(f"/proc/{sink.pid}/autogroup").read_text()
    niceness = os.getpriority(os.PRIO_PROCESS, sink.pid)
    sink.close()
    assert int(session.split()[-1]) == niceness == min(19, os.nice(0) + 5)


def test_uneven_rates_keep_their_microseconds(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    stamps = START_NS + np.cumsum(rng.integers(2_000_000, 120_000_000, 40))
    sink = VideoSink(tmp_path, "cam", block=True)
    for number, stamp in enumerate(stamps):
        put(sink, number, stamp_ns=int(stamp))
    sink.close()
    expected = ((stamps - stamps[0]) // 1000).tolist()
    assert video_file.presentation_times(tmp_path / "cam.mp4") == expected


def test_a_full_queue_drops_and_counts_and_never_blocks(tmp_path: Path) -> None:
    sink = VideoSink(tmp_path, "cam", block=False, queue_limit=3)
    put(sink, 0)
    time.sleep(0.5)
    os.kill(sink.pid, signal.SIGSTOP)
    begun = time.monotonic()
    taken = sum(put(sink, number) for number in range(1, 61))
    assert time.monotonic() - begun < 2.0
    os.kill(sink.pid, signal.SIGCONT)
    sink.close()
    assert sink.dropped == 60 - taken > 0
    side = table_file.read_table(tmp_path / "cam.csv")
    assert sink.frames == len(side) == 61 - sink.dropped
    assert sink.error is None


def test_what_cannot_be_encoded_is_skipped_with_its_reason(tmp_path: Path) -> None:
    sink = VideoSink(tmp_path, "cam", block=True)
    assert put(sink, 0)
    assert not put(sink, 1, encoding="64FC1")
    assert "64FC1" in str(sink.last_skip)
    assert not put(sink, 2, step=7)
    assert "does not add up" in str(sink.last_skip)
    put(sink, 3, width=80, step=240)
    put(sink, 4, stamp_ns=START_NS)  # not later than the first
    assert put(sink, 5)
    sink.close()
    assert (sink.frames, sink.dropped, sink.error) == (2, 4, None)
    side = table_file.read_table(tmp_path / "cam.csv")
    assert side["dropped"].sum() == 4


def test_other_encodings_and_odd_sizes(tmp_path: Path) -> None:
    """FFmpeg has a short cut for b, g, r that is four levels off."""
    bgr, grey = (40, 30, 200), (90, 90, 90)
    for encoding, colour in (("bgr8", bgr), ("bgr8", grey), ("8UC3", bgr), ("mono8", grey)):
        sink = VideoSink(tmp_path, encoding, block=True)
        pixel = bytes(colour[:1] if encoding == "mono8" else colour)
        step = 161 * len(pixel)
        for k in range(3):
            sink.put(Frame(pixel * 161 * 121, 161, 121, step, encoding, k * 10**9 + 1, 0))
        sink.close()
        assert (sink.frames, sink.error) == (3, None)
        (image,) = video_file.grab(tmp_path / f"{encoding}.mp4", [2])
        assert image.shape == (120, 160, 3)
        assert np.abs(image.mean(axis=(0, 1)) - colour[::-1]).max() <= 2


def test_a_killed_encoder_is_an_error_not_a_hang(tmp_path: Path) -> None:
    for block in (True, False):
        sink = VideoSink(tmp_path, f"cam{block}", block=block, queue_limit=5)
        for number in range(30):
            put(sink, number)
            time.sleep(0.01)
        os.kill(sink.pid, signal.SIGKILL)
        time.sleep(0.1)
        begun = time.monotonic()
        for number in range(30, 60):
            put(sink, number)
        sink.close()
        assert time.monotonic() - begun < 3.0
        assert sink.error is not None
        assert sink.dropped + sink.frames == sink.received == 60


_VICTIM = """
import sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from surg_recording.video.image_frame import Frame
from surg_recording.video.video_sink import VideoSink
import numpy as np
sink = VideoSink(Path(sys.argv[1]), "cam", block=False)
rng = np.random.default_rng(0)
ground = rng.integers(0, 255, (480, 640, 3), dtype=np.uint8)
assert sink.wait_ready(20.0)
print(sink.pid, flush=True)
begun, k = time.monotonic(), 0
while True:
    k += 1
    time.sleep(max(0.0, begun + k * 0.05 - time.monotonic()))
    data = np.roll(ground, 5 * k, axis=1).tobytes()
    sink.put(Frame(data, 640, 480, 1920, "rgb8", time.monotonic_ns(), 0))
"""


@pytest.mark.timed
@pytest.mark.parametrize("whom", ["recorder", "encoder", "both"])
def test_kill_9_loses_at_most_half_a_second_of_video(tmp_path: Path, full: bool, whom: str) -> None:
    rng = np.random.default_rng(11)
    kills, worst = (20 if full else 1), 0.0
    for kill in range(kills):
        folder = tmp_path / str(kill)
        folder.mkdir()
        with subprocess.Popen(
            [sys.executable, "-c", _VICTIM, str(folder), ""],
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        ) as victim:
            assert victim.stdout is not None
            encoder = int(victim.stdout.readline())
            time.sleep(rng.uniform(1.2, 2.5))
            killed = time.monotonic_ns()
            if whom != "recorder":
                os.kill(encoder, signal.SIGKILL)
            if whom != "encoder":
                os.kill(victim.pid, signal.SIGKILL)
            time.sleep(0.3)
            if whom == "encoder":
                os.kill(victim.pid, signal.SIGKILL)
        _wait_gone(encoder)
        frames = video_file.mend(folder / "cam.mp4", folder / "cam.csv")
        side = table_file.read_table(folder / "cam.csv")
        assert frames == len(side)
        assert video_file.presentation_times(folder / "cam.mp4") == side["pts"].tolist()
        decoded = video_file.grab(folder / "cam.mp4", list(range(frames)))
        assert len(decoded) == frames
        worst = max(worst, (killed - int(side["stamp_ns"][-1])) * 1e-9)
    victim_name = "both" if whom == "both" else f"the {whom}"
    note(f"kill -9 of {victim_name}: video", kills, f"at most {worst:.3f} s lost (≤ 0.5)")
    assert worst <= 0.5


def _wait_gone(pid: int) -> None:
    deadline = time.monotonic() + 30.0
    while time.monotonic() < deadline:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except OSError:
            return
        if state == "Z":
            return
        time.sleep(0.02)
    raise AssertionError(f"encoder {pid} still runs")


def test_no_video_at_all_is_said(tmp_path: Path) -> None:
    (tmp_path / "cam.mp4").write_bytes(b"")
    with pytest.raises(EpisodeError, match="no readable video"):
        video_file.presentation_times(tmp_path / "cam.mp4")
    (tmp_path / "cam.csv").write_text("frame,stamp_ns,receive_ns,pts,dropped\n0,1,1,0,0\n")
    assert video_file.mend(tmp_path / "cam.mp4", tmp_path / "cam.csv") == 0
    assert len(table_file.read_table(tmp_path / "cam.csv")) == 0
