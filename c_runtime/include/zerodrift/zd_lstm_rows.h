/* zerodrift runtime: the LSTM with Arm's M-profile vector extension (Cortex-M55, M85).
 *
 * Included by zd_lstm.h. A row of weights times the inputs, eight products at a time; the
 * activations of four units at a time.
 *
 * SPDX-License-Identifier: Apache-2.0; may be used under any terms beside a generated model.
 */
#ifndef ZD_LSTM_ROWS_H
#define ZD_LSTM_ROWS_H

#if ZD_RUNTIME_ID != 0xb9f9d9e0
#error "zd_lstm_rows.h is not of the same zerodrift runtime as zd_runtime.h: copy all files again"
#endif

/* Constants of one layer. U = H filled up to a multiple of 4; X vectors of features, R of the
 * output.
 */
typedef struct {
    const int16_t *weights;      /* [U][4][8 X + 8 R], or [U][4][8 X] beside `bytes` */
    const int8_t *bytes;         /* [U][4][8 R] with 8-bit recurrent weights, or NULL */
    const int32_t *bias;         /* [U / 4][i, f, g, o][4] */
    const int32_t *multiplier;   /* [U / 4][i, f, g, o][4], 8-bit weights only */
    uint8_t shift[4];            /* accumulator of i, f, g, o -> t_q16 */
    uint8_t multiplier_shift[4]; /* 8-bit weights only */
    uint8_t cell_bits;           /* fractional bits of the cell state, 24 .. 27 */
} zd_lstm_rows_t;

/* zd_lstm_relax of four, one by one: it is what a settling alone takes. */
static inline int32x4_t zd_lstm_relax4(int32x4_t cell, int32x4_t forget_q31, int32x4_t added) {
    int32_t c[4];
    int32_t forget[4];
    int32_t add[4];
    vst1q_s32(c, cell);
    vst1q_s32(forget, forget_q31);
    vst1q_s32(add, added);
    for (uint32_t k = 0; k < 4u; k++) {
        c[k] = zd_lstm_relax(c[k], forget[k], add[k]);
    }
    return vld1q_s32(c);
}

/* One step.
 *   x        [inputs] features
 *   h_q30    [hidden] output, updated
 *   cell     [hidden] cell state, updated
 *   v        [8 (ZD_ROW_VECTORS(inputs) + ZD_ROW_VECTORS(hidden))] scratch
 *   relaxing 0 for a step in time; 1 to come nearer to rest */
static inline void zd_lstm_step_rows(const zd_lstm_rows_t *layer, uint32_t inputs, uint32_t hidden,
                                     const int16_t *x, int32_t *h_q30, int32_t *cell, int16_t *v,
                                     uint32_t relaxing) {
    const uint32_t x_vectors = ZD_ROW_VECTORS(inputs);
    const uint32_t h_vectors = ZD_ROW_VECTORS(hidden);
    const uint32_t of_weights = (layer->bytes == NULL) ? (x_vectors + h_vectors) : x_vectors;
    const int32_t half_q30 = (int32_t)1 << 30;
    const int16_t *w = layer->weights;
    const int8_t *bytes = layer->bytes;
    const int32_t *bias = layer->bias;
    const int32_t *multiplier = layer->multiplier;
    const int32_t bits = layer->cell_bits;
    const int32_t half = (int32_t)1 << (layer->cell_bits - 17u);
    const int32_t *offset = &zd_tanh_offset_q30[256];
    const int16_t *slope = &zd_tanh_slope_q19[256];
    ZD_FORGET(offset);
    ZD_FORGET(slope);
    zd_fill_features(x, inputs, v);
    zd_fill_state(h_q30, hidden, &v[8u * x_vectors]);
    for (uint32_t j = 0; j < ZD_ROW_UNITS(hidden); j += 4u) {
        int32_t sums[4][4];
        int32_t products[4][4];
        int32x4_t gate_q30[4];
        for (uint32_t k = 0; k < 4u; k++) {
            zd_sum_rows(w, v, of_weights, 4u, sums, k);
        }
        w = &w[128u * of_weights];
        if (layer->bytes != NULL) {
            for (uint32_t k = 0; k < 4u; k++) {
                zd_sum_bytes(bytes, &v[8u * x_vectors], h_vectors, 4u, products, k);
            }
            bytes = &bytes[128u * h_vectors];
        }
        ZD_NEAR(slope);
        ZD_UNROLLED
        for (uint32_t g = 0; g < 4u; g++) {
            int32x4_t a = vaddq_s32(vld1q_s32(sums[g]), vld1q_s32(&bias[4u * g]));
            if (layer->bytes != NULL) {
                const int32_t shift = layer->multiplier_shift[g];
                a = vaddq_s32(a, zd_scale4(products[g], &multiplier[4u * g], shift));
            }
            gate_q30[g] = zd_tanh4_q30(a, layer->shift[g], offset, slope);
            ZD_FORGET(slope); /* gate by gate, or gcc loads all of their numbers first */
        }
        bias = &bias[16];
        multiplier = (layer->bytes != NULL) ? &multiplier[16] : multiplier;
        const int32x4_t i_q31 = vaddq_n_s32(gate_q30[0], half_q30);
        const int32x4_t f_q30 = gate_q30[1];
        const int32x4_t g_q30 = gate_q30[2];
        const int32x4_t o_q31 = vaddq_n_s32(gate_q30[3], half_q30);
        /* one fractional bit less than the cell state */
        const int32x4_t added = vrshlq_n_s32(vrmulhq_s32(g_q30, i_q31), bits - 30);
        int32x4_t c = zd_load4(&cell[j], hidden - j, hidden);
        if (relaxing == 0u) {
            const int32x4_t moved = vaddq_s32(vrmulhq_s32(c, vaddq_n_s32(f_q30, half_q30)), added);
            const int32x4_t low = vdupq_n_s32(-(ZD_LSTM_CELL_LIMIT / 2));
            const int32x4_t high = vdupq_n_s32(ZD_LSTM_CELL_LIMIT / 2);
            const int32x4_t limited = vminq_s32(vmaxq_s32(moved, low), high);
            c = vaddq_s32(limited, limited);
        } else {
            c = zd_lstm_relax4(c, vsubq_s32(vdupq_n_s32(half_q30), f_q30), added);
        }
        zd_store4(&cell[j], c, hidden - j, hidden);
        const int32x4_t bend = zd_tanh4_q30(vaddq_n_s32(c, half), bits - 16, offset, slope);
        const int32x4_t h = vrmulhq_s32(bend, o_q31);
        zd_store4(&h_q30[j], vaddq_s32(h, h), hidden - j, hidden);
    }
}

#endif /* ZD_LSTM_ROWS_H */
