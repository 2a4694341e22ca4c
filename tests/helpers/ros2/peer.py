"""A process that speaks DDS as a ROS 2 node does.

`peer.py DOMAIN NODE TOPIC TYPE PERIOD HEX LISTEN…` sends one sample on TOPIC again and again (none
without HEX), and prints each sample that it hears on LISTEN: `topic=type`, with `!` behind the name
of a latched one, `?` behind one of which some may be lost. In the environment: PEER_INTERFACE of
the network (loopback without it); PEER_ENCLAVE, a folder with files of DDS Security; PEER_KILLED,
as many processes do so one after another, each until it is killed.
"""

from __future__ import annotations

import os
import random
import signal
import struct
import sys
import time
import uuid
from pathlib import Path

from surg_ros2.bridged_topics import NAMES, Quality, dds_topic, dds_type
from surg_ros2.dds_port import LOOPBACK, Port

DEPTH = 100
LIVES_S = (0.3, 0.8)
"""[s] Shortest and longest life of a process that is killed."""


def nodes(key: str, name: str) -> bytes:
    """What a ROS 2 process tells about its one node."""
    text = name.encode() + b"\0"
    head = b"\0\1\0\0" + uuid.UUID(key).bytes + struct.pack("<II", 1, 2) + b"/\0\0\0"
    return head + struct.pack("<I", len(text)) + text + bytes(-len(text) % 4 + 8)


def one_after_another(count: int) -> None:
    """Returns in each of the processes; ends in this one when all have been killed."""
    for k in range(count):
        process = os.fork()
        if process == 0:
            return
        time.sleep(random.Random(k).uniform(*LIVES_S))
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
        print("killed", flush=True)
    sys.exit(0)


def main(domain: str, node: str, topic: str, kind: str, period: str, data: str, *hear: str) -> None:
    """Send and hear until the process is ended."""
    if killed := os.environ.get("PEER_KILLED"):
        one_after_another(int(killed))
    enclave = os.environ.get("PEER_ENCLAVE")
    interface = os.environ.get("PEER_INTERFACE", LOOPBACK)
    port = Port(int(domain), interface, enclave=enclave and Path(enclave))
    names = port.writer(
        "ros_discovery_info", "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_", NAMES
    )
    if node:
        names.send(nodes(port._key, node))
    writer = port.writer(dds_topic(topic), dds_type(kind), Quality())
    readers = {}
    for each in hear:
        name, _, of = each.partition("=")
        quality = Quality(not name.endswith("?"), name.endswith("!"), DEPTH)
        name = name.rstrip("!?")
        readers[name] = port.reader(dds_topic(name), dds_type(of), quality)
    print("ready", flush=True)
    due = 0.0
    while True:
        if data and time.monotonic() >= due and writer.readers:
            due = time.monotonic() + float(period)
            writer.send(bytes.fromhex(data))
        port.wait(float(period) / 4)
        for name, reader in readers.items():
            for _, sample in reader.take():
                print(name, sample.hex(), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
