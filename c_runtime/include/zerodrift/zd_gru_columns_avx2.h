/* zerodrift runtime: the GRU with AVX2, eight units in one vector.
 *
 * Included by zd_gru_columns.h.
 *
 * SPDX-License-Identifier: Apache-2.0; may be used under any terms beside a generated model.
 */
#ifndef ZD_GRU_COLUMNS_AVX2_H
#define ZD_GRU_COLUMNS_AVX2_H

#if ZD_RUNTIME_ID != 0xb9f9d9e0
#error                                                                                             \
    "zd_gru_columns_avx2.h is not of the same zerodrift runtime as zd_runtime.h: copy all files again"
#endif

#include <immintrin.h>

static inline __m256i zd_load8(const int32_t *from) {
    return _mm256_loadu_si256((const __m256i *)(const void *)from);
}

static inline void zd_store8(int32_t *to, __m256i x) {
    _mm256_storeu_si256((__m256i *)(void *)to, x);
}

/* zd_mul_high of eight. */
static inline __m256i zd_mul_high8(__m256i a, __m256i b) {
    const __m256i half = _mm256_set1_epi64x(INT64_C(1) << 31);
    const __m256i even = _mm256_add_epi64(_mm256_mul_epi32(a, b), half);
    const __m256i odd = _mm256_add_epi64(
        _mm256_mul_epi32(_mm256_srli_epi64(a, 32), _mm256_srli_epi64(b, 32)), half);
    return _mm256_blend_epi32(_mm256_srli_epi64(even, 32), odd, 0xAA);
}

/* zd_tanh_q30 of eight. */
static inline __m256i zd_tanh8_q30(__m256i t_q16) {
    const __m256i low = _mm256_set1_epi32(-524288);
    const __m256i high = _mm256_set1_epi32(524287);
    const __m256i position = _mm256_min_epi32(_mm256_max_epi32(t_q16, low), high);
    const __m256i line = _mm256_srai_epi32(position, 11);
    const __m256i offset = _mm256_i32gather_epi32(&zd_tanh_offset_q30[256], line, 4);
    const __m256i both =
        _mm256_i32gather_epi32((const int *)(const void *)&zd_tanh_slope_q19[256], line, 2);
    const __m256i slope = _mm256_srai_epi32(_mm256_slli_epi32(both, 16), 16);
    return _mm256_add_epi32(offset, _mm256_mullo_epi32(slope, position));
}

static inline __m256i zd_sigmoid8_q31(__m256i half_t_q16) {
    return _mm256_add_epi32(zd_tanh8_q30(half_t_q16), _mm256_set1_epi32((int32_t)1 << 30));
}

static inline __m256i zd_mac8(__m256i acc, const int32_t *w, __m256i x) {
    return _mm256_add_epi32(acc, _mm256_madd_epi16(zd_load8(w), x));
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
    const __m256i half = _mm256_set1_epi32((int32_t)1 << 14);
    const __m256i keep = _mm256_set1_epi32(u_keep);
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
        const __m256i q15 = _mm256_srai_epi32(_mm256_add_epi32(zd_load8(&state[j]), half), 15);
        const __m256i both = _mm256_permute4x64_epi64(_mm256_packs_epi32(q15, q15), 0x08);
        _mm_storeu_si128((__m128i *)(void *)&v[x_pairs + (j / 2u)], _mm256_castsi256_si128(both));
    }
    for (uint32_t j = 0; j < units; j += 8u) {
        __m256i r = zd_load8(&w[0]);
        __m256i u = zd_load8(&w[8]);
        __m256i outside = zd_load8(&w[16]);
        __m256i inside = zd_load8(&w[24]);
        w = &w[32];
        for (uint32_t i = 0; i < x_pairs; i++) {
            const __m256i pair = _mm256_set1_epi32(v[i]);
            r = zd_mac8(r, &w[0], pair);
            u = zd_mac8(u, &w[8], pair);
            outside = zd_mac8(outside, &w[16], pair);
            w = &w[24];
        }
        for (uint32_t i = 0; i < h_pairs; i++) {
            const __m256i pair = _mm256_set1_epi32(v[x_pairs + i]);
            r = zd_mac8(r, &w[0], pair);
            u = zd_mac8(u, &w[8], pair);
            inside = zd_mac8(inside, &w[16], pair);
            w = &w[24];
        }
        const __m256i r_q31 = zd_sigmoid8_q31(_mm256_srai_epi32(r, layer->shift[0]));
        const __m256i kept =
            _mm256_and_si256(zd_tanh8_q30(_mm256_srai_epi32(u, layer->shift[1])), keep);
        const __m256i u_q31 = _mm256_add_epi32(kept, _mm256_set1_epi32((int32_t)1 << 30));
        const __m256i a_n = _mm256_add_epi32(outside, zd_mul_high8(inside, r_q31));
        const __m256i n_q30 = zd_tanh8_q30(_mm256_srai_epi32(a_n, layer->shift[2]));
        const __m256i h = zd_load8(&state[j]);
        const __m256i move = zd_mul_high8(_mm256_sub_epi32(n_q30, h), u_q31);
        zd_store8(&state[j], _mm256_add_epi32(h, _mm256_add_epi32(move, move)));
    }
    if (units != hidden) {
        for (uint32_t j = 0; j < hidden; j++) {
            h_q30[j] = wide[j];
        }
    }
}

#endif /* ZD_GRU_COLUMNS_AVX2_H */
