#include "bridge.h"

#define LOW 0u
#define HIGH FIO_STEPS

struct fio_lines fio_bridge_lines(uint8_t c3, uint8_t c4, uint16_t duty)
{
    struct fio_lines lines = {c3 ? HIGH : LOW, c4 ? HIGH : LOW, HIGH};
#if FIO_BRIDGE == FIO_IN_IN
    if (c3 && !c4)
        lines.in2 = (uint16_t)(HIGH - duty);
    else if (c4 && !c3)
        lines.in1 = (uint16_t)(HIGH - duty);
#else
    if (c3 != c4)
        lines.pwm = duty;
#if FIO_BRIDGE == FIO_L298N
    else if (!c3)
        lines.pwm = LOW;
#endif
#endif
    return lines;
}
