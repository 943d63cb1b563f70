"""What is asked of many solves: speed against accuracy, global against stepwise, many variations of one problem.

Each study uses the verbs `solve` and `transcribe` as a user would.  This folder imports everything else.
"""
