"""Another program's pictures through v4l2loopback of a real kernel: `./surg test --tier vm`."""

from typing import Any

import numpy as np
import pytest

from helpers.machines import vm_loopback_module
from helpers.machines.vm_result import result_of
from helpers.perception.vm_loopback import BRIGHT, DARK, SIZE

pytestmark = pytest.mark.vm

MODULES = ("mc", "videodev", "v4l2loopback")


@pytest.fixture(scope="module")
def found() -> dict[str, Any]:
    """What the guest found."""
    if why := vm_loopback_module.missing():
        pytest.skip(why)
    return result_of("helpers.perception.vm_loopback", modules=MODULES)


def test_both_eyes_of_one_picture_come_through(found: dict[str, Any]) -> None:
    width, height = SIZE
    assert found["eyes"] == [[height, width // 2, 3]] * 2
    grey = np.array(found["grey"])
    assert len(grey) == 10
    np.testing.assert_allclose(grey, np.broadcast_to([DARK, BRIGHT], grey.shape), atol=8)


def test_its_stamps_are_the_drivers(found: dict[str, Any]) -> None:
    assert min(found["steps_ms"]) > 0
    ages = np.array(found["ages_ms"])
    assert (ages >= 0).all(), "a stamp in the future"
    assert np.median(ages) < 1000


def test_a_program_that_ends_is_silence_and_one_that_returns_is_read(
    found: dict[str, Any],
) -> None:
    assert "no picture for 5 s" in found["silent"]
    assert found["again"] == 3
