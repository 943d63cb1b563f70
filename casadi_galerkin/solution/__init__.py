"""The answer: a path that can be evaluated and drawn, what is known of it, and the exceptions where there is none.

Guesses are read here, because an earlier answer is one, and the loop of every refinement is here, because it ends with
an answer or with the best path so far.  This folder imports `calculus`, `problems` and `functional`.
"""
