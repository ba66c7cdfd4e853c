#include "frame.h"

#include "board.h"
#include "bridge.h"
#include "crc.h"
#include "duty.h"

#define START 0xA5u
#define FRAME 0x5Au  /* second byte of commands and reports */
#define QUERY 0x3Fu  /* '?' */
#define ANSWER 0x21u /* '!' */
#define ANSWER_FORMAT 1u

static uint16_t u16_at(const uint8_t *bytes)
{
    return (uint16_t)(bytes[0] | (uint16_t)(bytes[1] << 8));
}

static uint8_t *put_u16(uint8_t *out, uint16_t value)
{
    *out++ = (uint8_t)value;
    *out++ = (uint8_t)(value >> 8);
    return out;
}

static uint8_t has_good_crc(const uint8_t *bytes, uint8_t count)
{
    return fio_crc16(bytes, (uint8_t)(count - 2)) == u16_at(bytes + count - 2);
}

/* Length of the frame that the held bytes may begin: 1 where they can begin none. */
static uint8_t wanted(const struct fio_parser *parser)
{
    if (parser->held[0] != START)
        return 1;
    if (parser->length < 2 || parser->held[1] == FRAME)
        return FIO_COMMAND_BYTES;
    return parser->held[1] == QUERY ? FIO_QUERY_BYTES : 1;
}

static void drop(struct fio_parser *parser, uint8_t count)
{
    parser->length = (uint8_t)(parser->length - count);
    for (uint8_t i = 0; i < parser->length; i++)
        parser->held[i] = parser->held[i + count];
}

static uint8_t take_command(struct fio_parser *parser)
{
    const uint8_t *held = parser->held;
    uint16_t duty;
    if (!has_good_crc(held, FIO_COMMAND_BYTES) || held[8] > 1 || held[9] > 1 ||
        !fio_duty_counts(u16_at(held + 4) | (uint32_t)u16_at(held + 6) << 16, &duty))
        return 0;
    parser->command.sequence = u16_at(held + 2);
    parser->command.duty = duty;
    parser->command.c3 = held[8];
    parser->command.c4 = held[9];
    return 1;
}

uint8_t fio_parser_feed(struct fio_parser *parser, uint8_t byte)
{
    uint8_t found = 0;
    parser->held[parser->length++] = byte;
    while (parser->length) {
        uint8_t length = wanted(parser);
        if (parser->length < length)
            break;
        if (length == FIO_COMMAND_BYTES && take_command(parser))
            found |= FIO_FOUND_COMMAND;
        else if (length == FIO_QUERY_BYTES && has_good_crc(parser->held, FIO_QUERY_BYTES))
            found |= FIO_FOUND_QUERY;
        else {
            if (length > 1 && parser->refused < 0xFFFF)
                parser->refused++;
            length = 1;
        }
        drop(parser, length);
    }
    return found;
}

void fio_report(uint8_t *out, uint32_t tick, uint8_t direction, uint16_t pos)
{
    uint8_t *at = out;
    *at++ = START;
    *at++ = FRAME;
    at = put_u16(at, (uint16_t)tick); /* a report in each step: its number is the tick's lower half */
    at = put_u16(at, (uint16_t)tick);
    at = put_u16(at, (uint16_t)(tick >> 16));
    *at++ = direction;
    at = put_u16(at, pos);
    put_u16(at, fio_crc16(out, FIO_REPORT_BYTES - 2));
}

static uint8_t *put_text(uint8_t *out, const char *text, uint8_t room)
{
    while (room--)
        *out++ = *text ? (uint8_t)*text++ : 0;
    return out;
}

void fio_answer(uint8_t *out, uint16_t refused, uint16_t bad_edges)
{
    uint8_t *at = out;
    *at++ = START;
    *at++ = ANSWER;
    *at++ = ANSWER_FORMAT;
    at = put_text(at, FIO_BOARD_NAME, 12);
    at = put_text(at, FIO_BRIDGE_NAME, 8);
    *at++ = FIO_VERSION_MAJOR;
    *at++ = FIO_VERSION_MINOR;
    *at++ = FIO_VERSION_PATCH;
    at = put_u16(at, FIO_STEPS);
    at = put_u16(at, FIO_WATCHDOG_MS);
    at = put_u16(at, FIO_COUNTS_PER_REV);
    at = put_u16(at, FIO_STEP_MS * 1000u);
    at = put_u16(at, refused);
    at = put_u16(at, bad_edges);
    put_u16(at, fio_crc16(out, FIO_ANSWER_BYTES - 2));
}
