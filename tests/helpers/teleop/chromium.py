"""Debian's headless Chromium, driven by the DevTools protocol over its WebSocket."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import io
import json
import os
import shutil
import signal
import tempfile
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import aiohttp
import numpy as np
from PIL import Image

from surg_cli.graph import processes

PROGRAM = "/usr/bin/chromium"
START_S = 120.0
ANSWER_S = 30.0
ASK_S = 0.05
"""[s] Between two questions to a page: each takes it a millisecond, and its browser more."""
FLAGS = (
    "--headless=new",
    "--remote-debugging-port=0",
    "--remote-debugging-address=127.0.0.1",
    "--no-first-run",
    "--no-default-browser-check",
    "--disable-extensions",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-gpu",
    "--mute-audio",
    "--hide-scrollbars",
    "--force-color-profile=srgb",
)

GAMEPAD = """
window.pad = null;
window.idle = null;
navigator.getGamepads = () => [window.idle, window.pad];
window.plug = (axes, pressed) => {
  window.pad = {
    id: "Test pad (Vendor: 1234)", index: 0, connected: true, mapping: "standard", axes,
    buttons: [...Array(17).keys()].map((i) => {
      const value = pressed[i] ?? 0;
      return { pressed: value > 0.5, value };
    }),
  };
};
"""
"""A gamepad that is not there, for `Chromium.open`: `plug(axes, {button: value})`; `idle`: another
one, listed before it."""


def missing() -> str:
    """Why Chromium cannot be driven here; empty: it can."""
    return "" if shutil.which(PROGRAM) else f"{PROGRAM} is missing (Debian package chromium)"


class Navigated(AssertionError):
    """The page gave way to another one while it was asked."""


class Tab:
    """One open page."""

    def __init__(self, browser: Chromium, target: str, session: str) -> None:
        self._browser, self.target, self._session = browser, target, session

    async def call(self, method: str, **params: Any) -> dict[str, Any]:
        """One DevTools command on this page."""
        return await self._browser.call(method, self._session, **params)

    async def run(self, script: str) -> Any:
        """Evaluate a JavaScript expression (a promise is awaited) and return its JSON value."""
        answer = await self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in answer:
            raise AssertionError(json.dumps(answer["exceptionDetails"])[:600])
        return answer["result"].get("value")

    async def until(self, script: str, what: str, seconds: float = 20.0) -> Any:
        """Wait until an expression is true, on whatever page comes; the value it had then."""

        async def value() -> Any:
            with contextlib.suppress(Navigated):
                return await self.run(script)

        return await until(value, f"{what}: {script}", seconds, ASK_S)

    async def key(self, code: str, down: bool, key: str = "") -> None:
        """Press or release a key, as the browser's own input does."""
        kind = "keyDown" if down else "keyUp"
        await self.call("Input.dispatchKeyEvent", type=kind, code=code, key=key or code)

    async def tap(self, code: str) -> None:
        """Press and release a key."""
        await self.key(code, True)
        await self.key(code, False)

    async def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """A mouse event at a place of the page [px]."""
        await self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    async def type(self, keys: str) -> None:
        """Press keys by their names, separated by blanks; `_` is the space bar."""
        for name in keys.split():
            key = " " if name == "_" else name
            text = key if len(key) == 1 else "\r" if key == "Enter" else ""
            await self.call("Input.dispatchKeyEvent", type="keyDown", key=key, text=text)
            await self.call("Input.dispatchKeyEvent", type="keyUp", key=key)

    async def middle(self, selector: str) -> tuple[float, float]:
        """The middle of an element [px]."""
        box = f"document.querySelector({json.dumps(selector)}).getBoundingClientRect()"
        x, y = await self.run(
            f"(() => {{const b = {box}; return [b.x + b.width / 2, b.y + b.height / 2]}})()"
        )
        return x, y

    async def click(self, selector: str) -> None:
        """Click in the middle of an element."""
        at = await self.middle(selector)
        for kind in ("mousePressed", "mouseReleased"):
            await self.mouse(kind, *at, button="left", clickCount=1)

    async def fingers(self, kind: str, *places: Sequence[float]) -> None:
        """A touch event of this kind, with one finger at each place (2,) [px]."""
        points = [{"x": float(x), "y": float(y), "id": i} for i, (x, y) in enumerate(places)]
        await self.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)

    async def resize(self, width: int, height: int, touch: bool = False) -> None:
        """Give the page a screen [px], which is touched or not."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1}
        await self.call("Emulation.setDeviceMetricsOverride", mobile=touch, **size)
        await self.call("Emulation.setTouchEmulationEnabled", enabled=touch, maxTouchPoints=5)

    async def _png(self) -> bytes:
        return base64.b64decode((await self.call("Page.captureScreenshot", format="png"))["data"])

    async def screenshot(self, file: Path) -> None:
        """The page as a PNG file."""
        file.write_bytes(await self._png())

    async def pixels(self) -> np.ndarray:
        """What is on the screen (h, w, 3)."""
        return np.asarray(Image.open(io.BytesIO(await self._png())).convert("RGB")).astype(int)

    async def close(self) -> None:
        """Close the tab, as a person does."""
        await self._browser.call("Target.closeTarget", targetId=self.target)


class Chromium:
    """A browser of its own, with a profile that is thrown away; an async context manager.

    Attributes:
        errors: What the browser logged as errors of a page, and uncaught exceptions.
    """

    def __init__(self, size: tuple[int, int] = (1440, 860), flags: tuple[str, ...] = ()) -> None:
        self._size, self._flags = size, flags
        self.errors: list[str] = []
        self._answers: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self._count = 0

    async def __aenter__(self) -> Chromium:
        self._profile = Path(tempfile.mkdtemp(prefix="surg_chromium_"))
        width, height = self._size
        flags = [*FLAGS, f"--window-size={width},{height}", f"--user-data-dir={self._profile}"]
        if os.geteuid() == 0:
            flags.append("--no-sandbox")
        self.process = await asyncio.create_subprocess_exec(
            PROGRAM,
            *flags,
            *self._flags,
            "about:blank",
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.DEVNULL,
            start_new_session=True,
        )
        # A person's browser has the priority of what else that person started.
        processes.keep_niceness(self.process.pid)
        self._http = aiohttp.ClientSession()
        try:
            await self._connect()
        except BaseException:
            await self._end()
            raise
        return self

    async def _connect(self) -> None:
        port_file = self._profile / "DevToolsActivePort"

        async def port() -> list[str]:
            assert self.process.returncode is None, "chromium ended at once"
            return port_file.read_text().splitlines() if port_file.exists() else []

        lines = await until(port, "chromium's port", START_S)
        self._socket = await self._http.ws_connect(
            f"ws://127.0.0.1:{lines[0]}{lines[1]}", max_msg_size=1 << 26
        )
        self._reader = asyncio.create_task(self._read())

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self._end()

    async def _end(self) -> None:
        await self._http.close()
        if self.process.returncode is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            await self.process.wait()
        shutil.rmtree(self._profile, ignore_errors=True)

    async def _read(self) -> None:
        async for message in self._socket:
            said = json.loads(message.data)
            waiting = self._answers.pop(said.get("id", -1), None)
            if waiting is not None and not waiting.done():
                waiting.set_result(said)
            elif said.get("method") == "Runtime.exceptionThrown":
                self.errors.append(json.dumps(said["params"]["exceptionDetails"])[:500])
            elif said.get("method") == "Log.entryAdded":
                entry = said["params"]["entry"]
                self.errors += [entry["text"]] if entry["level"] == "error" else []

    def processor_time(self) -> float:
        """Processor time that all its processes have used [s]."""
        ticks = 0
        for stat in Path("/proc").glob("[0-9]*/stat"):
            with contextlib.suppress(OSError):
                fields = stat.read_text().rpartition(")")[2].split()
                if int(fields[2]) == self.process.pid:  # the process group
                    ticks += int(fields[11]) + int(fields[12])
        return ticks / os.sysconf("SC_CLK_TCK")

    async def call(self, method: str, session: str = "", **params: Any) -> dict[str, Any]:
        """One DevTools command; raises AssertionError with the browser's words."""
        self._count += 1
        number = self._count
        waiting = self._answers[number] = asyncio.get_running_loop().create_future()
        message = {"id": number, "method": method, "params": params}
        if session:
            message["sessionId"] = session
        await self._socket.send_str(json.dumps(message))
        said = await asyncio.wait_for(waiting, ANSWER_S)
        if "error" in said:
            gone = "navigated or closed" in said["error"].get("message", "")
            raise (Navigated if gone else AssertionError)(f"{method}: {said['error']}")
        return dict(said["result"])

    async def open(
        self, url: str, before: str = "", ready: bool = True, screen: tuple[int, ...] = ()
    ) -> Tab:
        """Open a page in a new tab.

        Args:
            url: Its address.
            before: JavaScript that runs before the page's own.
            ready: Wait until it has loaded.
            screen: Of `Tab.resize`; empty: the browser's window.
        """
        target = (await self.call("Target.createTarget", url="about:blank"))["targetId"]
        answer = await self.call("Target.attachToTarget", targetId=target, flatten=True)
        tab = Tab(self, target, answer["sessionId"])
        for domain in ("Page", "Runtime", "Log"):
            await tab.call(f"{domain}.enable")
        if before:
            await tab.call("Page.addScriptToEvaluateOnNewDocument", source=before)
        if screen:
            await tab.resize(*screen)
        await tab.call("Page.navigate", url=url)
        if ready:
            await tab.until("document.readyState === 'complete'", "the page to load", START_S)
        return tab


async def until(
    condition: Callable[[], Awaitable[Any]], what: str, seconds: float, period: float = 0.02
) -> Any:
    """Wait until a condition is true; its value.

    Raises:
        AssertionError: It does not come; names it.
    """
    loop = asyncio.get_running_loop()
    deadline = loop.time() + seconds
    while True:
        value = await condition()
        if value:
            return value
        assert loop.time() < deadline, f"waited {seconds} s for {what}"
        await asyncio.sleep(period)
