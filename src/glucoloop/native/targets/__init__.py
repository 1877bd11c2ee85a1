"""Targets: each makes code of what `glucoloop.native.lower` returns.

A target decides how values are held and scheduled, and nothing about arithmetic except one thing, which it states: how
it rounds a product that goes directly into a sum. Targets of one precision that round products alike agree on every
bit.

==========  =================================================================================================
name        meaning
==========  =================================================================================================
``fused``   product and sum are rounded once, by a fused multiply-add, where that sum alone takes the product
``strict``  every operation is rounded by itself, as every processor and WebAssembly can do it
==========  =================================================================================================
"""

from __future__ import annotations

from typing import Final

FUSED: Final = "fused"
STRICT: Final = "strict"
