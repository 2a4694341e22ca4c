"""DDS as ROS 2 uses it: topics whose samples stay bytes, and who is there.

The only user of ``cyclonedds``. A topic is known by its name and the name of its type: as in ROS 2,
nothing compares definitions, so the receiver of a sample must check that it fits.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import socket
import struct
import types
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cyclonedds._clayer import ddspy_take, ddspy_write
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import (
    DDSException,
    InstanceState,
    Policy,
    Qos,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import uint8
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from surg_ros2 import enclave as security
from surg_ros2.bridged_topics import NAMES, Quality

LOOPBACK = "lo"
_CONFIG = """<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface name="{interface}" multicast="{multicast}"/></Interfaces>
<AllowMulticast>{allow}</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex></Discovery>
<Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>
</Domain></CycloneDDS>"""
"""1.15 is Fast DDS: Cyclone cannot read its descriptions of nested types, and would not match.

A number of its own (ParticipantIndex) is where a peer without multicast looks for this process. On
loopback only greetings are multicast: a peer that uses another interface of this machine would send
the rest to us there, where we do not listen.
"""
_ANY = SampleState.Any | ViewState.Any | InstanceState.Any
_CURE = (
    "DDS Security needs a libddsc with it (PyPI's has none), the plug-ins "
    f"{', '.join(f'lib{name}.so' for name in security.LIBRARIES.values())} on the loader's path, "
    "and files that fit one another (docs/guide/coming_from_ros2.md)"
)
_GATEWAY = b"surg_ros2="
"""With it begins the user data of a writer that a gateway has, only to be known by; its time of
start follows. A participant's own user data would do, but for strangers in a secured domain."""
_DISCOVERY = ("ros_discovery_info", "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_")
"""Topic on which ROS 2 tells the names of its nodes, and its type."""
_MOST = 100  # samples that are taken at a time


class PortError(RuntimeError):
    """DDS cannot be had; says why, and the cure."""


@dataclass(frozen=True)
class RemoteWriter:
    """A writer of another process; ``type`` is empty when it has gone."""

    handle: int  # as the samples name it
    process: str  # key of its participant: of the process, in ROS 2
    topic: str
    type: str


class Writer:
    """Sends the samples of a topic."""

    def __init__(self, writer: DataWriter) -> None:
        self._writer = writer

    @property
    def readers(self) -> int:
        """How many readers there are in other processes."""
        return int(self._writer.get_publication_matched_status().current_count)

    def send(self, sample: bytes) -> None:
        """Send a sample with its header; nobody waits for a slow reader."""
        ddspy_write(self._writer._ref, sample + bytes(-len(sample) % 4))


class Reader:
    """Receives the samples of a topic."""

    def __init__(self, reader: DataReader) -> None:
        self._reader = reader
        self.condition = ReadCondition(reader, _ANY)

    def take(self) -> Iterator[tuple[int, bytes]]:
        """The samples that have come: the writer's handle, and the bytes with the header."""
        taken = ddspy_take(self._reader._ref, _ANY, _MOST)
        for data, info in () if isinstance(taken, int) else taken:
            if info.valid_data:  # else it says that a writer has gone
                yield info.publication_handle, data


class Port:
    """This process in a domain of DDS.

    Args:
        domain: Its number, as `ROS_DOMAIN_ID`.
        interface: Name of the network interface; no other one is used.
        started: Time of start [ns], by which two gateways know which is the second; None: it is
            no gateway.
        enclave: Folder with the files of DDS Security; None: whoever reaches the interface is
            heard.

    Raises:
        PortError: There is no such interface, or DDS does not start.
    """

    def __init__(
        self,
        domain: int,
        interface: str,
        started: int | None = None,
        enclave: Path | None = None,
    ) -> None:
        known = [name for _, name in socket.if_nameindex()]
        if interface not in known:
            raise PortError(
                f"no network interface {interface!r}; there are {', '.join(known)}; without a name "
                f"--ros2 uses {LOOPBACK}, this machine alone"
            )
        here = interface == LOOPBACK
        multicast, allow = ("true", "spdp") if here else ("default", "default")
        try:
            config = _CONFIG.format(interface=interface, multicast=multicast, allow=allow)
            self._domain = Domain(domain, config)
            told = {} if enclave is None else security.properties(enclave)
            secrets = [Policy.Property(name, value) for name, value in told.items()]
            self._participant = DomainParticipant(domain, Qos(*secrets))
        except DDSException as error:
            raise PortError(
                f"DDS does not start in domain {domain} on {interface}: {error.msg}; "
                + ("ROS_DOMAIN_ID and --ros2 INTERFACE choose others" if enclave is None else _CURE)
            ) from error
        if interface == LOOPBACK:
            hold_to(interface)
        self._key = str(self._participant.guid)
        self._kinds: dict[str, type] = {}
        self._waiting = WaitSet(self._participant)
        self._writers = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        self._seen: dict[int, RemoteWriter] = {}
        self._changed: list[RemoteWriter] = []
        self._earlier: set[int] = set()  # handles of other gateways' writers
        self._told: dict[str, list[str]] = {}
        self._names = self.reader(*_DISCOVERY, NAMES)
        self._note = b""
        if started is not None:
            self._note = _GATEWAY + b"%020d" % started
            noted = Qos(Policy.Userdata(self._note), base=_qos(NAMES))
            self._mark = DataWriter(self._participant, self._topic(*_DISCOVERY), noted)

    def writer(self, topic: str, kind: str, quality: Quality) -> Writer:
        """Offer a topic; names as on DDS."""
        made = self._topic(topic, kind)
        with _allowed(topic):
            return Writer(DataWriter(self._participant, made, _qos(quality)))

    def reader(self, topic: str, kind: str, quality: Quality) -> Reader:
        """Subscribe to a topic; names as on DDS."""
        of = self._topic(topic, kind)
        with _allowed(topic):
            made = Reader(DataReader(self._participant, of, _qos(quality)))
        self._waiting.attach(made.condition)
        return made

    def wait(self, seconds: float) -> None:
        """Wait until a reader has samples."""
        self._waiting.wait(duration(seconds=seconds))

    def first_gateway(self) -> bool:
        """Whether no other gateway of this domain has started before this one."""
        self._hear()
        return not self._earlier

    def changes(self) -> list[RemoteWriter]:
        """Writers of other processes that have come or gone since the last call."""
        self._hear()
        changed, self._changed = self._changed, []
        return changed

    def _hear(self) -> None:
        for end in self._writers.take(_MOST):
            handle, process = end.sample_info.instance_handle, str(end.participant_key)
            if process == self._key:
                continue
            if end.sample_info.instance_state == InstanceState.Alive:
                new = RemoteWriter(handle, process, end.topic_name, end.type_name)
                self._seen[handle] = new
                self._changed.append(new)
                note = end.qos[Policy.Userdata].data if Policy.Userdata in end.qos else b""
                if note.startswith(_GATEWAY) and note < self._note:
                    self._earlier.add(handle)
            elif (old := self._seen.pop(handle, None)) is not None:
                self._changed.append(dataclasses.replace(old, type=""))
                self._earlier.discard(handle)

    def node_names(self) -> dict[str, list[str]]:
        """Full name of the first node of each ROS 2 process; call `changes` before."""
        for handle, sample in self._names.take():
            if handle in self._seen and (name := first_node(sample)):
                self._told[self._seen[handle].process] = [name]
        there = {writer.process for writer in self._seen.values()}
        self._told = {each: names for each, names in self._told.items() if each in there}
        return self._told

    def _topic(self, name: str, kind: str) -> Topic:
        if kind not in self._kinds:
            self._kinds[kind] = _opaque(kind)
        with _allowed(f"{name} of type {kind}"):
            return Topic(self._participant, name, self._kinds[kind])


@contextlib.contextmanager
def _allowed(topic: str) -> Iterator[None]:
    """Make something of DDS for a topic.

    Raises:
        PortError: DDS does not; in a secured domain because the enclave may not.
    """
    try:
        yield
    except DDSException as error:
        raise PortError(
            f"DDS does not make {topic}: {error}; in a secured domain permissions.p7s must allow it"
        ) from error


def hold_to(interface: str) -> None:
    """Let this process's UDP sockets hear and use one network interface only.

    Raises:
        PortError: The system does not allow it.
    """
    for entry in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError), socket.socket(fileno=os.dup(int(entry))) as each:
            if each.type == socket.SOCK_DGRAM and each.family == socket.AF_INET:
                try:
                    each.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, interface.encode())
                except PermissionError as error:
                    raise PortError(
                        f"this system does not let DDS be held to the interface {interface} (Linux "
                        "5.7 does): name another, --ros2 INTERFACE"
                    ) from error


def first_node(sample: bytes) -> str:
    """The first node in a process's list of its nodes; empty: it has none, or says it otherwise."""
    try:
        (count,) = struct.unpack_from("<I", sample, 20)  # behind header and id of the process
        if not count:
            return ""
        (length,) = struct.unpack_from("<I", sample, 24)
        space = sample[28 : 28 + length - 1].decode()
        at = 28 + length + -length % 4
        (length,) = struct.unpack_from("<I", sample, at)
        return f"{space.rstrip('/')}/{sample[at + 4 : at + 3 + length].decode()}"
    except (struct.error, UnicodeDecodeError):
        return ""


def _opaque(kind: str) -> type:
    """A type of this name for ``cyclonedds``; its samples are never interpreted."""
    made = types.new_class(
        "Opaque",
        (IdlStruct,),
        {"typename": kind.replace("::", ".")},
        lambda namespace: namespace["__annotations__"].update(byte=uint8),
    )
    return dataclasses.dataclass(made)


def _qos(quality: Quality) -> Qos:
    reliability = Policy.Reliability
    durability = Policy.Durability
    return Qos(
        reliability.Reliable(0) if quality.reliable else reliability.BestEffort,
        durability.TransientLocal if quality.latched else durability.Volatile,
        Policy.History.KeepLast(quality.depth),
        Policy.IgnoreLocal.Participant,
    )
