/* zerodrift runtime: the GRU on a host's vector unit (SSE2, AVX2), eight units side by side.
 *
 * Included by zd_runtime.h. For hosts: simulation and the check of a model at full speed.
 *
 * SPDX-License-Identifier: Apache-2.0; may be used under any terms beside a generated model.
 */
#ifndef ZD_GRU_COLUMNS_H
#define ZD_GRU_COLUMNS_H

#if ZD_RUNTIME_ID != 0xb9f9d9e0
#error "zd_gru_columns.h is not of the same zerodrift runtime as zd_runtime.h: copy all files again"
#endif

/* Constants of one layer. */
typedef struct {
    const int32_t *stream; /* [ceil(H/8)][4 + 3 (X + R)][8]; X pairs of features, R of the state */
    uint8_t shift[3];      /* accumulator of r, u, n -> t_q16 */
} zd_gru_columns_t;

/* Sizes of the scratch: the state in whole vectors, and all pairs. */
#define ZD_COLUMN_UNITS(hidden) ((((hidden) + 7u) / 8u) * 8u)
#define ZD_COLUMN_PAIRS(inputs, hidden) ((((inputs) + 1u) / 2u) + (ZD_COLUMN_UNITS(hidden) / 2u))

#if defined(__AVX2__)
#include "zd_gru_columns_avx2.h"
#else
#include "zd_gru_columns_sse2.h"
#endif

#endif /* ZD_GRU_COLUMNS_H */
