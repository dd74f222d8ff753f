"""The kernels compiled: the names, arguments and bits of `reference`."""
