"""Command line shared by the example policies."""

from __future__ import annotations

import argparse
import signal
import sys
from typing import Any, Callable, Sequence

from surg_policy_client.errors import PolicyClientError
from surg_policy_client.serving import ADDRESS, serve

Arguments = Callable[[argparse.ArgumentParser], None]


def run(
    make: Callable[[argparse.Namespace], Any],
    description: str | None,
    add_arguments: Arguments = lambda parser: None,
    argv: Sequence[str] | None = None,
) -> int:
    """Parse the command line, make the policy from the options and serve it.

    Returns the exit status: 0, 1 after an error, 2 for invalid input.
    """
    lines = (description or "").strip().splitlines() or [""]
    parser = argparse.ArgumentParser(description=lines[0])
    add = parser.add_argument
    add(
        "--server",
        default=ADDRESS,
        metavar="ADDRESS",
        help=f"address of the server (default {ADDRESS})",
    )
    add("--keys", metavar="DIR", help="the policy's folder of ./surg policy keys")
    add("--episodes", type=int, metavar="N", help="end after N episodes (default: no end)")
    add("--timeout", type=float, metavar="S", help="longest wait for a server (default: no limit)")
    add("--seed", type=int, default=0, metavar="N", help="seed of random policies (default 0)")
    add_arguments(parser)
    options = parser.parse_args(argv)
    # A supervisor ends programs by SIGTERM: the server is to hear of it as of Ctrl-C.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        policy = make(options)
    except (PolicyClientError, ValueError, OSError) as error:
        return _refused(parser.prog, error)
    try:
        served = serve(
            policy,
            options.server,
            keys=options.keys,
            seed=options.seed,
            episodes=options.episodes,
            timeout_s=options.timeout,
            say=_say,
        )
    except PolicyClientError as error:  # the policy's own errors keep their traceback
        return _refused(parser.prog, error)
    _say(
        f"{served.observations} observations answered in {served.episodes} episodes, "
        f"{served.successes} with success; rows accepted {served.accepted}, clipped "
        f"{served.clipped}, late {served.late}, stale {served.stale}, refused {served.rejected}"
    )
    return 0


def _refused(program: str, error: Exception) -> int:
    """Say an error in one line; the exit status."""
    print(f"{program}: {error}", file=sys.stderr, flush=True)
    return 2 if isinstance(error, ValueError) else 1


def _say(text: str) -> None:
    print(text, flush=True)
