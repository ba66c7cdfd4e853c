/* A quadrature decoder in software, for chips whose timers have none. Levels are A + 2 B; counting up A leads B. */
#ifndef FIO_QUADRATURE_H
#define FIO_QUADRATURE_H

#include <stdint.h>

/* 1 up, -1 down, 0 nothing, FIO_BAD_EDGE where both levels changed: nobody can tell which way. */
#define FIO_BAD_EDGE 2

static inline int8_t fio_quadrature(uint8_t before, uint8_t after)
{
    uint8_t changed = before ^ after;
    if (changed == 0)
        return 0;
    if (changed == 3)
        return FIO_BAD_EDGE;
    /* a change of one level counts up where A before differs from B after */
    return ((before ^ (after >> 1)) & 1) ? -1 : 1;
}

#endif
