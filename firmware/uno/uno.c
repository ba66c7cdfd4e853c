/* Arduino Uno and Nano (ATmega328P, 16 MHz): the registers of the board.
 *
 *   D0, D1   serial line, 500 kBd (the USB cable)
 *   D2, D3   encoder A, B (pull-ups on)
 *   D8, D10  IN1, IN2 of the bridge; with FIO_IN_IN it is D9, D10
 *   D9       PWM, 20 kHz, 800 steps (TB6612: PWM, L298N: ENA)
 *   D12      enable (TB6612: STBY, DRV8833: nSLEEP), high once the lines say brake
 *   D13      the LED: high while the task runs
 */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>

#include "board.h"
#include "quadrature.h"

#define ENCODER 0x0Cu /* PD2, PD3 */
#define ENABLE 0x10u
#define LED 0x20u
#if FIO_BRIDGE == FIO_IN_IN
#define IN1 0x02u
#define IN2 0x04u
#define PWM 0x00u
#else
#define IN1 0x01u
#define PWM 0x02u
#define IN2 0x04u
#endif
#define OUTPUTS (IN1 | IN2 | PWM | ENABLE | LED)

/* GPIOR0, reached in one instruction: bits 0 and 1 the encoder's levels seen last, bit 2 its direction. */
#define SEEN GPIOR0
#define LEVELS 0x03u
#define DOWN 0x04u

static volatile uint16_t edges; /* counted up and down, wraps at 65536 */
static volatile uint16_t bad_edges;
static volatile uint8_t ticks; /* milliseconds */

static volatile uint8_t ring[256]; /* bytes that came; a line at 500 kBd brings 250 in a step */
static volatile uint8_t ring_in;

static inline uint8_t levels(void)
{
    uint8_t port = PIND;
    port >>= 2;
    return port & LEVELS;
}

ISR(INT0_vect)
{
    uint8_t seen = SEEN, now = levels();
    int8_t way = fio_quadrature(seen & LEVELS, now);
    if (way == 1) {
        SEEN = now;
        edges++;
    } else if (way == -1) {
        SEEN = now | DOWN;
        edges--;
    } else if (way != 0) {
        SEEN = now | (seen & DOWN);
        if (bad_edges < 0xFFFF)
            bad_edges++;
    }
}

ISR(INT1_vect, ISR_ALIASOF(INT0_vect));

ISR(USART_RX_vect)
{
    ring[ring_in++] = UDR0; /* a ring that is full loses what is in it: the CRC tells */
}

ISR(TIMER2_COMPA_vect)
{
    ticks++;
}

#if FIO_BRIDGE == FIO_IN_IN
static void put_oc1b(uint16_t counts)
{
    if (counts == 0) {
        TCCR1A &= (uint8_t)~_BV(COM1B1);
        return;
    }
    OCR1B = counts - 1;
    TCCR1A |= _BV(COM1B1);
}
#endif

/* The line at OC1A: fast PWM is high for OCR1A + 1 counts, so that nothing at all needs the pin as a plain one, low. */
static void put_oc1a(uint16_t counts)
{
    if (counts == 0) {
        TCCR1A &= (uint8_t)~_BV(COM1A1);
        return;
    }
    OCR1A = counts - 1;
    TCCR1A |= _BV(COM1A1);
}

static void put(const struct fio_lines *lines)
{
#if FIO_BRIDGE == FIO_IN_IN
    put_oc1a(lines->in1);
    put_oc1b(lines->in2);
#else
    uint8_t port = PORTB & (uint8_t)~(IN1 | IN2);
    if (lines->in1)
        port |= IN1;
    if (lines->in2)
        port |= IN2;
    PORTB = port; /* both at once */
    put_oc1a(lines->pwm);
#endif
}

static void begin(const struct fio_lines *lines)
{
    /* Before any pin drives: until here the bridge is off by its pull-downs. */
    ICR1 = FIO_STEPS - 1;
    TCCR1A = _BV(WGM11);
    TCCR1B = _BV(WGM13) | _BV(WGM12) | _BV(CS10); /* fast PWM up to ICR1, 16 MHz */
    put(lines);
    DDRB |= OUTPUTS;
    PORTB |= ENABLE;

    PORTD |= ENCODER | 0x01u; /* pull-ups on the encoder and on the serial input */
    EICRA = _BV(ISC00) | _BV(ISC10);
    EIFR = _BV(INTF0) | _BV(INTF1);
    EIMSK = _BV(INT0) | _BV(INT1);
    SEEN = levels();

    UCSR0A = _BV(U2X0);
    UBRR0 = 3; /* 16 MHz / (8 (3 + 1)) = 500 kBd */
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXCIE0) | _BV(RXEN0) | _BV(TXEN0);

    TCCR2A = _BV(WGM21);
    OCR2A = 249; /* 16 MHz / 64 / 250 = 1 kHz */
    TCCR2B = _BV(CS22);
    TIMSK2 = _BV(OCIE2A);

    ADCSRA = 0;
    PRR = _BV(PRADC) | _BV(PRTWI) | _BV(PRSPI) | _BV(PRTIM0);
}

/* The count within a turn, from the edges since the step before: no division is needed. */
static uint16_t turn(uint16_t pos, int16_t passed)
{
    int32_t at = (int32_t)pos + passed;
    while (at < 0)
        at += FIO_COUNTS_PER_REV;
    while (at >= (int32_t)FIO_COUNTS_PER_REV)
        at -= FIO_COUNTS_PER_REV;
    return (uint16_t)at;
}

int main(void)
{
    static struct fio_board board;
    static uint8_t out[FIO_OUT_BYTES];
    uint8_t out_at = 0, out_end = 0, ring_out = 0;
    uint16_t pos = 0, counted = 0;

    cli();
    fio_board_init(&board);
    struct fio_lines lines = fio_board_latch(&board);
    begin(&lines);
    set_sleep_mode(SLEEP_MODE_IDLE);
    sei();

    for (;;) {
        while (ring_out != ring_in)
            fio_board_receive(&board, ring[ring_out++]);
        if (ticks >= FIO_STEP_MS) {
            PORTB |= LED;
            cli();
            ticks -= FIO_STEP_MS;
            sei();
            lines = fio_board_latch(&board);
            put(&lines);
            cli();
            uint16_t now = edges, bad = bad_edges;
            uint8_t down = SEEN & DOWN ? 1 : 0;
            sei();
            pos = turn(pos, (int16_t)(now - counted));
            counted = now;
            out_end = fio_board_report(&board, down, pos, bad, out);
            out_at = 0;
            PORTB &= (uint8_t)~LED;
        }
        if (out_at < out_end) {
            if (UCSR0A & _BV(UDRE0))
                UDR0 = out[out_at++];
            continue;
        }
        cli();
        if (ring_out == ring_in && ticks < FIO_STEP_MS) {
            sleep_enable();
            sei(); /* the instruction after it still runs before any interrupt */
            sleep_cpu();
            sleep_disable();
        } else {
            sei();
        }
    }
}
