/* zerodrift runtime: layer normalisation (docs/reference/integer-layers.md, 4).
 *
 * Included by a model that needs it, after zd_runtime.h.
 *
 * SPDX-License-Identifier: Apache-2.0; may be used under any terms beside a generated model.
 */
#ifndef ZD_LAYER_NORM_H
#define ZD_LAYER_NORM_H

#include "zd_network.h"

#if ZD_RUNTIME_ID != 0xb9f9d9e0
#error "zd_layer_norm.h is not of the same zerodrift runtime as zd_runtime.h: copy all files again"
#endif

/* Constants of one layer of M numbers. */
typedef struct {
    const uint8_t *align; /* [M] what brings the numbers to one scale */
    const int32_t *gain;  /* [M] |gain| <= 2^30 */
    const uint8_t *shift; /* [M] product with the gain -> result */
    const int32_t *bias;  /* [M] in the result's unit */
    int64_t epsilon;      /* M epsilon in the unit of the squares, 1 .. 2^60 */
    int32_t reciprocal;   /* 2^mean_shift / M */
    int32_t root;         /* sqrt(M) in Q26 */
    uint8_t mean_shift;   /* 27 and the whole part of log2 M */
} zd_layer_norm_t;

#define ZD_NORM_START 1143535043 /* 2.13 and 1.215 in Q29 */
#define ZD_NORM_SLOPE 652298158
#define ZD_NORM_THREE 1610612736 /* 3 in Q29 */

/* 1 / sqrt(a) in Q29 of a in Q30, 1/4 <= a < 1: four rounds of Newton's rule from a line. */
static inline int64_t zd_inverse_root_q29(int32_t a_q30) {
    int64_t r = ZD_NORM_START - zd_asr64((int64_t)ZD_NORM_SLOPE * a_q30, 30);
    for (uint32_t k = 0; k < 4u; k++) {
        const int64_t square = zd_asr64(r * r, 29);
        r = zd_asr64(r * (ZD_NORM_THREE - zd_asr64(square * a_q30, 30)), 30);
    }
    return r;
}

/* y = gain (x - mean) / sqrt(variance + epsilon) + bias, over all numbers of a sample.
 *   x     [width] as int16 copies
 *   y     [width] result, with 15 more fractional bits than its own copies
 * No loop is longer for one value than for another. |y| before the mean is taken off <= 2^27, their
 * sum <= 2^34, the sum of squares < 2^62 (both proven per model). A number's own square is one of
 * them, so that |part| <= root + 8, and the last product < 2^60. */
static inline void zd_layer_norm(const zd_layer_norm_t *layer, const int16_t *x, int32_t *y,
                                 uint32_t width) {
    int64_t sum = 0;
    for (uint32_t i = 0; i < width; i++) {
        y[i] = (int32_t)zd_round_shift64((int64_t)x[i] * 4096, layer->align[i]);
        sum += y[i];
    }
    const int32_t mean = (int32_t)zd_round_shift64(sum * layer->reciprocal, layer->mean_shift);
    uint64_t squares = (uint64_t)layer->epsilon;
    for (uint32_t i = 0; i < width; i++) {
        y[i] -= mean;
        squares += (uint64_t)((int64_t)y[i] * y[i]);
    }
    /* to 2^60 .. 2^62, by an even number of doublings */
    uint32_t doublings = 0;
    for (uint32_t k = 0; k < 5u; k++) {
        const uint32_t by = 32u >> k;
        /* 1 if W < 2^(62 - by), by the sign of what is above less 1: no branch */
        uint32_t some = (uint32_t)(((squares >> (62u - by)) - 1u) >> 63);
        ZD_FORGET_NUMBER(some);
        squares ^= (squares ^ (squares << by)) & ((uint64_t)0 - some);
        doublings += some * by;
    }
    const int64_t inverse = zd_inverse_root_q29((int32_t)(squares >> 32));
    const int64_t scale = zd_asr64(inverse * layer->root, 29);
    for (uint32_t i = 0; i < width; i++) {
        const int64_t part = zd_round_shift64(y[i] * scale, 31u - (doublings / 2u));
        y[i] = (int32_t)zd_round_shift64(part * layer->gain[i], layer->shift[i]) + layer->bias[i];
    }
}

#endif /* ZD_LAYER_NORM_H */
