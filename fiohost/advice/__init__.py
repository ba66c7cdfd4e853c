"""Advice after a diagnosis: detection limits, the next experiment, curves of what remains."""
