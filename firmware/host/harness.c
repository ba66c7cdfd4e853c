/* The core fed with whatever comes on standard input; what it made of it goes to standard output, a line each:
 *
 *   C sequence duty c3 c4    a command was found        (all modes)
 *   Q                        a query was found
 *   L in1 in2 pwm            lines of a task step       (with an argument: a step after so many bytes)
 *   R hex...                 bytes of its report
 *   E bad                    at the end: frames refused
 */
#include <stdio.h>
#include <stdlib.h>

#include "board.h"
#include "quadrature.h"

static void step(struct fio_board *board)
{
    uint8_t out[FIO_OUT_BYTES];
    struct fio_lines lines = fio_board_latch(board);
    if (lines.in1 > FIO_STEPS || lines.in2 > FIO_STEPS || lines.pwm > FIO_STEPS)
        abort();
    printf("L %u %u %u\nR ", lines.in1, lines.in2, lines.pwm);
    uint8_t count = fio_board_report(board, board->tick & 1, (uint16_t)(board->tick % FIO_COUNTS_PER_REV), 7, out);
    for (uint8_t i = 0; i < count; i++)
        printf("%02x", out[i]);
    printf("\n");
}

int main(int arguments, char **words)
{
    struct fio_board board;
    struct fio_parser parser = {0};
    unsigned long every = arguments > 1 ? strtoul(words[1], 0, 10) : 0, taken = 0;
    int byte;

    fio_board_init(&board);
    while ((byte = getchar()) != EOF) {
        uint8_t found = fio_parser_feed(&parser, (uint8_t)byte);
        if (parser.length >= FIO_COMMAND_BYTES)
            abort(); /* a whole one is never held */
        fio_board_receive(&board, (uint8_t)byte);
        if (found & FIO_FOUND_QUERY)
            printf("Q\n");
        if (found & FIO_FOUND_COMMAND)
            printf("C %u %u %u %u\n", parser.command.sequence, parser.command.duty, parser.command.c3, parser.command.c4);
        if (every && ++taken % every == 0)
            step(&board);
    }
    printf("E %u\n", parser.refused);
    for (uint8_t change = 0; change < 16; change++)
        printf("D %d\n", fio_quadrature(change >> 2, change & 3));
    return 0;
}
