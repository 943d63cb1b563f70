"""What is asked of many solves: speed against accuracy, global against stepwise, many variations of one problem.

`trade` measures what `trade_table` shows, against a `reference`; `comparison` sets global against stepwise; `sweep`
solves variations, with their `distribution` over processes.
Each study uses the verbs `solve` and `transcribe` as a user would.  This folder imports everything else.
"""
