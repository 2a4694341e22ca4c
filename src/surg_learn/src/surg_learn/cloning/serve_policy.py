"""The command line of a policy: it connects to the platform and answers until Ctrl-C."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from surg_learn.cloning.chunk_policy import ChunkPolicy

WEIGHTS = "SURG_WEIGHTS"
"""Environment variable with the path of the weights, if the command line has none."""


def wanted(policy: ChunkPolicy) -> Any:
    """What the server has to serve, as a `surg_policy_client.Spec`; else it refuses the policy."""
    from surg_policy_client.action_spec import ActionSpec
    from surg_policy_client.spec import Feature, Spec

    features = {
        key: Feature(
            names=tuple(policy.names[key]) if key in policy.names else None,
            shape=policy.shape_of(key),
        )
        for key in policy.wants
    }
    return Spec(observation=features, action=ActionSpec.of_space("absolute", [policy.arm]))


def serve(kind: type[ChunkPolicy], about: str, words: Sequence[str] | None = None) -> int:
    """Command line of a policy: connect and answer until Ctrl-C.

    Args:
        kind: Class of the policy.
        about: One line of help.
        words: Of the command line.

    Returns:
        Exit status: 0 after Ctrl-C, 1 for a server that does not fit, 2 for wrong input.
    """
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--server", default="tcp://127.0.0.1:5555", help="address of the platform")
    parser.add_argument(
        "--weights",
        type=Path,
        default=os.environ.get(WEIGHTS),
        help=f"file of {kind.trainer} (default: environment variable {WEIGHTS})",
    )
    parser.add_argument("--keys", type=Path, help="folder of keys, if the server requires keys")
    options = parser.parse_args(words)
    if options.weights is None:
        parser.error(f"--weights FILE or {WEIGHTS} is required; {kind.trainer} writes the file")
    import surg_policy_client

    try:
        policy = kind.load(Path(options.weights))
    except (OSError, ValueError) as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 2
    try:
        wants = wanted(policy)
        surg_policy_client.serve(policy, options.server, wants=wants, keys=options.keys)
    except surg_policy_client.PolicyClientError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 1
    return 0
