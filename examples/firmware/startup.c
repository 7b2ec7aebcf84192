/* Reset of a Cortex-M: vector table, initialised data, zeroed data, then main. */
#include <stddef.h>
#include <stdint.h>
#include <string.h>

extern uint32_t stack_top;
extern uint32_t data_start;
extern uint32_t data_end;
extern uint32_t data_in_flash;
extern uint32_t bss_start;
extern uint32_t bss_end;

int main(void);
void reset(void);
void stop(void);

typedef void (*handler_t)(void);
typedef struct {
    uint32_t *stack;
    handler_t handlers[15];
} vectors_t;

__attribute__((section(".vectors"), used)) static const vectors_t vectors = {
    &stack_top, {reset, stop, stop, stop, stop, stop, 0, 0, 0, 0, stop, stop, 0, stop, stop}};

void reset(void) {
    const uint32_t *from = &data_in_flash;
    for (uint32_t *to = &data_start; to < &data_end; to++) {
        *to = *from;
        from++;
    }
    for (uint32_t *to = &bss_start; to < &bss_end; to++) {
        *to = 0;
    }
    (void)main();
    stop();
}

void stop(void) {
    for (;;) {
    }
}

/* The compiler and the CAN encoder call these; here they need no C library. */
void *memset(void *to, int value, size_t n) {
    volatile uint8_t *bytes = to;
    for (size_t i = 0; i < n; i++) {
        bytes[i] = (uint8_t)value;
    }
    return to;
}

void *memcpy(void *to, const void *from, size_t n) {
    volatile uint8_t *bytes = to;
    const uint8_t *source = from;
    for (size_t i = 0; i < n; i++) {
        bytes[i] = source[i];
    }
    return to;
}
