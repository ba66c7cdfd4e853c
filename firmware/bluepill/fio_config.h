/* Blue Pill, STM32F103C8 at 72 MHz. */
#ifndef FIO_CONFIG_H
#define FIO_CONFIG_H

#define FIO_TB6612 1 /* PWM, IN1, IN2, STBY */
#define FIO_L298N 2  /* PWM on ENA, IN1, IN2 */
#define FIO_IN_IN 3  /* DRV8833 and its like: PWM on IN1 and IN2 */

/* The bridge that is wired to the board: make BRIDGE=l298n chooses another. */
#ifndef FIO_BRIDGE
#define FIO_BRIDGE FIO_TB6612
#endif

#define FIO_BOARD_NAME "bluepill"
#define FIO_STEPS_PER_PCT 36u /* 72 MHz / 20 kHz = 3600 timer counts */
#define FIO_COUNTS_PER_REV 720u

#endif
