/* zerodrift runtime: 2^t and its table. Written by `make golden`.
 *
 * Included by a model that needs it, after zd_runtime.h.
 *
 * SPDX-License-Identifier: Apache-2.0; may be used under any terms beside a generated model.
 */
#ifndef ZD_EXP2_H
#define ZD_EXP2_H

#include "zd_runtime.h"

#if ZD_RUNTIME_ID != 0xb9f9d9e0
#error "zd_exp2.h is not of the same zerodrift runtime as zd_runtime.h: copy all files again"
#endif

/* 2^f = sum c[i] f^i for 0 <= f <= 1 in Q2.29. */
#define ZD_EXP2_TERMS 7u
#define ZD_EXP2_CRC UINT32_C(1414128660)
#define zd_exp2_octave_q29 zd_exp2_octave_q29_b9f9d9e0
/* clang-format off */
ZD_SHARED const int32_t zd_exp2_octave_q29[ZD_EXP2_TERMS] = {
    536870912, 372130457, 128972571, 29786284, 5198974, 665093, 117533
};
/* clang-format on */

/* 1 if the table is what it was written as. */
static inline uint32_t zd_exp2_is_sound(void) {
    return (zd_crc32_i32(0, zd_exp2_octave_q29, ZD_EXP2_TERMS) == ZD_EXP2_CRC) ? 1u : 0u;
}

/* 2^t for t in Q7.24, in units of 2^(top - 27): at most 2^28. t < (top + 1) 2^24. */
static inline int32_t zd_exp2(int32_t t_q24, int32_t top) {
    const int32_t shift = (top + 2) - zd_asr32(t_q24, 24u);
    const int32_t f_q31 = (int32_t)(((uint32_t)t_q24 & 0xFFFFFFu) << 7);
    const int32_t mantissa = zd_polynomial(zd_exp2_octave_q29, ZD_EXP2_TERMS, f_q31);
    return (int32_t)zd_round_shift64(mantissa, (unsigned)((shift < 31) ? shift : 31));
}

#endif /* ZD_EXP2_H */
