"""Boards of machine code: an emulated microcontroller runs the firmware, the simulated motor turns on its pins.

``chip`` says what an emulator must do, ``avr`` and ``arm`` are the two there are, ``stm32f103`` the peripherals of the
second, ``wiring`` what is soldered between chip, bridge and encoder, ``board`` the lock step of all.
"""
