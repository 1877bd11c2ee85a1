"""The laboratory in a page: the closed loop in WebAssembly, made from the same definitions as everything else.

`build` lowers the functions that the page needs and makes the package data of them and of the numbers of `page_data`,
which needs a linker; `pack` writes the page from that data, which needs nothing.
"""
