#include "duty.h"

#define SIGN 0x80000000u
#define HUNDRED 0x42C80000u /* 100.0; the bits of positive floats order as the floats do, infinity and NaN last */

uint8_t fio_duty_counts(uint32_t bits, uint16_t *counts)
{
    if (bits == SIGN)
        bits = 0; /* minus zero */
    if (bits > HUNDRED)
        return 0;
    /* value = mantissa * 2^(exponent - 150), so the product is shifted right by 17 (at 100) or more */
    uint8_t exponent = (uint8_t)(bits >> 23);
    uint8_t shift = (uint8_t)(150 - exponent);
    uint32_t product = ((bits & 0x7FFFFFu) | 0x800000u) * FIO_STEPS_PER_PCT; /* below 2^24 * 36 < 2^32 */
    *counts = exponent == 0 || shift > 31 ? 0 : (uint16_t)(product >> shift);
    return 1;
}
