"""What a long run has measured so far, so that a killed one can go on where it stopped."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
from pathlib import Path
from types import TracebackType
from typing import Any


class JournalError(ValueError):
    """A journal that cannot be used; the text names the file and the reason."""


class Journal:
    """A file of JSON lines {"key": ..., "value": ...}, appended one whole line at a time.

    Later lines of a key win. Lines that are not whole (the run was killed while it wrote
    the last one) are dropped. An empty journal leaves no file. While it is open no second run
    can open it: JournalError.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            if file.exists() and not file.is_file():
                raise JournalError(f"{file}: no plain file, and so no journal to go on from")
            self._stream = file.open("a+b")
        except OSError as error:
            raise JournalError(f"{file}: cannot be written: {error.strerror}") from error
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._stream.close()
            raise JournalError(f"{file}: another run is writing it; wait for it to end") from error
        self._values = self._read()

    def get(self, key: str) -> Any | None:
        return self._values.get(key)

    def append(self, key: str, value: Any) -> None:
        """Raises JournalError if it cannot be written; ValueError for NaN."""
        line = json.dumps({"key": key, "value": value}, allow_nan=False) + "\n"
        try:
            self._stream.write(line.encode())
            self._stream.flush()
        except OSError as error:
            raise JournalError(f"{self.file}: cannot be written: {error.strerror}") from error
        self._values[key] = value

    def delete(self) -> None:
        Path(os.path.realpath(self.file)).unlink(missing_ok=True)  # a link stays

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if not self._values:
            self.delete()
        with contextlib.suppress(OSError):  # of a line that append() could not write
            self._stream.close()

    def _read(self) -> dict[str, Any]:
        self._stream.seek(0)
        data = self._stream.read()
        whole = data.rfind(b"\n") + 1
        if whole < len(data):
            self._stream.truncate(whole)  # else the next line would be glued to the torn one
        values = {}
        for line in data[:whole].splitlines():
            try:
                entry = json.loads(line)
                values[str(entry["key"])] = entry["value"]
            except (ValueError, TypeError, KeyError):
                continue
        return values
