"""Parts that all pages share: the engine that draws over time, the colours, and the packing of modules."""
