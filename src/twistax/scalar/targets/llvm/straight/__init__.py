"""Straight-line programs in LLVM: pieces, products of matrices, and programs that they contain several times."""
