"""Boards that there is firmware for: which programs ship, and how they get onto the board."""
