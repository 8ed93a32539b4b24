"""How long a fuzz test goes on: one round in `make test`, FUZZ_SECONDS of CPU in `make stress`."""

from __future__ import annotations

import os
from collections.abc import Iterator


def cpu_seconds() -> float:
    """Of this process and of those it has waited for."""
    return sum(os.times()[:4])


def rounds(share: float = 1.0) -> Iterator[int]:
    """0, 1, 2, ... as seeds: 0 alone, or until `share` of FUZZ_SECONDS is spent; says how far."""
    budget, start, number = share * float(os.environ.get("FUZZ_SECONDS", 0)), cpu_seconds(), 0
    while number == 0 or cpu_seconds() - start < budget:
        yield number
        number += 1
    if budget:
        print(f"{number} rounds in {cpu_seconds() - start:.0f} s of CPU")
