"""A V4L2 device of a real kernel before the capture process: `./surg test --tier vm`.

The kernel's test driver vivid delivers pictures, is busy, is unplugged and comes back.
"""

from typing import Any

import numpy as np
import pytest

from helpers.machines.vm_result import result_of

pytestmark = pytest.mark.vm

MODULES = (
    "mc", "videodev", "videobuf2-common", "videobuf2-memops", "videobuf2-v4l2",
    "videobuf2-vmalloc", "videobuf2-dma-contig", "v4l2-dv-timings", "v4l2-tpg", "rc-core", "cec",
    "vivid",
)  # fmt: skip


@pytest.fixture(scope="module")
def found() -> dict[str, Any]:
    """What the guest found."""
    return result_of("helpers.perception.vm_capture", modules=MODULES)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("no_device", "/dev/video77"),
        ("no_permission", "usermod -aG video"),
        ("wrong_format", "--list-formats-ext"),
        ("wrong_rate", "endoscope.rate: 7/s"),
        ("busy", "close the other program"),
    ],
)
def test_what_cannot_be_opened_says_why(code: str, words: str, found: dict[str, Any]) -> None:
    assert found[code]["code"] == code.replace("rate", "format")
    assert words in found[code]["text"]


def test_pictures_have_the_size_asked_for_and_the_drivers_stamps(found: dict[str, Any]) -> None:
    assert found["shape"] == [180, 320, 3]
    assert min(found["steps_ms"]) > 0
    ages = np.array(found["ages_ms"])
    assert (ages >= 0).all(), "a stamp in the future"
    assert (ages < 150).all(), "less than a period: the driver's, and not one picture late"


@pytest.mark.parametrize("code", ["bars", "black", "blue", "frozen"])
def test_what_is_no_live_picture_is_silence(code: str, found: dict[str, Any]) -> None:
    assert found[code]


def test_an_unplugged_device_is_named_and_read_again_when_it_is_back(found: dict[str, Any]) -> None:
    assert "by-id/usb-vivid-video-index0" in found["unplugged"]
    assert found["live_again"] == found["replugged"] == 3
