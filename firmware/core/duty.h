/* The duty of a command, a 32-bit float in percent, as timer counts: whole numbers only, no float code needed. */
#ifndef FIO_DUTY_H
#define FIO_DUTY_H

#include <stdint.h>

#include "fio_config.h"

#define FIO_STEPS (100u * FIO_STEPS_PER_PCT) /* timer counts of a PWM period */

/* The whole part of FIO_STEPS_PER_PCT times the duty whose float has these bits.
 * Returns 0, and leaves *counts alone, for what is no duty: negative, above 100, infinite, not a number. */
uint8_t fio_duty_counts(uint32_t bits, uint16_t *counts);

#endif
