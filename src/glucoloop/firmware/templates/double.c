/* Differences of float64 on a processor of ARM without a unit for it, rounded as IEEE 754 asks.
 *
 * The addition of libgcc keeps one bit too few where the exponents differ by 33: a difference that falls below a power
 * of two, as 1 - x for x near 2^-33, is rounded to the wrong neighbour. All its other sums are right. The linker puts
 * these functions in its place, with -Wl,--wrap=__aeabi_dadd,--wrap=__aeabi_dsub. */
#include <stdint.h>

#define SIGN ((uint64_t)1 << 63)
#define HIDDEN ((uint64_t)1 << 52)
#define NO_NUMBER 0x7FFU
#define EXPONENT(bits) ((uint32_t)((bits) >> 52) & NO_NUMBER)

uint64_t __real___aeabi_dadd(uint64_t a, uint64_t b);
uint64_t __wrap___aeabi_dadd(uint64_t a, uint64_t b);
uint64_t __wrap___aeabi_dsub(uint64_t a, uint64_t b);

/* Sum of two numbers of opposite signs whose exponents are 33 or 34 apart. */
static uint64_t difference(uint64_t large, uint64_t small)
{
  const uint32_t of_small = EXPONENT(small);
  uint32_t of_large = EXPONENT(large);
  const uint32_t shift = of_large - ((of_small == 0U) ? 1U : of_small);
  const uint64_t aligned = ((small & (HIDDEN - 1U)) | ((of_small == 0U) ? 0U : HIDDEN)) << 3;
  uint64_t left = ((large & (HIDDEN - 1U)) | HIDDEN) << 3;
  left -= (aligned >> shift) | (((aligned << (64U - shift)) != 0U) ? 1U : 0U);
  if (left < (HIDDEN << 3))
  {
    left <<= 1;
    of_large--;
  }
  left = (left >> 3) + ((((left & 7U) + ((left >> 3) & 1U)) > 4U) ? 1U : 0U);
  return (large & SIGN) | (((uint64_t)(of_large - 1U) << 52) + left);
}

uint64_t __wrap___aeabi_dadd(uint64_t a, uint64_t b)
{
  const uint32_t of_a = EXPONENT(a);
  const uint32_t of_b = EXPONENT(b);
  const uint32_t apart = (of_a > of_b) ? (of_a - of_b) : (of_b - of_a);
  uint64_t sum;
  /* Also 34: a subnormal number has the exponent of the smallest normal one. */
  if (((apart == 33U) || (apart == 34U)) && (((a ^ b) & SIGN) != 0U) && (of_a != NO_NUMBER) && (of_b != NO_NUMBER))
  {
    sum = (of_a > of_b) ? difference(a, b) : difference(b, a);
  }
  else
  {
    sum = __real___aeabi_dadd(a, b);
  }
  return sum;
}

uint64_t __wrap___aeabi_dsub(uint64_t a, uint64_t b)
{
  return __wrap___aeabi_dadd(a, b ^ SIGN);
}
