"""A headless Chromium for tests of pages, spoken to over its DevTools protocol.

Needs Debian's package `chromium`. The network is cut off: every name and address but this machine's
own resolves to nothing.
"""

import asyncio
import base64
import itertools
import os
import shutil
import subprocess
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
needed = pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's package chromium")
OPTIONS = (
    "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-extensions",
    "--disable-background-networking", "--disable-component-update", "--no-first-run",
    "--disable-sync", "--hide-scrollbars", "--enable-unsafe-swiftshader", "--use-angle=swiftshader",
    "--remote-debugging-port=0", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)  # fmt: skip


@dataclass
class Page:
    """What a page did while it was open.

    Attributes
    ----------
    errors : list of str
        Errors in its console, exceptions, and requests that failed.
    requests : list of str
        Addresses it asked for, itself first; none of `data:`.
    values : list
        Of the expressions that were asked for, in their order.
    """

    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
    values: list = field(default_factory=list)


def visit(
    address, *expressions, picture=None, size=(1100, 900), dark=False, wait="true", timeout=60.0
):
    """Open a page, wait until an expression holds, evaluate others, close the browser.

    Parameters
    ----------
    address : str
    *expressions : str
        JavaScript, each evaluated in turn; promises are waited for.
    picture : path, optional
        Where to write a PNG of the whole page, at the end.
    dark : bool
        The reader's setting of prefers-color-scheme.
    wait : str
        JavaScript that becomes true when the page is ready.

    Returns
    -------
    Page
    """
    with tempfile.TemporaryDirectory() as home:
        with open(Path(home) / "stderr", "wb") as err:
            browser = subprocess.Popen(
                [CHROMIUM, *OPTIONS, f"--user-data-dir={home}/profile", "about:blank"],
                stderr=err, stdout=subprocess.DEVNULL, start_new_session=True,
            )  # fmt: skip
        try:
            port = _port(Path(home) / "profile" / "DevToolsActivePort", browser)
            work = _visit(port, address, expressions, picture, size, dark, wait, timeout)
            return asyncio.run(asyncio.wait_for(work, 2.0 * timeout))
        finally:
            os.killpg(browser.pid, 15)
            try:
                browser.wait(10)
            except subprocess.TimeoutExpired:
                os.killpg(browser.pid, 9)
                browser.wait()


def _port(file, browser):
    until = time.monotonic() + 60.0
    while time.monotonic() < until and browser.poll() is None:
        if file.exists() and "\n" in (text := file.read_text()):
            return int(text.split()[0])
        time.sleep(0.05)
    raise RuntimeError("chromium does not start")


async def _visit(port, address, expressions, picture, size, dark, wait, timeout):
    from aiohttp import ClientSession

    page, number, answers = Page(), itertools.count(1), {}
    async with ClientSession() as http:
        async with http.get(f"http://127.0.0.1:{port}/json/list") as reply:
            tabs = await reply.json()
        target = next(tab for tab in tabs if tab["type"] == "page")["webSocketDebuggerUrl"]
        async with http.ws_connect(target, max_msg_size=0) as socket:

            async def listen():
                async for message in socket:
                    said = message.json()
                    if "id" in said:
                        answers.pop(said["id"]).set_result(said)
                    else:
                        _note(page, said["method"], said["params"])

            async def ask(method, **params):
                now = next(number)
                answers[now] = asyncio.get_running_loop().create_future()
                await socket.send_json({"id": now, "method": method, "params": params})
                said = await asyncio.wait_for(answers[now], timeout)
                if "error" in said:
                    raise RuntimeError(f"{method}: {said['error']['message']}")
                return said["result"]

            async def evaluate(text):
                found = await ask(
                    "Runtime.evaluate", expression=text, awaitPromise=True, returnByValue=True
                )
                if "exceptionDetails" in found:
                    raise RuntimeError(f"{text}: {found['exceptionDetails']['exception']}")
                return found["result"].get("value")

            listener = asyncio.create_task(listen())
            for part in ("Page", "Runtime", "Log", "Network"):
                await ask(f"{part}.enable")
            scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
            await ask("Emulation.setEmulatedMedia", features=[scheme])
            about = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": False}
            await ask("Emulation.setDeviceMetricsOverride", **about)
            await ask("Page.navigate", url=address)
            until = time.monotonic() + timeout
            ready = (
                f"document.readyState == 'complete' && location.href != 'about:blank' && ({wait})"
            )
            while not await evaluate(f"Boolean({ready})"):
                if time.monotonic() > until:
                    raise RuntimeError(f"{address}: '{wait}' never holds; {page.errors}")
                await asyncio.sleep(0.1)
            for text in expressions:
                page.values.append(await evaluate(text))
            await asyncio.sleep(0.3)  # for what the last expression has set off
            if picture is not None:
                shot = await ask("Page.captureScreenshot", captureBeyondViewport=True)
                Path(picture).write_bytes(base64.b64decode(shot["data"]))
            listener.cancel()
    return page


def _note(page, method, said):
    if method == "Runtime.exceptionThrown":
        page.errors.append(str(said["exceptionDetails"]))
    elif method == "Log.entryAdded" and said["entry"]["level"] == "error":
        page.errors.append(f"{said['entry']['text']} {said['entry'].get('url', '')}")
    elif method == "Runtime.consoleAPICalled" and said["type"] in ("error", "assert"):
        page.errors.append(" ".join(str(a.get("value", a)) for a in said["args"]))
    elif method == "Network.requestWillBeSent":
        url = said["request"]["url"]
        page.requests += [] if url.startswith(("data:", "blob:")) else [url]
    elif method == "Network.loadingFailed" and not said.get("canceled"):
        page.errors.append(f"a request failed: {said['errorText']} {said.get('blockedReason', '')}")
