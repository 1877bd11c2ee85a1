#include "@HEADER@"

#include <float.h>
#include <math.h> /* the constants NAN and INFINITY; no function of it is called */
#include <string.h>

#ifdef __FAST_MATH__
#error "Results are equal to the bit only where the compiler keeps to IEEE 754: leave -ffast-math out."
#endif
#if defined(FLT_EVAL_METHOD) && @DIGITS@
#error "This compiler computes in more digits than it stores; results would not be equal to the bit."
#endif
#if defined(__GNUC__) && !defined(__clang__) && defined(__AVX__)
/* gcc 12 may copy a table as wide constants, and loses zeros after numbers that are all alike. */
#pragma GCC optimize("no-tree-loop-distribute-patterns")
#endif
