"""C: one controller step as C99 for a microcontroller, without allocation and without a library of functions.

There are two forms. `unrolled` has one statement for each operation of a lowered program. `compact` is written from the
traced function itself: it keeps loops and matrices as they are. Products are strict in both: each operation is rounded
by itself, since few microcontrollers have a fused multiply-add in both precisions.
"""
