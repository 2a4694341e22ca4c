"""`./surg ptp master|slave`: one clock for two machines, by linuxptp's `ptp4l`.

The controller's machine is the master: its clock is left alone and told to the network. A slave
sets its own clock to it. The daemon runs until Ctrl-C, together with one line on how far it is.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import shutil
import sys
import time
from pathlib import Path

from surg_cli.graph import processes
from surg_cli.host import paths
from surg_cli.host.terminal import Problem, is_interactive, say, warn

# As root on a machine where nothing has been built: from the source tree.
sys.path.append(str(paths.ROOT / "src" / "surg_recording" / "src"))

from surg_recording.clock import clock_sync, pmc

FOLDER = Path(clock_sync.SOCKET).parent
NETWORK = Path("/sys/class/net")
START_TIMEOUT_S = 10.0
LOOK_S = 1.0
QUIET_S = 10.0
# Programs that steer the same clock: two hands on one wheel.
RIVALS = ("chronyd", "ntpd", "systemd-timesyn", "openntpd", "ptp4l", "phc2sys")


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.description = (
        "Keep the clocks of two machines together by PTP (linuxptp, software stamps). The machine"
        " of the controllers is the master: its clock is not touched. On a slave the clock is SET"
        " to the master's: by a step at the start, then steered. Start it before you record, on"
        " the interface of the isolated network. Ctrl-C ends it. More: docs/guide/clock_sync.md"
    )
    parser.add_argument("role", choices=("master", "slave"), help="who this machine is")
    parser.add_argument("--interface", metavar="IF", help="network interface, e.g. enp3s0")
    parser.add_argument(
        "--free-running",
        action="store_true",
        help="slave: measure the offset, leave the clock alone",
    )
    parser.add_argument(
        "--folder",
        type=Path,
        default=FOLDER,
        metavar="DIR",
        help=f"for configuration, socket and log (default {FOLDER})",
    )


def main(options: argparse.Namespace, command: str) -> int:
    """Check, write the configuration, run the daemon until Ctrl-C."""
    if options.role == "master" and options.free_running:
        raise Problem("--free-running is a slave's: a master's clock is never touched", 2)
    daemon = _program("ptp4l")
    _program("pmc")
    interface = _interface(options.interface)
    _check_permission(options)
    steers = options.role == "slave" and not options.free_running
    if steers:
        _check_rivals()
    folder = options.folder.absolute()
    socket = folder / "ptp4l"
    if socket.exists() and not pmc.ask(socket).problem:
        raise Problem(f"a PTP daemon runs already: it answers at {socket}; end that one first")
    _make_folder(folder)
    file = folder / "ptp4l.conf"
    paths.write_text(file, configuration(options.role, interface, socket, options.free_running))
    say(_announcement(options.role, interface, options.free_running, file))
    env = {"PATH": os.environ.get("PATH", os.defpath), "LC_ALL": "C.UTF-8"}
    try:
        with processes.Supervisor(env, folder) as supervisor:
            child = supervisor.start("ptp4l", [daemon, "-f", file, "-m"])
            _watch(child, socket, steers)
    except KeyboardInterrupt:
        say("ptp: ended; the clock runs on by itself")
        return 0
    finally:
        for left in (socket, folder / "ptp4lro", file):
            left.unlink(missing_ok=True)
    return 1


def configuration(role: str, interface: str, socket: Path, free_running: bool) -> str:
    """The text of ptp4l's configuration file.

    Args:
        role: `master` or `slave`.
        interface: Name of the network interface.
        socket: Where the daemon can be asked.
        free_running: Measure only.
    """
    lines = [
        f"# Written by ./surg ptp {role}; docs/guide/clock_sync.md explains it.",
        "[global]",
        # The kernel stamps packets: works with every network card and needs no hardware clock.
        "time_stamping           software",
        "network_transport       UDPv4",
        "delay_mechanism         E2E",
        f"masterOnly              {int(role == 'master')}",
        f"slaveOnly               {int(role == 'slave')}",
        # Another PTP clock on this network must not take over.
        f"priority1               {100 if role == 'master' else 255}",
        "logSyncInterval         -2",  # four times a second: the median is quick to settle
        "logMinDelayReqInterval  -2",
        f"free_running            {int(free_running)}",
        # A slave steps once, at the start; later a step would tear recordings apart.
        "first_step_threshold    0.00002",
        "step_threshold          0.0",
        "summary_interval        4",  # a line of statistics in the log every 16 s
        f"uds_address             {socket}",
        f"[{interface}]",
    ]
    return "\n".join(lines) + "\n"


def _program(name: str) -> str:
    found = pmc.program(name)
    if found is None:
        raise Problem(f"{name} is not installed: sudo apt install linuxptp, or ./surg setup", 2)
    return found


def _interface(wanted: str | None) -> str:
    """The interface to use, checked.

    Raises:
        Problem: None or several to choose from, unknown, or down.
    """
    names = sorted(entry.name for entry in NETWORK.iterdir() if (entry / "operstate").exists())
    others = [name for name in names if name != "lo"]
    listed = ", ".join(f"{name} ({_state(name)})" for name in others) or "none"
    if wanted is None:
        live = [name for name in others if _state(name) == "up"]
        if len(live) != 1:
            raise Problem(
                f"which network? --interface IF names the one that joins the two machines:"
                f" {listed}",
                2,
            )
        wanted = live[0]
    if wanted not in others:
        hint = " (PTP does not run on loopback)" if wanted == "lo" else ""
        raise Problem(f"--interface {wanted}: no such interface{hint}; there are: {listed}", 2)
    if _state(wanted) == "down":
        raise Problem(f"--interface {wanted}: it is down: sudo ip link set {wanted} up", 2)
    return wanted


def _state(interface: str) -> str:
    """Whether the kernel calls it up, down or unknown."""
    try:
        return (NETWORK / interface / "operstate").read_text(encoding="ascii").strip()
    except OSError:
        return "gone"


def _check_permission(options: argparse.Namespace) -> None:
    """PTP's ports are below 1024, and setting the clock is root's."""
    if os.geteuid() == 0:
        return
    words = [options.role]
    words += ["--interface", options.interface] if options.interface else []
    words += ["--free-running"] if options.free_running else []
    raise Problem(
        "ptp needs root, for the ports 319 and 320 and for the clock:"
        f" sudo ./surg ptp {' '.join(words)}",
        2,
    )


def _check_rivals() -> None:
    """Refuse to steer a clock that another program steers.

    Raises:
        Problem: Names the programs and how to stop them.
    """
    found = set()
    for comm in Path("/proc").glob("[0-9]*/comm"):
        with contextlib.suppress(OSError):
            name = comm.read_text(encoding="utf-8", errors="replace").strip()
            if name in RIVALS and _same_network(comm.parent):
                found.add(name)
    if found:
        names = ", ".join(sorted(found))
        raise Problem(
            f"{names} steers this machine's clock already: stop it first (for the time service of"
            " Debian: sudo systemctl stop systemd-timesyncd), or measure with --free-running",
            2,
        )


def _same_network(process: Path) -> bool:
    """Whether a process is one of this machine, not of a container's or test's network."""
    try:
        return os.readlink(process / "ns" / "net") == os.readlink("/proc/self/ns/net")
    except OSError:
        return True


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        folder.chmod(0o755)
    except OSError as problem:
        raise Problem(f"--folder {folder}: {problem.strerror}", 2) from problem


def _announcement(role: str, interface: str, free_running: bool, file: Path) -> str:
    if role == "master":
        what = "tells its time to the network; its clock is left alone"
    elif free_running:
        what = "measures how far it is off the master; its clock is left alone"
    else:
        what = "SETS its clock to the master's: one step at the start, then steered"
    return f"ptp: this machine {what}\n  interface {interface}, configuration {file}\n  Ctrl-C ends"


def _watch(child: processes.Child, socket: Path, steers: bool) -> None:
    """Say how it goes until the daemon ends.

    Raises:
        Problem: The daemon has ended.
    """
    processes.wait_until(lambda: socket.exists() or child.exit_code is not None, START_TIMEOUT_S)
    _let_ask(socket)
    said, said_at = "", -math.inf
    while child.exit_code is None:
        line = describe(pmc.ask(socket))
        now = time.monotonic()
        if is_interactive():
            width = shutil.get_terminal_size().columns - 1
            sys.stderr.write("\r\033[K" + f"  {line}"[:width])
            sys.stderr.flush()
        elif line.split(",")[0] != said or now - said_at > QUIET_S:
            say(f"  {line}")
            said, said_at = line.split(",")[0], now
        processes.wait_until(lambda: child.exit_code is not None, LOOK_S)
    if steers:
        warn("ptp: the clock runs on by itself")
    raise Problem(f"ptp4l ended ({child.exit_code}); the end of {child.log}:\n{child.log_tail()}")


def describe(status: clock_sync.ClockStatus) -> str:
    """One line on a clock, for a person."""
    if status.port_state == clock_sync.MASTER and not status.problem:
        return f"master, clock {status.clock}"
    fault = status.fault()
    if math.isnan(status.offset):
        return fault
    words = fault or "in step"
    return (
        f"{words}, offset {status.offset * 1e6:+.1f} µs,"
        f" path delay {status.path_delay * 1e6:.1f} µs, master {status.grandmaster}"
    )


def _let_ask(socket: Path) -> None:
    """Let the user who called sudo ask the daemon: the monitor node need not be root."""
    with contextlib.suppress(KeyError, ValueError, OSError):
        os.chown(socket, int(os.environ["SUDO_UID"]), int(os.environ["SUDO_GID"]))
