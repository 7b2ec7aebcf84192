/* Driver of the thermometer TMP117 (Texas Instruments, data sheet SNOSD82). */
#ifndef TMP117_H
#define TMP117_H

#include <stdint.h>

#include "i2c.h"

#define TMP117_ADDRESS 0x48u /* ADD0 at ground */

typedef enum {
    TMP117_OK = 0,
    TMP117_BUS = 1,       /* not acknowledged */
    TMP117_WRONG = 2,     /* another chip answers */
    TMP117_NOT_READY = 3, /* no conversion since the last reading */
} tmp117_status_t;

/* Checks the device's identity and starts continuous conversions, one a second of 8 averages. */
tmp117_status_t tmp117_start(const i2c_t *i2c);

/* Reads the newest conversion, 0.0078125 degC per count. */
tmp117_status_t tmp117_read(const i2c_t *i2c, int16_t *code);

#endif /* TMP117_H */
