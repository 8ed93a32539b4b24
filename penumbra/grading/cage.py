"""Where a submitted program runs, and what it may use up there."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """What a build, or one run of a program, may use."""

    seconds: float = 60.0
    """wall time [s]"""
    memory: int = 2 << 30
    """of all its processes together [bytes]"""
    processes: int = 64
    """with their threads"""
    file_size: int = 64 << 20
    """each file [bytes]"""
    disk: int = 256 << 20
    """all that it writes [bytes]"""
    output: int = 1 << 20
    """what it prints [bytes]"""
