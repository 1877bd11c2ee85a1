/* Frames of the link between a patient's side (sensor and pump) and a chip. */
#ifndef HIL_FRAME_H
#define HIL_FRAME_H

#include "link.h"

#include <stdbool.h>
#include <stdint.h>

typedef struct
{
  uint32_t session;
  uint32_t sample;
  uint16_t length; /* of the payload, in bytes */
  uint8_t type;
  uint8_t payload[HIL_PAYLOAD_MAX];
} hil_frame;

/* Bytes that were received and are not yet part of a frame. Set it to zeros before its first use. */
typedef struct
{
  uint32_t size;
  uint32_t refused; /* number of beginnings of frames that were refused */
  uint8_t held[HIL_FRAME_MAX];
} hil_decoder;

/* CRC-32 as of IEEE 802.3. */
uint32_t hil_crc(const uint8_t bytes[], uint32_t size);

/* Write a frame to bytes, and return their number. */
uint32_t hil_encode(const hil_frame *frame, uint8_t bytes[HIL_FRAME_MAX]);

/* Take one byte. All frames that hil_next gives must be taken before the next byte. */
void hil_push(hil_decoder *decoder, uint8_t byte);

/* Take the next frame; false if none is complete. */
bool hil_next(hil_decoder *decoder, hil_frame *frame);

/* Numbers of 16 and 32 bits in bytes, the lowest byte first. */
void hil_put16(uint8_t bytes[], uint16_t number);
void hil_put32(uint8_t bytes[], uint32_t number);
uint16_t hil_get16(const uint8_t bytes[]);
uint32_t hil_get32(const uint8_t bytes[]);

#endif
