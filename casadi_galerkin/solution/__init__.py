"""The answer: a path that can be called and drawn, what is said of it, and what is raised where there is none.

Guesses are read here, because an earlier answer is one, and the loop of every refinement is here, because it ends with
an answer or with the best path so far.  This folder imports `calculus`, `problems` and `functional`.
"""
