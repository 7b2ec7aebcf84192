/* A plain float GRU with libm, of the shape that bench_kernels.py gives, to measure against. */
#include <math.h>
#include <stdint.h>

static float sigmoid(float x) { return 1.0f / (1.0f + expf(-x)); }

/* w [H][3][I + H] (r, u, n; features first), bias [H][4], head [K][H], scale [I]. */
void float_gru_run(const float *w, const float *bias, const float *head, const float *scale,
                   const int16_t *codes, float *h, float *drift, uint32_t steps) {
    for (uint32_t t = 0; t < steps; t++) {
        float x[INPUTS];
        float next[HIDDEN];
        for (int i = 0; i < INPUTS; i++) {
            x[i] = scale[i] * codes[t * INPUTS + i];
        }
        for (int j = 0; j < HIDDEN; j++) {
            float outside[3];
            float inside[3];
            for (int g = 0; g < 3; g++) {
                const float *row = &w[(3 * j + g) * (INPUTS + HIDDEN)];
                float from_x = bias[4 * j + g];
                float from_h = 0.0f;
                for (int i = 0; i < INPUTS; i++) {
                    from_x += row[i] * x[i];
                }
                for (int i = 0; i < HIDDEN; i++) {
                    from_h += row[INPUTS + i] * h[i];
                }
                outside[g] = from_x;
                inside[g] = from_h;
            }
            const float r = sigmoid(outside[0] + inside[0]);
            const float u = sigmoid(outside[1] + inside[1]);
            const float n = tanhf(outside[2] + r * (inside[2] + bias[4 * j + 3]));
            next[j] = h[j] + u * (n - h[j]);
        }
        for (int j = 0; j < HIDDEN; j++) {
            h[j] = next[j];
        }
        for (int k = 0; k < OUTPUTS; k++) {
            float sum = 0.0f;
            for (int j = 0; j < HIDDEN; j++) {
                sum += head[k * HIDDEN + j] * h[j];
            }
            drift[t * OUTPUTS + k] = sum;
        }
    }
}
