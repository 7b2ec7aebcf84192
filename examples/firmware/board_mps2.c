/* QEMU's mps2-an386: a Cortex-M4 with a serial line. The thermometer, the other inputs and the raw
 * values come from samples that the build puts into flash; CAN frames go to the serial line as
 * lines of candump, which python-can reads. */
#include "board.h"

#include "samples.h"
#include "tmp117.h"

#define UART_DATA (*(volatile uint32_t *)0x40004000u)
#define UART_STATE (*(volatile uint32_t *)0x40004004u)
#define UART_CONTROL (*(volatile uint32_t *)0x40004008u)
#define UART_BAUD (*(volatile uint32_t *)0x40004010u)
#define UART_FULL 1u
#define SEMIHOSTING_EXIT 0x18u
#define EXIT_DONE 0x20026u

static uint32_t taken; /* samples so far; the present one is taken - 1 */
static uint32_t configured;

static void send(char c) {
    while ((UART_STATE & UART_FULL) != 0u) {
    }
    UART_DATA = (uint32_t)(uint8_t)c;
}

static void send_text(const char *text) {
    for (uint32_t i = 0; text[i] != '\0'; i++) {
        send(text[i]);
    }
}

static void send_hex(uint32_t x, uint32_t digits) {
    for (uint32_t i = digits; i > 0u; i--) {
        send("0123456789ABCDEF"[(x >> (4u * (i - 1u))) & 15u]);
    }
}

static void send_decimal(uint32_t x) {
    uint32_t unit = 1u;
    while ((x / unit) >= 10u) {
        unit *= 10u;
    }
    for (; unit > 0u; unit /= 10u) {
        send((char)('0' + (char)((x / unit) % 10u)));
    }
}

/* A thermometer on the bus: three registers, and a conversion ready once it is configured. */
static int transfer(void *bus, uint8_t address, const uint8_t *out, uint32_t out_bytes, uint8_t *in,
                    uint32_t in_bytes) {
    uint32_t value = 0;
    (void)bus;
    if ((address != TMP117_ADDRESS) || (out_bytes == 0u)) {
        return 1;
    }
    if ((out[0] == 1u) && (out_bytes == 3u)) {
        configured = 1u;
    }
    if (out[0] == 0x0Fu) {
        value = 0x1117u; /* revision 1 */
    } else if (out[0] == 1u) {
        value = 0x0220u | ((configured != 0u) ? 0x2000u : 0u);
    } else if (taken == 0u) {
        value = 0x8000u;
    } else {
        value = (uint16_t)sample_codes[taken - 1u][SAMPLE_THERMOMETER];
    }
    if (in_bytes == 2u) {
        in[0] = (uint8_t)(value >> 8);
        in[1] = (uint8_t)(value & 0xFFu);
    }
    return 0;
}

static const i2c_t i2c = {transfer, 0};

void board_start(void) {
    UART_BAUD = 16u;
    UART_CONTROL = 1u; /* transmit */
}

const i2c_t *board_i2c(void) { return &i2c; }

uint32_t board_wait(void) {
    taken++;
    return (taken <= SAMPLES) ? 1u : 0u;
}

int32_t board_read_channel(uint32_t channel) { return sample_codes[taken - 1u][channel]; }

int32_t board_read_raw(uint32_t output) { return sample_raw[taken - 1u][output]; }

void board_send_can(uint32_t identifier, const uint8_t *data, uint32_t bytes) {
    send('(');
    send_decimal(taken - 1u);
    send_text(".000000) can0 ");
    send_hex(identifier, 3u);
    send('#');
    for (uint32_t i = 0; i < bytes; i++) {
        send_hex(data[i], 2u);
    }
    send('\n');
}

void board_stop(void) {
    register uint32_t operation __asm("r0") = SEMIHOSTING_EXIT;
    register uint32_t reason __asm("r1") = EXIT_DONE;
    __asm volatile("bkpt 0xab" : : "r"(operation), "r"(reason) : "memory");
}
