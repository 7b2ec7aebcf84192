/* Dot products at the rails, and every length against a sum in 64 bits. */
#include "check.h"
#include "zd_runtime.h"

#define LONGEST 37u

static void check_rails(void) {
    const int16_t low[2] = {INT16_MIN, INT16_MIN};
    const int16_t high[2] = {INT16_MAX, INT16_MAX};
    const int8_t low8[2] = {INT8_MIN, INT8_MIN};
    /* -2^15 (2^15 - 1) twice: -2^31 + 2^16, the most negative sum that two products can give. */
    CHECK_EQUAL(zd_dot_i16(low, high, 2), -INT64_C(2147418112));
    CHECK_EQUAL(zd_dot_i16(high, high, 2), INT64_C(2147352578)); /* 2 (2^15 - 1)^2 */
    CHECK_EQUAL(zd_dot_i16(low, low, 1), 1 << 30);
    CHECK_EQUAL(zd_dot_i8(low8, low, 2), 1 << 23);
    CHECK_EQUAL(zd_dot_i8(low8, high, 2), -(1 << 23) + (1 << 8));
    CHECK_EQUAL(zd_dot_i16(low, high, 0), 0);
}

static void check_every_length(void) {
    int16_t w[3u * LONGEST];
    int8_t w8[3u * LONGEST];
    int16_t x[LONGEST];
    uint32_t seed = 1;
    for (uint32_t i = 0; i < (3u * LONGEST); i++) {
        seed = (seed * 1664525u) + 1013904223u;
        w[i] = (int16_t)((int32_t)(seed >> 18) - 8192);
        w8[i] = (int8_t)((int32_t)(seed >> 24) - 128);
        if (i < LONGEST) {
            x[i] = (int16_t)((int32_t)((seed >> 8) & 4095u) - 2048);
        }
    }
    for (uint32_t n = 0; n <= LONGEST; n++) {
        int64_t sum[3] = {0, 0, 0};
        int64_t sum8[3] = {0, 0, 0};
        int32_t rows[3];
        for (uint32_t row = 0; row < 3u; row++) {
            for (uint32_t i = 0; i < n; i++) {
                sum[row] += (int64_t)w[(row * n) + i] * x[i];
                sum8[row] += (int64_t)w8[(row * n) + i] * x[i];
            }
        }
        CHECK_EQUAL(zd_dot_i16(w, x, n), sum[0]);
        CHECK_EQUAL(zd_dot_i8(w8, x, n), sum8[0]);
        zd_dot3_i16(w, x, n, rows);
        for (uint32_t row = 0; row < 3u; row++) {
            CHECK_EQUAL(rows[row], sum[row]);
        }
        zd_dot3_i8(w8, x, n, rows);
        for (uint32_t row = 0; row < 3u; row++) {
            CHECK_EQUAL(rows[row], sum8[row]);
        }
    }
}

int main(void) {
    check_rails();
    check_every_length();
    return check_report("dot");
}
