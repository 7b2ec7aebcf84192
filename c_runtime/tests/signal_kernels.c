/* The kernels of effects as functions of a shared library, so that Python can compare them with the
 * reference (tests/fixed_point/test_signal_kernels.py). */
#include <stdint.h>

#include "zd_exp2.h"

void zk_exp2(const int32_t *t_q24, int32_t top, int32_t *out, uint32_t n);
void zk_power(const int32_t *octave, uint32_t terms, int32_t low, int32_t high,
              const int32_t *gains, uint32_t shift, const int32_t *x, int32_t *out, uint32_t n);
void zk_play(int32_t *y, int32_t half_width, const int32_t *x, int32_t *out, uint32_t n);
void zk_between(const int32_t *older, const int32_t *newer, int32_t newer_q31, int32_t *out,
                uint32_t n);
void zk_load(const int32_t *measured, const int32_t *drift, int32_t low, int32_t high, int32_t *out,
             uint32_t n);

void zk_exp2(const int32_t *t_q24, int32_t top, int32_t *out, uint32_t n) {
    for (uint32_t i = 0; i < n; i++) {
        out[i] = zd_exp2(t_q24[i], top);
    }
}

void zk_power(const int32_t *octave, uint32_t terms, int32_t low, int32_t high,
              const int32_t *gains, uint32_t shift, const int32_t *x, int32_t *out, uint32_t n) {
    const zd_power_t power = {octave, gains, low, high, (uint8_t)terms, (uint8_t)shift};
    for (uint32_t i = 0; i < n; i++) {
        out[i] = zd_power(&power, x[i]);
    }
}

void zk_play(int32_t *y, int32_t half_width, const int32_t *x, int32_t *out, uint32_t n) {
    for (uint32_t i = 0; i < n; i++) {
        out[i] = zd_play(y, x[i], half_width);
    }
}

void zk_between(const int32_t *older, const int32_t *newer, int32_t newer_q31, int32_t *out,
                uint32_t n) {
    for (uint32_t i = 0; i < n; i++) {
        out[i] = zd_between(older[i], newer[i], newer_q31);
    }
}

void zk_load(const int32_t *measured, const int32_t *drift, int32_t low, int32_t high, int32_t *out,
             uint32_t n) {
    for (uint32_t i = 0; i < n; i++) {
        out[i] = zd_load(measured[i], drift[i], low, high);
    }
}
