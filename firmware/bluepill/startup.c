/* What happens before main: the vector table, and the memory as C expects it. */
#include <stddef.h>
#include <stdint.h>

extern uint32_t _data_from[], _data[], _data_end[], _bss[], _bss_end[], _stack[];

int main(void);
void reset(void);

void reset(void)
{
    uint32_t *from = _data_from;
    for (uint32_t *to = _data; to < _data_end;)
        *to++ = *from++;
    for (uint32_t *to = _bss; to < _bss_end;)
        *to++ = 0;
    main();
    for (;;)
        ;
}

/* A fault: everything stops. Timer and pins go on as they are, until the independent watchdog starts the chip anew. */
static void hang(void)
{
    for (;;)
        ;
}

__attribute__((section(".vectors"), used)) void (*const vectors[16])(void) = {
    (void (*)(void))_stack, reset, hang, hang, hang, hang, hang, 0, 0, 0, 0, hang, hang, 0, hang, hang,
};

/* The compiler may ask for these two even where there is no library. */
void *memcpy(void *to, const void *from, size_t count)
{
    uint8_t *out = to;
    const uint8_t *in = from;
    while (count--)
        *out++ = *in++;
    return to;
}

void *memset(void *to, int value, size_t count)
{
    uint8_t *out = to;
    while (count--)
        *out++ = (uint8_t)value;
    return to;
}
