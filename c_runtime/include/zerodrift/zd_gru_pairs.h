/* zerodrift runtime: the GRU on Cortex-M: those with a dual 16-bit multiplier, and the smallest.
 *
 * Included by zd_runtime.h. Pairs of 16-bit numbers lie in one 32-bit word; the model's weights are
 * laid out so when it is generated. The generated assembly reads the same stream.
 *
 * SPDX-License-Identifier: Apache-2.0; may be used under any terms beside a generated model.
 */
#ifndef ZD_GRU_PAIRS_H
#define ZD_GRU_PAIRS_H

#if ZD_RUNTIME_ID != 0xb9f9d9e0
#error "zd_gru_pairs.h is not of the same zerodrift runtime as zd_runtime.h: copy all files again"
#endif

/* Constants of one layer. */
typedef struct {
    const int32_t *stream; /* [H][4 + 3 (X + R)]; X pairs of features, R pairs of the state */
    uint8_t shift[3];      /* accumulator of r, u, n -> t_q16 */
} zd_gru_pairs_t;

/* Features and state as the products read them: in pairs where one instruction multiplies two,
 * otherwise one by one, an odd number filled up with a zero. */
#if defined(__ARM_FEATURE_DSP)
#define ZD_PER_PAIR 1u
#else
#define ZD_PER_PAIR 2u
#endif
#define ZD_PAIR_SCRATCH(inputs, hidden)                                                            \
    (ZD_PER_PAIR * ((((inputs) + 1u) / 2u) + (((hidden) + 1u) / 2u)))

/* acc + low(w) v[0] + high(w) v[1]; the caller's proof bounds every partial sum. */
static inline int32_t zd_mac_pair(int32_t acc, int32_t w, const int32_t *v) {
#if defined(__ARM_FEATURE_DSP)
    return __smlad(w, v[0], acc);
#else
    const int32_t low = zd_asr32((int32_t)((uint32_t)w << 16), 16);
    return acc + (low * v[0]) + (zd_asr32(w, 16) * v[1]);
#endif
}

/* v <- a pair; of both only the lower 16 bits count. */
static inline void zd_put_pair(int32_t *v, int32_t low, int32_t high) {
#if defined(__ARM_FEATURE_DSP)
    v[0] = (int32_t)(((uint32_t)low & 0xFFFFu) | ((uint32_t)high << 16));
#else
    v[0] = low;
    v[1] = high;
#endif
}

/* A state as the products read it. */
static inline int32_t zd_state_q15(int32_t h_q30) {
    return zd_asr32(h_q30 + ((int32_t)1 << 14), 15);
}

/* v [ZD_PAIR_SCRATCH] <- features and rounded state. */
static inline void zd_gru_pack_pairs(const int16_t *x, uint32_t inputs, const int32_t *h_q30,
                                     uint32_t hidden, int32_t *v) {
    int32_t *to = v;
    for (uint32_t i = 0; i < inputs; i += 2u) {
        zd_put_pair(to, x[i], ((i + 1u) < inputs) ? x[i + 1u] : 0);
        to = &to[ZD_PER_PAIR];
    }
    uint32_t j = 0;
#if defined(__ARM_FEATURE_DSP)
    for (; (j + 4u) <= hidden; j += 4u) { /* two pairs, which one instruction stores */
        int32_t both[2];
        zd_put_pair(&both[0], zd_state_q15(h_q30[j]), zd_state_q15(h_q30[j + 1u]));
        zd_put_pair(&both[1], zd_state_q15(h_q30[j + 2u]), zd_state_q15(h_q30[j + 3u]));
        to[0] = both[0];
        to[1] = both[1];
        to = &to[2];
    }
#endif
    for (; j < hidden; j += 2u) {
        const int32_t high = ((j + 1u) < hidden) ? zd_state_q15(h_q30[j + 1u]) : 0;
        zd_put_pair(to, zd_state_q15(h_q30[j]), high);
        to = &to[ZD_PER_PAIR];
    }
}

/* acc += three rows of `pairs` pairs at w, in blocks of two pairs; returns the words read. */
static inline uint32_t zd_gru_mac3_pairs(const int32_t *w, const int32_t *v, uint32_t pairs,
                                         int32_t acc[3]) {
    int32_t a = acc[0];
    int32_t b = acc[1];
    int32_t c = acc[2];
    uint32_t i = 0;
    ZD_UNROLLED
    for (; (i + 2u) <= pairs; i += 2u) {
        ZD_IN_ORDER(w);
        ZD_IN_ORDER(v);
        const int32_t *block = &w[3u * i];
        const int32_t *first = &v[ZD_PER_PAIR * i];
        const int32_t *second = &first[ZD_PER_PAIR];
        a = zd_mac_pair(zd_mac_pair(a, block[0], first), block[1], second);
        b = zd_mac_pair(zd_mac_pair(b, block[2], first), block[3], second);
        c = zd_mac_pair(zd_mac_pair(c, block[4], first), block[5], second);
    }
    if (i < pairs) {
        const int32_t *block = &w[3u * i];
        a = zd_mac_pair(a, block[0], &v[ZD_PER_PAIR * i]);
        b = zd_mac_pair(b, block[1], &v[ZD_PER_PAIR * i]);
        c = zd_mac_pair(c, block[2], &v[ZD_PER_PAIR * i]);
    }
    acc[0] = a;
    acc[1] = b;
    acc[2] = c;
    return 3u * pairs;
}

/* One step, reset gate after the recurrent product.
 *   x      [inputs] features
 *   h_q30  [hidden] state, updated
 *   v      [ZD_PAIR_SCRATCH(inputs, hidden)] scratch
 *   u_keep -1 for a step in time; 0 to relax towards rest, where u = 1/2 */
static inline void zd_gru_step_pairs(const zd_gru_pairs_t *layer, uint32_t inputs, uint32_t hidden,
                                     const int16_t *x, int32_t *h_q30, int32_t *v, int32_t u_keep) {
    const uint32_t x_pairs = (inputs + 1u) / 2u;
    const int32_t *w = layer->stream;
    zd_table_t table;
    zd_find_table(&table);
    zd_gru_pack_pairs(x, inputs, h_q30, hidden, v);
    int32_t *h = h_q30;
    const int32_t *end = &h_q30[hidden];
    while (h != end) {
        ZD_PER_UNIT(w);
        ZD_PER_UNIT(v);
        const int32_t bias_n = w[3];
        int32_t acc[3] = {w[0], w[1], w[2]};
        w = &w[4];
        w = &w[zd_gru_mac3_pairs(w, v, x_pairs, acc)];
        const int32_t outside = acc[2];
        acc[2] = bias_n;
        w = &w[zd_gru_mac3_pairs(w, &v[ZD_PER_PAIR * x_pairs], (hidden + 1u) / 2u, acc)];
        const int32_t half_q30 = (int32_t)1 << 30;
        const int32_t r_q30 = zd_read_q30(zd_asr32(acc[0], layer->shift[0]), &table);
        const int32_t u_q30 = zd_read_q30(zd_asr32(acc[1], layer->shift[1]), &table);
        const int32_t a_n = outside + zd_mul_high(acc[2], r_q30 + half_q30);
        const int32_t n_q30 = zd_read_q30(zd_asr32(a_n, layer->shift[2]), &table);
        h[0] = zd_gru_move(h[0], n_q30, (u_q30 & u_keep) + half_q30);
        h = &h[1];
        ZD_PER_UNIT(h);
    }
}

#endif /* ZD_GRU_PAIRS_H */
