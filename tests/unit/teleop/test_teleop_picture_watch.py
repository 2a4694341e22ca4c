"""Stalled and frozen camera images are reported."""

from surg_teleop.follow.picture_watch import PictureWatch


def test_f08_a_picture_that_stalls_or_freezes_is_said_within_three_periods() -> None:
    watch = PictureWatch("endoscope_left")
    assert watch.problem(0.0) == ""
    now = 0.0
    for k in range(100):
        now = 0.05 * k
        watch.picture(now, 1 + k, k)
        assert watch.problem(now + 0.049) == ""
    assert watch.problem(now + 0.149) == ""
    assert "endoscope_left sends no pictures" in watch.problem(now + 0.151)
    for k in range(100, 104):  # the same pixels with new stamps
        now = 0.05 * k
        watch.picture(now, 1 + k, 99)
    assert "endoscope_left repeats the same picture" in watch.problem(now)
    watch.picture(now + 0.05, 105, 105)
    assert watch.problem(now + 0.05) == ""
    for k in range(4):  # new pixels with an old stamp
        watch.picture(now + 0.1 + 0.05 * k, 105, 200 + k)
    assert watch.problem(now + 0.3) != ""
