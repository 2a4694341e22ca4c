from pathlib import Path

import numpy as np
from PIL import Image

from surg_sim.appearance import episode_animation


def test_frames_come_back_in_order_and_the_last_one_stays_longest(tmp_path: Path) -> None:
    greys = (20, 120, 220)
    frames = [np.full((32, 48, 3), grey, np.uint8) for grey in greys]
    file = tmp_path / "animation.webp"
    episode_animation.write(frames, file)
    with Image.open(file) as picture:
        assert (picture.n_frames, picture.size, picture.info["loop"]) == (3, (48, 32), 0)
        durations = []
        for i, grey in enumerate(greys):
            picture.seek(i)
            assert abs(int(np.asarray(picture.convert("RGB")).mean()) - grey) <= 2
            durations.append(picture.info["duration"])
    assert durations == [
        episode_animation.FRAME_MS,
        episode_animation.FRAME_MS,
        episode_animation.LAST_FRAME_MS,
    ]
