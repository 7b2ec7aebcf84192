/* What the application needs of a board. board_mps2.c is the one that QEMU emulates; on your own,
 * these few functions are what you write. */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

#include "i2c.h"

void board_start(void);

/* The bus of the thermometer. */
const i2c_t *board_i2c(void);

/* Waits for the next sample period; 0 when there is none any more (a simulated board's log ends). */
uint32_t board_wait(void);

/* A further input of the model, by its number in the model's header; not the thermometer. */
int32_t board_read_channel(uint32_t channel);

/* What the sensor measures, uncompensated, in the counts of the model's output. */
int32_t board_read_raw(uint32_t output);

void board_send_can(uint32_t identifier, const uint8_t *data, uint32_t bytes);

/* The application has ended; a real one does not. */
void board_stop(void);

#endif /* BOARD_H */
