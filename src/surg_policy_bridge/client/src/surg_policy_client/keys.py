"""CURVE keys: which policies may connect to a model server, and which server they trust.

A folder made by `make` has a part for each machine::

    DIR/server/server.key_secret    stays with the model server
    DIR/server/server.key
    DIR/server/clients/NAME.key     policies that may connect
    DIR/NAME/NAME.key_secret        goes to the policy's machine, with
    DIR/NAME/server.key             public key of the server

Files are ZeroMQ certificates. Secret ones must be readable by their owner only (0600). Nothing is
ever overwritten.
"""

from __future__ import annotations

import os
import re
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Union

from zmq.auth import certs

from surg_policy_client.errors import BadKeys

SERVER = "server"
POLICY = "policy"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
_KEY = re.compile(rb"[ -~]{40}")
Folder = Union[str, "os.PathLike[str]"]


@dataclass(frozen=True)
class ClientKeys:
    """Keys of a policy and the public key of the server that it trusts (Z85, 40 bytes each)."""

    public: bytes
    secret: bytes = field(repr=False)
    server: bytes


@dataclass(frozen=True)
class ServerKeys:
    """Keys of a server, and public keys of the allowed policies by name (Z85, 40 bytes each)."""

    public: bytes
    secret: bytes = field(repr=False)
    clients: dict[str, bytes]


def make(folder: Folder, policy: str = POLICY) -> list[Path]:
    """Make key pairs of a server and a policy; of the policy only, if the server has one.

    Makes the folder. ``policy`` names the policy's machine or user. Returns the files made.

    Raises:
        BadKeys: The policy has keys already, one of the server's keys is missing, or the name is
            invalid.
    """
    root = Path(folder)
    if not _NAME.fullmatch(policy) or policy == SERVER:
        raise BadKeys(f"name {policy!r}; allowed: letters, digits, - and _, and not {SERVER!r}")
    server, mine = root / SERVER, root / policy
    if mine.exists() or (server / "clients" / f"{policy}.key").exists():
        raise BadKeys(
            f"{mine} has keys already, and nothing is overwritten; "
            "choose another name, or move that folder away"
        )
    present = [(server / name).exists() for name in ("server.key", "server.key_secret")]
    if any(present) and not all(present):
        raise BadKeys(f"{server} lacks one of the server's two keys; move that folder away")
    for place in (root, server, server / "clients", mine):
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
    made = [] if all(present) else _create(server, SERVER)
    public, secret = _create(mine, policy)
    made += [_place(public, server / "clients" / public.name), secret]
    public.unlink()  # only the server needs it
    _read(server / "server.key")
    trusted = mine / "server.key"
    trusted.write_bytes((server / "server.key").read_bytes())
    trusted.chmod(0o644)  # whatever the umask is
    return [*made, trusted]


def client_keys(folder: Folder) -> ClientKeys:
    """Keys of a policy, from its own part of the folder or the whole one.

    Raises:
        BadKeys: Names the file and what to do.
    """
    root = Path(folder)
    if not (root / "server.key").is_file() and (root / POLICY / "server.key").is_file():
        root = root / POLICY
    secrets = sorted(root.glob("*.key_secret"))
    if len(secrets) != 1 or secrets[0].name == "server.key_secret":
        raise BadKeys(
            f"{root} has {[path.name for path in secrets]}; exactly one policy's *.key_secret is "
            "needed; `./surg policy keys` makes one"
        )
    public, secret = _read_secret(secrets[0])
    return ClientKeys(public, secret, _read(root / "server.key")[0])


def server_keys(folder: Folder) -> ServerKeys:
    """Keys of a server with its allow-list, from its own part of the folder or the whole one.

    Raises:
        BadKeys: Names the file and what to do; also if no policy may connect.
    """
    root = Path(folder)
    if not (root / "server.key_secret").is_file() and (root / SERVER).is_dir():
        root = root / SERVER
    public, secret = _read_secret(root / "server.key_secret")
    clients = {path.stem: _read(path)[0] for path in sorted((root / "clients").glob("*.key"))}
    if not clients:
        raise BadKeys(
            f"{root / 'clients'} has no *.key, so no policy could connect; `./surg policy keys` "
            "makes one"
        )
    return ServerKeys(public, secret, clients)


def _create(folder: Path, name: str) -> list[Path]:
    """New key pair; returns the files of the public and of the secret key."""
    with tempfile.TemporaryDirectory(dir=folder) as private:
        public, secret = (Path(file) for file in certs.create_certificates(private, name))
        public.chmod(0o644)
        secret.chmod(0o600)
        return [_place(made, folder / made.name) for made in (public, secret)]


def _place(made: Path, to: Path) -> Path:
    """Give a file a second name; fails if there is a file of that name."""
    try:
        os.link(made, to)
    except FileExistsError:
        raise BadKeys(f"{to} exists already, and nothing is overwritten") from None
    return to


def _read(path: Path) -> tuple[bytes, bytes | None]:
    """Public and secret key of a certificate."""
    try:
        public, secret = certs.load_certificate(path)
    except OSError as error:
        raise BadKeys(f"{path}: {error}; `./surg policy keys` makes keys") from None
    except ValueError:  # without a public key
        public, secret = b"", None
    if not _KEY.fullmatch(public):
        raise BadKeys(f"{path}: no public-key of 40 characters; `./surg policy keys` makes keys")
    return public, secret


def _read_secret(path: Path) -> tuple[bytes, bytes]:
    public, secret = _read(path)
    if os.name == "posix" and path.stat().st_mode & 0o077:
        raise BadKeys(f"{path} can be read by others; run chmod 600 {path}")
    if secret is None or not _KEY.fullmatch(secret):
        raise BadKeys(f"{path}: no secret-key of 40 characters; `./surg policy keys` makes keys")
    return public, secret
