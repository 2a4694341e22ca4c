"""Where ROS ports may be opened for another machine, and where not: words and decisions."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from helpers.graph.surg import surg
from surg_cli.graph import join, network, roles
from surg_cli.graph.roles import Link, Role
from surg_cli.graph.system_plan import SystemPlan
from surg_cli.host import paths
from surg_cli.host.terminal import CliError
from surg_console.ros.console_node import Settings

MACHINES = {"robot": "192.168.77.1", "operator": "192.168.77.2"}
HEADER = "Iface\tDestination\tGateway \tFlags\tRefCnt\tUse\tMetric\tMask\t\tMTU\tWindow\tIRTT\n"
ISOLATED = "eth1\t004DA8C0\t00000000\t0001\t0\t0\t0\t00FFFFFF\t0\t0\t0\n"
ELSEWHERE = "wlan0\t00000000\t0100000A\t0003\t0\t0\t0\t00000000\t0\t0\t0\n"
ROUTER = "eth1\t00000000\tFE4DA8C0\t0003\t0\t0\t0\t00000000\t0\t0\t0\n"


def cell(network_: str = "isolated", machines: dict[str, str] | None = None) -> SimpleNamespace:
    machines = MACHINES if machines is None else machines
    return SimpleNamespace(file="cell.yaml", network=network_, machines=machines)


@pytest.mark.skipif(sys.byteorder != "little", reason="the texts are of such a machine")
def test_routes_are_read() -> None:
    found = roles.routes(HEADER + ISOLATED + ROUTER)
    assert [r.interface for r in found] == ["eth1", "eth1"]
    assert str(found[0].network) == "192.168.77.0/24"
    assert [str(r.gateway) for r in found] == ["0.0.0.0", "192.168.77.254"]
    assert roles.routes("") == []


def test_a_link_has_master_and_addresses() -> None:
    link = replace(roles.link_of(cell(), Role.OPERATOR, 11311), guard=True)
    assert (link.address, link.robot, link.others) == ("192.168.77.2", "192.168.77.1", ("robot",))
    base = {
        "ROS_HOSTNAME": "localhost",
        "ROS_IP": "127.0.0.1",
        "LD_PRELOAD": "a.so",
        "PATH": "/bin",
    }
    env = link.environment(base, network.GUARD)
    assert env["ROS_MASTER_URI"] == "http://192.168.77.1:11311"
    assert env["ROS_IP"] == env["SURG_LISTEN_ON"] == "192.168.77.2"
    assert "ROS_HOSTNAME" not in env, "it would win over ROS_IP"
    assert env["LD_PRELOAD"] == f"{network.GUARD}:a.so"
    assert link.environment(env, network.GUARD) == env, "twice is once"
    assert int(env["SURG_TCP_TIMEOUT_MS"]) == 1000 * roles.WAITS[Role.OPERATOR].tcp


def test_without_the_guard_nothing_is_preloaded() -> None:
    env = roles.link_of(cell(), Role.OPERATOR, 11311).environment({}, network.GUARD)
    assert env == {"ROS_IP": "192.168.77.2", "ROS_MASTER_URI": "http://192.168.77.1:11311"}


def test_without_the_guard_a_second_network_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    here = {"192.168.77.1"}
    monkeypatch.setattr(roles, "local_addresses", lambda _: here)
    link = roles.link_of(cell(), Role.ROBOT, 11311)
    network.refuse_foreign_ports([], link)
    here.add("10.1.2.3")
    with pytest.raises(CliError, match=r"10\.1\.2\.3.*--port-guard"):
        network.refuse_foreign_ports([], link)


def test_a_second_address_of_one_interface_is_seen() -> None:
    table = """Main:
  +-- 0.0.0.0/0 3 0 5
     +-- 127.0.0.0/8 2 0 2
           |-- 127.0.0.1
              /32 host LOCAL
     +-- 192.168.77.0/24 2 0 2
        |-- 192.168.77.0
           /24 link UNICAST
        |-- 192.168.77.1
           /32 host LOCAL
        |-- 192.168.77.255
           /32 link BROADCAST
        |-- 10.1.2.3
           /32 host LOCAL
"""
    assert roles.local_addresses(table) == {"192.168.77.1", "10.1.2.3"}


@pytest.mark.parametrize(
    ("config", "role", "words"),
    [
        (
            cell("loopback", {}),
            Role.ROBOT,
            ["'network: loopback' and no machines", "isolated"],
        ),
        (cell("isolated", {}), Role.ROBOT, ["no machines", "machines:", "robot: 192.168.77.1"]),
        (cell(), Role.ENDOSCOPE, ["machines.endoscope is missing", "robot, operator"]),
    ],
)
def test_a_cell_that_does_not_say_so_opens_nothing(
    config: SimpleNamespace, role: Role, words: list[str]
) -> None:
    with pytest.raises(CliError) as caught:
        roles.link_of(config, role, 11311)
    assert caught.value.code == 2
    for word in words:
        assert word in str(caught.value)


def refusal(has: bool, text: str, **interfaces: str) -> str:
    known = {"wlan0": "10.0.0.5", **interfaces}
    with pytest.raises(CliError) as caught:
        roles.check_address("192.168.77.1", Role.ROBOT, has, known, roles.routes(HEADER + text))
    assert caught.value.code == 2
    return str(caught.value)


def test_an_address_that_leads_elsewhere_is_refused_with_the_cure() -> None:
    text = refusal(True, ELSEWHERE + ISOLATED + ROUTER)
    for word in (
        "192.168.77.1 is routable",
        "eth1",
        "192.168.77.254",
        "ip route del",
        "of its own",
    ):
        assert word in text
    behind = (
        "eth1\t0000000A\tFE4DA8C0\t0003\t0\t0\t0\t000000FF\t0\t0\t0\n"  # 10.0.0.0/8 by a router
    )
    assert "routable" in refusal(True, ISOLATED + behind)


def test_an_address_of_another_machine_is_refused_with_what_there_is() -> None:
    text = refusal(False, ISOLATED)
    for word in ("does not have machines.robot = 192.168.77.1", "10.0.0.5 (wlan0)", "cable"):
        assert word in text


def test_an_isolated_address_beside_another_network_is_taken() -> None:
    table = roles.routes(HEADER + ELSEWHERE + ISOLATED)
    roles.check_address("192.168.77.1", Role.ROBOT, True, {}, table)


def test_an_address_without_a_network_is_looked_up_by_its_interface() -> None:
    """With the mask /32 no route tells of it; virtual machines are given such addresses."""
    assert "eth1 also leads" in refusal(True, ROUTER, eth1="192.168.77.1")
    assert "no interface" in refusal(True, ELSEWHERE)
    table = roles.routes(HEADER + ELSEWHERE)
    roles.check_address("192.168.77.1", Role.ROBOT, True, {"eth1": "192.168.77.1"}, table)


def plan_of(cameras: tuple[str, ...] = ("left",)) -> SystemPlan:
    out = paths.RUNS / "x"
    return SystemPlan(paths.CELLS / "sim_two_arms", ("PSM1", "ECM"), False, cameras, out)


def place_of(role: Role, **machines: str) -> Link:
    return roles.link_of(cell(machines={**MACHINES, **machines}), role, 11311)


def names_on(role: Role, leader: str = join.LEADER, **machines: str) -> set[str]:
    return {node.name for node in join.nodes(plan_of(), place_of(role, **machines), leader)}


def test_every_node_is_on_one_machine_of_the_cell() -> None:
    scope = {"endoscope": "192.168.77.3"}
    robot = {"/sim", "/PSM1/controller", "/ECM/controller", "/recorder"}
    assert names_on(Role.ROBOT) == robot | {"/endoscope"}
    assert names_on(Role.ROBOT, **scope) == robot
    assert names_on(Role.ENDOSCOPE, **scope) == {"/endoscope"}
    assert names_on(Role.OPERATOR) == {"/teleop"}
    assert names_on(Role.OPERATOR, "browser") == {"/teleop", "/console"}


def test_the_operators_page_is_served_on_the_operators_machine_alone() -> None:
    hands, page = join.nodes(plan_of(), place_of(Role.OPERATOR), "browser")
    assert hands.params["settings"] == {"name": "browser"} and hands.params["need_present"] is True
    assert page.params["leader"] == "browser" and "bind" not in page.params
    rules = Settings(dict(page.params)).access
    assert (rules.bind, rules.port) == ("127.0.0.1", 8090)
    (hands,) = join.nodes(plan_of(()), place_of(Role.OPERATOR), "gamepad")
    assert hands.params["need_present"] is False and hands.params["picture"] == ""


def test_a_clock_that_a_daemon_keeps_is_watched_on_every_machine(tmp_path: Path) -> None:
    daemon = tmp_path / "ptp4l"
    assert join.clock_monitor(Role.ROBOT, daemon) == []
    daemon.touch()
    found = [node for role in Role for node in join.clock_monitor(role, daemon)]
    assert [node.name for node in found] == [
        "/clock_sync_robot",
        "/clock_sync_operator",
        "/clock_sync_endoscope",
    ]
    assert all(node.params == {"socket": str(daemon)} and not node.essential for node in found)


def test_foreign_ports_are_named() -> None:
    text = (
        "  sl  local_address rem_address   st\n"
        "   0: 014DA8C0:2C2F 00000000:0000 0A 00000000:00000000 00:00000000 00000000 0 0 11 1\n"
        "   1: 00000000:1F90 00000000:0000 0A 00000000:00000000 00:00000000 00000000 0 0 12 1\n"
        "   2: 0100007F:1F91 00000000:0000 0A 00000000:00000000 00:00000000 00000000 0 0 13 1\n"
        "   3: 00000000:1F92 0100007F:0001 01 00000000:00000000 00:00000000 00000000 0 0 14 1\n"
    )
    text6 = (
        "  sl\n   0: 00000000000000000000000000000000:1F93 0:0 0A 0:0 0:0 0 0 0 15 1\n"
        "   1: 00000000000000000000000001000000:1F94 0:0 0A 0:0 0:0 0 0 0 16 1\n"
    )
    sockets = roles.listening(text, text6)
    assert sockets == {
        11: "192.168.77.1:11311",
        12: "0.0.0.0:8080",
        13: "127.0.0.1:8081",
        15: ":::8083",
        16: "::1:8084",
    }
    held = {"/a": {11, 13, 16}, "/b": {12, 99}, "/c": {15}, "/d": set()}
    wrong = roles.foreign_ports(sockets, held, "192.168.77.1")
    assert wrong == ["/b listens on 0.0.0.0:8080", "/c listens on :::8083"]


def test_an_open_port_of_this_process_is_seen() -> None:
    link = replace(roles.link_of(cell(), Role.ROBOT, 11311), guard=True)
    with socket.socket() as port:
        port.bind(("0.0.0.0", 0))
        port.listen()
        with pytest.raises(CliError, match=f"surg listens on 0.0.0.0:{port.getsockname()[1]}"):
            network.refuse_foreign_ports([], link)
    network.refuse_foreign_ports([], link)


def test_own_addresses() -> None:
    assert network.has("127.0.0.1")
    assert not network.has("192.0.2.77")
    assert not any(text.startswith("127.") for text in network.addresses().values())


@pytest.mark.skipif(not network.GUARD.is_file(), reason="the workspace is not built")
@pytest.mark.parametrize(
    ("family", "asked", "got"),
    [
        ("AF_INET", "0.0.0.0", "127.0.0.7"),
        ("AF_INET", "127.0.0.1", "127.0.0.1"),
        ("AF_INET6", "::1", "::1"),
        ("AF_INET6", "::", "refused"),
    ],
)
def test_the_guard_keeps_ports_on_one_address(family: str, asked: str, got: str) -> None:
    code = (
        f"import socket\ns = socket.socket(socket.{family})\n"
        f"try:\n s.bind(({asked!r}, 0)); s.listen(); print(s.getsockname()[0])\n"
        " print(s.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT))\n"
        "except OSError: print('refused')"
    )
    link = Link(Role.ROBOT, "127.0.0.7", "127.0.0.7", 1, guard=True)
    env = link.environment(os.environ, network.GUARD)
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True
    )
    words = done.stdout.split()
    if family == "AF_INET6" and not words:
        pytest.skip("no IPv6 here")
    assert words[0] == got
    assert words[1:] == ([] if got == "refused" else ["3000"])


def test_the_command_refuses_before_anything_starts() -> None:
    done = surg("up", "sim_ur5e", "--role", "robot")
    assert done.returncode == 2
    assert "network: loopback" in done.stderr
    assert "isolated" in done.stderr
