"""Security headers, TLS and the static files of the pages."""

from __future__ import annotations

import ssl
from importlib import resources

from aiohttp import web

from surg_console.web.access import Access

TYPES = {
    "html": "text/html",
    "css": "text/css",
    "js": "text/javascript",
    "svg": "image/svg+xml",
}
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self'; connect-src 'self'; worker-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Embedder-Policy": "require-corp",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=(), gamepad=(self), "
    "xr-spatial-tracking=(self)",
    "Cache-Control": "no-store",
}


async def add_headers(request: web.Request, response: web.StreamResponse) -> None:
    """Add the security headers where a page has none of its own; a signal handler of aiohttp."""
    for name, value in HEADERS.items():
        response.headers.setdefault(name, value)
    response.headers.popall("Server", None)


def page_files() -> dict[str, bytes]:
    """Files of the page by name, read once; no other file is served."""
    folder = resources.files(__package__).joinpath("page")
    groups = {f"{each.name}/": each for each in folder.iterdir() if each.is_dir()}
    return {
        prefix + file.name: file.read_bytes()
        for prefix, group in {"": folder, **groups}.items()
        for file in group.iterdir()
        if file.name.rpartition(".")[2] in TYPES
    }


def tls_context(access: Access) -> ssl.SSLContext | None:
    """TLS of the server; None: plain HTTP."""
    if access.certificate is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.load_cert_chain(*access.certificate)
    return context
