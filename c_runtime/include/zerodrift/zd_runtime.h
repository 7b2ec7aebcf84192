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

/* How a recurrent layer is computed: pairs and columns are of GRUs with 16-bit weights and the
 * reset gate after the product, rows of all. All ways give the same bits; the target's own macros
 * choose, -DZD_KERNEL=... overrides (docs/reference/kernels.md). ZD_SMALL trades speed for 2 KB of
 * flash: a compiler that is told to optimise for size (-Os) takes it, unless ZD_FAST is defined. */
#if defined(__OPTIMIZE_SIZE__) && !defined(ZD_SMALL) && !defined(ZD_FAST)
#define ZD_SMALL
#endif
#define ZD_KERNEL_PORTABLE 0
#define ZD_KERNEL_PAIRS 1   /* Cortex-M with a dual 16-bit multiplier, or without a high product */
#define ZD_KERNEL_ROWS 2    /* Arm MVE: Cortex-M55, M85 */
#define ZD_KERNEL_COLUMNS 3 /* SSE2 or AVX2 */
#if defined(__thumb__) && defined(__GNUC__) && defined(__ELF__) && !defined(ZD_NO_ASSEMBLY)
#if defined(__ARM_ARCH_6M__) || defined(__ARM_ARCH_8M_BASE__)
#define ZD_GRU_ASSEMBLY 6 /* of the pairs kernel: Armv6-M's instructions */
#elif defined(__ARM_FEATURE_DSP) && defined(__thumb2__) && defined(__ARM_ARCH_PROFILE)
#if __ARM_ARCH_PROFILE == 'M'
#define ZD_GRU_ASSEMBLY 7 /* Armv7E-M's */
#endif
#endif
#endif
/* The assembly may read two neighbours of 16 bits as one word, the first one low. */
#if defined(__ARM_FEATURE_UNALIGNED) && !defined(__ARM_BIG_ENDIAN)
#define ZD_UNALIGNED
#endif
#if !defined(ZD_KERNEL)
#if defined(__ARM_FEATURE_MVE) && !defined(ZD_SMALL)
#define ZD_KERNEL ZD_KERNEL_ROWS
#elif defined(__ARM_FEATURE_DSP) || defined(ZD_GRU_ASSEMBLY)
#define ZD_KERNEL ZD_KERNEL_PAIRS
#elif defined(__SSE2__) && !defined(ZD_SMALL)
#define ZD_KERNEL ZD_KERNEL_COLUMNS
#else
#define ZD_KERNEL ZD_KERNEL_PORTABLE
#endif
#endif

/* Layers that have no kernel in C for pairs take assembly wherever there is some. */
#if defined(ZD_GRU_ASSEMBLY) && (ZD_KERNEL == ZD_KERNEL_PAIRS)
#define ZD_ASSEMBLY ZD_GRU_ASSEMBLY
#else
#define ZD_ASSEMBLY 0
#endif

/* A model generated for another format must be regenerated: its constants mean something else. */
#define ZD_RUNTIME_FORMAT 3

/* Of the runtime's text, written by `make golden`: its files belong together, and so do a model and
 * the runtime beside which it was generated. Every other file asks for it. */
#define ZD_RUNTIME_ID 0xb9f9d9e0
/* The identity is a hash of these, of this file's own text and of nothing else. A firmware takes
 * those alone that its model includes; each file, and the hash of its text:
 * zd_exp2.h 5fe8882f
 * zd_gru_columns.h f2a254ce
 * zd_gru_columns_avx2.h d3207085
 * zd_gru_columns_sse2.h 432ac2ad
 * zd_gru_pairs.h 9d49e8a8
 * zd_gru_portable.h 5c9f40ac
 * zd_gru_rows.h daeb10ef
 * zd_layer_norm.h 2e9ec468
 * zd_lstm.h a27ddafa
 * zd_lstm_rows.h 95b646cd
 * zd_network.h 996319a6
 * zd_runtime.c 813cf806
 * zd_signals.h 94d2b7ed
 * zd_tanh_table.h d30bb3c6
 */

#define ZD_LOWPASS_FRACTION 24
#define ZD_GRU_RELAX_STEPS 64
#define ZD_GRU_H_LIMIT_Q30 1073709057 /* 2^30 - 2^15 + 1: |h| never exceeds it */

/* What the runtime gives to the linker bears the runtime's identity in its name, so that several
 * firmwares, each with a runtime of its own, link into one: equal runtimes share what they have,
 * different ones do not meet. Other compilers than these get tables for each model, and need equal
 * runtimes' zd_runtime.c once. */
#if defined(__GNUC__) && defined(__ELF__)
#define ZD_SHARED __attribute__((weak, used)) /* used: assembly names it */
#define ZD_SHARED_CODE __attribute__((weak))
#else
#define ZD_SHARED static
#define ZD_SHARED_CODE
#endif
#define zd_crc32 zd_crc32_b9f9d9e0
#define zd_crc32_word zd_crc32_word_b9f9d9e0
#define zd_crc32_i16 zd_crc32_i16_b9f9d9e0
#define zd_crc32_i32 zd_crc32_i32_b9f9d9e0
#define zd_save zd_save_b9f9d9e0
#define zd_restore zd_restore_b9f9d9e0

/* CRC-32 (reflected 0xEDB88320) of n bytes, continued from crc; start with 0. */
uint32_t zd_crc32(uint32_t crc, const uint8_t *bytes, uint32_t n);

/* Continues the CRC-32 with the four bytes of x, least significant first. */
uint32_t zd_crc32_word(uint32_t crc, uint32_t x);

/* Continues the CRC-32 with each of n numbers as a 32-bit word. */
uint32_t zd_crc32_i16(uint32_t crc, const int16_t *values, uint32_t n);
uint32_t zd_crc32_i32(uint32_t crc, const int32_t *values, uint32_t n);

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

#if (ZD_LANES == 1u) && defined(__GNUC__) && !defined(__clang__) && (__GNUC__ >= 8)
#define ZD_ROLLED _Pragma("GCC unroll 1") /* or gcc -O3 unrolls the loop before vectorising it */
#else
#define ZD_ROLLED
#endif

#if ZD_LANES == 1u
#define ZD_UNROLLED ZD_ROLLED
#define ZD_IN_ORDER(pointer)
#elif defined(__clang__) && !defined(__riscv)
#define ZD_UNROLLED
#define ZD_IN_ORDER(pointer)
#elif defined(__GNUC__) && ((__GNUC__ >= 8) || defined(__clang__)) && !defined(__OPTIMIZE_SIZE__)
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

/* --- The checksum of a live state: a flip of any bit in it changes the sum. ----------------------
 */

/* Turned by one bit, so that words that change places are noticed too. */
static inline uint32_t zd_check_word(uint32_t check, uint32_t x) {
    return ((check >> 1) | (check << 31)) + x;
}

static inline uint32_t zd_check_number(uint32_t check, int32_t x) {
    return zd_check_word(check, (uint32_t)x);
}

static inline uint32_t zd_check_i64(uint32_t check, int64_t x) {
    const uint64_t bits = (uint64_t)x;
    return zd_check_word(zd_check_word(check, (uint32_t)(bits & 0xFFFFFFFFu)),
                         (uint32_t)(bits >> 32));
}

static inline uint32_t zd_check_i32(uint32_t check, const int32_t *x, uint32_t n) {
    uint32_t next = check;
    uint32_t i = 0;
    for (; (i + 8u) <= n; i += 8u) {
        next = zd_check_word(next, (uint32_t)x[i]);
        next = zd_check_word(next, (uint32_t)x[i + 1u]);
        next = zd_check_word(next, (uint32_t)x[i + 2u]);
        next = zd_check_word(next, (uint32_t)x[i + 3u]);
        next = zd_check_word(next, (uint32_t)x[i + 4u]);
        next = zd_check_word(next, (uint32_t)x[i + 5u]);
        next = zd_check_word(next, (uint32_t)x[i + 6u]);
        next = zd_check_word(next, (uint32_t)x[i + 7u]);
    }
    for (; i < n; i++) {
        next = zd_check_word(next, (uint32_t)x[i]);
    }
    return next;
}

/* Two numbers are one word. */
static inline uint32_t zd_check_i16(uint32_t check, const int16_t *x, uint32_t n) {
    uint32_t next = check;
    uint32_t i = 0;
    for (; (i + 2u) <= n; i += 2u) {
        const uint32_t low = (uint16_t)x[i];
        const uint32_t high = (uint16_t)x[i + 1u];
        next = zd_check_word(next, low | (high << 16));
    }
    for (; i < n; i++) {
        next = zd_check_word(next, (uint16_t)x[i]);
    }
    return next;
}

/* The int16 copy of a state in Q1.30 that the dot products read; |h_q15| <= 32767 by the invariant.
 */
static inline void zd_gru_copy_state(const int32_t *h_q30, int16_t *h_q15, uint32_t hidden) {
    for (uint32_t j = 0; j < hidden; j++) {
        h_q15[j] = (int16_t)zd_asr32(h_q30[j] + ((int32_t)1 << 14), 15);
    }
}

#include "zd_signals.h"

#endif /* ZD_RUNTIME_H */
