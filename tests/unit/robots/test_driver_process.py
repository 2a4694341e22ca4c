"""What a driver asks of the machine: one driver for each robot, and a priority for a real one."""

import os

import pytest

from helpers.hardware.emulated_ur import free_address
from surg_hardware import driver_process
from surg_hardware.driver_process import NotHere


def test_a_robot_has_one_driver_on_this_machine() -> None:
    address = free_address()
    with driver_process.alone(address):
        with pytest.raises(NotHere, match="another driver"), driver_process.alone(address):
            pass
        with driver_process.alone(free_address()):
            pass
    with driver_process.alone(address):
        pass


def test_a_real_arm_needs_the_priority_and_an_emulated_one_does_without(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def denied(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", denied)
    with pytest.raises(NotHere, match=r"hardware\.realtime: priority 40 .*ulimit -r"):
        driver_process.realtime(40, "192.168.56.2")
    assert driver_process.realtime(40, "127.0.0.1") is False
