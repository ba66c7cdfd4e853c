"""The problems D-1 to D-19 of the control lab appendix, answered by computation. ``catalogue`` has them all."""
