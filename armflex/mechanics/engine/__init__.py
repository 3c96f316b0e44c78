"""The engine: one text in C of where an arm rests and how it responds, with its tables and calls.

`engine.c` is compiled when the package is built, see `build`; `tables` checks all that it reads, `binding` calls it.
"""
