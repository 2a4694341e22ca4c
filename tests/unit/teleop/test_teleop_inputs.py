"""Gamepad, pedals and SpaceMouse by the kernel's events: groups, meaning, unplugging."""

import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from evdev.ecodes import EV_KEY

from helpers.teleop.input_devices import (
    DROPPED,
    GAMEPAD,
    KEYBOARD,
    PEDALS,
    REPORT,
    SPACEMOUSE,
    SPACEMOUSE_RELATIVE,
    Machine,
    Plugged,
    code,
    event,
)
from surg_core.hand.leader_sample import LeaderSample
from surg_teleop.leaders.bundled.gamepad import Gamepad
from surg_teleop.leaders.bundled.pedals import Pedals
from surg_teleop.leaders.bundled.spacemouse import SpaceMouse
from surg_teleop.leaders.evdev.device_hand import MAX_STEP, WIRELESS_QUIET
from surg_teleop.leaders.evdev.device_layout import FOLDER, bundled, read_layout
from surg_teleop.leaders.evdev.device_leader import LOOK_FOR
from surg_teleop.leaders.evdev.device_search import SHOWN
from surg_teleop.leaders.evdev.device_state import (
    BUS_BLUETOOTH,
    RELATIVE_HOLD,
    AxisRange,
    without_dead_zone,
)
from surg_teleop.leaders.evdev.input_events import Groups
from surg_teleop.leaders.leader import Leader, LeaderError, load

STEP = 0.002


# -- events to groups


def test_groups_do_not_depend_on_how_the_events_are_cut(rng: random.Random) -> None:
    cases = 300
    for _ in range(cases):
        events = [
            rng.choice((REPORT, DROPPED, event(EV_KEY, rng.randrange(700), rng.randrange(3))))
            for _ in range(rng.randrange(1, 40))
        ]
        whole, pieces, parts = Groups().feed(events), Groups(), []
        while events:
            n = rng.randrange(1, 5)
            parts += pieces.feed(events[:n])
            events = events[n:]
        assert parts == whole
    print(f"{cases} streams, cut anywhere")


def test_what_was_lost_is_said_and_nothing_of_it_is_used() -> None:
    key = event(EV_KEY, 30, 1)
    assert Groups().feed([key, DROPPED, key, REPORT, key, REPORT]) == [None, [key]]


# -- readings to numbers


def test_an_axis_is_normal_whatever_its_range(rng: random.Random) -> None:
    for _ in range(1000):
        low = rng.randrange(-40000, 40000)
        span = AxisRange(low, low + rng.randrange(1, 70000))
        assert span.normal(span.minimum) == -1.0
        assert span.normal(span.maximum) == 1.0
        assert -1.0 <= span.normal(rng.randrange(-(2**31), 2**31)) <= 1.0
    assert AxisRange(0, 0).normal(5) == 0.0
    assert AxisRange(5, -5).normal(5) == 0.0  # a device that lies about its range moves nothing


def test_the_dead_zone_is_odd_without_a_step_and_reaches_one(rng: random.Random) -> None:
    for _ in range(1000):
        zone, x = rng.uniform(0.0, 0.5), rng.uniform(-1.0, 1.0)
        y = without_dead_zone(x, zone)
        assert y == -without_dead_zone(-x, zone)
        assert abs(y) <= abs(x) + 1e-12
        assert (y == 0.0) == (abs(x) <= zone)
        assert abs(without_dead_zone(x + 1e-6, zone) - y) <= 1e-6 / (1.0 - zone) + 1e-12
        assert without_dead_zone(1.0, zone) == 1.0


# -- what each device means


def opened(make: Callable[..., Leader], machine: Machine, **settings: object) -> Leader:
    leader = make(host=machine, **settings)
    leader.open()
    return leader


@pytest.fixture
def machine() -> Machine:
    """A machine with nothing plugged in."""
    return Machine()


def rate(sample: LeaderSample | None) -> list[float]:
    assert sample is not None
    assert sample.rate is not None
    return [*sample.rate.v_V.tolist(), sample.rate.roll]


RIGHT, DOWN, AWAY, CLOCKWISE = 0, 1, 2, 3
# What is pushed, which way (the kernel counts sticks to the right and down), and what must be seen.
GAMEPAD_SIGNS = [
    ("ABS_X", 1, RIGHT, 1),
    ("ABS_X", -1, RIGHT, -1),
    ("ABS_Y", -1, DOWN, -1),
    ("ABS_Y", 1, DOWN, 1),
    ("ABS_RY", -1, AWAY, 1),
    ("ABS_RY", 1, AWAY, -1),
    ("ABS_RX", 1, CLOCKWISE, 1),
    ("ABS_RX", -1, CLOCKWISE, -1),
]


@pytest.mark.parametrize(("axis", "push", "goes", "sign"), GAMEPAD_SIGNS)
def test_a_stick_moves_the_picture_the_way_it_is_pushed(
    axis: str, push: int, goes: int, sign: int, machine: Machine
) -> None:
    pad = machine.plug(GAMEPAD)
    leader = opened(Gamepad, machine)
    assert rate(leader.read(0.0)) == [0.0] * 4
    pad.press("BTN_TR")
    pad.push(axis, push)
    moved = rate(leader.read(0.01))
    full = [0.04, 0.04, 0.04, 1.5]
    assert moved[goes] == pytest.approx(sign * full[goes], rel=1e-3)
    assert [v for i, v in enumerate(moved) if i != goes] == [0.0] * 3


# As the device counts (x right, y towards the hand, z down), and what must be seen.
CAP_SIGNS = [("X", 1, RIGHT, 1), ("Y", 1, AWAY, -1), ("Z", 1, DOWN, 1), ("RZ", 1, CLOCKWISE, 1)]


@pytest.mark.parametrize(("axis", "push", "goes", "sign"), CAP_SIGNS)
def test_the_cap_of_a_spacemouse_does_too(
    axis: str, push: int, goes: int, sign: int, machine: Machine
) -> None:
    for description, layout in (
        (SPACEMOUSE, "spacemouse"),
        (SPACEMOUSE_RELATIVE, "spacemouse_relative"),
    ):
        cap = machine.plug(description)
        leader = opened(SpaceMouse, machine, layout=layout)
        leader.read(0.0)
        cap.press("BTN_0")
        if layout == "spacemouse":
            cap.push(f"ABS_{axis}", push)
        else:
            cap.shove(f"REL_{axis}", 350 * push)
        moved = rate(leader.read(0.01))
        assert np.sign(moved[goes]) == sign
        assert [v for i, v in enumerate(moved) if i != goes] == [0.0] * 3
        leader.close()
        machine.unplug(cap)


def test_a_cap_that_is_let_go_without_a_word_is_at_rest(machine: Machine) -> None:
    cap = machine.plug(SPACEMOUSE_RELATIVE)
    leader = opened(SpaceMouse, machine, layout="spacemouse_relative")
    leader.read(0.0)
    cap.press("BTN_0")
    cap.shove("REL_X", 350)
    assert rate(leader.read(1.0))[RIGHT] > 0
    assert rate(leader.read(1.0 + RELATIVE_HOLD - 0.001))[RIGHT] > 0
    assert rate(leader.read(1.0 + RELATIVE_HOLD + 0.001))[RIGHT] == 0


def test_the_spherical_layout_turns_the_shaft(machine: Machine) -> None:
    pad = machine.plug(GAMEPAD)
    leader = opened(Gamepad, machine, layout="gamepad_spherical")
    leader.read(0.0)
    pad.press("BTN_TR")
    pad.push("ABS_X", 1.0)
    pad.push("ABS_RY", -1.0)
    sample = leader.read(0.01)
    assert sample is not None
    assert sample.rate is not None
    assert sample.rate.spherical == pytest.approx([0.3, 0.0, 0.04], rel=1e-3)
    assert not sample.rate.v_V.any()


def test_joy_has_the_order_of_the_layout_and_ros_signs(machine: Machine) -> None:
    pad = machine.plug(GAMEPAD)
    leader = Gamepad(host=machine)
    leader.open()
    leader.read(0.0)
    pad.push("ABS_X", -1.0)  # left
    pad.push("ABS_Y", -1.0)  # up
    pad.push("ABS_RZ", 1.0)
    pad.press("BTN_EAST")
    leader.read(0.01)
    joy = leader.joy(0.01)
    assert joy is not None
    assert joy.axes == pytest.approx((1, 1, 0, 0, 0, 1), abs=1e-3)
    assert joy.buttons == (0, 1, 0, 0, 0, 0, 0, 0)


def test_triggers_move_the_jaw_and_it_never_moves_by_itself(machine: Machine) -> None:
    pad = machine.plug(GAMEPAD)
    leader = opened(Gamepad, machine)
    now = 0.0

    def run(seconds: float) -> float | None:
        nonlocal now
        for _ in range(round(seconds / STEP)):
            now += STEP
            sample = leader.read(now)
        assert sample is not None
        return sample.grip

    assert run(1.0) is None  # nobody has touched it: nobody knows
    pad.push("ABS_Z", 1.0)
    assert run(0.5) is None  # without the dead-man a trigger does nothing
    pad.press("BTN_TR")
    assert run(0.5) == pytest.approx(0.5, abs=0.01)
    assert run(2.0) == 1.0
    pad.push("ABS_Z", 0.0)
    assert run(1.0) == 1.0
    pad.push("ABS_RZ", 1.0)
    assert run(0.25) == pytest.approx(0.75, abs=0.01)
    now += 5.0  # a process that slept does not make up for it
    sample = leader.read(now)
    assert sample is not None
    assert sample.grip == pytest.approx(0.75 - MAX_STEP, abs=0.01)


# -- dead-man, unplugging, coming back


def test_nothing_moves_without_the_dead_man(machine: Machine) -> None:
    pad = machine.plug(GAMEPAD)
    leader = opened(Gamepad, machine)
    leader.read(0.0)
    pad.push("ABS_X", 1.0)
    sample = leader.read(0.01)
    assert rate(sample) == [0.0] * 4
    pad.press("BTN_TR")
    sample = leader.read(0.02)
    assert rate(sample)[RIGHT] > 0
    assert sample is not None
    assert sample.buttons == {"present"}
    pad.release("BTN_TR")
    sample = leader.read(0.03)
    assert rate(sample) == [0.0] * 4
    assert sample is not None
    assert sample.buttons == frozenset()


def test_what_is_held_when_it_is_plugged_in_does_not_count(machine: Machine) -> None:
    pad = machine.plug(GAMEPAD)
    pad.press("BTN_TR", "BTN_START", "BTN_TL")
    pad.push("ABS_X", 1.0)
    leader = opened(Gamepad, machine)
    for now in (0.0, 0.1, 5.0):
        sample = leader.read(now)
        assert rate(sample) == [0.0] * 4
        assert sample is not None
        assert sample.buttons == frozenset()
    pad.release("BTN_TR")
    pad.press("BTN_TR")
    assert rate(leader.read(5.1))[RIGHT] > 0


def test_unplugged_is_said_once_then_silent_and_coming_back_moves_nothing(
    machine: Machine,
) -> None:
    pad = machine.plug(GAMEPAD)
    leader = opened(Gamepad, machine)
    leader.read(0.0)
    pad.press("BTN_TR")
    pad.push("ABS_X", 1.0)
    assert rate(leader.read(0.01))[RIGHT] > 0
    machine.unplug(pad)
    with pytest.raises(LeaderError) as caught:
        leader.read(0.02)
    assert "gamepad: 'Some Pad' (/dev/input/event7): has gone (No such device)" in str(caught.value)
    assert "plug it in again" in caught.value.cure
    for now in np.arange(0.03, 20.0, 0.1):
        assert leader.read(float(now)) is None

    for _ in range(2):  # who opens it again and again reads what is missed, not what else there is
        with pytest.raises(LeaderError, match="has gone"):
            leader.open()
    other = machine.plug(KEYBOARD)
    with pytest.raises(LeaderError, match="no device fits"):
        leader.open()
    machine.unplug(other)

    back = machine.plug(replace(GAMEPAD, path="/dev/input/event11"))  # another port
    back.press("BTN_TR")
    back.push("ABS_X", 1.0)
    seen = [leader.read(20.0 + 0.01 * i) for i in range(100)]
    there = [sample for sample in seen if sample is not None]
    assert there, "it was not taken up again"
    assert all(rate(sample) == [0.0] * 4 and not sample.buttons for sample in there)
    back.release("BTN_TR")
    leader.read(21.1)
    back.press("BTN_TR")
    assert rate(leader.read(21.2))[RIGHT] > 0


def test_a_permission_that_comes_after_the_node_is_waited_for(machine: Machine) -> None:
    leader = Gamepad(host=machine)
    with pytest.raises(LeaderError):
        leader.open()
    machine.plug(GAMEPAD)
    machine.forbidden.add(GAMEPAD.path)
    assert leader.read(1.0) is None
    assert "input" in leader.lost
    machine.forbidden.clear()
    assert leader.read(1.6) is not None
    machine.unplug(machine.plugged[0])
    with pytest.raises(LeaderError):
        leader.read(1.7)
    # A device that does not fit is not opened again and again.
    machine.plug(KEYBOARD)
    for i in range(100):
        assert leader.read(2.0 + 0.1 * i) is None
    opens = 0
    original = machine.open

    def counted(path: str) -> object:
        nonlocal opens
        opens += 1
        return original(path)

    machine.open = counted  # type: ignore[method-assign,assignment]
    leader.read(12.0 + LOOK_FOR)
    assert opens == 0


def test_lost_events_are_asked_for_and_the_dead_man_starts_anew(machine: Machine) -> None:
    pad = machine.plug(GAMEPAD)
    leader = opened(Gamepad, machine)
    leader.read(0.0)
    pad.press("BTN_TR")
    pad.push("ABS_X", 1.0)
    assert rate(leader.read(0.01))[RIGHT] > 0
    pad.down.discard(code("BTN_TR"))  # let go while the buffer ran over
    pad.readings[code("ABS_X")] = 0
    pad.lose(event(EV_KEY, code("BTN_TR"), 1))
    assert rate(leader.read(0.02)) == [0.0] * 4
    pad.press("BTN_TR")
    pad.push("ABS_X", 1.0)
    assert rate(leader.read(0.03))[RIGHT] > 0
    pad.lose()  # held throughout: nobody can know
    assert rate(leader.read(0.04)) == [0.0] * 4


def test_a_radio_pad_that_has_gone_quiet_while_pushed_is_not_believed(machine: Machine) -> None:
    pad = machine.plug(replace(GAMEPAD, bus=BUS_BLUETOOTH))
    leader = opened(Gamepad, machine)
    leader.read(0.0)
    pad.press("BTN_TR")
    pad.push("ABS_X", 1.0)
    assert rate(leader.read(1.0))[RIGHT] > 0
    assert leader.read(1.0 + WIRELESS_QUIET - 0.01) is not None
    assert leader.read(1.0 + WIRELESS_QUIET + 0.01) is None
    pad.push("ABS_X", 0.9)  # back in range: the dead-man must be released first
    assert rate(leader.read(4.0)) == [0.0] * 4
    pad.push("ABS_X", 0.0)
    assert rate(leader.read(100.0)) == [0.0] * 4  # at rest it may be quiet for ever


ACTS = ("press", "release", "push", "nothing", "lose", "plug")


def test_random_storms_move_only_under_a_fresh_dead_man(rng: random.Random, full: bool) -> None:
    """An independent account of dead-man and jaw, through unplugging and losses of events."""
    cases, moved, lost = 5000 if full else 60, 0, 0
    keys = ["BTN_TR", "BTN_TL", "BTN_START"]
    for _ in range(cases):
        machine = Machine()
        pad: Plugged | None = machine.plug(GAMEPAD)
        leader = opened(Gamepad, machine)
        leader.read(0.0)
        armed, held, there, grip, now = True, False, True, None, 0.0
        for _ in range(120):
            step = rng.choice((0.001, 0.01, 0.1, 0.6))
            now += step
            (act,) = rng.choices(ACTS, (6, 2, 8, 4, 1, 1))
            if act == "plug" and pad is not None:
                machine.unplug(pad)
                pad = None
            elif act == "plug":
                pad = machine.plug(GAMEPAD)
                if held := rng.random() < 0.5:
                    pad.press("BTN_TR")
                pad.push("ABS_X", rng.choice((-1.0, 0.0, 1.0)))
                armed = not held
            elif pad is None:
                pass
            elif act in ("press", "release"):
                key = rng.choice(keys)
                getattr(pad, act)(key)
                if key == "BTN_TR":
                    held = act == "press"
                    armed = armed or not held
            elif act == "push":
                pad.push(rng.choice(("ABS_X", "ABS_RY", "ABS_Z")), rng.uniform(0.0, 1.0))
            elif act == "lose":
                pad.lose()
                armed = not held
            try:
                sample = leader.read(now)
            except LeaderError:
                sample, lost = None, lost + 1
                assert pad is None or not there
            if pad is None:
                assert sample is None
            if sample is not None and not there:
                armed = not held  # what happened before it was taken up again, nobody knows
            there = sample is not None
            if sample is None:
                continue
            may = held and armed
            speeds = rate(sample)
            assert ("present" in sample.buttons) == may
            assert may or speeds == [0.0] * 4
            assert np.abs(speeds[:3]).max() <= 0.04 + 1e-12
            moved += any(speeds)
            if not may:
                assert sample.grip == grip, "the jaw moved without a hand"
            elif sample.grip is not None:
                assert abs(sample.grip - (grip or 0.0)) <= min(step, MAX_STEP) + 1e-9
            grip = sample.grip
        leader.close()
    assert moved > cases
    assert lost > cases / 2
    print(f"{cases} storms of 120 events: {moved} samples moved, {lost} unpluggings")


# -- pedals


def test_pedals_are_grabbed_and_say_what_is_pressed(machine: Machine) -> None:
    machine.plug(KEYBOARD)
    feet = machine.plug(PEDALS)
    leader = opened(Pedals, machine)
    assert feet.grabbed
    assert not machine.plugged[0].grabbed  # the keyboard is left alone
    assert leader.read(0.0).buttons == frozenset()  # type: ignore[union-attr]
    for key, says in (("KEY_A", "clutch"), ("KEY_B", "camera"), ("KEY_C", "present")):
        feet.press(key)
        sample = leader.read(0.1)
        assert sample is not None
        assert sample.buttons == {says}
        assert sample.rate is None
        assert sample.pose is None
        feet.release(key)
        leader.read(0.2)
    leader.close()
    assert not feet.grabbed


def test_a_clutch_pedal_fails_to_pressed(machine: Machine) -> None:
    leader = Pedals(host=machine)
    first = leader.read(0.0)
    assert first.buttons == {"clutch"}
    assert "not opened" in first.problem
    feet = machine.plug(PEDALS)
    feet.press("KEY_A", "KEY_C")
    leader.open()
    assert leader.read(0.1).buttons == {"clutch"}  # held from the start counts; present does not
    feet.release("KEY_A", "KEY_C")
    assert leader.read(0.2) == LeaderSample(stamp=0.2, buttons=frozenset())
    feet.press("KEY_C")
    assert leader.read(0.3).buttons == {"present"}
    machine.unplug(feet)
    for now in (0.4, 1.0, 60.0):
        gone = leader.read(now)
        assert gone.buttons == {"clutch"}
        assert "PCsensor FootSwitch" in gone.problem
    assert machine.plug(PEDALS) is not None
    assert leader.read(61.0).buttons == frozenset()


# -- the wrong device, and no device


def refusal(make: Callable[..., Leader], machine: Machine, **settings: object) -> str:
    with pytest.raises(LeaderError) as caught:
        opened(make, machine, **settings)
    return str(caught.value)


def test_nothing_plugged_in_is_said(machine: Machine) -> None:
    text = refusal(Gamepad, machine)
    assert "no input device found" in text
    assert "plug it in" in text


def test_a_device_that_lacks_axes_is_named_with_what_it_lacks(machine: Machine) -> None:
    machine.plug(KEYBOARD)
    axes = {a: s for a, s in GAMEPAD.axes.items() if a not in (code("ABS_RX"), code("ABS_RZ"))}
    machine.plug(replace(GAMEPAD, axes=axes, name="Old Pad"))
    text = refusal(Gamepad, machine)
    assert "'Old Pad' (/dev/input/event7) has no ABS_RX (right_x), ABS_RZ (right_trigger)" in text
    assert "'AT Keyboard' (/dev/input/event0) has none of what is needed" in text
    assert "write a layout" in text


def test_no_permission_names_the_nodes_and_the_cure(machine: Machine) -> None:
    machine.plug(GAMEPAD)
    machine.forbidden.add(GAMEPAD.path)
    text = refusal(Gamepad, machine)
    assert "no permission to read /dev/input/event7" in text
    assert "usermod -aG input" in text
    assert "udev" in text


def test_a_path_that_is_not_there_is_said(machine: Machine) -> None:
    machine.plug(GAMEPAD)
    text = refusal(Gamepad, machine, device="/dev/input/event99")
    assert "/dev/input/event99 does not fit: /dev/input/event99: No such file" in text
    assert "ls -l /dev/input/by-id" in text


def test_a_path_chooses_among_two_and_needs_no_name(machine: Machine) -> None:
    machine.plug(GAMEPAD)
    other = machine.plug(replace(GAMEPAD, path="/dev/input/event8"))
    leader = opened(Gamepad, machine, device="/dev/input/event8")
    leader.read(0.0)
    other.press("BTN_TL")
    sample = leader.read(0.1)
    assert sample is not None
    assert sample.buttons == {"clutch"}
    machine.plug(replace(PEDALS, name="Unnamed", path="/dev/input/event3"))
    assert "is not called 'foot'" in refusal(Pedals, machine)
    opened(Pedals, machine, device="/dev/input/event3")


def test_pedals_that_somebody_else_has_grabbed_are_not_used(machine: Machine) -> None:
    machine.plug(PEDALS).busy = True
    text = refusal(Pedals, machine)
    assert "'PCsensor FootSwitch' (/dev/input/event9): cannot be grabbed" in text
    assert "stop the program that holds it" in text


def test_a_long_list_of_devices_is_cut(machine: Machine) -> None:
    for i in range(SHOWN + 3):
        machine.plug(replace(KEYBOARD, path=f"/dev/input/event{i:02d}"))
    assert "and 3 more" in refusal(Gamepad, machine)


# -- layouts


def test_every_bundled_layout_is_good() -> None:
    assert bundled() == (
        "gamepad",
        "gamepad_spherical",
        "pedals",
        "spacemouse",
        "spacemouse_relative",
    )
    for name in bundled():
        layout = read_layout(name)
        assert layout.hand == {} or layout.dead_man is not None


def gamepad_tree() -> dict[str, object]:
    tree = yaml.safe_load((FOLDER / "gamepad.yaml").read_text())
    assert isinstance(tree, dict)
    return tree


WRONG = {
    "format": ("surg_input/2", "format: 'surg_input/2'; allowed: surg_input/1"),
    "typo": (1, "the file: 'typo'; allowed: format"),
    "axes": ([], "axes: '[]'; allowed: names"),
    "axes.left_x": (3, "axes.left_x: '3'; allowed: keys and values: code, sign, rest"),
    "axes.left_x.code": ("ABS_NONSENSE", "axes.left_x.code: 'ABS_NONSENSE'; allowed: the kernel's"),
    "axes.left_x.sign": (2, "axes.left_x.sign: '2'; allowed: 1 or -1"),
    "axes.left_x.rest": ("top", "axes.left_x.rest: 'top'; allowed: middle, minimum"),
    "buttons.south": ("ABS_X", "buttons.south: 'ABS_X'; allowed: the kernel's name, BTN"),
    "buttons.left_x": ("BTN_C", "buttons: 'left_x'; allowed: a name that no axis has"),
    "hand.x.axis": ("left_z", "hand.x.axis: 'left_z'; allowed: left_x, left_y"),
    "hand.x.full": (0.3, "hand.x.full: '0.3'; allowed: a number from -0.2 to 0.2"),
    "hand.yaw": ({"axis": "left_x", "full": 0.1}, "hand: 'x'; allowed: yaw, pitch"),
    "hand.w": ({}, "hand: 'w'; allowed: x, y, z, roll"),
    "dead_zone": (0.9, "dead_zone: '0.9'; allowed: a number from 0 to 0.5"),
    "dead_man": ("left_x", "dead_man: 'left_x'; allowed: south"),
    "autorepeat": (float("nan"), "autorepeat: 'nan'; allowed: a number from 5 to 200"),
    "grip.open": ("mouth", "grip.open: 'mouth'; allowed: left_x"),
    "grip.speed": (True, "grip.speed: 'True'; allowed: a number from 0 to 5"),
    "actions.clutch": ("knee", "actions.clutch: 'knee'; allowed: south"),
    "actions.present": ("south", "actions: 'present'; allowed: camera, clutch"),
    "fail_pressed": (["rate"], "fail_pressed: 'rate'; allowed: clutch, enable"),
    "grab": ("yes please", "grab: 'yes please'; allowed: true or false"),
}


@pytest.mark.parametrize("key", WRONG)
def test_a_wrong_layout_says_which_value_and_what_is_allowed(key: str, tmp_path: Path) -> None:
    value, said = WRONG[key]
    tree = gamepad_tree()
    *folders, last = key.split(".")
    place: dict[str, object] = tree
    for name in folders:
        place = place[name]  # type: ignore[assignment]
    place[last] = value
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(tree, sort_keys=False))
    with pytest.raises(LeaderError) as caught:
        Gamepad(layout=str(path))
    assert f"{path}: {said}" in str(caught.value)


def test_a_device_that_moves_needs_a_dead_man(tmp_path: Path) -> None:
    tree = gamepad_tree()
    del tree["dead_man"]
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(tree, sort_keys=False))
    with pytest.raises(LeaderError, match=r"dead_man: 'None'; allowed: south, .*elsewhere"):
        Gamepad(layout=str(path))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"\xff\xfe", "is not YAML"),
        (b"a: [", "is not YAML"),
        (b"!!python/object/apply:os.getcwd []", "is not YAML"),
        (b"", "allowed: keys and values"),
    ],
)
def test_a_file_that_is_no_layout_is_refused(text: bytes, said: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_bytes(text)
    with pytest.raises(LeaderError, match=said):
        read_layout(str(path))


def test_an_unknown_layout_names_those_there_are(tmp_path: Path) -> None:
    with pytest.raises(LeaderError, match="there are gamepad, gamepad_spherical, pedals"):
        read_layout("joystick")
    with pytest.raises(LeaderError, match="cannot be read: No such file"):
        read_layout(str(tmp_path / "none.yaml"))


def test_they_are_found_by_name() -> None:
    for name, kind in (("gamepad", Gamepad), ("pedals", Pedals), ("spacemouse", SpaceMouse)):
        leader = load(name, {"name": "mine"})
        assert type(leader) is kind
        assert leader.name == "mine"
