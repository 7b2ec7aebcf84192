/* Those of Arm's M-profile vector intrinsics that the rows kernels use, lane by lane in plain C, so that
 * these kernels and their tables run on any host. Written from the Arm C Language Extensions; not part
 * of a firmware.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef ZD_HOST_ARM_MVE_H
#define ZD_HOST_ARM_MVE_H

#include <stdint.h>

typedef struct {
    int32_t lane[4];
} int32x4_t;
typedef struct {
    uint32_t lane[4];
} uint32x4_t;
typedef struct {
    int16_t lane[8];
} int16x8_t;
typedef struct {
    int32x4_t val[2];
} int32x4x2_t;
typedef struct {
    int32x4_t val[4];
} int32x4x4_t;
/* How many lanes from the first on are active; vctp makes no others. */
typedef uint32_t mve_pred16_t;

#define ZD_EACH4 for (int i = 0; i < 4; i++)
#define ZD_EACH8 for (int i = 0; i < 8; i++)

static inline mve_pred16_t vctp32q(uint32_t n) { return (n < 4u) ? n : 4u; }
static inline mve_pred16_t vctp16q(uint32_t n) { return (n < 8u) ? n : 8u; }

static inline int32x4_t vld1q_z_s32(const int32_t *from, mve_pred16_t p) {
    int32x4_t x;
    ZD_EACH4 { x.lane[i] = ((uint32_t)i < p) ? from[i] : 0; }
    return x;
}
static inline int32x4_t vld1q_s32(const int32_t *from) { return vld1q_z_s32(from, 4u); }
static inline int16x8_t vld1q_z_s16(const int16_t *from, mve_pred16_t p) {
    int16x8_t x;
    ZD_EACH8 { x.lane[i] = (int16_t)(((uint32_t)i < p) ? from[i] : 0); }
    return x;
}
static inline int16x8_t vld1q_s16(const int16_t *from) { return vld1q_z_s16(from, 8u); }
static inline int32x4x2_t vld2q_s32(const int32_t *from) {
    int32x4x2_t x;
    ZD_EACH4 {
        for (int k = 0; k < 2; k++) {
            x.val[k].lane[i] = from[(2 * i) + k];
        }
    }
    return x;
}
static inline int32x4x4_t vld4q_s32(const int32_t *from) {
    int32x4x4_t x;
    ZD_EACH4 {
        for (int k = 0; k < 4; k++) {
            x.val[k].lane[i] = from[(4 * i) + k];
        }
    }
    return x;
}

/* Eight numbers of 8 bits, their sign kept. */
static inline int16x8_t vldrbq_s16(const int8_t *from) {
    int16x8_t x;
    ZD_EACH8 { x.lane[i] = from[i]; }
    return x;
}

static inline void vst1q_p_s32(int32_t *to, int32x4_t x, mve_pred16_t p) {
    for (uint32_t i = 0; i < p; i++) {
        to[i] = x.lane[i];
    }
}
static inline void vst1q_s32(int32_t *to, int32x4_t x) { vst1q_p_s32(to, x, 4u); }
static inline void vst1q_s16(int16_t *to, int16x8_t x) {
    ZD_EACH8 { to[i] = x.lane[i]; }
}
static inline void vstrhq_s32(int16_t *to, int32x4_t x) {
    ZD_EACH4 { to[i] = (int16_t)(uint16_t)((uint32_t)x.lane[i] & 0xFFFFu); }
}

static inline int32x4_t vdupq_n_s32(int32_t a) {
    int32x4_t x;
    ZD_EACH4 { x.lane[i] = a; }
    return x;
}
static inline int16x8_t vdupq_n_s16(int16_t a) {
    int16x8_t x;
    ZD_EACH8 { x.lane[i] = a; }
    return x;
}
static inline uint32x4_t vreinterpretq_u32_s32(int32x4_t a) {
    uint32x4_t x;
    ZD_EACH4 { x.lane[i] = (uint32_t)a.lane[i]; }
    return x;
}

static inline int32x4_t vreinterpretq_s32_u32(uint32x4_t a) {
    int32x4_t x;
    ZD_EACH4 { x.lane[i] = (int32_t)a.lane[i]; }
    return x;
}

/* Modulo 2^32, as the lanes are. */
static inline int32x4_t vaddq_s32(int32x4_t a, int32x4_t b) {
    ZD_EACH4 { a.lane[i] = (int32_t)((uint32_t)a.lane[i] + (uint32_t)b.lane[i]); }
    return a;
}
static inline int32x4_t vaddq_n_s32(int32x4_t a, int32_t b) { return vaddq_s32(a, vdupq_n_s32(b)); }
static inline int32x4_t vsubq_s32(int32x4_t a, int32x4_t b) {
    ZD_EACH4 { a.lane[i] = (int32_t)((uint32_t)a.lane[i] - (uint32_t)b.lane[i]); }
    return a;
}
static inline int32x4_t vmulq_s32(int32x4_t a, int32x4_t b) {
    ZD_EACH4 { a.lane[i] = (int32_t)((uint32_t)a.lane[i] * (uint32_t)b.lane[i]); }
    return a;
}
static inline int32x4_t vandq_s32(int32x4_t a, int32x4_t b) {
    ZD_EACH4 { a.lane[i] &= b.lane[i]; }
    return a;
}
/* (a b + 2^31) / 2^32, rounded down. */
static inline int32x4_t vrmulhq_s32(int32x4_t a, int32x4_t b) {
    ZD_EACH4 {
        a.lane[i] = (int32_t)((((int64_t)a.lane[i] * b.lane[i]) + ((int64_t)1 << 31)) >> 32);
    }
    return a;
}
/* a b / 2^32, rounded down. */
static inline int32x4_t vmulhq_s32(int32x4_t a, int32x4_t b) {
    ZD_EACH4 { a.lane[i] = (int32_t)(((int64_t)a.lane[i] * b.lane[i]) >> 32); }
    return a;
}
static inline int32x4_t vshrq_n_s32(int32x4_t a, int n) {
    ZD_EACH4 { a.lane[i] >>= n; }
    return a;
}
static inline int32x4_t vrshrq_n_s32(int32x4_t a, int n) {
    ZD_EACH4 { a.lane[i] = (int32_t)(((int64_t)a.lane[i] + ((int64_t)1 << (n - 1))) >> n); }
    return a;
}
static inline int32x4_t vminq_s32(int32x4_t a, int32x4_t b) {
    ZD_EACH4 { a.lane[i] = (a.lane[i] < b.lane[i]) ? a.lane[i] : b.lane[i]; }
    return a;
}
static inline int32x4_t vmaxq_s32(int32x4_t a, int32x4_t b) {
    ZD_EACH4 { a.lane[i] = (a.lane[i] > b.lane[i]) ? a.lane[i] : b.lane[i]; }
    return a;
}
/* To the left modulo 2^32, n up to 32; to the right where n is negative, to nearest, halves up. */
static inline int32x4_t vrshlq_n_s32(int32x4_t a, int32_t n) {
    ZD_EACH4 {
        const int64_t x = a.lane[i];
        a.lane[i] = (n < 0) ? (int32_t)((x + ((int64_t)1 << (-n - 1))) >> -n)
                            : (int32_t)(uint32_t)((uint64_t)x << n);
    }
    return a;
}
/* The same, n down to -62. */
static inline uint32x4_t vrshlq_n_u32(uint32x4_t a, int32_t n) {
    ZD_EACH4 {
        const uint64_t x = a.lane[i];
        a.lane[i] = (n < 0) ? (uint32_t)((x + ((uint64_t)1 << (-n - 1))) >> -n) : (uint32_t)(x << n);
    }
    return a;
}
/* To the left, saturating; to the right where n is negative. */
static inline int32x4_t vqshlq_r_s32(int32x4_t a, int32_t n) {
    ZD_EACH4 {
        if (n < 0) {
            a.lane[i] = (n > -32) ? (a.lane[i] >> -n) : (a.lane[i] >> 31);
        } else {
            const int64_t wide = (int64_t)a.lane[i] * ((int64_t)1 << ((n < 31) ? n : 31));
            a.lane[i] = (wide > INT32_MAX) ? INT32_MAX : ((wide < INT32_MIN) ? INT32_MIN : (int32_t)wide);
        }
    }
    return a;
}

static inline int32_t vmladavaq_s16(int32_t acc, int16x8_t a, int16x8_t b) {
    ZD_EACH8 { acc = (int32_t)((uint32_t)acc + (uint32_t)((int32_t)a.lane[i] * b.lane[i])); }
    return acc;
}
static inline int32_t vmladavq_s16(int16x8_t a, int16x8_t b) { return vmladavaq_s16(0, a, b); }

/* At base + element size * offset, modulo 2^32: offsets from the middle of a table are negative. */
static inline int32x4_t vldrwq_gather_shifted_offset_s32(const int32_t *base, uint32x4_t offset) {
    int32x4_t x;
    ZD_EACH4 { x.lane[i] = base[(int32_t)offset.lane[i]]; }
    return x;
}
static inline int32x4_t vldrhq_gather_shifted_offset_s32(const int16_t *base, uint32x4_t offset) {
    int32x4_t x;
    ZD_EACH4 { x.lane[i] = base[(int32_t)offset.lane[i]]; }
    return x;
}

#endif /* ZD_HOST_ARM_MVE_H */
