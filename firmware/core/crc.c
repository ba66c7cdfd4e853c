#include "crc.h"

/* Byte by byte without a table: the eight steps of the division by 11021 (hex) folded into shifts. */
uint16_t fio_crc16(const uint8_t *bytes, uint8_t count)
{
    uint16_t crc = 0xFFFF;
    while (count--) {
        uint8_t high = (uint8_t)(crc >> 8) ^ *bytes++;
        high ^= high >> 4;
        crc = (uint16_t)((uint16_t)(crc << 8) ^ ((uint16_t)high << 12) ^ ((uint16_t)high << 5) ^ high);
    }
    return crc;
}
