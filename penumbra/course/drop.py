"""The page's part drop."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def drop(build_dir: Path) -> dict[str, Any]:
    return {}
