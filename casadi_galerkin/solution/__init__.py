"""Solutions: paths that can be evaluated and drawn, their properties, and the exceptions where none is found.

A `path` may be called, drawn (`plotting`), saved (`export`) and asked for a `quantity`.  A `trajectory` is one that was
verified.  What all optimizations return is an `optimal_path`, of one phase a `control_trajectory`, with its controls, a
`control_path`.  `error_indicators` look for what a mesh may hide, by `jump_detection`; of an optimization
`violations_between_points` and `time_jumps` do.  A `guess` is read here, because an earlier solution may be one.  The
loop of every `refinement`, with its limits, `errors` and `progress`, is here, because it ends with a solution or with
the best path so far.  This folder imports `calculus`, `problems` and `functional`.
"""
