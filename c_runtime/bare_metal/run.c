/* Runs a generated model over the steps in in.bin and writes drifts and flags to out.bin, on a board
 * that QEMU emulates; files by semihosting. Built by c_runtime/qemu.py. */
#include <stddef.h>
#include <stdint.h>

#include HARNESS
#include "zd_runtime.c"

#define BATCH 256u
#define REPEATS 1000u
#define SYS_OPEN 1u
#define SYS_WRITE 5u
#define SYS_READ 6u
#define SYS_EXIT 24u
#define EXIT_DONE 0x20026u
#define OPEN_READ 1u
#define OPEN_WRITE 5u

extern uint32_t stack_top;
void reset(void);
int main(void);

/* What a compiler may call where there is no C library. */
void *memset(void *to, int value, size_t n) {
    uint8_t *bytes = to;
    for (size_t i = 0; i < n; i++) {
        bytes[i] = (uint8_t)value;
    }
    return to;
}

void *memcpy(void *to, const void *from, size_t n) {
    uint8_t *bytes = to;
    for (size_t i = 0; i < n; i++) {
        bytes[i] = ((const uint8_t *)from)[i];
    }
    return to;
}

#if defined(__riscv)
__attribute__((naked, section(".vectors"))) void reset(void) {
    __asm volatile("la sp, stack_top\n"
                   "call main\n"
                   "1: j 1b\n");
}

static uintptr_t call_host(uintptr_t operation, uintptr_t argument) {
    register uintptr_t a0 __asm("a0") = operation;
    register uintptr_t a1 __asm("a1") = argument;
    __asm volatile(".option push\n"
                   ".option norvc\n"
                   ".balign 16\n"
                   "slli x0, x0, 0x1f\n"
                   "ebreak\n"
                   "srai x0, x0, 7\n"
                   ".option pop\n"
                   : "+r"(a0)
                   : "r"(a1)
                   : "memory");
    return a0;
}

static void start_clock(void) {}
static uint32_t read_clock(void) { return 0; }
#else
__attribute__((section(".vectors"), used)) static const uintptr_t vectors[2] = {
    (uintptr_t)&stack_top, (uintptr_t)&reset};

void reset(void) {
    /* floating point and vector unit on, where there is one */
    *(volatile uint32_t *)0xE000ED88u |= 0xF00000u;
    __asm volatile("dsb\n isb" ::: "memory");
    (void)main();
}

static uintptr_t call_host(uintptr_t operation, uintptr_t argument) {
    register uintptr_t r0 __asm("r0") = operation;
    register uintptr_t r1 __asm("r1") = argument;
    __asm volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

#define SYSTICK_CONTROL (*(volatile uint32_t *)0xE000E010u)
#define SYSTICK_RELOAD (*(volatile uint32_t *)0xE000E014u)
#define SYSTICK_VALUE (*(volatile uint32_t *)0xE000E018u)

static void start_clock(void) {
    SYSTICK_RELOAD = 0xFFFFFFu;
    SYSTICK_VALUE = 0;
    SYSTICK_CONTROL = 5u; /* counts the core's clock, no interrupt */
    while (SYSTICK_VALUE == 0u) {
    }
}

static uint32_t read_clock(void) { return 0xFFFFFFu - SYSTICK_VALUE; }
#endif

static uintptr_t open_file(const char *name, uintptr_t length, uintptr_t mode) {
    const uintptr_t block[3] = {(uintptr_t)name, mode, length};
    return call_host(SYS_OPEN, (uintptr_t)block);
}

static void read_file(uintptr_t file, void *to, uint32_t bytes) {
    const uintptr_t block[3] = {file, (uintptr_t)to, bytes};
    (void)call_host(SYS_READ, (uintptr_t)block);
}

static void write_file(uintptr_t file, const void *from, uint32_t bytes) {
    const uintptr_t block[3] = {file, (uintptr_t)from, bytes};
    (void)call_host(SYS_WRITE, (uintptr_t)block);
}

static uint64_t state[1024];
static CODE codes[BATCH * CHANNELS];
static int32_t drift[BATCH * OUTPUTS];
static uint32_t flags[BATCH];
static uint32_t rows[BATCH * (OUTPUTS + 1u)];

/* Clock ticks of a thousand layer steps, their loop taken off, and of a million instructions. */
static void measure(uint32_t ticks[2]) {
    ticks[0] = 0;
    ticks[1] = 0;
#if defined(LAYER_STEP)
    static const int16_t x[INPUTS] = {1000};
    static int32_t h_q30[HIDDEN];
    static int32_t cell[HIDDEN];
    uint32_t start = read_clock();
    for (uint32_t i = 0; i < REPEATS; i++) {
        LAYER_STEP(x, h_q30, cell);
    }
    ticks[0] = read_clock() - start;
    start = read_clock();
    for (uint32_t i = 0; i < REPEATS; i++) {
        __asm volatile("");
    }
    ticks[0] -= read_clock() - start;
    start = read_clock();
#if !defined(__riscv)
    uint32_t n = 500000u;
    __asm volatile("1: subs %0, #1\n bne 1b" : "+r"(n) : : "cc");
#endif
    ticks[1] = read_clock() - start;
#endif
}

int main(void) {
    uint32_t head[2] = {0, 0};
    uint32_t tail[3];
    const uintptr_t in = open_file("in.bin", 6u, OPEN_READ);
    const uintptr_t out = open_file("out.bin", 7u, OPEN_WRITE);
    memset(state, 0, sizeof state);
    read_file(in, head, sizeof head);
    for (uint32_t first = 0; first < head[1]; first += BATCH) {
        const uint32_t count = ((head[1] - first) < BATCH) ? (head[1] - first) : BATCH;
        read_file(in, codes, count * CHANNELS * (uint32_t)sizeof(CODE));
        if (first == 0u) {
            zd_start(state, codes, (int)head[0]);
        }
        zd_run(state, codes, count, drift, flags, NULL);
        uint32_t n = 0;
        for (uint32_t t = 0; t < count; t++) {
            for (uint32_t k = 0; k < OUTPUTS; k++) {
                rows[n++] = (uint32_t)drift[(t * OUTPUTS) + k];
            }
            rows[n++] = flags[t];
        }
        write_file(out, rows, n * 4u);
    }
    tail[0] = zd_selftest();
    start_clock();
    measure(&tail[1]);
    write_file(out, tail, sizeof tail);
    (void)call_host(SYS_EXIT, EXIT_DONE);
    return 0;
}
