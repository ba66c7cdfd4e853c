/* fiohost's firmware for the Arduino Uno and Nano, as a sketch: open, choose the board, upload.
 *
 * All of it is in the other tabs: uno.c has the registers and main, the rest is the same for every board. The bridge is
 * chosen in fio_config.h. The Arduino library is not used: setup and loop are never called.
 */
