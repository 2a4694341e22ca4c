"""DDS Security as ROS 2 has it: the files of an enclave, and what DDS is told of them.

No ROS, no DDS. Never half: what asks for security gets all of it, or an error.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

_FILES = {
    "auth.identity_ca": "identity_ca.cert.pem",
    "auth.identity_certificate": "cert.pem",
    "auth.private_key": "key.pem",
    "access.permissions_ca": "permissions_ca.cert.pem",
    "access.governance": "governance.p7s",
    "access.permissions": "permissions.p7s",
}
"""Property of a DDS participant -> its file in an enclave."""
_PLUGINS = {"auth": "authentication", "access": "access_control", "crypto": "crypto"}
"""Part of DDS Security -> the word in its functions' names."""
LIBRARIES = {
    "auth": "dds_security_auth",
    "access": "dds_security_ac",
    "crypto": "dds_security_crypto",
}
"""Part of DDS Security -> its plug-in, as the loader looks for it between `lib` and `.so`."""


def folder(env: Mapping[str, str]) -> Path | None:
    """The enclave that the environment names; None: it asks for no security.

    Raises:
        ValueError: The keystore is not named, or a file is missing; says which.
    """
    if env.get("ROS_SECURITY_ENABLE", "").lower() != "true":
        return None
    keystore = env.get("ROS_SECURITY_KEYSTORE")
    if not keystore:
        raise ValueError(
            "ROS_SECURITY_ENABLE=true: ROS_SECURITY_KEYSTORE must name the folder that "
            "`ros2 security create_keystore` made"
        )
    found = Path(keystore, "enclaves", env.get("ROS_SECURITY_ENCLAVE_OVERRIDE", "").strip("/"))
    check(found)
    return found.absolute()


def check(enclave: Path) -> None:
    """Refuse an enclave that is not complete.

    Raises:
        ValueError: A file is missing; names it.
    """
    for name in _FILES.values():
        if not (enclave / name).is_file():
            raise ValueError(
                f"{enclave / name}: no such file; `ros2 security create_enclave KEYSTORE /NAME` "
                "makes an enclave, ROS_SECURITY_ENCLAVE_OVERRIDE=/NAME names it"
            )


def properties(enclave: Path) -> dict[str, str]:
    """What a participant of DDS is told, by name; the enclave is complete."""
    told = {f"dds.sec.{key}": f"file:{enclave / name}" for key, name in _FILES.items()}
    for part, word in _PLUGINS.items():
        told[f"dds.sec.{part}.library.path"] = LIBRARIES[part]
        told[f"dds.sec.{part}.library.init"] = f"init_{word}"
        told[f"dds.sec.{part}.library.finalize"] = f"finalize_{word}"
    return told
