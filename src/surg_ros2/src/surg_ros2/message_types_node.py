"""The message and service types that this workspace has built."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import roslib.message

from surg_ros2.bridged_topics import NotBridged
from surg_ros2.cdr import Codec

_BETWEEN = re.compile(r"^=+\nMSG: (\w+)/(\w+)\n", re.MULTILINE)
"""In a definition, before each type that it needs."""


def fields(kind: str) -> list[tuple[str, str]]:
    """Names and types of the fields of a message type."""
    return _fields(message_class("std_msgs/Header" if kind == "Header" else kind))


def _fields(made: Any) -> list[tuple[str, str]]:
    return list(zip(made.__slots__, made._slot_types, strict=True))


def codec(made: Any) -> Codec:
    """The codec of a class: of a message, or of one half of a service."""
    return Codec(made._type, lambda kind: _fields(made) if kind == made._type else fields(kind))


def packed(message: Any) -> bytes:
    """The bytes of a message in ROS 1."""
    file = io.BytesIO()
    message.serialize(file)
    return file.getvalue()


def message_class(kind: str) -> Any:
    """The class of a message type.

    Raises:
        NotBridged: It is not built.
    """
    return _built(kind, "message", roslib.message.get_message_class(kind))


def service_class(kind: str) -> Any:
    """The class of a service type.

    Raises:
        NotBridged: It is not built.
    """
    return _built(kind, "service", roslib.message.get_service_class(kind))


def _built(kind: str, what: str, found: Any) -> Any:
    if found is None:
        raise NotBridged(f"{kind}: no such {what} is built in this workspace")
    return found


def definition_files(kind: str, folder: Path) -> tuple[Path, list[Path]]:
    """Write a service's definition, and those that it needs, as files `PACKAGE/srv/NAME.srv`."""
    made = service_class(kind)
    halves, needed = [], {}
    for half in (made._request_class, made._response_class):
        own, *others = _BETWEEN.split(half._full_text)
        halves.append(own)
        for package, name, text in zip(others[::3], others[1::3], others[2::3], strict=True):
            needed[folder / package / "msg" / f"{name}.msg"] = text
    package, _, name = kind.partition("/")
    service = folder / package / "srv" / f"{name}.srv"
    for file, text in {**needed, service: "---\n".join(halves)}.items():
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, "utf-8")
    return service, list(needed)
