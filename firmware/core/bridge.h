/* What each line of the bridge carries for a command: the truth table, chosen when the firmware is compiled.
 *
 * High time within a PWM period, in timer counts: 0 is always low, FIO_STEPS always high, d follows the duty.
 *
 *   FIO_BRIDGE       command    in1     in2     pwm     the winding
 *   FIO_TB6612       forward    high    low     d       driven, shorted between pulses (slow decay)
 *   PWM, IN1, IN2    reverse    low     high    d       driven, shorted between pulses
 *   STBY = enable    brake      high    high    high    shorted
 *                    standby    low     low     high    open
 *   FIO_L298N        forward    high    low     d       driven, open between pulses (fast decay)
 *   PWM on ENA       reverse    low     high    d       driven, open between pulses
 *                    brake      high    high    high    shorted: both lower or both upper switches, ONLY while enabled
 *                    standby    low     low     low     open
 *   FIO_IN_IN        forward    high    N - d   high    driven, shorted between pulses (slow decay)
 *   DRV8833 and its  reverse    N - d   high    high    driven, shorted between pulses
 *   like: PWM on the brake      high    high    high    shorted
 *   inputs           standby    low     low     high    open
 *
 * N is FIO_STEPS. FIO_IN_IN needs no pwm line; nSLEEP (DRV8833) or EN (an L298N wired so) is the enable line.
 */
#ifndef FIO_BRIDGE_H
#define FIO_BRIDGE_H

#include <stdint.h>

#include "duty.h"

#if FIO_BRIDGE == FIO_TB6612
#define FIO_BRIDGE_NAME "tb6612"
#elif FIO_BRIDGE == FIO_L298N
#define FIO_BRIDGE_NAME "l298n"
#elif FIO_BRIDGE == FIO_IN_IN
#define FIO_BRIDGE_NAME "drv8833"
#else
#error "FIO_BRIDGE is FIO_TB6612, FIO_L298N or FIO_IN_IN: see fio_config.h"
#endif

struct fio_lines {
    uint16_t in1, in2, pwm;
};

/* Lines for the direction bits of a command (1 0 forward, 0 1 reverse, 1 1 brake, 0 0 standby) and its duty in counts. */
struct fio_lines fio_bridge_lines(uint8_t c3, uint8_t c4, uint16_t duty);

#endif
