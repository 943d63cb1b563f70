"""Boundary problems, all intervals at once.

A `transcription` is the graph of one problem, solved as often as wanted; `refinement` chooses degree and mesh for a
tolerance, `continuation` follows a path while parameters change, `deflation` finds others between the same ends,
`sensitivity` differentiates.  This folder imports all that stand before it, but neither `stepping` nor `control`.
"""
