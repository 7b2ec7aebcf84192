/* zerodrift runtime: CRC, and a state's copy.
 * SPDX-License-Identifier: Apache-2.0; may be used under any terms beside a generated model. */
#include "zd_runtime.h"

#if ZD_RUNTIME_ID != 0xb9f9d9e0
#error "zd_runtime.c is not of the same zerodrift runtime as zd_runtime.h: copy all files again"
#endif

ZD_SHARED_CODE uint32_t zd_crc32(uint32_t crc, const uint8_t *bytes, uint32_t n) {
    uint32_t rest = ~crc;
    for (uint32_t i = 0; i < n; i++) {
        rest ^= bytes[i];
        for (uint32_t bit = 0; bit < 8u; bit++) {
            rest = (rest >> 1) ^ (0xEDB88320u & (0u - (rest & 1u)));
        }
    }
    return ~rest;
}

ZD_SHARED_CODE uint32_t zd_crc32_word(uint32_t crc, uint32_t x) {
    uint8_t bytes[4];
    for (uint32_t i = 0; i < 4u; i++) {
        bytes[i] = (uint8_t)((x >> (8u * i)) & 0xFFu);
    }
    return zd_crc32(crc, bytes, 4u);
}

ZD_SHARED_CODE uint32_t zd_crc32_i16(uint32_t crc, const int16_t *values, uint32_t n) {
    const volatile int16_t *memory = values; /* what is in the flash, not what the compiler knows */
    uint32_t next = crc;
    for (uint32_t i = 0; i < n; i++) {
        next = zd_crc32_word(next, (uint32_t)memory[i]);
    }
    return next;
}

ZD_SHARED_CODE uint32_t zd_crc32_i32(uint32_t crc, const int32_t *values, uint32_t n) {
    const volatile int32_t *memory = values; /* what is in the flash, not what the compiler knows */
    uint32_t next = crc;
    for (uint32_t i = 0; i < n; i++) {
        next = zd_crc32_word(next, (uint32_t)memory[i]);
    }
    return next;
}

static void zd_put_word(uint8_t *to, uint32_t x) {
    for (uint32_t i = 0; i < 4u; i++) {
        to[i] = (uint8_t)((x >> (8u * i)) & 0xFFu);
    }
}

ZD_SHARED_CODE void zd_save(uint8_t *saved, const uint8_t *state, uint32_t size, uint32_t identity) {
    zd_put_word(&saved[0], ZD_SAVED_VERSION);
    zd_put_word(&saved[4], identity);
    zd_put_word(&saved[8], size);
    for (uint32_t i = 0; i < size; i++) {
        saved[12u + i] = state[i];
    }
    zd_put_word(&saved[12u + size], zd_crc32(0, saved, 12u + size));
}

ZD_SHARED_CODE uint32_t zd_restore(uint8_t *state, const uint8_t *saved, uint32_t size, uint32_t identity) {
    uint8_t head[12];
    uint8_t crc[4];
    uint32_t different = 0;
    zd_put_word(&head[0], ZD_SAVED_VERSION);
    zd_put_word(&head[4], identity);
    zd_put_word(&head[8], size);
    zd_put_word(crc, zd_crc32(0, saved, 12u + size));
    for (uint32_t i = 0; i < 12u; i++) {
        different |= (uint32_t)head[i] ^ saved[i];
    }
    for (uint32_t i = 0; i < 4u; i++) {
        different |= (uint32_t)crc[i] ^ saved[12u + size + i];
    }
    if (different == 0u) {
        for (uint32_t i = 0; i < size; i++) {
            state[i] = saved[12u + i];
        }
    }
    return different;
}
