#include "tmp117.h"

#define REGISTER_RESULT 0x00u
#define REGISTER_CONFIGURATION 0x01u
#define REGISTER_IDENTITY 0x0Fu
#define IDENTITY 0x0117u
#define IDENTITY_MASK 0x0FFFu /* above it, the die's revision */
#define CONTINUOUS_1_HZ_8_AVERAGES 0x0220u
#define DATA_READY 0x2000u
#define NO_CONVERSION_YET (-32768) /* -256 degC: what the register holds after power-on */

static int read_register(const i2c_t *i2c, uint8_t number, uint16_t *value) {
    uint8_t in[2] = {0, 0};
    const int failed = i2c->transfer(i2c->bus, TMP117_ADDRESS, &number, 1u, in, 2u);
    *value = (uint16_t)(((uint32_t)in[0] << 8) | in[1]);
    return failed;
}

tmp117_status_t tmp117_start(const i2c_t *i2c) {
    const uint8_t configuration[3] = {REGISTER_CONFIGURATION,
                                      (uint8_t)(CONTINUOUS_1_HZ_8_AVERAGES >> 8),
                                      (uint8_t)(CONTINUOUS_1_HZ_8_AVERAGES & 0xFFu)};
    uint16_t identity = 0;
    if (read_register(i2c, REGISTER_IDENTITY, &identity) != 0) {
        return TMP117_BUS;
    }
    if ((identity & IDENTITY_MASK) != IDENTITY) {
        return TMP117_WRONG;
    }
    if (i2c->transfer(i2c->bus, TMP117_ADDRESS, configuration, 3u, 0, 0u) != 0) {
        return TMP117_BUS;
    }
    return TMP117_OK;
}

tmp117_status_t tmp117_read(const i2c_t *i2c, int16_t *code) {
    uint16_t configuration = 0;
    uint16_t result = 0;
    if (read_register(i2c, REGISTER_CONFIGURATION, &configuration) != 0) {
        return TMP117_BUS;
    }
    if ((configuration & DATA_READY) == 0u) {
        return TMP117_NOT_READY;
    }
    if (read_register(i2c, REGISTER_RESULT, &result) != 0) {
        return TMP117_BUS;
    }
    const int32_t value = (result < 32768u) ? (int32_t)result : ((int32_t)result - 65536);
    if (value == NO_CONVERSION_YET) {
        return TMP117_NOT_READY;
    }
    *code = (int16_t)value;
    return TMP117_OK;
}
