"""`./surg dev shell`: bash with the workspace sourced and the master's address set."""

from __future__ import annotations

import argparse
import os
import shlex

from surg_cli.graph import running
from surg_cli.host import environment, paths


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.add_argument("-c", dest="line", metavar="LINE", help="run one line and return")


def main(options: argparse.Namespace, command: str) -> int:
    """Replace this process by the shell."""
    systems = running.systems()
    port = systems[0].port if systems else None
    env = environment.for_nodes(port)
    if port is None and os.environ.get("SURG_CALLER_MASTER"):
        env["ROS_MASTER_URI"] = os.environ["SURG_CALLER_MASTER"]
    env.pop("SURG_CALLER_MASTER", None)
    env.pop("SURG_READY", None)
    if options.line is not None:
        os.execve("/bin/bash", ["/bin/bash", "-c", options.line], env)
    # The user's start-up file may put another Python first: set ours again after it.
    rc = paths.STATE / "shellrc"
    kept = ("PATH", "PYTHONPATH", "LD_LIBRARY_PATH", "ROS_MASTER_URI", "CMAKE_PREFIX_PATH")
    lines = ["[ -r ~/.bashrc ] && . ~/.bashrc"]
    lines += [f"export {name}={shlex.quote(env[name])}" for name in kept if name in env]
    lines += ["[ -r /usr/share/rosbash/rosbash ] && . /usr/share/rosbash/rosbash"]
    lines += [r'PS1="(surg) $PS1"']
    paths.write_text(rc, "\n".join(lines) + "\n")
    os.execve("/bin/bash", ["/bin/bash", "--rcfile", str(rc), "-i"], env)
