"""The laboratory in a page: the closed loop in WebAssembly, made from the same definitions as everything else.

`parts` says which functions the page needs and lowers them; `numbers` says which numbers it starts from; `build` makes
the package data of both, which needs a linker; `pack` writes the page from that data, which needs nothing.
"""
