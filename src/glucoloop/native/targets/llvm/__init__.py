"""LLVM: vector code for this processor, several people side by side in each vector. Products are fused or strict."""
