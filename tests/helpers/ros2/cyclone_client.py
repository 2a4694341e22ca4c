"""A process that asks a service as ROS 2's rmw_cyclonedds does.

`cyclone_client.py DOMAIN SERVICE TYPE HEX` sends the request again and again, each with a number of
its own behind eight bytes for itself, and prints `number reply` of each reply that is its own.
"""

from __future__ import annotations

import struct
import sys
import time

from surg_ros2.bridged_topics import Quality, dds_service
from surg_ros2.dds_port import LOOPBACK, Port

HEADER, ITSELF, PERIOD_S = b"\0\1\0\0", 0x1122334455667788, 0.2


def main(domain: str, service: str, kind: str, request: str) -> None:
    """Ask until the process is ended."""
    port = Port(int(domain), LOOPBACK)
    (asked, question), (told, answer) = dds_service(service, kind)
    reader = port.reader(told, answer, Quality())
    writer = port.writer(asked, question, Quality())
    due, number = 0.0, 0
    while True:
        if time.monotonic() >= due and writer.readers:
            due, number = time.monotonic() + PERIOD_S, number + 1
            writer.send(HEADER + struct.pack("<Qq", ITSELF, number) + bytes.fromhex(request))
        port.wait(PERIOD_S)
        for _, sample in reader.take():
            itself, answered = struct.unpack_from("<Qq", sample, len(HEADER))
            if itself == ITSELF:
                print(answered, sample[len(HEADER) + 16 :].hex(), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
