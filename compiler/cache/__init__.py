"""Keeps what steps of a compilation made, and takes it again where their inputs are the same.

The key of an entry is a SHA-256 over exactly what the step was given, the code of the compiler, the
libraries and the architecture; an entry holds plain data, says its own hashes, and is made again if
they do not fit.
"""
