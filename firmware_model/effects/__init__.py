"""The effects a simulated plant can have: one file each, every one giving its ``EFFECT``."""
