/* zerodrift runtime: the fixed-point kernels that every generated model calls.
 *
 * Specification: docs/reference/integer-arithmetic.md. C99, no heap, no float, no recursion, no
 * variable-length array. All sizes are compile-time constants of the generated model, so that the
 * compiler specialises each kernel. Every accumulator named here is bounded for any input; the
 * generator proves the bound for the actual weights before it writes a model.
 *
 * SPDX-License-Identifier: Apache-2.0; the parts copied beside a generated model may be used under
 * any terms (GENERATED-CODE-EXCEPTION.md).
 */
#ifndef ZD_RUNTIME_H
#define ZD_RUNTIME_H

#include <stddef.h>
#include <stdint.h>

#if defined(__ARM_FEATURE_DSP) || defined(__ARM_FEATURE_SAT)
#include <arm_acle.h>
#endif

/* How a GRU with 16-bit weights and its reset gate after the product is computed. All ways give the
 * same bits; the target's own macros choose, -DZD_KERNEL=... overrides (docs/reference/kernels.md).
 * ZD_SMALL, defined for every file of a build, trades speed for 2.3 KB of flash. */
#define ZD_KERNEL_PORTABLE 0
#define ZD_KERNEL_PAIRS 1   /* dual 16-bit multiplier: Cortex-M4, M7, M33 */
#define ZD_KERNEL_ROWS 2    /* Arm MVE: Cortex-M55, M85 */
#define ZD_KERNEL_COLUMNS 3 /* AVX2 */
#if !defined(ZD_KERNEL)
#if defined(ZD_SMALL)
#define ZD_KERNEL ZD_KERNEL_PORTABLE
#elif defined(__ARM_FEATURE_MVE)
#define ZD_KERNEL ZD_KERNEL_ROWS
#elif defined(__ARM_FEATURE_DSP)
#define ZD_KERNEL ZD_KERNEL_PAIRS
#elif defined(__AVX2__)
#define ZD_KERNEL ZD_KERNEL_COLUMNS
#else
#define ZD_KERNEL ZD_KERNEL_PORTABLE
#endif
#endif

/* A model generated for another format must be regenerated: its constants mean something else. */
#define ZD_RUNTIME_FORMAT 2

#if defined(ZD_SMALL)
#define ZD_TANH_HALF_NODES 179
#else
#define ZD_TANH_LINES 512
#endif
#define ZD_LOWPASS_FRACTION 24
#define ZD_GRU_RELAX_STEPS 64
#define ZD_GRU_H_LIMIT_Q30 1073709057 /* 2^30 - 2^15 + 1: |h| never exceeds it */

/* The table of the specification, 4.1, in one of two forms. An undefined reference to one of these
 * means that ZD_SMALL was defined for a part of the build only. */
#if defined(ZD_SMALL)
/* tanh at 0, 1/32, ..., 178/32 in Q0.19; beyond, the last value holds. */
extern const int32_t zd_tanh_half_q19[ZD_TANH_HALF_NODES];
#else
/* Line i - 256 of 512, between (i - 256) / 32 and the next: its rise in Q0.19 and where it cuts the
 * axis in Q0.30. One more slope, so that a vector unit may read 32 bits at the last one. */
extern const int32_t zd_tanh_offset_q30[ZD_TANH_LINES];
extern const int16_t zd_tanh_slope_q19[ZD_TANH_LINES + 1];
#endif

/* 2^f = sum c[i] f^i for 0 <= f <= 1 in Q2.29. */
#define ZD_EXP2_TERMS 7u
extern const int32_t zd_exp2_octave_q29[ZD_EXP2_TERMS];

/* CRC-32 (reflected 0xEDB88320) of n bytes, continued from crc; start with 0. */
uint32_t zd_crc32(uint32_t crc, const uint8_t *bytes, uint32_t n);

/* Continues the CRC-32 with the four bytes of x, least significant first. */
uint32_t zd_crc32_word(uint32_t crc, uint32_t x);

/* Continues the CRC-32 with each of n numbers as a 32-bit word. */
uint32_t zd_crc32_i16(uint32_t crc, const int16_t *values, uint32_t n);
uint32_t zd_crc32_i32(uint32_t crc, const int32_t *values, uint32_t n);

/* 1 if the activation table is what it was written as. */
uint32_t zd_tables_are_sound(void);

/* A state's copy: version, model, size, the bytes, CRC-32; ZD_SAVED_EXTRA bytes more than the
 * state. For the same build of a firmware: the bytes lie as the compiler laid them out. */
#define ZD_SAVED_VERSION 1u
#define ZD_SAVED_EXTRA 16u
void zd_save(uint8_t *saved, const uint8_t *state, uint32_t size, uint32_t identity);

/* 0 = restored; otherwise the copy is damaged, or another version's or model's, and the state is
 * left as it was. */
uint32_t zd_restore(uint8_t *state, const uint8_t *saved, uint32_t size, uint32_t identity);

/* Makes the compiler forget what it knows of a pointer and of memory. Without it, it spreads small
 * arrays over registers that it does not have, or addresses them too far away for short loads. */
#if defined(__GNUC__) && !defined(__OPTIMIZE_SIZE__)
#define ZD_FORGET(pointer) __asm volatile("" : "+r"(pointer) : : "memory")
#else
#define ZD_FORGET(pointer)
#endif
/* The same of a number: a mask that the compiler knows to be a mask becomes a branch. */
#if defined(__GNUC__)
#define ZD_FORGET_NUMBER(x) __asm("" : "+r"(x))
#else
#define ZD_FORGET_NUMBER(x)
#endif

/* --- Shifts and rounding: the only places where a signed number is shifted right. ------------- */

/* C99 leaves the shift of a negative number to the compiler; all supported ones keep the sign. */
typedef char zd_assert_arithmetic_shift[((-1 >> 1) == -1) ? 1 : -1];

/* floor(x / 2^shift), 0 <= shift <= 31. */
static inline int32_t zd_asr32(int32_t x, unsigned shift) { return x >> shift; }

/* floor(x / 2^shift), 0 <= shift <= 63. */
static inline int64_t zd_asr64(int64_t x, unsigned shift) { return x >> shift; }

/* x / 2^shift to nearest, halves up; |x| < 2^63 - 2^(shift - 1), 0 <= shift <= 62. */
static inline int64_t zd_round_shift64(int64_t x, unsigned shift) {
    return zd_asr64(x + (int64_t)(((uint64_t)1 << shift) >> 1), shift);
}

/* a * b / 2^32 to nearest, halves up; any a, b except both -2^31. */
static inline int32_t zd_mul_high(int32_t a, int32_t b) {
#if defined(__ARM_ARCH_6M__) || defined(__ARM_ARCH_8M_BASE__)
    /* No 64-bit product here: of halves, a = 2^16 ah + al. |middle| <= 32767 * 65535 + 65534 +
     * 32768 = 2^31 - 1, and the second sum is smaller. */
    const int32_t ah = zd_asr32(a, 16);
    const int32_t bh = zd_asr32(b, 16);
    const uint32_t al = (uint32_t)a & 0xFFFFu;
    const uint32_t bl = (uint32_t)b & 0xFFFFu;
    const int32_t middle = (ah * (int32_t)bl) + (int32_t)((al * bl) >> 16) + 32768;
    const int32_t other = ((int32_t)al * bh) + (int32_t)((uint32_t)middle & 0xFFFFu);
    return (ah * bh) + zd_asr32(middle, 16) + zd_asr32(other, 16);
#elif defined(__riscv)
    const int64_t product = (int64_t)a * b;
    return (int32_t)zd_asr64(product, 32) + (int32_t)(((uint32_t)product) >> 31);
#else
    return (int32_t)zd_asr64(((int64_t)a * b) + ((int64_t)1 << 31), 32);
#endif
}

static inline int32_t zd_clamp32(int32_t x, int32_t low, int32_t high) {
    return (x < low) ? low : ((x > high) ? high : x);
}

static inline int64_t zd_clamp64(int64_t x, int64_t low, int64_t high) {
    return (x < low) ? low : ((x > high) ? high : x);
}

/* --- Activations ------------------------------------------------------------------------------ */

/* t limited to 20 bits, -2^19 .. 2^19 - 1; without a branch on every core. */
static inline int32_t zd_saturate20(int32_t t) {
#if defined(__ARM_FEATURE_SAT)
    return __ssat(t, 20);
#elif defined(__riscv) || defined(__ARM_ARCH_6M__) || defined(__ARM_ARCH_8M_BASE__)
    const int32_t sign = zd_asr32(t, 31);
    int32_t inside = -(zd_asr32(t, 19) ^ sign); /* 0 if t has 20 bits, negative otherwise */
    ZD_FORGET_NUMBER(inside);
    return t ^ ((t ^ sign ^ 524287) & zd_asr32(inside, 31));
#else
    return zd_clamp32(t, -524288, 524287);
#endif
}

#if !defined(ZD_SMALL)
/* tanh in Q0.30 of t, from the middles of the two tables. |slope * t| < 2^29: where a line is
 * steep, t is small. */
static inline int32_t zd_line_q30(int32_t t_q16, const int32_t *offset_q30,
                                  const int16_t *slope_q19) {
    const int32_t position = zd_saturate20(t_q16);
    const int32_t line = zd_asr32(position, 11);
    return offset_q30[line] + (slope_q19[line] * position);
}
#endif

/* tanh in Q0.30 of t in Q3.16, any int32: outside -8 .. 8 the ends hold. |result| <= 2^30 - 2^15.
 */
static inline int32_t zd_tanh_q30(int32_t t_q16) {
#if defined(ZD_SMALL)
    const int32_t end = (ZD_TANH_HALF_NODES - 2) * 2048;
    const int32_t clamped = zd_clamp32(t_q16, -end, end);
    const int32_t sign = zd_asr32(clamped, 31);
    const uint32_t position = (uint32_t)((clamped ^ sign) - sign);
    const int32_t start = zd_tanh_half_q19[position >> 11];
    const int32_t slope = zd_tanh_half_q19[(position >> 11) + 1u] - start;
    const int32_t size = (start * 2048) + (slope * (int32_t)(position & 2047u));
    return (size ^ sign) - sign;
#else
    return zd_line_q30(t_q16, &zd_tanh_offset_q30[256], &zd_tanh_slope_q19[256]);
#endif
}

/* sigmoid in Q0.31 of twice t in Q3.16: 2^15 .. 2^31 - 2^15. */
static inline int32_t zd_sigmoid_q31(int32_t half_t_q16) {
    return zd_tanh_q30(half_t_q16) + ((int32_t)1 << 30);
}

/* --- Dot products: the caller's proof bounds the sum of absolute products by 2^31 - 1. -------- */

/* No partial sum can overflow, so the order of the terms is free: every variant gives the same
 * sum. Chips take two neighbours at a time (ZD_LANES 2), in one instruction where they have a dual
 * multiplier; compilers for vector units want the plain loop (ZD_LANES 1). */
#if !defined(ZD_LANES)
#if defined(__SSE2__) || defined(__ARM_NEON)
#define ZD_LANES 1u
#else
#define ZD_LANES 2u
#endif
#endif

#if (ZD_LANES == 1u) && defined(__GNUC__) && !defined(__clang__)
#define ZD_ROLLED _Pragma("GCC unroll 1") /* or gcc -O3 unrolls the loop before vectorising it */
#else
#define ZD_ROLLED
#endif

#if ZD_LANES == 1u
#define ZD_UNROLLED ZD_ROLLED
#define ZD_IN_ORDER(pointer)
#elif defined(__GNUC__) && !defined(__clang__) && !defined(__OPTIMIZE_SIZE__)
#define ZD_UNROLLED _Pragma("GCC unroll 16")
#define ZD_IN_ORDER(pointer) ZD_FORGET(pointer)
#else
#define ZD_UNROLLED
#define ZD_IN_ORDER(pointer)
#endif
#if defined(__thumb__) && defined(__clang__)
#define ZD_PER_UNIT(pointer) ZD_FORGET(pointer)
#else
#define ZD_PER_UNIT(pointer)
#endif

/* acc + w . x of ZD_LANES neighbours. */
static inline int32_t zd_mac(int32_t acc, const int16_t *w, const int16_t *x) {
#if ZD_LANES == 1u
    return acc + ((int32_t)w[0] * x[0]);
#elif defined(__ARM_FEATURE_DSP)
    const uint32_t w_pair = (uint16_t)w[0] | ((uint32_t)(uint16_t)w[1] << 16);
    const uint32_t x_pair = (uint16_t)x[0] | ((uint32_t)(uint16_t)x[1] << 16);
    return __smlad((int32_t)w_pair, (int32_t)x_pair, acc);
#else
    return acc + ((int32_t)w[0] * x[0]) + ((int32_t)w[1] * x[1]);
#endif
}

static inline int32_t zd_dot_i16(const int16_t *w, const int16_t *x, uint32_t n) {
    int32_t acc = 0;
    uint32_t i = 0;
    ZD_ROLLED
    for (; (i + ZD_LANES) <= n; i += ZD_LANES) {
        acc = zd_mac(acc, &w[i], &x[i]);
    }
    for (; i < n; i++) {
        acc += (int32_t)w[i] * x[i];
    }
    return acc;
}

static inline int32_t zd_dot_i8(const int8_t *w, const int16_t *x, uint32_t n) {
    int32_t acc = 0;
    for (uint32_t i = 0; i < n; i++) {
        acc += (int32_t)w[i] * x[i];
    }
    return acc;
}

/* Three rows of w, stored one after the other, times x: each x is read once for the three. */
static inline void zd_dot3_i16(const int16_t *w, const int16_t *x, uint32_t n, int32_t acc[3]) {
    int32_t a = 0;
    int32_t b = 0;
    int32_t c = 0;
    uint32_t i = 0;
    ZD_UNROLLED
    for (; (i + ZD_LANES) <= n; i += ZD_LANES) {
        ZD_IN_ORDER(x);
        a = zd_mac(a, &w[i], &x[i]);
        b = zd_mac(b, &w[n + i], &x[i]);
        c = zd_mac(c, &w[(2u * n) + i], &x[i]);
    }
    for (; i < n; i++) {
        a += (int32_t)w[i] * x[i];
        b += (int32_t)w[n + i] * x[i];
        c += (int32_t)w[(2u * n) + i] * x[i];
    }
    acc[0] = a;
    acc[1] = b;
    acc[2] = c;
}

static inline void zd_dot3_i8(const int8_t *w, const int16_t *x, uint32_t n, int32_t acc[3]) {
    int32_t a = 0;
    int32_t b = 0;
    int32_t c = 0;
    ZD_ROLLED
    for (uint32_t i = 0; i < n; i++) {
        a += (int32_t)w[i] * x[i];
        b += (int32_t)w[n + i] * x[i];
        c += (int32_t)w[(2u * n) + i] * x[i];
    }
    acc[0] = a;
    acc[1] = b;
    acc[2] = c;
}

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

/* 2^t for t in Q7.24, in units of 2^(top - 27): at most 2^28. t < (top + 1) 2^24. */
static inline int32_t zd_exp2(int32_t t_q24, int32_t top) {
    const int32_t shift = (top + 2) - zd_asr32(t_q24, 24u);
    const int32_t f_q31 = (int32_t)(((uint32_t)t_q24 & 0xFFFFFFu) << 7);
    const int32_t mantissa = zd_polynomial(zd_exp2_octave_q29, ZD_EXP2_TERMS, f_q31);
    return (int32_t)zd_round_shift64(mantissa, (unsigned)((shift < 31) ? shift : 31));
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

/* --- GRU (specification, 4) ------------------------------------------------------------------- */

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

/* The int16 copy of the state that the dot products read; |h_q15| <= 32767 by the invariant. */
static inline void zd_gru_copy_state(const int32_t *h_q30, int16_t *h_q15, uint32_t hidden) {
    for (uint32_t j = 0; j < hidden; j++) {
        h_q15[j] = (int16_t)zd_asr32(h_q30[j] + ((int32_t)1 << 14), 15);
    }
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

#if ZD_KERNEL == ZD_KERNEL_PAIRS
#include "zd_gru_pairs.h"
#elif ZD_KERNEL == ZD_KERNEL_ROWS
#include "zd_gru_rows.h"
#elif ZD_KERNEL == ZD_KERNEL_COLUMNS
#include "zd_gru_columns.h"
#endif

#endif /* ZD_RUNTIME_H */
