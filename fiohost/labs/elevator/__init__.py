"""The elevator of the control lab appendix, section D-2: seven floors, a car that hangs on the drum, two buttons."""
