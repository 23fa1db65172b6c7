"""A real browser, where there is one: headless Chromium, spoken to over a pipe in its own protocol."""

import base64
import json
import os
import shutil
import subprocess
import time

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
# The protocol is spoken on descriptors 3 and 4.
PIPES = 'exec "$@" 3<"/proc/self/fd/$FROM_US" 4>"/proc/self/fd/$TO_US"'
MOUSE = "--blink-settings=primaryHoverType=2,availableHoverTypes=2,primaryPointerType=4,availablePointerTypes=4"
FLAGS = [
    MOUSE,
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--hide-scrollbars",
    "--remote-debugging-pipe",
    "--mute-audio",
]
BUTTON = {"button": "left", "clickCount": 1}


class Browser:
    """One headless Chromium with one page (https://chromedevtools.github.io/devtools-protocol)."""

    def __init__(self, folder):
        ours, self._send = os.pipe()
        self._receive, theirs = os.pipe()
        self._process = subprocess.Popen(
            ["sh", "-c", PIPES, "sh", CHROMIUM, *FLAGS, f"--user-data-dir={folder}", "about:blank"],
            env={**os.environ, "FROM_US": str(ours), "TO_US": str(theirs), "HOME": str(folder)},
            pass_fds=(ours, theirs),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(ours)
        os.close(theirs)
        self._buffer, self._number, self._session, self.events = b"", 0, None, []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method, **parameters):
        """Give an order and return its answer; what else happens is kept in ``events``."""
        self._number += 1
        order = {"id": self._number, "method": method, "params": parameters}
        order |= {"sessionId": self._session} if self._session else {}
        os.write(self._send, json.dumps(order).encode() + b"\0")
        while True:
            message = self._message()
            if message.get("id") == self._number:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                return message["result"]
            self.events.append(message)

    def _message(self):
        while b"\0" not in self._buffer:
            piece = os.read(self._receive, 1 << 20)
            if not piece:
                raise RuntimeError("Chromium ended.")
            self._buffer += piece
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)

    def value(self, expression):
        """Return the value of a JavaScript expression."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(answer["exceptionDetails"]["exception"].get("description"))
        return answer["result"].get("value")

    def open(self, path, *, width=1280, height=900, phone=False, scripts=True):
        """Show a file and wait for its charts."""
        self.events.clear()
        self.call("Emulation.setScriptExecutionDisabled", value=not scripts)
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=phone)
        self.call("Emulation.setTouchEmulationEnabled", enabled=phone, maxTouchPoints=2)
        self.call("Page.navigate", url=path.as_uri())
        ready = "document.readyState === 'complete'"
        if scripts:
            ready += " && document.documentElement.dataset.charts === 'ready'"
        deadline = time.monotonic() + 60
        while not self.value(ready):
            if time.monotonic() > deadline:
                raise RuntimeError(f"Chromium did not open {path} within a minute: {self.complaints()}")
            time.sleep(0.02)

    def settle(self):
        """Wait until what was ordered is drawn."""
        self.value("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done())))")

    def mouse(self, kind, x, y, **options):
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **options)

    def drag(self, begin, end):
        """Press the left button at one point and let it go at another."""
        self.mouse("mousePressed", *begin, **BUTTON)
        self.mouse("mouseMoved", *end, button="left", buttons=1)
        self.mouse("mouseReleased", *end, **BUTTON)
        self.settle()

    def click(self, selector):
        x, y = self.value(
            f"(e => {{ e.scrollIntoView({{block: 'center'}}); const b = e.getBoundingClientRect();"
            f"return [b.x + b.width / 2, b.y + b.height / 2]; }})(document.querySelector({selector!r}))"
        )
        self.mouse("mousePressed", x, y, **BUTTON)
        self.mouse("mouseReleased", x, y, **BUTTON)
        self.settle()

    def key(self, key, **options):
        text = {"text": key} if len(key) == 1 else {}
        self.call("Input.dispatchKeyEvent", type="keyDown", key=key, **text, **options)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key, **options)
        self.settle()

    def touch(self, kind, *points):
        self.call("Input.dispatchTouchEvent", type=kind, touchPoints=[{"x": x, "y": y} for x, y in points])

    def screenshot(self, path):
        """Write the whole page as a PNG."""
        picture = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(picture["data"]))

    def complaints(self):
        """Return what the console and the log hold, and what was fetched beside the page."""
        found = []
        for event in self.events:
            kind, what = event.get("method"), event.get("params", {})
            if kind in ("Runtime.exceptionThrown", "Runtime.consoleAPICalled", "Log.entryAdded"):
                found.append(json.dumps(what))
            elif kind == "Network.requestWillBeSent" and what["request"]["url"] != what["documentURL"]:
                found.append(what["request"]["url"])
        return found

    def close(self):
        try:
            self.call("Browser.close")
        except (RuntimeError, OSError):
            self._process.kill()
        self._process.wait(10)
        os.close(self._send)
        os.close(self._receive)


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    """Return a headless Chromium, or skip where there is none."""
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine: apt install chromium")
    browser = Browser(tmp_path_factory.mktemp("chromium"))
    yield browser
    browser.close()
