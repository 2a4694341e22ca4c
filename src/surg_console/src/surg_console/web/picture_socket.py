"""The socket /pictures: encoded pictures out, what a page watches and has drawn in."""

from __future__ import annotations

import asyncio
import contextlib
import time

from aiohttp import WSMsgType, web

from surg_console.web.encoder_process import EncoderProcess
from surg_console.web.page_connection import MessageBudget, Viewer
from surg_console.web.page_protocol import ProtocolError, Shown, Watch, parse
from surg_console.web.picture_packet import WIDEST, Packet
from surg_console.web.picture_queue import PictureQueue


class PicturePages:
    """The pages that watch pictures."""

    def __init__(self, pictures: EncoderProcess) -> None:
        self._pictures = pictures
        self._viewers: set[Viewer] = set()

    @property
    def open(self) -> int:
        """Number of open sockets."""
        return len(self._viewers)

    def show(self, packet: Packet) -> None:
        """Send a new picture to everybody who watches its layout and codec."""
        for viewer in self._viewers:
            if viewer.stream == (packet.layout, packet.codec):
                viewer.queue.put(packet)
                viewer.changed.set()

    def request_keys(self) -> None:
        """Ask for key frames for those who have missed a picture; called all the time."""
        for viewer in self._viewers:
            if viewer.stream and viewer.queue.wants_key(time.monotonic()):
                self._pictures.key(*viewer.stream)

    async def serve(self, socket: web.WebSocketResponse) -> None:
        """Serve one page until it disconnects or breaks the protocol."""
        viewer = Viewer()
        self._viewers.add(viewer)
        sender = asyncio.create_task(self._send(socket, viewer))
        try:
            with contextlib.suppress(ProtocolError):
                await self._receive(socket, viewer)
        finally:
            self._viewers.discard(viewer)
            self._want_streams()
            sender.cancel()
            await socket.close()

    async def _receive(self, socket: web.WebSocketResponse, viewer: Viewer) -> None:
        budget = MessageBudget(time.monotonic())
        async for frame in socket:
            await asyncio.sleep(0)
            message = parse(frame.data) if frame.type is WSMsgType.TEXT else None
            if not budget.spend(time.monotonic()):
                return
            if isinstance(message, Watch):
                stream, viewer.spacing = (message.layout, message.codec), message.spacing
                if stream != viewer.stream:
                    viewer.stream, viewer.queue = stream, PictureQueue()
                self._want_streams()
            elif isinstance(message, Shown):
                viewer.queue.drawn(message.seq)
                viewer.changed.set()
            else:
                return

    def _want_streams(self) -> None:
        """Who wants fewer pictures than another page of the same stream gets as many as that."""
        wanted: dict[tuple[str, str], int] = {}
        for viewer in self._viewers:
            if viewer.stream is not None:
                wanted[viewer.stream] = min(viewer.spacing, wanted.get(viewer.stream, WIDEST))
        self._pictures.want(wanted)

    async def _send(self, socket: web.WebSocketResponse, viewer: Viewer) -> None:
        with contextlib.suppress(ConnectionError):
            while True:
                await viewer.changed.wait()
                viewer.changed.clear()
                packet = viewer.queue.take(time.monotonic())
                if packet is not None:
                    await socket.send_bytes(packet.pack())
