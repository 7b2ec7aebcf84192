/* Fuzz target of a generated model: any inputs, any state bytes, any saved copy. Built by
 * tests/fuzz/build.py with libFuzzer, or with a main of its own that replays files. What has to hold
 * beside the sanitizers' silence stands in `check`. */
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include HARNESS

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void check(int holds) {
    if (!holds) {
        abort();
    }
}

/* Takes up to `wanted` bytes; what is missing stays as it was. */
static void take(const uint8_t **data, size_t *size, void *to, size_t wanted) {
    const size_t n = (*size < wanted) ? *size : wanted;
    memcpy(to, *data, n);
    *data += n;
    *size -= n;
}

static void run_steps(MODEL_STATE *state, const uint8_t *data, size_t size) {
    static const int32_t low[OUTPUTS] = LOWEST;
    static const int32_t high[OUTPUTS] = HIGHEST;
    CODE codes[CHANNELS] = {0};
    int32_t drift[OUTPUTS];
    uint32_t flags;
    uint32_t before = 0;
    do {
        take(&data, &size, codes, sizeof codes);
        zd_run(state, codes, 1u, drift, &flags, NULL);
        for (uint32_t k = 0; k < OUTPUTS; k++) {
            const int within = drift[k] >= low[k] && drift[k] <= high[k];
            check((flags & 16u) ? (drift[k] == 0) : (within || ((flags & 64u) && drift[k] == 0)));
        }
        check((flags & ~127u) == 0u);
        check(!((before & flags) & 16u)); /* damage is told once: the state has been restarted */
        before = flags;
    } while (size > 0u);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    MODEL_STATE state;
    uint8_t saved[sizeof(MODEL_STATE) + 16u];
    CODE codes[CHANNELS] = {0};
    uint8_t settled = 0;
    if (size == 0u) {
        return 0;
    }
    memset(&state, 0, sizeof state);
    take(&data, &size, &settled, 1u);
    take(&data, &size, codes, sizeof codes);
    zd_start(&state, codes, settled & 1);
#if TARGET == 1
    take(&data, &size, &state, sizeof state);
    if (settled & 2) { /* else the fuzzer would have to guess the model's number */
        state.identity = IDENTITY;
    }
#elif TARGET >= 2
    MODEL_SAVE(&state, saved);
    take(&data, &size, &saved[(settled & 2) ? 16u : 0u], sizeof saved - ((settled & 2) ? 16u : 0u));
    if (settled & 4) {
        const uint32_t crc = zd_crc32(0, saved, (uint32_t)sizeof saved - 4u);
        memcpy(&saved[sizeof saved - 4u], &crc, 4u); /* hosts that fuzz are little-endian */
    }
    (void)MODEL_RESTORE(&state, saved);
#endif
    run_steps(&state, data, size);
    return 0;
}

#if defined(REPLAY)
#include <stdio.h>

int main(int count, char **names) {
    static uint8_t data[1 << 16];
    for (int i = 1; i < count; i++) {
        FILE *file = fopen(names[i], "rb");
        check(file != NULL);
        (void)LLVMFuzzerTestOneInput(data, fread(data, 1u, sizeof data, file));
        (void)fclose(file);
    }
    return 0;
}
#endif
