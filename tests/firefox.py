"""A stock Firefox, headless, driven by WebDriver BiDi: Playwright drives only its own build."""

from __future__ import annotations

import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import ClientConnection, connect

SECONDS = 60
"""For its start, and for each answer"""


class Firefox:
    """One tab."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._numbers = itertools.count(1)
        self._ask("session.new", capabilities={})
        self._tab = self._ask("browsingContext.getTree")["contexts"][0]["context"]

    def open(self, url: str) -> None:
        """And wait until it is loaded."""
        self._ask("browsingContext.navigate", context=self._tab, url=url, wait="complete")

    def size(self, width: int, height: int) -> None:
        """Of what the tab shows [CSS pixels]."""
        viewport = {"width": width, "height": height}
        self._ask("browsingContext.setViewport", context=self._tab, viewport=viewport)

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression, awaited, as JSON has it. Raises RuntimeError with
        what the page threw."""
        answer = self._ask(
            "script.evaluate",
            expression=f"(async () => JSON.stringify(await ({expression})))()",
            target={"context": self._tab},
            awaitPromise=True,
        )
        if answer["type"] == "exception":
            raise RuntimeError(answer["exceptionDetails"]["text"])
        return json.loads(answer["result"].get("value", "null"))

    def _ask(self, method: str, **params: Any) -> Any:
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        while True:
            answer = json.loads(self._socket.recv(timeout=SECONDS))
            if answer.get("id") == number:  # others are events
                break
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['message']}")
        return answer["result"]


@contextmanager
def firefox() -> Iterator[Firefox]:
    """With a profile of its own, and gone at the end with all its processes."""
    names = ("firefox-esr", "firefox")
    program = next((path for path in map(shutil.which, names) if path), None)
    if program is None:
        pytest.fail(f"none of {', '.join(names)} is installed: run ./setup.sh test")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        profile, said = Path(folder) / "profile", Path(folder) / "said"
        profile.mkdir()
        with said.open("w") as stream:
            started = subprocess.Popen(
                [program, "--headless", "--no-remote", "--profile", str(profile),
                 "--remote-debugging-port=0"],
                stdout=stream, stderr=stream, start_new_session=True,
            )  # fmt: skip
        try:
            address = _address(said, started)
            with connect(f"{address}/session", max_size=None, open_timeout=SECONDS) as socket:
                yield Firefox(socket)
        finally:
            os.killpg(started.pid, signal.SIGKILL)
            started.wait()


def _address(said: Path, started: subprocess.Popen[bytes]) -> str:
    """Where it listens, which it says once it does."""
    end = time.monotonic() + SECONDS
    while time.monotonic() < end and started.poll() is None:
        if found := re.search(r"BiDi listening on (ws://\S+)", said.read_text(errors="replace")):
            return found[1]
        time.sleep(0.05)
    pytest.fail(f"Firefox does not listen:\n{said.read_text(errors='replace')[-2000:]}")
