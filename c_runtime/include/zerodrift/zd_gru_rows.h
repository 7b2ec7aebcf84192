/* zerodrift runtime: the GRU with Arm's M-profile vector extension (Cortex-M55, M85).
 *
 * Included by zd_runtime.h. A row of weights times the inputs, eight products at a time; the
 * activations of four units at a time.
 *
 * SPDX-License-Identifier: Apache-2.0; may be used under any terms beside a generated model.
 */
#ifndef ZD_GRU_ROWS_H
#define ZD_GRU_ROWS_H

#if ZD_RUNTIME_ID != 0xb9f9d9e0
#error "zd_gru_rows.h is not of the same zerodrift runtime as zd_runtime.h: copy all files again"
#endif

#include <arm_mve.h>

/* Constants of one layer. U = H filled up to a multiple of 4; X vectors of features, R of the
 * state. With the reset gate before the product, the rows of r and u of all units stand before
 * those of n. */
typedef struct {
    const int16_t *weights;      /* [U][3][8 X + 8 R], or [U][3][8 X] beside `bytes` */
    const int8_t *bytes;         /* [U][3][8 R] with 8-bit recurrent weights, or NULL */
    const int32_t *bias;         /* [U / 4][r, u, n outside, n inside][4] */
    const int32_t *multiplier;   /* [U / 4][r, u, n][4], 8-bit weights only */
    uint8_t shift[3];            /* accumulator of r, u, n -> t_q16 */
    uint8_t multiplier_shift[3]; /* 8-bit weights only */
} zd_gru_rows_t;

#define ZD_ROW_VECTORS(n) (((n) + 7u) / 8u)
#define ZD_ROW_UNITS(hidden) ((((hidden) + 3u) / 4u) * 4u)

/* The first `count` of four numbers, zeros for the others; whole vectors where all are whole. */
static inline int32x4_t zd_load4(const int32_t *from, uint32_t count, uint32_t hidden) {
    return ((hidden % 4u) == 0u) ? vld1q_s32(from) : vld1q_z_s32(from, vctp32q(count));
}

static inline void zd_store4(int32_t *to, int32x4_t x, uint32_t count, uint32_t hidden) {
    if ((hidden % 4u) == 0u) {
        vst1q_s32(to, x);
    } else {
        vst1q_p_s32(to, x, vctp32q(count));
    }
}

/* zd_tanh_q30 of sum >> shift, four at once. The sum is brought to the top of 32 bits, saturating;
 * addresses count from the middles of the tables, modulo 2^32. */
static inline int32x4_t zd_tanh4_q30(int32x4_t sum, int32_t shift, const int32_t *offset_q30,
                                     const int16_t *slope_q19) {
    const int32x4_t top = vqshlq_r_s32(sum, 12 - shift);
    const uint32x4_t line = vreinterpretq_u32_s32(vshrq_n_s32(top, 23));
    const int32x4_t offset = vldrwq_gather_shifted_offset_s32(offset_q30, line);
    const int32x4_t slope = vldrhq_gather_shifted_offset_s32(slope_q19, line);
    return vaddq_s32(offset, vmulq_s32(slope, vshrq_n_s32(top, 12)));
}

/* Four products times their multipliers / 2^shift to nearest, halves up, as zd_round_shift64; 0 <=
 * shift <= 62. The halves of the 64-bit product are shifted apart: one that is shifted out adds 0.
 */
static inline int32x4_t zd_scale4(const int32_t *product, const int32_t *multiplier,
                                  int32_t shift) {
    const int32x4_t p = vld1q_s32(product);
    const int32x4_t m = vld1q_s32(multiplier);
    const uint32x4_t low = vreinterpretq_u32_s32(vmulq_s32(p, m));
    return vaddq_s32(vrshlq_n_s32(vmulhq_s32(p, m), 32 - shift),
                     vreinterpretq_s32_u32(vrshlq_n_u32(low, -shift)));
}

/* w . v over whole vectors, at least one. */
static inline int32_t zd_dot_rows(const int16_t *w, const int16_t *v, uint32_t vectors) {
    int32_t acc = vmladavq_s16(vld1q_s16(v), vld1q_s16(w));
    ZD_UNROLLED
    for (uint32_t i = 8u; i < (8u * vectors); i += 8u) {
        acc = vmladavaq_s16(acc, vld1q_s16(&v[i]), vld1q_s16(&w[i]));
    }
    return acc;
}

/* The same of weights of 8 bits. */
static inline int32_t zd_dot_bytes(const int8_t *w, const int16_t *v, uint32_t vectors) {
    int32_t acc = vmladavq_s16(vld1q_s16(v), vldrbq_s16(w));
    ZD_UNROLLED
    for (uint32_t i = 8u; i < (8u * vectors); i += 8u) {
        acc = vmladavaq_s16(acc, vld1q_s16(&v[i]), vldrbq_s16(&w[i]));
    }
    return acc;
}

/* w . v of `gates` rows of the k-th of four units; sums [gate][unit]. */
static inline void zd_sum_rows(const int16_t *w, const int16_t *v, uint32_t vectors, uint32_t gates,
                               int32_t sums[][4], uint32_t k) {
    ZD_UNROLLED
    for (uint32_t g = 0; g < gates; g++) {
        sums[g][k] = zd_dot_rows(&w[8u * vectors * ((k * gates) + g)], v, vectors);
    }
}

/* The same of weights of 8 bits. */
static inline void zd_sum_bytes(const int8_t *w, const int16_t *v, uint32_t vectors, uint32_t gates,
                                int32_t sums[][4], uint32_t k) {
    ZD_UNROLLED
    for (uint32_t g = 0; g < gates; g++) {
        sums[g][k] = zd_dot_bytes(&w[8u * vectors * ((k * gates) + g)], v, vectors);
    }
}

/* Keeps a pointer in one of r0 - r7, from which gcc gathers 16-bit numbers without a copy of it. */
#if defined(__GNUC__)
#define ZD_NEAR(pointer) __asm volatile("" : "+l"(pointer))
#else
#define ZD_NEAR(pointer)
#endif

/* The features, filled up with zeros to whole vectors. */
static inline void zd_fill_features(const int16_t *x, uint32_t inputs, int16_t *v) {
    for (uint32_t i = 0; i < inputs; i += 8u) {
        vst1q_s16(&v[i], vld1q_z_s16(&x[i], vctp16q(inputs - i)));
    }
}

/* The int16 copy of a state in Q1.30, filled up with zeros to whole vectors. */
static inline void zd_fill_state(const int32_t *h_q30, uint32_t hidden, int16_t *v) {
    for (uint32_t j = 0; j < (8u * ZD_ROW_VECTORS(hidden)); j += 4u) {
        const int32x4_t h = (j < hidden) ? zd_load4(&h_q30[j], hidden - j, hidden) : vdupq_n_s32(0);
        vstrhq_s32(&v[j], vrshrq_n_s32(h, 15));
    }
}

/* zd_gru_move of four. */
static inline int32x4_t zd_gru_move4(int32x4_t h_q30, int32x4_t n_q30, int32x4_t u_q31) {
    const int32x4_t move = vrmulhq_s32(vsubq_s32(n_q30, h_q30), u_q31);
    return vaddq_s32(h_q30, vaddq_s32(move, move));
}

/* One step, reset gate after the recurrent product.
 *   x      [inputs] features
 *   h_q30  [hidden] state, updated
 *   v      [8 (ZD_ROW_VECTORS(inputs) + ZD_ROW_VECTORS(hidden))] scratch
 *   u_keep -1 for a step in time; 0 to relax towards rest, where u = 1/2 */
static inline void zd_gru_step_rows(const zd_gru_rows_t *layer, uint32_t inputs, uint32_t hidden,
                                    const int16_t *x, int32_t *h_q30, int16_t *v, int32_t u_keep) {
    const uint32_t x_vectors = ZD_ROW_VECTORS(inputs);
    const uint32_t h_vectors = ZD_ROW_VECTORS(hidden);
    const uint32_t row = 8u * (x_vectors + h_vectors);
    const int32_t half_q30 = (int32_t)1 << 30;
    const int16_t *v_h = &v[8u * x_vectors];
    const int16_t *w = layer->weights;
    const int8_t *bytes = layer->bytes;
    const int32_t *bias = layer->bias;
    const int32_t *multiplier = layer->multiplier;
    const int32_t *offset = &zd_tanh_offset_q30[256];
    const int16_t *slope = &zd_tanh_slope_q19[256];
    ZD_FORGET(offset);
    ZD_FORGET(slope);
    zd_fill_features(x, inputs, v);
    zd_fill_state(h_q30, hidden, &v[8u * x_vectors]);
    for (uint32_t j = 0; j < ZD_ROW_UNITS(hidden); j += 4u) {
        int32x4_t a_r;
        int32x4_t a_u;
        int32x4_t outside;
        int32x4_t inside;
        if (layer->bytes == NULL) {
            int32_t acc[4][4]; /* [unit][r, u, n outside, n inside] */
            for (uint32_t k = 0; k < 4u; k++) {
                acc[k][0] = zd_dot_rows(w, v, x_vectors + h_vectors);
                acc[k][1] = zd_dot_rows(&w[row], v, x_vectors + h_vectors);
                acc[k][2] = zd_dot_rows(&w[2u * row], v, x_vectors);
                acc[k][3] = zd_dot_rows(&w[(2u * row) + (8u * x_vectors)], v_h, h_vectors);
                w = &w[3u * row];
            }
            const int32x4x4_t sums = vld4q_s32(&acc[0][0]);
            a_r = sums.val[0];
            a_u = sums.val[1];
            outside = sums.val[2];
            inside = sums.val[3];
        } else {
            int32_t from_x[3][4];
            int32_t product[3][4];
            const uint8_t *by = layer->multiplier_shift;
            ZD_UNROLLED
            for (uint32_t k = 0; k < 4u; k++) {
                zd_sum_rows(w, v, x_vectors, 3u, from_x, k);
                zd_sum_bytes(bytes, v_h, h_vectors, 3u, product, k);
            }
            a_r = vaddq_s32(vld1q_s32(from_x[0]), zd_scale4(product[0], &multiplier[0], by[0]));
            a_u = vaddq_s32(vld1q_s32(from_x[1]), zd_scale4(product[1], &multiplier[4], by[1]));
            outside = vld1q_s32(from_x[2]);
            inside = zd_scale4(product[2], &multiplier[8], by[2]);
            w = &w[96u * x_vectors];
            bytes = &bytes[96u * h_vectors];
            multiplier = &multiplier[12];
        }
        ZD_NEAR(slope);
        a_r = vaddq_s32(a_r, vld1q_s32(&bias[0]));
        a_u = vaddq_s32(a_u, vld1q_s32(&bias[4]));
        outside = vaddq_s32(outside, vld1q_s32(&bias[8]));
        inside = vaddq_s32(inside, vld1q_s32(&bias[12]));
        bias = &bias[16];
        const int32x4_t r_q31 =
            vaddq_n_s32(zd_tanh4_q30(a_r, layer->shift[0], offset, slope), half_q30);
        const int32x4_t kept =
            vandq_s32(zd_tanh4_q30(a_u, layer->shift[1], offset, slope), vdupq_n_s32(u_keep));
        const int32x4_t u_q31 = vaddq_n_s32(kept, half_q30);
        const int32x4_t a_n = vaddq_s32(outside, vrmulhq_s32(inside, r_q31));
        const int32x4_t n_q30 = zd_tanh4_q30(a_n, layer->shift[2], offset, slope);
        const int32x4_t h = zd_load4(&h_q30[j], hidden - j, hidden);
        zd_store4(&h_q30[j], zd_gru_move4(h, n_q30, u_q31), hidden - j, hidden);
    }
}

/* One step, reset gate before the recurrent product: r and u of every unit, then n.
 *   x      [inputs] features
 *   h_q30  [hidden] state, updated
 *   v      [16 (ZD_ROW_VECTORS(inputs) + ZD_ROW_VECTORS(hidden))] scratch
 *   u_q31  [ZD_ROW_UNITS(hidden)] scratch
 *   u_keep -1 for a step in time; 0 to relax towards rest, where u = 1/2 */
static inline void zd_gru_step_rows_before(const zd_gru_rows_t *layer, uint32_t inputs,
                                           uint32_t hidden, const int16_t *x, int32_t *h_q30,
                                           int16_t *v, int32_t *u_q31, int32_t u_keep) {
    const uint32_t x_vectors = ZD_ROW_VECTORS(inputs);
    const uint32_t h_vectors = ZD_ROW_VECTORS(hidden);
    const uint32_t vectors = (layer->bytes == NULL) ? (x_vectors + h_vectors) : x_vectors;
    const uint32_t row = 8u * (x_vectors + h_vectors);
    const int32_t half_q30 = (int32_t)1 << 30;
    const int16_t *v_h = &v[8u * x_vectors];
    int16_t *v_n = &v[row]; /* features, then r h */
    int16_t *rh = &v_n[8u * x_vectors];
    const int16_t *w = layer->weights;
    const int8_t *bytes = layer->bytes;
    const uint8_t *by = layer->multiplier_shift;
    const int32_t *offset = &zd_tanh_offset_q30[256];
    const int16_t *slope = &zd_tanh_slope_q19[256];
    ZD_FORGET(offset);
    ZD_FORGET(slope);
    zd_fill_features(x, inputs, v);
    zd_fill_features(x, inputs, v_n);
    zd_fill_state(h_q30, hidden, &v[8u * x_vectors]);
    vst1q_s16(&rh[8u * (h_vectors - 1u)], vdupq_n_s16(0));
    for (uint32_t j = 0; j < ZD_ROW_UNITS(hidden); j += 4u) {
        const int32_t *bias = &layer->bias[4u * j];
        int32_t sums[2][4]; /* [r, u][unit] */
        ZD_UNROLLED
        for (uint32_t k = 0; k < 4u; k++) {
            zd_sum_rows(w, v, vectors, 2u, sums, k);
        }
        w = &w[64u * vectors];
        int32x4_t a_r = vaddq_s32(vld1q_s32(sums[0]), vld1q_s32(&bias[0]));
        int32x4_t a_u = vaddq_s32(vld1q_s32(sums[1]), vld1q_s32(&bias[4]));
        if (layer->bytes != NULL) {
            int32_t product[2][4];
            ZD_UNROLLED
            for (uint32_t k = 0; k < 4u; k++) {
                zd_sum_bytes(bytes, v_h, h_vectors, 2u, product, k);
            }
            bytes = &bytes[64u * h_vectors];
            const int32_t *multiplier = &layer->multiplier[3u * j];
            a_r = vaddq_s32(a_r, zd_scale4(product[0], &multiplier[0], by[0]));
            a_u = vaddq_s32(a_u, zd_scale4(product[1], &multiplier[4], by[1]));
        }
        ZD_NEAR(slope);
        const int32x4_t r_q31 =
            vaddq_n_s32(zd_tanh4_q30(a_r, layer->shift[0], offset, slope), half_q30);
        const int32x4_t kept =
            vandq_s32(zd_tanh4_q30(a_u, layer->shift[1], offset, slope), vdupq_n_s32(u_keep));
        vst1q_s32(&u_q31[j], vaddq_n_s32(kept, half_q30));
        /* of r h / 2^46 the product's lower half only ever rounds down */
        const int32x4_t reset = vmulhq_s32(zd_load4(&h_q30[j], hidden - j, hidden), r_q31);
        vstrhq_s32(&rh[j], vrshrq_n_s32(reset, 14));
    }
    for (uint32_t j = 0; j < ZD_ROW_UNITS(hidden); j += 4u) {
        int32_t sums[1][4];
        ZD_UNROLLED
        for (uint32_t k = 0; k < 4u; k++) {
            zd_sum_rows(w, v_n, vectors, 1u, sums, k);
        }
        w = &w[32u * vectors];
        int32x4_t a_n = vaddq_s32(vld1q_s32(sums[0]), vld1q_s32(&layer->bias[(4u * j) + 8u]));
        if (layer->bytes != NULL) {
            int32_t product[1][4];
            ZD_UNROLLED
            for (uint32_t k = 0; k < 4u; k++) {
                zd_sum_bytes(bytes, rh, h_vectors, 1u, product, k);
            }
            bytes = &bytes[32u * h_vectors];
            const int32_t *multiplier = &layer->multiplier[(3u * j) + 8u];
            a_n = vaddq_s32(a_n, zd_scale4(product[0], multiplier, by[2]));
        }
        ZD_NEAR(slope);
        const int32x4_t n_q30 = zd_tanh4_q30(a_n, layer->shift[2], offset, slope);
        const int32x4_t h = zd_load4(&h_q30[j], hidden - j, hidden);
        const int32x4_t moved = zd_gru_move4(h, n_q30, vld1q_s32(&u_q31[j]));
        zd_store4(&h_q30[j], moved, hidden - j, hidden);
    }
}

#endif /* ZD_GRU_ROWS_H */
