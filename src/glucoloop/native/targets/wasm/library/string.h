/* The functions of string.h that the compact form of C uses. */
#define memcpy __builtin_memcpy

static inline int memcmp(const void *a, const void *b, __SIZE_TYPE__ bytes)
{
  const unsigned char *x = a, *y = b;
  for (__SIZE_TYPE__ i = 0; i < bytes; i++)
  {
    if (x[i] != y[i]) return x[i] < y[i] ? -1 : 1;
  }
  return 0;
}
