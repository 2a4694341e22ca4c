"""`--ros2` of `./surg up`, `teleop` and `run`: a gateway on request, or why there is none."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.graph import surg
from surg_cli.commands import run, teleop
from surg_cli.graph import ros2_gateway, running, system
from surg_cli.graph.system_plan import SystemPlan
from surg_cli.host import paths, provision
from surg_cli.host.terminal import CliError

ENCLAVE = [
    *("identity_ca.cert.pem", "cert.pem", "key.pem", "permissions_ca.cert.pem"),
    *("governance.p7s", "permissions.p7s"),
]
"""What `ros2 security create_enclave` makes."""


@pytest.fixture(autouse=True)
def nothing_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provision, "need_dds", lambda: False)
    for name in ("ROS_DOMAIN_ID", "RMW_IMPLEMENTATION", "ROS_SECURITY_ENABLE"):
        monkeypatch.delenv(name, raising=False)


def printed(capsys: pytest.CaptureFixture[str], *words: str) -> list[str]:
    """The lines of the gateway that `./surg up --print` prints."""
    return [line for line in surg.printed(capsys, "sim_ur5e", *words) if "surg_ros2" in line]


def test_without_the_option_there_is_no_gateway(capsys: pytest.CaptureFixture[str]) -> None:
    assert printed(capsys) == []


def test_the_gateway_of_this_machine(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (line,) = printed(capsys, "--ros2")
    for word in ("_interface:=lo", "_domain:=0", "_commands:=false", "_mode:=freerun"):
        assert word in line
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    (line,) = printed(capsys, "--ros2-commands", "--lock-step", "ros2_script")
    for word in ("_interface:=lo", "_domain:=42", "_commands:=true", "_mode:=lockstep"):
        assert word in line


@pytest.mark.parametrize(
    ("words", "domain", "said"),
    [
        (["--ros2", "nope"], "", "--ros2 nope: no such network interface; there are lo"),
        (["--ros2"], "233", "ROS_DOMAIN_ID=233: expected a whole number from 0 to 232"),
        (["--ros2"], "two", "ROS_DOMAIN_ID=two: expected a whole number"),
        (["--ros2", "nope", "--ros2-commands"], "", "--ros2 nope: no such network interface"),
        (["--ros2", "--role", "operator"], "", "--ros2: give it to the robot's machine"),
        (["--ros2-commands", "--role", "operator"], "", "--ros2-commands: give it to the robot's"),
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


def test_a_secured_domain_has_all_its_files(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def refused(said: str) -> None:
        with pytest.raises(CliError, match=said) as caught:
            printed(capsys, "--ros2")
        assert caught.value.code == 2

    monkeypatch.delenv("ROS_SECURITY_KEYSTORE", raising=False)
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    refused("ROS_SECURITY_KEYSTORE must name the folder")
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(tmp_path))
    monkeypatch.setenv("ROS_SECURITY_ENCLAVE_OVERRIDE", "/robot")
    enclave = tmp_path / "enclaves" / "robot"
    for name in ENCLAVE:  # one after the other, in any order
        refused("enclaves/robot/.*: no such file; `ros2 security create_enclave")
        paths.write_text(enclave / name, "")
    assert f"_enclave:={enclave}" in printed(capsys, "--ros2")[0]
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "false")
    assert f"_enclave:={enclave}" not in printed(capsys, "--ros2")[0]


def test_a_package_that_cannot_be_had_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> bool:
        raise CliError("pip failed")

    monkeypatch.setattr(provision, "need_dds", fail)
    with pytest.raises(CliError, match="--ros2: pip failed") as caught:
        ros2_gateway.parameters(surg.parsed("up", "sim_ur5e", "--ros2"))
    assert caught.value.code == 2


def gateway(plan: SystemPlan) -> system.Node | None:
    return next((node for node in system.nodes(plan) if node.name == system.GATEWAY), None)


def test_a_teleoperation_has_a_gateway() -> None:
    assert gateway(teleop._plan(surg.parsed("teleop", "sim_ur5e"))) is None
    node = gateway(teleop._plan(surg.parsed("teleop", "sim_ur5e", "--ros2-commands")))
    assert node is not None and not node.essential
    assert (node.params["commands"], node.params["mode"]) == (True, "freerun")


def test_a_system_that_runs_gets_none_from_a_teleoperation(monkeypatch: pytest.MonkeyPatch) -> None:
    there = running.System(11311, 1, 1, "up", "sim_ur5e", "logs")
    monkeypatch.setattr(running, "systems", lambda *port: [there])
    for word in ("--ros2", "--ros2-commands"):
        said = rf"start that system with it: \./surg up CELL {word}$"
        with pytest.raises(CliError, match=said) as caught:
            teleop.main(surg.parsed("teleop", "sim_ur5e", word), "teleop")
        assert caught.value.code == 2


def test_every_episode_of_a_run_has_a_gateway_that_looks_on(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    class Played(Exception):
        pass

    def play(plan: SystemPlan, *more: object) -> None:
        raise Played(gateway(plan))

    monkeypatch.setattr(run, "_play_all", play)
    for words, mode in ((["--ros2"], "lockstep"), ([], "")):
        with pytest.raises(Played) as caught:
            run.main(surg.parsed("run", "bgr", "--out", str(tmp_path / f"o{mode}"), *words), "run")
        (node,) = caught.value.args
        assert (node.params["mode"], node.params["commands"]) == (mode, False) if mode else not node
    with pytest.raises(CliError, match="run has no option --ros2-commands"):
        surg.parsed("run", "bgr", "--ros2-commands")
