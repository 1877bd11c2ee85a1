/* The board virt as QEMU emulates it: UART and timer of a RISC-V of 32 bits. The timer is the watchdog. */
#include "board.h"
#include "emulated.h"

#define WORD(address) (*(volatile uint32_t *)(address))
#define BYTE(address) (*(volatile uint8_t *)(address))
#define UART_DATA BYTE(0x10000000U)
#define UART_INTERRUPT BYTE(0x10000001U)
#define UART_QUEUE BYTE(0x10000002U)
#define UART_FORMAT BYTE(0x10000003U)
#define UART_STATE BYTE(0x10000005U)
#define LINE_PRIORITY WORD(0x0C000028U)
#define LINE_ENABLE WORD(0x0C002000U)
#define LINE_THRESHOLD WORD(0x0C200000U)
#define LINE_CLAIM WORD(0x0C200004U)
#define TIMER_LOW WORD(0x0200BFF8U)
#define TIMER_HIGH WORD(0x0200BFFCU)
#define TIMER_AT_LOW WORD(0x02004000U)
#define TIMER_AT_HIGH WORD(0x02004004U)
#define TEST_DEVICE WORD(0x00100000U)

#define CLOCK_KHZ 10000U
#define UART_LINE 10U
#define UART_DIVISOR 0x80U

static uint32_t limit_ms;

static uint64_t time_now(void)
{
  uint32_t high;
  uint32_t low;
  do
  {
    high = TIMER_HIGH;
    low = TIMER_LOW;
  } while (high != TIMER_HIGH);
  return ((uint64_t)high << 32) | low;
}

static void wake_after(uint32_t ms)
{
  const uint64_t at = time_now() + ((uint64_t)CLOCK_KHZ * ms);
  TIMER_AT_HIGH = 0xFFFFFFFFU;
  TIMER_AT_LOW = (uint32_t)at;
  TIMER_AT_HIGH = (uint32_t)(at >> 32);
}

void power_fails(void)
{
  TEST_DEVICE = 0x7777U;
  for (;;)
  {
  }
}

/* The watchdog calls this, and so does whatever goes wrong: a reset. */
__attribute__((interrupt("machine"), aligned(4))) static void restart(void)
{
  power_fails();
}

void board_begin(uint32_t watchdog_ms)
{
  limit_ms = watchdog_ms;
  emulated_begin();
  UART_FORMAT = UART_DIVISOR;
  UART_DATA = 1U; /* 115200 baud */
  UART_INTERRUPT = 0U;
  UART_FORMAT = 3U; /* 8 bits, no parity, one stop bit */
  /* Interrupt at 14 bytes, or when no more come for the time of 4: QEMU pays much for each interrupt. */
  UART_QUEUE = 0xC1U;
  UART_INTERRUPT = 1U;
  LINE_PRIORITY = 1U;
  LINE_ENABLE = 1U << UART_LINE;
  LINE_THRESHOLD = 0U;
  __asm volatile("csrw mtvec, %0\n csrs mie, %1" : : "r"(restart), "r"(0x80U) : "memory");
  board_feed();
}

void board_feed(void)
{
  wake_after(limit_ms);
  __asm volatile("csrsi mstatus, 8" : : : "memory"); /* from here on the timer interrupts */
}

uint32_t board_receive(uint8_t bytes[], uint32_t most)
{
  uint32_t count = 0U;
  if ((UART_STATE & 1U) == 0U)
  {
    /* The timer or a byte ends the sleep, and does not interrupt. */
    __asm volatile("csrci mstatus, 8\n csrs mie, %0" : : "r"(0x800U) : "memory");
    wake_after(100U);
    __asm volatile("wfi" : : : "memory");
    LINE_CLAIM = LINE_CLAIM;
    __asm volatile("csrc mie, %0" : : "r"(0x800U) : "memory");
    board_feed();
  }
  while ((count < most) && ((UART_STATE & 1U) != 0U))
  {
    bytes[count] = UART_DATA;
    count++;
  }
  return count;
}

void board_send(const uint8_t bytes[], uint32_t size)
{
  for (uint32_t i = 0U; i < size; i++)
  {
    while ((UART_STATE & 0x20U) == 0U)
    {
    }
    UART_DATA = bytes[i];
  }
}
