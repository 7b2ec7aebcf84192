/* zerodrift runtime: the GRU with SSE2, which every x86-64 has: eight units in two vectors.
 *
 * Included by zd_gru_columns.h.
 *
 * SPDX-License-Identifier: Apache-2.0; may be used under any terms beside a generated model.
 */
#ifndef ZD_GRU_COLUMNS_SSE2_H
#define ZD_GRU_COLUMNS_SSE2_H

#if ZD_RUNTIME_ID != 0xb9f9d9e0
#error                                                                                             \
    "zd_gru_columns_sse2.h is not of the same zerodrift runtime as zd_runtime.h: copy all files again"
#endif

#include <emmintrin.h>

static inline __m128i zd_load4(const int32_t *from) {
    return _mm_loadu_si128((const __m128i *)(const void *)from);
}

static inline void zd_store4(int32_t *to, __m128i x) { _mm_storeu_si128((__m128i *)(void *)to, x); }

/* zd_mul_high of four, no b negative: the product without signs, less b 2^32 where a is negative.
 */
static inline __m128i zd_mul_high4(__m128i a, __m128i b) {
    const __m128i half = _mm_set_epi32(0, INT32_MIN, 0, INT32_MIN);
    const __m128i upper = _mm_set_epi32(-1, 0, -1, 0);
    const __m128i even = _mm_add_epi64(_mm_mul_epu32(a, b), half);
    const __m128i odd =
        _mm_add_epi64(_mm_mul_epu32(_mm_srli_epi64(a, 32), _mm_srli_epi64(b, 32)), half);
    const __m128i both = _mm_or_si128(_mm_srli_epi64(even, 32), _mm_and_si128(odd, upper));
    return _mm_sub_epi32(both, _mm_and_si128(_mm_srai_epi32(a, 31), b));
}

/* tanh on line `line` of the table at t: beyond the table's ends the slope is 0, whatever t is. */
static inline int32_t zd_read_line_q30(uint16_t line, int32_t t_q16) {
    return zd_tanh_offset_q30[line] + (zd_tanh_slope_q19[line] * t_q16);
}

/* zd_tanh_q30 of eight sums >> shift. Only the lines' numbers are limited; they fit 16 bits. */
static inline void zd_tanh8_q30(__m128i sum[2], uint8_t shift) {
    const __m128i count = _mm_cvtsi32_si128(shift);
    const __m128i t0 = _mm_sra_epi32(sum[0], count);
    const __m128i t1 = _mm_sra_epi32(sum[1], count);
    const __m128i top = _mm_packs_epi32(_mm_srai_epi32(t0, 4), _mm_srai_epi32(t1, 4));
    uint16_t line[8];
    int32_t t[8];
    _mm_storeu_si128((__m128i *)(void *)line,
                     _mm_add_epi16(_mm_srai_epi16(top, 7), _mm_set1_epi16(256)));
    zd_store4(&t[0], t0);
    zd_store4(&t[4], t1);
    sum[0] = _mm_set_epi32(zd_read_line_q30(line[3], t[3]), zd_read_line_q30(line[2], t[2]),
                           zd_read_line_q30(line[1], t[1]), zd_read_line_q30(line[0], t[0]));
    sum[1] = _mm_set_epi32(zd_read_line_q30(line[7], t[7]), zd_read_line_q30(line[6], t[6]),
                           zd_read_line_q30(line[5], t[5]), zd_read_line_q30(line[4], t[4]));
}

static inline __m128i zd_mac4(__m128i acc, const int32_t *w, __m128i x) {
    return _mm_add_epi32(acc, _mm_madd_epi16(zd_load4(w), x));
}

/* zd_gru_move of four. */
static inline void zd_gru_move4(int32_t *h_q30, __m128i n_q30, __m128i u_q31) {
    const __m128i h = zd_load4(h_q30);
    const __m128i move = zd_mul_high4(_mm_sub_epi32(n_q30, h), u_q31);
    zd_store4(h_q30, _mm_add_epi32(h, _mm_add_epi32(move, move)));
}

/* One step, reset gate after the recurrent product.
 *   x      [inputs] features
 *   h_q30  [hidden] state, updated
 *   wide   [ZD_COLUMN_UNITS] scratch
 *   v      [ZD_COLUMN_PAIRS] scratch
 *   u_keep -1 for a step in time; 0 to relax towards rest, where u = 1/2 */
static inline void zd_gru_step_columns(const zd_gru_columns_t *layer, uint32_t inputs,
                                       uint32_t hidden, const int16_t *x, int32_t *h_q30,
                                       int32_t *wide, int32_t *v, int32_t u_keep) {
    const uint32_t x_pairs = (inputs + 1u) / 2u;
    const uint32_t h_pairs = (hidden + 1u) / 2u;
    const uint32_t units = ZD_COLUMN_UNITS(hidden);
    const __m128i half = _mm_set1_epi32((int32_t)1 << 14);
    const __m128i half_q30 = _mm_set1_epi32((int32_t)1 << 30);
    const __m128i keep = _mm_set1_epi32(u_keep);
    const int32_t *w = layer->stream;
    int32_t *state = h_q30; /* in whole vectors */
    if (units != hidden) {
        for (uint32_t j = 0; j < units; j++) {
            wide[j] = (j < hidden) ? h_q30[j] : 0;
        }
        state = wide;
    }
    for (uint32_t i = 0; i < x_pairs; i++) {
        const int32_t second = (((2u * i) + 1u) < inputs) ? x[(2u * i) + 1u] : 0;
        v[i] = (int32_t)(((uint32_t)x[2u * i] & 0xFFFFu) | ((uint32_t)second << 16));
    }
    for (uint32_t j = 0; j < units; j += 8u) {
        const __m128i first = _mm_srai_epi32(_mm_add_epi32(zd_load4(&state[j]), half), 15);
        const __m128i second = _mm_srai_epi32(_mm_add_epi32(zd_load4(&state[j + 4u]), half), 15);
        zd_store4(&v[x_pairs + (j / 2u)], _mm_packs_epi32(first, second));
    }
    for (uint32_t j = 0; j < units; j += 8u) {
        __m128i r[2] = {zd_load4(&w[0]), zd_load4(&w[4])};
        __m128i u[2] = {zd_load4(&w[8]), zd_load4(&w[12])};
        __m128i n[2] = {zd_load4(&w[16]), zd_load4(&w[20])};
        __m128i inside[2] = {zd_load4(&w[24]), zd_load4(&w[28])};
        w = &w[32];
        ZD_ROLLED
        for (uint32_t i = 0; i < x_pairs; i++) {
            const __m128i pair = _mm_set1_epi32(v[i]);
            r[0] = zd_mac4(r[0], &w[0], pair);
            r[1] = zd_mac4(r[1], &w[4], pair);
            u[0] = zd_mac4(u[0], &w[8], pair);
            u[1] = zd_mac4(u[1], &w[12], pair);
            n[0] = zd_mac4(n[0], &w[16], pair);
            n[1] = zd_mac4(n[1], &w[20], pair);
            w = &w[24];
        }
        ZD_ROLLED
        for (uint32_t i = 0; i < h_pairs; i++) {
            const __m128i pair = _mm_set1_epi32(v[x_pairs + i]);
            r[0] = zd_mac4(r[0], &w[0], pair);
            r[1] = zd_mac4(r[1], &w[4], pair);
            u[0] = zd_mac4(u[0], &w[8], pair);
            u[1] = zd_mac4(u[1], &w[12], pair);
            inside[0] = zd_mac4(inside[0], &w[16], pair);
            inside[1] = zd_mac4(inside[1], &w[20], pair);
            w = &w[24];
        }
        zd_tanh8_q30(r, layer->shift[0]);
        zd_tanh8_q30(u, layer->shift[1]);
        n[0] = _mm_add_epi32(n[0], zd_mul_high4(inside[0], _mm_add_epi32(r[0], half_q30)));
        n[1] = _mm_add_epi32(n[1], zd_mul_high4(inside[1], _mm_add_epi32(r[1], half_q30)));
        zd_tanh8_q30(n, layer->shift[2]);
        zd_gru_move4(&state[j], n[0], _mm_add_epi32(_mm_and_si128(u[0], keep), half_q30));
        zd_gru_move4(&state[j + 4u], n[1], _mm_add_epi32(_mm_and_si128(u[1], keep), half_q30));
    }
    if (units != hidden) {
        for (uint32_t j = 0; j < hidden; j++) {
            h_q30[j] = wide[j];
        }
    }
}

#endif /* ZD_GRU_COLUMNS_SSE2_H */
