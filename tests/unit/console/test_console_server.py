"""The console's server on a real socket, with a robot that a test holds in its hands."""

from __future__ import annotations

import asyncio
import contextlib
import json
import ssl
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import aiohttp
import pytest

from helpers.async_tests import within
from helpers.teleop.console import console
from helpers.teleop.console_page import Page, page, socket_of, when
from surg_cli.graph import master
from surg_console.session.console_orders import (
    EnableTeleop,
    Move,
    Record,
    SetOperatorPresent,
    StateCommand,
)
from surg_console.web import picture_packet
from surg_console.web.admission import CLOSE_HELLO
from surg_console.web.control_socket import MAX_ERRORS
from surg_console.web.overlay_socket import PERIODS
from surg_console.web.page_connection import MESSAGE_BURST, MessageBudget

SOCKETS = ("/control", "/status", "/pictures", "/calibration", *(f"/{what}" for what in PERIODS))
TOKEN = "0123456789abcdef0123"


@within(60.0)
async def test_the_page_and_its_headers() -> None:
    async with console() as made, aiohttp.ClientSession() as http:
        root = f"http://localhost:{made.port}"
        for path, kind in {
            "/": "text/html",
            "/calibrate": "text/html",
            "/page/main.js": "text/javascript",
            "/page/console.css": "text/css",
            "/page/mark.svg": "image/svg+xml",
        }.items():
            async with http.get(root + path) as answer:
                assert answer.status == 200, path
                assert answer.content_type == kind
                assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]
                assert answer.headers["X-Content-Type-Options"] == "nosniff"
                assert "Server" not in answer.headers
        for path in ("/page/../server.py", "/page/%2e%2e%2fserver.py", "/page/none.js", "/etc"):
            async with http.get(root + path) as answer:
                assert answer.status == 404, path


@within(60.0)
async def test_another_host_name_is_not_answered() -> None:
    """DNS rebinding: a foreign name that has come to mean this machine."""
    async with console() as made, aiohttp.ClientSession() as http:
        for host in ("evil.example", f"evil.example:{made.port}", "localhost", "localhost:1"):
            for path in ("/", "/page/main.js", "/control", "/pictures", "/calibration"):
                url = f"http://localhost:{made.port}{path}"
                async with http.get(url, headers={"Host": host}) as answer:
                    assert answer.status == 421, (host, path)


@within(60.0)
async def test_a_socket_from_another_page_is_refused() -> None:
    async with console() as made, aiohttp.ClientSession() as http:
        for path in SOCKETS:
            url = f"ws://localhost:{made.port}{path}"
            for origin in (
                None,
                "null",
                "http://evil.example",
                f"https://localhost:{made.port}",
            ):
                with pytest.raises(aiohttp.WSServerHandshakeError) as caught:
                    await http.ws_connect(url, origin=origin)
                assert caught.value.status == 403, (path, origin)
        assert made.session.pages == 0


@within(60.0)
async def test_without_the_token_nothing_is_said() -> None:
    async with console(token=TOKEN) as made, aiohttp.ClientSession() as http:
        origin = f"http://localhost:{made.port}"

        async def refused(path: str, first: str) -> None:
            socket = await http.ws_connect(origin.replace("http", "ws") + path, origin=origin)
            await socket.send_str(first)
            answer = await socket.receive()
            assert answer.type is aiohttp.WSMsgType.CLOSE
            assert answer.data == CLOSE_HELLO

        wrong = ('{"say": "hello", "token": ""}', '{"say": "hello", "token": "x"}', "x")
        await asyncio.gather(*(refused(path, first) for path in SOCKETS for first in wrong))
        assert made.session.pages == 0
        async with page(made.port, TOKEN) as found:
            assert found.name and found.status["holder"] == found.name


@within(60.0)
async def test_no_message_of_the_session_is_heard_on_the_socket_of_calibration() -> None:
    async with console() as made, aiohttp.ClientSession() as http:
        made.system.now = replace(made.system.now, calibration={"state": "DONE"})

        async def said(text: str) -> list[aiohttp.WSMsgType]:
            socket = await socket_of(http, made.port, "calibration")
            await socket.send_str(text)
            return [message.type async for message in socket]

        press = '{"say": "press", "button": "enable", "at": 1.0}'
        take = '{"say": "press", "button": "take", "at": 1.0}'
        moves = '{"say": "input", "seq": 1, "at": 1.0, "v": [0.01, 0, 0]}'
        wrong = '{"say": "calibrate", "request": "MOVE"}'
        await asyncio.gather(*(said(text) for text in (press, take, moves, wrong)))
        assert made.system.orders == [] and made.session.pages == 0


@within(60.0)
async def test_inputs_go_out_and_a_closed_page_holds_within_its_limit() -> None:
    async with console() as made:
        async with page(made.port) as found:
            await found.drive()
            await when(lambda: len(made.system.given(Move)) > 20, "inputs")
            closed = time.monotonic()
            await found.socket.close()
        await when(lambda: made.session.holder == "", "the end of the page")
        at, order = made.system.last(SetOperatorPresent)
        assert order == SetOperatorPresent(False) and made.system.last(EnableTeleop)[
            1
        ] == EnableTeleop(False)
        print(f"held {1e3 * (at - closed):.0f} ms after the socket was closed")
        assert at - closed < 0.2


@within(60.0)
async def test_a_silent_page_holds_within_its_limit_and_does_not_go_on() -> None:
    async with console() as made, page(made.port) as found:
        await found.drive()
        found.fall_silent()
        silent = time.monotonic()
        await when(lambda: made.session.phase.value == "held", "the hold")
        at, order = made.system.last(SetOperatorPresent)
        assert order == SetOperatorPresent(False)
        print(f"held {1e3 * (at - silent):.0f} ms after the last input")
        assert at - silent < 0.3
        made.system.orders.clear()
        found.speak()
        await asyncio.sleep(0.5)
        assert made.system.given(Move) == []
        assert "No input from this page" in found.status["sentence"]


@within(60.0)
async def test_a_hidden_page_holds_at_once() -> None:
    async with console() as made, page(made.port) as found:
        await found.drive()
        hidden = time.monotonic()
        await found.say("hidden", why="hidden")
        await when(lambda: made.session.phase.value == "held", "the hold")
        assert made.system.last(SetOperatorPresent)[0] - hidden < 0.2


@within(60.0)
async def test_two_pages_one_drives_both_may_stop() -> None:
    async with console() as made, page(made.port) as first, page(made.port) as second:
        await first.drive()
        second.speak()
        await second.press("enable")
        await second.press("take")
        await second.press("record")
        await when(lambda: len(second.refused) == 3, "three refusals")
        assert "has control" in second.refused[1]
        assert made.system.given(Record) == []
        assert second.status["holder"] == first.name
        await when(lambda: first.status["phase"] == "driving", "still driving", 5.0)
        await second.press("stop")
        await when(lambda: first.status["phase"] == "held", "the stop")
        assert made.system.last(StateCommand)[1] == StateCommand("PSM1", "pause")
        await first.press("release")
        await when(lambda: second.status["holder"] == "", "control is free")
        await second.press("take")
        await when(lambda: second.status["holder"] == second.name, "control")


@within(60.0)
async def test_nonsense_and_floods_are_cut_off() -> None:
    async with console() as made:
        async with page(made.port) as found:
            for _ in range(MAX_ERRORS):
                await found.socket.send_str("{}")
            await when(lambda: found.socket.closed, "the end")
        async with page(made.port) as found:
            await found.socket.send_str("x" * 100_000)
            await when(lambda: found.socket.closed, "the end")
        async with page(made.port) as found:
            with contextlib.suppress(ConnectionError):
                for _ in range(int(MESSAGE_BURST) + 400):
                    await found.say("ping", at=1.0)
            await when(lambda: found.socket.closed, "the end")
        async with page(made.port) as found:  # the console lives
            assert found.status["holder"] == found.name


def test_the_allowance_is_that_of_a_page_and_no_more() -> None:
    steady, flood = MessageBudget(0.0), MessageBudget(0.0)
    assert all(steady.spend(0.01 * step) for step in range(3000))  # 100 a second for ever
    taken = sum(flood.spend(0.001 * step) for step in range(3000))  # 1000 a second for 3 s
    assert MESSAGE_BURST <= taken <= MESSAGE_BURST + 3 * 200 + 1


@within(60.0)
async def test_pictures_come_and_the_newest_wins() -> None:
    async with console() as made, aiohttp.ClientSession() as http:
        socket = await socket_of(http, made.port, "pictures")
        for codec, layout in (("h264", "left"), ("jpeg", "stereo")):
            await socket.send_str(json.dumps({"say": "watch", "layout": layout, "codec": codec}))
            packets: list[picture_packet.Packet] = []
            while len(packets) < 8:
                packet = picture_packet.unpack((await socket.receive()).data)
                if (packet.codec, packet.layout) == (codec, layout):
                    packets.append(packet)
                await socket.send_str(json.dumps({"say": "shown", "seq": packet.seq}))
            assert packets[0].key
            stamps = [packet.exposed_us for packet in packets]
            assert stamps == sorted(stamps)
        # A page that no longer draws is not sent more and more.
        (viewer,) = made.server._pictures._viewers
        await when(lambda: viewer.queue.dropped >= 3, "pictures that are not sent")
        await socket.close()
        await when(lambda: not made.camera.wanted, "nobody watches")


@within(60.0)
async def test_who_wants_fewer_pictures_takes_none_from_another_page() -> None:
    async with console() as made, aiohttp.ClientSession() as http:

        async def viewer(spacing: int) -> aiohttp.ClientWebSocketResponse:
            socket = await socket_of(http, made.port, "pictures")
            watched = {"say": "watch", "layout": "left", "codec": "jpeg", "spacing": spacing}
            await socket.send_str(json.dumps(watched))
            return socket

        slow = await viewer(200)
        await when(lambda: made.camera.wanted == {("left", "jpeg"): 200}, "fewer")
        quick = await viewer(0)
        await when(lambda: made.camera.wanted == {("left", "jpeg"): 0}, "all")
        await quick.close()
        await when(lambda: made.camera.wanted == {("left", "jpeg"): 200}, "fewer again")
        await slow.close()


@within(60.0)
async def test_over_tls(tmp_path: Path) -> None:
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    made = subprocess.run(
        [
            *("openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt"),
            *("ec_paramgen_curve:prime256v1", "-nodes", "-keyout", key, "-out", cert),
            *("-days", "2", "-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost"),
        ],
        capture_output=True,
        check=False,
    )
    assert made.returncode == 0, made.stderr
    trust = ssl.create_default_context(cafile=str(cert))
    rules = {"certificate": cert, "key": key, "token": TOKEN}
    async with console(**rules) as served, aiohttp.ClientSession() as http:
        root = f"https://localhost:{served.port}"
        async with http.get(root + "/", ssl=trust) as answer:
            assert answer.status == 200
        socket = await http.ws_connect(
            f"wss://localhost:{served.port}/control", origin=root, ssl=trust
        )
        await socket.send_str(json.dumps({"say": "hello", "token": TOKEN}))
        assert json.loads((await socket.receive()).data)["say"] == "welcome"
        await socket.close()
        with pytest.raises(aiohttp.ClientError):
            await http.get(f"http://localhost:{served.port}/")


@within(60.0)
async def test_what_breaks_inside_ends_the_console_and_holds_the_arm() -> None:
    with pytest.raises(ZeroDivisionError):
        async with console() as made, page(made.port) as found:
            await found.drive()
            made.session.tick = lambda robot, now: 1 / 0  # type: ignore[method-assign]
            await when(lambda: found.socket.closed, "the end")
            assert made.system.last(SetOperatorPresent)[1] == SetOperatorPresent(False)
            assert made.system.last(EnableTeleop)[1] == EnableTeleop(False)


class Stuck:
    """A socket whose other end reads nothing more."""

    async def close(self, **_: object) -> None:
        await asyncio.Event().wait()


@within(60.0)
async def test_a_console_that_ends_enables_nothing_and_waits_for_no_stuck_page() -> None:
    async with console(pictures=False) as made, aiohttp.ClientSession() as http:
        made.server._admission._sockets.add(Stuck())  # type: ignore[arg-type]
        made.stop.set()
        await when(lambda: made.system.given(EnableTeleop), "the end")
        late = Page(await socket_of(http, made.port, "control"))
        await late.input()
        await late.press("enable")
        await when(lambda: not master.port_in_use(made.port), "a free port", 5.0)
        assert EnableTeleop(True) not in made.system.given(EnableTeleop)
