"""A UR's modes as one condition, and the numbers of the message."""

import itertools

import pytest

from surg_core import RobotCondition
from surg_hardware.conditions import Condition, ur_reading
from surg_msgs.msg import LinkStatus

RUNNING, NORMAL = 7, 1


def test_the_conditions_are_those_of_the_message_and_of_the_controller() -> None:
    for condition in Condition:
        assert getattr(LinkStatus, condition.name) == condition
        assert int(RobotCondition.__members__[condition.name]) == condition
    assert len(Condition) == 10


@pytest.mark.parametrize(
    ("mode", "safety", "scaling", "guided", "condition"),
    [
        (RUNNING, NORMAL, 1.0, False, Condition.READY),
        (RUNNING, 2, 1.0, False, Condition.READY),
        (3, NORMAL, 1.0, False, Condition.OFF),
        (4, NORMAL, 1.0, False, Condition.OFF),
        (5, NORMAL, 1.0, False, Condition.BRAKED),
        (6, NORMAL, 1.0, False, Condition.GUIDED),
        (RUNNING, NORMAL, 1.0, True, Condition.GUIDED),
        (RUNNING, NORMAL, 0.5, False, Condition.SLOWED),
        (RUNNING, NORMAL, float("nan"), False, Condition.SLOWED),
        (RUNNING, 3, 1.0, False, Condition.STOPPED),
        (RUNNING, 5, 1.0, False, Condition.STOPPED),
        (3, 6, 1.0, False, Condition.ESTOP),
        (3, 7, 1.0, True, Condition.ESTOP),
        (RUNNING, 8, 1.0, False, Condition.BROKEN),
        (RUNNING, 9, 1.0, False, Condition.BROKEN),
        (99, NORMAL, 1.0, False, Condition.BROKEN),
        (RUNNING, 77, 1.0, False, Condition.BROKEN),
    ],
)
def test_modes_mean_one_condition(
    mode: int, safety: int, scaling: float, guided: bool, condition: Condition
) -> None:
    assert ur_reading(mode, safety, scaling, guided).condition is condition
    assert ur_reading(mode, safety, 1.0, guided, slider=scaling).condition is condition


def test_slider_limiter_and_a_paused_program_are_told_apart() -> None:
    said = [
        ur_reading(RUNNING, NORMAL, slider=0.5),
        ur_reading(RUNNING, NORMAL, limiter=0.4),
        ur_reading(RUNNING, NORMAL, paused=True),
    ]
    words = ("speed slider is at 50 %", "limits its speed to 40 %", "program is paused")
    for reading, word in zip(said, words, strict=True):
        assert word in reading.sentence and reading.cure
    assert ur_reading(RUNNING, NORMAL, 0.5, slider=0.5).speed_scaling == 0.25


def test_only_a_running_arm_in_normal_or_reduced_mode_may_move() -> None:
    """All modes, known or not: whatever is not known may not move, and every reading says why."""
    for mode, safety in itertools.product(range(-3, 12), range(-1, 16)):
        reading = ur_reading(mode, safety)
        may = mode == RUNNING and safety in (1, 2)
        assert (reading.condition is Condition.READY) == may
        assert may or (reading.sentence and reading.cure)
        assert reading.condition not in (Condition.ACTIVE, Condition.OFFLINE)
