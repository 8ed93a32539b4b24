"""Soft shadows, rendered, referenced, compared and explained: a course toolkit."""
