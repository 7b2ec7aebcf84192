/* What a driver needs of an I2C bus: one transfer. Implement it with your chip's HAL. */
#ifndef I2C_H
#define I2C_H

#include <stdint.h>

/* Writes `out_bytes` to the device, then, if `in_bytes` is not 0, reads after a repeated start.
 * Returns 0 when every byte was acknowledged. */
typedef struct {
    int (*transfer)(void *bus, uint8_t address, const uint8_t *out, uint32_t out_bytes, uint8_t *in,
                    uint32_t in_bytes);
    void *bus;
} i2c_t;

#endif /* I2C_H */
