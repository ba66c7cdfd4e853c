"""Models and controllers for other programs: C for firmware, MATLAB scripts, python-control, FMU."""
