"""Real virtual devices of a real kernel: `./surg test --tier vm` (about a minute).

A gamepad and foot pedals made by uinput drive the core controller and an arm with lag; unplugging
them stops it. Elsewhere the same code reads pipes (tests/unit/teleop/test_teleop_inputs.py).
"""

from typing import Any

import pytest

from helpers.machines.vm_result import result_of
from surg_cli.host import paths

pytestmark = pytest.mark.vm

TICK_MS = 2.0


@pytest.fixture(scope="module")
def found() -> dict[str, Any]:
    """What the guest found."""
    return result_of("helpers.machines.vm_devices", str(paths.CELLS / "sim_ur5e"))


def test_what_cannot_be_opened_says_why(found: dict[str, Any]) -> None:
    assert "connect one that fits" in found["nothing"]
    assert "no permission to read /dev/input/event" in found["no_permission"]
    assert "usermod -aG input" in found["no_permission"]


def test_a_real_gamepad_moves_the_arm_the_way_it_is_pushed(found: dict[str, Any]) -> None:
    assert found["engaged"] == "FOLLOWING"
    for name, axis, sign in (("right", 0, 1), ("away", 2, 1), ("nearer", 2, -1)):
        moved = found[name]
        assert sign * moved[axis] > 10, (name, moved)  # 0.34 s at 40 mm/s, less the lag
        assert all(abs(v) < 2.5 for i, v in enumerate(moved) if i != axis), (name, moved)


def test_a_buffer_that_ran_over_stops_until_the_dead_man_is_pressed_anew(
    found: dict[str, Any],
) -> None:
    # 13 mm if it went on; what there is is the stop's overshoot, which the arm makes up for.
    assert all(abs(v) < 2.0 for v in found["after_overrun"])


@pytest.mark.parametrize("event", ["unplugged", "clutch", "pedals_unplugged"])
def test_it_stops(event: str, found: dict[str, Any]) -> None:
    stop = found[event]
    print(
        f"{event}: halted after {stop['ticks_to_halt'] * TICK_MS:.0f} ms of the arm's time "
        f"({stop['guest_ms_to_halt']} ms of the guest's), at rest after "
        f"{stop['ticks_to_standstill'] * TICK_MS:.0f} ms and {stop['travel_mm']} mm"
    )
    assert stop["ticks_to_halt"] <= 2
    assert stop["ticks_to_standstill"] * TICK_MS <= 300
    assert stop["travel_mm"] < 5.0
    assert stop["drift_mm"] < 0.01


def test_plugging_in_moves_nothing(found: dict[str, Any]) -> None:
    assert "'Virtual Pad'" in found["lost"]
    assert "has gone (No such device)" in found["lost"]
    assert found["back"] == {
        "problem": "",
        "state": "WAITING",
        "moved_mm": pytest.approx(0, abs=0.01),
    }


def test_pedals_are_grabbed_and_fail_to_pressed(found: dict[str, Any]) -> None:
    assert found["engaged_with_pedals"] == "FOLLOWING"
    assert found["clutched"] == "CLUTCHED"
    assert found["released"] == "FOLLOWING"
    assert not found["typed_elsewhere"]
    assert "'Virtual FootSwitch'" in found["pedals_lost"]
