/* One step of the GRU, worked by hand. The table near 0 (node k stands for tanh(k / 32) in Q0.19):
 *   k     0      1      2      3      4
 *   T     0  16381  32729  49014  65205 */
#include "check.h"
#include "zd_network.h"

#define HALF_Q30 (1 << 29) /* h = 0.5: h_q15 = 16384 */

/* One unit, one feature: w_x = (0, 0, 5), w_h = (0, 0, 3), bias = (r, u, 7, 100), shift (0, 0, 2).
 */
static const int16_t w_x[3] = {0, 0, 5};
static const int16_t w_h[3] = {0, 0, 3};
static const int16_t x[1] = {2};

static zd_gru_t make_layer(const int32_t *bias) {
    const zd_gru_t layer = {w_x, w_h, 0, 0, bias, {0, 0, 2}, {0, 0, 0}};
    return layer;
}

static int32_t step_after(const int32_t *bias, int32_t h_q30, int32_t u_keep) {
    const zd_gru_t layer = make_layer(bias);
    int16_t h_q15[1];
    zd_gru_step_after(&layer, 1, 1, x, &h_q30, h_q15, u_keep);
    return h_q30;
}

static int32_t step_before(const int32_t *bias, int32_t h_q30, int32_t u_keep) {
    const zd_gru_t layer = make_layer(bias);
    int16_t h_q15[1];
    int16_t rh_q15[1];
    zd_gru_step_before(&layer, 1, 1, x, &h_q30, h_q15, rh_q15, u_keep);
    return h_q30;
}

static void check_reset_after(void) {
    /* r = u = 1/2 (2^30). a_nh = 100 + 3 * 16384 = 49252, times r: 12313.
     * a_n = 7 + 5 * 2 + 12313 = 12330, >> 2 = 3082 = 2048 + 1034.
     * n = tanh = 16381 * 2048 + (32729 - 16381) * 1034 = 50452120.
     * d = n - h = -486418792, d / 4 = -121604698, h' = h + 2 * that = 293661516. */
    const int32_t bias[4] = {0, 0, 7, 100};
    CHECK_EQUAL(step_after(bias, HALF_Q30, -1), 293661516);
}

static void check_reset_after_with_open_gates(void) {
    /* r: t = 2048, r = 16381 * 2048 + 2^30 = 1107290112 = 0.257811069 * 2^32.
     * u: t = -2048, u = 2^30 - 16381 * 2048 = 1040193536 = 0.242188931 * 2^32.
     * 49252 * 0.257811069 = 12697.71 -> 12698, a_n = 12715, >> 2 = 3178 = 2048 + 1130.
     * n = tanh = 33548288 + 16348 * 1130 = 52021528, d = -484849384.
     * d * 0.242188931 = -117425153.77 -> -117425154, h' = h + 2 * that = 302020604. */
    const int32_t bias[4] = {2048, -2048, 7, 100};
    CHECK_EQUAL(step_after(bias, HALF_Q30, -1), 302020604);
}

static void check_relaxing_ignores_the_update_gate(void) {
    /* As above with u = 1/2: d / 4 = -121212346, h' = h - 242424692. */
    const int32_t bias[4] = {2048, -2048, 7, 100};
    CHECK_EQUAL(step_after(bias, HALF_Q30, 0), 294446220);
}

static void check_reset_before(void) {
    /* r = u = 1/2: r h = 8192 in Q15. a_n = 7 + 10 + 3 * 8192 = 24593, >> 2 = 6148 = 3 * 2048 + 4.
     * n = tanh = 49014 * 2048 + (65205 - 49014) * 4 = 100445436, d = -436425476.
     * h' = h + 2 * (d / 4) = 318658174. bias[3] belongs to the other form. */
    const int32_t bias[4] = {0, 0, 7, 0};
    CHECK_EQUAL(step_before(bias, HALF_Q30, -1), 318658174);
    CHECK_EQUAL(step_before(bias, HALF_Q30, 0), 318658174);
}

static void check_negative_state(void) {
    /* h = -0.5: a_nh = 100 - 49152 = -49052, times 1/2: -12263. a_n = 17 - 12263 = -12246.
     * >> 2 = floor(-3061.5) = -3062 = -2 * 2048 + 1034.
     * n = tanh = -32729 * 2048 + (-16381 + 32729) * 1034 = -50125160.
     * d = -50125160 + 536870912 = 486745752, h' = -536870912 + 2 * 121686438 = -293498036. */
    const int32_t bias[4] = {0, 0, 7, 100};
    CHECK_EQUAL(step_after(bias, -HALF_Q30, -1), -293498036);
}

static void check_eight_bit_weights(void) {
    /* 3 * 16384 = 49152, times the multiplier 49152 >> 15: 73728. a_nh = 73828, times 1/2: 18457.
     * a_n = 18474, >> 2 = 4618 = 2 * 2048 + 522.
     * n = tanh = 32729 * 2048 + (49014 - 32729) * 522 = 75529762, d = -461341150.
     * d / 4 = -115335287.5, half upwards: -115335287, h' = h + 2 * that = 306200338. */
    const int8_t w_h8[3] = {0, 0, 3};
    const int32_t multiplier[3] = {0, 0, 49152};
    const int32_t bias[4] = {0, 0, 7, 100};
    const zd_gru_t layer = {w_x, 0, w_h8, multiplier, bias, {0, 0, 2}, {15, 15, 15}};
    int32_t h_q30[1] = {HALF_Q30};
    int16_t h_q15[1];
    zd_gru_step_after(&layer, 1, 1, x, h_q30, h_q15, -1);
    CHECK_EQUAL(h_q30[0], 306200338);
}

static void check_units_read_the_state_before_the_step(void) {
    /* Unit 1 reads unit 0, which goes from 0.5 to 0.25 in this step: its old state counts.
     * After: mul_high(16384, 2^30) = 4096, node 2: n = 32729 * 2048, h' = n / 2 = 33514496.
     * Before: r h = 8192, node 4: n = 65205 * 2048, h' = n / 2 = 66769920. */
    const int16_t none[6] = {0, 0, 0, 0, 0, 0};
    const int16_t w[12] = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0}; /* [unit][r u n][h] */
    const int32_t bias[8] = {0, 0, 0, 0, 0, 0, 0, 0};
    const zd_gru_t layer = {none, w, 0, 0, bias, {0, 0, 0}, {0, 0, 0}};
    int32_t h_q30[2] = {HALF_Q30, 0};
    int16_t h_q15[2];
    int16_t rh_q15[2];
    zd_gru_step_after(&layer, 1, 2, x, h_q30, h_q15, -1);
    CHECK_EQUAL(h_q30[0], HALF_Q30 / 2);
    CHECK_EQUAL(h_q30[1], 33514496);
    h_q30[0] = HALF_Q30;
    h_q30[1] = 0;
    zd_gru_step_before(&layer, 1, 2, x, h_q30, h_q15, rh_q15, -1);
    CHECK_EQUAL(h_q30[0], HALF_Q30 / 2);
    CHECK_EQUAL(h_q30[1], 66769920);
}

static void check_state_stays_within_its_invariant(void) {
    /* n at its limit and u at its limit drive h to the limit, never beyond. */
    const int32_t up[4] = {0, 1 << 29, 1 << 29, 0};
    const int32_t down[4] = {0, 1 << 29, -(1 << 29), 0};
    int32_t h_q30 = 0;
    for (uint32_t k = 0; k < 100u; k++) {
        h_q30 = step_before(up, h_q30, -1);
    }
    CHECK(h_q30 <= ZD_GRU_H_LIMIT_Q30);
    CHECK(h_q30 >= (1 << 30) - (1 << 15) - 1);
    for (uint32_t k = 0; k < 100u; k++) {
        h_q30 = step_before(down, h_q30, -1);
    }
    CHECK(h_q30 >= -ZD_GRU_H_LIMIT_Q30);
    CHECK(h_q30 <= -(1 << 30) + (1 << 15) + 1);
    CHECK_EQUAL(zd_gru_state_is_sound(&h_q30, 1), 1);
    h_q30 = ZD_GRU_H_LIMIT_Q30;
    CHECK_EQUAL(zd_gru_state_is_sound(&h_q30, 1), 1);
    h_q30 = ZD_GRU_H_LIMIT_Q30 + 1;
    CHECK_EQUAL(zd_gru_state_is_sound(&h_q30, 1), 0);
    h_q30 = INT32_MIN;
    CHECK_EQUAL(zd_gru_state_is_sound(&h_q30, 1), 0);
}

static void check_copy_of_the_state(void) {
    const int32_t h_q30[5] = {0, 16383, 16384, -16384, ZD_GRU_H_LIMIT_Q30};
    const int16_t expected[5] = {0, 0, 1, 0, 32767}; /* halves up */
    int16_t h_q15[5];
    zd_gru_copy_state(h_q30, h_q15, 5);
    for (uint32_t j = 0; j < 5u; j++) {
        CHECK_EQUAL(h_q15[j], expected[j]);
    }
}

int main(void) {
    check_reset_after();
    check_reset_after_with_open_gates();
    check_relaxing_ignores_the_update_gate();
    check_reset_before();
    check_negative_state();
    check_eight_bit_weights();
    check_units_read_the_state_before_the_step();
    check_state_stays_within_its_invariant();
    check_copy_of_the_state();
    return check_report("gru");
}
