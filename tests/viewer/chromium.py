"""A headless Chromium driven through its debugging protocol: open pages, press keys, look."""

from __future__ import annotations

import base64
import itertools
import json
import os
import shutil
import subprocess
import tempfile
import time
import urllib.request
from pathlib import Path

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome", "headless_shell")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-first-run",
    "--disable-background-timer-throttling",
    "--disable-renderer-backgrounding",
    "--disable-backgrounding-occluded-windows",
    "--window-size=1250,760",
    "--remote-debugging-port=0",
)
SECONDS = 90.0
"""How long anything may take: software rendering on a busy machine."""


def find_chromium() -> str | None:
    """Where it is: named by CHROMIUM, on the PATH, or unpacked by playwright."""
    named = os.environ.get("CHROMIUM")
    for name in (named, *NAMES):
        if name and (found := shutil.which(name)):
            return found
    cache = Path.home() / ".cache" / "ms-playwright"
    for pattern in (
        "chromium-*/chrome-linux*/chrome",
        "chromium_headless_shell-*/*/headless_shell",
    ):
        for path in sorted(cache.glob(pattern)):
            return str(path)
    return None


class Chromium:
    """A browser without windows of its own profile; `open` gives a page in a new window."""

    def __init__(self, program: str):
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self._process = subprocess.Popen(
            [program, *FLAGS, f"--user-data-dir={self._profile.name}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        port = Path(self._profile.name, "DevToolsActivePort")
        self._open: list[str] = []
        wait_until(lambda: port.is_file() and "\n" in port.read_text(), "the browser to start")
        self._port = int(port.read_text().splitlines()[0])
        with urllib.request.urlopen(f"http://127.0.0.1:{self._port}/json/version") as answer:
            self._browser = _Socket(json.load(answer)["webSocketDebuggerUrl"])

    def open(self, url: str) -> Window:
        made = self._browser.call("Target.createTarget", url=url, newWindow=True)
        self._open.append(made["targetId"])
        return Window(f"ws://127.0.0.1:{self._port}/devtools/page/{made['targetId']}")

    def close_windows(self) -> None:
        """Windows that nobody looks at would go on drawing."""
        while self._open:
            self._browser.call("Target.closeTarget", targetId=self._open.pop())

    def close(self) -> None:
        self._browser.close()
        self._process.terminate()
        self._process.wait(30)
        self._profile.cleanup()


class Window:
    """One page."""

    def __init__(self, address: str):
        self._socket = _Socket(address)

    def text(self) -> str:
        """What a person reads on the page."""
        return self.run("document.body ? document.body.innerText : ''")

    def run(self, script: str):
        """The value of a JavaScript expression."""
        result = self._socket.call("Runtime.evaluate", expression=script, returnByValue=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def wait_for(self, words: str) -> None:
        try:
            wait_until(lambda: words in self.text(), words)
        except TimeoutError as err:
            raise AssertionError(
                f"{words!r} is not on the page, which says: {self.text()}"
            ) from err

    def press(self, key: str) -> None:
        """Press a letter where nothing is typed into."""
        self.run("document.activeElement && document.activeElement.blur()")
        self.press_here(key)

    def press_here(self, key: str) -> None:
        """Press a letter where the cursor is."""
        code = {"code": f"Key{key.upper()}", "windowsVirtualKeyCode": ord(key.upper())}
        for kind, text in (("keyDown", {"text": key}), ("keyUp", {})):
            self._socket.call("Input.dispatchKeyEvent", type=kind, key=key, **code, **text)

    def type_into(self, label: str, words: str) -> None:
        """Put words into the text box with a label, in place of what is there."""
        self.run(f"{_BOX}(box => {{ box.focus(); box.select(); }})({json.dumps(label)})")
        self._socket.call("Input.insertText", text=words)

    def choose(self, label: str, option: str) -> None:
        """Choose from the drop-down with a label."""
        self.run(f"{_BOX}(box => box.click())({json.dumps(label)})")
        script = f"""(() => {{
            const found = [...document.querySelectorAll('[role=option]')]
                .filter(e => e.innerText.trim() === {json.dumps(option)} && e.offsetParent);
            if (found.length) found[0].click();
            return found.length;
        }})()"""
        wait_until(lambda: self.run(script), f"the option {option}")

    def click(self, words: str) -> None:
        """Click the button with these words."""
        found = self.run(f"""(() => {{
            const found = [...document.querySelectorAll('button')]
                .filter(e => e.innerText.trim() === {json.dumps(words)});
            if (found.length) found[0].click();
            return found.length;
        }})()""")
        assert found == 1, f"{found} buttons say {words!r}"

    def picture(self, path: Path) -> Path:
        """Save what the window shows as a PNG."""
        self._socket.call("Page.bringToFront")
        data = self._socket.call("Page.captureScreenshot", format="png")["data"]
        path.write_bytes(base64.b64decode(data))
        return path


_BOX = """(act => label => {
    const of = [...document.querySelectorAll('label')].find(e => e.innerText.trim() === label);
    if (!of) throw new Error('no widget is called ' + label);
    const row = of.parentElement.parentElement.parentElement;
    act(row.querySelector('input, textarea'));
})"""


class _Socket:
    def __init__(self, address: str):
        from websockets.sync.client import connect

        self._socket = connect(address, max_size=None)
        self._numbers = itertools.count(1)

    def call(self, method: str, **params):
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        while True:
            answer = json.loads(self._socket.recv(SECONDS))
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return answer["result"]

    def close(self) -> None:
        self._socket.close()


def wait_until(condition, what: str, seconds: float = SECONDS) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return
        time.sleep(0.1)
    raise TimeoutError(f"waited {seconds:.0f} s for {what}")
