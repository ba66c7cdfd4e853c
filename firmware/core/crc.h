/* CRC-16/CCITT-FALSE: polynomial 1021, initial value FFFF, not reflected (docs/protocol.md). */
#ifndef FIO_CRC_H
#define FIO_CRC_H

#include <stdint.h>

uint16_t fio_crc16(const uint8_t *bytes, uint8_t count);

#endif
