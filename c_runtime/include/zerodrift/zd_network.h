/* zerodrift runtime: activations and recurrent layers, for models with a network.
 *
 * Included by a model that needs it, after zd_runtime.h.
 *
 * SPDX-License-Identifier: Apache-2.0; may be used under any terms beside a generated model.
 */
#ifndef ZD_NETWORK_H
#define ZD_NETWORK_H

#include "zd_runtime.h"

#if ZD_RUNTIME_ID != 0xb9f9d9e0
#error "zd_network.h is not of the same zerodrift runtime as zd_runtime.h: copy all files again"
#endif

#include "zd_tanh_table.h"

/* --- Activations ------------------------------------------------------------------------------ */

/* t limited to 20 bits, -2^19 .. 2^19 - 1; without a branch on every core. */
static inline int32_t zd_saturate20(int32_t t) {
#if defined(__ARM_FEATURE_SAT) && defined(__GNUC__)
    return (int32_t)__builtin_arm_ssat(t, 20); /* gcc's __ssat warns of a conversion of its own */
#elif defined(__ARM_FEATURE_SAT)
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

/* Where the table lies: kept in registers by a kernel that reads it often. */
typedef struct {
    const int32_t *offset_q30; /* of the line from 0 on */
    const int16_t *slope_q19;
} zd_table_t;

static inline void zd_find_table(zd_table_t *table) {
    const int32_t *offset = ZD_TANH_OFFSET_Q30;
    const int16_t *slope = ZD_TANH_SLOPE_Q19;
    ZD_FORGET(offset);
    ZD_FORGET(slope);
    table->offset_q30 = offset;
    table->slope_q19 = slope;
}

/* tanh in Q0.30 of t in Q3.16, any int32: outside -8 .. 8 the ends hold. |result| <= 2^30 - 2^15.
 * |slope * t| < 2^29: where a line is steep, t is small. */
static inline int32_t zd_read_q30(int32_t t_q16, const zd_table_t *table) {
#if defined(ZD_SMALL)
    const int32_t sign = zd_asr32(t_q16, 31);
    const int32_t distance = zd_asr32(t_q16, 11) ^ sign; /* in lines, from 0 on either side */
    const int32_t rest = (ZD_TANH_HALF_LINES - 1) - distance;
    int32_t beyond = zd_asr32(rest, 31); /* -1 beyond the last line, otherwise 0 */
    ZD_FORGET_NUMBER(beyond);
    const int32_t line = distance + (rest & beyond);
    return ((table->offset_q30[line] ^ sign) - sign) + (table->slope_q19[line] * t_q16);
#else
    const int32_t position = zd_saturate20(t_q16);
    const int32_t line = zd_asr32(position, 11);
    return table->offset_q30[line] + (table->slope_q19[line] * position);
#endif
}

static inline int32_t zd_tanh_q30(int32_t t_q16) {
    const zd_table_t table = {ZD_TANH_OFFSET_Q30, ZD_TANH_SLOPE_Q19};
    return zd_read_q30(t_q16, &table);
}

/* sigmoid in Q0.31 of twice t in Q3.16: 2^15 .. 2^31 - 2^15. */
static inline int32_t zd_sigmoid_q31(int32_t half_t_q16) {
    return zd_tanh_q30(half_t_q16) + ((int32_t)1 << 30);
}

#if defined(ZD_GRU_ASSEMBLY)
#define ZD_IN_REGISTER __attribute__((unused)) /* a parameter that assembly finds by itself */
#endif

#include "zd_gru_portable.h"

#if ZD_KERNEL == ZD_KERNEL_PAIRS
#include "zd_gru_pairs.h"
#elif ZD_KERNEL == ZD_KERNEL_ROWS
#include "zd_gru_rows.h"
#elif ZD_KERNEL == ZD_KERNEL_COLUMNS
#include "zd_gru_columns.h"
#endif

#endif /* ZD_NETWORK_H */
