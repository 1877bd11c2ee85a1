"""WebAssembly of lowered functions: the vector code of `glucoloop.native.targets.llvm`, compiled for browsers and node.

WebAssembly has no fused multiply-add that rounds alike everywhere, so products are strict, and every engine gives the
bits of strict code on any other processor. Only the bits of what is not a number may differ.
"""
