"""Keystores as `ros2 security` makes them, by openssl: an authority, and enclaves that it signs."""

from __future__ import annotations

import subprocess
from pathlib import Path

AUTHORITY, KEY = "ca.cert.pem", "ca.key.pem"
DAYS = "2"
_CURVE = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")
_XML = '<?xml version="1.0" encoding="utf-8"?>\n<dds>{}</dds>\n'
_DOMAINS = "<domains><id_range><min>0</min><max>230</max></id_range></domains>"
_GOVERNANCE = f"""<domain_access_rules><domain_rule>{_DOMAINS}
<allow_unauthenticated_participants>false</allow_unauthenticated_participants>
<enable_join_access_control>true</enable_join_access_control>
<discovery_protection_kind>ENCRYPT</discovery_protection_kind>
<liveliness_protection_kind>ENCRYPT</liveliness_protection_kind>
<rtps_protection_kind>SIGN</rtps_protection_kind>
<topic_access_rules><topic_rule><topic_expression>*</topic_expression>
<enable_discovery_protection>true</enable_discovery_protection>
<enable_liveliness_protection>true</enable_liveliness_protection>
<enable_read_access_control>true</enable_read_access_control>
<enable_write_access_control>true</enable_write_access_control>
<metadata_protection_kind>ENCRYPT</metadata_protection_kind>
<data_protection_kind>ENCRYPT</data_protection_kind></topic_rule></topic_access_rules>
</domain_rule></domain_access_rules>"""
_TOPICS = "<topics>{}</topics>"
_PERMISSIONS = """<permissions><grant name="{name}"><subject_name>CN={name}</subject_name>
<validity><not_before>2020-01-01T00:00:00</not_before>
<not_after>2100-01-01T00:00:00</not_after></validity>
<allow_rule>{domains}<publish>{topics}</publish><subscribe>{topics}</subscribe></allow_rule>
<default>DENY</default></grant></permissions>"""
ALL = ("*",)
"""Topics, on DDS."""


def authority(folder: Path) -> Path:
    """Make an authority; returns its folder, the keystore."""
    (folder / "enclaves").mkdir(parents=True)
    subject = ("-subj", "/CN=authority", "-days", DAYS)
    _openssl("req", "-x509", *_CURVE, *subject, "-out", folder / AUTHORITY, "-keyout", folder / KEY)
    return folder


def enclave(keystore: Path, name: str, topics: tuple[str, ...] = ALL) -> Path:
    """Make an enclave that may use some topics; returns its folder."""
    made = keystore / "enclaves" / name.strip("/")
    made.mkdir()
    signer, request = (keystore / AUTHORITY, keystore / KEY), made / "request"
    subject = ("-subj", "/CN=" + name.replace("/", r"\/"))
    _openssl("req", "-new", *_CURVE, *subject, "-out", request, "-keyout", made / "key.pem")
    by = ("-CA", signer[0], "-CAkey", signer[1], "-set_serial", "1", "-days", DAYS)
    _openssl("x509", "-req", *by, "-in", request, "-out", made / "cert.pem")
    for each in ("identity_ca", "permissions_ca"):
        (made / f"{each}.cert.pem").write_bytes(signer[0].read_bytes())
    allowed = _TOPICS.format("".join(f"<topic>{topic}</topic>" for topic in topics))
    granted = _PERMISSIONS.format(name=name, domains=_DOMAINS, topics=allowed)
    for file, text in (("governance", _GOVERNANCE), ("permissions", granted)):
        (made / f"{file}.xml").write_text(_XML.format(text), "utf-8")
        words = ("-in", made / f"{file}.xml", "-out", made / f"{file}.p7s")
        by = ("-signer", signer[0], "-inkey", signer[1])
        _openssl("smime", "-sign", "-text", *words, *by)
    return made


def _openssl(*words: object) -> None:
    subprocess.run(["openssl", *map(str, words)], check=True, capture_output=True)
