"""A policy in the place of the scripted expert: `./surg run TASK --policy ADDRESS|PATH.py`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from surg_cli.graph import follow, master, system
from surg_cli.graph.processes import Supervisor
from surg_cli.graph.system_plan import Policy, SystemPlan
from surg_cli.graph.watch import Watch
from surg_cli.host import paths
from surg_cli.host.terminal import CliError

CLIENT = "policy_client"
LAST_LINES = 5
"""Lines of a dead program that are shown."""
WORDLESS = "it printed nothing; ./surg policy new NAME writes one that connects"
"""What is said of a program that ends without a word."""
FAILED = "the policy failed: "
"""What a client's farewell says of an exception, before the exception."""
CLIENT_TIMEOUT_S = 120.0
"""[s] wall clock: longest time that a script may take to connect; its own libraries load first."""


class ProgramDied(CliError):
    """The policy's program has ended before it had connected."""


def read(given: str, keys: Path | None, privileged: bool, forces: bool = False) -> Policy:
    """A policy from the command line: an address to listen at, or the path of a client's script.

    Raises:
        CliError: It is neither, or must not be listened at; says what is allowed.
    """
    from surg_policy_bridge.server import listen_address
    from surg_policy_client.errors import BadKeys
    from surg_policy_client.keys import server_keys

    folder = "" if keys is None else str(keys.absolute())
    try:
        if keys is not None:
            server_keys(keys)
        if "://" in given:
            address = listen_address.check(given, keys is not None)
            return Policy(address, "", folder, privileged, forces)
    except (listen_address.BindError, BadKeys, OSError) as error:
        raise CliError(f"--policy {given}: {error}", 2) from error
    script = Path(given)
    if script.suffix == ".py" and not script.is_file():
        raise CliError(
            f"--policy {given}: no such file; ./surg policy new NAME writes one to begin with", 2
        )
    if script.suffix != ".py":
        raise CliError(
            f"--policy {given}: neither an address such as tcp://127.0.0.1:5555 nor the path of a "
            "client's .py file",
            2,
        )
    return Policy("", str(script.absolute()), folder, privileged, forces)


def connect(
    plan: SystemPlan,
    supervisor: Supervisor,
    watch: Watch,
    progress: Callable[[float | None, str], None],
) -> None:
    """Start the model server and the client, and wait until one has connected.

    Raises:
        ProgramDied: The client ends.
        CliError: The server ends, or the script does not connect in time.
    """
    policy = plan.policy
    assert policy is not None
    system.start(supervisor, system.model_server(plan))
    client = None
    if policy.script:
        argv = [str(paths.VENV_PYTHON), "-s", policy.script, "--server", policy.address]
        argv += ["--keys", policy.keys] if policy.keys else []
        # In real time the threads of its linear algebra, which wait busily, hold up the pictures.
        few = {} if plan.lockstep else {"OPENBLAS_NUM_THREADS": "1"}
        client = supervisor.start(CLIENT, argv, essential=False, extra_env=few)
    waited_for = f"a policy at {policy.address}"

    def missing() -> list[str]:
        if client is not None and client.exit_code is not None:
            raise ProgramDied(
                f"the policy's program ended ({client.exit_code}) before it had connected:\n"
                f"{client.log_tail(LAST_LINES) or WORDLESS}"
            )
        return [] if watch.policy.waiting else [waited_for]

    timeout_s = math.inf if client is None else CLIENT_TIMEOUT_S
    follow.wait_for(missing, supervisor, progress, timeout_s)


def crash(supervisor: Supervisor, watch: Watch) -> list[str]:
    """How the policy's program has died, with its last lines; empty: it has not."""
    for child in supervisor.children:
        if child.name == CLIENT:
            code = child.exit_code
            if code is None:
                return []
            how = f"was killed by signal {-code}" if code < 0 else f"ended ({code})"
            return [f"the policy's program {how}:\n{child.log_tail(LAST_LINES)}"]
    # One that was started elsewhere says so when it leaves.
    status = watch.policy
    failed = status.reason == status.REASON_POLICY_LEFT and FAILED in status.detail
    return [status.detail] if failed else []


def complaints(watch: Watch) -> list[str]:
    """Why a policy may have failed, in sentences."""
    status = watch.policy
    stopped = status.state in (status.STATE_IDLE, status.STATE_PAUSED)
    return [f"policy: {said}" for said in (stopped and status.detail, status.warning) if said]


def addressed(policy: Policy) -> Policy:
    """The policy of one episode: a script gets a port of its own."""
    if policy.address:
        return policy
    address = f"tcp://127.0.0.1:{master.free_port()}"
    return replace(policy, address=address)
