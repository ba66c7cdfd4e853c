#include "board.h"

static void brake(struct fio_board *board)
{
    board->command.duty = 0;
    board->command.c3 = board->command.c4 = 1;
}

void fio_board_init(struct fio_board *board)
{
    static const struct fio_board blank;
    *board = blank;
    board->silent_steps = FIO_WATCHDOG_STEPS;
    brake(board);
}

void fio_board_receive(struct fio_board *board, uint8_t byte)
{
    uint8_t found = fio_parser_feed(&board->parser, byte);
    if (found & FIO_FOUND_COMMAND)
        board->fresh = 1; /* an older one that no step has taken is passed over */
    if (found & FIO_FOUND_QUERY)
        board->asked = 1;
}

struct fio_lines fio_board_latch(struct fio_board *board)
{
    if (board->fresh) {
        board->command = board->parser.command;
        board->fresh = 0;
        board->silent_steps = 0;
    } else if (board->silent_steps < FIO_WATCHDOG_STEPS && ++board->silent_steps == FIO_WATCHDOG_STEPS) {
        brake(board);
    }
    return fio_bridge_lines(board->command.c3, board->command.c4, board->command.duty);
}

uint8_t fio_board_report(struct fio_board *board, uint8_t direction, uint16_t pos, uint16_t bad_edges, uint8_t *out)
{
    fio_report(out, board->tick++, direction, pos);
    if (!board->asked)
        return FIO_REPORT_BYTES;
    board->asked = 0;
    fio_answer(out + FIO_REPORT_BYTES, board->parser.refused, bad_edges);
    return FIO_OUT_BYTES;
}
