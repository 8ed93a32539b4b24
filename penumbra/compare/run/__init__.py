"""Renderers as commands, the C library, provenance and journals."""
