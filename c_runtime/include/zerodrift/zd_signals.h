/* zerodrift runtime: low-passes and the signals of effects (specification, 3).
 *
 * Included by zd_runtime.h.
 *
 * SPDX-License-Identifier: Apache-2.0; may be used under any terms beside a generated model.
 */
#ifndef ZD_SIGNALS_H
#define ZD_SIGNALS_H

#if ZD_RUNTIME_ID != 0x08eba25e
#error "zd_signals.h is not of the same zerodrift runtime as zd_runtime.h: copy all files again"
#endif

/* --- Low-pass: v has ZD_LOWPASS_FRACTION more fractional bits than x (specification, 3.4). ---- */

static inline int64_t zd_lowpass_rest(int32_t x, int32_t c_q24) {
    return (int64_t)x * (((int32_t)1 << ZD_LOWPASS_FRACTION) - c_q24);
}

static inline int32_t zd_lowpass(int64_t *v, int32_t x, int32_t c_q24, int32_t m_q31,
                                 unsigned shift) {
    const int64_t y = *v + ((int64_t)x * c_q24);
    const int64_t gap =
        zd_round_shift64(((int64_t)x * ((int32_t)1 << ZD_LOWPASS_FRACTION)) - y, 22);
    *v += zd_round_shift64(gap * m_q31, shift);
    return (int32_t)zd_round_shift64(y, ZD_LOWPASS_FRACTION);
}

/* --- Signals of effects (specification, 3) ---------------------------------------------------- */

/* What the caller measured less the drift of the step before, limited; any int32. */
static inline int32_t zd_load(int32_t measured, int32_t drift, int32_t low, int32_t high) {
    return (int32_t)zd_clamp64((int64_t)measured - drift, low, high);
}

/* Slack of half_width to either side; x -+ half_width fit by proof. */
static inline int32_t zd_play(int32_t *y, int32_t x, int32_t half_width) {
    *y = zd_clamp32(*y, x - half_width, x + half_width);
    return *y;
}

/* A share of the way from `older` to `newer`, 0 <= newer_q31 < 2^31. */
static inline int32_t zd_between(int32_t older, int32_t newer, int32_t newer_q31) {
    const int64_t rise = ((int64_t)newer - older) * newer_q31;
    return older + (int32_t)zd_round_shift64(rise, 31u);
}

/* c[0] + c[1] f + ... by Horner's rule for f in Q0.31, 0 <= f < 1; each sum fits by proof. */
static inline int32_t zd_polynomial(const int32_t *c, uint32_t count, int32_t f_q31) {
    int32_t sum = c[count - 1u];
    for (uint32_t i = count - 1u; i > 0u; i--) {
        sum = c[i - 1u] + (int32_t)zd_round_shift64((int64_t)sum * f_q31, 31u);
    }
    return sum;
}

/* Constants of x^p for one p that is not whole. */
typedef struct {
    const int32_t *octave; /* polynomial of (1 + f)^p */
    const int32_t *gains;  /* 2^(n p), n = 0, 1, ... */
    int32_t low;           /* (1 + f)^p at the ends of the octave */
    int32_t high;
    uint8_t terms; /* of the polynomial */
    uint8_t shift;
} zd_power_t;

/* x^p, 0 for x <= 0; the table of gains reaches the largest x by proof. */
static inline int32_t zd_power(const zd_power_t *power, int32_t x) {
    uint32_t mantissa = (uint32_t)zd_clamp32(x, 1, INT32_MAX) << 1;
    uint32_t n = 30u;
    while (mantissa < 0x80000000u) { /* at most 30 times */
        mantissa <<= 1;
        n--;
    }
    const int32_t f_q31 = (int32_t)(mantissa & 0x7FFFFFFFu);
    const int32_t octave =
        zd_clamp32(zd_polynomial(power->octave, power->terms, f_q31), power->low, power->high);
    const int64_t product = (int64_t)octave * power->gains[n];
    return (x > 0) ? (int32_t)zd_round_shift64(product, power->shift) : 0;
}

#endif /* ZD_SIGNALS_H */
