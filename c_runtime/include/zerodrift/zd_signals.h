/* zerodrift runtime: low-passes and the signals of effects (specification, 3).
 *
 * Included by zd_runtime.h.
 *
 * SPDX-License-Identifier: Apache-2.0; may be used under any terms beside a generated model.
 */
#ifndef ZD_SIGNALS_H
#define ZD_SIGNALS_H

#if ZD_RUNTIME_ID != 0xb9f9d9e0
#error "zd_signals.h is not of the same zerodrift runtime as zd_runtime.h: copy all files again"
#endif

/* --- Low-pass: v has ZD_LOWPASS_FRACTION more fractional bits than x (specification, 3.4). ---- */

static inline int64_t zd_lowpass_rest(int32_t x, int32_t c_q24) {
    return (int64_t)x * (((int32_t)1 << ZD_LOWPASS_FRACTION) - c_q24);
}

static inline int32_t zd_lowpass(int64_t *v, int32_t x, int32_t c_q24, int32_t m_q31,
                                 unsigned shift) {
    const int64_t y = *v + ((int64_t)x * c_q24);
    const int32_t gap = (int32_t)zd_round_shift64(
        ((int64_t)x * ((int32_t)1 << ZD_LOWPASS_FRACTION)) - y, 22); /* fits by proof */
    *v += zd_round_shift64((int64_t)gap * m_q31, shift);
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

/* Drift counted from a tare on, limited (specification, 5); tared: 0 no answer yet, 1 answered,
 * 2 tared. 1 if an answer stands at a limit. */
static inline uint32_t zd_count_from(int32_t *drift, int32_t *answered, int32_t *tared,
                                     const int32_t *tare, uint32_t n) {
    uint32_t limited = 0;
    for (uint32_t k = 0; k < n; k++) {
        answered[k] = drift[k];
    }
    if (*tared == 2) {
        for (uint32_t k = 0; k < n; k++) {
            const int64_t from = (int64_t)drift[k] - tare[k];
            drift[k] = (int32_t)zd_clamp64(from, INT32_MIN, INT32_MAX);
            if (drift[k] != from) {
                limited = 1u;
            }
        }
    } else {
        *tared = 1;
    }
    return limited;
}

/* --- Steps that are told how long they lasted (specification, 3.16 and 5) -------------------- */

#define ZD_LONGEST_US INT64_C(2305843009213693952) /* 2^61: longer times count as this one */

/* What is added to the last step: the time slept, and that since then; 0 <= slept <= 2^61. */
static inline int64_t zd_add_span(int64_t slept_us, uint64_t elapsed_us) {
    const int64_t own =
        (elapsed_us < (uint64_t)ZD_LONGEST_US) ? (int64_t)elapsed_us : ZD_LONGEST_US;
    const int64_t both = slept_us + own;
    return (both < ZD_LONGEST_US) ? both : ZD_LONGEST_US;
}

/* A time of the self-test's: up to 2^47 us, each power of two as often as any other. */
static inline uint64_t zd_draw_time(uint32_t seed) {
    return (uint64_t)(seed >> 16) << ((seed >> 11) & 31u);
}

/* 1 if the code moved by more than rate_max in each period of the span, a span shorter than a
 * period counting as one; over 2^32 us and more it is not told. 0 <= rate_max, 1 <= period_us. */
static inline uint32_t zd_is_fast(int32_t now, int32_t before, int32_t rate_max, int64_t span_us,
                                  uint32_t period_us) {
    const int64_t change = (int64_t)now - before;
    const int64_t moved = zd_clamp64((change < 0) ? -change : change, 0, INT32_MAX);
    const int64_t held = (span_us > (int64_t)period_us) ? span_us : (int64_t)period_us;
    if (held > INT64_C(4294967295)) {
        return 0u;
    }
    return ((moved * (int64_t)period_us) > ((int64_t)rate_max * held)) ? 1u : 0u; /* < 2^63 */
}

/* Time since the start, up to limit 2^bits us, in ticks of 2^bits us to the nearest. */
static inline int32_t zd_add_time(int64_t *time_us, int64_t span_us, int32_t limit, unsigned bits) {
    const int64_t most = (int64_t)((uint64_t)(uint32_t)limit << bits);
    const int64_t sum = *time_us + span_us;
    *time_us = (sum < most) ? sum : most;
    return (int32_t)zd_round_shift64(*time_us, bits);
}

/* n for 2^(n - 1) <= x < 2^n; 0 for 0. */
static inline uint32_t zd_count_bits(uint64_t x) {
    uint64_t left = x;
    uint32_t bits = (x > 0u) ? 1u : 0u;
    for (uint32_t halved = 0; halved < 6u; halved++) {
        const uint32_t by = 32u >> halved;
        if ((left >> by) > 0u) {
            left >>= by;
            bits += by;
        }
    }
    return bits;
}

/* A step of r = dt / tau: y' = y + a (x - y) + c (x' - x). */
typedef struct {
    int32_t a_q31; /* a = a_q31 2^-(31 + k) = 1 - exp(-r) */
    int32_t c_q31; /* c = c_q31 2^-31 = 1 - a / r, never above a */
    uint32_t k;    /* 0 .. 19 */
} zd_shares_t;

/* a b 2^-31 for 0 <= a, b <= 2^31, rounded down. */
static inline uint32_t zd_part(uint32_t a, uint32_t b) {
    return (uint32_t)(((uint64_t)a * b) >> 31);
}

/* Finds the shares of r = time_us rate_q31 2^-(31 + shift); 0 if r < 2^-20, which is collected.
 * 0 <= time_us < 2^62, 1 <= rate_q31, shift <= 50. */
static inline uint32_t zd_find_shares(zd_shares_t *shares, int64_t time_us, int32_t rate_q31,
                                      unsigned shift) {
    const uint64_t time = (uint64_t)time_us;
    const uint32_t bits = zd_count_bits(time);
    const uint64_t place = (bits > 32u) ? (time >> (bits - 32u)) : (time << (32u - bits));
    const uint64_t product = place * (uint32_t)rate_q31;
    const uint32_t wide = zd_count_bits(product);
    const int32_t e = ((int32_t)wide + (int32_t)bits) - (63 + (int32_t)shift);
    if ((time == 0u) || (e < -19)) {
        return 0u;
    }
    /* r = m 2^(e - 31), 2^30 <= m < 2^31; more than 2^24 counts as that */
    const uint32_t m = (e > 24) ? UINT32_C(2147483647) : (uint32_t)(product >> (wide - 31u));
    const uint32_t k = (e < 0) ? (uint32_t)(-e) : 0u;
    const uint32_t f = m >> k;
    uint32_t straight = UINT32_C(9); /* 2^32 / (n + 2)! for n = 10 .. 0 */
    straight = UINT32_C(108) - zd_part(f, straight);
    straight = UINT32_C(1184) - zd_part(f, straight);
    straight = UINT32_C(11836) - zd_part(f, straight);
    straight = UINT32_C(106522) - zd_part(f, straight);
    straight = UINT32_C(852176) - zd_part(f, straight);
    straight = UINT32_C(5965232) - zd_part(f, straight);
    straight = UINT32_C(35791394) - zd_part(f, straight);
    straight = UINT32_C(178956971) - zd_part(f, straight);
    straight = UINT32_C(715827883) - zd_part(f, straight);
    straight = UINT32_C(2147483648) - zd_part(f, straight);
    uint32_t c = (uint32_t)(((uint64_t)f * straight) >> 32);
    uint32_t a = m - zd_part(m, c);
    uint32_t s = UINT32_C(2147483648) - c; /* a / r */
    const int32_t doublings = (e < 24) ? e : 24;
    for (int32_t doubled = 0; doubled < doublings; doubled++) {
        s -= (uint32_t)(((uint64_t)s * a) >> 32);
        a = (2u * a) - (uint32_t)((((uint64_t)a * a) + UINT32_C(2147483647)) >> 31);
    }
    c = UINT32_C(2147483648) - s;
    if (c > (a >> k)) { /* changes nothing; what is proven rests on it */
        c = a >> k;
    }
    shares->a_q31 = (int32_t)a;
    shares->c_q31 = (int32_t)c;
    shares->k = k;
    return 1u;
}

/* Low-pass, exact for a straight line from the last input to x; y has ZD_LOWPASS_FRACTION more
 * fractional bits than x. A step that is too short moves nothing and waits for the next. */
static inline int32_t zd_lowpass_after(int32_t *before, int32_t *waiting_us, int64_t *y, int32_t x,
                                       int64_t span_us, int32_t rate_q31, unsigned shift) {
    const int64_t time_us = (int64_t)*waiting_us + span_us;
    zd_shares_t shares = {0};
    if (zd_find_shares(&shares, time_us, rate_q31, shift) == 0u) {
        *waiting_us = (int32_t)time_us; /* below 2^31 by proof */
    } else {
        const int64_t gap =
            zd_round_shift64(((int64_t)*before * ((int32_t)1 << ZD_LOWPASS_FRACTION)) - *y, 22u);
        const int64_t rise = ((int64_t)x - *before) * shares.c_q31;
        *y += zd_round_shift64(gap * shares.a_q31, 9u + (unsigned)shares.k) +
              zd_round_shift64(rise, 7u);
        *before = x;
        *waiting_us = 0;
    }
    return (int32_t)zd_round_shift64(*y, ZD_LOWPASS_FRACTION);
}

#endif /* ZD_SIGNALS_H */
