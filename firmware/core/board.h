/* The board without its registers: the newest command, the watchdog, one report a task step.
 *
 * A port calls fio_board_receive for each byte that came, and every FIO_STEP_MS
 *     lines = fio_board_latch(&board);          put these lines out,
 *     count = fio_board_report(&board, ...);    send these bytes.
 */
#ifndef FIO_BOARD_H
#define FIO_BOARD_H

#include <stdint.h>

#include "bridge.h"
#include "frame.h"

#define FIO_VERSION_MAJOR 0
#define FIO_VERSION_MINOR 1
#define FIO_VERSION_PATCH 0

#define FIO_STEP_MS 5u
#define FIO_WATCHDOG_MS 100u
#define FIO_WATCHDOG_STEPS (FIO_WATCHDOG_MS / FIO_STEP_MS)
#define FIO_OUT_BYTES (FIO_REPORT_BYTES + FIO_ANSWER_BYTES)

struct fio_board {
    struct fio_parser parser;
    struct fio_command command; /* that acts; braked at boot and by the watchdog */
    uint32_t tick;
    uint8_t fresh;        /* a command came since the last step */
    uint8_t asked;        /* a query came since the last step */
    uint8_t silent_steps; /* since the last command, up to FIO_WATCHDOG_STEPS */
};

void fio_board_init(struct fio_board *board);

void fio_board_receive(struct fio_board *board, uint8_t byte);

/* Begin a task step: take the newest command, or brake where none came for FIO_WATCHDOG_MS. */
struct fio_lines fio_board_latch(struct fio_board *board);

/* End the task step: bytes to send, at most FIO_OUT_BYTES; returns how many. */
uint8_t fio_board_report(struct fio_board *board, uint8_t direction, uint16_t pos, uint16_t bad_edges, uint8_t *out);

#endif
