/* What of Arm's vector extension the rows kernels use, in plain C, so that a host under sanitizers
 * can run it. Each function reads and writes exactly the memory that the instruction does. */
#ifndef ZD_MUTANTS_ARM_MVE_H
#define ZD_MUTANTS_ARM_MVE_H
#include <stdint.h>

typedef struct { int32_t e[4]; } int32x4_t;
typedef struct { uint32_t e[4]; } uint32x4_t;
typedef struct { int16_t e[8]; } int16x8_t;
typedef struct { int32x4_t val[2]; } int32x4x2_t;
typedef struct { int32x4_t val[4]; } int32x4x4_t;
typedef uint16_t mve_pred16_t; /* here: how many lanes are on */

#define MVE_EACH(n, what)                                                                          \
    for (int i = 0; i < (n); i++) {                                                                \
        what;                                                                                      \
    }
static inline mve_pred16_t vctp16q(uint32_t n) { return (mve_pred16_t)(n < 8u ? n : 8u); }
static inline mve_pred16_t vctp32q(uint32_t n) { return (mve_pred16_t)(n < 4u ? n : 4u); }
static inline int32x4_t vld1q_z_s32(const int32_t *p, mve_pred16_t on) {
    int32x4_t r;
    MVE_EACH(4, r.e[i] = (i < on) ? p[i] : 0)
    return r;
}
static inline int32x4_t vld1q_s32(const int32_t *p) { return vld1q_z_s32(p, 4); }
static inline int16x8_t vld1q_z_s16(const int16_t *p, mve_pred16_t on) {
    int16x8_t r;
    MVE_EACH(8, r.e[i] = (int16_t)((i < on) ? p[i] : 0))
    return r;
}
static inline int16x8_t vld1q_s16(const int16_t *p) { return vld1q_z_s16(p, 8); }
static inline int32x4x2_t vld2q_s32(const int32_t *p) {
    int32x4x2_t r;
    MVE_EACH(8, r.val[i % 2].e[i / 2] = p[i])
    return r;
}
static inline int32x4x4_t vld4q_s32(const int32_t *p) {
    int32x4x4_t r;
    MVE_EACH(16, r.val[i % 4].e[i / 4] = p[i])
    return r;
}
static inline int16x8_t vldrbq_s16(const int8_t *p) {
    int16x8_t r;
    MVE_EACH(8, r.e[i] = p[i])
    return r;
}
static inline void vst1q_p_s32(int32_t *p, int32x4_t x, mve_pred16_t on) {
    MVE_EACH(4, if (i < on) p[i] = x.e[i])
}
static inline void vst1q_s32(int32_t *p, int32x4_t x) { vst1q_p_s32(p, x, 4); }
static inline void vst1q_s16(int16_t *p, int16x8_t x) { MVE_EACH(8, p[i] = x.e[i]) }
static inline void vstrhq_s32(int16_t *p, int32x4_t x) { MVE_EACH(4, p[i] = (int16_t)x.e[i]) }
static inline int32x4_t vldrwq_gather_shifted_offset_s32(const int32_t *p, uint32x4_t at) {
    int32x4_t r;
    MVE_EACH(4, r.e[i] = p[(int32_t)at.e[i]])
    return r;
}
static inline int32x4_t vldrhq_gather_shifted_offset_s32(const int16_t *p, uint32x4_t at) {
    int32x4_t r;
    MVE_EACH(4, r.e[i] = p[(int32_t)at.e[i]])
    return r;
}
static inline int32x4_t vdupq_n_s32(int32_t x) {
    int32x4_t r;
    MVE_EACH(4, r.e[i] = x)
    return r;
}
static inline int16x8_t vdupq_n_s16(int16_t x) {
    int16x8_t r;
    MVE_EACH(8, r.e[i] = x)
    return r;
}
static inline uint32x4_t vreinterpretq_u32_s32(int32x4_t x) {
    uint32x4_t r;
    MVE_EACH(4, r.e[i] = (uint32_t)x.e[i])
    return r;
}
static inline int32x4_t vreinterpretq_s32_u32(uint32x4_t x) {
    int32x4_t r;
    MVE_EACH(4, r.e[i] = (int32_t)x.e[i])
    return r;
}
static inline int32x4_t vrshlq_n_s32(int32x4_t x, int32_t n) {
    const int64_t half = (n < 0) ? (int64_t)1 << (-n - 1) : 0;
    MVE_EACH(4, x.e[i] = (n < 0) ? (int32_t)((x.e[i] + half) >> -n) : (int32_t)(uint32_t)((uint64_t)x.e[i] << n))
    return x;
}
static inline uint32x4_t vrshlq_n_u32(uint32x4_t x, int32_t n) {
    const uint64_t half = (n < 0) ? (uint64_t)1 << (-n - 1) : 0;
    MVE_EACH(4, x.e[i] = (uint32_t)((n < 0) ? ((x.e[i] + half) >> -n) : ((uint64_t)x.e[i] << n)))
    return x;
}
#define MVE_TWO(name, expression)                                                                  \
    static inline int32x4_t name(int32x4_t x, int32x4_t y) {                                       \
        int32x4_t r;                                                                               \
        MVE_EACH(4, const int32_t a = x.e[i]; const int32_t b = y.e[i]; r.e[i] = (expression))     \
        return r;                                                                                  \
    }
MVE_TWO(vaddq_s32, (int32_t)((uint32_t)a + (uint32_t)b))
MVE_TWO(vsubq_s32, (int32_t)((uint32_t)a - (uint32_t)b))
MVE_TWO(vmulq_s32, (int32_t)((uint32_t)a * (uint32_t)b))
MVE_TWO(vminq_s32, (a < b) ? a : b)
MVE_TWO(vmaxq_s32, (a > b) ? a : b)
MVE_TWO(vandq_s32, a & b)
MVE_TWO(vmulhq_s32, (int32_t)(((int64_t)a * b) >> 32))
MVE_TWO(vrmulhq_s32, (int32_t)(((int64_t)a * b + ((int64_t)1 << 31)) >> 32))
static inline int32x4_t vaddq_n_s32(int32x4_t x, int32_t n) { return vaddq_s32(x, vdupq_n_s32(n)); }
static inline int32x4_t vshrq_n_s32(int32x4_t x, int n) {
    MVE_EACH(4, x.e[i] >>= n)
    return x;
}
static inline int32x4_t vrshrq_n_s32(int32x4_t x, int n) {
    MVE_EACH(4, x.e[i] = (int32_t)(((int64_t)x.e[i] + ((int64_t)1 << (n - 1))) >> n))
    return x;
}
static inline int32x4_t vqshlq_r_s32(int32x4_t x, int32_t n) {
    const int s = (int8_t)n;
    for (int i = 0; i < 4; i++) {
        int64_t y = x.e[i];
        y = (s < -31) ? (y >> 31) : (s < 0) ? (y >> -s) : (s > 31) ? (y > 0) * ((int64_t)1 << 40) - (y < 0) * ((int64_t)1 << 40) : y * ((int64_t)1 << s);
        x.e[i] = (int32_t)((y > INT32_MAX) ? INT32_MAX : (y < INT32_MIN) ? INT32_MIN : y);
    }
    return x;
}
static inline int32_t vmladavaq_s16(int32_t acc, int16x8_t x, int16x8_t y) {
    MVE_EACH(8, acc = (int32_t)((uint32_t)acc + (uint32_t)((int32_t)x.e[i] * y.e[i])))
    return acc;
}
static inline int32_t vmladavq_s16(int16x8_t x, int16x8_t y) { return vmladavaq_s16(0, x, y); }

#endif
