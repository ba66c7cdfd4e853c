"""The board's machine solved again: scipy's ``solve_ivp`` with event location at tight tolerance.

Written from the equations in the effects' own words; of the package under test it takes only the plant's constants.
"""

from .machine import Reference, State

__all__ = ["Reference", "State"]
