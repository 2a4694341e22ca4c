"""Sources of pictures: what cannot be opened says why, files play at their pace."""

from __future__ import annotations

import builtins
import errno
import os
import time
from fractions import Fraction
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import cv2
import numpy as np
import pytest

from helpers.perception import recorded_pairs
from surg_perception.capture import picture_source
from surg_perception.capture.picture_source import Grabbed, SourceError, SourceUri, Wanted
from surg_perception.sources import gstreamer_source, v4l2_source

NS = 1_000_000_000
OUTSIDE = """\
import numpy as np
from surg_perception.capture.picture_source import Grabbed, PictureSource

class Noise(PictureSource):
    keys = ("shade",)

    def pictures(self):
        for n in range(int(self.address)):
            shape = (4, 6, 3)
            yield Grabbed(n, n, (np.full(shape, int(self.options["shade"]), np.uint8),))
"""


class FakeTime:
    """A clock that sleeping moves."""

    def __init__(self) -> None:
        self.now_ns = 1_700_000_000 * NS

    def now(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.now_ns += round(seconds * NS)


def wanted(**changes: Any) -> Wanted:
    clock = FakeTime()
    return Wanted(clock.now, clock.sleep, **changes)


def refused(uri: str, **changes: Any) -> SourceError:
    with pytest.raises(SourceError) as error:
        list(SourceUri.parse(uri).open(wanted(**changes)).pictures())
    return error.value


def played(uri: str, count: int, **changes: Any) -> list[Grabbed]:
    pictures = SourceUri.parse(uri).open(wanted(**changes)).pictures()
    return [next(pictures) for _ in range(count)]


@pytest.mark.parametrize(
    ("uri", "words"),
    [
        ("/dev/video0", "KIND:ADDRESS"),
        ("v4l2:", "KIND:ADDRESS"),
        ("usb:0", "v4l2, file, pipe"),
        ("missing.py:0", "missing.py"),
        ("v4l2:/dev/video0?fps=30", "'fps'"),
        ("file:a.mp4?rate=fast", "'fast'"),
        ("pipe:/run/p?format=h264", "y4m, mjpeg"),
    ],
)
def test_a_uri_that_cannot_be_used_is_refused(uri: str, words: str) -> None:
    error = refused(uri)
    assert error.code == "bad_address"
    assert words in str(error)


def test_devices_of_a_uri() -> None:
    def devices(text: str) -> list[str]:
        return [str(uri) for uri in SourceUri.parse(text).devices()]

    both = devices("v4l2:/dev/video0+/dev/video2?format=mjpeg")
    assert both == ["v4l2:/dev/video0?format=mjpeg", "v4l2:/dev/video2?format=mjpeg"]
    assert devices("file:a.mp4+b.mp4") == ["file:a.mp4+b.mp4"]
    assert devices("gst:a ! b c=1+2?d=3") == ["gst:a ! b c=1+2?d=3"]


def test_a_source_from_outside_is_found_by_path(tmp_path: Path) -> None:
    file = tmp_path / "noise.py"
    file.write_text(OUTSIDE)
    grabbed = played(f"{file}:2?shade=7", 2)
    assert [g.stamp_ns for g in grabbed] == [0, 1]
    assert (grabbed[0].pictures[0] == 7).all()
    assert refused(f"{file}:2?depth=7").code == "bad_address"


def test_a_source_from_outside_is_found_by_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    kind = type("Noise", (picture_source.PictureSource,), {"pictures": lambda self: iter(())})
    point = SimpleNamespace(name="noise", value="noise:Noise", load=lambda: kind)
    monkeypatch.setattr(
        metadata, "entry_points", lambda group: [point] if "sources" in group else []
    )
    assert list(SourceUri.parse("noise:0").open(wanted()).pictures()) == []


@pytest.mark.parametrize(
    ("number", "code", "words"),
    [
        (errno.ENOENT, "no_device", "plug the device in"),
        (errno.ENODEV, "no_device", "by-id"),
        (errno.EBUSY, "busy", "close the other program"),
        (errno.EACCES, "no_permission", "usermod -aG video"),
        (errno.EINVAL, "wrong_format", "--list-formats-ext"),
    ],
)
def test_a_device_that_cannot_be_opened_says_why(
    number: int, code: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def busy(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(av, "open", busy)
    error = refused("v4l2:/dev/video7")
    assert error.code == code
    assert words in str(error)
    assert "endoscope.source: v4l2:/dev/video7" in str(error)


def test_a_device_that_is_not_there_is_named() -> None:
    assert refused("v4l2:/dev/video_not_there").code == "no_device"


class FakeContainer:
    """A device that gives what it has, whatever is asked for."""

    def __init__(self, options: dict[str, str], driver_us: int = 1) -> None:
        self.options, self.driver_us = options, driver_us
        codec = SimpleNamespace(name="rawvideo", pix_fmt="yuyv422")
        stream = SimpleNamespace(width=1280, height=720, average_rate=25, codec_context=codec)
        self.streams = SimpleNamespace(video=[stream])
        self.closed = False

    def demux(self, _: object) -> Any:
        frame = av.VideoFrame.from_ndarray(np.zeros((2, 2, 3), np.uint8), format="rgb24")
        yield SimpleNamespace(
            pts=self.driver_us,
            time_base=Fraction(1, 10**6),
            decode=lambda: [frame],
            stream=self.streams.video[0],
        )
        raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))

    def close(self) -> None:
        self.closed = True


@pytest.mark.parametrize(
    ("changes", "uri", "key", "words"),
    [
        ({"size": (1920, 1080)}, "v4l2:/dev/video0", "size", "1920 x 1080"),
        ({"rate": 30.0}, "v4l2:/dev/video0", "rate", "25/s"),
        ({}, "v4l2:/dev/video0?format=mjpeg", "source", "yuyv422"),
    ],
)
def test_another_size_rate_or_format_is_refused(
    changes: dict[str, Any], uri: str, key: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = []

    def opened(_: str, options: dict[str, str], **__: object) -> FakeContainer:
        made.append(FakeContainer(options))
        return made[-1]

    monkeypatch.setattr(av, "open", opened)
    error = refused(uri, **changes)
    assert error.code == "wrong_format"
    assert f"endoscope.{key}" in str(error)
    assert words in str(error)
    assert made[0].closed
    assert made[0].options["timestamps"] == "default"


@pytest.mark.parametrize(
    ("driver_us", "expected"),
    [
        (50_000_000 - 30_000, 1_700_000_000 * NS - 30_000_000),
        (1_700_000_000_000_000 - 30_000, 1_700_000_000 * NS - 30_000_000),
        (7_000, 1_700_000_000 * NS),
    ],
    ids=["monotonic", "wall", "unknown"],
)
def test_a_drivers_stamp_is_the_time_of_capture(
    driver_us: int, expected: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(av, "open", lambda _, options, **__: FakeContainer(options, driver_us))
    source = SourceUri.parse("v4l2:/dev/video0").open(wanted(monotonic=lambda: 50 * NS))
    assert next(source.pictures()).stamp_ns == expected


def test_an_unplugged_device_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(av, "open", lambda _, options, **__: FakeContainer(options))
    source = SourceUri.parse("v4l2:/dev/video0").open(wanted())
    with pytest.raises(SourceError) as error:
        list(source.pictures())
    assert error.value.code == "gone"
    assert "plug it in again" in str(error.value)


def test_a_device_is_opened_again_by_its_persistent_name(tmp_path: Path) -> None:
    device = tmp_path / "video4"
    device.touch()
    for kind in ("by-path", "by-id"):
        (tmp_path / "v4l" / kind).mkdir(parents=True)
        (tmp_path / "v4l" / kind / f"usb-{kind}").symlink_to(device)
    assert v4l2_source.persistent_name(str(device), tmp_path / "v4l").endswith("by-id/usb-by-id")
    (tmp_path / "v4l" / "by-id" / "usb-by-id").unlink()
    assert v4l2_source.persistent_name(str(device), tmp_path / "v4l").endswith("usb-by-path")
    assert v4l2_source.persistent_name("/dev/other", tmp_path / "v4l") == "/dev/other"


def test_without_gstreamer_the_package_set_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def missing(name: str, *rest: Any) -> Any:
        if name == "gi":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", missing)
    error = refused("gst:videotestsrc")
    assert error.code == "no_library"
    assert "gst:videotestsrc: " in str(error)
    assert "./surg dev setup --gstreamer" in str(error)


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        ('no element "decklinkvideosrc"', "no_library", "--gstreamer"),
        ("Cannot identify device '/dev/video9'. No such file", "no_device", "no such device"),
        ("Internal data stream error: not-negotiated (-4)", "wrong_format", "size, rate"),
        ("something else", "failed", "something else"),
    ],
)
def test_messages_of_gstreamer_are_translated(text: str, code: str, words: str) -> None:
    error = gstreamer_source.translated("gst:decklinkvideosrc", text)
    assert error.code == code
    assert words in str(error)


def test_a_pipeline_that_does_not_start_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """As that of a DeckLink card without its library."""
    bus = SimpleNamespace(timed_pop_filtered=lambda *_: None)
    states = []
    pipeline = SimpleNamespace(
        get_by_name=lambda _: None,
        set_state=states.append,
        get_state=lambda _: ("failure", None, None),
        get_bus=lambda: bus,
    )
    gst = SimpleNamespace(
        parse_launch=lambda _: pipeline,
        State=SimpleNamespace(PLAYING="playing", NULL="null"),
        StateChangeReturn=SimpleNamespace(FAILURE="failure"),
        MessageType=SimpleNamespace(ERROR=1, EOS=2),
        SECOND=NS,
        MSECOND=NS // 1000,
    )
    monkeypatch.setattr(gstreamer_source, "gstreamer", lambda _: gst)
    assert refused("gst:whatever").code == "failed"
    assert states == ["playing", "null"]


def test_gstreamers_pictures_are_rgb_and_young() -> None:
    gi = pytest.importorskip("gi")
    if not gi.Repository.get_default().enumerate_versions("Gst"):
        pytest.skip("GStreamer is optional: ./surg dev setup --gstreamer")
    red = "videotestsrc pattern=red is-live=true num-buffers=3 ! video/x-raw,width=33,height=18"
    source = SourceUri.parse(f"gst:{red}").open(Wanted(time.time_ns, time.sleep))
    grabbed: list[Grabbed] = []
    with pytest.raises(SourceError) as error:
        grabbed.extend(source.pictures())
    source.close()
    assert error.value.code == "ended"
    assert [g.pictures[0].shape for g in grabbed] == [(18, 33, 3)] * 3
    assert np.abs(grabbed[0].pictures[0].astype(int) - (255, 0, 0)).max() < 8
    assert all(0 <= g.received_ns - g.stamp_ns < NS for g in grabbed)


def test_a_folder_of_pairs_is_played_at_its_rate(tmp_path: Path) -> None:
    for number in range(3):
        for eye, shade in (("left", 50), ("right", 90)):
            name = tmp_path / f"{eye}_{number:03d}.png"
            cv2.imwrite(str(name), np.full((48, 64, 3), shade + number, np.uint8))
    grabbed = played(f"file:{tmp_path}?rate=20&loop", 7)
    assert [g.stamp_ns - grabbed[0].stamp_ns for g in grabbed] == [n * NS // 20 for n in range(7)]
    assert all(g.received_ns == g.stamp_ns for g in grabbed)
    shades = [[int(picture[0, 0, 0]) for picture in g.pictures] for g in grabbed]
    assert shades == [[50 + n % 3, 90 + n % 3] for n in range(7)]


def test_a_video_keeps_its_own_times_and_ends(tmp_path: Path) -> None:
    recorded_pairs.side_by_side(tmp_path / "a.mp4", 4, 320, 240)
    source = SourceUri.parse("file:a.mp4").open(wanted(folder=tmp_path))
    grabbed: list[Grabbed] = []
    with pytest.raises(SourceError) as error:
        grabbed.extend(source.pictures())
    assert error.value.code == "ended"
    times = np.diff([g.stamp_ns for g in grabbed])
    assert np.allclose(times, NS / 30, atol=1e6)
    assert [recorded_pairs.number_of(g.pictures[0][:, :320]) for g in grabbed] == [0, 1, 2, 3]


def test_an_episodes_videos_are_its_eyes(tmp_path: Path) -> None:
    for name in ("endoscope_left.mp4", "endoscope_right.mp4"):
        recorded_pairs.side_by_side(tmp_path / name, 2, 160, 120)
    grabbed = played(f"file:{tmp_path}", 2)
    assert [len(g.pictures) for g in grabbed] == [2, 2]


def test_files_that_cannot_be_played_are_named(tmp_path: Path) -> None:
    assert refused(f"file:{tmp_path}/none.mp4").code == "no_device"
    assert refused(f"file:{tmp_path}").code == "wrong_format"
    (tmp_path / "text.mp4").write_text("no video")
    assert refused(f"file:{tmp_path}/text.mp4").code == "wrong_format"
    cv2.imwrite(str(tmp_path / "left_0.png"), np.zeros((8, 8, 3), np.uint8))
    assert "1 pictures left*, 0 right*" in str(refused(f"file:{tmp_path}"))
    (tmp_path / "right_0.png").write_text("no picture")
    assert "right_0.png" in str(refused(f"file:{tmp_path}"))


def test_a_slow_machine_plays_later_and_never_falls_behind_for_good(tmp_path: Path) -> None:
    for number in range(6):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.zeros((8, 8, 3), np.uint8))
    clock = FakeTime()
    ages = []
    source = SourceUri.parse(f"file:{tmp_path}?rate=10").open(Wanted(clock.now, clock.sleep))
    with pytest.raises(SourceError):
        for grabbed in source.pictures():
            ages.append(clock.now_ns - grabbed.stamp_ns)
            clock.now_ns += NS  # the reader needs a second for each
    assert len(ages) == 6
    assert max(ages) == 0


def test_a_pipe_is_read_picture_by_picture(tmp_path: Path) -> None:
    path = tmp_path / "stream.y4m"
    frame = b"FRAME\n" + bytes([200]) * (32 * 16) + bytes([128]) * (32 * 16 // 2)
    path.write_bytes(b"YUV4MPEG2 W32 H16 F30:1 Ip A1:1 C420jpeg\n" + 3 * frame)
    pictures = SourceUri.parse(f"pipe:{path}").open(wanted()).pictures()
    assert [next(pictures).pictures[0].shape for _ in range(3)] == [(16, 32, 3)] * 3
    with pytest.raises(SourceError) as error:
        next(pictures)
    assert error.value.code == "gone"
