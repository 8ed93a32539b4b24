"""The page's part museum."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def museum(build_dir: Path) -> dict[str, Any]:
    return {}
