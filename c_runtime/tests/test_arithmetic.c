/* Rounding, shifting and limiting: hand-worked values at the halves, signs and ends. */
#include "check.h"
#include "zd_runtime.h"

static void check_shifts_floor(void) {
    CHECK_EQUAL(zd_asr32(7, 1), 3);
    CHECK_EQUAL(zd_asr32(-7, 1), -4);
    CHECK_EQUAL(zd_asr32(-1, 31), -1);
    CHECK_EQUAL(zd_asr32(INT32_MIN, 31), -1);
    CHECK_EQUAL(zd_asr32(INT32_MAX, 0), INT32_MAX);
    CHECK_EQUAL(zd_asr64(-1, 63), -1);
    CHECK_EQUAL(zd_asr64(INT64_MIN, 62), -2);
    CHECK_EQUAL(zd_asr64(INT64_MAX, 62), 1);
}

static void check_rounding_takes_halves_up(void) {
    /* x / 2: -1.5 -> -1, -0.5 -> 0, 0.5 -> 1, 1.5 -> 2 */
    const int64_t rounded[7] = {-1, -1, 0, 0, 1, 1, 2};
    for (int32_t x = -3; x <= 3; x++) {
        CHECK_EQUAL(zd_round_shift64(x, 1), rounded[x + 3]);
    }
    CHECK_EQUAL(zd_round_shift64(-5, 0), -5);
    CHECK_EQUAL(zd_round_shift64(6, 2), 2);   /*  1.50 */
    CHECK_EQUAL(zd_round_shift64(-6, 2), -1); /* -1.50 */
    CHECK_EQUAL(zd_round_shift64(5, 2), 1);   /*  1.25 */
    CHECK_EQUAL(zd_round_shift64(-7, 2), -2); /* -1.75 */
    /* The largest x that the precondition |x| < 2^63 - 2^(shift - 1) admits. */
    CHECK_EQUAL(zd_round_shift64(INT64_MAX - ((int64_t)1 << 61), 62), 1);
    CHECK_EQUAL(zd_round_shift64(-INT64_MAX + ((int64_t)1 << 61), 62), -1);
    CHECK_EQUAL(zd_round_shift64(((int64_t)1 << 61) - 1, 62), 0);
    CHECK_EQUAL(zd_round_shift64((int64_t)1 << 61, 62), 1);
}

static void check_mul_high(void) {
    CHECK_EQUAL(zd_mul_high(1 << 16, 1 << 15), 1);     /* 2^31 / 2^32 = 0.5, halves up */
    CHECK_EQUAL(zd_mul_high(-(1 << 16), 1 << 15), 0);  /* -0.5 */
    CHECK_EQUAL(zd_mul_high(-(1 << 16), 3 << 15), -1); /* -1.5 */
    CHECK_EQUAL(zd_mul_high(1 << 16, (1 << 15) - 1), 0);
    CHECK_EQUAL(zd_mul_high(INT32_MAX, INT32_MAX), (1 << 30) - 1);  /* 2^30 - 1 + 2^-32 */
    CHECK_EQUAL(zd_mul_high(INT32_MIN, INT32_MAX), -(1 << 30) + 1); /* -2^30 + 0.5, up */
    CHECK_EQUAL(zd_mul_high(INT32_MAX, INT32_MIN), -(1 << 30) + 1);
    CHECK_EQUAL(zd_mul_high(0, INT32_MIN), 0);
}

static void check_clamps(void) {
    CHECK_EQUAL(zd_clamp32(5, -3, 3), 3);
    CHECK_EQUAL(zd_clamp32(-5, -3, 3), -3);
    CHECK_EQUAL(zd_clamp32(3, -3, 3), 3);
    CHECK_EQUAL(zd_clamp32(INT32_MIN, -3, 3), -3);
    CHECK_EQUAL(zd_clamp32(INT32_MAX, INT32_MIN, INT32_MAX), INT32_MAX);
    CHECK_EQUAL(zd_clamp64(INT64_MAX, INT32_MIN, INT32_MAX), INT32_MAX);
    CHECK_EQUAL(zd_clamp64(INT64_MIN, INT32_MIN, INT32_MAX), INT32_MIN);
    CHECK_EQUAL(zd_clamp64(-7, -8, 8), -7);
}

int main(void) {
    check_shifts_floor();
    check_rounding_takes_halves_up();
    check_mul_high();
    check_clamps();
    return check_report("arithmetic");
}
