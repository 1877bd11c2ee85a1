/* Frames of the link: see frame.h, and the guide of `glucoloop hil` for their layout. */
#include "frame.h"

#include <string.h>

/* Four bits at a time: a table of 256 entries would be twice as quick, and sixteen times as large. */
uint32_t hil_crc(const uint8_t bytes[], uint32_t size)
{
  static const uint32_t of_four_bits[16] = {
    0x00000000U, 0x1DB71064U, 0x3B6E20C8U, 0x26D930ACU, 0x76DC4190U, 0x6B6B51F4U, 0x4DB26158U, 0x5005713CU,
    0xEDB88320U, 0xF00F9344U, 0xD6D6A3E8U, 0xCB61B38CU, 0x9B64C2B0U, 0x86D3D2D4U, 0xA00AE278U, 0xBDBDF21CU};
  uint32_t crc = 0xFFFFFFFFU;
  for (uint32_t i = 0U; i < size; i++)
  {
    crc ^= bytes[i];
    crc = (crc >> 4) ^ of_four_bits[crc & 15U];
    crc = (crc >> 4) ^ of_four_bits[crc & 15U];
  }
  return ~crc;
}

void hil_put16(uint8_t bytes[], uint16_t number)
{
  bytes[0] = (uint8_t)(number & 0xFFU);
  bytes[1] = (uint8_t)(number >> 8);
}

void hil_put32(uint8_t bytes[], uint32_t number)
{
  for (uint32_t i = 0U; i < 4U; i++)
  {
    bytes[i] = (uint8_t)((number >> (8U * i)) & 0xFFU);
  }
}

uint16_t hil_get16(const uint8_t bytes[])
{
  return (uint16_t)(bytes[0] | (uint16_t)((uint16_t)bytes[1] << 8));
}

uint32_t hil_get32(const uint8_t bytes[])
{
  uint32_t number = 0U;
  for (uint32_t i = 0U; i < 4U; i++)
  {
    number |= (uint32_t)bytes[i] << (8U * i);
  }
  return number;
}

uint32_t hil_encode(const hil_frame *frame, uint8_t bytes[HIL_FRAME_MAX])
{
  const uint32_t end = HIL_HEADER + (uint32_t)frame->length;
  bytes[0] = HIL_MARK_0;
  bytes[1] = HIL_MARK_1;
  bytes[2] = HIL_VERSION;
  bytes[3] = frame->type;
  hil_put32(&bytes[4], frame->session);
  hil_put32(&bytes[8], frame->sample);
  hil_put16(&bytes[12], frame->length);
  hil_put16(&bytes[14], 0U);
  hil_put32(&bytes[16], hil_crc(bytes, 16U));
  (void)memcpy(&bytes[HIL_HEADER], frame->payload, frame->length);
  hil_put32(&bytes[end], hil_crc(bytes, end));
  return end + 4U;
}

void hil_push(hil_decoder *decoder, uint8_t byte)
{
  if (decoder->size < HIL_FRAME_MAX) /* there is room: hil_next leaves less than the longest frame */
  {
    decoder->held[decoder->size] = byte;
    decoder->size++;
  }
}

static void drop(hil_decoder *decoder, uint32_t count)
{
  const uint32_t end = (decoder->size < HIL_FRAME_MAX) ? decoder->size : HIL_FRAME_MAX;
  uint32_t left = 0U;
  for (uint32_t i = count; (i < end) && (left < HIL_FRAME_MAX); i++)
  {
    decoder->held[left] = decoder->held[i];
    left++;
  }
  decoder->size = left;
}

/* Number of bytes of the frame that begins here; 0 if none can, and 1 if there are too few bytes to tell. */
static uint32_t length_of(const uint8_t held[], uint32_t size)
{
  static const uint8_t first[3] = {HIL_MARK_0, HIL_MARK_1, HIL_VERSION};
  uint32_t length = 1U;
  for (uint32_t i = 0U; (i < 3U) && (i < size); i++)
  {
    if (held[i] != first[i])
    {
      length = 0U;
    }
  }
  if ((length != 0U) && (size >= HIL_HEADER))
  {
    const uint32_t payload = hil_get16(&held[12]);
    const bool whole = hil_get32(&held[16]) == hil_crc(held, 16U);
    length = (whole && (payload <= HIL_PAYLOAD_MAX)) ? (HIL_FRAME_MIN + payload) : 0U;
  }
  return length;
}

bool hil_next(hil_decoder *decoder, hil_frame *frame)
{
  bool found = false;
  bool more = true;
  while (more && (decoder->size > 0U))
  {
    const uint8_t *held = decoder->held;
    const uint32_t length = length_of(held, decoder->size);
    more = false;
    if ((length == 0U) || ((length >= HIL_FRAME_MIN) && (decoder->size >= length) &&
                           (hil_get32(&held[length - 4U]) != hil_crc(held, length - 4U))))
    {
      /* No frame begins at the first byte; one may begin at any of the others. */
      decoder->refused += (held[0] == HIL_MARK_0) ? 1U : 0U;
      drop(decoder, 1U);
      more = true;
    }
    else if ((length >= HIL_FRAME_MIN) && (decoder->size >= length))
    {
      frame->type = held[3];
      frame->session = hil_get32(&held[4]);
      frame->sample = hil_get32(&held[8]);
      frame->length = (uint16_t)(length - HIL_FRAME_MIN);
      (void)memcpy(frame->payload, &held[HIL_HEADER], frame->length);
      drop(decoder, length);
      found = true;
    }
    else
    {
      /* The frame is not complete yet. */
    }
  }
  return found;
}
