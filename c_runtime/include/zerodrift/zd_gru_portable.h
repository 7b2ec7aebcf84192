/* zerodrift runtime: the GRU in plain C99 (specification, 4), for every core and every model.
 *
 * Included by zd_runtime.h.
 *
 * SPDX-License-Identifier: Apache-2.0; may be used under any terms beside a generated model.
 */
#ifndef ZD_GRU_PORTABLE_H
#define ZD_GRU_PORTABLE_H

#if ZD_RUNTIME_ID != 0xb9f9d9e0
#error                                                                                             \
    "zd_gru_portable.h is not of the same zerodrift runtime as zd_runtime.h: copy all files again"
#endif

/* Constants of one layer. Rows are stored unit by unit, and within a unit r, u, n. */
typedef struct {
    const int16_t *w_x;          /* [H][3][I] */
    const int16_t *w_h16;        /* [H][3][H], or NULL with 8-bit recurrent weights */
    const int8_t *w_h8;          /* [H][3][H], or NULL */
    const int32_t *multiplier;   /* [H][3], 8-bit weights only */
    const int32_t *bias;         /* [H][4]: r, u, n outside, n inside the reset product */
    uint8_t shift[3];            /* accumulator of r, u, n -> t_q16 */
    uint8_t multiplier_shift[3]; /* 8-bit weights only */
} zd_gru_t;

/* Layers as the generated assembly reads them, which have no other kernel for their core. */
typedef struct {
    const int32_t *stream; /* [H][2 + 2 (X + R)] of r, u, then [H][1 + X + R] of n; X, R pairs */
    uint8_t shift[3];      /* accumulator of r, u, n -> t_q16 */
} zd_gru_before_t;
typedef struct {
    const int32_t *stream;       /* [H][7 + 3 (X + F)]; F fours of 8-bit weights */
    uint8_t shift[3];            /* accumulator of r, u, n -> t_q16 */
    uint8_t multiplier_shift[3]; /* below 32 */
} zd_gru_bytes_t;

/* An 8-bit row's product in its gate's accumulator format. */
static inline int32_t zd_gru_rescale(const zd_gru_t *layer, uint32_t row, unsigned gate,
                                     int32_t product) {
    return (int32_t)zd_round_shift64((int64_t)product * layer->multiplier[row],
                                     layer->multiplier_shift[gate]);
}

/* w_h . h of one row, in its gate's accumulator format. */
static inline int32_t zd_gru_recurrent(const zd_gru_t *layer, uint32_t row, unsigned gate,
                                       const int16_t *h_q15, uint32_t hidden) {
    int32_t acc;
    if (layer->w_h8 == NULL) {
        acc = zd_dot_i16(&layer->w_h16[row * hidden], h_q15, hidden);
    } else {
        acc =
            zd_gru_rescale(layer, row, gate, zd_dot_i8(&layer->w_h8[row * hidden], h_q15, hidden));
    }
    return acc;
}

/* The same of the three rows r, u, n of one unit, the first of which is `row`. */
static inline void zd_gru_recurrent3(const zd_gru_t *layer, uint32_t row, const int16_t *h_q15,
                                     uint32_t hidden, int32_t acc[3]) {
    if (layer->w_h8 == NULL) {
        zd_dot3_i16(&layer->w_h16[row * hidden], h_q15, hidden, acc);
    } else {
        zd_dot3_i8(&layer->w_h8[row * hidden], h_q15, hidden, acc);
        for (unsigned gate = 0; gate < 3u; gate++) {
            acc[gate] = zd_gru_rescale(layer, row + gate, gate, acc[gate]);
        }
    }
}

/* The update gate; 1/2 if u_keep is 0 rather than -1. */
static inline int32_t zd_gru_update_q31(int32_t half_t_q16, int32_t u_keep) {
    return (zd_tanh_q30(half_t_q16) & u_keep) + ((int32_t)1 << 30);
}

/* h + u (n - h). Since |n|, |h| <= 2^30 - 2^15 + 1 the difference fits 32 bits, and |h| stays. */
static inline int32_t zd_gru_move(int32_t h_q30, int32_t n_q30, int32_t u_q31) {
    return h_q30 + (2 * zd_mul_high(n_q30 - h_q30, u_q31));
}

/* One step, reset gate after the recurrent product.
 *   x      [inputs] features
 *   h_q30  [hidden] state, updated
 *   h_q15  [hidden] scratch
 *   u_keep -1 for a step in time; 0 to relax towards rest, where u = 1/2 */
static inline void zd_gru_step_after(const zd_gru_t *layer, uint32_t inputs, uint32_t hidden,
                                     const int16_t *x, int32_t *h_q30, int16_t *h_q15,
                                     int32_t u_keep) {
    zd_gru_copy_state(h_q30, h_q15, hidden);
    for (uint32_t j = 0; j < hidden; j++) {
        ZD_PER_UNIT(h_q15);
        const uint32_t row = 3u * j;
        const int32_t *bias = &layer->bias[4u * j];
        int32_t from_x[3];
        int32_t from_h[3];
        zd_dot3_i16(&layer->w_x[row * inputs], x, inputs, from_x);
        zd_gru_recurrent3(layer, row, h_q15, hidden, from_h);
        const int32_t a_r = bias[0] + from_x[0] + from_h[0];
        const int32_t a_u = bias[1] + from_x[1] + from_h[1];
        const int32_t r_q31 = zd_sigmoid_q31(zd_asr32(a_r, layer->shift[0]));
        const int32_t u_q31 = zd_gru_update_q31(zd_asr32(a_u, layer->shift[1]), u_keep);
        const int32_t a_n = bias[2] + from_x[2] + zd_mul_high(bias[3] + from_h[2], r_q31);
        const int32_t n_q30 = zd_tanh_q30(zd_asr32(a_n, layer->shift[2]));
        h_q30[j] = zd_gru_move(h_q30[j], n_q30, u_q31);
    }
}

/* One step, reset gate before the recurrent product; rh_q15 [hidden] is a second scratch. */
static inline void zd_gru_step_before(const zd_gru_t *layer, uint32_t inputs, uint32_t hidden,
                                      const int16_t *x, int32_t *h_q30, int16_t *h_q15,
                                      int16_t *rh_q15, int32_t u_keep) {
    zd_gru_copy_state(h_q30, h_q15, hidden);
    for (uint32_t j = 0; j < hidden; j++) {
        const uint32_t row = 3u * j;
        const int32_t a_r = layer->bias[4u * j] + zd_dot_i16(&layer->w_x[row * inputs], x, inputs) +
                            zd_gru_recurrent(layer, row, 0u, h_q15, hidden);
        const int32_t r_q31 = zd_sigmoid_q31(zd_asr32(a_r, layer->shift[0]));
        rh_q15[j] = (int16_t)zd_round_shift64((int64_t)h_q30[j] * r_q31, 46u);
    }
    for (uint32_t j = 0; j < hidden; j++) {
        const uint32_t row = 3u * j;
        const int16_t *w_x = &layer->w_x[row * inputs];
        const int32_t *bias = &layer->bias[4u * j];
        const int32_t a_u = bias[1] + zd_dot_i16(&w_x[inputs], x, inputs) +
                            zd_gru_recurrent(layer, row + 1u, 1u, h_q15, hidden);
        const int32_t a_n = bias[2] + zd_dot_i16(&w_x[2u * inputs], x, inputs) +
                            zd_gru_recurrent(layer, row + 2u, 2u, rh_q15, hidden);
        const int32_t u_q31 = zd_gru_update_q31(zd_asr32(a_u, layer->shift[1]), u_keep);
        const int32_t n_q30 = zd_tanh_q30(zd_asr32(a_n, layer->shift[2]));
        h_q30[j] = zd_gru_move(h_q30[j], n_q30, u_q31);
    }
}

/* 1 if every |h| is within its invariant: a state that violates it was damaged from outside. */
static inline uint32_t zd_gru_state_is_sound(const int32_t *h_q30, uint32_t hidden) {
    uint32_t sound = 1u;
    for (uint32_t j = 0; j < hidden; j++) {
        if ((h_q30[j] > ZD_GRU_H_LIMIT_Q30) || (h_q30[j] < -ZD_GRU_H_LIMIT_Q30)) {
            sound = 0u;
        }
    }
    return sound;
}

#endif /* ZD_GRU_PORTABLE_H */
