"""The one question of RTDE that every controller answers at any time: its version."""

from __future__ import annotations

import socket
import struct
import time

from surg_hardware.ur.rtde import PORT, Decoder, RtdeError, package

_GET_VERSION, _LAYOUT, _CHUNK = ord("v"), struct.Struct(">4I"), 4096


def round_trips(address: str, seconds: float, pause: float = 0.02) -> list[float]:
    """Times from a question to its answer [s], asked over and over; moves nothing.

    Raises:
        OSError: Nobody answers, or not within 1 s.
        RtdeError: The answer is not RTDE.
    """
    trips: list[float] = []
    end = time.monotonic() + seconds
    with _peer(address) as peer:
        while not trips or time.monotonic() < end:
            asked = time.monotonic()
            _version(peer)
            trips.append(time.monotonic() - asked)
            time.sleep(pause)
    return trips


def controller_version(address: str) -> tuple[int, ...]:
    """The version (major, minor, bugfix, build) of a controller; empty: RTDE does not answer."""
    try:
        with _peer(address) as peer:
            return _version(peer)
    except OSError:
        return ()


def _peer(address: str) -> socket.socket:
    peer = socket.create_connection((address, PORT), 1.0)
    peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return peer


def _version(peer: socket.socket) -> tuple[int, ...]:
    """Ask for the controller's version, the one question that is always answered."""
    peer.sendall(package(_GET_VERSION))
    decoder = Decoder()
    while True:
        data = peer.recv(_CHUNK)
        if not data:
            raise RtdeError("the robot has closed the connection")
        for letter, payload in decoder.add(data):
            if letter == _GET_VERSION and len(payload) == _LAYOUT.size:
                return _LAYOUT.unpack(payload)
            if letter == _GET_VERSION:
                raise RtdeError(f"{len(payload)} bytes for the controller's version")
