"""Scenes that other programs describe, as cfgs: OAISYS, USD, BlenderProc and BOP.

An importer reads, translates and reports: every value of what it reads is translated, approximated
or dropped, and ``report`` says which and why. ``output`` writes the cfg, once it is valid.
"""
