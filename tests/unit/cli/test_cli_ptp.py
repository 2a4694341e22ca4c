"""./surg ptp: its configuration, what it refuses, and the status of a clock."""

from __future__ import annotations

import functools
import math
import os
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers.graph.surg import parsed
from surg_cli.commands import ptp
from surg_cli.host.terminal import CliError
from surg_recording.clock import pmc
from surg_recording.clock.clock_sync import ClockStatus


@pytest.fixture
def network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A machine with a loopback, a cable that is in, one that is out, and linuxptp."""
    folder = tmp_path / "net"
    for name, state in (("lo", "unknown"), ("enp1", "up"), ("enp2", "down")):
        (folder / name).mkdir(parents=True)
        (folder / name / "operstate").write_text(state + "\n")
    monkeypatch.setattr(ptp, "NETWORK", folder)
    monkeypatch.setattr(pmc, "program", lambda name: f"/usr/sbin/{name}")
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    yield folder


options = functools.partial(parsed, "ptp")


def refusal(*words: str) -> str:
    with pytest.raises(CliError) as caught:
        ptp.main(options(*words), "ptp")
    assert caught.value.code == 2
    return str(caught.value)


def test_without_root_the_whole_command_is_told(network: Path) -> None:
    said = refusal("slave", "enp1")
    assert "sudo ./surg ptp slave enp1" in said


def test_the_only_live_interface_is_taken(network: Path) -> None:
    assert "needs root" in refusal("master")


def test_several_live_interfaces_are_listed(network: Path) -> None:
    (network / "enp2" / "operstate").write_text("up\n")
    said = refusal("master")
    assert "enp1 (up), enp2 (up)" in said
    assert "lo" not in said.split(":")[-1].split()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("eth9", "enp1 (up), enp2 (down)"),
        ("lo", "PTP does not run on loopback"),
        ("enp2", "sudo ip link set enp2 up"),
        ("../enp1", "no such interface"),
    ],
)
def test_an_unusable_interface_is_refused(network: Path, name: str, words: str) -> None:
    assert words in refusal("master", name)


def test_a_missing_package_is_told_with_the_cure(
    network: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pmc, "program", lambda name: None)
    assert "apt install linuxptp" in refusal("master", "enp1")


def test_a_master_is_never_free_running(network: Path) -> None:
    assert "--free-running" in refusal("master", "--free-running")


def test_a_clock_that_another_program_steers_is_refused(
    monkeypatch: pytest.MonkeyPatch, network: Path
) -> None:
    name = Path("/proc/self/comm").read_text().strip()
    monkeypatch.setattr(ptp, "RIVALS", (name,))
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    assert name in refusal("slave")


def settings(text: str) -> dict[str, str]:
    lines = [line for line in text.splitlines() if re.match(r"\w", line)]
    return dict(line.split(None, 1) for line in lines)


def test_the_configuration_of_both_roles() -> None:
    master = settings(ptp.configuration("master", "enp1", Path("/run/x/ptp4l"), False))
    slave = settings(ptp.configuration("slave", "enp1", Path("/run/x/ptp4l"), False))
    measuring = settings(ptp.configuration("slave", "enp1", Path("/run/x/ptp4l"), True))
    assert (master["masterOnly"], master["slaveOnly"]) == ("1", "0")
    assert (slave["masterOnly"], slave["slaveOnly"]) == ("0", "1")
    assert int(master["priority1"]) < int(slave["priority1"])
    assert slave["step_threshold"] == "0.0"  # never a step after the first
    assert [s["free_running"] for s in (master, slave, measuring)] == ["0", "0", "1"]
    for found in (master, slave, measuring):
        assert found["time_stamping"] == "software"
        assert found["uds_address"] == "/run/x/ptp4l"
    assert ptp.configuration("slave", "enp1", Path("/x"), True).endswith("[enp1]\n")


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (ClockStatus("MASTER", 0.0, math.nan, "a", "a"), "master, clock a"),
        (
            ClockStatus("SLAVE", 12.34e-6, 40e-6, "a", "b"),
            "synchronised, offset +12.3 µs, path delay 40.0 µs, master a",
        ),
        (ClockStatus("SLAVE", -5e-3, 40e-6, "a", "b"), "the clock is -5.000 ms off its master"),
        (ClockStatus("LISTENING"), "no PTP master is heard"),
        (ClockStatus(problem="no daemon"), "no daemon"),
    ],
)
def test_how_a_clock_is_described(status: ClockStatus, words: str) -> None:
    assert ptp.describe(status).startswith(words)
