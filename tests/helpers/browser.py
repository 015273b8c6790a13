"""A real browser driven through its DevTools protocol; tests that need it are skipped where there is none."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import time
import urllib.request
from base64 import b64decode
from pathlib import Path

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
SECONDS = 60
OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--remote-debugging-port=0",
    "--hide-scrollbars",
)
KEYS = {"Enter": 13, "Escape": 27, "Tab": 9, "Delete": 46, "ArrowLeft": 37, "ArrowRight": 39}
CONTROL = 2
LEFT = {"button": "left", "buttons": 1, "clickCount": 1}


class Browser:
    """One page of a browser with a fresh profile."""

    def __init__(self, folder, size=(1400, 900)):
        import websocket

        profile = Path(folder) / "profile"
        window = f"--window-size={size[0]},{size[1]}"
        self.process = subprocess.Popen(  # noqa: S603
            [str(BROWSER), *OPTIONS, window, f"--user-data-dir={profile}", "about:blank"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        try:
            port = _port(profile / "DevToolsActivePort")
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list") as answer:
                pages = [page for page in json.load(answer) if page["type"] == "page"]
            self.socket = websocket.create_connection(
                pages[0]["webSocketDebuggerUrl"], timeout=SECONDS, suppress_origin=True
            )
        except BaseException:
            self.kill()
            raise
        self.number, self.complaints = 0, []
        self.call("Runtime.enable")
        self.call("Log.enable")
        self.call("Page.enable")
        self.resize(*size)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()
        self.kill()

    def kill(self):
        """End the browser at once."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def call(self, method, **parameters):
        """Send one command and return its result; complaints of the page are collected."""
        self.number += 1
        self.socket.send(json.dumps({"id": self.number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self.socket.recv())
            if message.get("id") == self.number:
                assert "error" not in message, message["error"]
                return message["result"]
            self._listen(message)

    def _listen(self, message):
        kind, data = message.get("method"), message.get("params", {})
        if kind == "Runtime.exceptionThrown":
            self.complaints.append(
                data["exceptionDetails"].get("exception", {}).get("description", str(data))
            )
        elif kind == "Log.entryAdded" and data["entry"]["level"] == "error":
            self.complaints.append(data["entry"]["text"])
        elif kind == "Page.javascriptDialogOpening":
            self.socket.send(
                json.dumps({"id": 10**9, "method": "Page.handleJavaScriptDialog", "params": {"accept": True}})
            )

    def evaluate(self, code):
        """Value of an expression on the page; promises are awaited."""
        result = self.call("Runtime.evaluate", expression=code, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def wait_for(self, code, seconds=SECONDS):
        """Wait until an expression is true."""
        end = time.monotonic() + seconds
        while not self.evaluate(f"Boolean({code})"):
            assert time.monotonic() < end, f"never true: {code}"
            time.sleep(0.02)

    def open(self, address, ready):
        """Open an address and wait until an expression is true there."""
        self.call("Page.navigate", url=address)
        there = f"location.href === '{address}' && document.readyState === 'complete'"
        self.wait_for(f"{there} && ({ready})")

    def resize(self, width, height):
        """Set the size of the page."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )

    def mouse(self, kind, x, y, **more):
        self.call("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, **more)

    def click(self, x, y, modifiers=0):
        self.drag((x, y), modifiers=modifiers)

    def drag(self, *places, modifiers=0):
        """Press at the first place, move through the others, release at the last."""
        self.mouse("Moved", *places[0], modifiers=modifiers)
        self.mouse("Pressed", *places[0], modifiers=modifiers, **LEFT)
        for place in places[1:]:
            self.mouse("Moved", *place, modifiers=modifiers, buttons=1, button="left")
        self.mouse("Released", *places[-1], modifiers=modifiers, **LEFT)

    def key(self, key, modifiers=0):
        """Press and release a key."""
        code = KEYS.get(key, ord(key.upper()[0]))
        text = {} if len(key) > 1 or modifiers else {"text": key}
        for kind in ("keyDown", "keyUp"):
            self.call(
                "Input.dispatchKeyEvent", type=kind, key=key, windowsVirtualKeyCode=code, modifiers=modifiers,
                **(text if kind == "keyDown" else {}),
            )  # fmt: skip

    def screenshot(self, path):
        """Write a PNG of the page."""
        Path(path).write_bytes(b64decode(self.call("Page.captureScreenshot", format="png")["data"]))


def _port(file):
    """The port that the browser listens on, when it has written it."""
    end = time.monotonic() + SECONDS
    while not (file.exists() and file.read_text()):
        assert time.monotonic() < end, "the browser does not start"
        time.sleep(0.05)
    return file.read_text().split()[0]
