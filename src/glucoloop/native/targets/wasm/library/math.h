/* The constants of math.h, which the compact form of C uses. */
#define NAN __builtin_nanf("")
#define INFINITY __builtin_inff()
