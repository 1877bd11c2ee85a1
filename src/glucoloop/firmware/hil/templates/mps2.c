/* The boards mps2-an386 and mps2-an500 as QEMU emulates them: UART, watchdog and tick of a Cortex-M. */
#include "board.h"
#include "emulated.h"

#define WORD(address) (*(volatile uint32_t *)(address))
#define UART_DATA WORD(0x40004000U)
#define UART_STATE WORD(0x40004004U)
#define UART_CONTROL WORD(0x40004008U)
#define UART_CLEAR WORD(0x4000400CU)
#define UART_DIVIDER WORD(0x40004010U)
#define WATCHDOG_LOAD WORD(0x40008000U)
#define WATCHDOG_CONTROL WORD(0x40008008U)
#define WATCHDOG_CLEAR WORD(0x4000800CU)
#define WATCHDOG_LOCK WORD(0x40008C00U)
#define TICK_CONTROL WORD(0xE000E010U)
#define TICK_LOAD WORD(0xE000E014U)
#define IRQ_ENABLE WORD(0xE000E100U)
#define IRQ_CLEAR WORD(0xE000E280U)
#define SCB_PENDING WORD(0xE000ED04U)
#define SCB_VECTORS WORD(0xE000ED08U)
#define SCB_RESET WORD(0xE000ED0CU)

#define CLOCK_KHZ 25000U
#define UART_IRQ 1U
#define TICK_PENDING_CLEAR 0x02000000U

/* The watchdog calls this, and so does whatever goes wrong: a reset. */
static void restart(void)
{
  SCB_RESET = 0x05FA0004U;
  for (;;)
  {
  }
}

void power_fails(void)
{
  restart();
}

typedef void (*handler)(void);
static const handler vectors[16] __attribute__((aligned(128))) = {
  0,       restart, restart, restart, restart, restart, restart, restart,
  restart, restart, restart, restart, restart, restart, restart, restart};

void board_begin(uint32_t watchdog_ms)
{
  __asm volatile("cpsid i" : : : "memory"); /* an interrupt ends a sleep, and nothing else */
  SCB_VECTORS = (uint32_t)vectors;
  emulated_begin();
  UART_DIVIDER = CLOCK_KHZ * 1000U / 115200U;
  UART_CONTROL = 0x0BU; /* send, receive, interrupt at a received byte */
  IRQ_ENABLE = UART_IRQ;
  TICK_LOAD = CLOCK_KHZ * 100U;
  TICK_CONTROL = 7U;
  WATCHDOG_LOCK = 0x1ACCE551U;
  WATCHDOG_LOAD = CLOCK_KHZ * watchdog_ms;
  WATCHDOG_CONTROL = 3U;
}

void board_feed(void)
{
  WATCHDOG_CLEAR = 1U;
}

uint32_t board_receive(uint8_t bytes[], uint32_t most)
{
  uint32_t count = 0U;
  /* The next byte of a frame is soon there. QEMU pays much for each sleep, and a board would not wait here. */
  for (uint32_t turn = 0U; (turn < 128U) && ((UART_STATE & 2U) == 0U); turn++)
  {
    for (uint32_t i = 0U; i < 256U; i++)
    {
      __asm volatile("nop");
    }
  }
  if ((UART_STATE & 2U) == 0U)
  {
    __asm volatile("dsb\n wfi" : : : "memory");
  }
  UART_CLEAR = 2U;
  IRQ_CLEAR = UART_IRQ;
  SCB_PENDING = TICK_PENDING_CLEAR;
  while ((count < most) && ((UART_STATE & 2U) != 0U))
  {
    bytes[count] = (uint8_t)UART_DATA;
    count++;
  }
  return count;
}

void board_send(const uint8_t bytes[], uint32_t size)
{
  for (uint32_t i = 0U; i < size; i++)
  {
    while ((UART_STATE & 1U) != 0U)
    {
    }
    UART_DATA = bytes[i];
  }
}
