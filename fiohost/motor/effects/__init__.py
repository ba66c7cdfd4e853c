"""The library of effects: one file each, or a family of close relatives. Each module lists its own in ``EFFECTS``."""
