"""`./surg ptp master|slave`: synchronises the clocks of two machines with linuxptp's `ptp4l`.

The controller's machine is the master: it sends its time and does not change its clock. A slave
sets its own clock. The daemon runs until Ctrl-C, with a status line.
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
from surg_cli.host.terminal import CliError, is_interactive, say, warn

# Runs as root, also where nothing has been built: import from the source tree.
sys.path.append(str(paths.ROOT / "src" / "surg_recording" / "src"))

from surg_recording.clock import clock_sync, pmc

FOLDER = Path(clock_sync.SOCKET).parent
"""For configuration, socket and log."""
NETWORK = Path("/sys/class/net")
START_TIMEOUT_S = 10.0
LOOK_S = 1.0
QUIET_S = 10.0
# Programs that steer the same clock.
RIVALS = ("chronyd", "ntpd", "systemd-timesyn", "openntpd", "ptp4l", "phc2sys")


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.description = (
        "Synchronise the clocks of two machines by PTP (linuxptp, software stamps). The machine of"
        " the controllers is the master; its clock is not changed. The clock of a slave is SET to"
        " the master's: one step at the start, then steering. Start it before you record, on the"
        " interface of the isolated network. Ctrl-C ends it. More: docs/guide/clock_sync.md"
    )
    parser.add_argument("role", choices=("master", "slave"), help="role of this machine")
    parser.add_argument("interface", nargs="?", metavar="INTERFACE", help="such as enp3s0")
    parser.add_argument(
        "--free-running",
        action="store_true",
        help="slave: measure the offset without setting the clock",
    )


def main(options: argparse.Namespace, command: str) -> int:
    """Check, write the configuration, run the daemon until Ctrl-C."""
    if options.role == "master" and options.free_running:
        raise CliError("--free-running is for a slave; a master's clock is never changed", 2)
    daemon = _program("ptp4l")
    _program("pmc")
    interface = _interface(options.interface)
    _check_permission(options)
    steers = options.role == "slave" and not options.free_running
    if steers:
        _check_rivals()
    folder = FOLDER
    socket = folder / "ptp4l"
    if socket.exists() and not pmc.ask(socket).problem:
        raise CliError(f"a PTP daemon runs already and answers at {socket}; end it first")
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
        say("ptp: ended; the clock runs on freely")
        return 0
    finally:
        for left in (socket, folder / "ptp4lro", file):
            left.unlink(missing_ok=True)
    return 1


def configuration(role: str, interface: str, socket: Path, free_running: bool) -> str:
    """The text of ptp4l's configuration file; ``socket`` is the daemon's control socket."""
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
        "logSyncInterval         -2",  # four times a second, so that the median settles quickly
        "logMinDelayReqInterval  -2",
        f"free_running            {int(free_running)}",
        # A slave steps once, at the start; a later step would break recordings.
        "first_step_threshold    0.00002",
        "step_threshold          0.0",
        "summary_interval        4",  # a line of statistics in the log every 16 s
        f"uds_address             {socket}",
        f"[{interface}]",
    ]
    return "\n".join(lines) + "\n"


def _program(name: str) -> str:
    path = pmc.program(name)
    if path is None:
        raise CliError(
            f"{name} is not installed: sudo apt install linuxptp, or ./surg dev setup", 2
        )
    return path


def _interface(wanted: str | None) -> str:
    """The interface to use: named, or the only one that is up; not loopback, and not down."""
    names = sorted(entry.name for entry in NETWORK.iterdir() if (entry / "operstate").exists())
    others = [name for name in names if name != "lo"]
    listed = ", ".join(f"{name} ({_state(name)})" for name in others) or "none"
    if wanted is None:
        live = [name for name in others if _state(name) == "up"]
        if len(live) != 1:
            raise CliError(
                f"INTERFACE is missing: name the one that connects the two machines: {listed}",
                2,
            )
        wanted = live[0]
    if wanted not in others:
        hint = " (PTP does not run on loopback)" if wanted == "lo" else ""
        raise CliError(f"{wanted}: no such interface{hint}; available: {listed}", 2)
    if _state(wanted) == "down":
        raise CliError(f"{wanted}: it is down: sudo ip link set {wanted} up", 2)
    return wanted


def _state(interface: str) -> str:
    """State of an interface: up, down or unknown."""
    try:
        return (NETWORK / interface / "operstate").read_text(encoding="ascii").strip()
    except OSError:
        return "gone"


def _check_permission(options: argparse.Namespace) -> None:
    """PTP needs root, for its ports and to set the clock."""
    if os.geteuid() == 0:
        return
    words = [options.role]
    words += [options.interface] if options.interface else []
    words += ["--free-running"] if options.free_running else []
    raise CliError(
        "ptp needs root, for the ports 319 and 320 and for the clock:"
        f" sudo ./surg ptp {' '.join(words)}",
        2,
    )


def _check_rivals() -> None:
    """Check that no other program steers the clock."""
    rivals = set()
    for comm in Path("/proc").glob("[0-9]*/comm"):
        with contextlib.suppress(OSError):
            name = comm.read_text(encoding="utf-8", errors="replace").strip()
            if name in RIVALS and _same_network(comm.parent):
                rivals.add(name)
    if rivals:
        names = ", ".join(sorted(rivals))
        raise CliError(
            f"{names} already steers this machine's clock: stop it first (Debian's time service:"
            " sudo systemctl stop systemd-timesyncd), or measure with --free-running",
            2,
        )


def _same_network(process: Path) -> bool:
    """Whether a process is in this network namespace, not in that of a container or a test."""
    try:
        return os.readlink(process / "ns" / "net") == os.readlink("/proc/self/ns/net")
    except OSError:
        return True


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        folder.chmod(0o755)
    except OSError as problem:
        raise CliError(f"{folder}: {problem.strerror}", 2) from problem


def _announcement(role: str, interface: str, free_running: bool, file: Path) -> str:
    if role == "master":
        what = "sends its time to the network; its clock is not changed"
    elif free_running:
        what = "measures its offset from the master; its clock is not changed"
    else:
        what = "SETS its clock to the master's: one step at the start, then steering"
    return f"ptp: this machine {what}\n  interface {interface}, configuration {file}\n  Ctrl-C ends"


def _watch(child: processes.Child, socket: Path, steers: bool) -> None:
    """Print the status until the daemon ends, which is a CliError."""
    processes.wait_until(lambda: socket.exists() or child.exit_code is not None, START_TIMEOUT_S)
    _share_socket(socket)
    printed, printed_at = "", -math.inf
    while child.exit_code is None:
        line = describe(pmc.ask(socket))
        now = time.monotonic()
        if is_interactive():
            width = shutil.get_terminal_size().columns - 1
            sys.stderr.write("\r\033[K" + f"  {line}"[:width])
            sys.stderr.flush()
        elif line.split(",")[0] != printed or now - printed_at > QUIET_S:
            say(f"  {line}")
            printed, printed_at = line.split(",")[0], now
        processes.wait_until(lambda: child.exit_code is not None, LOOK_S)
    if steers:
        warn("ptp: the clock runs on freely")
    raise CliError(f"ptp4l ended ({child.exit_code}); the end of {child.log}:\n{child.log_tail()}")


def describe(status: clock_sync.ClockStatus) -> str:
    """One line on the state of a clock."""
    if status.port_state == clock_sync.MASTER and not status.problem:
        return f"master, clock {status.clock}"
    fault = status.fault()
    if math.isnan(status.offset):
        return fault
    words = fault or "synchronised"
    return (
        f"{words}, offset {status.offset * 1e6:+.1f} µs,"
        f" path delay {status.path_delay * 1e6:.1f} µs, master {status.grandmaster}"
    )


def _share_socket(socket: Path) -> None:
    """Give the user of sudo access to the daemon: the monitor node does not run as root."""
    with contextlib.suppress(KeyError, ValueError, OSError):
        os.chown(socket, int(os.environ["SUDO_UID"]), int(os.environ["SUDO_GID"]))
