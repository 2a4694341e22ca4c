"""Finds the device that a layout is meant for, or says why there is none and what to do."""

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
"""Devices named in a message at most, ..."""
LACKS_SHOWN = 4
"""... and what each of them lacks."""


@dataclass
class _Looked:
    """What a search has seen: readable devices with what they lack, and what was not readable."""

    unfit: list[str]
    forbidden: list[str]
    broken: list[str]


def find(host: Host, layout: Layout, wanted: str = "") -> Device:
    """Opens the first device that a layout fits.

    Args:
        host: The machine.
        layout: What the device must have.
        wanted: Path of its node; empty: any that fits, lowest number first.

    Returns:
        The open device; grabbed where the layout says so.

    Raises:
        LeaderError: Nothing is plugged in, nothing fits, no permission, or somebody else has
            grabbed it; lists what is there.
    """
    nodes = host.nodes()
    if wanted:
        nodes = [wanted]
    if not nodes:
        raise LeaderError(
            "no input device is there (no /dev/input/event* on this machine)",
            layout.file,
            "plug it in; a container needs /dev/input from its host",
        )
    looked = _Looked([], [], [])
    for path in nodes:
        device = _open(host, path, looked)
        if device is None:
            continue
        problem = _misfit(layout, device, bool(wanted))
        if not problem:
            return _take(device, layout)
        looked.unfit.append(f"'{device.description.name}' ({path}) {problem}")
        device.close()
    raise _nothing_fits(layout, wanted, looked)


def _open(host: Host, path: str, looked: _Looked) -> Device | None:
    try:
        return host.open(path)
    except PermissionError:
        looked.forbidden.append(path)
    except OSError as error:
        looked.broken.append(f"{path}: {error.strerror or os.strerror(error.errno or 0)}")
    return None


def _misfit(layout: Layout, device: Device, named: bool) -> str:
    """Why a device does not fit; empty: it does. One that is named by its path need not match."""
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
                "end the program that holds it (a second leader, an input remapper)",
            ) from error
    return device


def _nothing_fits(layout: Layout, wanted: str, looked: _Looked) -> LeaderError:
    what = []
    if looked.unfit:
        listed = looked.unfit[:SHOWN]
        more = len(looked.unfit) - len(listed)
        what.append("; ".join(listed) + (f"; and {more} more" if more else ""))
    if looked.broken:
        what.append(", ".join(looked.broken[:SHOWN]))
    if looked.forbidden:
        what.append(f"no permission to read {', '.join(looked.forbidden[:SHOWN])}")
    if looked.forbidden:
        cure = PERMISSION_CURE
    elif looked.unfit:
        cure = (
            "plug in one that fits, or describe yours in a layout of its own"
            " (docs/guide/leaders.md); "
            "'evtest' shows what a device has"
        )
    else:
        cure = "check the path: 'ls -l /dev/input/by-id' lists what is there"
    head = f"{wanted} does not serve" if wanted else "no device fits"
    return LeaderError(f"{head}: {'; '.join(what)}", layout.file, cure)
