/* Start of an emulated chip, its way to tell, and a counter of instructions. For the self-test alone. */
#include "chip.h"

#include <stddef.h>
#include <stdint.h>

extern uint32_t data_begin, data_end, data_source, bss_begin, bss_end, stack_top;
int main(void);

void *memcpy(void *to, const void *from, size_t size)
{
  for (size_t i = 0; i < size; i++)
  {
    ((volatile uint8_t *)to)[i] = ((const uint8_t *)from)[i];
  }
  return to;
}

void *memset(void *to, int byte, size_t size)
{
  for (size_t i = 0; i < size; i++)
  {
    ((volatile uint8_t *)to)[i] = (uint8_t)byte;
  }
  return to;
}

int memcmp(const void *a, const void *b, size_t size)
{
  const uint8_t *x = a;
  const uint8_t *y = b;
  int found = 0;
  for (size_t i = 0; (i < size) && (found == 0); i++)
  {
    found = (int)x[i] - (int)y[i];
  }
  return found;
}

#if defined(__arm__)
int chip_ask(int what, const void *with)
{
  register int r0 __asm("r0") = what;
  register const void *r1 __asm("r1") = with;
  __asm volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
  return r0;
}
#define TICKS (0xFFFFFFU - *(volatile uint32_t *)0xE000E018U)
static void count(void)
{
  *(volatile uint32_t *)0xE000E014U = 0xFFFFFFU;
  *(volatile uint32_t *)0xE000E018U = 0U;
  *(volatile uint32_t *)0xE000E010U = 5U;
}
static void turn(uint32_t rounds)
{
  __asm volatile("1: subs %0, %0, #1\n bne 1b" : "+r"(rounds) : : "cc");
}
void reset(void);
__attribute__((section(".vectors"), used)) static const struct
{
  uint32_t *stack;
  void (*start)(void);
} vectors = {&stack_top, reset};
#else
/* The place is rounded up where instructions of two bytes are allowed: without them it may be two bytes off. */
int chip_ask(int what, const void *with)
{
  register int a0 __asm("a0") = what;
  register const void *a1 __asm("a1") = with;
  __asm volatile(".balign 16\n.option push\n.option norvc\nslli x0, x0, 0x1f\nebreak\nsrai x0, x0, 7\n.option pop"
                 : "+r"(a0) : "r"(a1) : "memory");
  return a0;
}
static uint32_t cycles(void)
{
  uint32_t now;
  __asm volatile("csrr %0, mcycle" : "=r"(now));
  return now;
}
static uint32_t began;
#define TICKS (cycles() - began)
static void count(void)
{
  began = cycles();
}
static void turn(uint32_t rounds)
{
  __asm volatile("1: addi %0, %0, -1\n bnez %0, 1b" : "+r"(rounds));
}
#endif

static uint32_t per_round;

void chip_begin(void)
{
  if (per_round == 0U)
  {
    count();
    turn(100000U);
    per_round = TICKS;
  }
  count();
}

uint32_t chip_instructions(void)
{
  const uint64_t ticks = TICKS;
  return (uint32_t)((ticks * 200000U) / per_round);
}

void chip_say(const char *text)
{
  while (*text != '\0')
  {
    (void)chip_ask(3, text);
    text++;
  }
}

static void leave(int code)
{
  const uint32_t with[2] = {0x20026U, (uint32_t)code};
  (void)chip_ask(0x20, with);
  for (;;)
  {
  }
}

static void begin(void)
{
  for (uint32_t *to = &data_begin, *from = &data_source; to < &data_end; to++, from++)
  {
    *to = *from;
  }
  for (volatile uint32_t *to = &bss_begin; to < (volatile uint32_t *)&bss_end; to++)
  {
    *to = 0U;
  }
  leave(main());
}

#if defined(__arm__)
void reset(void)
{
  *(volatile uint32_t *)0xE000ED88U |= 0xF00000U; /* the floating-point unit */
  __asm volatile("dsb\n isb");
  begin();
}
#else
__attribute__((used)) static void (*const go)(void) = begin;
__attribute__((naked, section(".vectors"), used)) void reset(void)
{
  __asm volatile("la sp, stack_top\n li t0, 0x6000\n csrs mstatus, t0\n lla t0, %0\n jr t0" : : "i"(begin));
}
#endif
