"""Finds an exporter: by name, entry point, or file.

An entry point in the group ``surg_recording.exporters`` names a class:
``my_format = my_package.my_format:MyExporter``; see docs/guide/adding_an_exporter.md.
"""

from __future__ import annotations

from typing import Any

from surg_core.plugins import PluginError, PluginKind
from surg_recording.datasets.export_report import ExportError

_BUNDLED = {
    "lerobot": "lerobot_v21",
    "lerobot_v21": "lerobot_v21",
    "lerobot_v30": "lerobot_v30",
    "robomimic": "robomimic",
    "act": "act",
    "diffusion_policy": "diffusion_policy",
}
"""Name on the command line → module of the bundled formats; ``lerobot`` is the default version."""
_WITH_ROS = ("mcap", "rosbag", "rosbag2", "rosbag2_sqlite3")
"""Formats of ROS messages, each in a module of its name."""
_KIND = PluginKind(
    noun="exporter",
    group="surg_recording.exporters",
    bundled={
        **{name: f"surg_recording.datasets.formats.{module}" for name, module in _BUNDLED.items()},
        **{name: f"surg_recording.nodes.{name}_exporter_node" for name in _WITH_ROS},
    },
    accepts=lambda kind: all(hasattr(kind, part) for part in ("name", "write", "validate")),
    shape="one class with name, write and validate (see surg_recording.datasets.Exporter)",
)


def names() -> tuple[str, ...]:
    """Names that ``load`` knows: the bundled formats, then those of installed packages."""
    return _KIND.names()


def load(name_or_path: str) -> Any:
    """A new exporter by name or ``.py`` file; an ExportError lists those that exist.

    A file is executed: load none that you would not run. The exporter has ``name``, ``write`` and
    ``validate``; the bundled ones are ``Exporter``.
    """
    try:
        return _KIND.find(name_or_path)()
    except PluginError as error:
        raise ExportError(str(error)) from error
