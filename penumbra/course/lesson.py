"""The page's part lesson."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def lesson(build_dir: Path) -> dict[str, Any]:
    return {}
