"""Solutions: paths that can be evaluated and drawn, their properties, and the exceptions where none is found.

Guesses are read here, because an earlier solution may be a guess.  The loop of every refinement is here, because it
ends with a solution or with the best path so far.  This folder imports `calculus`, `problems` and `functional`.
"""
