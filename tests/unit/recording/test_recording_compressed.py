"""Cameras that send JPEG or PNG: every picture in its place; what is cut or broken is counted."""

from __future__ import annotations

import io
import os
import signal
import zlib
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from PIL import Image

from helpers.recording import picture_identity
from helpers.recording import recording_synthetic as synthetic
from helpers.recording.camera_recording import start, until
from helpers.recording.picture_identity import HEIGHT, WIDTH, Identity
from surg_recording.episode import episode_reader
from surg_recording.video import compressed_image, video_file
from surg_recording.video.compressed_image import Coded

PERIOD_NS = 50_000_000
KINDS = ("jpeg", "png")


def coded(picture: np.ndarray, kind: str, **options: object) -> bytes:
    """An RGB or grey picture as a camera's driver sends it."""
    file = io.BytesIO()
    Image.fromarray(picture).save(file, kind, **options)
    return file.getvalue()


def message(
    data: bytes, stamp_ns: int, said: str = "rgb8; jpeg compressed bgr8"
) -> SimpleNamespace:
    return SimpleNamespace(header=synthetic.header(stamp_ns), format=said, data=data)


def shown(number: int, size: tuple[int, int] = (WIDTH, HEIGHT)) -> np.ndarray:
    return picture_identity.draw(Identity(1, 0, number), *size)


def numbers(recorded: episode_reader.Episode) -> list[int]:
    """Numbers of all frames of all parts; every picture must be the one of its stamp."""
    found: list[int] = []
    for video in recorded.parts("cam"):
        stamps = video.frames["stamp_ns"] // PERIOD_NS
        images = video_file.grab(video.path, list(range(len(stamps))))
        assert [picture_identity.read(image).frame for image in images] == stamps.tolist()
        found += stamps.tolist()
    return found


# --- the head -------------------------------------------------------------------------------------


def test_sizes_are_those_that_a_decoder_finds() -> None:
    rng = np.random.default_rng(1)
    cases = 0
    for width, height in ((2, 2), (640, 480), (161, 121), (1920, 3)):
        colour = rng.integers(0, 255, (height, width, 3), dtype=np.uint8)
        for picture in (colour, colour[..., 0]):
            files = [coded(picture, "png"), coded(picture, "png", optimize=True)]
            files += [coded(picture, "jpeg", quality=q, progressive=q > 50) for q in (20, 95)]
            files += [cv2.imencode(end, picture)[1].tobytes() for end in (".jpg", ".png")]
            exif = Image.Exif()
            exif[0x0112] = 6  # "turn me": recorded as the camera saw it
            files.append(coded(picture, "jpeg", exif=exif.tobytes()))
            for data in files:
                cases += 1
                assert compressed_image.read_header(data)[1:] == (width, height)
                padded = data + bytes(7)  # some drivers fill up to a whole number of words
                assert compressed_image.read_header(padded)[1:] == (width, height)
    print(f"{cases} files")


def test_a_picture_that_is_cut_is_refused_wherever_it_is_cut() -> None:
    """A decoder would fill the rest with grey and say nothing."""
    thumbnail = coded(shown(1)[::8, ::8], "jpeg")
    exif = b"Exif\0\0" + thumbnail  # a whole JPEG within the head of another
    for data in (
        coded(shown(1), "png"),
        coded(shown(1), "jpeg"),
        coded(shown(1), "jpeg", progressive=True, exif=exif),
    ):
        compressed_image.read_header(data)
        for size in range(len(data)):
            with pytest.raises(ValueError, match=r"cut or broken|neither JPEG nor PNG"):
                compressed_image.read_header(data[:size], "x")


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "neither JPEG nor PNG .*'x'"),
        (b"GIF89a" + bytes(100), "neither JPEG nor PNG"),
        (coded(np.zeros((4, 4), np.uint16), "png"), "16 bits per colour; 8 are recorded"),
        (coded(np.zeros((9000, 9000), np.uint8), "png"), "9000x9000 pixels; at most"),
        (b"\xff\xd8\xff\xda" + bytes(50) + b"\xff\xd9", "cut or broken"),  # a scan without a size
        (bytes(12) + b"compressedDepth", "neither JPEG nor PNG"),
    ],
)
def test_what_cannot_be_recorded_is_said(data: bytes, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        compressed_image.read_header(data, "x")


def test_noise_never_raises_anything_else() -> None:
    rng = np.random.default_rng(2)
    whole = coded(shown(1), "jpeg")
    for _ in range(3000):
        data = bytearray(whole[: int(rng.integers(4, 700))] + rng.bytes(20) + b"\xff\xd9")
        for place in rng.integers(2, len(data), 4):
            data[place] = int(rng.integers(256))
        try:
            found = compressed_image.read_header(bytes(data))
        except ValueError:
            continue
        assert isinstance(found, Coded)


# --- the recording --------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "mode"), [("jpeg", "freerun"), ("png", "lockstep")])
def test_every_picture_is_recorded_at_its_stamp(tmp_path: Path, kind: str, mode: str) -> None:
    recording = start(tmp_path / "e", mode)
    for k in range(1, 31):
        recording.image("cam", message(coded(shown(k), kind), k * PERIOD_NS), k)
    recorded = episode_reader.read(recording.close({}))
    assert recorded.complete, recorded.manifest["reason"]
    assert numbers(recorded) == list(range(1, 31))
    stream = recorded.manifest["camera_streams"]["cam"]
    assert (stream["encoding"], stream["size"]) == (kind, f"{WIDTH}x{HEIGHT}")


def test_colours_are_not_swapped(tmp_path: Path) -> None:
    recording = start(tmp_path / "e")
    red = np.zeros((48, 64, 3), np.uint8)
    red[..., 0] = 200
    recording.image("cam", message(coded(red, "jpeg"), PERIOD_NS), 1)
    recorded = episode_reader.read(recording.close({}))
    (picture,) = video_file.grab(recorded.video("cam").path, [0])
    r, g, b = picture.reshape(-1, 3).mean(axis=0)
    assert r > 180 and g < 25 and b < 25


def broken_inside(kind: str) -> bytes:
    """A picture that is whole by its head and its end, and that no decoder can read."""
    data = bytearray(coded(shown(1), kind))
    if kind == "png":  # a broken stream of zlib in a chunk of which the checksum is right
        at = data.index(b"IDAT")
        (size,) = np.frombuffer(data[at - 4 : at], ">u4")
        data[at + 4 : at + 4 + size] = bytes(size)
        crc = zlib.crc32(data[at : at + 4 + size]).to_bytes(4, "big")
        data[at + 4 + size : at + 8 + size] = crc
    else:  # it counts more codes than there can be
        at = data.index(b"\xff\xc4")
        data[at + 5 : at + 21] = b"\xff" * 16
    return bytes(data)


@pytest.mark.parametrize("kind", KINDS)
def test_what_cannot_be_decoded_is_counted_and_said_and_the_rest_goes_on(
    tmp_path: Path, kind: str
) -> None:
    recording = start(tmp_path / "e")
    for k in range(1, 21):
        data = coded(shown(k), kind)
        if k in (5, 6):
            data = data[: len(data) // 2]
        if k in (12, 13, 14):
            data = broken_inside(kind)
        recording.image("cam", message(data, k * PERIOD_NS), k)
    until(lambda: recording.status()["backlog"]["frames"] == 0)
    assert recording.status()["drops"]["cam"] == 5
    recorded = episode_reader.read(recording.close({}))
    assert numbers(recorded) == [k for k in range(1, 21) if k not in (5, 6, 12, 13, 14)]
    dropped = recorded.video("cam").frames["dropped"]
    assert {int(row): int(dropped[row]) for row in np.flatnonzero(dropped)} == {4: 2, 9: 3}
    assert not recorded.complete
    said = "cam: 5 dropped (the last that could not be recorded: a compressed picture of "
    assert recorded.manifest["reason"].startswith(f"{said}{WIDTH}x{HEIGHT} pixels: ")
    assert recorded.manifest["videos"]["cam"]["dropped"] == 5


def test_a_camera_that_only_sends_what_is_no_picture_is_said(tmp_path: Path) -> None:
    recording = start(tmp_path / "e")
    for k in range(1, 6):
        recording.image("cam", message(b"\0" * 99, k * PERIOD_NS, "16UC1; compressedDepth"), k)
    recorded = episode_reader.read(recording.close({}))
    assert recorded.cameras == []
    assert "cam: 5 dropped" in recorded.manifest["reason"]
    assert "neither JPEG nor PNG" in recorded.manifest["reason"]
    assert "16UC1; compressedDepth" in recorded.manifest["reason"]


@pytest.mark.parametrize("kind", ["jpeg", "raw"])
def test_f13_an_encoder_that_dies_before_its_first_picture_costs_nothing(
    tmp_path: Path, kind: str
) -> None:
    """The camera's first video is there, whichever encoder has made it."""
    recording = start(tmp_path / "e")
    os.kill(recording.cameras.sinks["cam"].part.pid, signal.SIGSTOP)
    for k in range(1, 11):
        picture = shown(k)
        image = synthetic.image(k * PERIOD_NS, k)
        image.data = picture.tobytes()
        sent = image if kind == "raw" else message(coded(picture, kind), k * PERIOD_NS)
        recording.image("cam", sent, k)
    os.kill(recording.cameras.sinks["cam"].part.pid, signal.SIGKILL)
    until(lambda: recording.cameras.sinks["cam"].part.error is not None)
    recorded = episode_reader.read(recording.close({}))
    assert recorded.cameras == ["cam"]
    assert numbers(recorded) == list(range(1, 11))
    assert recorded.manifest["videos"]["cam"]["dropped"] == 0
    assert "goes on in cam" in recorded.manifest["reason"]
