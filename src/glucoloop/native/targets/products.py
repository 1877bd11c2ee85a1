"""Rounding of a product that goes directly into a sum, as a property of a target.

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
