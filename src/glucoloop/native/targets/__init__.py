"""Targets: each makes code of what `glucoloop.native.lower` returns.

A target decides how values are held and scheduled, and nothing about arithmetic except one thing, which it states: how
it rounds products (`glucoloop.native.targets.products`). Targets of one precision that round products alike agree on
every bit.
"""
