/* CRC-32: the check value of every catalogue, and continuation. */
#include "check.h"
#include "zd_runtime.h"

int main(void) {
    const uint8_t digits[9] = {'1', '2', '3', '4', '5', '6', '7', '8', '9'};
    CHECK_EQUAL(zd_crc32(0, digits, 9), 0xCBF43926);
    CHECK_EQUAL(zd_crc32(0, digits, 0), 0);
    CHECK_EQUAL(zd_crc32(zd_crc32(0, digits, 4), &digits[4], 5), 0xCBF43926);
    /* '1' '2' '3' '4' as one word, least significant byte first */
    CHECK_EQUAL(zd_crc32(zd_crc32_word(0, 0x34333231), &digits[4], 5), 0xCBF43926);
    return check_report("crc");
}
