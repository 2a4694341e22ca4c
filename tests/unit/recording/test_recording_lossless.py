"""Pictures and measured values that come back bit for bit, or a copied stream that does."""

from __future__ import annotations

import hashlib
from pathlib import Path
from types import SimpleNamespace

import av
import numpy as np
import pytest

from surg_recording.recording_errors import EpisodeError
from surg_recording.video import exact_values, video_embed, video_file
from surg_recording.video.camera_sink import CameraSink
from surg_recording.video.image_frame import Frame, frame_of
from surg_recording.video.video_sink import VideoSink

START_NS, PERIOD_NS = 10**18, 50_000_000
HEIGHT, WIDTH = 61, 95


def written(folder: Path, encoding: str, images: list[np.ndarray], **options: str) -> VideoSink:
    """A video of these images, complete."""
    sink = VideoSink(folder, "cam", block=True, **options)
    for number, image in enumerate(images):
        height, width = image.shape[:2]
        data = image.tobytes()
        stamp = START_NS + number * PERIOD_NS
        frame = Frame(data, width, height, len(data) // height, encoding, stamp, stamp)
        assert sink.put(frame), sink.last_skip
    sink.close()
    assert (sink.frames, sink.dropped, sink.error) == (len(images), 0, None), sink.last_skip
    return sink


def noise(seed: int, channels: int, count: int = 5) -> list[np.ndarray]:
    """Pictures without any structure that a coder could guess."""
    rng = np.random.default_rng(seed)
    shape = (HEIGHT, WIDTH, channels) if channels > 1 else (HEIGHT, WIDTH)
    return [rng.integers(0, 256, shape, np.uint8) for _ in range(count)]


@pytest.mark.parametrize(
    ("encoding", "order"),
    [("rgb8", [0, 1, 2]), ("bgr8", [2, 1, 0]), ("rgba8", [0, 1, 2]), ("mono8", None)],
)
def test_lossless_means_every_pixel(tmp_path: Path, encoding: str, order: list[int] | None) -> None:
    images = noise(3, 1 if order is None else 4 if encoding == "rgba8" else 3)
    sink = written(tmp_path, encoding, images, quality="lossless")
    read = video_file.grab(sink.path, list(range(len(images))))
    for image, back in zip(images, read, strict=True):
        given = np.repeat(image[..., None], 3, axis=2) if order is None else image[..., order]
        np.testing.assert_array_equal(back, given)


def test_a_better_quality_is_nearer_to_the_picture_and_larger(tmp_path: Path) -> None:
    ramp = np.add.outer(np.arange(HEIGHT), np.arange(WIDTH))[..., None] * np.array([1, 2, 3]) % 256
    images = [np.roll(ramp, 3 * k, axis=1).astype(np.uint8) for k in range(5)]
    errors, sizes = [], []
    for quality in ("40", "23", "5", "lossless"):
        folder = tmp_path / quality
        folder.mkdir()
        path = written(folder, "rgb8", images, quality=quality).path
        (back,) = video_file.grab(path, [4])
        cut = images[4][: back.shape[0], : back.shape[1]]
        errors.append(float(np.abs(back.astype(int) - cut).mean()))
        sizes.append(path.stat().st_size)
    assert errors == sorted(errors, reverse=True) and errors[-1] == 0.0 < errors[-2], errors
    assert sizes == sorted(sizes), sizes


@pytest.mark.parametrize("encoding", ["16UC1", "mono16", "32FC1"])
def test_measured_values_come_back_as_they_were(tmp_path: Path, encoding: str) -> None:
    rng = np.random.default_rng(5)
    if encoding == "32FC1":
        images = [rng.uniform(0.04, 0.13, (HEIGHT, WIDTH)).astype("<f4") for _ in range(4)]
        images[1][:3, :5] = [np.nan, np.inf, -np.inf, -0.0, 1e-42]
    else:
        images = [rng.integers(0, 65536, (HEIGHT, WIDTH)).astype("<u2") for _ in range(4)]
    sink = written(tmp_path, encoding, images)
    read = list(exact_values.read(sink.path))
    assert [back.tobytes() for back in read] == [image.tobytes() for image in images]
    assert {back.dtype for back in read} == {images[0].dtype}
    (third,) = exact_values.read(sink.path, [2])
    assert third.tobytes() == images[2].tobytes()
    with pytest.raises(EpisodeError, match="frame 9"):
        list(exact_values.read(sink.path, [1, 9]))


def test_a_video_without_frames_says_which_one_is_missing(tmp_path: Path) -> None:
    path = tmp_path / "empty.mp4"
    with av.open(str(path), "w", format="mp4", options={"movflags": "empty_moov"}) as container:
        stream = container.add_stream("png", rate=20)
        stream.pix_fmt, stream.width, stream.height = "gray16be", WIDTH, HEIGHT
        stream.codec_context.open()
        container.start_encoding()
    with pytest.raises(EpisodeError, match=r"no measured values|frame 0 is needed"):
        list(exact_values.read(path, [0]))
    with pytest.raises(EpisodeError, match=r"no readable video|holds no frame"):
        video_embed.embed(path, 10**7)


def test_colours_are_no_measured_values(tmp_path: Path) -> None:
    path = written(tmp_path, "rgb8", noise(7, 3)).path
    with pytest.raises(EpisodeError, match="h264"):
        list(exact_values.read(path))


@pytest.mark.parametrize(("encoding", "kind"), [("16UC1", ">u2"), ("32FC1", ">f4")])
def test_a_camera_of_the_other_byte_order(tmp_path: Path, encoding: str, kind: str) -> None:
    values = np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH).astype(kind)
    message = SimpleNamespace(
        data=values.tobytes(),
        height=HEIGHT,
        width=WIDTH,
        step=WIDTH * values.itemsize,
        encoding=encoding,
        is_bigendian=1,
    )
    sink = VideoSink(tmp_path, "cam", block=True)
    assert sink.put(frame_of(message, START_NS, START_NS))
    message.data = message.data[:-1]
    assert not sink.put(frame_of(message, START_NS + PERIOD_NS, START_NS))
    assert "no whole number of" in str(sink.last_skip)
    sink.close()
    (back,) = exact_values.read(sink.path)
    np.testing.assert_array_equal(back, values)


def test_a_killed_recording_of_depth_keeps_whole_frames(tmp_path: Path) -> None:
    images = [np.full((HEIGHT, WIDTH), 1000 + k, "<u2") for k in range(20)]
    sink = written(tmp_path, "16UC1", images)
    data = sink.path.read_bytes()
    sink.path.write_bytes(data[: len(data) * 2 // 3])
    kept = video_file.mend(sink.path, sink.sidecar)
    assert 5 <= kept < 20
    read = list(exact_values.read(sink.path))
    assert [int(back[0, 0]) for back in read] == [1000 + k for k in range(kept)]


def test_a_camera_that_turns_from_colours_to_depth_begins_a_new_part(tmp_path: Path) -> None:
    camera = CameraSink(tmp_path, "cam", block=True)
    rgb, depth = noise(1, 3)[0], np.full((HEIGHT, WIDTH), 700, "<u2")
    for number, (image, encoding) in enumerate([(rgb, "rgb8"), (depth, "16UC1")]):
        data, stamp = image.tobytes(), START_NS + number * PERIOD_NS
        step = len(data) // HEIGHT
        assert camera.put(Frame(data, WIDTH, HEIGHT, step, encoding, stamp, stamp))
    camera.close()
    assert camera.frames == 2 and "from rgb8 to 16UC1" in camera.changes[0]
    (back,) = exact_values.read(tmp_path / "cam.2.mp4")
    np.testing.assert_array_equal(back, depth)


@pytest.mark.parametrize(("encoding", "quality"), [("16UC1", "23"), ("rgb8", "lossless")])
def test_a_page_shows_what_browsers_do_not_play(
    tmp_path: Path, encoding: str, quality: str
) -> None:
    near = np.full((HEIGHT, WIDTH), 2000, "<u2")
    near[:, : WIDTH // 2] = 500
    images = [near] * 4 if encoding == "16UC1" else noise(2, 3, 4)
    path = written(tmp_path, encoding, images, quality=quality).path
    shown = video_embed.embed(path, 10**7)
    played = tmp_path / "shown.mp4"
    played.write_bytes(shown.data)
    with av.open(str(played)) as container:
        context = container.streams.video[0].codec_context
        assert (context.name, context.pix_fmt) == ("h264", "yuv420p")
    assert shown.frames.tolist() == [0, 1, 2, 3]
    if encoding == "16UC1":
        (image,) = video_file.grab(played, [0])
        assert image[:, : WIDTH // 4].mean() > 200 > 60 > image[:, -WIDTH // 4 :].mean()


def test_depth_is_the_same_file_in_every_run(tmp_path: Path) -> None:
    hashes = set()
    for name in "ab":
        folder = tmp_path / name
        folder.mkdir()
        path = written(folder, "16UC1", [np.full((HEIGHT, WIDTH), 9, "<u2")] * 3).path
        hashes.add(hashlib.sha256(path.read_bytes()).hexdigest())
    assert len(hashes) == 1
