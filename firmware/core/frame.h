/* Frames of the layout serial-framed (docs/protocol.md): commands found in a stream of bytes, reports made. */
#ifndef FIO_FRAME_H
#define FIO_FRAME_H

#include <stdint.h>

#define FIO_COMMAND_BYTES 12u
#define FIO_REPORT_BYTES 13u
#define FIO_QUERY_BYTES 4u
#define FIO_ANSWER_BYTES 40u

#define FIO_FOUND_COMMAND 1u
#define FIO_FOUND_QUERY 2u

struct fio_command {
    uint16_t sequence;
    uint16_t duty; /* timer counts */
    uint8_t c3, c4;
};

/* Takes bytes as they come. What begins like a frame and is none costs its first byte only: the search goes on behind
 * it, so that a frame hidden behind a false header is found. */
struct fio_parser {
    uint8_t held[FIO_COMMAND_BYTES];
    uint8_t length;
    uint16_t refused;           /* whole frames that were none: CRC, duty or direction bits; stays at 65535 */
    struct fio_command command; /* the last one found */
};

/* Returns FIO_FOUND_COMMAND, FIO_FOUND_QUERY, both or 0. A byte completes one command at most. */
uint8_t fio_parser_feed(struct fio_parser *parser, uint8_t byte);

/* Telemetry of one task step, FIO_REPORT_BYTES long. */
void fio_report(uint8_t *out, uint32_t tick, uint8_t direction, uint16_t pos);

/* Who the board is, FIO_ANSWER_BYTES long; *bad_edges* are transitions of the encoder that cannot be. */
void fio_answer(uint8_t *out, uint16_t refused, uint16_t bad_edges);

#endif
