"""Studies by many solves: speed against accuracy, global against stepwise, many variations of one problem.

`trade` measures times and errors against a reference, and `trade_table` shows them; `comparison` compares the global
solution with stepwise ones; `sweep` solves variations, here or in `parallel` processes, and may keep them in a
`sweep_file`.
Each study uses the verbs `solve` and `transcribe` as a user would.  This folder imports everything else.
"""
