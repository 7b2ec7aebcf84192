/* The low-pass by hand, and a time constant at which a 32-bit filter would stand still. */
#include "check.h"
#include "zd_runtime.h"

#define ONE (INT64_C(1) << 24) /* 1 LSB of x in v and y */

/* a = 1/2 (m = 2^30, shift = 31 - 22), c = 0: y is half way to the previous input each step. */
static void check_half_steps(void) {
    int64_t v = zd_lowpass_rest(0, 0);
    CHECK_EQUAL(v, 0);
    CHECK_EQUAL(zd_lowpass(&v, 1, 0, 1 << 30, 9), 0); /* y = 0, v = 1/2 */
    CHECK_EQUAL(v, ONE / 2);
    CHECK_EQUAL(zd_lowpass(&v, 1, 0, 1 << 30, 9), 1); /* y = 1/2, halves up; v = 3/4 */
    CHECK_EQUAL(v, 3 * (ONE / 4));
    CHECK_EQUAL(zd_lowpass(&v, -1, 0, 1 << 30, 9), 1); /* y = 3/4, v = 3/4 - 7/8 = -1/8 */
    CHECK_EQUAL(v, -(ONE / 8));
    CHECK_EQUAL(zd_lowpass(&v, -1, 0, 1 << 30, 9), 0); /* y = -1/8 */
}

/* c = 1/4: a quarter of the present input is seen at once. */
static void check_straight_line_term(void) {
    int64_t v = zd_lowpass_rest(4, 1 << 22);
    CHECK_EQUAL(v, 3 * ONE);                                 /* 4 (1 - 1/4) */
    CHECK_EQUAL(zd_lowpass(&v, 4, 1 << 22, 1 << 30, 9), 4);  /* at rest y = x */
    CHECK_EQUAL(v, 3 * ONE);                                 /* and nothing moves */
    CHECK_EQUAL(zd_lowpass(&v, 12, 1 << 22, 1 << 30, 9), 6); /* y = 3 + 12/4 */
    CHECK_EQUAL(v, 6 * ONE);                                 /* 3 + (12 - 6)/2 */
}

static void check_rest_at_the_rails(void) {
    const int32_t ends[2] = {-32768 * 4096, 32767 * 4096};
    for (uint32_t i = 0; i < 2u; i++) {
        int64_t v = zd_lowpass_rest(ends[i], 7654321);
        CHECK_EQUAL(zd_lowpass(&v, ends[i], 7654321, 2000000000, 12), ends[i]);
        CHECK_EQUAL(v, zd_lowpass_rest(ends[i], 7654321));
    }
}

/* tau = 10 h at 10 ms: a = 1 - exp(-0.01 / 36000) = 1250999723 2^-52, c = a / 2 = 2 2^-24. A step
 * of 8 LSB, 15 millionths of a kelvin, is at 1 - 1/e = 63.212 % of itself one tau later. */
static void check_slow_filter_does_not_stall(void) {
    int64_t v = zd_lowpass_rest(0, 2);
    for (uint32_t step = 0; step < 3600000u; step++) {
        (void)zd_lowpass(&v, 8, 2, 1250999723, 30);
    }
    const int64_t y = v + (8 * 2);
    CHECK(y > (8 * ONE * 62) / 100);
    CHECK(y < (8 * ONE * 64) / 100);
}

int main(void) {
    check_half_steps();
    check_straight_line_term();
    check_rest_at_the_rails();
    check_slow_filter_does_not_stall();
    return check_report("lowpass");
}
