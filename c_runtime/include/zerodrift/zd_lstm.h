/* zerodrift runtime: the LSTM in plain C99 (docs/reference/integer-layers.md, 3), for every core.
 *
 * Included by a model that needs it, after zd_runtime.h.
 *
 * SPDX-License-Identifier: Apache-2.0; may be used under any terms beside a generated model.
 */
#ifndef ZD_LSTM_H
#define ZD_LSTM_H

#include "zd_network.h"

#if ZD_RUNTIME_ID != 0xb9f9d9e0
#error "zd_lstm.h is not of the same zerodrift runtime as zd_runtime.h: copy all files again"
#endif

#define ZD_LSTM_CELL_LIMIT 1073741824 /* 2^30: |c| never exceeds it, the step saturates there */
#define ZD_LSTM_SLOWEST 15

/* Constants of one layer. Rows are stored unit by unit, and within a unit i, f, g, o. */
typedef struct {
    const int16_t *w_x;          /* [H][4][I] */
    const int16_t *w_h16;        /* [H][4][H], or NULL with 8-bit recurrent weights */
    const int8_t *w_h8;          /* [H][4][H], or NULL */
    const int32_t *multiplier;   /* [H][4], 8-bit weights only */
    const int32_t *bias;         /* [H][4] */
    uint8_t shift[4];            /* accumulator of i, f, g, o -> t_q16 */
    uint8_t multiplier_shift[4]; /* 8-bit weights only */
    uint8_t cell_bits;           /* fractional bits of the cell state, 24 .. 27 */
} zd_lstm_t;

/* The same with 16-bit weights, as the generated assembly reads them. */
typedef struct {
    const int32_t *stream; /* [H][4 + 4 (X + R)]; X pairs of features, R pairs of the output */
    uint8_t shift[4];      /* accumulator of i, f, g, o -> t_q16 */
    uint8_t cell_bits;     /* fractional bits of the cell state, 24 .. 27 */
} zd_lstm_pairs_t;

/* The same with 8-bit recurrent weights. */
typedef struct {
    const int32_t *stream;       /* [H][8 + 4 (F + X)]; F fours of the output, X pairs of x */
    uint8_t shift[4];            /* accumulator of i, f, g, o -> t_q16 */
    uint8_t multiplier_shift[4]; /* product of i, f, g, o -> accumulator */
    uint8_t cell_bits;           /* fractional bits of the cell state, 24 .. 27 */
} zd_lstm_bytes_t;

/* The table's argument of one gate of one unit. */
static inline int32_t zd_lstm_gate(const zd_lstm_t *layer, uint32_t inputs, uint32_t hidden,
                                   uint32_t row, const int16_t *x, const int16_t *h_q15) {
    const uint32_t gate = row & 3u;
    int32_t from_h;
    if (layer->w_h8 == NULL) {
        from_h = zd_dot_i16(&layer->w_h16[row * hidden], h_q15, hidden);
    } else {
        const int32_t product = zd_dot_i8(&layer->w_h8[row * hidden], h_q15, hidden);
        from_h = (int32_t)zd_round_shift64((int64_t)product * layer->multiplier[row],
                                           layer->multiplier_shift[gate]);
    }
    return zd_asr32(layer->bias[row] + zd_dot_i16(&layer->w_x[row * inputs], x, inputs) + from_h,
                    layer->shift[gate]);
}

/* c towards rest: by 2^doublings / 2 of its distance, a quarter to half of the way. */
static inline int32_t zd_lstm_relax(int32_t cell, int32_t forget_q31, int32_t added) {
    uint32_t doublings = 0;
    for (uint32_t k = 0; k < ZD_LSTM_SLOWEST; k++) {
        if (forget_q31 < ((int32_t)1 << (30u - k))) {
            doublings++;
        }
    }
    const int64_t distance = (int64_t)added - zd_mul_high(cell, forget_q31);
    return (int32_t)zd_clamp64(cell + (distance * ((int64_t)1 << doublings)), -ZD_LSTM_CELL_LIMIT,
                               ZD_LSTM_CELL_LIMIT);
}

/* One step.
 *   x        [inputs] features
 *   h_q30    [hidden] output, updated
 *   cell     [hidden] cell state, updated
 *   h_q15    [hidden] scratch
 *   relaxing 0 for a step in time; 1 to come nearer to rest */
static inline void zd_lstm_step(const zd_lstm_t *layer, uint32_t inputs, uint32_t hidden,
                                const int16_t *x, int32_t *h_q30, int32_t *cell, int16_t *h_q15,
                                uint32_t relaxing) {
    const uint32_t cell_bits = layer->cell_bits;
    const int32_t half = (int32_t)1 << (cell_bits - 17u);
    zd_gru_copy_state(h_q30, h_q15, hidden);
    for (uint32_t j = 0; j < hidden; j++) {
        ZD_PER_UNIT(h_q15);
        const uint32_t row = 4u * j;
        const int32_t i_q31 = zd_sigmoid_q31(zd_lstm_gate(layer, inputs, hidden, row, x, h_q15));
        const int32_t f_q30 = zd_tanh_q30(zd_lstm_gate(layer, inputs, hidden, row + 1u, x, h_q15));
        const int32_t g_q30 = zd_tanh_q30(zd_lstm_gate(layer, inputs, hidden, row + 2u, x, h_q15));
        const int32_t o_q31 =
            zd_sigmoid_q31(zd_lstm_gate(layer, inputs, hidden, row + 3u, x, h_q15));
        /* one fractional bit less than the cell state */
        const int32_t added = zd_asr32(
            zd_mul_high(g_q30, i_q31) + ((int32_t)1 << (29u - cell_bits)), 30u - cell_bits);
        int32_t c;
        if (relaxing == 0u) {
            const int32_t moved = zd_mul_high(cell[j], f_q30 + ((int32_t)1 << 30)) + added;
            c = 2 * zd_clamp32(moved, -(ZD_LSTM_CELL_LIMIT / 2), ZD_LSTM_CELL_LIMIT / 2);
        } else {
            c = zd_lstm_relax(cell[j], ((int32_t)1 << 30) - f_q30, added);
        }
        cell[j] = c;
        h_q30[j] = 2 * zd_mul_high(zd_tanh_q30(zd_asr32(c + half, cell_bits - 16u)), o_q31);
    }
}

#if ZD_KERNEL == ZD_KERNEL_ROWS
#include "zd_lstm_rows.h"
#endif

#endif /* ZD_LSTM_H */
