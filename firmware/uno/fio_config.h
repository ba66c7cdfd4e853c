/* Arduino Uno and Nano, ATmega328P at 16 MHz. */
#ifndef FIO_CONFIG_H
#define FIO_CONFIG_H

#define FIO_TB6612 1 /* PWM, IN1, IN2, STBY */
#define FIO_L298N 2  /* PWM on ENA, IN1, IN2 */
#define FIO_IN_IN 3  /* DRV8833 and its like: PWM on IN1 and IN2 */

/* The bridge that is wired to the board: change it here in the Arduino IDE, or with make BRIDGE=l298n. */
#ifndef FIO_BRIDGE
#define FIO_BRIDGE FIO_TB6612
#endif

#define FIO_BOARD_NAME "uno"
#define FIO_STEPS_PER_PCT 8u /* 16 MHz / 20 kHz = 800 timer counts */
#define FIO_COUNTS_PER_REV 720u

#endif
