"""One grabbed picture becomes the pictures of the eyes, whatever the grabber's layout."""

import numpy as np
import pytest

from surg_perception.capture import eye_layout
from surg_perception.capture.eye_layout import LayoutError, fitted, fitted_size, split

LEFT = np.arange(8 * 12 * 3, dtype=np.uint8).reshape(8, 12, 3)
RIGHT = 255 - LEFT

JOINED = {
    "sbs": np.hstack([LEFT, RIGHT]),
    "top_bottom": np.vstack([LEFT, RIGHT]),
}


@pytest.mark.parametrize("layout", JOINED)
@pytest.mark.parametrize("swap", [False, True])
def test_a_full_layout_gives_both_eyes_back_exactly(layout: str, swap: bool) -> None:
    left, right = split(JOINED[layout], layout, swap)
    assert np.array_equal(left, RIGHT if swap else LEFT)
    assert np.array_equal(right, LEFT if swap else RIGHT)


@pytest.mark.parametrize("layout", ["sbs_half", "rows"])
def test_a_half_layout_gives_eyes_of_the_pictures_size_and_brightness(layout: str) -> None:
    picture = np.empty((480, 640, 3), np.uint8)
    if layout == "rows":
        picture[0::2], picture[1::2] = 40, 200
    else:
        picture[:, :320], picture[:, 320:] = 40, 200
    left, right = split(picture, layout)
    assert left.shape == right.shape == (480, 640, 3)
    assert (left == 40).all()
    assert (right == 200).all()


@pytest.mark.parametrize("layout", ["two", "mono"])
def test_a_picture_of_one_eye_stays_as_it_is(layout: str) -> None:
    (only,) = split(LEFT, layout)
    assert np.array_equal(only, LEFT)


@pytest.mark.parametrize(
    ("flip", "expected"),
    [
        ("horizontal", LEFT[:, ::-1]),
        ("vertical", LEFT[::-1]),
        ("rotate_180", LEFT[::-1, ::-1]),
    ],
)
def test_each_eye_is_flipped_by_itself(flip: str, expected: eye_layout.Image) -> None:
    left, _ = split(JOINED["sbs"], "sbs", flip=flip)
    assert np.array_equal(left, expected)


@pytest.mark.parametrize(
    ("layout", "shape", "edge"),
    [("sbs", (8, 13), "width"), ("sbs_half", (8, 13), "width"), ("top_bottom", (9, 12), "height"),
     ("rows", (9, 12), "height")],
)  # fmt: skip
def test_an_odd_picture_cannot_be_divided(layout: str, shape: tuple[int, int], edge: str) -> None:
    with pytest.raises(LayoutError, match=rf"odd {edge}.*{layout}"):
        split(np.zeros((*shape, 3), np.uint8), layout)


@pytest.mark.parametrize(
    ("size", "most", "expected"),
    [((640, 480), (960, 540), (640, 480)), ((1920, 1080), (960, 540), (960, 540)),
     ((1280, 1024), (960, 540), (676, 540)), ((1920, 1080), (1920, 1080), (1920, 1080))],
)  # fmt: skip
def test_an_eye_fits_the_published_size_with_its_aspect_kept(
    size: tuple[int, int], most: tuple[int, int], expected: tuple[int, int]
) -> None:
    assert fitted_size(size, most) == expected
    picture = fitted(np.full((size[1], size[0], 3), 77, np.uint8), most)
    assert picture.shape == (expected[1], expected[0], 3)
    assert (picture == 77).all()
