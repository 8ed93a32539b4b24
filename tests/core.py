"""The C core's functions, called one by one through build/lib/libpenumbra.so (cffi, ABI mode), or
through libpenumbra-float64.so."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cffi
import numpy as np

from penumbra.compare.run.library import opened, read_by_c


@dataclass(frozen=True)
class Core:
    """The core in one precision: its types and its functions."""

    ffi: cffi.FFI
    library: Any
    dtype: type[np.floating[Any]]
    """what C calls real"""

    def read_scene(self, file: Path) -> Any:
        return read_by_c(file, "float32" if self.dtype is np.float32 else "float64")


ffi = opened("float32")[0]


def library() -> Any:
    return opened("float32")[1]


@cache
def core(precision: str) -> Core:
    """precision: "float32" or "float64"."""
    return Core(*opened(precision), np.float32 if precision == "float32" else np.float64)
