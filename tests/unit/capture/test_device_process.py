"""The process of one device: eyes with one stamp, or why there are none; reopening."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from importlib import metadata
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from helpers.perception import recorded_pairs
from surg_perception.capture import frame_pipe
from surg_perception.capture.capture_parameters import CaptureSettings
from surg_perception.capture.device_process import REOPEN_S, messages
from surg_perception.capture.frame_pipe import DeviceState, FramePipeError, Pictures
from surg_perception.capture.picture_source import (
    Grabbed,
    PictureSource,
    SourceError,
    Wanted,
)
from surg_ros.params import ParamError, read

MS = 1_000_000
NS = 1000 * MS
PAIR = np.hstack([recorded_pairs.scene(1, 320, 240), recorded_pairs.scene(1, 320, 240, -60)])


class Script(PictureSource):
    """A device that does what a test has written down: pictures, or a SourceError."""

    acts: ClassVar[list[Any]] = []
    opened: ClassVar[list[str]] = []

    def __init__(self, address: str, options: Mapping[str, str], wanted: Wanted) -> None:
        super().__init__(address, options, wanted)
        self.opened.append(address)
        if isinstance(self.acts[0], SourceError):
            raise self.acts.pop(0)

    @property
    def reopen(self) -> str:
        return "persistent"

    def pictures(self) -> Iterator[Grabbed]:
        while True:
            act = self.acts.pop(0)
            if isinstance(act, SourceError):
                raise act
            yield act


class Over(Exception):
    """The script has ended."""


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> type[Script]:
    Script.acts, Script.opened = [], []
    point = SimpleNamespace(name="script", value="tests:Script", load=lambda: Script)
    monkeypatch.setattr(metadata, "entry_points", lambda group: [point])
    return Script


def run(acts: list[Any], sleeps: list[float] | None = None, **changes: Any) -> list[Any]:
    """What the process says until the script ends."""
    Script.acts = acts
    waited = [] if sleeps is None else sleeps

    def sleep(seconds: float) -> None:
        waited.append(seconds)
        if not Script.acts:
            raise Over

    given = {"source": "script:/dev/video0", "layout": "sbs", **changes}
    settings = CaptureSettings(**given)
    found = []
    with pytest.raises((Over, IndexError)):
        for message in messages(settings, Wanted(lambda: 0, sleep)):
            found.append(message)
    return found


def grabbed(stamp: int, picture: np.ndarray = PAIR) -> Grabbed:
    return Grabbed(stamp, stamp + 5 * MS, (picture,))


def test_a_pair_leaves_with_one_stamp_less_the_latency(script: type[Script]) -> None:
    state, pair = run([grabbed(NS)], latency=0.08)
    assert state.code == frame_pipe.OPEN
    assert pair.stamp_ns == NS - 80 * MS
    assert [eye.shape for eye in pair.eyes] == [(240, 320, 3)] * 2
    assert [recorded_pairs.number_of(eye) for eye in pair.eyes] == [1, 1]


def test_an_eye_is_published_at_the_wanted_size(script: type[Script]) -> None:
    pair = run([grabbed(NS)], publish_width=160, publish_height=160)[1]
    assert [eye.shape for eye in pair.eyes] == [(120, 160, 3)] * 2


def test_an_unplugged_device_is_silent_and_opened_again_by_its_persistent_name(
    script: type[Script],
) -> None:
    gone, absent = SourceError("gone", "gone"), SourceError("no_device", "absent")
    sleeps: list[float] = []
    acts = [grabbed(NS), gone, absent, absent, absent, grabbed(9 * NS), grabbed(9 * NS + 33 * MS)]
    found = run(acts, sleeps)
    codes = [m.code if isinstance(m, DeviceState) else m.stamp_ns for m in found]
    assert codes == ["open", NS, "gone", "no_device", "open", 9 * NS, 9 * NS + 33 * MS]
    assert script.opened == ["/dev/video0", *["persistent"] * 4]
    assert set(sleeps[:4]) == {REOPEN_S}


def test_without_a_signal_there_is_no_picture_and_the_reason_is_said_once(
    script: type[Script],
) -> None:
    black = np.full_like(PAIR, 16)
    acts = [grabbed(n * NS, black) for n in range(1, 4)]
    found = run([*acts, grabbed(4 * NS)])
    assert [type(m) for m in found] == [DeviceState, DeviceState, Pictures]
    assert [m.code for m in found[:2]] == ["black", "open"]
    assert "endoscope.source: script:/dev/video0" in found[0].text


@pytest.mark.parametrize(
    ("changes", "code", "words"),
    [
        ({"width": 1920, "height": 1080}, "wrong_size", "640 x 240, not 1920 x 1080"),
        ({"layout": "two"}, "wrong_format", "endoscope.layout: two"),
    ],
)
def test_pictures_that_do_not_fit_the_cell_are_named(
    changes: dict[str, Any], code: str, words: str, script: type[Script]
) -> None:
    (state,) = run([grabbed(NS)], **changes)
    assert state.code == code
    assert words in state.text


def test_an_odd_picture_is_named(script: type[Script]) -> None:
    (state,) = run([grabbed(NS, PAIR[:, :-1])])
    assert (state.code, "odd width" in state.text) == ("wrong_format", True)


@pytest.mark.parametrize(("flip", "passed"), [("none", True), ("horizontal", False)])
def test_a_grabbers_jpeg_is_passed_on_where_it_is_an_eye_as_it_is(
    flip: str, passed: bool, script: type[Script]
) -> None:
    act = Grabbed(NS, NS, (PAIR,), (b"jpeg",))
    pictures = run([act], layout="mono", eyes=1, flip=flip)[1]
    assert pictures.jpegs == ((b"jpeg",) if passed else ())


def test_messages_go_through_the_pipe_unchanged() -> None:
    random = np.random.default_rng(1)
    eyes = tuple(random.integers(0, 256, (5, 7, 3), np.uint8) for _ in range(2))
    pipe = io.BytesIO()
    frame_pipe.write(pipe, DeviceState("busy", "größer"))
    frame_pipe.write(pipe, Pictures(2**62, -1, eyes, (b"\n{", b"")))
    whole = pipe.getvalue()
    pipe.seek(0)
    assert frame_pipe.read(pipe) == DeviceState("busy", "größer")
    found = frame_pipe.read(pipe)
    assert isinstance(found, Pictures)
    assert (found.stamp_ns, found.received_ns, found.jpegs) == (2**62, -1, (b"\n{", b""))
    assert all(np.array_equal(a, b) for a, b in zip(found.eyes, eyes, strict=True))
    assert frame_pipe.read(pipe) is None
    cut = io.BytesIO(whole[:-100])
    frame_pipe.read(cut)
    assert frame_pipe.read(cut) is None, "the writer was killed"
    with pytest.raises(FramePipeError):
        frame_pipe.read(io.BytesIO(b"Traceback\n"))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (
            {"source": "v4l2:/dev/video0+/dev/video2", "layout": "sbs"},
            "two devices with layout two",
        ),
        ({"source": "v4l2:a+b+c", "layout": "two"}, "two devices"),
        ({"source": "usb:0", "layout": "mono"}, "~source"),
        ({"source": "v4l2:/dev/video0", "layout": "mono", "width": 640}, "width and height"),
        ({"source": "v4l2:/dev/video0", "layout": "mono", "latency": 2.0}, "~latency"),
    ],
)
def test_parameters_that_do_not_fit_are_refused(given: dict[str, Any], words: str) -> None:
    with pytest.raises(ParamError, match=words):
        read(CaptureSettings, given)


def test_two_devices_are_exchanged_by_swap() -> None:
    given = {"source": "v4l2:/dev/video0+/dev/video2", "layout": "two"}
    for swap, expected in ((False, ["v4l2:/dev/video0", "v4l2:/dev/video2"]),
                           (True, ["v4l2:/dev/video2", "v4l2:/dev/video0"])):  # fmt: skip
        devices = read(CaptureSettings, {**given, "swap": swap}).devices()
        assert [device.source for device in devices] == expected
        assert [device.eyes for device in devices] == [1, 1]
