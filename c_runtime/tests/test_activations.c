/* tanh and sigmoid over every input of the table, and far beyond its ends. */
#include "check.h"
#include "zd_network.h"

#define BEYOND 5000
#define END 524288                  /* 8 in Q3.16 */
#define TOP ((1 << 30) - (1 << 15)) /* 1 - 2^-15 */

static void check_tanh_is_monotone_odd_and_saturates(void) {
    int32_t before = zd_tanh_q30(-END - BEYOND - 1);
    for (int32_t t = -END - BEYOND; t <= END + BEYOND; t++) {
        const int32_t y = zd_tanh_q30(t);
        CHECK(y >= before);
        CHECK_EQUAL(zd_tanh_q30(-t), -y);
        before = y;
    }
    CHECK_EQUAL(zd_tanh_q30(0), 0);
    CHECK_EQUAL(zd_tanh_q30(END - 1), TOP);
    CHECK_EQUAL(zd_tanh_q30(END), TOP); /* tanh(8) is not -1: nothing wraps */
    CHECK_EQUAL(zd_tanh_q30(-END), -TOP);
    CHECK_EQUAL(zd_tanh_q30(-END - 1), -TOP);
    CHECK_EQUAL(zd_tanh_q30(INT32_MAX), TOP);
    CHECK_EQUAL(zd_tanh_q30(INT32_MIN), -TOP);
}

static void check_tanh_by_hand(void) {
    /* Node k stands for k / 32. Between nodes 1 (16381) and 2 (32729), half way: 24555. */
    CHECK_EQUAL(zd_tanh_q30(2048), 16381 * 2048);
    CHECK_EQUAL(zd_tanh_q30(2048 + 1024), 24555 * 2048);
    CHECK_EQUAL(zd_tanh_q30(2048 + 1), (16381 * 2048) + (32729 - 16381));
    CHECK_EQUAL(zd_tanh_q30(-2048 - 1), (-16381 * 2048) - (32729 - 16381));
}

static void check_sigmoid_complement_is_exact(void) {
    for (int32_t t = -END - BEYOND; t <= END + BEYOND; t++) {
        const int64_t both = (int64_t)zd_sigmoid_q31(t) + zd_sigmoid_q31(-t);
        CHECK_EQUAL(both, INT64_C(1) << 31);
    }
    CHECK_EQUAL(zd_sigmoid_q31(0), 1 << 30);
    CHECK_EQUAL(zd_sigmoid_q31(INT32_MIN), 1 << 15);
    CHECK_EQUAL(zd_sigmoid_q31(INT32_MAX), INT32_MAX - (1 << 15) + 1);
}

int main(void) {
    check_tanh_is_monotone_odd_and_saturates();
    check_tanh_by_hand();
    check_sigmoid_complement_is_exact();
    return check_report("activations");
}
