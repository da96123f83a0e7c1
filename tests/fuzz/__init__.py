"""Hostile files by the thousand, each drawn from a seed and a number, and what came of reading them.

Each tool runs a number of cases: `python -m tests.fuzz.uploads --count 5000 --seed 1 --log uploads.jsonl`. What the log
has already is not run again.
"""
