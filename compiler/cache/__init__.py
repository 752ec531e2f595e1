"""Incremental compilation: what a step made is kept, and taken again where its inputs are the same.

The key of an entry is a SHA-256 over exactly what the step was given, the code of the compiler, the
libraries and the architecture; an entry holds plain data, says its own hashes, and is made again if
they do not fit.
"""
