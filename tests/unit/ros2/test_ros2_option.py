"""`./surg up --ros2`: the gateway is there when it is asked for, and refused by name."""

from __future__ import annotations

import argparse

import pytest

from surg_cli.commands import up
from surg_cli.graph import ros2_gateway
from surg_cli.host import provision
from surg_cli.host.terminal import CliError


@pytest.fixture(autouse=True)
def nothing_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provision, "need_dds", lambda: False)
    for name in ("ROS_DOMAIN_ID", "RMW_IMPLEMENTATION"):
        monkeypatch.delenv(name, raising=False)


def printed(capsys: pytest.CaptureFixture[str], *words: str) -> list[str]:
    """The lines of the gateway that `./surg up --print` prints."""
    parser = argparse.ArgumentParser()
    up.add_arguments(parser, "up")
    up.main(parser.parse_args(["sim_ur5e", *words, "--print"]), "up")
    return [line for line in capsys.readouterr().out.splitlines() if "surg_ros2" in line]


def test_without_the_option_there_is_no_gateway(capsys: pytest.CaptureFixture[str]) -> None:
    assert printed(capsys) == []


def test_the_gateway_of_this_machine(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (line,) = printed(capsys, "--ros2")
    for word in ("_interface:=lo", "_domain:=0", "_commands:=false", "_mode:=freerun"):
        assert word in line
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    (line,) = printed(capsys, "--ros2", "lo", "--ros2-commands", "--lock-step", "ros2_script")
    for word in ("_domain:=42", "_commands:=true", "_mode:=lockstep"):
        assert word in line


@pytest.mark.parametrize(
    ("words", "domain", "said"),
    [
        (["--ros2-commands"], "", "--ros2-commands: only with --ros2"),
        (["--ros2", "nope"], "", "--ros2 nope: no such network interface; there are lo"),
        (["--ros2"], "233", "ROS_DOMAIN_ID=233: expected a whole number from 0 to 232"),
        (["--ros2"], "two", "ROS_DOMAIN_ID=two: expected a whole number"),
        (["--ros2", "--role", "operator"], "", "--ros2: give it to the robot's machine"),
    ],
)
def test_what_cannot_be_is_refused(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    domain: str,
    said: str,
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    with pytest.raises(CliError, match=said) as caught:
        printed(capsys, *words)
    assert caught.value.code == 2


def test_how_services_are_framed(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for framing in ("rmw_fastrtps_cpp", "rmw_cyclonedds_cpp"):
        monkeypatch.setenv("RMW_IMPLEMENTATION", framing)
        assert f"_implementation:={framing}" in printed(capsys, "--ros2")[0]
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_zenoh_cpp")
    said = "RMW_IMPLEMENTATION=rmw_zenoh_cpp: expected rmw_fastrtps_cpp or rmw_cyclonedds_cpp"
    with pytest.raises(CliError, match=said) as caught:
        printed(capsys, "--ros2")
    assert caught.value.code == 2


def test_a_package_that_cannot_be_had_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> bool:
        raise CliError("pip failed")

    monkeypatch.setattr(provision, "need_dds", fail)
    options = argparse.Namespace(ros2="lo", ros2_commands=False)
    with pytest.raises(CliError, match="--ros2: pip failed") as caught:
        ros2_gateway.parameters(options)
    assert caught.value.code == 2
