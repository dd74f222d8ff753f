"""The kernels as plain numpy: what they compute, slowly and readably."""
