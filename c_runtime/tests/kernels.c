/* The kernels as functions of a shared library, so that Python can compare them with the reference
 * over every input (tests/fixed_point/test_kernels.py). */
#include <stdint.h>

#include "zd_network.h"

void zk_tanh_q30(const int32_t *t_q16, int32_t *out, uint32_t n);
void zk_sigmoid_q31(const int32_t *t_q16, int32_t *out, uint32_t n);
void zk_round_shift64(const int64_t *x, const uint32_t *shift, int64_t *out, uint32_t n);
void zk_mul_high(const int32_t *a, const int32_t *b, int32_t *out, uint32_t n);
void zk_lowpass(int64_t *v, const int32_t *x, int32_t c_q24, int32_t m_q31, uint32_t shift,
                int32_t *out, uint32_t n);

void zk_tanh_q30(const int32_t *t_q16, int32_t *out, uint32_t n) {
    for (uint32_t i = 0; i < n; i++) {
        out[i] = zd_tanh_q30(t_q16[i]);
    }
}

void zk_sigmoid_q31(const int32_t *t_q16, int32_t *out, uint32_t n) {
    for (uint32_t i = 0; i < n; i++) {
        out[i] = zd_sigmoid_q31(t_q16[i]);
    }
}

void zk_round_shift64(const int64_t *x, const uint32_t *shift, int64_t *out, uint32_t n) {
    for (uint32_t i = 0; i < n; i++) {
        out[i] = zd_round_shift64(x[i], shift[i]);
    }
}

void zk_mul_high(const int32_t *a, const int32_t *b, int32_t *out, uint32_t n) {
    for (uint32_t i = 0; i < n; i++) {
        out[i] = zd_mul_high(a[i], b[i]);
    }
}

/* n steps of one filter whose state is v. */
void zk_lowpass(int64_t *v, const int32_t *x, int32_t c_q24, int32_t m_q31, uint32_t shift,
                int32_t *out, uint32_t n) {
    for (uint32_t i = 0; i < n; i++) {
        out[i] = zd_lowpass(v, x[i], c_q24, m_q31, shift);
    }
}
