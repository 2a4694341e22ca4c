"""Finds the device for a layout, or states why there is none and what to do."""

from __future__ import annotations

import os
from dataclasses import dataclass

from surg_teleop.leaders.evdev.device_host import Device, Host
from surg_teleop.leaders.evdev.device_layout import Layout
from surg_teleop.leaders.leader import LeaderError

PERMISSION_CURE = (
    "'sudo usermod -aG input $USER' and a new login, or the udev rule in docs/guide/leaders.md,"
    " allows it"
)
SHOWN = 12
"""Most devices named in a message."""
LACKS_SHOWN = 4
"""Most missing parts named per device."""


@dataclass
class _Candidates:
    """Rejected devices: unfit, without permission, or unreadable."""

    unfit: list[str]
    forbidden: list[str]
    broken: list[str]


def find(host: Host, layout: Layout, wanted: str = "") -> Device:
    """Open the first device that fits a layout, or that of a path; grab it if required.

    Raises:
        LeaderError: No device is connected or fits, there is no permission, or another process has
            grabbed it; lists the candidates.
    """
    nodes = [wanted] if wanted else host.nodes()
    if not nodes:
        raise LeaderError(
            "no input device found (no /dev/input/event* on this machine)",
            layout.file,
            "plug it in; a container needs /dev/input from its host",
        )
    candidates = _Candidates([], [], [])
    for path in nodes:
        device = _open(host, path, candidates)
        if device is None:
            continue
        problem = _misfit(layout, device, bool(wanted))
        if not problem:
            return _take(device, layout)
        candidates.unfit.append(f"'{device.description.name}' ({path}) {problem}")
        device.close()
    raise _nothing_fits(layout, wanted, candidates)


def _open(host: Host, path: str, candidates: _Candidates) -> Device | None:
    try:
        return host.open(path)
    except PermissionError:
        candidates.forbidden.append(path)
    except OSError as error:
        candidates.broken.append(f"{path}: {error.strerror or os.strerror(error.errno or 0)}")
    return None


def _misfit(layout: Layout, device: Device, named: bool) -> str:
    """Why a device does not fit; empty: it does. One given by its path may have any name."""
    description = device.description
    if not named and layout.match.lower() not in description.name.lower():
        return f"is not called '{layout.match}'"
    lacks = layout.lacks(description)
    if not lacks:
        return ""
    if len(lacks) == len(layout.axes) + len(layout.buttons):
        return "has none of what is needed"
    more = f" and {len(lacks) - LACKS_SHOWN} more" if len(lacks) > LACKS_SHOWN else ""
    return f"has no {', '.join(lacks[:LACKS_SHOWN])}{more}"


def _take(device: Device, layout: Layout) -> Device:
    if layout.grab:
        try:
            device.grab()
        except OSError as error:
            name = f"'{device.description.name}' ({device.description.path})"
            device.close()
            raise LeaderError(
                f"cannot be grabbed: {error.strerror}",
                name,
                "stop the program that holds it (a second leader, an input remapper)",
            ) from error
    return device


def _nothing_fits(layout: Layout, wanted: str, candidates: _Candidates) -> LeaderError:
    what = []
    if candidates.unfit:
        listed = candidates.unfit[:SHOWN]
        more = len(candidates.unfit) - len(listed)
        what.append("; ".join(listed) + (f"; and {more} more" if more else ""))
    if candidates.broken:
        what.append(", ".join(candidates.broken[:SHOWN]))
    if candidates.forbidden:
        what.append(f"no permission to read {', '.join(candidates.forbidden[:SHOWN])}")
    if candidates.forbidden:
        cure = PERMISSION_CURE
    elif candidates.unfit:
        cure = (
            "connect one that fits, or write a layout for yours (docs/guide/leaders.md); 'evtest' "
            "shows what a device has"
        )
    else:
        cure = "check the path: 'ls -l /dev/input/by-id' lists what is there"
    head = f"{wanted} does not fit" if wanted else "no device fits"
    return LeaderError(f"{head}: {'; '.join(what)}", layout.file, cure)
