/* An ATmega328P run by simavr in lock step: built into a shared library on the machine that has simavr, and loaded
 * with ctypes by avr.py. Link with -lsimavr -lelf. No register of the firmware is known here, only the chip's.
 *
 * Time is the chip's cycle. Encoder levels and serial bytes are scheduled with simavr's own cycle timers, so that a
 * sleeping core wakes at the right one. avr_lines_run stops early where an output changed. */
#include <stdarg.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <simavr/avr_extint.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>

/* Data addresses of the ATmega328P (datasheet, register summary). */
enum { PORTB = 0x25, DDRB = 0x24, PORTD = 0x2B, TCCR1A = 0x80, TCCR1B = 0x81, ICR1 = 0x86, OCR1A = 0x88, OCR1B = 0x8A };
enum { LED = 0x20, ENCODER_FIRST = 2 };
enum { SETTLE = 40, UART_HOLDS = 2, BAUD_REGISTERS = 0xC0 };

struct lines {
    avr_t *avr;
    avr_uart_t *uart;
    uint64_t *edge_at;
    uint8_t *edge_levels;
    int edges, edge;
    uint8_t levels, port_d;
    uint8_t *in;
    int ins, in_at;
    uint32_t in_cycles;
    uint8_t out[4096];
    int outs;
    uint8_t image[16], led;
    uint64_t led_since, dark_since;
    uint64_t stats[5]; /* longest task, longest time with interrupts off, bytes overrun, wakes of the task, instructions */
};

static void quiet(avr_t *avr, const int level, const char *format, va_list ap)
{
}

static void no_sleep(avr_t *avr, avr_cycle_count_t how_long)
{
}

static avr_cycle_count_t nothing(avr_t *avr, avr_cycle_count_t when, void *param)
{
    return 0;
}

static void drive(struct lines *s)
{
    avr_irq_t *pins = avr_io_getirq(s->avr, AVR_IOCTL_IOPORT_GETIRQ('D'), 0);
    avr_ioport_external_t held = {.name = 'D', .mask = 3 << ENCODER_FIRST, .value = s->levels << ENCODER_FIRST};
    avr_ioctl(s->avr, AVR_IOCTL_IOPORT_SET_EXTERNAL('D'), &held);
    for (int i = 0; i < 2; i++)
        avr_raise_irq(pins + ENCODER_FIRST + i, s->levels >> i & 1);
}

static avr_cycle_count_t next_edge(avr_t *avr, avr_cycle_count_t when, void *param)
{
    struct lines *s = param;
    while (s->edge < s->edges && s->edge_at[s->edge] <= avr->cycle) {
        s->levels = s->edge_levels[s->edge++];
        drive(s);
    }
    return s->edge < s->edges ? s->edge_at[s->edge] : 0;
}

static avr_cycle_count_t next_byte(avr_t *avr, avr_cycle_count_t when, void *param)
{
    struct lines *s = param;
    int held = (s->uart->input.write - s->uart->input.read + 64) % 64;
    if (held > UART_HOLDS) { /* its two bytes and the one in the shift register */
        s->stats[2]++;
    } else {
        avr_cycle_count_t usual = s->uart->cycles_per_byte;
        s->uart->cycles_per_byte = 1; /* the time of the byte has passed already */
        avr_raise_irq(s->uart->io.irq + UART_IRQ_INPUT, s->in[s->in_at]);
        s->uart->cycles_per_byte = usual;
    }
    return ++s->in_at < s->ins ? when + s->in_cycles : 0;
}

static void byte_out(avr_irq_t *irq, uint32_t value, void *param)
{
    struct lines *s = param;
    if (s->outs < (int)sizeof s->out)
        s->out[s->outs++] = value;
}

static void image(const struct lines *s, uint8_t *into)
{
    static const uint8_t bytes[] = {DDRB, TCCR1A, TCCR1B, ICR1, ICR1 + 1, OCR1A, OCR1A + 1, OCR1B, OCR1B + 1};
    *into++ = s->avr->data[PORTB] & ~LED;
    for (unsigned i = 0; i < sizeof bytes; i++)
        *into++ = s->avr->data[bytes[i]];
}

void *avr_lines_new(const uint8_t *code, uint32_t size)
{
    avr_global_logger_set(quiet);
    avr_t *avr = avr_make_mcu_by_name("atmega328p");
    if (!avr)
        return NULL;
    struct lines *s = calloc(1, sizeof *s);
    s->avr = avr;
    avr_init(avr);
    avr->frequency = 16000000;
    avr->sleep = no_sleep;
    avr->run_cycle_limit = 1; /* one instruction at a time: outputs are seen at their cycle */
    uint8_t *copy = malloc(size);
    memcpy(copy, code, size);
    avr_loadcode(avr, copy, size, 0);
    free(copy);
    avr->codeend = avr->flashend;
    for (avr_io_t *io = avr->io_port; io; io = io->next)
        if (!strcmp(io->kind, "uart"))
            s->uart = (avr_uart_t *)io;
    if (!s->uart)
        return NULL;
    uint32_t flags = 0; /* neither text to the terminal nor naps of the host */
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_register_notify(s->uart->io.irq + UART_IRQ_OUTPUT, byte_out, s);
    for (int i = 0; i < 2; i++)
        avr_extint_set_strict_lvl_trig(avr, i, 0); /* a low pin before EICRA is set would interrupt without end */
    drive(s);
    image(s, s->image);
    return s;
}

void avr_lines_free(void *handle)
{
    struct lines *s = handle;
    avr_terminate(s->avr);
    free(s->edge_at);
    free(s->edge_levels);
    free(s->in);
    free(s);
}

/* Run to the cycle *until*, or to where an output changed and was then quiet for a while. Returns the cycle reached, 0
 * where the program crashed. */
uint64_t avr_lines_run(void *handle, uint64_t until)
{
    struct lines *s = handle;
    avr_t *avr = s->avr;
    uint64_t changed = 0;
    uint8_t now[16] = {0};
    avr_cycle_timer_cancel(avr, nothing, s);
    if (until > avr->cycle)
        avr_cycle_timer_register(avr, until - avr->cycle, nothing, s);
    while (avr->cycle < until || changed) {
        int state = avr_run(avr);
        s->stats[4]++;
        if (state == cpu_Crashed || state == cpu_Done)
            return 0;
        if (avr->sreg[S_I]) {
            if (s->dark_since && avr->cycle - s->dark_since > s->stats[1])
                s->stats[1] = avr->cycle - s->dark_since;
            s->dark_since = 0;
        } else if (!s->dark_since && s->stats[3]) {
            s->dark_since = avr->cycle;
        }
        uint8_t led = avr->data[PORTB] & LED;
        if (led && !s->led) {
            s->led_since = avr->cycle;
            s->stats[3]++;
        } else if (!led && s->led && avr->cycle - s->led_since > s->stats[0]) {
            s->stats[0] = avr->cycle - s->led_since;
        }
        s->led = led;
        if (avr->data[PORTD] != s->port_d) { /* a write there lets simavr forget what drives the pins from outside */
            s->port_d = avr->data[PORTD];
            drive(s);
        }
        image(s, now);
        if (memcmp(now, s->image, sizeof now)) {
            memcpy(s->image, now, sizeof now);
            changed = avr->cycle + SETTLE; /* 16-bit registers are written in two halves, lines one by one */
        }
        if (changed && avr->cycle >= changed)
            break;
    }
    return avr->cycle;
}

/* From now on the encoder has these levels (A + 2 B) at these cycles; what was to come is forgotten. */
void avr_lines_edges(void *handle, const uint64_t *at, const uint8_t *levels, int count)
{
    struct lines *s = handle;
    s->edge_at = realloc(s->edge_at, (count + 1) * sizeof *at);
    s->edge_levels = realloc(s->edge_levels, count + 1);
    memcpy(s->edge_at, at, count * sizeof *at);
    memcpy(s->edge_levels, levels, count);
    s->edges = count;
    s->edge = 0;
    avr_cycle_timer_cancel(s->avr, next_edge, s);
    if (count)
        avr_cycle_timer_register(s->avr, at[0] > s->avr->cycle ? at[0] - s->avr->cycle : 1, next_edge, s);
}

/* Bytes on the serial input from now on, each of so many cycles, behind those that are still to come. */
void avr_lines_send(void *handle, const uint8_t *bytes, int count, uint32_t cycles)
{
    struct lines *s = handle;
    int left = s->ins - s->in_at;
    uint8_t *all = malloc(left + count + 1);
    if (left)
        memcpy(all, s->in + s->in_at, left);
    memcpy(all + left, bytes, count);
    free(s->in);
    s->in = all;
    s->ins = left + count;
    s->in_at = 0;
    s->in_cycles = cycles;
    if (!left && count)
        avr_cycle_timer_register(s->avr, cycles, next_byte, s);
}

/* Bytes that the chip sent since the last call. */
int avr_lines_sent(void *handle, uint8_t *into)
{
    struct lines *s = handle;
    int count = s->outs;
    memcpy(into, s->out, count);
    s->outs = 0;
    return count;
}

uint8_t avr_lines_peek(void *handle, uint16_t address)
{
    return ((struct lines *)handle)->avr->data[address];
}

uint64_t avr_lines_cycle(void *handle)
{
    return ((struct lines *)handle)->avr->cycle;
}

void avr_lines_stats(void *handle, uint64_t *into, int anew)
{
    struct lines *s = handle;
    memcpy(into, s->stats, sizeof s->stats);
    if (anew)
        memset(s->stats, 0, 3 * sizeof s->stats[0]);
}
